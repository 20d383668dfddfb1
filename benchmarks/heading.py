"""Owns what the benchmark page says of its measurements as a whole: when, where, what compares.

Times of different runs, and costs by different versions of the judge: whether it matters is found
in rows that were measured twice. Knows nothing of who is faster.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, log
from statistics import median

from benchmarks.contestants import OURS
from benchmarks.judges import SAME_COST, is_same_plan, moved
from benchmarks.rows import Row, number
from benchmarks.runs import ASKED_GAP
from benchmarks.verdicts import latest
from benchmarks.words import counted, percent, some

__all__ = ["head"]

TIMED_TWICE_S = 0.1
"""Shorter proofs are left out where two runs are held against each other [s]."""


def _two_loads(rows: Iterable[Row], proof_rows: Iterable[Row]) -> str:
    """Return how the times of the same proofs in two result files differ."""
    cases, found = latest(rows), {}
    alone = [r for r in proof_rows if number(r, "workers") == 1]
    last = {(r["case"], number(r, "asked_gap")): r for r in alone}
    for (case, asked), there in last.items():
        here = cases.get(case, {}).get(OURS)
        if here is None or asked != ASKED_GAP:
            continue
        if number(here, "programs") != number(there, "programs"):  # not the same work
            continue
        if min(number(here, "total_s"), number(there, "total_s")) > TIMED_TWICE_S:
            found[case] = (number(here, "total_s"), number(there, "total_s"))
    if not found:
        return ""
    ratios = {case: here / there for case, (here, there) in found.items()}
    worst = max(ratios, key=lambda case: abs(log(ratios[case])))
    return (
        f" `proofs.csv`, of another run, has {counted(len(found), 'proof')} to"
        f" {percent(ASKED_GAP, 0)} with the same number of programs as here: the times here are"
        f" {min(ratios.values()):.2f} to {max(ratios.values()):.2f} times those there, median"
        f" {median(ratios.values()):.2f} (`{worst}`: {found[worst][0]:.1f} s here,"
        f" {found[worst][1]:.1f} s there)."
    )


def _judged_again(judges: list[str], judge_rows: Iterable[Row]) -> str:
    """Return whether it matters that the judge changed; nothing if it did not."""
    if len(judges) < 2:
        return ""
    said = f"The code of the judge changed between rows: {len(judges)} versions of it."
    same = [row for row in judge_rows if row["judge"] in judges and is_same_plan(row)]
    if not same:
        return said + " Whether that moves a cost was not measured (`python -m benchmarks.judges`)."
    apart = max(map(moved, same))
    missing = [judge for judge in judges if all(row["judge"] != judge for row in same)]
    said += (
        f" `python -m benchmarks.judges` made {counted(len(same), 'plan')} anew and judged"
        f" {'it' if len(same) == 1 else 'them'} by the judge of {same[-1]['date']}"
        f" (`{'`, `'.join(sorted({row['judge_now'] for row in same}))}`): "
    )
    if apart <= SAME_COST:
        said += f"no verdict changed and no cost moved by more than {apart:.0e} (relative)."
    elif apart < inf:
        said += f"costs moved by up to {apart:.0e} (relative)."
    else:
        bad = [row["case"] for row in same if moved(row) == inf]
        said += f"the verdict changed in {some(bad)}."
    if missing:
        said += f" No row of {some(missing)} was among them."
    return said


def head(
    summary: Row, rows: Iterable[Row], proof_rows: Iterable[Row], judge_rows: Iterable[Row]
) -> list[str]:
    """Return when, where and with what it was measured, and what can be compared."""
    dates, rows = summary["dates"], list(rows)
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    machine = "; ".join(summary["processors"])
    packages = "; ".join(
        dict.fromkeys(text.replace(" evrelax=not installed", "") for text in summary["versions"])
    )
    loose = any("not installed" in text or "+checkout" in text for text in summary["versions"])
    checkout = "; evrelax was run from a checkout, whose state the digests below name"
    checkout = checkout if loose else ""
    runs = len({row["run"] for by in latest(rows).values() for row in by.values()})
    lines = [
        f"Written by `python -m benchmarks.report`; do not edit. Measured on {when} on {machine}"
        f" with {packages}{checkout}. One thread, one core.",
        "",
        f"The machine is shared. The rows are of {counted(runs, 'run')}, each under its own load,"
        " and so are those of the other result files: times of different runs cannot be compared,"
        " only ratios of times of one run." + _two_loads(rows, proof_rows),
    ]
    judged = _judged_again(summary["judges"], judge_rows)
    return [*lines, "", judged] if judged else lines
