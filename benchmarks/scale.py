"""How do time and memory grow? Steps, cells, chargers, and the gap asked for.

    python -m benchmarks.scale [--sweeps steps cells chargers gap] [--time-limit 120] [--smoke]

Every point is planned in a fresh process, without and with an asked gap: time by part of the
work, peak memory, programs. A trip that ``plan`` refuses is a row that says so, and so is one
that the time limit stops. Rows are appended to ``benchmarks/results/scale.csv``; the same
command resumes. Exponents are fitted to the points that finished.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import exp, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.cases import digest, load_paper
from benchmarks.contestants import OURS, find
from benchmarks.floor import run_task, where
from benchmarks.measured import MEASURED, PlanTask
from benchmarks.probe import PARTS
from benchmarks.rows import RESULTS, Row, RowFile, number
from benchmarks.runs import ASKED_GAP
from benchmarks.worker import Worker
from relax.trip import Grid, Trip

__all__ = [
    "COLUMNS",
    "SWEEPS",
    "curves",
    "fits",
    "fits_table",
    "main",
    "make_trip",
    "parts_table",
    "scale",
    "table",
]

SWEEPS: dict[str, tuple[float, ...]] = {
    "steps": (100, 200, 400, 700, 1000),
    "cells": (6, 12, 24, 48, 96),
    "chargers": (3, 6, 8, 10, 12, 14, 16, 20, 24),
    "gap": (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001),
}
"""Values of what is varied; all else is ``BASE``."""
SMOKE_SWEEPS: dict[str, tuple[float, ...]] = {"chargers": (1, 40)}
"""One small point, and one that may be refused."""
BASE = (0.0, 1.0, 40.0)
"""Ambient temperature [degrees C], heat pump [kW] and value of time [SEK/h] of the trip."""
KEY = ("sweep", "value", "asked_gap", "trip_digest", "version", "time_limit_s")
COLUMNS = (*KEY, *MEASURED, "date", "processor", "versions")
"""Columns of the result file."""
LEAST_POINTS = 3
"""Points that a fit needs."""


def make_trip(sweep: str, value: float) -> Trip:
    """Return the trip of a point; chargers are spread evenly over the road.

    Examples
    --------
    >>> make_trip("steps", 200).grid.step_km, [c.position_km for c in make_trip(
    ...     "chargers", 3).chargers]
    (2.0, [100.0, 200.0, 300.0])
    """
    trip = load_paper(*BASE)
    length = trip.route.length_km
    if sweep == "steps":
        return replace(trip, grid=Grid(length / value, trip.grid.cells))
    if sweep == "cells":
        return replace(trip, grid=Grid(trip.grid.step_km, int(value)))
    if sweep == "chargers":
        places = length * np.arange(1, int(value) + 1) / (int(value) + 1)
        chargers = tuple(
            replace(trip.chargers[0], name=f"km {km:.1f}", position_km=float(km)) for km in places
        )
        return replace(trip, chargers=chargers)
    return trip


def _points(sweeps: dict[str, tuple[float, ...]]) -> Iterator[tuple[str, float, float | None]]:
    for sweep, values in sweeps.items():
        for value in values:
            gaps = (value,) if sweep == "gap" else (None, ASKED_GAP)
            yield from ((sweep, value, gap) for gap in gaps)


def scale(
    sweeps: dict[str, tuple[float, ...]],
    file: RowFile,
    time_limit_s: float,
    grid: Grid | None = None,
) -> None:
    """Measure the points that the file does not hold yet, each in a process of its own.

    Parameters
    ----------
    sweeps : dict of str to tuple of float
        Values by sweep.
    file : RowFile
        Where rows go.
    time_limit_s : float
        Of one plan [s].
    grid : Grid, optional
        Instead of the trip's, in sweeps that do not vary it.
    """
    version = find([OURS])[0].version
    todo: list[tuple[Row, PlanTask]] = []
    for sweep, value, gap in _points(sweeps):
        trip = make_trip(sweep, value)
        if grid is not None and sweep in ("chargers", "gap"):
            trip = replace(trip, grid=grid)
        key = {
            "sweep": sweep,
            "value": value,
            "asked_gap": "" if gap is None else gap,
            "trip_digest": digest(trip),
            "version": version,
            "time_limit_s": time_limit_s,
        }
        if not file.has(key):
            todo.append((key, PlanTask(trip, gap, time_limit_s)))
    for key, task in tqdm(todo, file=sys.stderr, desc="scale", disable=None):
        with Worker() as worker:
            file.append(key | where() | run_task(worker, task))


def _slope(x: list[float], y: list[float]) -> float:
    if len(x) < LEAST_POINTS or min(y) <= 0.0:
        return nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def curves(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return the rows by sweep and asked gap, ordered by value; of equals the last."""
    last: dict[tuple[str, str, float], Row] = {}
    for row in rows:
        gap = "" if row["sweep"] == "gap" else str(row["asked_gap"])
        last[row["sweep"], gap, float(row["value"])] = row
    found: dict[tuple[str, str], list[Row]] = {}
    for sweep, gap, value in sorted(last):
        found.setdefault((sweep, gap), []).append(last[sweep, gap, value])
    return found


def fits(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Return the exponents p of time and memory ~ value^p, by sweep and asked gap.

    For chargers also the factor per charger, of time ~ factor^N. Only points that finished count.

    Examples
    --------
    >>> rows = [{"sweep": "steps", "value": v, "asked_gap": "", "ended": "done",
    ...     "total_s": 0.01 * v, "memory_mb": 90 + v, "memory_before_mb": 90} for v in (1, 2, 4)]
    >>> [round(fits(rows)[0][name], 6) for name in ("time_exponent", "memory_exponent")]
    [1.0, 1.0]
    """
    found = []
    for (sweep, gap), own in curves(rows).items():
        done = [row for row in own if row["ended"] == "done"]
        x = [float(row["value"]) for row in done]
        seconds = [number(row, "total_s") for row in done]
        added = [number(row, "memory_mb") - number(row, "memory_before_mb") for row in done]
        factor = nan
        if sweep == "chargers" and len(x) >= LEAST_POINTS:
            factor = exp(float(np.polyfit(x, np.log(seconds), 1)[0]))
        found.append(
            {
                "sweep": sweep,
                "asked_gap": float(gap) if gap else None,
                "points": len(done),
                "time_exponent": _slope(x, seconds),
                "memory_exponent": _slope(x, added),
                "factor_per_charger": factor,
                "ended_otherwise": {
                    f"{float(row['value']):g}": f"{row['ended']}: {row['message']}"
                    for row in own
                    if row["ended"] != "done"
                },
            }
        )
    return found


def _gap_words(row: Row) -> str:
    gap = number(row, "asked_gap")
    return f"{100.0 * gap:g} %" if gap > 0.0 else "none"


def table(rows: Iterable[Row]) -> str:
    """Return the points in Markdown."""
    lines = [
        "| varied | value | gap asked for | ended | time s | peak memory MB | programs "
        "| cost | proved gap % |",
        "|---|---:|---:|---|---:|---:|---:|---:|---:|",
    ]
    for own in curves(rows).values():
        for row in own:
            if not number(row, "total_s") > 0.0:
                lines.append(
                    f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} "
                    f"| {row['ended']}: {row['message']} | | | | | |"
                )
                continue
            gap = number(row, "gap")
            lines.append(
                f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} | {row['ended']} "
                f"| {number(row, 'total_s'):.2f} | {number(row, 'memory_mb'):.0f} "
                f"| {number(row, 'programs'):.0f} | {number(row, 'cost'):.3f} "
                f"| {f'{100.0 * gap:.2f}' if isfinite(gap) else '-'} |"
            )
    return "\n".join(lines)


def fits_table(found: list[dict[str, Any]]) -> str:
    """Return the fits in Markdown."""

    def show(value: float) -> str:
        return f"{value:.2f}" if isfinite(value) else "-"

    lines = [
        "| varied | gap asked for | points | time ~ value^p, p | memory added ~ value^p, p "
        "| time per further charger |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for f in found:
        gap = "varied" if f["sweep"] == "gap" else "none"
        if f["asked_gap"] is not None:
            gap = f"{100.0 * f['asked_gap']:g} %"
        factor = f["factor_per_charger"]
        lines.append(
            f"| {f['sweep']} | {gap} | {f['points']} | {show(f['time_exponent'])} "
            f"| {show(f['memory_exponent'])} | {f'x {show(factor)}' if isfinite(factor) else '-'} |"
        )
    return "\n".join(lines)


def parts_table(rows: Iterable[Row]) -> str:
    """Return where the time goes, in Markdown: shares by part of the least and largest point."""
    names = [*PARTS, "rest"]
    lines = [
        "| varied | value | gap asked for | time s | " + " | ".join(f"{n} %" for n in names) + " |",
        "|---|---:|---|---:|" + "---:|" * len(names),
    ]
    for own in curves(rows).values():
        done = [row for row in own if number(row, "total_s") > 0.0]
        for row in done if len(done) <= 2 else (done[0], done[-1]):
            total = number(row, "total_s")
            shares = " | ".join(f"{100.0 * number(row, f'{n}_s') / total:.0f}" for n in names)
            lines.append(
                f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} | {total:.2f} "
                f"| {shares} |"
            )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure, write the file, print points and fits; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.scale", description=__doc__)
    parser.add_argument("--sweeps", nargs="*", default=list(SWEEPS), choices=list(SWEEPS))
    parser.add_argument("--time-limit", type=float, default=120.0, help="of one plan [s]")
    parser.add_argument("--file", type=Path, default=RESULTS / "scale.csv")
    parser.add_argument("--smoke", action="store_true", help="a few small points, anew")
    options = parser.parse_args(arguments)
    path = options.file
    sweeps = {name: SWEEPS[name] for name in options.sweeps}
    if options.smoke:
        sweeps = SMOKE_SWEEPS
        if path == RESULTS / "scale.csv":
            path = RESULTS / "scale-smoke.csv"
    file = RowFile(path, COLUMNS, KEY, fresh=options.smoke)
    try:
        grid = Grid(20.0, 4) if options.smoke else None
        scale(sweeps, file, 10.0 if options.smoke else options.time_limit, grid)
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    print(f"{table(file.rows)}\n\n{fits_table(fits(file.rows))}\n\n{parts_table(file.rows)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
