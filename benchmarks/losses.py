"""Owns the list of where evrelax loses: found in summaries and rows, none left out for its size.

Knows nothing of how anything was measured.
"""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.asked import missed
from benchmarks.contestants import FAST, OURS
from benchmarks.rows import Row, number
from benchmarks.scale import curves
from benchmarks.words import bullets, counted, percent, plain, some

__all__ = ["MEMORY_MB", "UNMOVED", "losses"]

MEMORY_MB = 500.0
"""Peak memory of one plan that counts as much [MB]."""
UNMOVED = 0.01
"""A proof that takes less than this share off the gap has not changed it."""


def _times(summary: Row, ours: str) -> list[str]:
    """Return who is faster than one of ours."""
    ways: dict[str, list[str]] = {"with": [], "without": []}
    rules = []
    for a in summary["against"]:
        if a["ours"] != ours:
            continue
        name, n = a["peer"], a["timed"]
        if a["kind"] == "rule":
            if a["faster_with_build"]:
                rules.append(f"`{name}` in {len(a['faster_with_build'])} of {counted(n, 'case')}")
            continue
        for way, found in ways.items():
            faster = a[f"faster_{way}_build"]
            if faster and (way == "with" or set(faster) > set(a["faster_with_build"])):
                found.append(
                    f"`{name}` in {len(faster)} of {counted(n, 'case')} (down to "
                    f"{plain(a[f'least_ratio_{way}_build'], 3)} of our time)"
                )
    return [
        *bullets(f"**Time** of `{ours}`, their model building included", ways["with"]),
        *bullets(f"**Time** of `{ours}`, if their model is built before", ways["without"]),
        *bullets(f"**Time** of `{ours}` against rules that optimise nothing", rules),
    ]


def _peers(summary: Row) -> list[str]:
    """Return who has cheaper plans, plans alone, or tighter bounds."""
    cheaper: list[str] = []
    alone: list[str] = []
    tighter: list[str] = []
    for name in dict.fromkeys(a["peer"] for a in summary["against"]):
        own = [a for a in summary["against"] if a["peer"] == name]
        at = max(own, key=lambda a: float(a["cheaper_by"]))
        if at["cheaper"]:
            cheaper.append(
                f"`{name}` in {len(at['cheaper'])} of {counted(at['cases'], 'case')} (by up to "
                f"{percent(at['cheaper_by'], 3)}, `{at['cheapest_case']}`"
                + (", once our refinement has repaired it)" if at["cheapest_repaired"] else ")")
            )
        for found, key in ((alone, "plan_only_there"), (tighter, "tighter")):
            cases = sorted({case for a in own for case in a[key]})
            if cases:
                found.append(f"`{name}` in {some(cases)}")
    return [
        *bullets("**Cost**, as judged: cheaper plans have", cheaper),
        *bullets("**Plans** that we do not find", alone),
        *bullets("**Bounds** tighter than ours", tighter),
    ]


def _claims(summary: Row) -> list[str]:
    """Return what of our own claims is not confirmed, or wrong."""
    refused, bounds, proofs = [], [], []
    for name, s in summary["solvers"].items():
        if s["kind"] != "ours":
            continue
        if s["possible"] > s["correct"]:
            refused.append(
                f"{s['possible'] - s['correct']} of {s['possible']} answers of `{name}` are not"
                " confirmed"
            )
        if s["bounds_undercut"]:
            bounds.append(f"{s['bounds_undercut']} of `{name}` are above a known plan")
        if s["wrongly_infeasible"]:
            cases = counted(s["wrongly_infeasible"], "case")
            proofs.append(f"`{name}` calls {cases} infeasible where there is a plan")
    return [
        *bullets("**Claims**", refused),
        *bullets("**Wrong bounds**", bounds),
        *bullets("**Wrong proofs**", proofs),
    ]


def _point(row: Row) -> str:
    """Return what was varied in a row of a sweep, and how far."""
    gap = number(row, "asked_gap")
    asked = f", {percent(gap, 0)} asked for" if gap > 0.0 and row["sweep"] != "gap" else ""
    return f"{row['sweep']} {float(row['value']):g}{asked}"


def _sweeps(scale_rows: Iterable[Row]) -> list[str]:
    """Return what the sweeps show: no plan, much memory, gaps that stay open."""
    found = curves(scale_rows)
    rows = [row for own in found.values() for row in own]
    quick = {
        (row["sweep"], row["value"]): number(row, "gap")
        for (_, asked), own in found.items() if not asked
        for row in own
    }  # fmt: skip
    broken = [
        f"{_point(row)} ({row['ended']}: {row['message']})"
        for row in rows
        if row["ended"] not in ("done", "limit")
    ]
    memory = [
        f"{_point(row)}: {number(row, 'memory_mb'):.0f} MB"
        for row in rows
        if number(row, "memory_mb") > MEMORY_MB
    ]
    left = []
    for row in rows:
        gap, asked = number(row, "gap"), number(row, "asked_gap")
        if row["ended"] != "limit" or not gap > asked:
            continue
        words = f"{_point(row)}: {percent(gap)} after {number(row, 'time_limit_s'):g} s"
        if gap > (1.0 - UNMOVED) * quick.get((row["sweep"], row["value"]), float("inf")):
            words += ", no less than without a proof"
        left.append(words)
    return [
        *bullets("**No plan** in the sweeps below", broken),
        *bullets(f"**Memory** above {MEMORY_MB:.0f} MB in the sweeps below", memory),
        *bullets("**Proof**: the gap asked for is not reached in the sweeps below", left),
    ]


def losses(summary: Row, entries: Iterable[Row] = (), scale_rows: Iterable[Row] = ()) -> str:
    """Return the list that says where evrelax is beaten.

    Parameters
    ----------
    summary : dict
        From ``summarise``.
    entries : iterable of dict
        From ``asked``: what is not reached is said, too.
    scale_rows : iterable of dict
        Of ``benchmarks.scale``: refused trips, much memory and open gaps are said, too.

    Returns
    -------
    str
        Markdown: time, cost, plans, bounds, asked gaps, own claims, sweeps, what was asked for.
    """
    said = [*_times(summary, OURS), *_times(summary, FAST), *_peers(summary)]
    if summary["gap_missed"]:
        cases = counted(len(summary["gap_missed"]), "case")
        said.append(
            f"- **Proof**: the asked gap of {percent(summary['asked_gap'], 0)} is not reached in"
            f" {cases}: {some(summary['gap_missed'])}"
        )
    if summary["open"]:
        said.append(
            f"- **Open**: neither a plan nor a proof that there is none in {some(summary['open'])}"
        )
    said += [*_claims(summary), *_sweeps(scale_rows)]
    said += bullets("**Asked for and not reached**", missed(entries))
    if not said:
        return (
            "**Where evrelax loses:** in none of these rows"
            f" ({counted(summary['cases'], 'case')}) is a peer faster, cheaper or tighter, and"
            " every gap asked for is proved."
        )
    return "\n".join(["**Where evrelax loses.**", "", *said])
