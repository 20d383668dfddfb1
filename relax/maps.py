"""Owns lookup tables: (multi)linear interpolation on a declared domain, never beyond it.

The table *is* the model: relaxation, refinement and replay read the same
numbers. First derivatives are the table's, averaged over a narrow window, which
is what a Newton-type method needs at a kink. Knows nothing of what the maps mean.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from relax.errors import DomainError

__all__ = ["DOMAIN_SLACK", "Table1", "Table2"]

Array = npt.NDArray[np.float64]
Cells = npt.NDArray[np.intp]

WINDOW = 0.1
"""Half-width of the window over which slopes are averaged, in cells."""
DOMAIN_SLACK = 1e-9
"""Relative overshoot of a table's domain that is rounding, not extrapolation."""


def _grid(values: Sequence[float] | Array, name: str) -> Array:
    grid = np.array(values, dtype=np.float64)
    if grid.ndim != 1 or grid.size < 2:
        raise ValueError(f"{name}: a table axis needs at least 2 nodes")
    if not np.all(np.isfinite(grid)) or np.any(np.diff(grid) <= 0):
        raise ValueError(f"{name}: a table axis must be finite and strictly increasing")
    grid.setflags(write=False)
    return grid


def _slopes(x: Array, f: Array, axis: int = 0) -> Array:
    """Node slopes: mean of the two adjoining segments' slopes, one-sided at the ends."""
    f = np.moveaxis(f, axis, 0)
    step = np.diff(x).reshape(-1, *([1] * (f.ndim - 1)))
    slope = np.diff(f, axis=0) / step
    out = np.concatenate([slope[:1], 0.5 * (slope[1:] + slope[:-1]), slope[-1:]])
    return np.moveaxis(out, 0, axis)


def _monotone(f: Array, axis: int) -> bool:
    """Whether values never fall or never rise along an axis."""
    step = np.diff(f, axis=axis)
    return bool((step >= 0.0).all() or (step <= 0.0).all())


def _locate(grid: Array, x: Array, name: str) -> tuple[npt.NDArray[np.intp], Array]:
    """Cell index and weight in [0, 1] of every point; raises off the domain."""
    if x.size:
        slack = DOMAIN_SLACK * (grid[-1] - grid[0])
        lo, hi = x.min(), x.max()
        if not (lo >= grid[0] - slack and hi <= grid[-1] + slack):  # also if one is no number
            raise DomainError(
                f"{name} at {lo:g} .. {hi:g} is outside the table {grid[0]:g} .. {grid[-1]:g}"
            )
    index = np.searchsorted(grid[1:-1], x, side="right")
    left = grid[index]
    weight = (x - left) / (grid[index + 1] - left)
    return index, np.minimum(np.maximum(weight, 0.0), 1.0)


def _window(x: Array, half: float, lo: float, hi: float) -> Array:
    """Return points and the ends of the window around them, shape (3, *x.shape)."""
    return np.stack([x, np.maximum(x - half, lo), np.minimum(x + half, hi)])


def _blend1(f: Array, i: Cells, w: Array) -> Array:
    """Return linear interpolation of node values between nodes i and i + 1."""
    return np.asarray(f[i] * (1.0 - w) + f[i + 1] * w)


def _blend2(f: Array, i: Cells, u: Array, j: Cells, v: Array) -> Array:
    """Return bilinear interpolation of node values, shape (..., n, m)."""
    width = f.shape[-1]
    flat, corner = f.reshape(*f.shape[:-2], -1), i * width + j
    # one gather over flat indices is quicker than one over two
    low = (1.0 - v) * flat.take(corner, -1) + v * flat.take(corner + 1, -1)
    corner = corner + width
    high = (1.0 - v) * flat.take(corner, -1) + v * flat.take(corner + 1, -1)
    return np.asarray((1.0 - u) * low + u * high)


@dataclass(frozen=True)
class Table1:
    """Piecewise linear function of one variable.

    Parameters
    ----------
    x : array_like, shape (n,)
        Nodes, strictly increasing, n >= 2.
    f : array_like, shape (n,)
        Values at the nodes.
    name : str
        Used in error messages.

    Raises
    ------
    ValueError
        Shapes differ or a number is not finite.

    Examples
    --------
    >>> table = Table1([0.0, 1.0, 3.0], [1.0, 2.0, 0.0])
    >>> float(table(2.0)), table.at(0.5)
    (1.0, 1.5)
    """

    x: Array
    f: Array
    name: str = field(default="table")

    def __init__(
        self, x: Sequence[float] | Array, f: Sequence[float] | Array, name: str = "table"
    ) -> None:
        object.__setattr__(self, "x", _grid(x, name))
        values = np.array(f, dtype=np.float64)
        if values.shape != self.x.shape or not np.all(np.isfinite(values)):
            raise ValueError(f"{name}: needs one finite value per node")
        values.setflags(write=False)
        object.__setattr__(self, "f", values)
        object.__setattr__(self, "name", name)

    @classmethod
    def constant(cls, value: float, lo: float, hi: float, name: str = "table") -> Table1:
        """Return the constant map on [lo, hi]."""
        return cls([lo, hi], [value, value], name)

    @property
    def lo(self) -> float:
        """Lower end of the domain."""
        return float(self.x[0])

    @property
    def hi(self) -> float:
        """Upper end of the domain."""
        return float(self.x[-1])

    @cached_property
    def monotone(self) -> bool:
        """Whether the table never falls or never rises."""
        return _monotone(self.f, 0)

    @cached_property
    def slopes(self) -> Array:
        """Slope between every two nodes, shape (n - 1,)."""
        return np.diff(self.f) / np.diff(self.x)

    @cached_property
    def kinks(self) -> dict[str, Array]:
        """Inner nodes: ``all``, and those where the slope falls (``concave``) or rises."""
        inner, bend = self.x[1:-1], np.diff(self.slopes)
        return {"all": inner, "concave": inner[bend < 0.0], "convex": inner[bend > 0.0]}

    @cached_property
    def _lists(self) -> tuple[list[float], list[float], list[float], float]:
        slack = DOMAIN_SLACK * (self.hi - self.lo)
        return self.x.tolist(), self.f.tolist(), self.slopes.tolist(), slack

    @cached_property
    def _curvature(self) -> Array:
        return _slopes(self.x, _slopes(self.x, self.f))

    @cached_property
    def _half(self) -> float:
        return WINDOW * float(np.diff(self.x).min())

    def __call__(self, x: npt.ArrayLike) -> Array:
        """Return the values at ``x`` (any shape); DomainError outside the table."""
        x = np.asarray(x, dtype=np.float64)
        return _blend1(self.f, *_locate(self.x, x, self.name))

    def at(self, x: float) -> float:
        """Return the value at one float: the fast path of simulation and replay."""
        grid, values, slope, slack = self._lists
        if not grid[0] - slack <= x <= grid[-1] + slack:
            raise DomainError(
                f"{self.name} at {x:g} is outside the table {grid[0]:g} .. {grid[-1]:g}"
            )
        i = bisect_right(grid, x, 1, len(slope)) - 1
        return values[i] + slope[i] * (x - grid[i])

    def clamped(self) -> Callable[[float], float]:
        """Return a fast function of one float that takes the nearest point of the domain.

        For iterates that stray outside for a moment: such a point breaks a limit,
        so no accepted plan rests on a clamped value.
        """
        grid, values, slope, _ = self._lists
        lo, hi = grid[0], grid[-1]
        if len(slope) == 1:
            first, last, steep = values[0], values[1], slope[0]
            return lambda x: first if x <= lo else last if x >= hi else first + steep * (x - lo)

        def at(x: float) -> float:
            if x <= lo:
                return values[0]
            if x >= hi:
                return values[-1]
            i = bisect_right(grid, x) - 1
            return values[i] + slope[i] * (x - grid[i])

        return at

    def jet(self, x: npt.ArrayLike) -> Array:
        """Return value, first and second derivative, shape (3, *x.shape).

        The first derivative is the table's, averaged over a window of a tenth of
        a cell on either side, so it is continuous across nodes; the second comes
        from differences of node slopes: the curvature of the function behind the table.
        """
        x = np.asarray(x, dtype=np.float64)
        around = _window(x, self._half, self.lo, self.hi)
        i, w = _locate(self.x, around, self.name)
        f = _blend1(self.f, i, w)
        slope = (f[2] - f[1]) / (around[2] - around[1])
        return np.stack([f[0], slope, _blend1(self._curvature, i[0], w[0])])


@dataclass(frozen=True)
class Table2:
    """Bilinear function of two variables on a grid.

    Parameters
    ----------
    x : array_like, shape (n,)
        Nodes of the first variable, strictly increasing.
    y : array_like, shape (m,)
        Nodes of the second variable, strictly increasing.
    f : array_like, shape (n, m)
        Values at the nodes.
    name : str
        Used in error messages.

    Raises
    ------
    ValueError
        Shapes differ or a number is not finite.

    Examples
    --------
    >>> table = Table2([0.0, 1.0], [0.0, 2.0], [[0.0, 2.0], [1.0, 5.0]])
    >>> table.at(0.5, 1.0)
    2.0
    """

    x: Array
    y: Array
    f: Array
    name: str = field(default="table")

    def __init__(
        self,
        x: Sequence[float] | Array,
        y: Sequence[float] | Array,
        f: Sequence[Sequence[float]] | Array,
        name: str = "table",
    ) -> None:
        object.__setattr__(self, "x", _grid(x, name))
        object.__setattr__(self, "y", _grid(y, name))
        values = np.array(f, dtype=np.float64)
        if values.shape != (self.x.size, self.y.size) or not np.all(np.isfinite(values)):
            raise ValueError(
                f"{name}: needs one finite value per node, {self.x.size} x {self.y.size}"
            )
        values.setflags(write=False)
        object.__setattr__(self, "f", values)
        object.__setattr__(self, "name", name)

    @cached_property
    def monotone(self) -> tuple[bool, bool]:
        """Whether the table never falls or never rises along x, and along y."""
        return _monotone(self.f, 0), _monotone(self.f, 1)

    @cached_property
    def _lists(self) -> tuple[list[float], list[float], list[list[float]], float, float]:
        return (
            self.x.tolist(),
            self.y.tolist(),
            self.f.tolist(),
            DOMAIN_SLACK * float(self.x[-1] - self.x[0]),
            DOMAIN_SLACK * float(self.y[-1] - self.y[0]),
        )

    @cached_property
    def _curvature(self) -> Array:
        """Second derivatives f_xx, f_xy, f_yy at the nodes, shape (3, n, m)."""
        fx = _slopes(self.x, self.f, 0)
        fy = _slopes(self.y, self.f, 1)
        return np.stack([_slopes(self.x, fx, 0), _slopes(self.y, fx, 1), _slopes(self.y, fy, 1)])

    @cached_property
    def _halves(self) -> tuple[float, float]:
        return WINDOW * float(np.diff(self.x).min()), WINDOW * float(np.diff(self.y).min())

    def __call__(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the values at the points (x, y) of one shape; DomainError outside."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        at_x, at_y = _locate(self.x, x, self.name), _locate(self.y, y, self.name)
        return _blend2(self.f, *at_x, *at_y)

    def at(self, x: float, y: float) -> float:
        """Return the value at one point of floats: the fast path of simulation and replay."""
        xs, ys, f, slack_x, slack_y = self._lists
        if not (
            xs[0] - slack_x <= x <= xs[-1] + slack_x and ys[0] - slack_y <= y <= ys[-1] + slack_y
        ):
            raise DomainError(
                f"{self.name} at ({x:g}, {y:g}) is outside the table "
                f"{xs[0]:g} .. {xs[-1]:g}, {ys[0]:g} .. {ys[-1]:g}"
            )
        i, j = bisect_right(xs, x, 1, len(xs) - 1) - 1, bisect_right(ys, y, 1, len(ys) - 1) - 1
        u = (x - xs[i]) / (xs[i + 1] - xs[i])
        v = (y - ys[j]) / (ys[j + 1] - ys[j])
        left, right = f[i], f[i + 1]
        return (1.0 - u) * ((1.0 - v) * left[j] + v * left[j + 1]) + u * (
            (1.0 - v) * right[j] + v * right[j + 1]
        )

    @cached_property
    def roughness(self) -> float:
        """Largest second difference over the largest value: how sharp the kinks are."""
        bends = [np.abs(np.diff(self.f, 2, axis=axis)) for axis in (0, 1) if self.f.shape[axis] > 2]
        top = float(np.abs(self.f).max())
        return max((float(b.max()) for b in bends), default=0.0) / top if top > 0.0 else 0.0

    def clamped(self) -> Callable[[float, float], float]:
        """Return a fast function of two floats that takes the nearest point of the domain."""
        xs, ys, f, _, _ = self._lists
        x_lo, x_hi, y_lo, y_hi = xs[0], xs[-1], ys[0], ys[-1]
        x_last, y_last = len(xs) - 2, len(ys) - 2

        def at(x: float, y: float) -> float:
            x = x_lo if x < x_lo else x_hi if x > x_hi else x
            y = y_lo if y < y_lo else y_hi if y > y_hi else y
            i, j = bisect_right(xs, x) - 1, bisect_right(ys, y) - 1
            i = i if i <= x_last else x_last
            j = j if j <= y_last else y_last
            v = (y - ys[j]) / (ys[j + 1] - ys[j])
            left, right = f[i], f[i + 1]
            a = left[j] + v * (left[j + 1] - left[j])
            b = right[j] + v * (right[j + 1] - right[j])
            return a + (x - xs[i]) / (xs[i + 1] - xs[i]) * (b - a)

        return at

    def tangent(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return f, f_x, f_y, shape (3, *x.shape): the first of ``jet``."""
        return self._expanded(x, y)[0]

    def jet(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return f, f_x, f_y, f_xx, f_xy, f_yy, shape (6, *x.shape).

        Derivatives as in ``Table1.jet``.
        """
        first, at = self._expanded(x, y)
        return np.concatenate([first, _blend2(self._curvature, *at)])

    def _expanded(
        self, x: npt.ArrayLike, y: npt.ArrayLike
    ) -> tuple[Array, tuple[Cells, Array, Cells, Array]]:
        """Value and first derivatives, and where the points lie."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        half_x, half_y = self._halves
        xs = _window(x, half_x, float(self.x[0]), float(self.x[-1]))
        ys = _window(y, half_y, float(self.y[0]), float(self.y[-1]))
        (i, u), (j, v) = _locate(self.x, xs, self.name), _locate(self.y, ys, self.name)
        along_x = _blend2(self.f, i, u, j[0], v[0])
        along_y = _blend2(self.f, i[0], u[0], j[1:], v[1:])
        by_x = (along_x[2] - along_x[1]) / (xs[2] - xs[1])
        by_y = (along_y[1] - along_y[0]) / (ys[2] - ys[1])
        return np.stack([along_x[0], by_x, by_y]), (i[0], u[0], j[0], v[0])

    def neighbours(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the adjoining cells' functions, continued to the points, shape (4, 3, *x.shape).

        Value and derivatives by x and y of the bilinear functions of the cells
        before and after in x, before and after in y; at the table's edge, of the
        own cell. Where one lies above the table there is a concave kink between.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        i, _ = _locate(self.x, x, self.name)
        j, _ = _locate(self.y, y, self.name)
        last_i, last_j = self.x.size - 2, self.y.size - 2
        found = []
        for di, dj in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            a, b = np.clip(i + di, 0, last_i), np.clip(j + dj, 0, last_j)
            dx, dy = self.x[a + 1] - self.x[a], self.y[b + 1] - self.y[b]
            u, v = (x - self.x[a]) / dx, (y - self.y[b]) / dy
            f = self.f
            by_x = ((1 - v) * (f[a + 1, b] - f[a, b]) + v * (f[a + 1, b + 1] - f[a, b + 1])) / dx
            by_y = ((1 - u) * (f[a, b + 1] - f[a, b]) + u * (f[a + 1, b + 1] - f[a + 1, b])) / dy
            found.append(np.stack([_blend2(f, a, u, b, v), by_x, by_y]))
        return np.stack(found)
