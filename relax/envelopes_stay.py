"""Owns the envelope of a stop's charging time: what the cells together take, from end to end.

A plane under one cell's time says little while the charge is open by tens of kWh, since then
the cell may be anywhere on the charge curve. The cells together are not: they cover the way
from the energy at the begin to that at the end. Knows nothing of programs and of trips.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from relax.envelopes import SAFETY
from relax.envelopes_charge import LEAST_POWER_KW
from relax.intervals import Interval, grid_values
from relax.maps import Table1, Table2

__all__ = ["envelope_stay_under"]

Array = npt.NDArray[np.float64]

PIECES = 128
"""Parts of the way from the least energy at the begin to the largest at the end."""
TANGENTS = (0.05, 0.3, 0.55, 0.8, 0.95)
"""Shares of the interval of the energy at the end at which planes take their slope."""
AROUND = 0.05
"""Share of that interval over which a slope is measured: the curve has steps."""


def envelope_stay_under(
    limit: Table2,
    chargers: Sequence[Table1],
    begin: Interval,
    end: Interval,
    temp: Interval,
    cell_kwh: Array,
) -> Array:
    """Planes in (E_a, E_b) under the time in which equal cells charge from E_a to E_b.

    Under-estimators: a cell takes its energy over the power in its middle, which is at most
    the largest within half a cell of any of its energies. So all cells take at least the
    integral of one over that largest power, a function H of the energy, from E_a to E_b:
    H(E_b) lies above its planes, -H(E_a) above the chord moved down to it.

    Parameters
    ----------
    limit : Table2
        Battery charge limit over (E, T) [kW].
    chargers : sequence of Table1
        Charger limit of every stop over E [kW].
    begin, end : Interval, shape (S,)
        Energies at the begin and at the end [kWh].
    temp : Interval, shape (S,)
        Of all cells' midpoints [degrees C].
    cell_kwh : ndarray, shape (S,)
        Largest charge of one cell [kWh].

    Returns
    -------
    ndarray, shape (m, 3, S)
        Slopes [h/kWh] and offset [h]: time >= s_a E_a + s_b E_b + s_0.

    Examples
    --------
    >>> limit = Table2([0.0, 40.0, 80.0], [0.0, 40.0], [[100.0] * 2, [100.0] * 2, [20.0] * 2])
    >>> begin, end = Interval(*np.array([[10.0], [10.0]])), Interval(*np.array([[20.0], [75.0]]))
    >>> temp, charger = Interval(*np.array([[5.0], [30.0]])), Table1.constant(90.0, 0.0, 80.0)
    >>> planes = envelope_stay_under(limit, [charger], begin, end, temp, np.array([4.0]))
    >>> hours = planes[:, 0, 0] * 10.0 + planes[:, 1, 0] * 75.0 + planes[:, 2, 0]
    >>> round(float(hours.max()), 2)  # from 10 to 75 kWh; 90 kW all the way would take 0.72 h
    0.89
    """
    half = 0.5 * cell_kwh[:, None]
    first, last = begin.lo[:, None], np.maximum(end.hi, begin.lo + SAFETY)[:, None]
    step = (last - first) / PIECES
    u = first + step * np.arange(PIECES + 1)
    # no cell that covers a part of a piece has its middle further off than this
    lo, hi = np.maximum(u[:, :-1] - half, first), np.minimum(u[:, 1:] + half, last)
    power = _largest_power(limit, temp, lo, hi)
    for i, table in enumerate(chargers):
        most = _largest_between(table.x, table.f, lo[i], hi[i])
        power[i] = np.minimum(power[i], most)
    pace = 1.0 / np.maximum(power, LEAST_POWER_KW)
    time = np.zeros_like(u)
    np.cumsum(pace * step, axis=1, out=time[:, 1:])

    def at(e: Array) -> Array:
        where = np.clip((e - first) / step, 0.0, PIECES)
        k = np.minimum(where.astype(np.int64), PIECES - 1)
        rows = np.arange(u.shape[0])[:, None]
        out: Array = time[rows, k] + (where - k) * (time[rows, k + 1] - time[rows, k])
        return out

    def least(slope: Array, sign: float, x: Interval) -> Array:
        """Least of sign * time - slope * E over an interval: at a node, or at an end."""
        ends = np.stack([x.lo, np.maximum(x.hi, x.lo)], axis=1)
        inside = (u > ends[:, :1]) & (u < ends[:, 1:])
        values = np.where(inside, sign * time - slope[:, None] * u, np.inf).min(axis=1)
        out: Array = np.minimum(values, (sign * at(ends) - slope[:, None] * ends).min(axis=1))
        return out

    ends = np.stack([begin.lo, np.maximum(begin.hi, begin.lo + SAFETY)], axis=1)
    s_a = -np.diff(at(ends), axis=1)[:, 0] / np.maximum(np.diff(ends, axis=1)[:, 0], 1e-6)
    o_a = least(s_a, -1.0, begin)
    planes = []
    for share in TANGENTS:
        around = end.lo[:, None] + (share + np.array([-AROUND, AROUND])) * end.width[:, None]
        around = np.clip(around, first, last)
        run = np.diff(around, axis=1)[:, 0]
        s_b = np.diff(at(around), axis=1)[:, 0] / np.maximum(run, 1e-6)
        o_b = least(s_b, 1.0, end)
        size = np.abs(o_a) + np.abs(o_b) + time[:, -1] + (np.abs(s_a) + np.abs(s_b)) * last[:, 0]
        planes.append(np.stack([s_a, s_b, o_a + o_b - SAFETY * (1.0 + size)]))
    return np.stack(planes)


def _largest_power(limit: Table2, temp: Interval, lo: Array, hi: Array) -> Array:
    """Largest charge limit over intervals of energy and all temperatures, shape (S, pieces)."""
    inner = np.clip(limit.y[None], temp.lo[:, None], np.maximum(temp.hi, temp.lo)[:, None])
    t = np.column_stack([temp.lo, inner, temp.hi])
    e = np.broadcast_to(limit.x, (t.shape[0], limit.x.size))
    # between nodes of E the largest of affine functions is below its chord
    most = grid_values(limit, e, t).max(axis=2)
    return np.stack([_largest_between(limit.x, *row) for row in zip(most, lo, hi, strict=True)])


def _largest_between(x: Array, f: Array, lo: Array, hi: Array) -> Array:
    """Largest value of a table on intervals, its edge values beyond it, shape (n,)."""
    inside = (x > lo[:, None]) & (x < hi[:, None])
    nodes = np.where(inside, f, -np.inf).max(axis=1)
    out: Array = np.maximum(nodes, np.maximum(np.interp(lo, x, f), np.interp(hi, x, f)))
    return out
