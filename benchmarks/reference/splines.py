"""Owns smooth twins of the lookup tables: cubic splines that CasADi can differentiate.

An interior-point method wants two continuous derivatives, the tables have
none. Each table is fitted by least squares along its *segments*, not at its
nodes, so that the spline lies on average on the table and not beside its
chords; the knots are as few as the tolerance allows, because every knot costs time in
every iteration of the peer. Knows nothing of programs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy.interpolate import PPoly, make_lsq_spline

from relax.maps import Table1, Table2

__all__ = ["Spline", "SplineSum", "cut", "fit_curve", "fit_spline", "fit_surface"]

Array = npt.NDArray[np.float64]

FIT_TOLERANCE = 2e-3
"""Largest error along the table, as a share of the size it refers to. The chords of the
shipped tables are off their own smooth originals by half of this."""
RANK_TOLERANCE = 2e-4
"""Singular values below this share of the largest are dropped from a surface."""
MAX_KNOTS = 20
"""Inner knots of a spline at most; a kink sharper than that stays rounded."""
SAMPLES = 300
"""Points at which a table is compared with its spline."""
AFFINE_TOLERANCE = 1e-9
"""Share of the largest value within which a table counts as affine."""


@dataclass(frozen=True)
class Spline:
    """Piecewise cubic: sum_i c_i t^i + sum_m a_m max(0, t - t_m)^3 with t = (x - lo) / width.

    Parameters
    ----------
    lo, width : float
        Normalisation of the argument.
    coefficients : tuple of float
        Polynomial of the first piece, constant first.
    knots, jumps : tuple of float
        Inner knots (normalised) and the jump of the cubic coefficient at each.

    Examples
    --------
    >>> Spline(0.0, 2.0, (1.0, 2.0), (), ())(1.0)
    2.0
    """

    lo: float
    width: float
    coefficients: tuple[float, ...]
    knots: tuple[float, ...]
    jumps: tuple[float, ...]

    def __call__(self, x: Any) -> Any:
        """Return the value at a number, an array or a CasADi expression."""
        t = (x - self.lo) / self.width
        value: Any = self.coefficients[-1]
        for c in self.coefficients[-2::-1]:
            value = value * t + c
        positive = ca.fmax if isinstance(t, ca.SX | ca.MX) else np.maximum
        for knot, jump in zip(self.knots, self.jumps, strict=True):
            u = positive(t - knot, 0.0)
            value = value + jump * (u * u * u)
        return value


@dataclass(frozen=True)
class SplineSum:
    """Surface sum_r f_r(x) * g_r(y) of one-dimensional splines.

    Parameters
    ----------
    terms : tuple of pairs of Spline
        The factors of every term.

    Examples
    --------
    >>> line = Spline(0.0, 1.0, (0.0, 1.0), (), ())
    >>> SplineSum(((line, line),))(2.0, 3.0)
    6.0
    """

    terms: tuple[tuple[Spline, Spline], ...]

    def __call__(self, x: Any, y: Any) -> Any:
        """Return the value at a point of numbers, arrays or CasADi expressions."""
        value: Any = 0.0
        for f, g in self.terms:
            value = value + f(x) * g(y)
        return value


def _cubic(t: Array, value: Array, size: Array, knots: Array) -> tuple[Array, Array, Array]:
    """Fit on [0, 1] with inner ``knots``; returns coefficients, jumps, errors over ``size``."""
    borders = np.concatenate([[0.0] * 4, knots, [1.0] * 4])
    spline = make_lsq_spline(t, value, borders, k=3, w=1.0 / size)
    pieces = PPoly.from_spline(spline.tck)
    cubic = pieces.c[:, np.diff(pieces.x) > 0.0]
    return cubic[::-1, 0], np.diff(cubic[0]), np.abs(spline(t) - value) / size


def _spread(nodes: Array, f: Array, count: int) -> Array:
    """Return ``count`` inner knots on [0, 1], denser where the table bends."""
    if nodes.size < 3:
        return np.linspace(0.0, 1.0, count + 2)[1:-1]
    slope = np.diff(f) / np.diff(nodes)
    bend = np.abs(np.diff(slope)) / (0.5 * (nodes[2:] - nodes[:-2]))
    density = np.interp(np.linspace(0.0, 1.0, SAMPLES), nodes[1:-1], np.sqrt(bend))
    density += 0.3 * density.mean()
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    share = np.linspace(0.0, 1.0, count + 2)[1:-1]
    return np.interp(share, mass / mass[-1], np.linspace(0.0, 1.0, SAMPLES))


def fit_spline(
    x: Array, f: Array, size: float | None = None, tolerance: float = FIT_TOLERANCE
) -> Spline:
    """Return a cubic spline near the piecewise linear function with nodes (x, f).

    Parameters
    ----------
    x, f : ndarray, shape (n,)
        Nodes and values.
    size : float, optional
        Size of a value to which the tolerance refers; by default its own, where
        all values are positive, else the largest.
    tolerance : float
        Largest error.

    Returns
    -------
    Spline
        Affine where the table is; else with the fewest knots that hold the tolerance,
        or ``MAX_KNOTS``.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 10.0, 21)
    >>> spline = fit_spline(x, np.exp(-0.1 * x))
    >>> bool(abs(spline(5.0) - np.exp(-0.5)) < 1e-3), len(spline.knots) < 4
    (True, True)
    """
    lo, width = float(x[0]), float(x[-1] - x[0])
    nodes = (x - lo) / width
    t = np.linspace(0.0, 1.0, SAMPLES)
    value = np.interp(t, nodes, f)
    largest = float(np.abs(f).max())
    if size is not None:
        sizes = np.full(SAMPLES, size)
    elif f.min() > 0.0:
        sizes = value
    else:
        sizes = np.full(SAMPLES, largest or 1.0)
    rise = float(f[-1] - f[0])
    if float(np.abs(f - f[0] - rise * nodes).max()) <= AFFINE_TOLERANCE * largest:
        return Spline(lo, width, (float(f[0]), rise), (), ())
    for count in range(MAX_KNOTS + 1):
        knots = _spread(nodes, f, count)
        coefficients, jumps, error = _cubic(t, value, sizes, knots)
        if error.max() <= tolerance:
            break
    return Spline(
        lo, width, tuple(coefficients.tolist()), tuple(knots.tolist()), tuple(jumps.tolist())
    )


def cut(grid: Array, lo: float, hi: float) -> Array:
    """Return the nodes of a table's axis on [lo, hi] within its domain."""
    lo, hi = max(lo, float(grid[0])), min(hi, float(grid[-1]))
    apart = 1e-6 * (hi - lo)  # a node that is an end but for rounding is no node of its own
    return np.concatenate([[lo], grid[(grid > lo + apart) & (grid < hi - apart)], [hi]])


def fit_curve(table: Table1, lo: float, hi: float) -> Spline:
    """Return the spline of a table on the part [lo, hi] of its domain.

    Examples
    --------
    >>> from relax.maps import Table1
    >>> fit_curve(Table1([0.0, 4.0], [1.0, 3.0]), 1.0, 2.0)(1.5)
    1.75
    """
    x = cut(table.x, lo, hi)
    return fit_spline(x, table(x))


def fit_surface(table: Table2, x_lo: float, x_hi: float, y_lo: float, y_hi: float) -> SplineSum:
    """Return a sum of products of splines near a bilinear table, on a rectangle.

    The table's singular value decomposition gives the products: two or three
    terms for the power limits of batteries.

    Examples
    --------
    >>> import numpy as np
    >>> from relax.maps import Table2
    >>> x = np.linspace(0.0, 1.0, 11)
    >>> surface = fit_surface(Table2(x, x, np.outer(1.0 + x, 2.0 - x)), 0.0, 1.0, 0.0, 1.0)
    >>> len(surface.terms), round(float(surface(0.5, 0.5)), 9)
    (1, 2.25)
    """
    x, y = cut(table.x, x_lo, x_hi), cut(table.y, y_lo, y_hi)
    values = table(*np.meshgrid(x, y, indexing="ij"))
    left, singular, right = np.linalg.svd(values, full_matrices=False)
    rank = int(np.count_nonzero(singular > RANK_TOLERANCE * singular[0]))
    largest = float(np.abs(values).max())
    terms = []
    for r in range(rank):
        u, v = np.sqrt(singular[r]) * left[:, r], np.sqrt(singular[r]) * right[r]
        size_u, size_v = largest / float(np.abs(v).max()), largest / float(np.abs(u).max())
        terms.append((fit_spline(x, u, size_u), fit_spline(y, v, size_v)))
    return SplineSum(tuple(terms))
