"""How long does a proof take? Plans with a gap asked for, in one process and with two workers.

    python -m benchmarks.proofs [--cases PATTERN ...] [--fresh] [--smoke]

Every case of ``paper/`` to 1 % and, within 10 s, to 0.1 %; the corridor in summer and winter
and the twenty chargers of ``long-1000km-winter`` to 1 %; and a start so empty that nothing can
be reached. Rows are appended to ``benchmarks/results/proofs.csv``; the same command resumes.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.machine import keep_to_cores, make_single_threaded, processor, versions

if __name__ == "__main__":
    make_single_threaded()  # before numpy is imported

from tqdm import tqdm

from benchmarks.cases import CASES, SMOKE, Case
from benchmarks.rows import RESULTS, Row, RowFile, number
from benchmarks.sources import code_digest
from benchmarks.words import counted
from enumerate import plan

__all__ = ["COLUMNS", "Task", "main", "measure", "summarise", "tasks"]

KEY = ("case", "asked_gap", "time_limit_s", "workers", "version")
COLUMNS = (
    *KEY, "chargers", "subsets", "status", "cost", "lower_bound", "gap", "programs", "prove_s",
    "total_s", "interrupted", "date", "processor", "versions",
)  # fmt: skip
"""Columns of the result file."""
FULL, FINE = 0.01, 0.001
"""Relative gaps asked for."""
FINE_LIMIT_S = 10.0
"""Time for the fine gap [s]."""
LIMIT_S = 180.0
"""Time for the others [s]."""
WORKERS = (1, 2)
"""Processes at work, each on a core of its own."""
EMPTY = "corridor/goteborg-stockholm-winter"
"""Case of which the infeasible one is made."""


@dataclass(frozen=True)
class Task:
    """One plan to be proved.

    Parameters
    ----------
    name : str
        What the row is called.
    case : Case
        The trip.
    gap : float
        Relative gap asked for.
    limit_s : float
        Time limit [s].
    start_soc : float or None
        Another state of charge at the start.
    workers : int
        Processes at work.
    """

    name: str
    case: Case
    gap: float
    limit_s: float
    start_soc: float | None = None
    workers: int = 1


def tasks(cases: tuple[Case, ...] = CASES) -> list[Task]:
    """Return what is measured of some cases.

    Examples
    --------
    >>> len(tasks()) == 2 * (27 + 27 + 3) + 1
    True
    """
    paper = [case for case in cases if case.group == "paper"]
    others = [case for case in cases if case.group == "corridor"]
    out = [Task(c.name, c, FULL, LIMIT_S, workers=n) for n in WORKERS for c in paper]
    out += [Task(c.name, c, FINE, FINE_LIMIT_S, workers=n) for n in WORKERS for c in paper]
    out += [Task(c.name, c, FULL, LIMIT_S, workers=n) for n in WORKERS for c in others]
    empty = [case for case in others if case.name == EMPTY]
    return out + [Task(f"{c.name}, start at 30 %", c, FULL, LIMIT_S, 0.3) for c in empty]


def measure(task: Task) -> Row:
    """Plan one trip with a gap asked for.

    Examples
    --------
    >>> row = measure(Task("smoke", SMOKE, 0.05, 60.0))
    >>> row["status"], row["gap"] <= 0.05
    ('optimal', True)
    """
    trip = task.case.load()
    if task.start_soc is not None:
        trip = replace(trip, start_soc=task.start_soc)
    begin = perf_counter()
    result = plan(trip, gap=task.gap, time_limit_s=task.limit_s, workers=task.workers)
    seconds = perf_counter() - begin
    return {
        "chargers": len(trip.chargers),
        "subsets": 2 ** len(trip.chargers),
        "status": result.status.name.lower(),
        "cost": result.cost,
        "lower_bound": result.lower_bound,
        "gap": result.gap,
        "programs": result.programs,
        "prove_s": result.timings_s.get("prove", 0.0),
        "total_s": seconds,
        "interrupted": result.interrupted,
    }


def summarise(rows: list[Row]) -> str:
    """Return the table of README.md from the rows of the result file.

    Examples
    --------
    >>> row = {"case": "paper/a", "asked_gap": "0.01", "gap": "0.01", "total_s": "2.0",
    ...        "programs": "40", "subsets": "8", "status": "optimal", "workers": "1"}
    >>> print(summarise([row, row | {"total_s": "1.2", "workers": "2"}]))
    | gap asked for | | reached | time | with 2 workers | programs |
    |---:|---|---:|---:|---:|---:|
    | 1 % | 1 variant of `paper-400km` | 1 of 1 | 2.0 s (2.0 to 2.0) | 1.2 s (1.2 to 1.2) | 40 (40 to 40) |
    | | - of these within 1 s, 5 s, 20 s | | 0, 1, 1 | 0, 1, 1 | |
    """  # noqa: E501
    alone = [row for row in rows if number(row, "workers") == 1]
    shared = [row for row in rows if number(row, "workers") == WORKERS[-1]]
    lines = [
        f"| gap asked for | | reached | time | with {WORKERS[-1]} workers | programs |",
        "|---:|---|---:|---:|---:|---:|",
    ]
    for gap, limits in ((FULL, (1.0, 5.0, 20.0)), (FINE, ())):
        group, other = (_variants(some, gap) for some in (alone, shared))
        if not group:
            continue
        programs = [number(row, "programs") for row in group]
        lines.append(
            f"| {100 * gap:g} % | {counted(len(group), 'variant')} of `paper-400km` | "
            f"{_reached(group, gap)} | {_times(group)} | {_times(other)} | "
            f"{median(programs):.0f} ({min(programs):.0f} to {max(programs):.0f}) |"
        )
        if limits:
            words = ", ".join(f"{limit:g} s" for limit in limits)
            lines.append(
                f"| | - of these within {words} | | {_within(group, gap, limits)} | "
                f"{_within(other, gap, limits)} | |"
            )
        else:
            lines.append(
                f"| | - of these within {FINE_LIMIT_S:g} s, and the others' gaps then | | "
                f"{_left(group, gap)} | {_left(other, gap)} | |"
            )
    for row in alone:
        if not row["case"].startswith("paper/"):
            gap, subsets = number(row, "gap"), int(number(row, "subsets"))
            reached = row["status"] if row["status"] == "infeasible" else f"{100 * gap:.2f} %"
            same = [r for r in shared if r["case"] == row["case"]]
            lines.append(
                f"| {100 * number(row, 'asked_gap'):g} % | {row['case'].split('/')[-1]}, "
                f"{subsets:,} choices | {reached} | {number(row, 'total_s'):.1f} s | "
                f"{_times(same, with_range=False)} | {number(row, 'programs'):.0f} |"
            )
    return "\n".join(lines)


def _variants(rows: list[Row], gap: float) -> list[Row]:
    return [r for r in rows if r["case"].startswith("paper/") and number(r, "asked_gap") == gap]


def _reached(rows: list[Row], gap: float) -> str:
    return f"{sum(_is_reached(row, gap) for row in rows)} of {len(rows)}"


def _left(rows: list[Row], gap: float) -> str:
    """Return how many rows reach the gap in their time, and the gaps of the others."""
    left = sorted(100 * number(row, "gap") for row in rows if not _is_reached(row, gap))
    words = f", {left[0]:.2f} to {left[-1]:.2f} %" if left else ""
    return f"{len(rows) - len(left)}{words}" if rows else ""


def _is_reached(row: Row, gap: float) -> bool:
    return number(row, "gap") <= gap * (1.0 + 1e-9)


def _times(rows: list[Row], *, with_range: bool = True) -> str:
    """Return the median time of some rows, with its range."""
    times = [number(row, "total_s") for row in rows]
    if not times:
        return ""
    middle = f"{median(times):.1f} s"
    return f"{middle} ({min(times):.1f} to {max(times):.1f})" if with_range else middle


def _within(rows: list[Row], gap: float, limits: tuple[float, ...]) -> str:
    """Return how many rows reach the gap within each time."""
    good = [number(row, "total_s") for row in rows if _is_reached(row, gap)]
    return ", ".join(str(sum(seconds <= limit for seconds in good)) for limit in limits)


def main(arguments: list[str] | None = None) -> int:
    """Measure what is missing, write the rows, print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.proofs", description=__doc__)
    parser.add_argument("--cases", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--fresh", action="store_true", help="forget the rows there are")
    parser.add_argument("--smoke", action="store_true", help="one small case, once, anew")
    options = parser.parse_args(arguments)
    from benchmarks.cases import select

    try:
        wanted = tasks(select(options.cases))
    except ValueError as error:
        parser.error(str(error))
    name, path = "proofs", Path(RESULTS)
    if options.smoke:
        wanted, name = [Task(SMOKE.name, SMOKE, 0.05, 60.0)], "proofs-smoke"
    file = RowFile(path / f"{name}.csv", COLUMNS, KEY, fresh=options.fresh or options.smoke)
    where = {
        "version": code_digest("enumerate.search", ("relax", "enumerate")),
        "date": date.today().isoformat(),
        "processor": processor(),
        "versions": " ".join(f"{k}={v}" for k, v in versions().items()),
    }
    try:
        for task in tqdm(wanted, file=sys.stderr, desc="proofs", disable=None):
            row: Row = where | {
                "case": task.name, "asked_gap": task.gap, "time_limit_s": task.limit_s,
                "workers": task.workers,
            }  # fmt: skip
            if not file.has(row):
                if not options.smoke:
                    keep_to_cores(task.workers)
                file.append(row | measure(task))
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    print(summarise(file.rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
