"""Owns the figures of a comparison: rows of a result file in, plain numbers out.

Pure functions on rows. Every comparison of costs uses the judge's figure, never a claim; every
time of a peer is its building plus solving, or solving alone: correcting and judging its plan is
left out, while all of ours is in. Knows nothing of trips and of pages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from math import exp, inf, isfinite, log, nan
from statistics import mean, median
from typing import Any

from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.rows import Row, is_true, number
from enumerate.gap import relative_gap

__all__ = [
    "AMBIENT_BINS",
    "CLAIM_TOLERANCE",
    "SAME_COST",
    "SHIFT_S",
    "best_costs",
    "excess",
    "latest",
    "peer_s",
    "shifted_mean",
    "summarise",
    "table",
]

SHIFT_S = 0.1
"""Shift of geometric means of time: differences far below it do not count [s]."""
CLAIM_TOLERANCE = 5e-3
"""Relative distance of a claimed cost from the judge's that counts as correct: far above what
the transcription costs (``docs/grid-study.md``)."""
SAME_COST = 1e-4
"""Relative difference of costs that counts as none."""
BOUND_SLACK = 1e-7
"""Relative distance by which a bound may exceed a cost by rounding."""
AMBIENT_BINS = ((-inf, -5.0), (-5.0, 5.0), (5.0, 15.0), (15.0, 25.0), (25.0, inf))
"""Ambient temperatures that are looked at together [degrees C]."""
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


def excess(cost: float, best: float) -> float:
    """Return by how much a cost is above another, relative; costs below 1 count as 1.

    Examples
    --------
    >>> excess(102.0, 100.0)
    0.02
    """
    return (cost - best) / max(abs(best), 1.0)


def _held(row: Row | None) -> bool:
    return row is not None and is_true(row, "feasible")


def _cost(row: Row | None) -> float:
    return number(row, "replayed_cost") if row is not None and _held(row) else inf


def best_costs(cases: Cases) -> dict[str, float]:
    """Return the least cost by the judge of every case, ``inf`` where nobody has a plan."""
    return {case: min(map(_cost, rows.values())) for case, rows in cases.items()}


def _gap(row: Row) -> float:
    return relative_gap(_cost(row), number(row, "lower_bound"))


def peer_s(row: Row) -> tuple[float, float]:
    """Return a peer's time with and without building [s]; NaN if it gave no answer."""
    return number(row, "build_s") + number(row, "solve_s"), number(row, "solve_s")


def _words(name: str) -> str:
    return next((c.words for c in CONTESTANTS if c.name == name), name)


def _solver(name: str, cases: Cases, best: dict[str, float], known: dict[str, float]) -> Row:
    """Return the figures of one solver."""
    own = {case: rows[name] for case, rows in cases.items() if name in rows}
    possible = [case for case in own if isfinite(best[case])]
    held = [case for case in possible if _held(own[case])]
    correct = [
        case
        for case in possible
        if own[case]["outcome"] == "holds"
        and abs(excess(number(own[case], "claimed_cost"), _cost(own[case]))) <= CLAIM_TOLERANCE
    ]
    wrong = [case for case in possible if is_true(own[case], "claims_infeasible")]
    bounds = {c: number(r, "lower_bound") for c, r in own.items()}
    bounds = {c: b for c, b in bounds.items() if isfinite(b)}
    undercut = [c for c, b in bounds.items() if excess(b, known[c]) > BOUND_SLACK]
    gaps = {c: _gap(own[c]) for c in bounds if _held(own[c])}
    apart = {c: excess(_cost(own[c]), best[c]) for c in held}
    total = [number(row, "total_s") for row in own.values() if number(row, "total_s") > 0.0]
    worst = max(apart, key=lambda c: apart[c], default="")
    return {
        "words": _words(name),
        "kind": next(iter(own.values()))["kind"],
        "cases": len(own),
        "possible": len(possible),
        "held": len(held),
        "repaired": sum(own[c]["outcome"] == "repaired" for c in held),
        "stopped": sum(row["outcome"] == "stopped" for row in own.values()),
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
        "versions": sorted({row["version"] for row in own.values()}),
    }


def _asked_gap() -> float:
    """Return the gap that is asked for, rounding allowed."""
    return next(c.gap for c in CONTESTANTS if c.name == OURS) * (1.0 + 1e-9)


def _reference(cases: Cases, name: str) -> str:
    """Return which of ours a peer is compared with: the proving one if the peer gives bounds."""
    proves = any(
        isfinite(number(rows[name], "lower_bound")) for rows in cases.values() if name in rows
    )
    return OURS if proves else FAST


def _against(cases: Cases, name: str) -> Row:
    """Return a peer against us: ratios of time, and where it is faster or cheaper.

    Times are compared where both have a plan that holds, and the peer's proof is complete if
    it gives bounds at all: giving up is not fast.
    """
    asked = _asked_gap()
    ours = _reference(cases, name)
    pairs = {c: (r[ours], r[name]) for c, r in cases.items() if ours in r and name in r}
    done = {
        case
        for case, (mine, other) in pairs.items()
        if _held(mine) and _held(other) and (ours == FAST or _gap(other) <= asked)
    }
    ratio: dict[str, dict[str, float]] = {"with": {}, "without": {}}
    for case, (mine, other) in pairs.items():
        spent = number(mine, "total_s")
        for way, time in zip(ratio, peer_s(other), strict=True):
            if spent > 0.0 and time > 0.0 and case in done:
                ratio[way][case] = time / spent
    cheaper = {
        case: excess(_cost(mine), _cost(other))
        for case, (mine, other) in pairs.items()
        if _held(mine) and _held(other) and excess(_cost(mine), _cost(other)) > SAME_COST
    }
    dearer = [
        case
        for case, (mine, other) in pairs.items()
        if _held(mine) and _held(other) and excess(_cost(other), _cost(mine)) > SAME_COST
    ]
    alone = [c for c, (mine, other) in pairs.items() if _held(other) and not _held(mine)]
    missing = [c for c, (mine, other) in pairs.items() if _held(mine) and not _held(other)]
    tighter = [
        case
        for case, (mine, other) in pairs.items()
        if excess(number(other, "lower_bound"), number(mine, "lower_bound")) > SAME_COST
    ]
    figures: Row = {"ours": ours, "cases": len(pairs), "timed": len(ratio["with"])}
    for way, values in ratio.items():
        faster = [case for case, value in values.items() if value < 1.0]
        figures |= {
            f"ratio_{way}_build": exp(mean(map(log, values.values()))) if values else nan,
            f"least_ratio_{way}_build": min(values.values(), default=nan),
            f"largest_ratio_{way}_build": max(values.values(), default=nan),
            f"faster_{way}_build": sorted(faster),
            f"ratios_{way}_build": values,
        }
    return figures | {
        "cheaper": sorted(cheaper),
        "cheaper_by": max(cheaper.values(), default=0.0),
        "cheapest_case": max(cheaper, key=lambda c: cheaper[c], default=""),
        "dearer": sorted(dearer),
        "plan_only_there": sorted(alone),
        "plan_only_here": sorted(missing),
        "tighter": sorted(tighter),
    }


def _savings(cases: Cases, name: str) -> list[Row]:
    """Return what our plans save against a driver, by ambient temperature."""
    found = []
    for lo, hi in AMBIENT_BINS:
        pairs = [
            (rows[FAST], rows[name])
            for rows in cases.values()
            if FAST in rows and name in rows and lo <= number(rows[name], "ambient_c") < hi
        ]
        both = [(a, b) for a, b in pairs if _held(a) and _held(b)]

        def average(value: Callable[[Row, Row], float], both: list[Any] = both) -> float:
            return mean(value(a, b) for a, b in both) if both else nan

        if pairs:
            found.append(
                {
                    "from_c": lo,
                    "to_c": hi,
                    "cases": len(both),
                    "driver_fails": sum(_held(a) and not _held(b) for a, b in pairs),
                    "saved_min": average(lambda a, b: 60.0 * (_stop_h(b) - _stop_h(a))),
                    "saved_paid": average(
                        lambda a, b: _share(number(b, "paid"), number(a, "paid"))
                    ),
                    "saved_cost": average(lambda a, b: _share(_cost(b), _cost(a))),
                }
            )
    return found


def _stop_h(row: Row) -> float:
    return number(row, "charging_h") + number(row, "detour_h")


def _share(theirs: float, ours: float) -> float:
    """Return what is saved, as a share; amounts below 1 count as 1."""
    return (theirs - ours) / max(abs(theirs), 1.0)


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
        case: min((number(row, "transcribed_cost") for row in by.values() if _held(row)),
                  default=inf)
        for case, by in cases.items()
    }  # fmt: skip
    names = [c.name for c in CONTESTANTS if any(c.name in by for by in cases.values())]
    every = [row for by in cases.values() for row in by.values()]
    certified = {c: by[OURS] for c, by in cases.items() if OURS in by and isfinite(best[c])}
    asked = _asked_gap()
    summary: Row = {
        "cases": len(cases),
        "groups": dict(Counter(next(iter(by.values()))["group"] for by in cases.values())),
        "possible": sum(map(isfinite, best.values())),
        "without_plan": sorted(c for c, cost in best.items() if not isfinite(cost)),
        "shift_s": SHIFT_S,
        "claim_tolerance": CLAIM_TOLERANCE,
        "asked_gap": asked,
        "gap_missed": sorted(case for case, row in certified.items() if not _gap(row) <= asked),
        "open": sorted(
            case
            for case, by in cases.items()
            for row in [by.get(OURS) or by.get(FAST)]
            if row is not None and not _held(row) and not is_true(row, "claims_infeasible")
        ),
        "solvers": {name: _solver(name, cases, best, known) for name in names},
        "against": {
            c.name: _against(cases, c.name)
            for c in CONTESTANTS
            if c.kind != "ours" and c.name in names
        },
        "savings": {
            c.name: _savings(cases, c.name)
            for c in CONTESTANTS
            if c.kind == "rule" and c.name in names
        },
        "judges": sorted({row["judge"] for row in every}),
        "dates": sorted({row["date"] for row in every}),
        "processors": sorted({row["processor"] for row in every}),
        "versions": sorted({row["versions"] for row in every}),
        "settings": sorted({row["settings"] for row in every}),
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
