"""How good are our plans? Our cost against the best local optimum of two nonlinear solvers.

    python -m benchmarks.optimality [--cases 27] [--resume] [--smoke]

27 cases of the trip ``paper-400km``: ambient temperature, size of the heat
pump, value of time. Per case our plan, and IPOPT and FATROP on the same
transcription for all subsets of chargers from up to 12 starts each. One row
per case and solver, written as it comes: the cost a solver claims, the cost
of its controls on the transcription with the tables (``relax.simulate``), and
on the continuous model (``relax.replay``).
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from math import exp, inf, isfinite, log, nan
from pathlib import Path
from time import perf_counter
from typing import Any

from tqdm import tqdm

from benchmarks.machine import make_single_threaded, processor, versions

make_single_threaded()

from benchmarks.cases import PAPER_CASES, load_paper, small  # noqa: E402
from benchmarks.judge import judge  # noqa: E402
from benchmarks.reference.peer import CAREFUL, SOLVERS  # noqa: E402
from benchmarks.reference.search import reference_best  # noqa: E402
from enumerate import plan  # noqa: E402
from relax.trip import Trip  # noqa: E402

__all__ = ["CASES", "main", "our_row", "reference_row", "summary"]

CASES = PAPER_CASES
"""Ambient temperature [degrees C], heat pump [kW], value of time [SEK/h]."""
RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
EQUAL = 1e-4
"""Relative difference of costs that counts as none."""
COLUMNS = (
    "ambient_c",
    "heat_pump_kw",
    "time_value_per_h",
    "solver",
    "subset",
    "claimed_cost",
    "cost",
    "replayed_cost",
    "feasible",
    "lower_bound",
    "solves",
    "failures",
    "build_s",
    "solve_s",
    "total_s",
    "processor",
    "versions",
)
"""Columns of the result file."""
Row = dict[str, Any]


def our_row(trip: Trip) -> Row:
    """Return our plan of a trip as a row."""
    begin = perf_counter()
    result = plan(trip)
    names = [c.name for c in trip.chargers]
    used = [] if result.plan is None else [names.index(s.charger) for s in result.plan.stops]
    counts = result.ledger.counts()
    return {
        "solver": "evrelax",
        "subset": " ".join(map(str, used)),
        "claimed_cost": result.transcribed_cost,
        "cost": result.transcribed_cost,
        "replayed_cost": result.cost,
        "feasible": result.is_feasible,
        "lower_bound": result.lower_bound,
        "solves": counts["planned"],
        "failures": counts["unproved"],
        "build_s": 0.0,
        "solve_s": result.timings_s["total"],
        "total_s": perf_counter() - begin,
    }


def reference_row(trip: Trip, solver: str, multi_start: bool = True) -> Row:
    """Return the best plan of a peer over all subsets and starts as a row."""
    begin = perf_counter()
    reference = reference_best(trip, solver, multi_start, settings=CAREFUL)
    total_s = perf_counter() - begin
    best = reference.best
    return {
        "solver": solver,
        "subset": " ".join(map(str, reference.best_subset)),
        "claimed_cost": inf if best is None else best.claimed_cost,
        "cost": inf if best is None else best.cost,
        "replayed_cost": (
            inf if best is None else judge(trip, reference.best_subset, best.controls).replayed_cost
        ),
        "feasible": best is not None,
        "lower_bound": -inf,
        "solves": len(reference.rows),
        "failures": sum(not row["feasible"] for row in reference.rows),
        "build_s": reference.build_s,
        "solve_s": reference.solve_s,
        "total_s": total_s,
    }


def _key(row: Row) -> tuple[float, float, float, str]:
    return (
        float(row["ambient_c"]),
        float(row["heat_pump_kw"]),
        float(row["time_value_per_h"]),
        str(row["solver"]),
    )


def _read(file: Path) -> list[Row]:
    with file.open(newline="", encoding="utf-8") as stream:
        return [dict(row) for row in csv.DictReader(stream)]


def _measure(
    cases: tuple[tuple[float, float, float], ...], done: set[Any], smoke: bool
) -> Iterator[Row]:
    """Yield the rows that are not done yet."""
    todo = [(c, s) for c in cases for s in ("evrelax", *SOLVERS) if (*c, s) not in done]
    where = {"processor": processor(), "versions": " ".join(f"{k}={v}" for k, v in
             versions().items())}  # fmt: skip
    for case, solver in tqdm(todo, file=sys.stderr, desc="optimality", disable=None):
        trip = load_paper(*case)
        if smoke:
            trip = small(trip)
        row = our_row(trip) if solver == "evrelax" else reference_row(trip, solver, not smoke)
        ambient, heat_pump, time_value = case
        yield {
            "ambient_c": ambient,
            "heat_pump_kw": heat_pump,
            "time_value_per_h": time_value,
            **row,
            **where,
        }


def _ratio(ours: float, best: float) -> float:
    """Return ours / best; best may be zero only if ours is."""
    if not (isfinite(ours) and isfinite(best)):
        return nan
    return 1.0 if ours == best else ours / best


def summary(rows: list[Row]) -> str:
    """Return a table of our cost against the best reference, case by case.

    Parameters
    ----------
    rows : list of dict
        As in the result file; strings or numbers.

    Examples
    --------
    >>> case = {"ambient_c": 0, "heat_pump_kw": 1, "time_value_per_h": 40, "subset": "1"}
    >>> cost = {"evrelax": 99.0, "ipopt": 100.0, "fatrop": 101.0}
    >>> text = summary([case | {"solver": s, "feasible": "True", "cost": c, "total_s": 1.0,
    ...     "replayed_cost": c, "lower_bound": 98.0} for s, c in cost.items()])
    >>> "0.99000" in text
    True
    """
    by_key = {_key(row): row for row in rows}
    cases = sorted({key[:3] for key in by_key})
    lines = [
        "ambient  pump  value |  evrelax      ipopt     fatrop | ours/best  replayed"
        " |  stops ours / best | proved gap"
    ]
    ratios: list[float] = []
    for case in cases:
        found = {s: by_key.get((*case, s)) for s in ("evrelax", *SOLVERS)}
        cost = {s: _cost(row, "cost") for s, row in found.items()}
        driven = {s: _cost(row, "replayed_cost") for s, row in found.items()}
        leader = min(SOLVERS, key=lambda s: cost[s])
        ratio = _ratio(cost["evrelax"], cost[leader])
        driven_ratio = _ratio(driven["evrelax"], driven[leader])
        ours, best = found["evrelax"], found[leader]
        bound = float(ours["lower_bound"]) if ours else nan
        gap = (driven["evrelax"] - bound) / driven["evrelax"] if driven["evrelax"] else 0.0
        stops = f"{ours['subset'] if ours else '-':>10} / {best['subset'] if best else '-':<5}"
        lines.append(
            f"{case[0]:7.0f} {case[1]:5.0f} {case[2]:6.0f} | "
            + " ".join(f"{cost[s]:10.4f}" for s in cost)
            + f" | {ratio:9.5f} {driven_ratio:9.5f} | {stops} | {100.0 * gap:6.2f} %"
        )
        if isfinite(ratio):
            ratios.append(ratio)
    if ratios:
        mean = exp(sum(map(log, ratios)) / len(ratios))
        lines.append(
            f"{len(ratios)} of {len(cases)} cases compared on the transcription: ours/best mean "
            f"{mean:.6f}, worst {max(ratios):.6f}, best {min(ratios):.6f}; within "
            f"{EQUAL:g} or better in {sum(r <= 1.0 + EQUAL for r in ratios)}"
        )
    for solver in ("evrelax", *SOLVERS):
        own = [row for row in rows if row["solver"] == solver]
        held = sum(str(row["feasible"]) == "True" for row in own)
        spent = sum(float(row["total_s"]) for row in own)
        lines.append(f"{solver}: {held} of {len(own)} feasible, {spent:.1f} s in all")
    return "\n".join(lines)


def _cost(row: Row | None, column: str) -> float:
    if row is None or str(row["feasible"]) != "True":
        return inf
    return float(row[column])


def main(arguments: list[str] | None = None) -> int:
    """Run the cases, write the file, print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.optimality", description=__doc__)
    parser.add_argument("--cases", type=int, default=len(CASES), help="how many of the cases")
    parser.add_argument("--resume", action="store_true", help="keep the rows already in the file")
    parser.add_argument("--smoke", action="store_true", help="one small case, one start")
    parser.add_argument("--file", type=Path, default=RESULTS / "optimality.csv")
    options = parser.parse_args(arguments)
    file = options.file
    if options.smoke and file == RESULTS / "optimality.csv":
        file = RESULTS / "optimality-smoke.csv"
    cases = CASES[4:5] if options.smoke else CASES[: options.cases]
    rows = _read(file) if options.resume and file.is_file() else []
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a" if rows else "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        if not rows:
            writer.writeheader()
        for row in _measure(cases, {_key(r) for r in rows}, options.smoke):
            writer.writerow(row)
            stream.flush()
            rows.append(row)
    print(summary(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
