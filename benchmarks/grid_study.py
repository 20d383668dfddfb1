"""How far is the transcription from the drive? Steps and cells against the continuous model.

    python -m benchmarks.grid_study [--smoke]

One fixed choice of stops per trip, planned on nine grids (steps of 4, 2, 1 km;
6, 12, 24 cells per stop), each plan driven on the continuous model. Writes
``benchmarks/results/grid_study.csv`` and the page ``docs/grid-study.md``. The
page's judgement of the three limits is computed from the rows, not written by hand.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from benchmarks.machine import processor, versions
from relax import execute, load_trip, make_instance, refine, replay
from relax.bound import relax_subset
from relax.driven import Replay
from relax.instance import Instance
from relax.plan import Trajectory
from relax.starts import best_start
from relax.trip import Grid, Trip

__all__ = ["CASES", "Case", "main", "measure", "page"]

Array = npt.NDArray[np.float64]
Row = dict[str, Any]

COMMAND = "python -m benchmarks.grid_study"
HERE = Path(__file__).parent
STEPS_KM = (4.0, 2.0, 1.0)
CELLS = (6, 12, 24)
SCAN_CELLS = (8, 10, 14, 16, 18, 20, 30, 36, 48)
"""Further cells at the default step, for the car whose charge curve has steep drops."""
LIMITS = {"cost_percent": 0.2, "final_soc_points": 0.1, "temperature_k": 0.5}
"""What the deviations are to stay within: % of the cost, percentage points, K."""
COLUMNS = (
    "case",
    "stop",
    "step_km",
    "cells",
    "transcribed_cost",
    "replayed_cost",
    "cost_percent",
    "final_soc_points",
    "node_soc_points",
    "node_temperature_k",
    "temperature_k",
    "moved_targets_points",
    "seconds",
    "processor",
    "versions",
)
"""Columns of the result file."""


@dataclass(frozen=True)
class Case:
    """A trip and the stops it is studied with.

    Parameters
    ----------
    label : str
        For the table.
    trip : str
        Name of a shipped trip.
    overrides : tuple of (str, float)
        Values replaced in it.
    stops : tuple of str
        Chargers used: those of the best plan that ``evrelax plan`` finds.
    """

    label: str
    trip: str
    overrides: tuple[tuple[str, float], ...]
    stops: tuple[str, ...]

    def load(self) -> tuple[Trip, tuple[int, ...]]:
        """Return the trip and the indices of the chargers used.

        Examples
        --------
        >>> trip, subset = CASES[0].load()
        >>> trip.name, subset
        ('paper-400km', (1,))
        """
        trip = load_trip(self.trip, dict(self.overrides))
        names = [c.name for c in trip.chargers]
        return trip, tuple(names.index(s) for s in self.stops)


CASES = (
    Case("paper-400km, -10 C", "paper-400km", (), ("km 200",)),
    Case("paper-400km, 0 C", "paper-400km", (("route.ambient_c", 0.0),), ("km 300",)),
    Case("paper-400km, 10 C", "paper-400km", (("route.ambient_c", 10.0),), ("km 300",)),
    Case("paper-400km, -10 C, 200 m samples", "paper-400km", (("route.sample_km", 0.2),),
         ("km 200",)),
    Case("goteborg-stockholm-winter", "goteborg-stockholm-winter", (), ("Mantorp",)),
)  # fmt: skip


def _temperature_anywhere_k(
    trip: Trip, instance: Instance, plan: Trajectory, driven: Replay
) -> float:
    """Return the largest temperature difference at nodes, samples and cell borders [K].

    Within a step the transcription's temperature is taken as linear in time.
    """
    nodes, route = instance.drive.node_km, trip.route
    km = driven.position_km
    clock = np.interp(km, route.node_km, np.concatenate([[0.0], np.cumsum(route.duration_h)]))
    node_clock = np.interp(nodes, km, clock)
    k = np.maximum(np.searchsorted(nodes, km, "left") - 1, 0)  # the step that ends at, or holds, km
    share = (clock - node_clock[k]) / np.diff(node_clock)[k]
    start, end = plan.temperature_start_c[k], plan.temperature_c[k + 1]
    apart = [np.abs(start + share * (end - start) - driven.temperature_c)[km > 0.0].max()]
    for planned, ran in zip(plan.stops, driven.stops, strict=True):
        apart.append(np.abs(planned.temperature_c - ran.temperature_c).max())
    return float(max(apart))


def measure(case: Case, grid: Grid) -> Row:
    """Plan a case on a grid, drive it, and return how far the two are apart.

    Parameters
    ----------
    case : Case
        Trip and stops.
    grid : Grid
        Steps and cells.

    Raises
    ------
    RuntimeError
        No plan of these stops holds on the continuous model.

    Examples
    --------
    >>> row = measure(CASES[2], Grid(step_km=20.0, cells=4))
    >>> abs(row["cost_percent"]) < 2.0, row["temperature_k"] < 2.0
    (True, True)
    """
    begin = perf_counter()
    trip, subset = case.load()
    instance = make_instance(trip, subset, grid)
    relaxed = relax_subset(instance)
    start = best_start(instance, relaxed.point, relaxed.lower_bound or 0.0)
    done = execute(trip, instance, refine(instance, start))
    if done.reason or done.replay is None:
        raise RuntimeError(f"{case.label}, {grid}: {done.reason}")
    seconds = perf_counter() - begin
    plan, driven, pack = done.trajectory, done.replay, trip.vehicle.pack
    planned_targets = tuple(float(s.energy_kwh[-1]) for s in plan.stops)
    unmoved = replay(trip, instance, done.controls, planned_targets)

    def soc_points(planned_kwh: Array, driven_kwh: Array) -> float:
        return 100.0 * float(np.abs(pack.soc(planned_kwh) - pack.soc(driven_kwh)).max())

    return {
        "case": case.label,
        "stop": " + ".join(case.stops),
        "step_km": grid.step_km,
        "cells": grid.cells,
        "transcribed_cost": plan.cost,
        "replayed_cost": driven.cost,
        "cost_percent": 100.0 * (driven.cost / plan.cost - 1.0),
        "final_soc_points": soc_points(
            plan.energy_kwh[-1:], np.array([unmoved.final_energy_kwh])
        ),
        "node_soc_points": soc_points(plan.energy_kwh, driven.node_energy_kwh),
        "node_temperature_k": float(np.abs(plan.temperature_c - driven.node_temperature_c).max()),
        "temperature_k": _temperature_anywhere_k(trip, instance, plan, driven),
        "moved_targets_points": soc_points(np.array(planned_targets), np.array(done.targets_kwh)),
        "seconds": seconds,
    }  # fmt: skip


def _rows(todo: Sequence[tuple[Case, Grid]]) -> Iterator[Row]:
    where = {
        "processor": processor(),
        "versions": " ".join(f"{k}={v}" for k, v in versions().items()),
    }
    for case, grid in tqdm(todo, file=sys.stderr, desc="grid study", disable=None):
        yield measure(case, grid) | where


def _verdicts(rows: list[Row]) -> list[str]:
    """Return one sentence per limit: where it holds, where not, and the worst value."""
    words = {
        "final_soc_points": ("Final SoC", "percentage points", 3),
        "temperature_k": ("Temperature", "K", 2),
        "cost_percent": ("Cost", "%", 3),
    }
    lines = []
    for name, (noun, unit, digits) in words.items():
        limit = LIMITS[name]
        missed = [r for r in rows if abs(r[name]) > limit]
        default = [r for r in rows if r["step_km"] == 4.0 and r["cells"] == 12]
        worst = max(rows, key=lambda r: abs(r[name]))
        text = (
            f"- **{noun} within {limit:g} {unit}:** holds in {len(rows) - len(missed)} of "
            f"{len(rows)} rows. Largest deviation {abs(worst[name]):.{digits}f} {unit} "
            f"({_where(worst)})"
        )
        if default:
            top = max(default, key=lambda r: abs(r[name]))
            text += f"; on 4 km and 12 cells {abs(top[name]):.{digits}f} {unit} ({top['case']})"
        text += "."
        if missed:
            text += " Missed: " + "; ".join(_misses(missed)) + "."
        lines.append(text)
    return lines


def _where(row: Row) -> str:
    return f"{row['case']}, {row['step_km']:g} km, {row['cells']} cells"


def _misses(rows: list[Row]) -> Iterator[str]:
    """Group missed rows: the case, then the cells and steps."""
    for case in dict.fromkeys(r["case"] for r in rows):
        own = [r for r in rows if r["case"] == case]
        parts = []
        for cells in sorted({r["cells"] for r in own}):
            steps = "/".join(f"{r['step_km']:g}" for r in own if r["cells"] == cells)
            parts.append(f"{cells} cells at {steps} km")
        yield f"{case} with " + ", ".join(parts)


def _trend(rows: list[Row]) -> str:
    """Return a table of the largest deviation of the cost by case and cells."""
    cells = sorted({r["cells"] for r in rows})
    lines = [
        "| case | " + " | ".join(f"{c} cells" for c in cells) + " |",
        "|---|" + "---:|" * len(cells),
    ]
    for case in dict.fromkeys(r["case"] for r in rows):
        worst = [
            max(abs(r["cost_percent"]) for r in rows if r["case"] == case and r["cells"] == c)
            for c in cells
        ]
        lines.append(f"| {case} | " + " | ".join(f"{w:.3f} %" for w in worst) + " |")
    return "\n".join(lines)


def _scan(rows: list[Row]) -> list[str]:
    """Return the deviation of one case over many numbers of cells, as lines of a page."""
    by_cells = {r["cells"]: r["cost_percent"] for r in rows}
    cells = sorted(by_cells)
    return [
        f"Of {rows[0]['case']}, {rows[0]['step_km']:g} km steps, over more numbers of cells:",
        "",
        "| cells | " + " | ".join(map(str, cells)) + " |",
        "|---|" + "---:|" * len(cells),
        "| cost deviation % | " + " | ".join(f"{by_cells[c]:+.3f}" for c in cells) + " |",
        "",
        "It does not fall steadily. A cell reads the charge limit at its middle, and 12 cells of",
        "this stop are 4 to 5 points of SoC wide; the measured curve of this car drops within 1 or",
        "2 points (69 to 25 kW between SoC 0.79 and 0.80). How the drops fall into the cells",
        "decides sign and size of the error. The smooth curve of `paper-2022` does not show it.",
        "The corridor trips are therefore shipped with 16 cells.",
        "",
    ]


def page(rows: list[Row], scan: list[Row], day: str, command: str) -> str:
    """Return the page of the study in Markdown.

    Parameters
    ----------
    rows, scan : list of dict
        From ``measure``: all cases on all grids; one case over many numbers of cells.
    day, command : str
        When and how they were made.

    Examples
    --------
    >>> row = {"case": "a", "stop": "b", "step_km": 4.0, "cells": 12, "transcribed_cost": 100.0,
    ...     "replayed_cost": 100.3, "cost_percent": 0.3, "final_soc_points": 0.01,
    ...     "node_soc_points": 0.01, "node_temperature_k": 0.1, "temperature_k": 0.2,
    ...     "moved_targets_points": 0.0}
    >>> text = page([row], [row], "2026-01-01", "python -m benchmarks.grid_study")
    >>> "Missed: a with 12 cells at 4 km" in text, "holds in 0 of 1 rows" in text
    (True, True)
    """
    lines = [
        "# Grid study: the transcription against the drive",
        "",
        f"Written by `{command}` on {day}; do not edit. Machine: {processor()}. Versions: "
        + ", ".join(f"{k} {v}" for k, v in versions().items())
        + ". The rows are in `benchmarks/results/grid_study.csv`.",
        "",
        "Bounds hold for the transcription (`docs/maths.md`), reported costs come from the drive",
        "on the continuous model (the replay). This page says how far the two are apart. Each",
        "row plans one fixed choice of stops on one grid and drives that plan. A row compares a",
        "plan with its own drive. Plans of different grids may be different local optima, so costs",
        "of different rows can differ a little for that reason too.",
        "",
        "## Where the limits hold",
        "",
        *_verdicts(rows),
        "",
        "The largest deviation of the cost over the steps, by cells:",
        "",
        _trend(rows),
        "",
        *_scan(scan),
        "Consequence for the gap: `evrelax plan` compares the bound (transcription) with the cost",
        "(drive), so a gap no larger than the deviation of the cost says nothing about the drive.",
        "`evrelax plan` prints that deviation below the gap; `--set grid.cells=24` makes it small.",
        "",
        "## All rows",
        "",
        "- *cost deviation*: driven over transcribed cost, less 1.",
        "- *final SoC*: with the planned charging targets, before they are corrected.",
        "- *targets moved*: by how much the executed plan moves a charging target so that the",
        "  trip ends at its least SoC; the driven cost is that of the executed plan.",
        "- *SoC*: of the executed plan, at the nodes; *T nodes*: the same for the temperature;",
        "  *T*: at nodes, samples of the road and borders of charging cells.",
        "",
        "| case | stop | step km | cells | transcribed | driven | cost deviation % | final SoC "
        "points | targets moved points | SoC points | T nodes K | T K |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for r in rows:
        lines.append(
            f"| {r['case']} | {r['stop']} | {r['step_km']:g} | {r['cells']} "
            f"| {r['transcribed_cost']:.3f} | {r['replayed_cost']:.3f} | {r['cost_percent']:+.4f} "
            f"| {r['final_soc_points']:.4f} | {r['moved_targets_points']:.4f} "
            f"| {r['node_soc_points']:.4f} | {r['node_temperature_k']:.3f} "
            f"| {r['temperature_k']:.3f} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run the study, write file and page, print the judgement; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.grid_study", description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="one case on one coarse grid")
    options = parser.parse_args(arguments)
    name = "grid_study.csv"
    grids = [Grid(step_km, cells) for step_km, cells in product(STEPS_KM, CELLS)]
    todo = list(product(CASES, grids))
    studied = len(todo)
    todo += [(CASES[-1], Grid(STEPS_KM[0], cells)) for cells in SCAN_CELLS]
    if options.smoke:
        todo, studied, name = [(CASES[2], Grid(20.0, 4))], 1, "grid_study-smoke.csv"
    file = HERE / "results" / name
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        for row in _rows(todo):
            writer.writerow(row)
            stream.flush()
            rows.append(row)
    if not options.smoke:
        first = (rows[0]["step_km"], CASES[-1].label)
        scan = [r for r in rows if (r["step_km"], r["case"]) == first]
        text = page(rows[:studied], scan, date.today().isoformat(), COMMAND)
        (HERE.parent / "docs" / "grid-study.md").write_text(text, encoding="utf-8")
    print("\n".join(_verdicts(rows[:studied])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
