"""Owns one measured call of ``plan``: time by part, Clarabel's own time, memory, how it ended.

Runs in the process that calls it; for a peak of memory that means something, a fresh one.
Knows nothing of what is varied.
"""

from __future__ import annotations

import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from benchmarks.cases import SMOKE
from benchmarks.probe import PARTS, watch
from enumerate import plan
from relax.trip import Trip

__all__ = ["MEASURED", "PlanTask", "measure_plan", "peak_memory_mb"]

REPEAT_BELOW_S = 5.0
"""Plans that take longer are measured once [s]."""
REPEATS = 3
MEASURED = (
    "ended", "message", "total_s", "runs_s", "clarabel_s", *(f"{part}_s" for part in PARTS),
    "rest_s", "programs", "subsets", "cost", "lower_bound", "gap", "memory_before_mb", "memory_mb",
)  # fmt: skip
"""What is measured. ``ended``: ``done``, ``limit`` (the time limit stopped it) or ``refused``."""
Row = dict[str, Any]


@dataclass(frozen=True)
class PlanTask:
    """A call of ``plan``.

    Parameters
    ----------
    trip : Trip
        The trip.
    gap : float or None
        Relative gap asked for.
    time_limit_s : float
        Handed to ``plan`` [s].
    """

    trip: Trip
    gap: float | None
    time_limit_s: float


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage counts the parent's memory from before the exec, too
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024.0 / 1e6
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _once(task: PlanTask) -> Row:
    with watch() as probe:
        begin = perf_counter()
        result = plan(task.trip, gap=task.gap, time_limit_s=task.time_limit_s)
        total = perf_counter() - begin
    parts = probe.parts_s()
    return {
        "ended": "limit" if result.interrupted else "done",
        "message": result.status.value,
        "total_s": total,
        "clarabel_s": sum(probe.reported_s),
        **{f"{part}_s": spent for part, spent in parts.items()},
        "rest_s": total - sum(parts.values()),
        "programs": probe.programs,
        "subsets": len(result.ledger.rows),
        "cost": result.cost,
        "lower_bound": result.lower_bound,
        "gap": result.gap,
    }


def measure_plan(task: PlanTask) -> Row:
    """Plan once, or several times if that is quick, and return medians.

    A trip that ``plan`` refuses gives a row that says so.

    Examples
    --------
    >>> row = measure_plan(PlanTask(SMOKE.load(), None, 60.0))
    >>> row["ended"], 0.0 < row["clarabel_s"] < row["solve_s"] < row["total_s"]
    ('done', True)
    """
    plan(SMOKE.load())  # imports and first calls are not what is measured
    before = peak_memory_mb()
    try:
        runs = [_once(task)]
    except ValueError as error:
        return {"ended": "refused", "message": str(error)}
    while runs[0]["total_s"] < REPEAT_BELOW_S and len(runs) < REPEATS:
        runs.append(_once(task))
    times = {name: median(run[name] for run in runs) for name in runs[0] if name.endswith("_s")}
    return runs[0] | times | {
        "runs_s": [run["total_s"] for run in runs],
        "memory_before_mb": before,
        "memory_mb": peak_memory_mb(),
    }  # fmt: skip
