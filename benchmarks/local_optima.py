"""Is a plan the best local optimum? Against all choices of few stops from many starts each.

    python -m benchmarks.local_optima [--trip NAME] [--soc SOC ...] [--stops K]

Per state of charge at the start one row: the plan of ``plan`` without a gap, and the best of all
choices of at most ``K`` stops, each refined from eleven starts or more, both on the transcription.
Then one row per kind of start: how far above the best of its choice it ends, over the choices of
two stops and more.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import combinations
from math import inf

import numpy as np
from tqdm import tqdm

from benchmarks.machine import make_single_threaded

if __name__ == "__main__":
    make_single_threaded()

from enumerate import plan
from relax import load_trip
from relax.bound import relax_subset
from relax.errors import InputError
from relax.instance import Instance, make_drive, make_instance
from relax.plan import Controls
from relax.refinement import refine, refine_best
from relax.relaxed_point import RelaxedPoint
from relax.starts import (
    colder_start,
    even_start,
    further_starts,
    relaxed_start,
    split_starts,
    warmer_start,
)
from relax.trip import Trip

__all__ = ["Found", "best_of_starts", "main", "refined_costs"]

TRIP = "goteborg-stockholm-winter"
SOCS = (0.35, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9)
"""Where most of the best plans have one or two stops, and local optima differ."""
MAX_STOPS = 2
FREE = ("even", "warm 10 °C", "warm 20 °C", "warm 30 °C, 0.5 h", "warm 30 °C, 1 h")
"""The first of ``further_starts``, by what they do; then come equal stops, split."""
AHEAD = "relaxed or warm 20 °C, whichever is ahead"
"""Both starts as the search uses them."""
Costs = dict[str, float]
Found = dict[tuple[int, ...], Costs]
"""Costs by start, by subset."""


def refined_costs(instance: Instance, point: RelaxedPoint | None) -> Costs:
    """Return the cost of the plan that each start leads to; ``inf`` where none keeps the limits.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    point : RelaxedPoint or None
        Its relaxed optimum.
    """
    costs: Costs = {}

    def cost_from(name: str, start: Controls) -> Controls:
        done = refine(instance, start)
        costs[name] = done.trajectory.cost if done.feasible else inf
        return done.controls

    relaxed = even_start(instance) if point is None else relaxed_start(instance, point)
    controls = cost_from("relaxed", relaxed)
    both = refine_best(instance, [warmer_start(instance, even_start(instance)), relaxed])
    costs[AHEAD] = both.trajectory.cost if both.feasible else inf
    cost_from("relaxed, then warmer", warmer_start(instance, controls))
    cost_from("relaxed, then colder", colder_start(controls))
    for k, start in enumerate(split_starts(instance, controls)):
        cost_from(f"relaxed, then most at stop {k + 1}", start)
    for k, start in enumerate(further_starts(instance)):
        cost_from(FREE[k] if k < len(FREE) else f"even, most at stop {k - len(FREE) + 1}", start)
    return costs


def best_of_starts(trip: Trip, max_stops: int) -> Found:
    """Return the costs from every start of every choice that could be the best.

    Parameters
    ----------
    trip : Trip
        The trip.
    max_stops : int
        Choices of more stops are left out.
    """
    drive = make_drive(trip, trip.grid.step_km)
    found: Found = {}
    best = inf
    for count in range(1, max_stops + 1):
        subsets = list(combinations(range(len(trip.chargers)), count))
        for subset in tqdm(subsets, desc=f"{count} stops", file=sys.stderr, disable=None):
            instance = make_instance(trip, subset, trip.grid, drive)
            relaxed = relax_subset(instance)
            bound = -inf if relaxed.lower_bound is None else relaxed.lower_bound
            if relaxed.infeasible or bound >= best:
                continue
            found[subset] = refined_costs(instance, relaxed.point)
            best = min(best, *found[subset].values())
    return found


def _excesses(found: Sequence[Found]) -> Iterator[tuple[str, list[float]]]:
    """Yield kinds of starts and how far above the best of its choice each of them ended."""
    choices = [c for one in found for s, c in one.items() if len(s) > 1 and min(c.values()) < inf]
    for name in ("relaxed", AHEAD, "relaxed, then warmer", "relaxed, then colder", *FREE):
        yield name, [c[name] / min(c.values()) - 1.0 for c in choices]


def main(arguments: list[str] | None = None) -> int:
    """Compare a plan with the best of many starts for every start; print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else None)
    parser.add_argument("--trip", default=TRIP, metavar="NAME")
    parser.add_argument("--soc", nargs="+", type=float, default=list(SOCS), metavar="SOC")
    parser.add_argument("--stops", type=int, default=MAX_STOPS, metavar="K")
    asked = parser.parse_args(arguments)
    if asked.stops < 1:
        parser.error(f"--stops: {asked.stops}; allowed: 1 or more")
    try:
        trips = [load_trip(asked.trip, overrides={"start.soc": soc}) for soc in asked.soc]
    except InputError as error:
        parser.error(str(error))
    print("| start | plan | best of many starts | above it |")
    print("|---:|---:|---:|---:|")
    everything: list[Found] = []
    for soc, trip in zip(asked.soc, trips, strict=True):
        result, found = plan(trip), best_of_starts(trip, asked.stops)
        everything.append(found)
        cost = result.transcribed_cost
        stops = () if result.instance is None else result.instance.subset
        best, subset = min(((min(c.values()), s) for s, c in found.items()), default=(inf, ()))
        above = f"{100.0 * (cost / best - 1.0):.2f} %" if max(cost, best) < inf else "-"
        print(
            f"| {100.0 * soc:.0f} % | {_named(cost, stops)} | {_named(best, subset)} | {above} |",
            flush=True,
        )
    print("\n| start of a refinement | no plan | mean above the best | worst |")
    print("|---|---:|---:|---:|")
    for name, excess in _excesses(everything):
        held = [100.0 * e for e in excess if e < inf]
        if held:
            missed = f"{len(excess) - len(held)} of {len(excess)}"
            print(f"| {name} | {missed} | {np.mean(held):.2f} % | {max(held):.1f} % |")
    return 0


def _named(cost: float, subset: tuple[int, ...]) -> str:
    """Return a cost with the numbers of its chargers."""
    return f"{cost:.2f} ({'+'.join(map(str, subset))})" if cost < inf else "no plan"


if __name__ == "__main__":
    sys.exit(main())
