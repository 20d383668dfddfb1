"""Owns how the benchmark pages write figures: shares, numbers, counts, names of cases, lists."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["bullets", "counted", "percent", "plain", "some"]

NAMED = 3
"""Cases that a sentence names at most."""


def percent(share: float | None, digits: int = 2) -> str:
    """Return a share in percent; a dash if there is none.

    Examples
    --------
    >>> percent(0.0123), percent(None)
    ('1.23 %', '-')
    """
    return "-" if share is None else f"{100.0 * share:.{digits}f} %"


def plain(value: float | None, digits: int = 2) -> str:
    """Return a number; a dash if there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def counted(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun.

    Examples
    --------
    >>> counted(1, "case"), counted(2, "case"), counted(0, "entry", "entries")
    ('1 case', '2 cases', '0 entries')
    """
    return f"{number} {one if number == 1 else many or one + 's'}"


def some(cases: Sequence[str]) -> str:
    """Return the first few cases by name and the number of the others.

    Examples
    --------
    >>> some(["a", "b", "c", "d"])
    '`a`, `b`, `c` and 1 more'
    """
    more = f" and {len(cases) - NAMED} more" if len(cases) > NAMED else ""
    return ", ".join(f"`{case}`" for case in cases[:NAMED]) + more


def bullets(lead: str, items: Sequence[str]) -> list[str]:
    """Return a point of a list: its items below it if there are several, nothing without.

    Examples
    --------
    >>> bullets("**Cost**", ["a", "b"])
    ['- **Cost**:', '  - a', '  - b']
    >>> bullets("**Cost**", ["a"]), bullets("**Cost**", [])
    (['- **Cost**: a'], [])
    """
    if len(items) == 1:
        return [f"- {lead}: {items[0]}"]
    return [f"- {lead}:", *(f"  - {item}" for item in items)] if items else []
