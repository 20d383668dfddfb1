"""Owns the curvature of a vehicle's maps: convex, concave, affine or neither, where, by how much.

Verdicts are exact statements about piecewise linear and bilinear tables and
their reciprocals; what they mean for the relaxation is said in
``docs/relaxation.md``. Knows nothing of trips, programs and solvers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from relax.maps import Table1, Table2
from relax.vehicle import Vehicle

__all__ = ["Axis", "Shape", "Verdict", "judge_table1", "judge_table2", "judge_vehicle"]

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Span = tuple[int, int]

ROUNDING = 1e-9
"""Bends below this share of a map's largest value are rounding, not curvature."""
LEAST_DIVISOR = 1e-6
"""Where a map is below this, its reciprocal is not judged [unit of the map]."""
SAMPLES = 8
"""Points per cell and direction at which a reciprocal, curved in its cells, is compared with
its envelope in one direction; jointly it is compared at nodes, edge middles and cell middles."""


class Shape(Enum):
    """What a map is on a domain.

    Examples
    --------
    >>> Shape("convex")
    <Shape.CONVEX: 'convex'>
    """

    AFFINE = "affine"
    CONVEX = "convex"
    CONCAVE = "concave"
    NEITHER = "neither"


@dataclass(frozen=True)
class Axis:
    """A variable and an interval of it.

    Parameters
    ----------
    name : str
        Symbol and unit.
    lo, hi : float
        Ends.

    Examples
    --------
    >>> str(Axis("T [C]", -10.0, 40.0))
    'T [C] -10 .. 40'
    """

    name: str
    lo: float
    hi: float

    def __str__(self) -> str:
        return f"{self.name} {self.lo:.4g} .. {self.hi:.4g}"


@dataclass(frozen=True)
class Verdict:
    """Curvature of one map on one domain.

    Parameters
    ----------
    map : str
        Which map.
    shape : Shape
        What it is there.
    domain : tuple of Axis
        Where the verdict holds, one interval per variable of the map.
    violation : float
        Largest distance between the map and its nearer envelope on the domain: the
        convex one for a convex map (then rounding), the nearer of the two for one
        that is neither [unit of the map].
    where : tuple of float
        Point of the domain at which that distance is reached.
    along : str
        Variables in which the shape is meant; the others are held fixed.
    nearest : Shape
        Convex or concave: the envelope that ``violation`` is measured from.
    unit : str
        Unit of the map and of ``violation``.
    whole : bool
        Whether ``domain`` is all of the map's domain (of a reciprocal: all of the
        part where it is defined); otherwise the largest part with that shape.

    Notes
    -----
    A bilinear table is jointly convex iff all its cells' cross terms vanish, so that
    it is a sum g(x) + h(y), and both summands are convex: on a cell with a cross
    term the Hessian [[0, c], [c, 0]] is indefinite.
    """

    map: str
    shape: Shape
    domain: tuple[Axis, ...]
    violation: float
    where: tuple[float, ...]
    along: str
    nearest: Shape
    unit: str
    whole: bool = True

    def __str__(self) -> str:
        domain = ", ".join(str(a) for a in self.domain)
        text = f"{self.map} in {self.along}: {self.shape.value}"
        if not self.whole:
            return f"{text} on {domain}"
        if self.shape is Shape.NEITHER:
            at = ", ".join(f"{x:.4g}" for x in self.where)
            unit = "" if self.unit == "1" else f" {self.unit}"
            text += f", {self.violation:.3g}{unit} from {self.nearest.value} at ({at})"
        return text


_SHAPES = {
    (True, True): Shape.AFFINE,
    (True, False): Shape.CONVEX,
    (False, True): Shape.CONCAVE,
    (False, False): Shape.NEITHER,
}
"""By whether it is convex and whether it is concave."""


@dataclass(frozen=True)
class _Map:
    """A table of positive size or its reciprocal on a grid of n x m nodes.

    One variable is a table with two equal columns, judged along x alone.
    """

    name: str
    unit: str
    axes: tuple[str, ...]
    x: Array
    y: Array
    f: Array
    reciprocal: bool

    def part(self, i: tuple[int, int], j: tuple[int, int]) -> _Map:
        """Return the map on the nodes i[0] .. i[1], j[0] .. j[1], ends included."""
        at_x, at_y = slice(i[0], i[1] + 1), slice(j[0], j[1] + 1)
        return replace(self, x=self.x[at_x], y=self.y[at_y], f=self.f[at_x, at_y])

    @property
    def domain(self) -> tuple[Axis, ...]:
        """The whole domain."""
        ends = ((float(g[0]), float(g[-1])) for g in (self.x, self.y))
        return tuple(Axis(name, *end) for name, end in zip(self.axes, ends, strict=False))

    def values(self, step_x: int, step_y: int) -> tuple[Array, Array, Array]:
        """Return a refined grid and the values on it: ``step`` points per cell."""
        x, y = _refined(self.x, step_x), _refined(self.y, step_y)
        f = Table2(self.x, self.y, self.f)(x[:, None], y[None, :])
        return x, y, 1.0 / f if self.reciprocal else f


def _refined(grid: Array, step: int) -> Array:
    return np.interp(np.arange((grid.size - 1) * step + 1) / step, np.arange(grid.size), grid)


def _chord(x: Array, f: Array) -> Array:
    """Chord between the neighbours minus the value at every node along the first axis; ends 0."""
    share = np.diff(x)[:-1] / (x[2:] - x[:-2])
    out = np.zeros_like(f)
    out[1:-1] = f[:-2] * (1.0 - share[:, None]) + f[2:] * share[:, None] - f[1:-1]
    return out


def _broken(of: _Map, along: str, sign: float) -> tuple[Mask, Mask, Mask]:
    """Where convexity (sign 1) or concavity (-1) is broken: kinks along x and y, and cells.

    Shapes (n, m), (n, m) and (n - 1, m - 1). Exact: a continuous function made of smooth
    cells is convex iff it is so in every cell and no kink between cells is concave.
    """
    f = of.f
    bend_x = _chord(of.x, f) if "x" in along else np.zeros_like(f)
    bend_y = _chord(of.y, f.T).T if "y" in along else np.zeros_like(f)
    a, b, c = f[:-1, :-1], f[1:, :-1] - f[:-1, :-1], f[:-1, 1:] - f[:-1, :-1]
    d = f[1:, 1:] - f[1:, :-1] - c  # cross term: f = a + b*u + c*v + d*u*v on the unit cell
    if not of.reciprocal:
        least = ROUNDING * float(np.abs(f).max(initial=0.0))
        cells = np.abs(d) > least if along == "xy" else np.zeros(d.shape, dtype=bool)
        return sign * bend_x < -least, sign * bend_y < -least, cells
    # 1/f bends the other way at a kink of f
    kink_x, kink_y = (sign * bend / f > ROUNDING for bend in (bend_x, bend_y))
    corners = np.stack([f[:-1, :-1], f[1:, :-1], f[:-1, 1:], f[1:, 1:]])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if sign < 0.0:  # 1/affine is convex: concave only where constant
        rise_x = np.maximum(np.abs(b), np.abs(b + d)) if "x" in along else 0.0
        rise_y = np.maximum(np.abs(c), np.abs(c + d)) if "y" in along else 0.0
        return kink_x, kink_y, np.maximum(rise_x, rise_y) > ROUNDING * high
    if along != "xy":
        return kink_x, kink_y, np.zeros(d.shape, dtype=bool)
    # f^4 det of the Hessian of 1/f is 3 d^2 + 4 d (b c - a d) / f: least at a corner
    tilt = 4.0 * d * (b * c - a * d)
    det = 3.0 * d**2 + np.minimum(tilt / low, tilt / high)
    return kink_x, kink_y, det < -ROUNDING * high**2


def _sums(mask: Mask) -> npt.NDArray[np.int64]:
    """Integral image: entry (i, j) counts mask[:i, :j]."""
    out = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), dtype=np.int64)
    out[1:, 1:] = mask.cumsum(axis=0).cumsum(axis=1)
    return out


def _largest(of: _Map, broken: tuple[Mask, Mask, Mask]) -> tuple[float, Span, Span]:
    """Largest rectangle of nodes in which nothing is broken: its share of the area, its ends."""
    kink_x, kink_y, cells = (_sums(mask) for mask in broken)
    best: tuple[float, Span, Span] = (0.0, (0, 0), (0, 0))
    n, m = of.f.shape
    j0, j1 = np.triu_indices(m, 1)
    wide = (of.y[j1] - of.y[j0]) / (of.y[-1] - of.y[0])
    for i0 in range(n - 1):
        i1 = np.arange(i0 + 1, n)[:, None]

        def count(table: npt.NDArray[np.int64], a: Any, b: Any, c: Any, d: Any) -> Any:
            return table[b, d] - table[a, d] - table[b, c] + table[a, c]

        wrong = (
            count(kink_x, i0 + 1, i1, j0, j1 + 1)
            + count(kink_y, i0, i1 + 1, j0 + 1, j1)
            + count(cells, i0, i1, j0, j1)
        )
        area = np.where(wrong == 0, (of.x[i1] - of.x[i0]) / (of.x[-1] - of.x[0]) * wide, 0.0)
        k = int(area.argmax())
        if area.flat[k] > best[0]:
            row, col = divmod(k, j0.size)
            best = float(area.flat[k]), (i0, i0 + 1 + row), (int(j0[col]), int(j1[col]))
    return best


def _hull1(x: Array, f: Array) -> Array:
    """Convex envelope of points with ascending x, at those points."""
    hull: list[int] = []
    for i in range(x.size):
        while len(hull) > 1:
            p, q = hull[-2], hull[-1]
            if (f[q] - f[p]) * (x[i] - x[p]) < (f[i] - f[p]) * (x[q] - x[p]):
                break
            hull.pop()
        hull.append(i)
    return np.interp(x, x[hull], f[hull])


def _hull2(x: Array, y: Array, f: Array) -> Array:
    """Convex envelope of the points of a grid, at those points; they must not be coplanar."""
    u, v = (x - x[0]) / (x[-1] - x[0]), (y - y[0]) / (y[-1] - y[0])
    points = np.stack([*np.broadcast_arrays(u[:, None], v[None, :]), f], axis=-1).reshape(-1, 3)
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    tilt = plane @ np.linalg.lstsq(plane, points[:, 2])[0]
    size = float(np.abs(points[:, 2] - tilt).max())
    points[:, 2] = (points[:, 2] - tilt) / size
    facets = ConvexHull(points).equations
    facets = facets[facets[:, 2] < -1e-9]  # the lower ones
    slopes = -facets[:, [0, 1, 3]] / facets[:, 2:3]
    value = np.concatenate([(rows @ slopes.T).max(axis=1) for rows in _chunks(plane)])
    return np.asarray(value * size + tilt).reshape(f.shape)


def _chunks(rows: Array, size: int = 512) -> list[Array]:
    return [rows[k : k + size] for k in range(0, len(rows), size)]


def _distance(of: _Map, along: str, sign: float) -> tuple[float, tuple[float, ...]]:
    """Largest distance to the convex (sign 1) or concave (-1) envelope, and where."""
    fine = SAMPLES if of.reciprocal else 1
    if along == "xy":
        x, y, f = of.values(2, 2)
        gap = sign * f - _hull2(x, y, sign * f)
    elif along == "x":
        x, y, f = of.values(fine, 1)
        gap = np.stack([sign * c - _hull1(x, sign * c) for c in f.T], axis=1)
    else:
        x, y, f = of.values(1, fine)
        gap = np.stack([sign * c - _hull1(y, sign * c) for c in f])
    i, j = np.unravel_index(int(gap.argmax()), gap.shape)
    return max(float(gap[i, j]), 0.0), (float(x[i]), float(y[j]))[: len(of.axes)]


def _judge(of: _Map, along: str) -> list[Verdict]:
    """Verdict on the whole domain and, if that is neither, on the largest part with a shape."""
    broken = {sign: _broken(of, along, sign) for sign in (1.0, -1.0)}
    fine = {sign: not any(mask.any() for mask in broken[sign]) for sign in broken}
    shape = _SHAPES[fine[1.0], fine[-1.0]]
    names = " and ".join(of.axes["xy".index(v)].split(" ")[0] for v in along)

    def verdict(of: _Map, shape: Shape, whole: bool) -> Verdict:
        if shape is Shape.AFFINE:
            at = tuple(axis.lo for axis in of.domain)
            gap, near = (0.0, at), Shape.CONVEX
        elif shape is Shape.NEITHER:
            found = [(*_distance(of, along, s), _SHAPES[s > 0.0, s < 0.0]) for s in (1.0, -1.0)]
            value, at, near = min(found, key=lambda d: d[0])
            gap = (value, at)
        else:
            gap, near = _distance(of, along, 1.0 if shape is Shape.CONVEX else -1.0), shape
        return Verdict(of.name, shape, of.domain, *gap, names, near, of.unit, whole)

    out = [verdict(of, shape, True)]
    if shape is Shape.NEITHER:
        area, i, j = max(_largest(of, broken[sign]) for sign in broken)
        if area > 0.0:
            part = of.part(i, j)
            fine = {s: not any(m.any() for m in _broken(part, along, s)) for s in broken}
            out.append(verdict(part, _SHAPES[fine[1.0], fine[-1.0]], False))
    return out


def _positive(of: _Map) -> _Map | None:
    """Return the map on the largest rectangle where it can be divided by; None if there is none."""
    low = of.f < LEAST_DIVISOR
    cells = low[:-1, :-1] | low[1:, :-1] | low[:-1, 1:] | low[1:, 1:]
    none = np.zeros_like(low)
    area, i, j = _largest(of, (none, none, cells))
    return of.part(i, j) if area > 0.0 else None


def judge_table1(
    table: Table1, *, axis: str = "x", unit: str = "1", reciprocal: bool = False
) -> tuple[Verdict, ...]:
    """Return the curvature of a piecewise linear table, or of its reciprocal.

    Parameters
    ----------
    table : Table1
        The table; a reciprocal is judged on the largest interval where it is positive.
    axis : str
        Symbol and unit of its variable.
    unit : str
        Unit of the value judged.
    reciprocal : bool
        Judge 1 / table.

    Returns
    -------
    tuple of Verdict
        On the whole domain and, if that is neither, on its largest part with a shape.
        Empty if a reciprocal is nowhere defined.

    Examples
    --------
    >>> print(*judge_table1(Table1([0, 1, 2], [0, 1, 0], "tent")))
    tent in x: concave
    """
    name = f"1/{table.name}" if reciprocal else table.name
    two = np.stack([table.f, table.f], axis=1)
    of: _Map | None = _Map(name, unit, (axis,), table.x, np.array([0.0, 1.0]), two, reciprocal)
    if reciprocal and of is not None:
        of = _positive(of)
    return () if of is None else tuple(_judge(of, "x"))


def judge_table2(
    table: Table2,
    *,
    axes: tuple[str, str] = ("x", "y"),
    unit: str = "1",
    reciprocal: bool = False,
) -> tuple[Verdict, ...]:
    """Return the curvature of a bilinear table, or of its reciprocal: by axis, and jointly.

    Parameters
    ----------
    table : Table2
        The table; a reciprocal is judged on the largest rectangle where it is positive.
    axes : pair of str
        Symbols and units of its variables.
    unit : str
        Unit of the value judged.
    reciprocal : bool
        Judge 1 / table.

    Returns
    -------
    tuple of Verdict
        In x for every y, in y for every x, and in both; each on the whole domain
        and, where that is neither, on the largest part with a shape.

    Examples
    --------
    >>> table = Table2([0, 1], [0, 1], [[0, 0], [0, 1]], "x*y")
    >>> [str(v) for v in judge_table2(table)][:2]
    ['x*y in x: affine', 'x*y in y: affine']
    >>> judge_table2(table)[2].shape, judge_table2(table)[2].violation
    (<Shape.NEITHER: 'neither'>, 0.25)
    """
    name = f"1/{table.name}" if reciprocal else table.name
    of: _Map | None = _Map(name, unit, axes, table.x, table.y, table.f, reciprocal)
    if reciprocal and of is not None:
        of = _positive(of)
    return () if of is None else tuple(v for along in ("x", "y", "xy") for v in _judge(of, along))


def _named(table: Table2, name: str) -> Table2:
    return Table2(table.x, table.y, table.f, name)


def judge_vehicle(vehicle: Vehicle) -> tuple[Verdict, ...]:
    """Return the curvature of every map that the relaxation has to deal with.

    Parameters
    ----------
    vehicle : Vehicle
        Its pack's maps over internal energy E and battery temperature T, and its heat pump.

    Returns
    -------
    tuple of Verdict
        U^2 over E, R over T, charge and discharge limit over (E, T), cop over T, 1/cop and
        1/charge limit. The heat pump's maps only if there is one.

    Examples
    --------
    >>> from relax import load_vehicle
    >>> for verdict in judge_vehicle(load_vehicle("paper-2022"))[:2]:
    ...     print(verdict)
    U^2 in E: affine
    R in T: convex
    """
    pack, E, T = vehicle.pack, "E [kWh]", "T [C]"
    square = Table1(pack.voltage_squared.x, 1000.0 * pack.voltage_squared.f, "U^2")
    charge = _named(pack.charge_limit_kw, "charge limit")
    discharge = _named(pack.discharge_limit_kw, "discharge limit")
    cop = Table1(vehicle.heat_pump_cop.x, vehicle.heat_pump_cop.f, "cop")
    resistance = Table1(pack.resistance_ohm.x, pack.resistance_ohm.f, "R")
    pump = vehicle.heat_pump_kw > 0.0
    return (
        *judge_table1(square, axis=E, unit="V^2"),
        *judge_table1(resistance, axis=T, unit="ohm"),
        *judge_table2(charge, axes=(E, T), unit="kW"),
        *judge_table2(discharge, axes=(E, T), unit="kW"),
        *(judge_table1(cop, axis=T) if pump else ()),
        *(judge_table1(cop, axis=T, reciprocal=True) if pump else ()),
        *judge_table2(charge, axes=(E, T), unit="1/kW", reciprocal=True),
    )
