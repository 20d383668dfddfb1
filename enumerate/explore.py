"""Owns the search for plans over all charger subsets: relax, order, refine, drive, account.

With few chargers every subset is relaxed, which bounds it or proves it infeasible, or all
with more than one stop together; those whose bound is below the best plan are refined,
most promising first. With many, families of subsets are relaxed together, and what their
optima use is refined, with its neighbours. The best plan is driven on the continuous
model. To prove a gap is the work of ``proving``. How much is handed out at once does not
depend on the number of workers, so neither does the result. Knows no solver.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import comb, inf

from enumerate.account import Account
from enumerate.gap import is_close, is_closed, may_gain
from enumerate.ledger import Outcome, Row
from enumerate.pool import Pending, run_in_order
from enumerate.road import Road
from enumerate.subset import Subset, all_subsets, neighbours
from enumerate.tasks import (
    WORTH_A_START,
    Node,
    Setting,
    examine_leaf,
    refine_afresh,
    refine_apart,
    refine_node,
    refine_splits,
    refine_thinned,
    relax_node,
    rescue_node,
)
from enumerate.tree import Examined, Leaf, cut_unbounded, make_roots
from relax.relaxed_point import Optimum

__all__ = ["FEW_CHARGERS", "Progress", "Search"]

FEW_CHARGERS = 4
"""Up to this many chargers every subset is relaxed by itself; with more, families are: 32
relaxations of single subsets take longer than the families of five chargers."""
FEW_TOGETHER = 2
"""More subsets with two stops or more than this are first bounded as one family: that takes as
long as one or two of them, and where one stop is best by far it closes them all."""
SURE = 0.018
"""That family is tried at once if the best plan is above its own bound by at most this share. Of
the 27 paper cases that saves a program in 9 of the 11 whose families close; it costs one at most
in 8 of the 16 others."""
FURTHER, FURTHER_WITHIN = 3, 0.02
"""Cheapest subsets that get further starts where there are many chargers, and how near to the best
they are: from Goteborg to Stockholm in winter, with a start at 35 %, the best stops were third
before, 1.4 % above the cheapest."""
FAR_BELOW = 0.12
"""Where there are few chargers, subsets with a bound this far below the best plan start afresh: of
214 random trips seven had plans 0.1 to 10 % too dear. It costs one of the 27 paper cases 11 of 41
programs, the others none; with 0.10 it costs three of them more, with 0.15 three trips are lost."""
FEW_ALIKE, MOST_ALIKE = 40, 4
"""Choices of as many stops as the best plan has, up to which all are bounded after a climb, and
how many of those not planned yet are: eight chargers have 28 pairs. From Goteborg to Stockholm in
winter, with a start at 65 %, no climb met the best pair, 0.6 % cheaper than what it ended at."""
BATCH = 4
"""Subsets handled before the best plan is updated; fixed, so that any number of workers closes
the same ones."""
SAME = 1e-4
"""Relative rise of a plan's cost by repairs that reopens what was closed against it."""
OPENING = 12
"""Leaves looked at before the first plan, when there are many chargers."""
RIVALS = 3
"""Further plans driven after one that holds, as long as they cost less on the grid than it does on
the road: two stops from Goteborg to Stockholm cost 0.04 % less than one, and 1.8 % more there."""
RESCUED = 3
"""Subsets that are planned from further starts when no plan holds."""
MAX_OPENING = 400
"""Leaves looked at for a first plan; after that the tree is searched without one."""


@dataclass(frozen=True)
class Progress:
    """Where a search stands.

    Parameters
    ----------
    phase : str
        What is being done.
    done, total : int
        Of what the phase counts: subsets, leaves, points of a front or per cent of the gap.
    cost : float
        Best plan so far on the transcription [currency].
    lower_bound : float
        Bound so far [currency].
    """

    phase: str
    done: int
    total: int
    cost: float
    lower_bound: float


class Search:
    """State of one search: the subsets met so far, the account, and when to stop."""

    def __init__(
        self,
        setting: Setting,
        executor: Executor | None,
        deadline: float,
        report: Callable[[Progress], None] | None,
        single: bool,
        keep_proofs: bool,
    ) -> None:
        self.setting, self.executor = setting, executor
        self.deadline, self.report = deadline, report
        self.n_chargers = len(setting.trip.chargers)
        self.account = Account(self.n_chargers, keep_proofs)
        self.single = single
        self.nodes: dict[Subset, Node] = {}
        self.optima: dict[Subset, Optimum | None] = {}
        self.together: frozenset[Subset] = frozenset()  # bounded as one family
        self.proving = False
        if single:
            every = all_subsets(self.n_chargers)
            self.nodes = {s: Node(Row(s, Outcome.UNPROVED)) for s in every}
        else:
            self.account.plant(make_roots(self.n_chargers))
        self.road = Road()
        self.interrupted = ""

    @property
    def best(self) -> Node | None:
        """The node of the cheapest plan; ties go to the fewer stops."""
        planned = [n for n in self.nodes.values() if n.row.outcome is Outcome.PLANNED]
        return min(planned, key=lambda n: n.row.cost, default=None)

    @property
    def cost(self) -> float:
        """Cost of the cheapest plan."""
        return inf if self.best is None else self.best.row.cost

    def run(
        self,
        task: Callable[[Setting, Node], Node],
        nodes: list[Node],
        phase: str,
        enough: float = -inf,
    ) -> None:
        """Apply a task to nodes in batches, until time is up or a plan costs less than enough."""
        done = 0
        while nodes and not self.interrupted and self.cost >= enough:
            batch, nodes = nodes[:BATCH], nodes[BATCH:]
            bound = partial(task, self.setting_now())
            for node in run_in_order(self.executor, bound, batch):
                if task is relax_node:
                    self.account.root(node.row, node.steps)
                    if self.n_chargers <= FEW_CHARGERS:  # else leaves have other boxes
                        self.optima[node.row.subset] = node.optimum
                    node = replace(node, optimum=None)
                self.nodes[node.row.subset] = node
                done += 1
                self.tell(phase, done, done + len(nodes))
            if phase.startswith("refine"):
                nodes = [n for n in nodes if not self._close(n)]
            self.look_at_clock()

    def look_at_clock(self) -> None:
        """Interrupt the search if time is up."""
        if time.perf_counter() > self.deadline:
            self.interrupted = "time limit reached"

    def setting_now(self) -> Setting:
        """Return the setting of the next batch: what cannot beat the best plan ends earlier."""
        return replace(self.setting, refine=replace(self.setting.refine, hopeless=self.cost))

    def _close(self, node: Node) -> bool:
        """Close a subset whose bound shows that it cannot beat the best plan."""
        best = self.best
        if best is None or not is_closed(node.row.lower_bound, best.row.cost):
            return False
        reason = f"bound {node.row.lower_bound:.2f} is not below the best plan"
        row = replace(node.row, outcome=Outcome.BOUNDED, reason=reason)
        self.nodes[row.subset] = replace(node, row=row)
        return True

    def tell(self, phase: str, done: int, total: int) -> None:
        """Report where the search stands."""
        if self.report is not None:
            bound = self.account.open_bound
            if bound == inf or (self.single and not self.proving):  # subsets speak for themselves
                bound = min((n.row.lower_bound for n in self.nodes.values()), default=inf)
            self.report(Progress(phase, done, total, self.cost, bound))

    def relax(self, prune: bool) -> None:
        """Bound every subset, or families of them; plan a promising one as soon as it is known."""
        if not self.single:
            for k in range(MAX_OPENING // BATCH):
                if self.interrupted or not self._examine_families():
                    break
                if k + 1 >= OPENING // BATCH:
                    self.plan_new([*self.account.suggestions(), *self.account.decided()])
                    if self.best is not None:
                        return
            self.plan_new(self.account.decided())
            return
        nodes = self.open()
        self.run(relax_node, [n for n in nodes if len(n.row.subset) <= 1], "relax")
        known = [n for n in self.open() if n.point is not None]
        self.run(refine_node, known[:1], "first plan")
        more = [n for n in nodes if len(n.row.subset) > 1]
        if prune and self.best is not None and len(more) > FEW_TOGETHER:
            more = self._relax_together(more)
        self.run(relax_node, more, "relax")

    def _relax_together(self, nodes: list[Node]) -> list[Node]:
        """Bound all subsets with two stops or more at once; return those that need their own.

        Unless the best plan is near its own bound, first the pair of the chargers that are best
        alone is bounded: what does not close it closes no family that it belongs to.
        """
        best, rest = self.best, nodes
        assert best is not None
        worth_it = best.row.cost - best.row.lower_bound <= SURE * abs(best.row.cost)
        if not worth_it:
            alone = [n for n in self.nodes.values() if len(n.row.subset) == 1]
            alone = sorted((n for n in alone if n.point), key=lambda n: n.row.lower_bound)
            pair = tuple(sorted(n.row.subset[0] for n in alone[:2]))
            self.run(relax_node, [n for n in nodes if n.row.subset == pair], "relax")
            rest = [n for n in nodes if n.row.subset != pair]
            bound = self.nodes[pair].row.lower_bound  # inf if infeasible
            worth_it = len(pair) == 2 and bound < inf and is_closed(bound, self.cost)
        if self.interrupted or not worth_it:
            return rest
        every = tuple(range(self.n_chargers))
        leaf = Leaf((), every, -inf, None, (2, self.n_chargers))
        done = examine_leaf(self.setting_now(), leaf, inf, self.deadline)
        if done.infeasible or not is_closed(done.bound, self.cost):  # each says why it is
            self.account.programs += done.programs
            return rest
        self.account.plant([leaf])
        (leaf,) = self.account.take(1, inf)  # numbered
        self.account.enter(replace(done, leaf=leaf), inf)
        for node in rest:
            row = replace(node.row, lower_bound=done.bound)
            self.nodes[row.subset] = replace(node, row=row)
        self.together = frozenset(n.row.subset for n in nodes)
        return []

    def refine(self, prune: bool) -> None:
        """Plan the subsets that may be better than the best plan, most promising first."""
        if self.single:
            if prune:
                for node in self.open():
                    self._close(node)
            self.run(refine_node, self.open(), "refine" if prune else "plan all")
            close = [n for n in self._planned() if is_close(n.row.cost, self.cost)]
            self.run(refine_splits, close, "further starts")
            far = self._promising(self._planned(), FAR_BELOW)
            self.run(refine_afresh, far, "further starts")
            return
        self._climb()
        self._look_around()
        tried: set[Subset] = set()
        while (best := self.best) is not None and not self.interrupted:
            close = [n for n in self._planned() if is_close(n.row.cost, self.cost, FURTHER_WITHIN)]
            close = self._promising(close[:FURTHER], WORTH_A_START)
            close = [n for n in close if n.row.subset not in tried]
            self.run(refine_apart, close, "further starts")
            tried.update(n.row.subset for n in close)
            if self.best is None or self.best.row.subset == best.row.subset:
                break
            self._climb()

    def _look_around(self) -> None:
        """Plan the most promising choices of as many stops as the best has, and climb on.

        A climb moves one stop at a time, and leaves what it has not tried at the first better one.
        """
        best = self.best
        if best is None or comb(self.n_chargers, len(best.row.subset)) > FEW_ALIKE:
            return
        alike = list(combinations(range(self.n_chargers), len(best.row.subset)))
        self._relax_new(alike)
        nodes = [self.nodes[s] for s in alike if s in self.nodes]
        fresh = [n for n in nodes if n.refined is None and n.row.outcome is not Outcome.INFEASIBLE]
        fresh.sort(key=lambda n: n.row.lower_bound)
        self.plan_new(n.row.subset for n in fresh[:MOST_ALIKE])
        if self.best is not best:
            self._climb()

    def _promising(self, nodes: list[Node], share: float) -> list[Node]:
        """Return the nodes whose bound leaves this share of the cost to gain."""
        return [n for n in nodes if may_gain(n.row.lower_bound, self.cost, share)]

    def _planned(self) -> list[Node]:
        """Return the nodes with plans that stop, the cheapest first."""
        planned = [n for n in self.nodes.values() if n.row.outcome is Outcome.PLANNED]
        return sorted((n for n in planned if n.row.subset), key=lambda n: n.row.cost)

    def _climb(self) -> None:
        """Move to better neighbours of the best plan's stops until there is none.

        First what is left without one of them, then whichever neighbour is the first to be
        better: to plan all of them before each move took twice the time with five stops.
        """
        order = [s.charger for s in self.setting.instance(tuple(range(self.n_chargers))).stops]
        before = inf
        while (plan := self.best) is not None and self.cost < before and not self.interrupted:
            before = self.cost
            self._thin(plan)
            if self.cost == before:
                self.plan_new(neighbours(plan.row.subset, order), enough=before)

    def _thin(self, plan: Node) -> None:
        """Plan what is left of a plan's stops without each of them, from the plan itself.

        Planned by itself such a subset may end in a local optimum that is dearer.
        """
        subset = plan.row.subset
        parts = [tuple(c for c in subset if c != out) for out in subset if len(subset) > 1]
        self._relax_new(parts)
        nodes = [self.nodes[part] for part in parts if part in self.nodes]
        nodes = [n for n in nodes if n.row.outcome is not Outcome.INFEASIBLE]
        nodes = [n for n in nodes if n.row.lower_bound < self.cost]
        self.run(partial(refine_thinned, plan=plan), nodes, "further starts")

    def _relax_new(self, subsets: Iterable[Subset]) -> None:
        """Relax subsets not met before."""
        fresh = [s for s in dict.fromkeys(subsets) if s not in self.nodes]
        self.run(relax_node, [Node(Row(s, Outcome.UNPROVED)) for s in fresh], "relax")

    def plan_new(self, subsets: Iterable[Subset], enough: float = -inf) -> None:
        """Relax and refine subsets not planned before, until a plan costs less than enough."""
        near = list(dict.fromkeys(subsets))
        self._relax_new(near)
        nodes = [self.nodes[s] for s in near if s in self.nodes]
        nodes = [n for n in nodes if n.refined is None and n.row.outcome is Outcome.UNPROVED]
        nodes = [n for n in nodes if not self._close(n)]
        nodes.sort(key=lambda n: n.row.lower_bound)
        self.run(partial(refine_node, warm=True), nodes, "refine", enough)

    def _examine_families(self) -> bool:
        """Examine a batch of the families of least bound; return whether there was any."""
        leaves = self._take(BATCH, inf, families=True)
        task = partial(examine_leaf, self.setting, cutoff=inf, deadline=self.deadline)
        entered = 0
        try:
            for done in run_in_order(self.executor, task, leaves):
                self.account.enter(done, inf)
                entered += 1
                self.tell("relax", *self.account.progress)
        finally:  # an interrupt loses no leaf
            self.account.put_back(leaves[entered:])
        self.look_at_clock()
        return entered > 0

    def examine_all(
        self, cutoff: Callable[[], float], ahead: int
    ) -> Generator[Examined, None, None]:
        """Examine open leaves, of least bound first, until none is below the cutoff.

        Yields what became of each as it is entered, in the order in which they were taken.

        Parameters
        ----------
        cutoff : callable
            Returns the cost from which on a bound closes at the moment [currency].
        ahead : int
            Leaves that are handed out before the first of them is entered.
        """
        waiting: deque[tuple[Leaf, float, Pending[Examined]]] = deque()
        try:
            while not self.interrupted:
                closing = cutoff()
                task = partial(examine_leaf, self.setting, cutoff=closing, deadline=self.deadline)
                for leaf in self._take(ahead - len(waiting), closing, families=False):
                    waiting.append((leaf, closing, Pending(self.executor, task, leaf)))
                if not waiting:
                    return
                _, closing, pending = waiting[0]
                done = pending.result()
                self.account.enter(done, closing)
                waiting.popleft()
                self.tell("prove", *self.account.progress)
                self.look_at_clock()
                yield done
        finally:  # an interrupt loses no leaf
            for _, _, pending in waiting:
                pending.cancel()
            self.account.put_back(leaf for leaf, _, _ in waiting)

    def _take(self, most: int, cutoff: float, families: bool) -> list[Leaf]:
        """Take open leaves of least bound; small families among them are replaced by parts."""
        out: list[Leaf] = []
        found: list[Leaf] = []
        try:
            while len(out) < most and (
                found := self.account.take(most - len(out), cutoff, families)
            ):
                while found:
                    done = cut_unbounded(self.setting.instance, found[0], cutoff)
                    if done is None:
                        out.append(found[0])
                    else:
                        self.account.enter(done, cutoff)
                    del found[0]
        except BaseException:  # an interrupt loses no leaf
            self.account.put_back([*out, *found])
            raise
        return out

    def open(self) -> list[Node]:
        """Unsettled nodes, least bound first; ties go to fewer stops."""
        nodes = [n for n in self.nodes.values() if n.row.outcome is Outcome.UNPROVED]
        return sorted(nodes, key=lambda n: n.row.lower_bound)

    def drive(self) -> None:
        """Drive plans on the continuous model, cheapest first, until one holds.

        Then a few that its cost on the road, if that is above its cost on the grid, leaves in
        doubt. The cheapest on the road is kept.
        """
        rivals = 0
        while (node := self._next_to_drive()) is not None and rivals < RIVALS:
            rivals += self.road.execution is not None
            row = self.road.drive(self.setting, node, patient=node is self.best)
            if row.cost > node.row.cost + SAME * abs(node.row.cost):
                # refused or repaired: others were closed against a cost that does not hold
                self.nodes[row.subset] = replace(node, row=row)
                self._reopen()

    def _next_to_drive(self) -> Node | None:
        planned = [n for n in self.nodes.values() if n.row.outcome is Outcome.PLANNED]
        late = bool(self.interrupted) or time.perf_counter() > self.deadline
        return self.road.next(planned, self.best, late)

    def drive_or_rescue(self) -> None:
        """Drive plans until one holds; if none does, plan the most promising subsets again."""
        self.drive()
        for node in self.open()[:RESCUED]:
            if self.best is None and not self.interrupted:
                self.run(partial(rescue_node, deadline=self.deadline), [node], "further starts")
        if self.best is not None and self.road.execution is None:
            self.drive()

    def _reopen(self) -> None:
        """Look again at the subsets that were closed against a plan which has been refused."""
        closed = [n for n in self.nodes.values() if n.row.outcome is Outcome.BOUNDED]
        for node in closed:
            row = replace(node.row, outcome=Outcome.UNPROVED, reason="")
            self.nodes[row.subset] = replace(node, row=row)
        again = [n for n in self.open() if n.refined is None and not self._close(n)]
        again = [n for n in again if n.row.subset in {c.row.subset for c in closed}]
        self.run(refine_node, again, "refine")
