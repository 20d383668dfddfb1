"""Owns how a box is cut in two: along an interval, by using a stop or not, by the number of stops.

Both parts together hold every feasible trajectory of the whole. Knows nothing of
programs, bounds and solvers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from relax.box import Box
from relax.intervals import Interval

__all__ = ["Branch", "Target", "branch", "decide", "limit_count", "with_interval"]

STOP_FIELDS = (
    "charge", "arrive", "leave", "stop_temperature", "dwell", "stay", "after", "after_temperature",
)  # fmt: skip
"""Intervals of a box with one entry or row per stop."""


@dataclass(frozen=True)
class Target:
    """An entry of a box, and the variables of the relaxation that add up to it.

    Parameters
    ----------
    name : str
        Field of ``Box``.
    index : int or tuple of int
        Entry.
    variable : str
        Name of the columns.
    """

    name: str
    index: int | tuple[int, int]
    variable: str


@dataclass(frozen=True)
class Branch:
    """How to cut a box in two.

    Parameters
    ----------
    kind : str
        ``"halve"`` an interval, ``"use"`` a stop or not, or ``"count"`` the stops.
    target : Target or None
        What is halved.
    at : float
        Where; for ``"count"`` the largest number of stops of the first part.
    stop : int
        The stop in question.
    """

    kind: str
    target: Target | None = None
    at: float = 0.0
    stop: int = -1


def with_interval(box: Box, name: str, interval: Interval) -> Box:
    """Return the box with another interval."""
    changes: dict[str, Any] = {name: interval}
    return replace(box, **changes)


def limit_count(box: Box, least: int, most: int) -> Box:
    """Return the part of a box with at least and at most so many used stops."""
    return replace(box, count=(max(box.count[0], least), min(box.count[1], most)))


def decide(box: Box, stop: int, use: bool) -> Box:
    """Return the part of a box where an optional stop is used, or where it is left out.

    Parameters
    ----------
    box : Box
        With the stop optional.
    stop : int
        Its index.
    use : bool
        Whether it is used; if not, it is gone from the box and later stops move up.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> box = make_box(make_instance(load_trip("paper-400km"), (1,), undecided=(0, 2)))
    >>> decide(box, 0, True).optional.tolist(), decide(box, 0, False).optional.tolist()
    ([False, False, True], [False, True])
    """
    if use:
        optional = box.optional.copy()
        optional[stop] = False
        leave, end = box.leave, box.stop_temperature
        after = Interval(box.after.lo.copy(), box.after.hi.copy())
        warm = Interval(box.after_temperature.lo.copy(), box.after_temperature.hi.copy())
        after.lo[stop] = max(after.lo[stop], leave.lo[stop])
        after.hi[stop] = min(after.hi[stop], leave.hi[stop])
        warm.lo[stop] = max(warm.lo[stop], end.lo[stop, -1])
        warm.hi[stop] = min(warm.hi[stop], end.hi[stop, -1])
        return replace(box, optional=optional, after=after, after_temperature=warm)
    keep = np.arange(box.optional.size) != stop
    kept: dict[str, Any] = {"optional": box.optional[keep], "node": box.node[keep]}
    for name in STOP_FIELDS:
        whole: Interval = getattr(box, name)
        kept[name] = Interval(whole.lo[keep], whole.hi[keep])
    return replace(box, **kept)


def branch(box: Box, how: Branch) -> tuple[Box, Box]:
    """Return both parts of a box.

    Parameters
    ----------
    box : Box
        The whole.
    how : Branch
        Where to cut.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> box = make_box(make_instance(load_trip("paper-400km"), (1,)))
    >>> low, high = branch(box, Branch("halve", Target("charge", 0, "charge"), 30.0))
    >>> float(low.charge.hi[0]), float(high.charge.lo[0])
    (30.0, 30.0)
    """
    if how.kind == "use":
        return decide(box, how.stop, True), decide(box, how.stop, False)
    if how.kind == "count":
        at = int(how.at)
        return limit_count(box, 0, at), limit_count(box, at + 1, box.optional.size)
    assert how.target is not None
    whole: Interval = getattr(box, how.target.name)
    halves = []
    for upper in (False, True):
        ends = whole.lo.copy(), whole.hi.copy()
        ends[0 if upper else 1][how.target.index] = how.at
        halves.append(with_interval(box, how.target.name, Interval(*ends)))
    return halves[0], halves[1]
