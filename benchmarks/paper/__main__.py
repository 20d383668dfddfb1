"""Runs the experiments of the paper and writes tables and figures.

    python -m benchmarks.paper [--workers 2] [--only fronts|cases|sweep] [--few] [--fresh]

Results are kept one by one in ``benchmarks/results/paper.jsonl``; a second call does what is
missing. ``docs/paper.md`` and ``docs/figures/paper-*`` are written from what is there.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from time import perf_counter

from benchmarks.machine import THREAD_VARIABLES, processor, versions

for _name in THREAD_VARIABLES:  # one thread per process; libraries read it when imported
    os.environ.setdefault(_name, "1")

from benchmarks.paper import sweep, tables  # noqa: E402
from benchmarks.paper.cases import all_found  # noqa: E402
from benchmarks.paper.figures import (  # noqa: E402
    case_figure,
    front_figure,
    save,
    sweep_figure,
)
from benchmarks.paper.page import Made, page  # noqa: E402
from benchmarks.paper.run import KINDS, Rows, kept, run  # noqa: E402

__all__ = ["main", "write"]

RESULTS = Path(__file__).parents[1] / "results" / "paper.jsonl"
DOCS = Path(__file__).parents[2] / "docs"


def write(rows: Rows, docs: Path, wall_s: float | None, workers: int) -> None:
    """Write page and figures from the rows.

    Parameters
    ----------
    rows : Rows
        What there is.
    docs : Path
        Folder of the page; figures go into ``figures`` beneath it.
    wall_s : float or None
        Wall-clock time of the run, if it made all rows [s].
    workers : int
        Processes of the run.
    """
    cells = tables.cells(rows.fronts)
    cases = all_found(rows.fronts, rows.cases)
    points = sweep.points(rows.points)
    folder = docs / "figures"
    if rows.fronts:
        save(front_figure(rows.fronts), folder, "paper-front")
    for found in cases:
        save(case_figure(found), folder, f"paper-case-{found.case.name}")
    if points:
        save(sweep_figure(points), folder, "paper-sweep")
    made = Made(
        date=date.today().isoformat(),
        machine=processor(),
        versions=versions(),
        count=rows.count,
        seconds=rows.seconds,
        wall_s=wall_s,
        workers=workers,
    )
    (docs / "paper.md").write_text(page(cells, cases, points, made), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, write page and figures; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.paper",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--only", choices=KINDS, action="append", help="these experiments alone")
    parser.add_argument("--few", action="store_true", help="every sixth degree of the sweep")
    parser.add_argument("--fresh", action="store_true", help="forget the results kept so far")
    parser.add_argument("--file", type=Path, default=RESULTS)
    parser.add_argument("--docs", type=Path, default=DOCS)
    options = parser.parse_args(arguments)
    if options.fresh:
        options.file.unlink(missing_ok=True)
    options.file.parent.mkdir(parents=True, exist_ok=True)
    begin = perf_counter()
    done = run(options.file, options.only or KINDS, options.workers, options.few)
    wall = perf_counter() - begin
    rows = kept(options.file, options.few)
    whole = rows.missing == 0 and done.computed == rows.number
    write(rows, options.docs, wall if whole else None, options.workers)
    print(
        f"{options.docs / 'paper.md'}: {rows.count} certified values, {rows.missing} rows missing"
    )
    if done.interrupted:
        print(f"{done.interrupted}; call again to go on", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
