"""Owns the plan of the proofs of a front: which lines, proved once, certify all its points.

A line ``v + c * t >= bound`` within a longest time certifies a point (t, v) if it passes
less than the gap below it. One line can serve many points: the chord between two ends of
a stretch does, where the front is convex, and the longest time makes up for it where it
is not. Arithmetic only; knows nothing of plans and proofs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

__all__ = ["Corner", "Stretch", "make_stretches"]

SLACK = 0.85
"""Share of the gap that a proof is left with: less saves proofs, but each takes longer."""
ROUNDING = 1e-4
"""Share of the gap kept free for rounding."""
FLAT = 0.5
"""Up to this ratio of the weight of time to that of value the gap is kept in value alone;
beyond, in value and time together."""


@dataclass(frozen=True)
class Corner:
    """A point of a front: this value takes this time [h]."""

    time_h: float
    value: float


@dataclass(frozen=True)
class Stretch:
    """A line to prove for every choice of stops, and the points it then certifies.

    Parameters
    ----------
    value_weight, time_weight : float
        value_weight * v + time_weight * t >= bound.
    budget_h : float
        For plans that take at most this time [h].
    bound : float
        To be proved.
    corners : tuple of Corner
        The points.
    flat : tuple of Corner
        Those of them where time is cheap: their gap is kept in value alone.
    """

    value_weight: float
    time_weight: float
    budget_h: float
    bound: float
    corners: tuple[Corner, ...]
    flat: tuple[Corner, ...] = ()


def _line(
    corners: Sequence[Corner], known: Sequence[Corner], gap: float, weight: float, budget_h: float
) -> tuple[float, Stretch]:
    """Return the line of a slope for some points, and the share of the gap a proof is left with."""

    def height(corner: Corner) -> float:
        return corner.value + weight * corner.time_h

    def room(corner: Corner) -> float:
        by_value, by_time = gap * abs(corner.value), gap * weight * corner.time_h
        return by_value if by_time <= FLAT * by_value else by_value + by_time

    bound = max(height(c) - room(c) for c in corners)
    lowest = min((c for c in known if c.time_h <= budget_h), key=height, default=corners[0])
    left = (height(lowest) - bound) / max(room(lowest), 1e-12)
    return left, Stretch(1.0, weight, budget_h, bound, tuple(corners))


def make_stretches(
    front: Sequence[Corner], known: Sequence[Corner], gap: float, latest_h: float
) -> list[Stretch]:
    """Return lines that, once proved, certify every point of a front.

    Parameters
    ----------
    front : sequence of Corner
        Time ascending, value descending.
    known : sequence of Corner
        All plans known: no line may be above one of them.
    gap : float
        Relative gap wanted of every point.
    latest_h : float
        Longest time of interest [h].

    Returns
    -------
    list of Stretch
        The first is about the least time alone, the second about the least value.

    Examples
    --------
    >>> from math import inf
    >>> front = [Corner(0.4, 36.0), Corner(0.5, 34.2), Corner(0.6, 34.1), Corner(0.7, 34.0)]
    >>> [len(s.corners) for s in make_stretches(front, front, 0.01, inf)]
    [1, 1, 2, 1]
    """
    if not front:
        return []
    gap *= 1.0 - ROUNDING
    found: list[Stretch] = []
    last = len(front) - 1
    while last >= 0:
        budget = latest_h if not found else front[last].time_h
        chosen: Stretch | None = None
        for first in range(last, -1, -1):
            lines = [
                _line(front[first : last + 1], known, gap, weight, budget)
                for weight in (_weights(front, first, last) if found else (0.0,))
            ]
            left, line = max(lines, key=lambda pair: pair[0])
            if left >= SLACK or first == last:  # a point by itself is tried in any case
                chosen = line
        assert chosen is not None
        begin = last + 1 - len(chosen.corners)
        flat = tuple(front[k] for k in range(begin, last + 1) if _is_flat(front, k))
        found.append(replace(chosen, flat=flat))
        last = begin - 1
    fastest = front[0].time_h
    if fastest > 0.0:
        near = [c for c in front if c.time_h * (1.0 - gap) <= (1.0 - SLACK * gap) * fastest]
        bound = max(c.time_h for c in near) * (1.0 - gap)
        found.insert(0, Stretch(0.0, 1.0, latest_h, bound, tuple(near)))
    return found


def _slope(front: Sequence[Corner], a: int, b: int) -> float:
    """Return what an hour is worth between two points; 0 beyond the slow end."""
    if b >= len(front):
        return 0.0
    rise = front[b].time_h - front[a].time_h
    return (front[a].value - front[b].value) / rise if rise > 0.0 else 0.0


def _is_flat(front: Sequence[Corner], k: int) -> bool:
    return _slope(front, k, k + 1) * front[k].time_h <= FLAT * abs(front[k].value)


def _weights(front: Sequence[Corner], first: int, last: int) -> list[float]:
    """Weights of time worth trying for a stretch: its chord; for a point alone what lies ahead."""
    if first == last:
        return [0.0, _slope(front, last, last + 1)]
    return [_slope(front, first, last)]
