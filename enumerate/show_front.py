"""Owns a front as text for people: the table of its points and what its columns mean.

Reads a ``Front``; decides nothing. What is not known is shown as ``-``, never as 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from enumerate.front import Front
from enumerate.table import NO_BREAK, number, paragraph, percent, table, unbroken

__all__ = ["format_front"]

LEAST_DIGITS, MOST_DIGITS = 2, 5
"""Digits behind the point of a front's values."""


def format_front(front: Front) -> str:
    """Return a front as a table, with the digits that tell neighbours apart.

    Parameters
    ----------
    front : Front
        From ``pareto``.

    Returns
    -------
    str
        Lines of at most 80 characters, without a newline at the end.

    Examples
    --------
    >>> from math import inf
    >>> nothing = Front("t", "energy", "kWh", (), {}, (), (), None, "time limit reached", {})
    >>> format_front(nothing)
    't: no plan found (time limit reached)'
    """
    if not front.points:
        why = f" ({front.interrupted})" if front.interrupted else ""
        return f"{front.trip}: no plan found{why}"
    digits = _digits([p.value for p in front.points])
    head = ["time\nmin", front.unit, f"bound\n{front.unit}", "gap\n%", "front\ngap %", "stops"]
    rows = [
        [
            number(60.0 * p.time_h, 2),
            number(p.value, digits),
            number(p.lower_bound, digits),
            percent(p.gap),
            percent(p.front_gap),
            f" +{NO_BREAK}".join(map(unbroken, p.stops)) or "none",
        ]
        for p in front.points
    ]
    notes = [
        ("time", "charging and detours."),
        ("bound", "no plan within this time undercuts it; gap: its distance."),
        ("front", f"no plan is better by more than this share in both time and {front.measure}."),
    ]
    if front.interrupted:
        notes.append(("", f"Not complete: {front.interrupted}."))
    return "\n".join(
        [
            paragraph("", f"{front.trip}: {front.measure} against time", 0),
            "",
            table(head, rows, words_last=True),
            "",
            *(paragraph(label, text) for label, text in notes),
        ]
    )


def _digits(values: Sequence[float]) -> int:
    """Return the fewest digits with which neighbours do not look alike."""
    for digits in range(LEAST_DIGITS, MOST_DIGITS):
        shown = [number(value, digits) for value in values]
        if all(a != b for a, b in pairwise(shown)):
            return digits
    return MOST_DIGITS
