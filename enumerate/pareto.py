"""Owns the exact front of energy (or cost) against charging and detour time.

Plans come from a limit of the time, so that parts which no weighted sum reaches are
found too. Bounds come from few proofs: each is about a stretch of the front, with a
weight of time and a longest time of its own, and certifies all its points at once.
Method and figures: docs/pareto.md. Knows no solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from math import inf
from typing import Literal, TypeVar

from enumerate.explore import Progress
from enumerate.front import CurvePoint, Cut, Front, FrontPoint, earliest_h, front_gap, least_value
from enumerate.front_plans import (
    Driven,
    Root,
    Setting,
    Timed,
    Walk,
    drive_plan,
    plan_ends,
    prove_stretch,
    relax_ends,
    support_plan,
    walk_budgets,
)
from enumerate.gap import relative_gap
from enumerate.phases import REPLAY, run_phases
from enumerate.pool import open_pool, run_in_order
from enumerate.spread import improves, next_times, spread
from enumerate.stretch import Stretch, make_stretches
from enumerate.subset import Subset, all_subsets
from relax.execute import Execution
from relax.instance import make_drive, make_instance
from relax.report import make_report
from relax.simulate import stop_cost
from relax.trip import Grid, Trip

__all__ = ["pareto"]

T = TypeVar("T")
R = TypeVar("R")

MOST_CHARGERS = 10
"""More chargers than this are refused: every one of the 2^N stop sets has a front of its own."""
BATCH = 4
"""Times looked at before the front is updated; fixed, so that workers change nothing."""
TRIES = 2
"""Times looked at per point wanted: not every one holds a new point."""
SUPPORTS = 3
"""Rounds in which plans below the lines to be proved are looked for."""


class _Search:
    """State of one front: plans and cuts so far, and when to stop."""

    def __init__(
        self,
        setting: Setting,
        executor: Executor | None,
        deadline: float,
        every_subset: bool,
        report: Callable[[Progress], None] | None,
    ) -> None:
        self.setting, self.executor, self.every_subset = setting, executor, every_subset
        self.deadline, self.report = deadline, report
        self.subsets = list(all_subsets(len(setting.trip.chargers)))
        self.plans: list[Timed] = []
        self.cuts: dict[Subset, list[Cut]] = {
            s: [Cut(s, 1.0, 0.0, inf, -inf)] for s in self.subsets
        }
        self.driven: list[Driven] = []
        self.budgets: list[float] = []
        self.interrupted = ""

    def run(self, task: Callable[[T], R], items: Sequence[T], phase: str) -> list[R]:
        """Apply a task to items in batches; between batches the clock is looked at."""
        found: list[R] = []
        for start in range(0, len(items), BATCH):
            if self.interrupted:
                break
            found += run_in_order(self.executor, task, items[start : start + BATCH])
            self.tell(phase, len(found), len(items))
        return found

    def tell(self, phase: str, done: int, total: int) -> None:
        """Report progress and look at the clock."""
        if self.report is not None:
            self.report(Progress(phase, done, total, inf, -inf))
        if time.perf_counter() > self.deadline:
            self.interrupted = "time limit reached"

    def of(self, subset: Subset) -> list[Timed]:
        """Plans of a choice of stops."""
        return [p for p in self.plans if p.subset == subset]

    def ends(self, latest_h: float) -> None:
        """Find both ends of every choice of stops that may be on the front."""
        roots = self.run(partial(relax_ends, self.setting, latest_h), self.subsets, "relax")
        for root in roots:
            self.cuts[root.subset] += root.cuts
        order = [r for r in roots if r.corner.value < inf]
        order.sort(key=lambda r: (r.corner.value, len(r.subset), r.subset))
        task = partial(plan_ends, self.setting, latest_h)
        while order and not self.interrupted:
            batch, order = order[:BATCH], order[BATCH:]
            for plans in run_in_order(self.executor, task, batch):
                self.plans += plans
            order = [r for r in order if self.every_subset or not self._beaten(r)]
            self.tell("ends", len(roots) - len(order), len(roots))

    def _beaten(self, root: Root) -> bool:
        """Whether a known plan is as good as any of a choice can be in value and in time."""
        least = root.corner
        return any(p.time_h <= least.time_h and p.value <= least.value for p in self.plans)

    def fill(self, points: int) -> None:
        """Add points where the front is long, until there are as many as asked for."""
        while not self.interrupted and len(self.budgets) < TRIES * points:
            wanted = min(BATCH, points - len(spread(self.plans)))
            budgets = next_times(self.plans, self.budgets, wanted)
            if not budgets:
                return
            self.look(budgets)
            self.tell("front", min(len(spread(self.plans)), points), points)

    def look(self, budgets_h: Sequence[float]) -> None:
        """Plan within budgets, with every choice of stops that may be on the front there."""
        self.budgets += budgets_h
        front = spread(self.plans)
        walks = []
        for subset in self.subsets:
            plans = self.of(subset)
            least = min((p.value for p in plans), default=inf)
            wanted = tuple(
                b
                for b in budgets_h
                if plans
                and (
                    self.every_subset
                    or least < min((p.value for p in front if p.time_h <= b), default=inf)
                )
            )
            if wanted:
                walks.append(Walk(tuple(plans), wanted))
        for found in run_in_order(self.executor, partial(walk_budgets, self.setting), walks):
            self.plans += found

    def support(self, gap: float, latest_h: float) -> None:
        """Look for plans below the lines that are to be proved: such lines would be in vain."""
        seen: set[tuple[float, float, Subset]] = set()
        for _ in range(SUPPORTS):
            front = [p.corner for p in spread(self.plans)]
            lines = []
            for stretch in make_stretches(front, [p.corner for p in self.plans], gap, latest_h):
                weight, budget = stretch.time_weight, stretch.budget_h
                for subset in self.subsets:
                    own = [p for p in self.of(subset) if p.time_h <= budget]
                    if stretch.value_weight == 0.0 or weight == 0.0 or not own:
                        continue
                    near = min(own, key=lambda p: p.value + weight * p.time_h)
                    least = min(p.value for p in own) + weight * min(p.time_h for p in own)
                    key = (weight, budget, subset)
                    if least < stretch.bound * (1.0 + gap) and key not in seen:
                        seen.add(key)
                        lines.append((weight, budget, near))
            if not lines:
                return
            for plans in self.run(partial(support_plan, self.setting), lines, "support"):
                self.plans += plans

    def drive(self) -> None:
        """Drive the front; where a plan is refused, those behind it move up."""
        refused: set[int] = set()
        done: dict[int, Driven] = {}
        while True:
            front = spread(p for p in self.plans if id(p) not in refused)
            new = [p for p in front if id(p) not in done]
            if not new:
                break
            results = run_in_order(self.executor, partial(drive_plan, self.setting), new)
            for plan, result in zip(new, results, strict=True):
                if result is None:
                    refused.add(id(plan))
                else:
                    done[id(plan)] = result
                self.tell("replay", len(done), len(front))
        kept: list[Driven] = []
        for entry in sorted((done[id(p)] for p in front), key=lambda d: (d.time_h, d.value)):
            if not kept or improves(entry.value, kept[-1].value):
                kept.append(entry)
        self.driven = kept
        self.plans = [p for p in self.plans if id(p) not in refused]

    def prove(self, gap: float, latest_h: float, max_boxes: int) -> None:
        """Raise the cuts until they certify every point, stretch by stretch."""
        known = [p.corner for p in self.plans] + [d.corner for d in self.driven]
        stretches = make_stretches([d.corner for d in self.driven], known, gap, latest_h)
        for number, stretch in enumerate(stretches):
            open_ = [s for s in self.subsets if not self._covers(s, stretch, gap)]
            left = self.deadline - time.perf_counter()
            deadline = time.perf_counter() + left / (len(stretches) - number)
            for start in range(0, len(open_), BATCH):
                task = partial(prove_stretch, self.setting, stretch, deadline, max_boxes)
                for cut in run_in_order(self.executor, task, open_[start : start + BATCH]):
                    self.cuts[cut.subset].append(cut)
            self.tell("prove", number + 1, len(stretches))
            if self.interrupted:
                return

    def _covers(self, subset: Subset, stretch: Stretch, gap: float) -> bool:
        """Whether the cuts of a choice already certify all points of a stretch."""
        cuts = self.cuts[subset]
        return all(
            relative_gap(c.value, least_value(cuts, c.time_h)) <= gap
            if c in stretch.flat
            else front_gap(cuts, c.time_h, c.value) <= gap
            for c in stretch.corners
        )


def pareto(
    trip: Trip,
    *,
    points: int = 12,
    times_h: Sequence[float] | None = None,
    measure: Literal["energy", "cost"] = "energy",
    gap: float | None = 0.01,
    latest_h: float | None = None,
    every_subset: bool = False,
    max_boxes: int = 100,
    time_limit_s: float | None = None,
    grid: Grid | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Front:
    """Return the front of energy or cost against charging and detour time, with bounds.

    Parameters
    ----------
    trip : Trip
        From ``load_trip``; its value of time is ignored, its limit of the time holds.
    points : int
        Points wanted, spread evenly along the front, both ends included. Fewer come
        back where the front is short or upright.
    times_h : sequence of float, optional
        Look at these times instead of spreading points; the ends come beside [h].
    measure : {"energy", "cost"}
        Energy from the chargers [kWh], or what the trip costs without the value of
        time [currency].
    gap : float or None
        Relative gap to prove of every point; None leaves it at the root bounds.
    latest_h : float, optional
        Longest time of interest [h]: the energy end is then the least within it.
    every_subset : bool
        Plan every choice of stops at every time, for complete ``curves``; otherwise
        those that may be on the front.
    max_boxes : int
        Effort of one proof: boxes looked at before it gives up.
    time_limit_s : float, optional
        Wall-clock limit; what is known by then is returned [s].
    grid : Grid, optional
        Other steps and cells than the trip's.
    workers : int
        Processes (threads where they cannot be forked); 1 runs everything here.
    executor : Executor, optional
        Any ``concurrent.futures.Executor`` instead.
    progress : callable, optional
        Called with a ``Progress`` as the work goes on.

    Returns
    -------
    Front
        The same for any number of workers, timings and time limits aside. Ctrl-C returns what
        is known by then, with ``interrupted`` set. No points: no plan was found.

    Raises
    ------
    ValueError
        More than 10 chargers, fewer than 2 points, a gap not above 0 and below 1, a time not
        above 0, an unknown measure, or no worker.

    Examples
    --------
    >>> from enumerate import pareto
    >>> from relax import load_trip
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> front = pareto(trip, points=3, gap=None)
    >>> [p.value for p in front.points] == sorted((p.value for p in front.points), reverse=True)
    True
    """
    begin = time.perf_counter()
    if len(trip.chargers) > MOST_CHARGERS:
        raise ValueError(f"at most {MOST_CHARGERS} chargers, not {len(trip.chargers)}")
    if points < 2:
        raise ValueError(f"at least 2 points, not {points}")
    if gap is not None and not 0.0 < gap < 1.0:
        raise ValueError(f"gap must be above 0 and below 1, not {gap}")
    if latest_h is not None and not latest_h > 0.0:
        raise ValueError(f"latest_h must be above 0, not {latest_h}")
    if times_h is not None and not all(0.0 < t < inf for t in times_h):
        raise ValueError(f"times_h must be above 0, not {list(times_h)}")
    if measure not in ("energy", "cost"):
        raise ValueError(f"measure must be 'energy' or 'cost', not {measure!r}")
    grid = grid or trip.grid
    latest = min(trip.stop_time_h, inf if latest_h is None else latest_h)
    setting = Setting(_measured(trip, measure), make_drive(trip, grid.step_km), grid)
    deadline = begin + (inf if time_limit_s is None else time_limit_s)
    with open_pool(workers, executor) as pool:
        search = _Search(setting, pool, deadline, every_subset, progress)
        phases: list[tuple[str, Callable[[], None]]] = [("ends", lambda: search.ends(latest))]
        if times_h is None:
            phases.append(("front", lambda: search.fill(points)))
        else:
            phases.append(("front", lambda: search.look(sorted(times_h))))
        if gap is not None:
            phases.append(("support", lambda: search.support(gap, latest)))
        phases.append((REPLAY, search.drive))
        if gap is not None:
            phases.append(("prove", lambda: search.prove(gap, latest, max_boxes)))
        timings = run_phases(search, phases, begin)
    found = _result(search, trip, measure, gap)
    return replace(found, timings_s={**timings, "total": time.perf_counter() - begin})


def _measured(trip: Trip, measure: str) -> Trip:
    """Return the trip whose cost is the measure."""
    if measure == "cost":
        return replace(trip, time_value_per_h=0.0)
    chargers = [
        replace(c, price_per_kwh=1.0, occupancy_price_per_h=0.0, stop_penalty=0.0)
        for c in trip.chargers
    ]
    return replace(trip, chargers=tuple(chargers), time_value_per_h=0.0)


def _result(search: _Search, trip: Trip, measure: str, gap: float | None) -> Front:
    """Sum up a finished or interrupted search."""
    cuts = tuple(c for s in search.subsets for c in search.cuts[s])
    points = []
    for driven in search.driven:
        corner = driven.corner
        bound = min(least_value(cuts, corner.time_h), corner.value)
        least_h = min(earliest_h(cuts, corner.value), corner.time_h)
        both = front_gap(cuts, corner.time_h, corner.value)
        report = make_report(trip, driven.instance, _priced(trip, driven))
        points.append(
            FrontPoint(
                budget_h=driven.plan.budget_h,
                time_h=driven.time_h,
                charging_h=report.charging_h,
                detour_h=report.detour_h,
                value=driven.value,
                energy_kwh=report.grid_kwh,
                stops=tuple(s.charger for s in report.stops),
                subset=driven.plan.subset,
                lower_bound=bound,
                gap=relative_gap(corner.value, bound),
                least_time_h=least_h,
                time_gap=1.0 - least_h / corner.time_h if corner.time_h > 0.0 else 0.0,
                front_gap=both,
                proved=gap is not None and both <= gap,
                plan=report,
            )
        )
    curves = {
        s: tuple(CurvePoint(p.time_h, p.value) for p in spread(own))
        for s in search.subsets
        if (own := [p for p in search.plans if p.subset == s])
    }
    return Front(
        trip=trip.name,
        measure=measure,
        unit="kWh" if measure == "energy" else trip.currency,
        points=tuple(points),
        curves=curves,
        chargers=tuple(c.name for c in trip.chargers),
        cuts=cuts,
        asked_gap=gap,
        interrupted=search.interrupted,
        timings_s={},
    )


def _priced(trip: Trip, driven: Driven) -> Execution:
    """Return the execution at the trip's own prices, driven and on the grid."""
    done = driven.execution
    assert done.replay is not None
    own = make_instance(replace(trip, time_value_per_h=0.0), driven.plan.subset)
    stops = tuple(
        replace(ran, cost=stop_cost(stop, ran.dwell_h, ran.grid_kwh))
        for stop, ran in zip(own.stops, done.replay.stops, strict=True)
    )
    on_grid = sum(
        stop_cost(stop, float(planned.dwell_h.sum()), float(planned.grid_kwh.sum()))
        for stop, planned in zip(own.stops, done.trajectory.stops, strict=True)
    )
    return replace(
        done,
        replay=replace(done.replay, stops=stops, cost=sum(s.cost for s in stops)),
        trajectory=replace(done.trajectory, cost=on_grid),
    )
