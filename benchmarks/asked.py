"""Owns what the comparison was meant to reach, and whether it did: one entry per statement.

Figures come from a summary and from rows; nothing is measured here, and no statement is left out
because it is not reached. Ratios are geometric means over cases of one kind, each case a median
of runs that took turns with the peer's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import exp, inf, isfinite, log
from statistics import mean, median

from benchmarks import floor
from benchmarks.cases import GROUPS
from benchmarks.contestants import FAST, OURS
from benchmarks.rows import Row, is_true, number
from benchmarks.runs import ASKED_GAP
from benchmarks.verdicts import Cases, excess, is_as_claimed, judged_cost, latest
from benchmarks.words import counted

__all__ = ["COST_ABOVE_PEERS", "RATIOS", "TIMES_FLOOR", "asked", "asked_section", "missed"]

COST_ABOVE_PEERS = 5e-4
"""Our cost may be above the best of all peers by this share."""
RATIOS = (
    ("fatrop", "with", 2.0),
    ("fatrop", "without", 1.0),
    ("ipopt", "with", 5.0),
    ("bonmin", "with", 20.0),
)
"""Peer, with or without its building, and the least multiple of our time that it should take."""
TIMES_FLOOR = 2.0
"""Our time over the solver's own, at most."""
LATE = "scip-our-time"
"""The peer that is stopped when we have finished."""
WAYS = {"with": "its building counted", "without": "built before"}


def _entry(
    words: str, measured: str, reached: bool | None, about: str = "", short: str = ""
) -> Row:
    return {
        "words": words, "measured": measured, "reached": reached, "about": about, "short": short
    }  # fmt: skip


def _costs(cases: Cases) -> Iterator[Row]:
    """Yield how far each of ours is above the best peer, at worst."""
    for ours in (FAST, OURS):
        apart: dict[str, float] = {}
        for case, by in cases.items():
            others = [judged_cost(row) for row in by.values() if row["kind"] != "ours"]
            best = min(others, default=inf)
            if ours in by and isfinite(best):
                apart[case] = excess(judged_cost(by[ours]), best)
        if not apart:
            continue
        worst = max(apart, key=lambda case: apart[case])
        beyond = sum(value > COST_ABOVE_PEERS for value in apart.values())
        above = f"{100.0 * apart[worst]:+.4f} %" if isfinite(apart[worst]) else "no plan"
        yield _entry(
            f"cost of `{ours}` at most {100.0 * COST_ABOVE_PEERS:g} % above the best of all others",
            f"worst of {counted(len(apart), 'case')}: {above} (`{worst}`)",
            not beyond,
            f"cost at most {100.0 * COST_ABOVE_PEERS:g} % above the best of all others",
            f"missed by `{ours}` in {beyond} of {len(apart)} cases",
        )


def _confirmed(cases: Cases) -> Iterator[Row]:
    """Yield how many plans of peers the judge confirms."""
    rows = [row for by in cases.values() for row in by.values() if row["kind"] == "peer"]
    plans = [row for row in rows if row["outcome"] not in ("none", "stopped")]
    if not plans:
        return
    holds = [row for row in plans if isfinite(judged_cost(row))]
    right = [row for row in holds if is_as_claimed(row)]
    words = (
        f"of {counted(len(plans), 'plan')} hold when driven: {len(holds)}; of these as claimed:"
        f" {len(right)}"
    )
    if len(rows) > len(plans):
        words += f"; {counted(len(rows) - len(plans), 'run')} ended without a plan"
    yield _entry("the peers' costs confirmed by the judge", words, None)


def _by_group(ratios: dict[str, float]) -> dict[str, list[float]]:
    """Return the values by kind of case, in the order of the kinds."""
    found = {
        group: [v for case, v in ratios.items() if case.split("/", 1)[0] == group]
        for group in GROUPS
    }
    return {group: values for group, values in found.items() if values}


def _mean(values: list[float]) -> float:
    return exp(mean(map(log, values)))


def _ratios(summary: Row) -> Iterator[Row]:
    """Yield the multiples of our certified time that peers take, by kind of case."""
    against = {(a["peer"], a["ours"]): a for a in summary["against"]}
    for peer, way, least in RATIOS:
        found, alone = (
            _by_group(against.get((peer, ours), {}).get(f"ratios_{way}_build", {}))
            for ours in (OURS, FAST)
        )
        for group, own in found.items():
            ratio, below = _mean(own), sum(value < least for value in own)
            words = (
                f"{ratio:.2f} ({min(own):.2f} to {max(own):.2f}); below in {below} of "
                f"{len(own)} cases"
            )
            together = against[peer, OURS]["together"]
            apart = len(own) - sum(case.split("/", 1)[0] == group for case in together)
            if apart:
                words += f"; in {apart} of them not measured in one run"
            if group in alone:
                words += f"; without an asked proof {_mean(alone[group]):.2f}"
            yield _entry(
                f"`{peer}` over `{OURS}`, {WAYS[way]}, {group}: at least {least:g}",
                words,
                ratio >= least,
                f"time of `{peer}`, {WAYS[way]}, at least {least:g} times that of `{OURS}`",
                f"{ratio:.2f} on {group} cases",
            )


def _late(cases: Cases) -> Iterator[Row]:
    """Yield what SCIP has at our finishing time."""
    own = {case: by[LATE] for case, by in cases.items() if LATE in by}
    if not own:
        return
    gaps = []
    for case, row in own.items():
        cost = min(judged_cost(other) for other in cases[case].values())
        bound = number(row, "lower_bound")
        if isfinite(cost) and 0.0 < bound < inf:
            gaps.append(-excess(bound, cost))
    plans = sum(is_true(row, "feasible") for row in own.values())
    words = f"a plan in {plans} of {len(own)} cases, a bound above zero in {len(gaps)}"
    if gaps:
        words += (
            f"; that bound is {100.0 * median(gaps):.1f} % (median; {100.0 * min(gaps):.1f} to "
            f"{100.0 * max(gaps):.1f} %) below the best known cost"
        )
    yield _entry("SCIP's gap at our finishing time reported", words, None)


def _floor(rows: list[Row]) -> Iterator[Row]:
    for f in floor.summarise(rows):
        gap = "no gap asked for" if f["asked_gap"] is None else f"{100.0 * f['asked_gap']:g} % gap"
        yield _entry(
            f"our time at most {TIMES_FLOOR:g} times the solver's own, {gap}",
            f"{f['times_floor']:.2f} ({f['least']:.2f} to {f['largest']:.2f}) on"
            f" {counted(f['cases'], 'case')}",
            f["times_floor"] <= TIMES_FLOOR,
            f"our time at most {TIMES_FLOOR:g} times Clarabel's own",
            f"{f['times_floor']:.2f} with {gap}",
        )


def asked(summary: Row, rows: Iterable[Row], floor_rows: list[Row]) -> list[Row]:
    """Return what was asked for, what was measured, and whether it is reached.

    Parameters
    ----------
    summary : dict
        From ``summary.summarise``.
    rows : iterable of dict
        Of the comparison.
    floor_rows : list of dict
        Of ``benchmarks.floor``; may be empty.

    Returns
    -------
    list of dict
        ``words``, ``measured``, ``reached`` (None where only a figure was asked for), and if
        it is not what it is ``about`` and the figure in ``short``.
    """
    cases = latest(rows)
    return [
        *_costs(cases),
        *_confirmed(cases),
        *_ratios(summary),
        *_late(cases),
        *_floor(floor_rows),
    ]


def missed(entries: Iterable[Row]) -> list[str]:
    """Return a few words on everything that is not reached.

    Examples
    --------
    >>> missed([_entry("a", "1", True, "x", "1"), _entry("b", "2", False, "y", "2"),
    ...     _entry("c", "3", False, "y", "3")])
    ['y: 2, 3']
    """
    found: dict[str, list[str]] = {}
    for entry in entries:
        if entry["reached"] is False:
            found.setdefault(entry["about"], []).append(entry["short"])
    return [f"{about}: {', '.join(short)}" for about, short in found.items()]


def asked_section(entries: list[Row]) -> list[str]:
    """Return the table of what was asked for; nothing without entries."""
    if not entries:
        return []
    lines = [
        "## What was asked for",
        "",
        "Set before anything was measured. Ratios are geometric means over cases in which our"
        f" proof of {100.0 * ASKED_GAP:g} % is complete, with the least and the largest; *without"
        f" an asked proof* is the same over `{FAST}`. Enumerations that the time limit cut count"
        " with the time until then.",
        "",
        "| asked for | measured | reached |",
        "|---|---|---|",
    ]
    said = {True: "yes", False: "**no**", None: "-"}
    lines += [f"| {e['words']} | {e['measured']} | {said[e['reached']]} |" for e in entries]
    return lines
