"""Owns the enumeration of charger subsets. Knows of a trip only its number of chargers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

__all__ = ["Subset", "all_subsets"]

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
