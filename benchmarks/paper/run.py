"""Owns the run of all experiments: sweeps of ``enumerate`` over the paper's trips, kept in a file.

What the file holds for the present car and settings is not computed again. Knows
nothing of pages and figures.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.paper.cases import AMBIENT_C as CASE_AMBIENT_C
from benchmarks.paper.cases import case_row, time_value
from benchmarks.paper.fronts import GAP, TIMES_MIN, front_row
from benchmarks.paper.published import (
    AMBIENT_C,
    CASES,
    HEAT_PUMP_KW,
    SWEEP_TIME_VALUE_PER_H,
)
from benchmarks.paper.sweep import AMBIENT_C as SWEEP_AMBIENT_C
from benchmarks.paper.sweep import point_row
from enumerate import sweep

__all__ = ["KINDS", "Rows", "kept", "run"]

KINDS = ("fronts", "cases", "sweep")
FEW = 6
"""With ``few``: every so many degrees of the sweep."""
TRIP = "paper-400km"
AMBIENT, PUMP, TIME_VALUE = "route.ambient_c", "vehicle.heat_pump_kw", "objective.time_value_per_h"
Row = Mapping[str, Any]


@dataclass
class Rows:
    """What there is.

    Parameters
    ----------
    fronts, points : dict
        Rows of the fronts and of the sweep by ambient temperature and heat pump.
    cases : dict
        By letter.
    seconds : float
        Work in them [s].
    computed, missing : int
        Rows that this call added; rows that are not there.
    interrupted : str
        Why some are missing; empty if they were not asked for or none is.
    """

    fronts: dict[tuple[float, float], Row] = field(default_factory=dict)
    cases: dict[str, Row] = field(default_factory=dict)
    points: dict[tuple[float, float], Row] = field(default_factory=dict)
    seconds: float = 0.0
    computed: int = 0
    missing: int = 0
    interrupted: str = ""

    @property
    def number(self) -> int:
        """Rows that are there."""
        return len(self.fronts) + len(self.cases) + len(self.points)

    @property
    def count(self) -> int:
        """Certified values: points of the fronts, case D, plans of the sweep."""
        fronts = sum(len(row["points"]) for row in self.fronts.values())
        return fronts + len(self.points) + sum("lower_bound" in c for c in self.cases.values())


class _Nobody(Executor):
    """Computes nothing."""

    def submit(self, *_args: Any, **_kwargs: Any) -> Any:
        """Refuse."""
        raise BrokenExecutor


def kept(file: Path, few: bool = False) -> Rows:
    """Return what a file holds for the present car and settings; computes nothing.

    Examples
    --------
    >>> rows = kept(Path("no such file"))
    >>> rows.count, rows.missing
    (0, 125)
    """
    return run(file, KINDS, few=few, executor=_Nobody())


def run(
    file: Path,
    kinds: Sequence[str] = KINDS,
    workers: int = 1,
    few: bool = False,
    executor: Executor | None = None,
) -> Rows:
    """Compute what a file does not hold yet; every row is kept as it comes.

    Parameters
    ----------
    file : Path
        JSON lines.
    kinds : sequence of str
        Of ``KINDS``.
    workers : int
        Processes.
    few : bool
        Every sixth degree of the sweep.
    executor : Executor, optional
        Instead of processes.

    Returns
    -------
    Rows
        After Ctrl-C: what was finished by then.
    """
    rows = Rows()
    degrees = SWEEP_AMBIENT_C[:: FEW if few else 1]
    pumps = tuple(reversed(HEAT_PUMP_KW))  # the longest proofs first: the workers end together
    if "fronts" in kinds:
        task: Any = partial(front_row, times_min=TIMES_MIN, gap=GAP)
        over = {AMBIENT: AMBIENT_C, PUMP: pumps}
        found = _sweep(rows, file, over, {}, task, workers, executor, "fronts")
        rows.fronts.update({(v[AMBIENT], v[PUMP]): row for v, row in found})
    for case in CASES if "cases" in kinds else ():
        task = partial(case_row, stops=case.stops, gap=GAP if case.aim == "cost" else None)
        fixed = {AMBIENT: CASE_AMBIENT_C, PUMP: case.heat_pump_kw}
        over = {TIME_VALUE: (time_value(case),)}
        for _, row in _sweep(rows, file, over, fixed, task, 1, executor, f"case {case.name}"):
            rows.cases[case.name] = row
    if "sweep" in kinds:
        task = partial(point_row, gap=GAP)
        fixed, over = {TIME_VALUE: SWEEP_TIME_VALUE_PER_H}, {AMBIENT: degrees, PUMP: pumps}
        found = _sweep(rows, file, over, fixed, task, workers, executor, "sweep")
        rows.points.update({(v[AMBIENT], v[PUMP]): row for v, row in found})
    return rows


def _sweep(
    rows: Rows,
    file: Path,
    over: Mapping[str, Sequence[float]],
    fixed: Mapping[str, float],
    task: Any,
    workers: int,
    executor: Executor | None,
    label: str,
) -> list[tuple[Mapping[str, float], Row]]:
    """Run one sweep with a progress bar; after an interrupt only read."""
    if rows.interrupted and executor is None:
        executor = _Nobody()
    total = 1
    for values in over.values():
        total *= len(values)
    quiet = True if isinstance(executor, _Nobody) else None
    with tqdm(total=total, file=sys.stderr, desc=label, disable=quiet) as bar:

        def progress(done: int, _total: int, row: Any) -> None:
            rows.computed += 1
            bar.set_postfix_str(f"{row.seconds:.1f} s")
            bar.update(done - bar.n)

        found = sweep(
            TRIP,
            over,
            task=task,
            overrides=fixed,
            workers=workers,
            executor=executor,
            file=file,
            progress=progress,
        )
    rows.missing += len(found.missing)
    rows.interrupted = rows.interrupted or found.interrupted
    errors = [row.error for row in found.rows if row.error]
    if errors:
        raise ValueError(f"{label}: {errors[0]}")
    rows.seconds += sum(row.seconds for row in found.rows)
    return [(row.variant, row.result) for row in found.rows if row.result is not None]
