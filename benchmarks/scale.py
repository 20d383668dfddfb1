"""How do time and memory grow? Steps, cells, chargers, and the gap asked for.

    python -m benchmarks.scale [--sweeps steps cells chargers gap] [--time-limit 120] [--smoke]

Every point is planned in a fresh process, without and with an asked gap: time by part of the
work, peak memory, programs. A trip that ``plan`` refuses is a row that says so, and so is one
that the time limit stops. Rows are appended to ``benchmarks/results/scale.csv``; the same
command resumes. Exponents are fitted to the points that finished.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import exp, isfinite, log, nan, sqrt
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
    "shares",
    "spread",
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
TOLD_FROM_SCATTER = 2.0
"""Standard errors that a slope must differ from zero by to be shown."""


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


def _slope(x: list[float], y: list[float]) -> tuple[float, float]:
    """Return the slope of a straight line through points and its standard error."""
    if len(x) < LEAST_POINTS or not np.all(np.isfinite(x) & np.isfinite(y)):
        return nan, nan
    a, b = np.asarray(x) - np.mean(x), np.asarray(y) - np.mean(y)
    slope = float(a @ b / (a @ a))
    left = b - slope * a
    return slope, sqrt(float(left @ left) / (len(x) - 2) / float(a @ a))


def _log(values: list[float]) -> list[float]:
    return [log(value) if value > 0.0 else nan for value in values]


def spread(row: Row) -> tuple[float, float]:
    """Return the least and the largest time of the runs of a point [s].

    Examples
    --------
    >>> spread({"runs_s": "[0.4, 0.5, 0.3]"}), spread({"total_s": 2.0})
    ((0.3, 0.5), (2.0, 2.0))
    """
    runs = json.loads(row["runs_s"]) if row.get("runs_s") else [number(row, "total_s")]
    return min(runs), max(runs)


def shares(row: Row) -> dict[str, float]:
    """Return what share of the work every part is, and the rest; they add up to 1.

    Parts are medians over runs each, so it is their sum that they are shares of.

    Examples
    --------
    >>> found = shares({f"{part}_s": 1.0 for part in (*PARTS, "rest")})
    >>> round(sum(found.values()), 12), list(found)[-1]
    (1.0, 'rest')
    """
    spent = {name: max(number(row, f"{name}_s"), 0.0) for name in (*PARTS, "rest")}
    total = sum(spent.values())
    return {name: seconds / total for name, seconds in spent.items()}


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
    Each with its standard error, that of the factor being relative.

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
        time, memory = _slope(_log(x), _log(seconds)), _slope(_log(x), _log(added))
        factor = _slope(x, _log(seconds)) if sweep == "chargers" else (nan, nan)
        found.append(
            {
                "sweep": sweep,
                "asked_gap": float(gap) if gap else None,
                "points": len(done),
                "measured": len(own),
                "time_exponent": time[0],
                "time_error": time[1],
                "memory_exponent": memory[0],
                "memory_error": memory[1],
                "factor_per_charger": exp(factor[0]),
                "factor_error": factor[1],
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
        "| varied | value | gap asked for | ended | time s | of its runs, least to largest "
        "| peak memory MB | programs | cost | proved gap % |",
        "|---|---:|---:|---|---:|---|---:|---:|---:|---:|",
    ]
    for own in curves(rows).values():
        for row in own:
            if not number(row, "total_s") > 0.0:
                lines.append(
                    f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} "
                    f"| {row['ended']}: {row['message']} | | | | | | |"
                )
                continue
            gap, (least, largest) = number(row, "gap"), spread(row)
            ranged = f"{least:.2f} to {largest:.2f}" if largest > least else "-"
            lines.append(
                f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} | {row['ended']} "
                f"| {number(row, 'total_s'):.2f} | {ranged} | {number(row, 'memory_mb'):.0f} "
                f"| {number(row, 'programs'):.0f} | {number(row, 'cost'):.3f} "
                f"| {f'{100.0 * gap:.2f}' if isfinite(gap) else '-'} |"
            )
    return "\n".join(lines)


def fits_table(found: list[dict[str, Any]]) -> str:
    """Return the fits in Markdown; what is not told from scatter gets no figure.

    Examples
    --------
    >>> fit = {"sweep": "cells", "asked_gap": None, "points": 5, "measured": 5,
    ...     "time_exponent": 0.1, "time_error": 0.17, "memory_exponent": 0.63,
    ...     "memory_error": 0.04, "factor_per_charger": nan, "factor_error": nan}
    >>> print(fits_table([fit]).splitlines()[-1])
    | cells | none | 5 of 5 | scatter | 0.63 ± 0.04 | - |
    """

    def show(value: float, error: float) -> str:
        if not isfinite(value):
            return "-"
        told = abs(value) > TOLD_FROM_SCATTER * error
        return f"{value:.2f} ± {error:.2f}" if told else "scatter"

    lines = [
        "| varied | gap asked for | points | time ~ value^p, p | memory added ~ value^p, p "
        "| time per further charger |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for f in found:
        gap = "varied" if f["sweep"] == "gap" else "none"
        if f["asked_gap"] is not None:
            gap = f"{100.0 * f['asked_gap']:g} %"
        factor, error = f["factor_per_charger"], f["factor_error"]
        further = "-"
        if isfinite(factor):
            told = abs(log(factor)) > TOLD_FROM_SCATTER * error
            further = f"x {factor:.2f} ± {factor * error:.2f}" if told else "scatter"
        lines.append(
            f"| {f['sweep']} | {gap} | {f['points']} of {f['measured']} "
            f"| {show(f['time_exponent'], f['time_error'])} "
            f"| {show(f['memory_exponent'], f['memory_error'])} | {further} |"
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
            cells = " | ".join(f"{100.0 * share:.0f}" for share in shares(row).values())
            lines.append(
                f"| {row['sweep']} | {float(row['value']):g} | {_gap_words(row)} "
                f"| {number(row, 'total_s'):.2f} | {cells} |"
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
