"""Owns which plans are a front, and where the front needs more of them. Arithmetic only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import hypot
from typing import Protocol, TypeVar

from enumerate.subset import Subset

__all__ = ["improves", "next_times", "spread"]

LEAST_STEP = 1 / 400
"""Share of the front's time below which two points count as one: an upright part."""
SAME = 1e-6
"""Relative difference of values below which the faster of two plans dominates."""


class Placed(Protocol):
    """What has a time, a value and a choice of stops."""

    @property
    def time_h(self) -> float:
        """Charging and detours [h]."""

    @property
    def value(self) -> float:
        """Energy or cost."""

    @property
    def subset(self) -> Subset:
        """Chargers used."""


P = TypeVar("P", bound=Placed)


def improves(value: float, on: float) -> bool:
    """Return whether a value is below another by more than rounding.

    Examples
    --------
    >>> improves(29.9, 30.0), improves(30.0 - 1e-9, 30.0)
    (True, False)
    """
    return value < on - SAME * max(abs(on), 1.0)


def spread(plans: Iterable[P]) -> list[P]:
    """Return the plans that no other dominates, by time; of near twins the better one.

    Parameters
    ----------
    plans : iterable
        With ``time_h``, ``value`` and ``subset``.

    Examples
    --------
    >>> from collections import namedtuple
    >>> Plan = namedtuple("Plan", "time_h value subset")
    >>> [p.time_h for p in spread([Plan(0.5, 3, ()), Plan(0.6, 4, ()), Plan(0.7, 2, ())])]
    [0.5, 0.7]
    """
    front: list[P] = []
    for plan in sorted(plans, key=lambda p: (p.time_h, p.value, len(p.subset), p.subset)):
        if not front or improves(plan.value, front[-1].value):
            front.append(plan)
    if len(front) < 3:
        return front
    least = LEAST_STEP * (front[-1].time_h - front[0].time_h)
    kept = front[:1]
    for plan in front[1:]:
        twins = plan.time_h - kept[-1].time_h < least
        if twins and len(kept) == 1 and plan is not front[-1]:
            continue  # the least time stays
        if twins and len(kept) > 1:
            kept.pop()
        kept.append(plan)
    return kept


def next_times(plans: Iterable[P], tried_h: Sequence[float], count: int) -> list[float]:
    """Return the times that halve the longest parts of the front as it is [h].

    Parameters
    ----------
    plans : iterable
        With ``time_h``, ``value`` and ``subset``.
    tried_h : sequence of float
        Times looked at before, whether or not a plan of the front was there [h].
    count : int
        How many times at most.

    Examples
    --------
    >>> from collections import namedtuple
    >>> Plan = namedtuple("Plan", "time_h value subset")
    >>> next_times([Plan(0.0, 3, ()), Plan(1.0, 2, ())], [0.5], 1)
    [0.75]
    """
    front = spread(plans)
    if len(front) < 2:
        return []
    span = front[-1].time_h - front[0].time_h
    height = front[0].value - front[-1].value
    corners = {(p.time_h, p.value) for p in front}
    for budget in tried_h:
        corners.add((budget, min((p.value for p in front if p.time_h <= budget), default=0.0)))
    ends = sorted(corner for corner in corners if corner[0] >= front[0].time_h)
    found: list[float] = []
    for _ in range(max(count, 0)):
        wide = [
            (hypot((b[0] - a[0]) / span, (a[1] - b[1]) / height), a, b)
            for a, b in pairwise(ends)
            if b[0] - a[0] > 2.0 * LEAST_STEP * span and a[1] > b[1]
        ]
        if not wide:
            break
        _, a, b = max(wide)
        middle = (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]))
        ends = sorted([*ends, middle])
        found.append(middle[0])
    return found
