"""What does the bound of one choice of stops cost? Its time against the solver's and a plan's.

    python -m benchmarks.bounds [TRIP ...] [--rounds 9]

Prints a row per trip and number of stops: the time of ``relax_subset`` (box, rows, solve,
certificate) as a multiple of the solver's call in it; the call and the bound with all cones of
driving losses, against those of the lean program that proofs use; how long proofs of
infeasibility take, and how long a plan of a choice that has one. One thread; medians over
rounds, in which all choices take turns. Up to ``MOST`` choices per row, spread evenly.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations
from statistics import median
from time import perf_counter

from benchmarks.machine import make_single_threaded

if __name__ == "__main__":
    make_single_threaded()

from relax import InputError, load_trip, make_instance, refine
from relax.bound import ROOT_SETTINGS, relax_subset
from relax.certify import LowerBound, certify_lower_bound
from relax.instance import Instance
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.solve import solve_cone
from relax.starts import best_start

__all__ = ["MOST", "Times", "main", "measure"]

TRIPS = ("paper-400km", "goteborg-stockholm-winter")
MOST = 12
"""Choices per row."""
STOPS = (1, 2, 3)


@dataclass
class Times:
    """Times of one choice of stops, an entry per round.

    Parameters
    ----------
    infeasible : bool
        Proved to have no plan.
    bound_s, solve_s : list of float
        Of ``relax_subset``, and of the solver's call in it (0 without one) [s].
    plan_s : list of float
        Of relaxing and refining, where that gives a plan [s].
    cones_s : list of float
        Of the solver's call if no cone is left out [s].
    risen : float
        By how much, relatively, the bound is higher then.
    """

    infeasible: bool = False
    bound_s: list[float] = field(default_factory=list)
    solve_s: list[float] = field(default_factory=list)
    plan_s: list[float] = field(default_factory=list)
    cones_s: list[float] = field(default_factory=list)
    risen: float = 0.0

    @property
    def ratio(self) -> float:
        """Median over the rounds of the bound's time as a multiple of the solver's."""
        return median(b / s for b, s in zip(self.bound_s, self.solve_s, strict=True))

    @property
    def cones(self) -> float:
        """Median of the time of the solver's call with all cones as a multiple of that without."""
        return median(c / s for c, s in zip(self.cones_s, self.solve_s, strict=True))


def _once(instance: Instance, times: Times) -> None:
    """Bound a choice, with all cones too, and plan it if it may have a plan."""
    begin = perf_counter()
    relaxed = relax_subset(instance)
    bounded = perf_counter()
    times.infeasible = relaxed.infeasible
    times.bound_s.append(bounded - begin)
    times.solve_s.append(relaxed.solve_s)
    if relaxed.lower_bound is None:
        return
    if refine(instance, best_start(instance, relaxed.point, relaxed.lower_bound)).feasible:
        times.plan_s.append(perf_counter() - begin)
    program = build_relaxation(instance, make_box(instance))
    solution = solve_cone(program, ROOT_SETTINGS)
    bound = certify_lower_bound(program, solution.z)
    assert isinstance(bound, LowerBound)
    times.cones_s.append(solution.solve_s)
    times.risen = bound.value / relaxed.lower_bound - 1.0


def measure(instances: Iterable[Instance], rounds: int) -> list[Times]:
    """Bound and plan all instances in every round; return their times.

    Examples
    --------
    >>> trip = load_trip("paper-400km")
    >>> used, empty = measure([make_instance(trip, (1,)), make_instance(trip, ())], rounds=1)
    >>> used.ratio > 1.0, used.infeasible, empty.infeasible, len(used.plan_s), used.cones > 0.0
    (True, False, True, 1, True)
    """
    every = [(instance, Times()) for instance in instances]
    for k in range(rounds + 1):
        for instance, times in every:
            _once(instance, Times() if k == 0 else times)  # the first round warms up
    return [times for _, times in every]


def _ms(seconds: Iterable[float]) -> str:
    values = [1e3 * s for s in seconds]
    return f"{median(values):.1f} (to {max(values):.1f})" if values else "-"


def _row(name: str, stops: int, found: list[Times]) -> str:
    bounded = [t for t in found if not t.infeasible]
    gone = [t for t in found if t.infeasible]
    ratios = [t.ratio for t in bounded]
    said = f"{median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})" if ratios else "-"
    risen = [100.0 * t.risen for t in bounded]
    cells = (
        f"`{name}`", stops, len(bounded), _ms(median(t.bound_s) for t in bounded), said,
        f"{median(t.cones for t in bounded):.2f}" if bounded else "-",
        f"{median(risen):+.2f} % ({min(risen):+.2f} to {max(risen):+.2f})" if bounded else "-",
        len(gone), _ms(median(t.bound_s) for t in gone),
        _ms(median(t.plan_s) for t in bounded if t.plan_s),
    )  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def main(arguments: list[str] | None = None) -> int:
    """Measure every trip; print a row per number of stops."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trips", nargs="*", default=list(TRIPS), metavar="TRIP")
    parser.add_argument("--rounds", type=int, default=9)
    asked = parser.parse_args(arguments)
    if asked.rounds < 1:
        parser.error(f"--rounds: {asked.rounds}; allowed: 1 or more")
    try:
        trips = [load_trip(name) for name in asked.trips]
    except InputError as error:
        parser.error(str(error))
    print("| trip | stops | bounded | bound ms | times the solver's call | all cones: call "
          "| bound | infeasible | proof ms | plan ms |")  # fmt: skip
    print("|---|" + "---:|" * 9)
    for name, trip in zip(asked.trips, trips, strict=True):
        for stops in STOPS:
            subsets = list(combinations(range(len(trip.chargers)), stops))
            subsets = subsets[:: -(-len(subsets) // MOST)]
            instances = [make_instance(trip, subset) for subset in subsets]
            print(_row(name, stops, measure(instances, asked.rounds)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
