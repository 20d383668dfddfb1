"""Owns the work of a front that is about one choice of stops: plans within a time, and proofs.

Every task takes a picklable setting and returns values, so that any executor can run
it. Knows nothing of other choices and of where the front needs points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

from enumerate.front import Cut
from enumerate.stretch import Corner, Stretch
from enumerate.subset import Subset
from relax.bound import RelaxedSubset, relax_subset
from relax.execute import Execution, execute
from relax.instance import Drive, Instance, make_instance
from relax.plan import Controls
from relax.refinement import Refined, best_of, refine
from relax.relaxed_point import RelaxedPoint
from relax.simulate import is_feasible, simulate
from relax.starts import best_start, split_starts
from relax.tighten import prove
from relax.trip import Grid, Trip

__all__ = [
    "Driven",
    "Root",
    "Setting",
    "Timed",
    "Walk",
    "drive_plan",
    "plan_ends",
    "prove_stretch",
    "relax_ends",
    "support_plan",
    "walk_budgets",
]

PRICE_OF_TIME = 100.0
"""Price of an hour where time alone is minimised: brings the cost to the size of an energy."""
LATE_H = (0.0, 1e-3, 5e-3, 2e-2)
"""By how much the drive may exceed a budget, tried in turn: near the least time, what the
transcription misses cannot be repaired in no time [h]."""
RETRY = 1.0005
"""Ratio of values above which a plan is refined once more from its faster neighbour's."""


@dataclass(frozen=True)
class Setting:
    """What every task needs; picklable.

    Parameters
    ----------
    trip : Trip
        Its cost is the value of the front: prices as measured, no price of time.
    drive : Drive
        Its driving steps.
    grid : Grid
        Steps and cells.
    """

    trip: Trip
    drive: Drive
    grid: Grid

    def instance(self, subset: Subset, budget_h: float = inf, weight: float = 0.0) -> Instance:
        """Return the transcription for value + weight * time within a budget."""
        trip = replace(self.trip, time_value_per_h=weight, stop_time_h=budget_h)
        return make_instance(trip, subset, self.grid, self.drive)

    def hurried(self, subset: Subset, budget_h: float = inf) -> Instance:
        """Return the transcription for time alone."""
        free = [
            replace(c, price_per_kwh=0.0, occupancy_price_per_h=0.0, stop_penalty=0.0)
            for c in self.trip.chargers
        ]
        trip = replace(self.trip, chargers=tuple(free), stop_time_h=budget_h)
        trip = replace(trip, time_value_per_h=PRICE_OF_TIME)
        return make_instance(trip, subset, self.grid, self.drive)


@dataclass(frozen=True)
class Timed:
    """A plan on the transcription by value and time.

    Parameters
    ----------
    subset : tuple of int
        Chargers used.
    budget_h : float
        Time it was asked to keep [h].
    time_h, value : float
        Charging and detours [h]; energy or cost.
    refined : Refined
        The plan.
    """

    subset: Subset
    budget_h: float
    time_h: float
    value: float
    refined: Refined

    @property
    def corner(self) -> Corner:
        """Time and value."""
        return Corner(self.time_h, self.value)


@dataclass(frozen=True)
class Walk:
    """Budgets to look at with one choice of stops [h], and its plans so far."""

    plans: tuple[Timed, ...]
    budgets_h: tuple[float, ...]


@dataclass(frozen=True)
class Driven:
    """A plan as driven on the continuous model."""

    plan: Timed
    instance: Instance
    execution: Execution
    time_h: float
    value: float

    @property
    def corner(self) -> Corner:
        """What bounds must reach: the plan is within this time and has this value."""
        return Corner(max(self.time_h, self.plan.time_h), self.value)


def _timed(instance: Instance, budget_h: float, found: Refined) -> list[Timed]:
    """Return a refined plan by value and time; nothing if it breaks a limit."""
    if not found.feasible:
        return []
    spent = sum(float(s.dwell_h.sum()) for s in found.trajectory.stops)
    spent += sum(s.detour_h for s in instance.stops)
    return [Timed(instance.subset, budget_h, spent, found.trajectory.cost, found)]


def _seen(instance: Instance, controls: Controls) -> Refined:
    """Return controls as a plan of another instance of the same choice."""
    trajectory = simulate(instance, controls)
    return Refined(controls, trajectory, is_feasible(trajectory), 0)


def _bound(relaxed: RelaxedSubset) -> float:
    if relaxed.infeasible:
        return inf
    return -inf if relaxed.lower_bound is None else relaxed.lower_bound


@dataclass(frozen=True)
class Root:
    """What the root relaxations say of a choice: two cuts, and where refinements may start.

    Parameters
    ----------
    subset : tuple of int
        The choice.
    cuts : tuple of Cut
        Bound of the value and, unless that is infinite, of the time.
    points : tuple of RelaxedPoint or None
        Their optima.
    """

    subset: Subset
    cuts: tuple[Cut, ...]
    points: tuple[RelaxedPoint | None, ...]

    @property
    def corner(self) -> Corner:
        """Time and value that no plan of the choice undercuts."""
        cuts = self.cuts
        least_h = cuts[1].bound / cuts[1].time_weight if len(cuts) > 1 else inf
        return Corner(least_h, cuts[0].bound)


def relax_ends(setting: Setting, latest_h: float, subset: Subset) -> Root:
    """Bound value and time of a choice of stops by one relaxation each."""
    by_value = relax_subset(setting.instance(subset, latest_h))
    first = Cut(subset, 1.0, 0.0, latest_h, _bound(by_value))
    if by_value.infeasible:
        return Root(subset, (first,), (None,))
    by_time = relax_subset(setting.hurried(subset, latest_h))
    second = Cut(subset, 0.0, PRICE_OF_TIME, latest_h, _bound(by_time))
    return Root(subset, (first, second), (by_value.point, by_time.point))


def plan_ends(setting: Setting, latest_h: float, root: Root) -> list[Timed]:
    """Return the plan of least value and the fastest plan of a choice of stops."""
    subset = root.subset
    instance, hurried = setting.instance(subset, latest_h), setting.hurried(subset, latest_h)
    slow = refine(instance, best_start(instance, root.points[0], root.cuts[0].bound))
    splits = [refine(instance, s) for s in split_starts(instance, slow.controls)]
    slow = best_of([slow, *splits], instance)
    plans = _timed(instance, latest_h, slow)
    starts = [slow.controls]
    if root.points[1] is not None:
        starts.append(best_start(hurried, root.points[1], root.cuts[1].bound))
    fast = best_of([refine(hurried, start) for start in starts], hurried)
    for plan in _timed(instance, latest_h, _seen(instance, fast.controls)):
        within = setting.instance(subset, plan.time_h)
        better = _timed(within, plan.time_h, refine(within, fast.controls))
        plans += [replace(plan, budget_h=plan.time_h), *better]
    return plans


def walk_budgets(setting: Setting, walk: Walk) -> list[Timed]:
    """Refine within every budget, from the longest on, each from its slower neighbour's plan."""
    known = list(walk.plans)
    found = []
    for budget in sorted(walk.budgets_h, reverse=True):
        slower = [p for p in known if p.time_h > budget]
        faster = [p for p in known if p.time_h <= budget]
        if not slower or not faster:
            continue
        instance = setting.instance(known[0].subset, budget)
        start = min(slower, key=lambda p: p.time_h).refined.controls
        plans = _timed(instance, budget, refine(instance, start))
        near = min(faster, key=lambda p: p.value)
        if not plans or plans[0].value > near.value * RETRY:
            plans += _timed(instance, budget, refine(instance, near.refined.controls))
        known += plans
        found += plans
    return found


def support_plan(setting: Setting, line: tuple[float, float, Timed]) -> list[Timed]:
    """Return the plan of least value + weight * time within a budget, from a plan near it."""
    weight, budget_h, near = line
    instance = setting.instance(near.subset, budget_h, weight)
    found = refine(instance, near.refined.controls)
    plain = setting.instance(near.subset, budget_h)
    return _timed(plain, budget_h, _seen(plain, found.controls))


def drive_plan(setting: Setting, plan: Timed) -> Driven | None:
    """Drive a plan; one that cannot keep its budget to the second is given a little more."""
    for late in LATE_H:
        instance = setting.instance(plan.subset, plan.budget_h + late)
        done = execute(setting.trip, instance, plan.refined)
        if not done.reason and done.replay is not None:
            stops = zip(instance.stops, done.replay.stops, strict=True)
            spent = sum(ran.dwell_h + stop.detour_h for stop, ran in stops)
            return Driven(plan, instance, done, spent, done.replay.cost)
    return None


def prove_stretch(
    setting: Setting, stretch: Stretch, deadline: float, max_boxes: int, subset: Subset
) -> Cut:
    """Prove the line of a stretch for one choice of stops, or as much of it as is reached."""
    if stretch.value_weight == 0.0:
        instance, scale = setting.hurried(subset, stretch.budget_h), PRICE_OF_TIME
    else:
        instance, scale = setting.instance(subset, stretch.budget_h, stretch.time_weight), 1.0
    proof = prove(instance, scale * stretch.bound, max_boxes=max_boxes, deadline=deadline)
    return Cut(
        subset,
        stretch.value_weight,
        scale * stretch.time_weight,
        stretch.budget_h,
        proof.lower_bound,
    )
