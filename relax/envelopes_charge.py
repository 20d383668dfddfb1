"""Owns the envelopes of the charging terms: charge limit, charging time, stop losses.

Same rule as ``envelopes``: any slope, certified offset, extrema in closed form on
every cell of the tables. ``ChargeGrid`` holds the table cells inside each box once;
the three terms that need the charge limit share it. Knows nothing of programs
and of trips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from relax.envelopes import SAFETY, nodes, raised
from relax.intervals import Interval, grid_values
from relax.maps import Table1, Table2

__all__ = [
    "ChargeGrid",
    "envelope_charge_time_under",
    "envelope_grid_limit_over",
    "envelope_limit_over",
    "envelope_stop_loss_over",
    "envelope_stop_loss_under",
    "envelope_table_over",
    "make_charge_grid",
    "range_of_planes",
]

Array = npt.NDArray[np.float64]

WIDE_NODES = 150
"""Boxes over more table nodes than this get no planes above rho: they would hardly be below its
range, and are the costliest of all."""
LEAST_POWER_KW = 1e-6
"""Charge limits below this count as this where they are divided by [kW]; only loosens."""


@dataclass(frozen=True)
class ChargeGrid:
    """Table cells inside the box of every charging cell (c of them), padded to one shape.

    Parameters
    ----------
    energy : ndarray, shape (c, k)
        Energy nodes, clipped to the box and ascending; first and last are its ends [kWh].
    temp : ndarray, shape (c, l)
        Temperature nodes likewise [degrees C].
    power : ndarray, shape (c, k, l)
        Battery charge limit at the nodes [kW]; bilinear between them.
    grid_power : ndarray, shape (c, k)
        Internal power that the charger's limit allows; affine between nodes [kW].
    resistance : ndarray, shape (c, l)
        R(T); affine between nodes [ohm].
    inverse_square : ndarray, shape (c, k)
        1000 / U^2(E); convex between nodes [1/(kW*ohm)].
    """

    energy: Array
    temp: Array
    power: Array
    grid_power: Array
    resistance: Array
    inverse_square: Array

    @cached_property
    def power_range(self) -> Interval:
        """Range of the charge limit on every box [kW]; exact."""
        return Interval(self.power.min(axis=(1, 2)), self.power.max(axis=(1, 2)))


def _window(grid: Array, x: Interval) -> Array:
    """Nodes inside each interval with both ends, padded to the largest count."""
    inner = np.clip(np.searchsorted(grid, x.lo, side="right"), 0, grid.size - 1)
    count = max(int((np.searchsorted(grid, x.hi, side="left") - inner).max(initial=0)), 0)
    index = np.minimum(inner[:, None] + np.arange(count), grid.size - 1)
    middle = np.clip(grid[index], x.lo[:, None], x.hi[:, None])
    return np.column_stack([x.lo, middle, x.hi])


def make_charge_grid(
    limit: Table2,
    resistance: Table1,
    square: Table1,
    grid_limits: Sequence[Table1],
    energy: Interval,
    temp: Interval,
) -> ChargeGrid:
    """Cut the tables to the boxes.

    Parameters
    ----------
    limit : Table2
        Battery charge limit over (E, T) [kW].
    resistance, square : Table1
        R(T) [ohm] and U^2(E)/1000 [kW*ohm].
    grid_limits : sequence of Table1
        Charger limit of every stop over E [kW].
    energy, temp : Interval, shape (S, K)
        Box of the cells' midpoints.

    Returns
    -------
    ChargeGrid
        With c = S * K rows.
    """
    cells = energy.lo.shape[1]
    e_grid = np.unique(np.concatenate([limit.x, square.x, *(g.x for g in grid_limits)]))
    t_grid = np.unique(np.concatenate([limit.y, resistance.x]))
    e = _window(e_grid, Interval(energy.lo.ravel(), energy.hi.ravel()))
    t = _window(t_grid, Interval(temp.lo.ravel(), temp.hi.ravel()))
    charger = [
        np.interp(e[i * cells : (i + 1) * cells], g.x, g.f) for i, g in enumerate(grid_limits)
    ]
    return ChargeGrid(
        energy=e,
        temp=t,
        power=grid_values(limit, e, t),
        grid_power=np.concatenate(charger),
        resistance=np.interp(t, resistance.x, resistance.f),
        inverse_square=1.0 / np.interp(e, square.x, square.f),
    )


def _edge_slope(values: Array, x: Array, first: bool) -> Array:
    """Slope of the concave envelope of points (c, l) at their first or last abscissa."""
    i = 0 if first else -1
    run = np.abs(x - x[:, [i]])
    rise = (values - values[:, [i]]) * (1.0 if first else -1.0)
    worst = -np.inf if first else np.inf
    slope = np.where(run > 1e-6, rise / np.where(run > 1e-6, run, 1.0), worst)
    out = slope.max(axis=1) if first else slope.min(axis=1)
    return np.where(np.isfinite(out), out, 0.0)


def _chord(values: Array, x: Array) -> Array:
    rise, run = values[:, -1] - values[:, 0], x[:, -1] - x[:, 0]
    return np.where(run > 1e-6, rise / np.where(run > 1e-6, run, 1.0), 0.0)


def envelope_limit_over(power: Array, energy: Array, temp: Array) -> Array:
    """Three planes in (E, T) above a bilinear power limit, shape (3, 3, c).

    Over-estimators: bilinear minus affine is largest at the corners of a table cell.

    Parameters
    ----------
    power : ndarray, shape (c, k, l)
        Limit at the nodes inside every box [kW].
    energy, temp : ndarray, shape (c, k) and (c, l)
        The nodes.
    """
    p, e, t = power, energy, temp
    k, l_ = e.shape[1], t.shape[1]
    middle = p[:, k // 2, :]
    steep, flat = _edge_slope(middle, t, True), _edge_slope(middle, t, False)
    cold, warm = _chord(p[:, :, 0], e), _chord(p[:, :, -1], e)
    s_e = np.stack([_chord(p[:, :, l_ // 2], e), warm, cold])
    s_t = np.stack([steep, flat, steep])
    gap = np.stack([_above(p, e, t, *s).max(axis=(1, 2)) for s in zip(s_e, s_t, strict=True)])
    return np.stack([s_e, s_t, raised(gap, p.max(axis=(1, 2)))], axis=1)


def envelope_table_over(table: Table2, energy: Interval, temp: Interval) -> Array:
    """Return ``envelope_limit_over`` of a table on boxes of shape (n,).

    Parameters
    ----------
    table : Table2
        Limit over (E, T) [kW].
    energy, temp : Interval, shape (n,)
        Boxes.

    Examples
    --------
    >>> table = Table2([0, 1], [0, 1], [[0, 1], [1, 1]])
    >>> unit = Interval(np.zeros(1), np.ones(1))
    >>> planes = envelope_table_over(table, unit, unit)
    >>> bool((planes.sum(axis=1) >= 1.0).all())  # above the table at (1, 1)
    True
    """
    e, t = _window(table.x, energy), _window(table.y, temp)
    return envelope_limit_over(grid_values(table, e, t), e, t)


def _center(grid: ChargeGrid, at: Sequence[float]) -> tuple[Array, Array]:
    """Return cells (m, c) where slopes are taken: at the middle energy, at shares of T."""
    e, t = grid.energy, grid.temp
    wanted = t[:, :1] + np.array(at) * (t[:, -1:] - t[:, :1])
    j = (t[:, None, 1:-1] <= wanted[:, :, None]).sum(axis=2)
    mid = 0.5 * (e[:, :1] + e[:, -1:])
    i = (e[:, 1:-1] <= mid).sum(axis=1)
    return np.broadcast_to(i, j.T.shape), j.T


def _cell_corners(values: Array) -> list[Array]:
    """Return views of the four corners, (c, k - 1, l - 1) each, of values at nodes (c, k, l)."""
    cold, warm = values[:, :, :-1], values[:, :, 1:]
    return [cold[:, :-1], cold[:, 1:], warm[:, :-1], warm[:, 1:]]


def _largest_corner(values: Array) -> Array:
    """Return the largest of every cell's four corners, (c, k - 1, l - 1)."""
    ends = np.maximum(values[:, :-1], values[:, 1:])
    return np.asarray(np.maximum(ends[:, :, :-1], ends[:, :, 1:]))


def _above(values: Array, e: Array, t: Array, s_e: Array, s_t: Array) -> Array:
    """Return values at points (c, k, l) less a plane in (E, T) with slopes (c,)."""
    out = values - (s_e[:, None] * e)[:, :, None]
    out -= (s_t[:, None] * t)[:, None, :]
    return out


def envelope_charge_time_under(
    grid: ChargeGrid, at: Sequence[float] = (0.35, 0.55, 0.75, 0.95)
) -> Array:
    """Planes in (E, T) below tau = 1 / Pchg(E, T), shape (m, 3, c) [1/kW].

    Under-estimators: on a table cell 1/p lies above its tangent 2/p_0 - p/p_0^2,
    which is bilinear there, so the gap is least at the corners.

    Parameters
    ----------
    grid : ChargeGrid
        Table cells of the boxes.
    at : sequence of float
        Where slopes are taken, as shares of the temperature interval; moved to
        the middle of a table cell, where the tangent above is exact.
    """
    e, t = grid.energy, grid.temp
    p = _cell_corners(np.maximum(grid.power, LEAST_POWER_KW))
    inverse = 4.0 / (p[0] + p[1] + p[2] + p[3])
    twice, square = 2.0 * inverse, inverse * inverse
    tau = [twice - corner * square for corner in p]
    i, j = _center(grid, at)
    row = np.arange(e.shape[0])
    run_e, run_t = np.diff(e, axis=1)[row, i], np.diff(t, axis=1)[row, j]
    here = [corner[row, i, j] for corner in tau]
    s_e = 0.5 * (here[1] + here[3] - here[0] - here[2]) / np.where(run_e > 1e-9, run_e, np.inf)
    s_t = 0.5 * (here[2] + here[3] - here[0] - here[1]) / np.where(run_t > 1e-9, run_t, np.inf)
    # a node is a corner of up to four cells: the least of their tangents counts
    least = np.full(grid.power.shape, np.inf)
    for node, corner in zip(_cell_corners(least), tau, strict=True):
        np.minimum(node, corner, out=node)
    low = np.stack([_above(least, e, t, *s).min(axis=(1, 2)) for s in zip(s_e, s_t, strict=True)])
    size = inverse[row, i, j]
    return np.stack([s_e, s_t, low - SAFETY * (size + np.abs(low))], axis=1)


def range_of_planes(planes: Array, grid: ChargeGrid) -> Interval:
    """Return the range of every plane in (E, T) on its box, shape (m, c).

    Parameters
    ----------
    planes : ndarray, shape (m, 3, c)
        Slopes and offset.
    grid : ChargeGrid
        Table cells of the boxes.
    """
    s_e, s_t, s_0 = planes.swapaxes(0, 1)
    e = s_e * grid.energy[:, 0], s_e * grid.energy[:, -1]
    t = s_t * grid.temp[:, 0], s_t * grid.temp[:, -1]
    lo, hi = s_0 + np.minimum(*e) + np.minimum(*t), s_0 + np.maximum(*e) + np.maximum(*t)
    room = SAFETY * (np.abs(s_0) + np.abs(lo) + np.abs(hi))
    return Interval(lo - room, hi + room)


def _between(values: Array) -> Array:
    """Return nodes with the middles between them: (c, k) becomes (c, 2k - 1)."""
    out = np.empty((values.shape[0], 2 * values.shape[1] - 1))
    out[:, ::2], out[:, 1::2] = values, 0.5 * (values[:, :-1] + values[:, 1:])
    return out


def _bernstein(p: Array, kappa: Array, R: Array) -> Array:
    """Bernstein coefficients (c, 2k - 1, 2l - 1) of p(E, T) * kappa(E) * R(T).

    Three by three per cell; neighbours share those on their border.
    """
    c, k, l_ = p.shape
    in_t, out = np.empty((c, k, 2 * l_ - 1)), np.empty((c, 2 * k - 1, 2 * l_ - 1))
    in_t[:, :, ::2] = p * R[:, None]
    in_t[:, :, 1::2] = 0.5 * (p[:, :, :-1] * R[:, None, 1:] + p[:, :, 1:] * R[:, None, :-1])
    left, right, k_0, k_1 = in_t[:, :-1], in_t[:, 1:], kappa[:, :-1, None], kappa[:, 1:, None]
    out[:, ::2], out[:, 1::2] = in_t * kappa[..., None], 0.5 * (left * k_1 + right * k_0)
    return out


def _largest(tables: Sequence[Array]) -> Array:
    """Largest value on each box of the least of functions with Bernstein coefficients, (c,).

    On every cell each function is at most the largest of its nine coefficients.
    """
    if len(tables) == 1:
        return np.asarray(tables[0].max(axis=(1, 2)))
    cells = []
    for table in tables:
        part = np.maximum(np.maximum(table[:, :-2:2], table[:, 1::2]), table[:, 2::2])
        cells.append(np.maximum(np.maximum(part[..., :-2:2], part[..., 1::2]), part[..., 2::2]))
    return np.asarray(np.min(cells, axis=0).max(axis=(1, 2)))


def envelope_stop_loss_over(
    grid: ChargeGrid, at: Sequence[float] = (0.3,)
) -> tuple[Array, Interval]:
    """Planes in (E, T) above rho = R(T)/U^2(E) * min(Pchg(E, T), charger), and its range.

    Over-estimators: 1/U^2 lies below its chord on a cell; then rho minus the plane
    is a biquadratic polynomial there, at most its largest Bernstein coefficient.
    The loss of a cell is l = r e^2/y <= e * rho, as e/y is at most both limits.

    Parameters
    ----------
    grid : ChargeGrid
        Table cells of the boxes.
    at : sequence of float
        Where slopes are taken, as shares of the temperature interval.

    Returns
    -------
    planes : ndarray, shape (m, 3, c)
        Planes; none on wide boxes.
    range : Interval, shape (c,)
        Bounds of rho on the box.
    """
    e, t = grid.energy, grid.temp
    families = [grid.power]
    if np.any(grid.grid_power.min(axis=1) < grid.power.max(axis=(1, 2))):
        families.append(np.broadcast_to(grid.grid_power[:, :, None], grid.power.shape))
    least = (
        grid.resistance.min(axis=1)
        * grid.inverse_square.min(axis=1)
        * np.min([p.min(axis=(1, 2)) for p in families], axis=0)
    )
    if grid.power[0].size > WIDE_NODES:
        # on every table cell at most the product of the largest factors
        most = np.min([_largest_corner(p) for p in families], axis=0)
        kappa, R = grid.inverse_square, grid.resistance
        most *= np.maximum(kappa[:, 1:], kappa[:, :-1])[:, :, None]
        most *= np.maximum(R[:, 1:], R[:, :-1])[:, None, :]
        return np.zeros((0, 3, e.shape[0])), _loosened(least, most.max(axis=(1, 2)))
    rho = (
        np.minimum(families[0], families[-1])
        * grid.inverse_square[:, :, None]
        * grid.resistance[:, None, :]
    )
    i, j = _center(grid, at)
    row = np.arange(e.shape[0])
    corner = [x[row, i, j] for x in _cell_corners(rho)]
    run_e, run_t = np.diff(e, axis=1)[row, i], np.diff(t, axis=1)[row, j]
    s_e = 0.5 * (corner[1] + corner[3] - corner[0] - corner[2])
    s_t = 0.5 * (corner[2] + corner[3] - corner[0] - corner[1])
    s_e = s_e / np.where(run_e > 1e-9, run_e, np.inf)
    s_t = s_t / np.where(run_t > 1e-9, run_t, np.inf)
    s_e = np.concatenate([s_e, [_chord(rho.mean(axis=2), e)]])
    s_t = np.concatenate([s_t, [_chord(rho.mean(axis=1), t)]])
    e_half, t_half = _between(e), _between(t)
    tables = [_bernstein(p, grid.inverse_square, grid.resistance) for p in families]
    offset = np.stack(
        [
            _largest([_above(b, e_half, t_half, *slopes) for b in tables])
            for slopes in zip(s_e, s_t, strict=True)
        ]
    )
    offset += SAFETY * (1e-3 + np.abs(offset))
    return np.stack([s_e, s_t, offset], axis=1), _loosened(least, _largest(tables))


def _loosened(least: Array, most: Array) -> Interval:
    """Return the range of rho with room for its rounding."""
    return Interval(least * (1.0 - SAFETY), most * (1.0 + SAFETY) + 1e-12)


def envelope_stop_loss_under(
    resistance: Table1,
    square_hi: Array,
    energy: Interval,
    temp: Interval,
    power: Array,
    at: Sequence[float] = (0.15, 0.4, 0.65, 0.9),
) -> Array:
    """Planes in (e, y, T) below the loss of a cell l = r(T) e^2 / y, shape (m, 4, c).

    Under-estimators: for fixed T the loss is a perspective, above its tangent
    r * (2 theta e - theta^2 y) for every theta; theta is chosen to cancel the plane's
    slope in y, the rest is affine in e, and l is piecewise affine in T.

    Parameters
    ----------
    resistance : Table1
        R(T) [ohm].
    square_hi : ndarray, shape (c,)
        Largest U^2/1000 on the box.
    energy : Interval, shape (c,)
        Energy of the cell e = W/K [kWh].
    temp : Interval, shape (c,)
        Midpoint temperature.
    power : ndarray, shape (m, c)
        Charging power e/y where slopes are taken, per entry of ``at`` [kW].
    at : sequence of float
        Where slopes are taken, as shares of the temperature interval.
    """
    t = nodes(resistance, temp, "convex")
    r = np.maximum(np.interp(t, resistance.x, resistance.f), 0.0) / square_hi[:, None]
    t0 = temp.lo + np.array(at)[:, None] * temp.width
    steepness = resistance.slopes[np.searchsorted(resistance.x[1:-1], t0, side="right")]
    r0 = np.maximum(np.interp(t0, resistance.x, resistance.f), 0.0) / square_hi
    s_e, s_y = 2.0 * r0 * power, -r0 * power**2
    s_t = steepness / square_hi * energy.mid * power
    theta = np.sqrt(-s_y[..., None] / np.maximum(r, 1e-12))
    coefficient = 2.0 * r * theta - s_e[..., None]
    spare = np.minimum(-r * theta**2 - s_y[..., None], 0.0)
    low = np.minimum(coefficient * energy.lo[:, None], coefficient * energy.hi[:, None])
    # rounding may leave a negative coefficient of y: y <= 1000 h on any box
    low = (low + spare * 1e3 - s_t[..., None] * t).min(axis=2)
    size = r.max(axis=1) * energy.hi * power
    return np.stack([s_e, s_y, s_t, low - SAFETY * (1e-3 + size + np.abs(low))], axis=1)


def envelope_grid_limit_over(grid: ChargeGrid, dwell: Interval) -> Array:
    """Three planes in (E, y) above the charger's energy limit(E) * y, shape (3, 3, c).

    Over-estimators: affine in y, piecewise affine in E: largest at nodes and ends.

    Parameters
    ----------
    grid : ChargeGrid
        Table cells of the boxes.
    dwell : Interval, shape (c,)
        Dwell of the cells [h].
    """
    g, e = grid.grid_power, grid.energy
    slope = _chord(g, e)
    g_lo, g_hi = g.min(axis=1), g.max(axis=1)
    s_e = np.stack([np.zeros_like(slope), slope * dwell.lo, slope * dwell.hi])
    s_y = np.stack([g_hi, g_hi, g_lo])
    ends = [
        (g * y[:, None] - s_e[..., None] * e).max(axis=2) - s_y * y for y in (dwell.lo, dwell.hi)
    ]
    return np.stack([s_e, s_y, raised(np.maximum(*ends), g_hi * dwell.hi)], axis=1)
