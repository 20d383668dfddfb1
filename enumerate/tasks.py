"""Owns what is done to one subset or leaf: relax, refine, examine. Picklable, for any executor.

Knows nothing of other subsets and of the order of the search.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from math import inf

from enumerate.gap import may_gain
from enumerate.ledger import Outcome, Row
from enumerate.subset import Subset
from enumerate.tree import Examined, Leaf, examine
from relax.bound import relax_subset
from relax.execute import execute
from relax.instance import Drive, Instance, make_instance
from relax.plan import Controls
from relax.proof import Step
from relax.refinement import Refined, RefineSettings, best_of, refine, refine_best
from relax.relaxed_point import Optimum, RelaxedPoint
from relax.simulate import Simulation
from relax.starts import (
    best_start,
    colder_start,
    even_start,
    further_starts,
    relaxed_start,
    split_starts,
    thinned_starts,
    warmer_start,
)
from relax.trip import Grid, Trip

__all__ = [
    "WORTH_A_START",
    "Node",
    "Setting",
    "examine_leaf",
    "refine_afresh",
    "refine_apart",
    "refine_from",
    "refine_node",
    "refine_point",
    "refine_splits",
    "refine_thinned",
    "relax_node",
    "rescue_node",
]


WORTH_A_START = 0.02
"""Share of the best plan's cost by which the bound of a subset is below it if the subset gets more
than one start: what they gain is at most that. Saves a sixth of the programs of random trips."""


@dataclass(frozen=True)
class Setting:
    """What every task needs; picklable.

    Parameters
    ----------
    trip : Trip
        The trip.
    drive : Drive
        Its driving steps, shared by all subsets.
    grid : Grid
        Steps and cells.
    refine : RefineSettings
        Of the refinements.
    """

    trip: Trip
    drive: Drive
    grid: Grid
    refine: RefineSettings

    def instance(self, subset: Subset, undecided: Subset = ()) -> Instance:
        """Return the instance of used and undecided chargers."""
        return make_instance(self.trip, subset, self.grid, self.drive, undecided)


@dataclass(frozen=True)
class Node:
    """A subset on its way through the search.

    Parameters
    ----------
    row : Row
        Its account so far.
    point : RelaxedPoint or None
        Where a refinement may start.
    refined : Refined or None
        Its best plan.
    steps : tuple of Step
        The proof of its first bound.
    starts : int
        Starts that proofs have added.
    optimum : Optimum or None
        That of its relaxation, as ``relax_node`` gives it.
    """

    row: Row
    point: RelaxedPoint | None = None
    refined: Refined | None = None
    steps: tuple[Step, ...] = ()
    starts: int = 0
    optimum: Optimum | None = None


def relax_node(setting: Setting, node: Node) -> Node:
    """Bound a subset by its relaxation, or prove it infeasible."""
    subset = node.row.subset
    relaxed = relax_subset(setting.instance(subset))
    programs = int(relaxed.solve_s > 0.0)
    if relaxed.infeasible:
        reason = "the relaxation has no point" if programs else "out of reach by interval bounds"
        row = Row(subset, Outcome.INFEASIBLE, inf, inf, reason, programs)
        return Node(row, steps=relaxed.steps)
    row = Row(
        subset,
        Outcome.UNPROVED,
        lower_bound=-inf if relaxed.lower_bound is None else relaxed.lower_bound,
        programs=programs,
    )
    return Node(row, relaxed.point, steps=relaxed.steps, optimum=relaxed.optimum)


def refine_node(setting: Setting, node: Node, warm: bool = False) -> Node:
    """Plan a subset for the first time, from its relaxed point.

    Parameters
    ----------
    setting : Setting
        What every task needs.
    node : Node
        The subset.
    warm : bool
        From equal, warm stops or from the relaxed point, whichever is ahead after a few
        programs: the losses of a relaxed optimum heat the battery for nothing, which in the
        cold leads to poor local optima. Only if the bound leaves something to gain.
    """
    instance = setting.instance(node.row.subset)
    simulation = Simulation(instance)

    def relaxed() -> Controls:
        return best_start(instance, node.point, node.row.lower_bound, simulation)

    def both() -> Iterator[Controls]:
        yield warmer_start(instance, even_start(instance))
        yield relaxed()

    worth = may_gain(node.row.lower_bound, setting.refine.hopeless, WORTH_A_START)
    if warm and worth and instance.stops:
        found = [refine_best(instance, both(), setting.refine)]
    else:
        found = [refine(instance, relaxed(), setting.refine, simulation)]
    if not found[0].feasible:  # may miss a limit by a hair
        found.append(refine(instance, even_start(instance), setting.refine))
    return _with_plan(node, found, instance)


def refine_from(setting: Setting, node: Node, starts: list[Controls]) -> Node:
    """Plan a subset from each of these starts; a better plan it has stays."""
    instance = setting.instance(node.row.subset)
    simulation = Simulation(instance)
    had = node.refined
    known = had.trajectory if had is not None and had.feasible else None
    found = [refine(instance, start, setting.refine, simulation, known) for start in starts]
    return _with_plan(node, found, instance)


def _with_plan(node: Node, found: list[Refined], instance: Instance) -> Node:
    """Return a node with the best of its plan and those found.

    Unless its plan was refused when it was driven: then any that differs is better.
    """
    had = node.refined
    holds = had is not None and had.feasible
    refused = holds and node.row.outcome is Outcome.UNPROVED
    candidates = [*([had] if had and not refused else []), *found]
    if not candidates:
        return node
    best = best_of(candidates, instance)
    if had and holds and not refused and had.trajectory.cost < best.trajectory.cost:
        best = had  # both hold; merit would prefer the dearer one for missing by less
    reason = node.row.reason if refused else "no feasible plan found, none disproved"
    row = replace(
        node.row,
        cost=best.trajectory.cost if best.feasible else inf,
        outcome=Outcome.PLANNED if best.feasible else Outcome.UNPROVED,
        reason="" if best.feasible else reason,
        programs=node.row.programs + sum(r.programs for r in found),
    )
    return replace(node, row=row, refined=best)


def examine_leaf(setting: Setting, leaf: Leaf, cutoff: float, deadline: float) -> Examined:
    """Bound, shrink and cut a leaf."""
    return examine(setting.instance, leaf, cutoff, deadline)


def refine_splits(setting: Setting, node: Node) -> Node:
    """Plan a subset again, from its energy split otherwise between the stops, or warmer."""
    assert node.refined is not None
    instance, controls = setting.instance(node.row.subset), node.refined.controls
    starts = [*split_starts(instance, controls), warmer_start(instance, controls)]
    return refine_from(setting, node, starts)


def refine_apart(setting: Setting, node: Node) -> Node:
    """Plan a subset again: from its plan warmer and colder, equal stops, the relaxed optimum."""
    assert node.refined is not None
    instance, controls = setting.instance(node.row.subset), node.refined.controls
    starts = [warmer_start(instance, controls), colder_start(controls), even_start(instance)]
    if node.point is not None:
        starts.append(relaxed_start(instance, node.point))
    return refine_from(setting, node, starts)


def refine_afresh(setting: Setting, node: Node) -> Node:
    """Plan a subset again, from equal stops, warm and without heating, whatever its plan is."""
    instance = setting.instance(node.row.subset)
    even = even_start(instance)
    return refine_from(setting, node, [warmer_start(instance, even), even])


def refine_thinned(setting: Setting, node: Node, plan: Node) -> Node:
    """Plan a subset from the plan of one that uses a charger more; a better plan it has stays."""
    assert plan.refined is not None
    chargers = [stop.charger for stop in setting.instance(plan.row.subset).stops]
    (left_out,) = set(chargers) - set(node.row.subset)
    starts = thinned_starts(plan.refined.controls, chargers.index(left_out))
    return refine_from(setting, node, starts)


def rescue_node(setting: Setting, node: Node, deadline: float = inf) -> Node:
    """Plan a subset from further starts, until one gives a plan that holds when it is driven."""
    instance = setting.instance(node.row.subset)
    programs, row = 0, node.row
    # where the first plan broke a limit on the grid, the even start has been tried already
    tried = int(node.refined is not None and not node.refined.feasible)
    for start in islice(further_starts(instance), tried, None):
        if time.perf_counter() > deadline:
            break
        refined = refine(instance, start, setting.refine)
        programs += refined.programs
        if refined.feasible and not execute(setting.trip, instance, refined, setting.refine).reason:
            row = replace(row, cost=refined.trajectory.cost, outcome=Outcome.PLANNED, reason="")
            node = replace(node, refined=refined)
            break
    return replace(node, row=replace(row, programs=row.programs + programs))


def refine_point(setting: Setting, node: Node) -> Node:
    """Plan a subset again, from the relaxed point it carries."""
    assert node.point is not None
    instance = setting.instance(node.row.subset)
    return refine_from(setting, node, [relaxed_start(instance, node.point)])
