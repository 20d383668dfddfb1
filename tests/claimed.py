"""A row of the comparison as the tests want it: any solver, case, cost and time."""

from __future__ import annotations

import math
from typing import Any

from benchmarks.compare import COLUMNS
from benchmarks.contestants import CONTESTANTS, OURS
from benchmarks.rows import Row

WHERE = {
    "date": "2026-01-02",
    "run": "2026-01-02T03:04+00:00",
    "processor": "a processor",
    "versions": "python=3",
}


def row(case: str, solver: str, cost: float, seconds: float, **changes: Any) -> Row:
    """A row as the comparison writes it; NaN cost: no plan."""
    held = math.isfinite(cost)
    kinds = {c.name: c.kind for c in CONTESTANTS}
    made = dict.fromkeys(COLUMNS, "") | {
        "case": case,
        "group": case.split("/")[0],
        "ambient_c": -10.0,
        "solver": solver,
        "version": "1",
        "settings": "limit 9 s",
        "kind": kinds[solver],
        "outcome": "holds" if held else "none",
        "claimed_cost": cost,
        "transcribed_cost": cost,
        "replayed_cost": cost if held else math.inf,
        "feasible": held,
        "claims_infeasible": False,
        "lower_bound": 0.99 * cost if solver == OURS else -math.inf,
        "charging_h": 0.5,
        "detour_h": 0.1,
        "paid": cost,
        "build_s": 0.0,
        "solve_s": seconds,
        "total_s": seconds,
        "trace": "[]",
        "programs": 3,
    }
    return made | WHERE | changes
