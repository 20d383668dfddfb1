"""Owns the envelopes of the driving terms: planes above and below each nonconvex term on a box.

One rule throughout (relaxation of docs/relaxation.md): *any* slope, certified
offset. A plane's slope is a choice; its offset is the extremum of term minus
slope over the box, in closed form: tables are piecewise linear, so extrema sit
at ends, at table nodes, or at the one stationary point of a convex piece.

Planes are arrays of shape (m, d + 1, n): m planes in d variables for n boxes,
the last coefficient is the offset. Knows nothing of programs and of trips.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from relax.intervals import Interval
from relax.maps import Table1
from relax.physics import heat_pump_power

__all__ = [
    "affine_over",
    "envelope_conductance_over",
    "envelope_loss_over",
    "envelope_loss_under",
    "envelope_product",
    "envelope_pump_heat_over",
    "envelope_pump_heat_under",
    "envelope_pump_power_under",
    "nodes",
    "raised",
]

Array = npt.NDArray[np.float64]

SAFETY = 1e-9
"""Share of the term's size added to every offset: covers the rounding of the offset itself."""
STRAIGHT = 1e-13
"""A droop below this bends the heat by less than SAFETY, and its stationary point is rounding."""
FLAT = 1e-9
"""Box widths below this count as zero when a slope is chosen (never for an offset)."""
TANGENTS = ((0.15, 0.25), (0.15, 0.75), (0.5, 0.25), (0.5, 0.75))
"""Shares of power and temperature where planes touch a driving loss: relaxed optima mostly have
the heater off, which is at 5 to 20 % of the powers that a box allows."""


def nodes(table: Table1, x: Interval, kinks: str = "all") -> Array:
    """Return the points of each interval where a piecewise linear table may have an extremum.

    Parameters
    ----------
    table : Table1
        The table.
    x : Interval, shape (n,)
        Where.
    kinks : str
        ``"all"`` nodes, only ``"concave"`` ones (a maximum of table plus anything
        affine sits there or at an end), or only ``"convex"`` ones (a minimum does).

    Returns
    -------
    ndarray, shape (n, k)
        Both ends and the inner nodes, clipped to the interval (repeated points are harmless).

    Examples
    --------
    >>> table = Table1([0, 1, 2], [0, 1, 0])
    >>> nodes(table, Interval(np.array([0.5]), np.array([1.5])), "convex").tolist()
    [[0.5, 1.5]]
    """
    inner = table.kinks[kinks]
    inner = inner[(inner > x.lo.min(initial=np.inf)) & (inner < x.hi.max(initial=-np.inf))]
    out = np.empty((x.lo.size, inner.size + 2))
    out[:, 0], out[:, -1] = x.lo, x.hi
    np.minimum(np.maximum(inner, x.lo[:, None]), x.hi[:, None], out=out[:, 1:-1])
    return out


def _at(table: Table1, x: Array) -> Array:
    """Table at points; beyond the domain the end value (boxes lie inside up to rounding)."""
    return np.interp(x, table.x, table.f)


def _ratio(rise: Array, run: Array) -> Array:
    """Slope rise / run, 0 where the run vanishes."""
    return np.where(run > FLAT, rise / np.where(run > FLAT, run, 1.0), 0.0)


def _steepness(table: Table1, x: Array) -> Array:
    """Slope of the table's segment at points."""
    i = np.searchsorted(table.x[1:-1], x, side="right")
    return np.asarray(table.slopes[i])


def raised(offset: Array, size: Array) -> Array:
    """Return an offset with room for the rounding of terms of a size."""
    return offset + SAFETY * (1.0 + np.abs(size))


def affine_over(table: Table1, x: Interval) -> Array:
    """Return the chord-sloped affine function above a table on intervals, shape (2, n).

    Parameters
    ----------
    table : Table1
        The table.
    x : Interval, shape (n,)
        Where it must hold.

    Examples
    --------
    >>> slope, offset = affine_over(Table1([0, 1, 2], [0, 1, 0]), Interval(np.zeros(1), np.full(1, 2.0)))
    >>> slope.tolist(), round(float(offset[0]), 6)
    ([0.0], 1.0)
    """  # noqa: E501
    slope = _ratio(_at(table, x.hi) - _at(table, x.lo), x.width)
    points = nodes(table, x, "concave")
    gap = (_at(table, points) - slope[:, None] * points).max(axis=1)
    return np.stack([slope, raised(gap, gap)])


def envelope_conductance_over(
    resistance: Table1, square: Table1, energy: Interval, temp: Interval
) -> Array:
    """Plane in (E, T) above gamma = U^2(E) / R(T), shape (1, 3, n): L * gamma >= P^2.

    Over-estimator: U^2/R is piecewise affine in E and, 1/R being convex on each
    segment, largest at the nodes in T.

    Parameters
    ----------
    resistance, square : Table1
        R(T) > 0 on the box and U^2(E)/1000.
    energy, temp : Interval, shape (n,)
        Box.
    """
    e, t = nodes(square, energy, "concave"), nodes(resistance, temp)
    u, g = _at(square, e), 1.0 / _at(resistance, t)
    g_lo, g_hi = g[:, 0], g[:, -1]
    s_e = _ratio(u[:, -1] - u[:, 0], energy.width) * 0.5 * (g_lo + g_hi)
    s_t = _ratio(g_hi - g_lo, temp.width) * u.mean(axis=1)
    value = u[:, :, None] * g[:, None, :]
    gap = value - s_e[:, None, None] * e[:, :, None] - s_t[:, None, None] * t[:, None, :]
    return np.stack([s_e, s_t, raised(gap.max(axis=(1, 2)), value.max(axis=(1, 2)))])[None]


def envelope_loss_over(
    resistance: Table1,
    square: Table1,
    power: Interval,
    energy: Interval,
    temp: Interval,
    ripple: Array,
) -> Array:
    """Two planes in (P, E, T) above L = R(T)/U^2(E) * (P^2 + ripple), shape (2, 4, n).

    Over-estimators: L is convex in P; in E and T it is largest at ends or at the
    kinks listed by ``nodes``. Slopes from the triangulation of the (P, T) rectangle.

    Parameters
    ----------
    resistance, square : Table1
        R(T) [ohm] and U^2(E)/1000 [kW*ohm].
    power, energy, temp : Interval, shape (n,)
        Box.
    ripple : ndarray, shape (n,)
        Variance of the power [kW^2].
    """
    e, t = nodes(square, energy, "convex"), nodes(resistance, temp, "concave")
    inverse, R = 1.0 / _at(square, e), _at(resistance, t)
    p = np.stack([power.lo, power.hi], axis=1)
    z = p**2 + ripple[:, None]
    value = z[:, :, None, None] * inverse[:, None, :, None] * R[:, None, None, :]
    v = inverse[:, [0, -1]].mean(axis=1)
    corner = v[:, None, None] * z[:, :, None] * R[:, None, [0, -1]]
    d_p, d_t = power.width, temp.width
    # cut the rectangle so that the two triangles lie above it: along the larger diagonal
    rising = corner[:, 0, 0] + corner[:, 1, 1] >= corner[:, 0, 1] + corner[:, 1, 0]
    p_cold, p_warm = corner[:, 1, 0] - corner[:, 0, 0], corner[:, 1, 1] - corner[:, 0, 1]
    t_low, t_high = corner[:, 0, 1] - corner[:, 0, 0], corner[:, 1, 1] - corner[:, 1, 0]
    s_p = _ratio(np.stack([p_cold, p_warm]), d_p)
    s_t = _ratio(np.where(rising, np.stack([t_high, t_low]), np.stack([t_low, t_high])), d_t)
    middle = 0.25 * z.sum(axis=1) * R[:, [0, -1]].sum(axis=1)
    s_e = _ratio((inverse[:, -1] - inverse[:, 0]) * middle, energy.width)
    s_e = np.broadcast_to(s_e, s_p.shape)
    gap = (
        value[None]
        - (s_p[..., None] * p)[..., None, None]
        - (s_e[..., None] * e)[..., None, :, None]
        - (s_t[..., None] * t)[..., None, None, :]
    )
    size = value.max(axis=(1, 2, 3))
    return np.stack([s_p, s_e, s_t, raised(gap.max(axis=(2, 3, 4)), size)], axis=1)


def envelope_loss_under(
    resistance: Table1,
    square: Table1,
    power: Interval,
    energy: Interval,
    temp: Interval,
    ripple: Array,
    at: Sequence[tuple[float, float]] = TANGENTS,
) -> Array:
    """Planes in (P, E, T) below L = R(T)/U^2(E) * (P^2 + ripple), shape (m, 4, n).

    Under-estimators: with an affine u above U^2, (P^2 + ripple)/u(E) is jointly
    convex, so for each T-node its tangent plane is minimal at the ends of P and E;
    between nodes L is affine in T.

    Parameters
    ----------
    resistance, square : Table1
        R(T) [ohm] and U^2(E)/1000 [kW*ohm].
    power, energy, temp : Interval, shape (n,)
        Box.
    ripple : ndarray, shape (n,)
        Variance of the power [kW^2].
    at : sequence of pair of float
        Where slopes are taken, as shares of the intervals of power and temperature.
    """
    t = nodes(resistance, temp, "convex")
    R = _at(resistance, t)
    u_slope, u_zero = affine_over(square, energy)
    u = u_slope * energy.mid + u_zero
    shares = np.array(at).T[..., None]
    p0, t0 = (x.lo + share * x.width for x, share in zip((power, temp), shares, strict=True))
    z0 = p0**2 + ripple
    r0 = _at(resistance, t0) / u
    s_p, s_e = 2.0 * r0 * p0, -r0 * z0 * u_slope / u
    s_t = _steepness(resistance, t0) * z0 / u
    # the tangent of P^2 / u with the plane's own slope in P, where the box allows it
    p_t = s_p[..., None] * u[:, None] / (2.0 * np.maximum(R, 1e-12))
    p_t = np.clip(p_t, power.lo[:, None], power.hi[:, None])
    z_t = p_t**2 + ripple[:, None]
    c_p = 2.0 * R * p_t / u[:, None] - s_p[..., None]
    c_e = -R * z_t * (u_slope / u**2)[:, None] - s_e[..., None]
    c_0 = R * (2.0 * ripple / u)[:, None] - R * z_t * (u_zero / u**2)[:, None]
    low = (
        c_0
        + np.minimum(c_p * power.lo[:, None], c_p * power.hi[:, None])
        + np.minimum(c_e * energy.lo[:, None], c_e * energy.hi[:, None])
        - s_t[..., None] * t
    )
    size = R.max(axis=1) / u * (np.maximum(power.lo**2, power.hi**2) + ripple)
    return np.stack([s_p, s_e, s_t, -raised(-low.min(axis=2), size)], axis=1)


def envelope_pump_heat_over(cop: Table1, droop: float, power: Interval, temp: Interval) -> Array:
    """Two planes in (hp, T) above h = cop(T) * hp * (1 - droop * hp), shape (2, 3, n).

    Over-estimators: h is piecewise affine in T and concave in hp, whose stationary
    point is closed form. Needs cop >= 0.

    Parameters
    ----------
    cop : Table1
        Coefficient of performance over temperature.
    droop : float
        Loss of it per power [1/kW], >= 0.
    power, temp : Interval, shape (n,)
        Box.
    """
    t = nodes(cop, temp, "concave")
    c = _at(cop, t)
    top = power.hi
    full = top * (1.0 - droop * top)
    c_lo, c_hi = c.min(axis=1), c.max(axis=1)
    zero = np.zeros_like(top)
    s_h = np.stack([c_hi, c_lo * (1.0 - 2.0 * droop * top)])
    s_t = np.stack([zero, full * _ratio(c[:, -1] - c[:, 0], temp.width)])
    # affine in hp: largest at an end; else at the stationary point, or at the end next to it
    most: list[Array] = [power.lo[:, None], power.hi[:, None]]
    if droop > STRAIGHT:
        best = (1.0 - s_h[..., None] / np.maximum(c, 1e-12)) / (2.0 * droop)
        most = [np.minimum(np.maximum(best, power.lo[:, None]), power.hi[:, None])]
    gaps = [
        (c * x * (1.0 - droop * x) - s_h[..., None] * x - s_t[..., None] * t).max(axis=2)
        for x in most
    ]
    return np.stack([s_h, s_t, raised(np.max(gaps, axis=0), c_hi * top)], axis=1)


def envelope_pump_heat_under(cop: Table1, droop: float, power: Interval, temp: Interval) -> Array:
    """Plane in (hp, T) below h = cop(T) * hp * (1 - droop * hp), shape (1, 3, n).

    Under-estimator: the chord in hp at the least cop. h is piecewise affine in T and
    concave in hp, so the gap is least at nodes of T and ends of hp. Needs cop >= 0.

    Parameters
    ----------
    cop : Table1
        Coefficient of performance over temperature.
    droop : float
        Loss of it per power [1/kW], >= 0.
    power, temp : Interval, shape (n,)
        Box.
    """
    c = _at(cop, nodes(cop, temp, "convex"))
    c_lo = c.min(axis=1)
    s_h = c_lo * (1.0 - droop * (power.lo + power.hi))
    ends = [c_lo * (x * (1.0 - droop * x)) - s_h * x for x in (power.lo, power.hi)]
    low = -raised(-np.minimum(*ends), c.max(axis=1) * power.hi)
    return np.stack([s_h, np.zeros_like(s_h), low])[None]


def envelope_pump_power_under(
    cop: Table1,
    droop: float,
    power: Interval,
    demand: Array,
    temp: Interval,
    at: tuple[float, ...] = (0.3, 0.7),
) -> Array:
    """Planes in (h, T) below the power hp that gives a heat h <= q, shape (m, 3, n).

    Under-estimators: for fixed hp the plane's gap is affine in T, so its least value is
    at a T-node (convex in hp there, stationary point closed form) or on the curve
    h = q, where it is convex between nodes and lies above its tangent.

    Parameters
    ----------
    cop : Table1
        Coefficient of performance, > 0.
    droop : float
        Loss of it per power [1/kW], >= 0, with droop * power < 1/2.
    power, temp : Interval, shape (n,)
        Box.
    demand : ndarray, shape (n,)
        Cabin heating demand q [kW].
    at : tuple of float
        Where slopes are taken, as shares of the temperature interval.
    """
    t = nodes(cop, temp)
    c, q = _at(cop, t), demand[:, None]
    most = power.hi[:, None]
    full = most * (1.0 - droop * most)

    def inverse(x: Array) -> Array:
        return heat_pump_power(np.minimum(x, full), np.ones(()), droop)

    t0 = temp.lo[:, None] + np.array(at) * temp.width[:, None]
    c0 = _at(cop, t0)
    hp0 = inverse(q / c0)
    steep = 1.0 / (1.0 - 2.0 * droop * hp0)
    s_t = (-q * _steepness(cop, t0) / c0**2 * steep).T
    c_lo = c.min(axis=1, keepdims=True)
    s_h = np.broadcast_to((1.0 / (c_lo * (1.0 - 2.0 * droop * inverse(q / c_lo)))).T, s_t.shape)
    cap = inverse(q / c)
    # affine in hp: least at an end; else at the stationary point, or at the end next to it
    points = [np.zeros_like(cap), cap]
    if droop > STRAIGHT:
        best = (1.0 - 1.0 / (s_h[..., None] * c)) / (2.0 * droop)
        points = [np.minimum(np.maximum(best, 0.0), cap)]
    low = np.min(
        [
            (x - s_h[..., None] * c * x * (1.0 - droop * x) - s_t[..., None] * t).min(axis=2)
            for x in points
        ],
        axis=0,
    )
    # the curve h = q inside every cell: tangents of 1/c and of the inverse, both convex
    c_m = 0.5 * (c[:, 1:] + c[:, :-1])
    x_m = np.minimum(q / c_m, full)
    hp_m = inverse(x_m)
    for c_end, t_end in ((c[:, 1:], t[:, 1:]), (c[:, :-1], t[:, :-1])):
        x_end = q * (2.0 / c_m - c_end / c_m**2)
        hp_end = hp_m + (x_end - x_m) / (1.0 - 2.0 * droop * hp_m)
        curve = hp_end - s_h[..., None] * q - s_t[..., None] * t_end
        low = np.minimum(low, curve.min(axis=2))
    return np.stack([s_h, s_t, -raised(-low, power.hi)], axis=1)


def envelope_product(x: Interval, y: Interval) -> tuple[Array, Array]:
    """McCormick planes of x * y: below and above, each of shape (2, 3, n).

    Parameters
    ----------
    x, y : Interval, shape (n,)
        Box.

    Examples
    --------
    >>> one = Interval(np.zeros(1), np.ones(1))
    >>> below, above = envelope_product(one, one)
    >>> below[1, :2, 0].tolist()
    [1.0, 1.0]
    """
    size = np.maximum(np.abs(x.lo), np.abs(x.hi)) * np.maximum(np.abs(y.lo), np.abs(y.hi))
    below = [
        np.stack([y.lo, x.lo, -raised(x.lo * y.lo, size)]),
        np.stack([y.hi, x.hi, -raised(x.hi * y.hi, size)]),
    ]
    above = [
        np.stack([y.lo, x.hi, -x.hi * y.lo + SAFETY * (1.0 + size)]),
        np.stack([y.hi, x.lo, -x.lo * y.hi + SAFETY * (1.0 + size)]),
    ]
    return np.stack(below), np.stack(above)
