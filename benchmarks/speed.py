"""How fast are we? One complete plan against two nonlinear solvers that enumerate subsets.

    python -m benchmarks.speed [--repeats 7] [--smoke]

Each repeat runs, one after the other on one core and one thread: our whole
``plan`` (bounds, refinement, replay; from a loaded trip), FATROP and IPOPT on
every subset from a single start (build the program, solve, correct and judge
the plan). Interleaving lets a slow moment of the machine hit all alike. Times
are medians over the repeats. "Times our plan" is the median over the repeats of
the ratio within one repeat, not the quotient of two medians, which may differ.
The peers' building is stated apart, for a program can be kept.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from tqdm import tqdm

from benchmarks.machine import make_single_threaded, processor, versions

make_single_threaded()

from benchmarks.cases import small  # noqa: E402
from benchmarks.reference.peer import SOLVERS  # noqa: E402
from benchmarks.reference.search import reference_best  # noqa: E402
from enumerate import plan  # noqa: E402
from relax import load_trip  # noqa: E402
from relax.trip import Trip  # noqa: E402

__all__ = ["main", "measure", "table"]

RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
RATIOS = (
    "times our plan: median over the rounds of the ratio within a round, not the quotient of the"
    " medians"
)
"""What the last column of the table is."""
Repeat = dict[str, dict[str, float]]


def _ours(trip: Trip) -> dict[str, float]:
    begin = perf_counter()
    result = plan(trip)
    return {
        "total_s": perf_counter() - begin,
        "cost": result.transcribed_cost,
        **{f"{name}_s": spent for name, spent in result.timings_s.items() if name != "total"},
    }


def _peer(trip: Trip, solver: str) -> dict[str, float]:
    begin = perf_counter()
    reference = reference_best(trip, solver, multi_start=False)
    solved = [row for row in reference.rows if row["feasible"]]
    return {
        "total_s": perf_counter() - begin,
        "cost": reference.best.cost if reference.best else float("inf"),
        "build_s": reference.build_s,
        "solve_s": reference.solve_s,
        "solve_feasible_s": sum(row["solve_s"] for row in solved),
        "evaluation_s": sum(row["evaluation_s"] for row in reference.rows),
        "judge_s": reference.judge_s,
        "solves": float(len(reference.rows)),
        "solved": float(len(solved)),
    }


def measure(trip: Trip, repeats: int) -> list[Repeat]:
    """Return interleaved measurements after one round that does not count.

    Parameters
    ----------
    trip : Trip
        The trip.
    repeats : int
        Measured rounds.

    Returns
    -------
    list of dict
        Per round and solver: times [s] and the cost on the transcription.
    """
    rounds: list[Repeat] = []
    for _ in tqdm(range(repeats + 1), file=sys.stderr, desc="speed", disable=None):
        rounds.append({"evrelax": _ours(trip), **{s: _peer(trip, s) for s in SOLVERS}})
    return rounds[1:]


def _median(rounds: list[Repeat], solver: str, name: str) -> float:
    return median(r[solver][name] for r in rounds)


def _ratio(rounds: list[Repeat], solver: str, name: str) -> float:
    """Return how many times longer than our whole plan a part of a peer takes.

    The median of the ratios within a round: both were measured under the same load there.
    """
    return median(r[solver][name] / r["evrelax"]["total_s"] for r in rounds)


def table(rounds: list[Repeat]) -> str:
    """Return medians, and medians of the ratios within a round, as text.

    Parameters
    ----------
    rounds : list of dict
        From ``measure``.

    Examples
    --------
    >>> peer = {"total_s": 2.0, "build_s": 1.0, "solve_s": 0.8, "solve_feasible_s": 0.5,
    ...     "judge_s": 0.2, "cost": 100.0, "solves": 7.0, "solved": 6.0, "evaluation_s": 0.3}
    >>> round_ = {"evrelax": {"total_s": 0.5, "cost": 99.0}, "ipopt": peer, "fatrop": peer}
    >>> slow = {"evrelax": {"total_s": 2.0, "cost": 99.0}, "ipopt": peer, "fatrop": peer}
    >>> print(table([round_, round_, slow]))
    evrelax: complete plan 500 ms, cost 99.0000
    ...
      everything               2000  4.00
    ...
    times our plan: median over the rounds of the ratio within a round, not the quotient ...
    """
    ours = _median(rounds, "evrelax", "total_s")
    lines = [
        f"evrelax: complete plan {1e3 * ours:.0f} ms, cost {_median(rounds, 'evrelax', 'cost'):.4f}"
    ]
    for name in rounds[0]["evrelax"]:
        if name not in ("total_s", "cost"):
            lines.append(f"    {name[:-2]:<10}{1e3 * _median(rounds, 'evrelax', name):8.0f} ms")
    lines.append(f"{'':22}{'ms':>9}  times our plan (above 1: we are faster)")
    parts = {
        "total_s": "everything",
        "build_s": "  build programs",
        "solve_s": "  solve",
        "solve_feasible_s": "  solve, feasible",
        "judge_s": "  correct and judge",
    }
    for solver in SOLVERS:
        cost, found = _median(rounds, solver, "cost"), rounds[0][solver]
        lines.append(
            f"{solver}: cost {cost:.4f}, {found['solved']:.0f} of {found['solves']:.0f} solved"
        )
        for name, words in parts.items():
            spent = 1e3 * _median(rounds, solver, name)
            lines.append(f"  {words:<20}{spent:9.0f}  {_ratio(rounds, solver, name):.2f}")
    lines.append(RATIOS)
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the file, print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.speed", description=__doc__)
    parser.add_argument("--repeats", type=int, default=7, help="measured rounds")
    parser.add_argument("--smoke", action="store_true", help="one small round")
    parser.add_argument("--file", type=Path, default=None)
    options = parser.parse_args(arguments)
    trip = load_trip("paper-400km")
    repeats = options.repeats
    if repeats < 1:
        parser.error("--repeats must be at least 1")
    if options.smoke:
        trip, repeats = small(trip), 1
    rounds = measure(trip, repeats)
    file = options.file or RESULTS / ("speed-smoke.json" if options.smoke else "speed.json")
    file.parent.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {
        "trip": trip.name,
        "chargers": len(trip.chargers),
        "processor": processor(),
        "versions": versions(),
        "median": {
            solver: {name: _median(rounds, solver, name) for name in rounds[0][solver]}
            for solver in rounds[0]
        },
        "rounds": rounds,
    }
    file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(table(rounds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
