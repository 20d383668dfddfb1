"""Owns one solver held against another: who is faster, cheaper, tighter, and what a driver saves.

Pure functions on rows. Knows nothing of trips and of pages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import exp, inf, isfinite, log, nan
from statistics import mean
from typing import Any

from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.rows import Row, number
from benchmarks.verdicts import Cases, asked_gap, excess, held, judged_cost, peer_s, proved_gap

__all__ = ["AMBIENT_BINS", "SAME_COST", "against", "pairs", "savings"]

SAME_COST = 1e-4
"""Relative difference of costs that counts as none."""
AMBIENT_BINS = ((-inf, -5.0), (-5.0, 5.0), (5.0, 15.0), (15.0, 25.0), (25.0, inf))
"""Ambient temperatures that are looked at together [degrees C]."""


def _proves(cases: Cases, name: str) -> bool:
    """Return whether a peer gives bounds."""
    return any(
        isfinite(number(rows[name], "lower_bound")) for rows in cases.values() if name in rows
    )


def pairs(cases: Cases, names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield who is compared with which of ours.

    Everybody who optimises with our certified plan, who proves nothing also with our plan
    alone, and rules with that only.
    """
    kinds = {c.name: c.kind for c in CONTESTANTS}
    for name in names:
        if kinds[name] == "peer":
            yield name, OURS
        if kinds[name] != "ours" and not _proves(cases, name):
            yield name, FAST


def against(cases: Cases, name: str, ours: str) -> Row:
    """Return a peer against one of us: ratios of time, and where it is faster or cheaper.

    Times are compared where both have a plan that holds, our proof is complete where we were
    asked for one, and the peer's is if it gives bounds at all: giving up is not fast.
    """
    asked = asked_gap()
    proves = _proves(cases, name)
    both = {c: (r[ours], r[name]) for c, r in cases.items() if ours in r and name in r}
    done = {
        case
        for case, (mine, other) in both.items()
        if held(mine)
        and held(other)
        and (ours == FAST or proved_gap(mine) <= asked)
        and (not proves or proved_gap(other) <= asked)
    }
    ratio: dict[str, dict[str, float]] = {"with": {}, "without": {}}
    for case, (mine, other) in both.items():
        spent = number(mine, "total_s")
        for way, time in zip(ratio, peer_s(other), strict=True):
            if spent > 0.0 and time > 0.0 and case in done:
                ratio[way][case] = time / spent
    cheaper = {
        case: excess(judged_cost(mine), judged_cost(other))
        for case, (mine, other) in both.items()
        if held(mine) and held(other) and excess(judged_cost(mine), judged_cost(other)) > SAME_COST
    }
    cheapest = max(cheaper, key=lambda c: cheaper[c], default="")
    dearer = [
        case
        for case, (mine, other) in both.items()
        if held(mine) and held(other) and excess(judged_cost(other), judged_cost(mine)) > SAME_COST
    ]
    alone = [c for c, (mine, other) in both.items() if held(other) and not held(mine)]
    missing = [c for c, (mine, other) in both.items() if held(mine) and not held(other)]
    tighter = [
        case
        for case, (mine, other) in both.items()
        if excess(number(other, "lower_bound"), number(mine, "lower_bound")) > SAME_COST
    ]
    figures: Row = {
        "peer": name,
        "kind": next(by[name]["kind"] for by in cases.values() if name in by),
        "ours": ours,
        "cases": len(both),
        "timed": len(ratio["with"]),
        "together": [c for c in ratio["with"] if both[c][0]["run"] == both[c][1]["run"] != ""],
    }
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
        "cheapest_case": cheapest,
        "cheapest_repaired": bool(cheapest) and both[cheapest][1]["outcome"] == "repaired",
        "dearer": sorted(dearer),
        "plan_only_there": sorted(alone),
        "plan_only_here": sorted(missing),
        "tighter": sorted(tighter),
    }


def savings(cases: Cases, name: str) -> list[Row]:
    """Return what our plans save against a driver, by ambient temperature."""
    found = []
    for lo, hi in AMBIENT_BINS:
        together = [
            (rows[FAST], rows[name])
            for rows in cases.values()
            if FAST in rows and name in rows and lo <= number(rows[name], "ambient_c") < hi
        ]
        both = [(a, b) for a, b in together if held(a) and held(b)]

        def average(value: Callable[[Row, Row], float], both: list[Any] = both) -> float:
            return mean(value(a, b) for a, b in both) if both else nan

        if together:
            found.append(
                {
                    "from_c": lo,
                    "to_c": hi,
                    "cases": len(both),
                    "driver_fails": sum(held(a) and not held(b) for a, b in together),
                    "saved_min": average(lambda a, b: 60.0 * (_stop_h(b) - _stop_h(a))),
                    "saved_paid": average(
                        lambda a, b: _share(number(b, "paid"), number(a, "paid"))
                    ),
                    "saved_cost": average(lambda a, b: _share(judged_cost(b), judged_cost(a))),
                }
            )
    return found


def _stop_h(row: Row) -> float:
    return number(row, "charging_h") + number(row, "detour_h")


def _share(theirs: float, ours: float) -> float:
    """Return what is saved, as a share; amounts below 1 count as 1."""
    return (theirs - ours) / max(abs(theirs), 1.0)
