"""Owns the enumeration of charger subsets. Knows of a trip only its number of chargers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

__all__ = ["Subset", "all_subsets", "neighbours"]

Subset = tuple[int, ...]
"""Indices of used chargers, ascending."""


def all_subsets(n_chargers: int) -> Iterator[Subset]:
    """Yield every subset of ``range(n_chargers)`` once: fewest stops first, then lexicographic.

    Examples
    --------
    >>> list(all_subsets(2))
    [(), (0,), (1,), (0, 1)]
    """
    for size in range(n_chargers + 1):
        yield from combinations(range(n_chargers), size)


def neighbours(subset: Subset, order: Sequence[int], reach: int = 2) -> Iterator[Subset]:
    """Yield subsets that differ by one stop: left out, moved by up to ``reach``, or added.

    Parameters
    ----------
    subset : tuple of int
        Used chargers.
    order : sequence of int
        All chargers in driving order.
    reach : int
        How far a stop is moved along the route, in chargers.

    Examples
    --------
    >>> list(neighbours((1,), [0, 1, 2], reach=1))
    [(), (0,), (2,), (0, 1), (1, 2)]
    """
    place = {charger: k for k, charger in zip(range(len(order)), order, strict=True)}
    for charger in subset:
        rest = tuple(c for c in subset if c != charger)
        yield rest
        for step in (s for d in range(1, reach + 1) for s in (-d, d)):
            to = place[charger] + step
            if 0 <= to < len(order) and order[to] not in subset:
                yield tuple(sorted((*rest, order[to])))
    for charger in order:
        if charger not in subset:
            yield tuple(sorted((*subset, charger)))
