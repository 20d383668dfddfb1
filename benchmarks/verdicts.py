"""Owns what one row of the comparison says: whether its plan holds, its cost, its gap, its time.

Every cost is the judge's, never a claim. A peer's time is its building plus solving, or solving
alone: correcting and judging its plan is left out, while all of ours is in. Knows nothing of
trips, of pages and of who is compared with whom.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from benchmarks.contestants import CONTESTANTS, OURS
from benchmarks.rows import Row, is_true, number
from benchmarks.runs import TIME_LIMIT
from enumerate.gap import relative_gap

__all__ = [
    "CLAIM_TOLERANCE",
    "Cases",
    "asked_gap",
    "best_costs",
    "excess",
    "held",
    "is_as_claimed",
    "is_cut",
    "judged_cost",
    "latest",
    "peer_s",
    "proved_gap",
]

CLAIM_TOLERANCE = 5e-3
"""Relative distance of a claimed cost from the judge's that counts as correct: far above what
the transcription costs (``docs/grid-study.md``)."""
CUT = (TIME_LIMIT, "timelimit", "limit_exceeded")
"""How enumerations and we, SCIP, and BONMIN say that time was up."""
Cases = dict[str, dict[str, Row]]


def latest(rows: Iterable[Row]) -> Cases:
    """Return the last row of every case and solver, by case.

    Examples
    --------
    >>> row = {"case": "a", "solver": "s", "total_s": 1.0}
    >>> latest([row, row | {"total_s": 2.0}])["a"]["s"]["total_s"]
    2.0
    """
    cases: Cases = {}
    for row in rows:
        cases.setdefault(row["case"], {})[row["solver"]] = row
    return cases


def excess(cost: float, best: float) -> float:
    """Return by how much a cost is above another, relative; costs below 1 count as 1.

    Examples
    --------
    >>> excess(102.0, 100.0)
    0.02
    """
    return (cost - best) / max(abs(best), 1.0)


def held(row: Row | None) -> bool:
    """Return whether there is a plan that the judge could drive.

    Examples
    --------
    >>> held(None), held({"feasible": "True"})
    (False, True)
    """
    return row is not None and is_true(row, "feasible")


def judged_cost(row: Row | None) -> float:
    """Return the cost by the judge, ``inf`` without a plan that holds."""
    return number(row, "replayed_cost") if row is not None and held(row) else inf


def best_costs(cases: Cases) -> dict[str, float]:
    """Return the least cost by the judge of every case, ``inf`` where nobody has a plan."""
    return {case: min(map(judged_cost, rows.values())) for case, rows in cases.items()}


def is_as_claimed(row: Row) -> bool:
    """Return whether a plan holds unrepaired, at the cost that was claimed.

    Examples
    --------
    >>> row = {"outcome": "holds", "feasible": True, "claimed_cost": 100, "replayed_cost": 100.4}
    >>> is_as_claimed(row), is_as_claimed(row | {"outcome": "repaired"})
    (True, False)
    """
    if row["outcome"] != "holds":
        return False
    return abs(excess(number(row, "claimed_cost"), judged_cost(row))) <= CLAIM_TOLERANCE


def is_cut(row: Row) -> bool:
    """Return whether the time limit ended a run before it was through, by the solver's words.

    Examples
    --------
    >>> is_cut({"message": "timelimit, 3 nodes"}), is_cut({"message": "SUCCESS"})
    (True, False)
    """
    return any(words in row["message"].lower() for words in CUT)


def proved_gap(row: Row) -> float:
    """Return the gap between the judged cost and the solver's own bound."""
    return relative_gap(judged_cost(row), number(row, "lower_bound"))


def peer_s(row: Row) -> tuple[float, float]:
    """Return a peer's time with and without building [s]; NaN if it gave no answer."""
    return number(row, "build_s") + number(row, "solve_s"), number(row, "solve_s")


def asked_gap() -> float:
    """Return the gap that is asked for, rounding allowed."""
    return next(c.gap for c in CONTESTANTS if c.name == OURS) * (1.0 + 1e-9)
