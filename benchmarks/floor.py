"""How far are we from the least possible? Our time against the solver's own.

    python -m benchmarks.floor [--cases PATTERN ...] [--time-limit 120] [--smoke]

The part that cannot be avoided with the programs we solve is what Clarabel itself reports
for them, its setup included. Per case ``plan`` without and with an asked gap: total time, that
part, the number of programs, and where the rest goes. Rows are appended to
``benchmarks/results/floor.csv``; the same command resumes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from datetime import date
from math import exp, log, nan
from pathlib import Path
from statistics import mean
from typing import Any

from tqdm import tqdm

from benchmarks.cases import SMOKE, Case, digest, select
from benchmarks.contestants import OURS, find
from benchmarks.machine import processor, versions
from benchmarks.measured import MEASURED, PlanTask
from benchmarks.rows import RESULTS, Row, RowFile, number
from benchmarks.runs import ASKED_GAP
from benchmarks.worker import Worker, WorkerError

__all__ = ["COLUMNS", "floor", "main", "run_task", "summarise", "table", "where"]

KEY = ("case", "trip_digest", "asked_gap", "version", "time_limit_s")
COLUMNS = (*KEY, *MEASURED, "date", "processor", "versions")
"""Columns of the result file."""


def where() -> Row:
    """Return what every row says of date and machine."""
    return {
        "date": date.today().isoformat(),
        "processor": processor(),
        "versions": " ".join(f"{k}={v}" for k, v in versions().items()),
    }


def run_task(worker: Worker, task: PlanTask) -> Row:
    """Measure a plan in the worker; one that is killed or fails gives a row that says so."""
    try:
        row: Row = worker.run(
            "benchmarks.measured", "measure_plan", (task,), 4.0 * task.time_limit_s + 60.0
        )
    except WorkerError as error:
        return {"ended": "stopped", "message": str(error)}
    return row


def floor(cases: Iterable[Case], file: RowFile, time_limit_s: float) -> None:
    """Measure what the file does not hold yet."""
    version = find([OURS])[0].version
    todo: list[tuple[Row, PlanTask]] = []
    for case in cases:
        trip = case.load()
        for gap in (None, ASKED_GAP):
            key = {
                "case": case.name,
                "trip_digest": digest(trip),
                "asked_gap": "" if gap is None else gap,
                "version": version,
                "time_limit_s": time_limit_s,
            }
            if not file.has(key):
                todo.append((key, PlanTask(trip, gap, time_limit_s)))
    with Worker() as worker:
        for key, task in tqdm(todo, file=sys.stderr, desc="floor", disable=None):
            file.append(key | where() | run_task(worker, task))


def summarise(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return per asked gap: programs, times, and how many times the solver's own we take.

    Examples
    --------
    >>> row = {"case": "a", "asked_gap": "", "ended": "done", "total_s": 3.0, "clarabel_s": 1.0,
    ...     "programs": 9, "solve_s": 1.2}
    >>> round(summarise([row])[0]["times_floor"], 9)
    3.0
    """
    last = {(row["case"], str(row["asked_gap"])): row for row in rows}
    found = []
    for gap in sorted({gap for _, gap in last}):
        own = [r for (_, g), r in last.items() if g == gap and r["ended"] == "done"]
        own = [r for r in own if number(r, "clarabel_s") > 0.0]
        ratios = [number(r, "total_s") / number(r, "clarabel_s") for r in own]
        found.append(
            {
                "asked_gap": float(gap) if gap else None,
                "cases": len(own),
                "not_done": sum(g == gap for _, g in last) - len(own),
                "programs": sum(number(r, "programs") for r in own),
                "clarabel_s": sum(number(r, "clarabel_s") for r in own),
                "calls_s": sum(number(r, "solve_s") for r in own),
                "total_s": sum(number(r, "total_s") for r in own),
                "times_floor": exp(mean(map(log, ratios))) if ratios else nan,
                "least": min(ratios, default=nan),
                "largest": max(ratios, default=nan),
            }
        )
    return found


def table(found: list[dict[str, Any]]) -> str:
    """Return the summary in Markdown."""
    lines = [
        "| gap asked for | cases | programs | Clarabel's own s | in its calls s | all s "
        "| all / own, geometric mean | least | largest |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for f in found:
        gap = "none" if f["asked_gap"] is None else f"{100.0 * f['asked_gap']:g} %"
        cases = str(f["cases"]) + (f" (and {f['not_done']} not done)" if f["not_done"] else "")
        lines.append(
            f"| {gap} | {cases} | {f['programs']:.0f} | {f['clarabel_s']:.2f} "
            f"| {f['calls_s']:.2f} | {f['total_s']:.2f} | {f['times_floor']:.2f} "
            f"| {f['least']:.2f} | {f['largest']:.2f} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the file, print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.floor", description=__doc__)
    parser.add_argument("--cases", nargs="*", default=["paper/*"], metavar="PATTERN")
    parser.add_argument("--time-limit", type=float, default=120.0, help="of one plan [s]")
    parser.add_argument("--file", type=Path, default=RESULTS / "floor.csv")
    parser.add_argument("--smoke", action="store_true", help="one small case, anew")
    options = parser.parse_args(arguments)
    try:
        cases: tuple[Case, ...] = (SMOKE,) if options.smoke else select(options.cases)
    except ValueError as error:
        parser.error(str(error))
    path = options.file
    if options.smoke and path == RESULTS / "floor.csv":
        path = RESULTS / "floor-smoke.csv"
    file = RowFile(path, COLUMNS, KEY, fresh=options.smoke)
    try:
        floor(cases, file, options.time_limit)
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    print(table(summarise(file.rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
