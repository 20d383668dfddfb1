"""Owns intervals: arrays of lower and upper ends, and the exact range of a table on them.

Knows nothing of what the intervals are of.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.maps import Table1, Table2

__all__ = ["EMPTY_MARGIN", "Interval", "grid_values", "pick", "range1", "range2"]

Array = npt.NDArray[np.float64]

OUTWARD = 1e-9
"""Relative and absolute widening of every interval: covers the rounding of its derivation."""
EMPTY_MARGIN = 1e-6
"""An interval counts as empty only when its ends cross by more than this [kWh, K, kW, h]."""


@dataclass(frozen=True)
class Interval:
    """Lower and upper ends of one shape.

    Parameters
    ----------
    lo, hi : ndarray
        Ends, any common shape.

    Examples
    --------
    >>> Interval(np.array([0.0]), np.array([2.0])).mid.tolist()
    [1.0]
    """

    lo: Array
    hi: Array

    @property
    def mid(self) -> Array:
        """Midpoints."""
        return 0.5 * (self.lo + self.hi)

    @property
    def width(self) -> Array:
        """Widths."""
        return self.hi - self.lo

    def meet(self, lo: npt.ArrayLike, hi: npt.ArrayLike) -> Interval:
        """Return the intersection with [lo, hi] (may be empty)."""
        return Interval(np.maximum(self.lo, lo), np.minimum(self.hi, hi))

    def outward(self) -> Interval:
        """Return the interval widened by rounding; ends that crossed by rounding are swapped."""
        lo, hi = self.lo, self.hi
        crossed = (lo > hi) & (lo <= hi + EMPTY_MARGIN)
        if crossed.any():
            lo, hi = np.where(crossed, hi, lo), np.where(crossed, lo, hi)
        return Interval(lo - OUTWARD * (1.0 + np.abs(lo)), hi + OUTWARD * (1.0 + np.abs(hi)))


def pick(x: Interval, on: npt.NDArray[np.bool_]) -> Interval:
    """Return the entries of an interval that a mask selects."""
    return Interval(x.lo[on], x.hi[on])


def _points(grid: Array, values_monotone: bool, lo: Array, hi: Array) -> Array:
    """Candidates for an extremum on [lo, hi]: the ends, and inner nodes unless monotone."""
    if values_monotone:
        return np.stack([lo, hi], axis=-1)
    return np.clip(grid, lo[..., None], hi[..., None])


def range1(table: Table1, x: Interval) -> Interval:
    """Return the exact range of a piecewise linear table on intervals.

    Parameters
    ----------
    table : Table1
        The table; beyond its domain its end values.
    x : Interval, any shape
        Where.

    Examples
    --------
    >>> found = range1(Table1([0, 1, 2], [0, 3, 1]), Interval(np.array([0.5]), np.array([2.0])))
    >>> found.lo.tolist(), found.hi.tolist()
    ([1.0], [3.0])
    """
    if table.monotone:
        ends = np.interp(x.lo, table.x, table.f), np.interp(x.hi, table.x, table.f)
        return Interval(np.minimum(*ends), np.maximum(*ends))
    values = np.interp(_points(table.x, False, x.lo, x.hi), table.x, table.f)
    return Interval(values.min(axis=-1), values.max(axis=-1))


def range2(table: Table2, x: Interval, y: Interval) -> Interval:
    """Return the exact range of a bilinear table on rectangles of shape (n,).

    Extrema of a bilinear function on a cell are at its corners.

    Parameters
    ----------
    table : Table2
        The table; beyond its domain its edge values.
    x, y : Interval, shape (n,)
        Where.

    Examples
    --------
    >>> table = Table2([0, 1], [0, 1], [[0, 1], [2, 3]])
    >>> half = Interval(np.array([0.0]), np.array([0.5]))
    >>> range2(table, half, half).hi.tolist()
    [1.5]
    """
    by_x, by_y = table.monotone
    px, py = _points(table.x, by_x, x.lo, x.hi), _points(table.y, by_y, y.lo, y.hi)
    values = grid_values(table, px, py)
    return Interval(values.min(axis=(-1, -2)), values.max(axis=(-1, -2)))


def grid_values(table: Table2, x: Array, y: Array) -> Array:
    """Return a bilinear table on product grids, shape (n, k, l); its edge values beyond it.

    Parameters
    ----------
    table : Table2
        The table.
    x : ndarray, shape (n, k)
        First coordinates.
    y : ndarray, shape (n, l)
        Second coordinates.

    Examples
    --------
    >>> table = Table2([0, 1], [0, 1], [[0, 1], [2, 3]])
    >>> grid_values(table, np.array([[0.5]]), np.array([[0.0, 1.0]])).tolist()
    [[[1.0, 2.0]]]
    """
    f = table.f
    i = np.searchsorted(table.x[1:-1], x, side="right")
    j = np.searchsorted(table.y[1:-1], y, side="right")
    x0, y0 = table.x[i], table.y[j]
    u = np.minimum(np.maximum((x - x0) / (table.x[i + 1] - x0), 0.0), 1.0)[:, :, None]
    v = np.minimum(np.maximum((y - y0) / (table.y[j + 1] - y0), 0.0), 1.0)[:, None, :]
    corner = i[:, :, None] * f.shape[1] + j[:, None, :]
    # four gathers cost more than all the rest: take is the quickest of them
    low, high, below, above = (
        np.take(f, corner + step, mode="clip") for step in (0, 1, f.shape[1], f.shape[1] + 1)
    )
    below -= low
    below *= u
    low += below
    above -= high
    above *= u
    high += above
    high -= low
    high *= v
    low += high
    return np.asarray(low)
