"""Owns the search over all charger subsets: relax, order, refine, drive, account.

Every subset is first relaxed, which bounds it or proves it infeasible; those
whose bound is below the best plan are refined, most promising first; the best
plan is driven on the continuous model. Subsets are handled in batches of fixed
size, so the result does not depend on the number of workers. Knows no solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Literal

from enumerate.diagnose import diagnose
from enumerate.gap import DEFAULT_GAP, is_close, is_closed, relative_gap
from enumerate.ledger import Ledger, Outcome, Row
from enumerate.pool import run_in_order
from enumerate.result import Result, Status
from enumerate.subset import Subset, all_subsets
from relax.bound import relax_subset
from relax.execute import Execution, execute
from relax.instance import Drive, Instance, make_drive, make_instance
from relax.plan import Controls
from relax.refinement import Refined, RefineSettings, best_of, refine
from relax.relaxed_point import RelaxedPoint
from relax.report import make_report
from relax.starts import best_start, split_starts
from relax.tighten import prove
from relax.trip import Grid, Trip

__all__ = ["MAX_CHARGERS", "Progress", "plan"]

MAX_CHARGERS = 14
"""More chargers than this are refused: 2^14 relaxations take minutes."""
BATCH = 4
"""Subsets refined before the best plan is updated; fixed, so that any number of workers
closes the same subsets."""


@dataclass(frozen=True)
class Progress:
    """Where a search stands.

    Parameters
    ----------
    phase : str
        What is being done.
    done, total : int
        Subsets.
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


@dataclass(frozen=True)
class _Setting:
    """What every task needs; picklable."""

    trip: Trip
    drive: Drive
    grid: Grid
    refine: RefineSettings

    def instance(self, subset: Subset) -> Instance:
        return make_instance(self.trip, subset, self.grid, self.drive)


@dataclass(frozen=True)
class _Node:
    """A subset on its way through the search."""

    row: Row
    point: RelaxedPoint | None = None
    refined: Refined | None = None


def _relax(setting: _Setting, subset: Subset) -> _Node:
    begin = time.perf_counter()
    relaxed = relax_subset(setting.instance(subset))
    seconds = time.perf_counter() - begin
    programs = int(relaxed.solve_s > 0.0)
    if relaxed.infeasible:
        reason = "the relaxation has no point" if programs else "out of reach by interval bounds"
        return _Node(Row(subset, Outcome.INFEASIBLE, inf, inf, reason, programs, seconds))
    row = Row(
        subset,
        Outcome.UNPROVED,
        lower_bound=-inf if relaxed.lower_bound is None else relaxed.lower_bound,
        programs=programs,
        seconds=seconds,
    )
    return _Node(row, relaxed.point)


def _refine(setting: _Setting, node: _Node, starts: list[Controls] | None = None) -> _Node:
    begin = time.perf_counter()
    instance = setting.instance(node.row.subset)
    if starts is None:
        starts = [best_start(instance, node.point, node.row.lower_bound)]
    found = [refine(instance, start, setting.refine) for start in starts]
    best = best_of([*([node.refined] if node.refined else []), *found], instance)
    row = replace(
        node.row,
        cost=best.trajectory.cost if best.feasible else inf,
        outcome=Outcome.PLANNED if best.feasible else Outcome.UNPROVED,
        reason="" if best.feasible else "no feasible plan found, none disproved",
        programs=node.row.programs + sum(r.programs for r in found),
        seconds=node.row.seconds + time.perf_counter() - begin,
    )
    return _Node(row, node.point, best)


def _prove(setting: _Setting, node: _Node, cutoff: float, deadline: float) -> _Node:
    begin = time.perf_counter()
    instance = setting.instance(node.row.subset)
    proof = prove(instance, cutoff, bound=node.row.lower_bound, deadline=deadline)
    row = replace(
        node.row,
        lower_bound=proof.lower_bound,
        programs=node.row.programs + proof.programs,
        seconds=node.row.seconds + time.perf_counter() - begin,
    )
    if row.outcome is Outcome.UNPROVED and proof.closed:
        row = replace(row, outcome=Outcome.BOUNDED, reason="closed by tightening")
    return replace(node, row=row)


def _refine_splits(setting: _Setting, node: _Node) -> _Node:
    assert node.refined is not None
    instance = setting.instance(node.row.subset)
    return _refine(setting, node, split_starts(instance, node.refined.controls))


class _Search:
    """State of one search: a node per subset, and when to stop."""

    def __init__(
        self,
        setting: _Setting,
        executor: Executor | None,
        deadline: float,
        report: Callable[[Progress], None] | None,
    ) -> None:
        self.setting, self.executor = setting, executor
        self.deadline, self.report = deadline, report
        self.nodes = {
            s: _Node(Row(s, Outcome.UNPROVED)) for s in all_subsets(len(setting.trip.chargers))
        }
        self.execution: Execution | None = None
        self.interrupted = ""

    @property
    def best(self) -> _Node | None:
        """The node of the cheapest plan; ties go to the fewer stops."""
        planned = [n for n in self.nodes.values() if n.row.outcome is Outcome.PLANNED]
        return min(planned, key=lambda n: n.row.cost, default=None)

    @property
    def cost(self) -> float:
        """Cost of the cheapest plan."""
        return inf if self.best is None else self.best.row.cost

    def run(self, task: Callable[[_Setting, _Node], _Node], nodes: list[_Node], phase: str) -> None:
        """Apply a task to nodes in batches; between batches the clock is looked at."""
        done = 0
        while nodes and not self.interrupted:
            batch, nodes = nodes[:BATCH], nodes[BATCH:]
            bound = partial(task, self._setting_now())
            for node in run_in_order(self.executor, bound, batch):
                self.nodes[node.row.subset] = node
                done += 1
                self._tell(phase, done, done + len(nodes))
            if phase == "refine":
                nodes = [n for n in nodes if not self._close(n)]
            if time.perf_counter() > self.deadline:
                self.interrupted = "time limit reached"

    def _setting_now(self) -> _Setting:
        """Return the setting of the next batch: what cannot beat the best plan ends earlier."""
        return replace(self.setting, refine=replace(self.setting.refine, hopeless=self.cost))

    def _close(self, node: _Node) -> bool:
        """Close a subset whose bound shows that it cannot beat the best plan."""
        best = self.best
        if best is None or not is_closed(node.row.lower_bound, best.row.cost):
            return False
        reason = f"bound {node.row.lower_bound:.2f} is not below the best plan"
        row = replace(node.row, outcome=Outcome.BOUNDED, reason=reason)
        self.nodes[row.subset] = replace(node, row=row)
        return True

    def _tell(self, phase: str, done: int, total: int) -> None:
        if self.report is not None:
            bound = min(n.row.lower_bound for n in self.nodes.values())
            self.report(Progress(phase, done, total, self.cost, bound))

    def relax(self) -> None:
        """Bound every subset; plan a promising one as soon as it is known."""
        nodes = self.open()
        early = [n for n in nodes if len(n.row.subset) <= 1]
        self.run(_relax_node, early, "relax")
        known = [n for n in self.open() if n.point is not None]
        self.run(_refine, known[:1], "first plan")
        self.run(_relax_node, [n for n in nodes if len(n.row.subset) > 1], "relax")

    def refine(self, prune: bool) -> None:
        """Plan the subsets that may be better than the best plan, most promising first."""
        if prune:
            for node in self.open():
                self._close(node)
        self.run(_refine, self.open(), "refine" if prune else "refine all")
        close = [
            n
            for n in self.nodes.values()
            if n.refined is not None
            and n.row.outcome is Outcome.PLANNED
            and len(n.row.subset) > 1
            and is_close(n.row.cost, self.cost)
        ]
        self.run(_refine_splits, close, "further starts")

    def prove(self, gap: float) -> None:
        """Raise the bounds of all subsets that are not yet within the gap of the driven plan."""
        done = self.execution
        if done is None or done.replay is None:
            return
        cutoff = done.replay.cost - gap * max(abs(done.replay.cost), 1.0)
        nodes = [
            n
            for n in self.nodes.values()
            if n.row.outcome is not Outcome.INFEASIBLE and n.row.lower_bound < cutoff
        ]
        nodes.sort(key=lambda n: -n.row.lower_bound)
        task = partial(_prove, cutoff=cutoff, deadline=self.deadline)
        self.run(task, nodes, "prove")

    def open(self) -> list[_Node]:
        """Unsettled nodes, least bound first; ties go to fewer stops."""
        nodes = [n for n in self.nodes.values() if n.row.outcome is Outcome.UNPROVED]
        return sorted(nodes, key=lambda n: n.row.lower_bound)

    def drive(self) -> None:
        """Drive plans on the continuous model, cheapest first, until one holds."""
        while (best := self.best) is not None:
            assert best.refined is not None
            subset = best.row.subset
            instance = self.setting.instance(subset)
            done = execute(self.setting.trip, instance, best.refined, self.setting.refine)
            if not done.reason:
                self.execution = done
                return
            row = replace(
                best.row,
                outcome=Outcome.UNPROVED,
                cost=inf,
                reason=f"plan refused in replay: {done.reason}",
            )
            self.nodes[subset] = replace(best, row=row)
            self._reopen()

    def _reopen(self) -> None:
        """Look again at the subsets that were closed against a plan which has been refused."""
        closed = [n for n in self.nodes.values() if n.row.outcome is Outcome.BOUNDED]
        for node in closed:
            row = replace(node.row, outcome=Outcome.UNPROVED, reason="")
            self.nodes[row.subset] = replace(node, row=row)
        again = [n for n in self.open() if n.refined is None and not self._close(n)]
        again = [n for n in again if n.row.subset in {c.row.subset for c in closed}]
        self.run(_refine, again, "refine")


def plan(
    trip: Trip,
    *,
    gap: float | None = None,
    time_limit_s: float | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    solver: Literal["clarabel", "osqp"] = "clarabel",
    grid: Grid | None = None,
    prune: bool = True,
    progress: Callable[[Progress], None] | None = None,
) -> Result:
    """Plan a trip: stops, charging, heating and cooling, with a bound on what any plan costs.

    Parameters
    ----------
    trip : Trip
        From ``load_trip``.
    gap : float, optional
        Relative gap to prove: boxes of every subset that could be better are tightened
        and split until no plan can be cheaper by more than this. Without it only the
        root bounds are computed, which is fast, and the gap is whatever they give.
    time_limit_s : float, optional
        Wall-clock limit; the best plan and bound at that moment are returned [s].
    workers : int
        Threads over subsets; 1 runs everything in this thread.
    executor : Executor, optional
        Any ``concurrent.futures.Executor`` instead, for example processes.
    solver : {"clarabel", "osqp"}
        Solver of the quadratic programs. OSQP is less accurate, see ``docs/refinement.md``.
    grid : Grid, optional
        Other steps and cells than the trip's.
    prune : bool
        Skip subsets whose bound shows that they cannot be better; False plans them all.
    progress : callable, optional
        Called with a ``Progress`` after every subset.

    Returns
    -------
    Result
        The same for any number of workers, timings aside. Ctrl-C and the time
        limit return what is known by then, with ``interrupted`` set.

    Raises
    ------
    ValueError
        More than 14 chargers, or a gap that is not above 0.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip
    >>> result = plan(load_trip("paper-400km", overrides={"route.ambient_c": 10}))
    >>> result.replay.feasible, result.lower_bound <= result.cost
    (True, True)
    """
    begin = time.perf_counter()
    if len(trip.chargers) > MAX_CHARGERS:
        raise ValueError(f"at most {MAX_CHARGERS} chargers, not {len(trip.chargers)}")
    if gap is not None and not gap > 0.0:
        raise ValueError(f"gap must be above 0, not {gap}")
    grid = grid or trip.grid
    setting = _Setting(trip, make_drive(trip, grid.step_km), grid, RefineSettings(solver=solver))
    timings: dict[str, float] = {}

    def lap(name: str) -> None:
        timings[name] = time.perf_counter() - begin - sum(timings.values())

    with ExitStack() as stack:
        if executor is None and workers > 1:
            executor = stack.enter_context(ThreadPoolExecutor(workers))
        search = _Search(
            setting, executor, begin + (inf if time_limit_s is None else time_limit_s), progress
        )
        phases: list[tuple[str, Callable[[], None]]] = [
            ("relax", search.relax),
            ("refine", lambda: search.refine(prune)),
            ("replay", search.drive),
        ]
        if gap is not None:
            phases.append(("prove", lambda: search.prove(gap)))
        for name, phase in phases:
            if search.interrupted and name != "replay":
                continue
            try:
                phase()
            except KeyboardInterrupt:
                search.interrupted = "interrupted"
                if name == "replay":  # the plan is worth more than the moment
                    search.drive()
            lap(name)
    return _result(search, gap, timings, begin)


def _relax_node(setting: _Setting, node: _Node) -> _Node:
    return _relax(setting, node.row.subset)


def _result(search: _Search, gap: float | None, timings: dict[str, float], begin: float) -> Result:
    """Sum up a finished or interrupted search."""
    trip, best, done = search.setting.trip, search.best, search.execution
    ledger = Ledger(len(trip.chargers), tuple(n.row for n in search.nodes.values()))
    report, replayed, cost = None, None, inf
    if best is not None and done is not None and done.replay is not None:
        report = make_report(trip, search.setting.instance(best.row.subset), done)
        replayed, cost = done.replay, done.replay.cost
    status = Status.UNKNOWN
    if report is not None:
        enough = DEFAULT_GAP if gap is None else gap
        within = relative_gap(cost, ledger.lower_bound) <= enough * (1.0 + 1e-9)
        status = Status.OPTIMAL if within else Status.FEASIBLE
    elif all(row.outcome is Outcome.INFEASIBLE for row in ledger.rows):
        status = Status.INFEASIBLE
    settled = report is None and not search.interrupted
    timings["total"] = time.perf_counter() - begin
    return Result(
        trip=trip.name,
        currency=trip.currency,
        status=status,
        cost=cost,
        transcribed_cost=inf if done is None else done.trajectory.cost,
        lower_bound=ledger.lower_bound,
        plan=report,
        replay=replayed,
        ledger=ledger,
        chargers=tuple(c.name for c in trip.chargers),
        timings_s=timings,
        asked_gap=gap,
        interrupted=search.interrupted,
        diagnosis=diagnose(trip, search.setting.drive) if settled else None,
    )
