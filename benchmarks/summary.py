"""Owns the figures of a comparison: rows of a result file in, plain numbers out.

Pure functions on rows. What a row says is ``verdicts``, who beats whom ``against``. Knows nothing
of trips and of pages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from math import exp, inf, isfinite, log, nan
from statistics import mean, median
from typing import Any

from benchmarks.against import against, pairs, savings
from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.rows import Row, is_true, number
from benchmarks.verdicts import (
    CLAIM_TOLERANCE,
    Cases,
    asked_gap,
    best_costs,
    excess,
    held,
    is_as_claimed,
    is_cut,
    judged_cost,
    latest,
    proved_gap,
)

__all__ = ["SHIFT_S", "shifted_mean", "summarise", "table"]

SHIFT_S = 0.1
"""Shift of geometric means of time: differences far below it do not count [s]."""
BOUND_SLACK = 1e-7
"""Relative distance by which a bound may exceed a cost by rounding."""


def shifted_mean(times: Sequence[float], shift: float = SHIFT_S) -> float:
    """Return the geometric mean of time + shift, less the shift; NaN of nothing.

    Examples
    --------
    >>> round(shifted_mean([0.1, 0.7], shift=0.1), 6)
    0.3
    """
    if not times:
        return nan
    return exp(mean(log(t + shift) for t in times)) - shift


def _words(name: str) -> str:
    return next((c.words for c in CONTESTANTS if c.name == name), name)


def _by_group(rows: Iterable[Row], column: str) -> list[str]:
    """Return what rows say in a column; of several entries each with its kinds of case."""
    found: dict[str, set[str]] = {}
    for row in rows:
        found.setdefault(row[column], set()).add(row["group"])
    if len(found) == 1:
        return list(found)
    return sorted(f"{entry} ({', '.join(sorted(groups))})" for entry, groups in found.items())


def _solver(name: str, cases: Cases, best: dict[str, float], known: dict[str, float]) -> Row:
    """Return the figures of one solver."""
    own = {case: rows[name] for case, rows in cases.items() if name in rows}
    possible = [case for case in own if isfinite(best[case])]
    driven = [case for case in possible if held(own[case])]
    correct = [case for case in possible if is_as_claimed(own[case])]
    wrong = [case for case in possible if is_true(own[case], "claims_infeasible")]
    bounds = {c: number(r, "lower_bound") for c, r in own.items()}
    bounds = {c: b for c, b in bounds.items() if isfinite(b)}
    undercut = [c for c, b in bounds.items() if excess(b, known[c]) > BOUND_SLACK]
    gaps = {c: proved_gap(own[c]) for c in bounds if held(own[c])}
    apart = {c: excess(judged_cost(own[c]), best[c]) for c in driven}
    total = [number(row, "total_s") for row in own.values() if number(row, "total_s") > 0.0]
    worst = max(apart, key=lambda c: apart[c], default="")
    return {
        "words": _words(name),
        "kind": next(iter(own.values()))["kind"],
        "cases": len(own),
        "possible": len(possible),
        "held": len(driven),
        "repaired": sum(own[c]["outcome"] == "repaired" for c in driven),
        "stopped": sum(row["outcome"] == "stopped" for row in own.values()),
        "cut": sum(map(is_cut, own.values())),
        "correct": len(correct),
        "wrongly_infeasible": len(wrong),
        "mean_excess": mean(apart.values()) if apart else nan,
        "worst_excess": apart.get(worst, nan),
        "worst_case": worst,
        "bounds": len(bounds),
        "bounds_undercut": len(undercut),
        "median_gap": median(gaps.values()) if gaps else nan,
        "largest_gap": max(gaps.values(), default=nan),
        "time_s": shifted_mean(total),
        "slowest_s": max(total, default=nan),
        "sum_s": sum(total),
        "median_programs": median(number(row, "programs") for row in own.values())
        if total
        else nan,
        "versions": _by_group(own.values(), "version"),
    }


def summarise(rows: Iterable[Row]) -> Row:
    """Return all figures of a comparison.

    Parameters
    ----------
    rows : iterable of dict
        As in the result file; of several with the same case and solver the last counts.

    Returns
    -------
    dict
        JSON types; what is not there is None.
    """
    cases = latest(rows)
    best = best_costs(cases)
    known = {
        case: min((number(row, "transcribed_cost") for row in by.values() if held(row)),
                  default=inf)
        for case, by in cases.items()
    }  # fmt: skip
    names = [c.name for c in CONTESTANTS if any(c.name in by for by in cases.values())]
    every = [row for by in cases.values() for row in by.values()]
    certified = {c: by[OURS] for c, by in cases.items() if OURS in by and isfinite(best[c])}
    asked = asked_gap()
    summary: Row = {
        "cases": len(cases),
        "groups": dict(Counter(next(iter(by.values()))["group"] for by in cases.values())),
        "possible": sum(map(isfinite, best.values())),
        "without_plan": sorted(c for c, cost in best.items() if not isfinite(cost)),
        "shift_s": SHIFT_S,
        "claim_tolerance": CLAIM_TOLERANCE,
        "asked_gap": asked,
        "gap_missed": sorted(
            case for case, row in certified.items() if not proved_gap(row) <= asked
        ),
        "open": sorted(
            case
            for case, by in cases.items()
            for row in [by.get(OURS) or by.get(FAST)]
            if row is not None and not held(row) and not is_true(row, "claims_infeasible")
        ),
        "solvers": {name: _solver(name, cases, best, known) for name in names},
        "against": [
            against(cases, name, ours) for name, ours in pairs(cases, names) if ours in names
        ],
        "savings": {
            c.name: savings(cases, c.name)
            for c in CONTESTANTS
            if c.kind == "rule" and c.name in names
        },
        "judges": sorted({row["judge"] for row in every}),
        "dates": sorted({row["date"] for row in every}),
        "processors": sorted({row["processor"] for row in every}),
        "versions": sorted({row["versions"] for row in every}),
        "settings": _by_group(every, "settings"),
    }
    plain = _plain(summary)
    assert isinstance(plain, dict)
    return plain


def _plain(value: Any) -> Any:
    """Return JSON types; infinities and NaN become None."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def table(summary: Row) -> str:
    """Return a summary as text for the terminal."""

    def show(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    lines = [
        f"{summary['cases']} cases, {summary['possible']} with a plan by anyone",
        f"{'solver':<19} rows  held correct  excess %  worst %  gap %   time s    sum s",
    ]
    for name, s in summary["solvers"].items():
        percent = {
            k: None if s[k] is None else 100.0 * s[k]
            for k in ("mean_excess", "worst_excess", "median_gap")
        }
        lines.append(
            f"{name:<19} {s['cases']:4d} {s['held']:5d} {s['correct']:7d} "
            f"{show(percent['mean_excess'], '9.3f'):>9} {show(percent['worst_excess'], '8.3f'):>8} "
            f"{show(percent['median_gap'], '6.2f'):>6} {show(s['time_s'], '8.3f'):>8} "
            f"{show(s['sum_s'], '8.1f'):>8}"
        )
    return "\n".join(lines)
