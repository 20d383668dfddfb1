"""Owns which battery temperatures follow: what heats and cools at most, step by step and at stops.

Along the way the lower end of the interval is moved by the heat at *that* temperature: a cold
battery gives the heat pump little, whatever a warm one would. Proofs are in section 5 of
``docs/relaxation.md``. Knows nothing of energies, programs and solvers.
"""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.instance import Instance
from relax.intervals import Interval, range1
from relax.maps import Table1
from relax.physics import heat_pump_power
from relax.vehicle import Vehicle

__all__ = ["COOLING_SLACK_K", "cooling_floor_c", "pump_limits", "temperatures"]

Array = npt.NDArray[np.float64]

COOLING_SLACK_K = 0.01
"""How far below its temperature cooling may take a step: the simulation's own tolerance [K]."""
STEEPEST = 0.8
"""Largest change of a step's end with its own midpoint for which ends are moved along [K/K]:
below 1 there is one solution."""
ROUNDING_K = 1e-9
"""Added to an end that is moved, and once more per kW h/K of pace: more than its rounding [K]."""
FALL_POINTS = 17
"""Points between which the fall of a warm battery at a stop is bounded."""


def cooling_floor_c(vehicle: Vehicle) -> float:
    """Return the temperature below which no plan in the box cools [degrees C]."""
    return vehicle.cooling_from_c - COOLING_SLACK_K


def pump_limits(instance: Instance, demand: Array, cop: Interval) -> tuple[Array, Array, Array]:
    """Return the largest compressor power, the largest heat and the largest heat drawn.

    Parameters
    ----------
    instance : Instance
        Its vehicle's heat pump.
    demand : ndarray
        Cabin heating demand q, which the heat may not exceed [kW].
    cop : Interval
        Coefficient of performance at vanishing power.

    Returns
    -------
    tuple of ndarray
        hp_hi, h_hi and (h - hp)_hi, all >= 0 [kW].
    """
    vehicle = instance.vehicle
    droop, most = vehicle.heat_pump_droop_per_kw, vehicle.heat_pump_kw
    power = np.full(demand.shape, most)
    if np.all(cop.lo > 0.0):  # h grows with hp: h <= q bounds hp
        power = np.minimum(power, heat_pump_power(demand, cop.lo, droop))
    return power, *_pump_heat(instance, demand, cop.hi)


def _pump_heat(instance: Instance, demand: npt.ArrayLike, cop: Array) -> tuple[Array, Array]:
    """Largest heat of the heat pump at a CoP, and the largest heat drawn from the pack [kW]."""
    heat = np.minimum(demand, np.maximum(cop, 0.0) * _heat_per_cop(instance))
    return heat, heat * np.maximum(0.0, 1.0 - 1.0 / np.maximum(cop, 1.0))


def _heat_per_cop(instance: Instance) -> float:
    """Largest hp * (1 - droop * hp) of the heat pump [kW]: at full power."""
    most = instance.vehicle.heat_pump_kw
    return most * (1.0 - instance.vehicle.heat_pump_droop_per_kw * most)


def temperatures(
    instance: Instance,
    box: Box,
    power: Interval,
    heat: Interval,
    cell_power: Array,
    dwell_hi: Array,
) -> dict[str, Any]:
    """Return the temperature intervals after one sweep forwards and one backwards.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box
        A valid box.
    power, heat : Interval, shape (n,)
        Battery power, and heat into the battery but for cooling and ambient [kW].
    cell_power : ndarray, shape (S, K)
        Largest internal charging power of every cell [kW].
    dwell_hi : ndarray, shape (S, K)
        Longest dwell of every cell [h].

    Returns
    -------
    dict
        ``temperature``, ``stop_temperature`` and ``after_temperature`` of a box.
    """
    drive, stops, vehicle = instance.drive, instance.stops, instance.vehicle
    borders = [0, *(s.node for s in stops), drive.n_steps]
    node = Interval(box.temperature.lo.copy(), box.temperature.hi.copy())
    cell = Interval(box.stop_temperature.lo.copy(), box.stop_temperature.hi.copy())
    floor = cooling_floor_c(vehicle) if vehicle.cooling_kw > 0.0 else inf
    steps = _Steps(instance, _Colder(instance, box, power), heat, floor)
    after = Interval(box.after_temperature.lo.copy(), box.after_temperature.hi.copy())
    usable = ~box.unusable
    t0, t1 = float(node.lo[0]), float(node.hi[0])
    drifts = _Drifts(instance, box, cell_power, dwell_hi)
    for i in range(len(stops) + 1):
        a, b = borders[i], borders[i + 1]
        if b > a:
            t0, t1 = steps.forward(node, a, b, t0, t1)
        if i < len(stops):
            cold, warm = drifts.fall[i], drifts.rise[i]
            ambient = stops[i].ambient_c
            cell.lo[i, 0], cell.hi[i, 0] = max(cell.lo[i, 0], t0), min(cell.hi[i, 0], t1)
            cell.hi[i, 1:] = np.minimum(cell.hi[i, 1:], max(t1, ambient) + warm)
            begin, top = min(float(cell.lo[i, 0]), floor), float(cell.hi[i].max())
            fallen = _fallen(instance, i, float(box.stay.hi[i]), begin, top)
            least = max(fallen, min(t0, ambient, floor) - cold)
            cell.lo[i, 1:] = np.maximum(cell.lo[i, 1:], least)
            drifts.forward(i, cell.lo[i], cell.hi[i], floor)
            low, high = float(cell.lo[i, -1]), float(cell.hi[i, -1])
            if stops[i].optional:
                low = min(low, t0) if usable[i] else t0
                high = max(high, t1) if usable[i] else t1
            after.lo[i] = t0 = max(float(after.lo[i]), low)
            after.hi[i] = t1 = min(float(after.hi[i]), high)
    t0, t1 = -inf, inf  # after a stop at the destination nothing is known
    for i in range(len(stops), -1, -1):
        a, b = borders[i], borders[i + 1]
        if b > a:
            if i < len(stops):
                node.lo[b] = t0 = max(t0, float(node.lo[b]))
                node.hi[b] = t1 = min(t1, float(node.hi[b]))
            t0, t1 = steps.backward(node, a, b, i == 0)
        if i > 0:
            cold, warm = drifts.fall[i - 1], drifts.rise[i - 1]
            ambient = stops[i - 1].ambient_c
            last = cell.lo[i - 1], cell.hi[i - 1]
            after.lo[i - 1] = t0 = max(float(after.lo[i - 1]), t0)
            after.hi[i - 1] = t1 = min(float(after.hi[i - 1]), t1)
            last[0][-1], last[1][-1] = max(last[0][-1], t0), min(last[1][-1], t1)
            # the stop warms by at most ``warm`` unless ambient does
            if last[0][-1] - warm > ambient:
                last[0][:-1] = np.maximum(last[0][:-1], last[0][-1] - warm)
            if last[1][-1] + cold < min(ambient, floor):
                last[1][:-1] = np.minimum(last[1][:-1], last[1][-1] + cold)
            drifts.backward(i - 1, *last, floor)
            low, high = float(last[0][0]), float(last[1][0])
            if stops[i - 1].optional:
                low = min(low, t0) if usable[i - 1] else t0
                high = max(high, t1) if usable[i - 1] else t1
            t0, t1 = low, high
    return {
        "temperature": node.outward(),
        "stop_temperature": cell.outward(),
        "after_temperature": after.outward(),
    }


def _steepest(table: Table1, x: Interval) -> Array:
    """Largest slope of a table, without its sign, on intervals of shape (n,)."""
    over = (table.x[:-1] < x.hi[:, None]) & (table.x[1:] > x.lo[:, None])
    return np.asarray(np.where(over, np.abs(table.slopes), 0.0).max(axis=1))


class _Colder:
    """Where a step leads at least from the lower end of its start's interval, before cooling.

    With the least heat G(T_m) that any control gives at a midpoint temperature T_m, x = t +
    d/C G((t + x)/2) has one solution, found by a contraction by at most ``share``; a step
    that starts at t or above ends nowhere below it.
    """

    def __init__(self, instance: Instance, box: Box, power: Interval) -> None:
        vehicle, drive, pack = instance.vehicle, instance.drive, instance.vehicle.pack
        middle = box.middle_temperature
        square = range1(pack.voltage_squared, box.middle_energy)
        least = np.maximum(np.maximum(power.lo, -power.hi), 0.0) ** 2 + drive.ripple_kw2
        least = least / square.hi
        self.resistance, self.cop = pack.resistance_ohm.clamped(), vehicle.heat_pump_cop.clamped()
        self.per_cop, self.pumps = _heat_per_cop(instance), vehicle.heat_pump_kw > 0.0
        pace = drive.duration_h / pack.heat_capacity_kwh_per_k
        steep = _steepest(pack.resistance_ohm, middle) * least + drive.heat_loss_kw_per_k
        if self.pumps:
            heated = np.where(drive.cabin_heat_kw > 0.0, self.per_cop, 0.0)
            steep = steep + _steepest(vehicle.heat_pump_cop, middle) * heated
        self.share = 0.5 * pace * steep
        self.rows: list[tuple[float, ...]] = list(
            zip(
                self.share.tolist(), pace.tolist(), middle.lo.tolist(), middle.hi.tolist(),
                drive.drivetrain_heat_kw.tolist(), drive.heat_loss_kw_per_k.tolist(),
                drive.ambient_c.tolist(), drive.cabin_heat_kw.tolist(), least.tolist(),
                strict=True,
            )
        )  # fmt: skip

    def end(self, k: int, t: float) -> float:
        """Return what step k ends at least at from at least t; -inf if nothing is known."""
        share, pace, lo, hi, drivetrain, exchange, ambient, demand, least = self.rows[k]
        if not share <= STEEPEST:
            return -inf
        x = before = t
        for _ in range(2):
            before, middle = x, 0.5 * (t + x)
            at = lo if middle < lo else hi if middle > hi else middle
            drawn = 0.0
            if self.pumps and (cop := self.cop(at)) > 1.0:
                drawn = min(demand, cop * self.per_cop) * (1.0 - 1.0 / cop)
            loss = self.resistance(at) * least
            x = t + pace * (loss + drivetrain - drawn + exchange * (ambient - middle))
        return x - share / (1.0 - share) * abs(x - before) - ROUNDING_K * (1.0 + pace)


class _Steps:
    """Temperature intervals from step to step: T' = factor * T + gain, less what cooling takes.

    Plain floats: a recursion of a few hundred steps with a case in it.
    """

    def __init__(self, instance: Instance, colder: _Colder, heat: Interval, floor: float) -> None:
        drive, vehicle = instance.drive, instance.vehicle
        rate = vehicle.pack.heat_capacity_kwh_per_k / drive.duration_h
        half, drift = 0.5 * drive.heat_loss_kw_per_k, drive.heat_loss_kw_per_k * drive.ambient_c
        self.factor = ((rate - half) / (rate + half)).tolist()
        self.gain_lo = ((heat.lo + drift) / (rate + half)).tolist()
        self.gain_hi = ((heat.hi + drift) / (rate + half)).tolist()
        taken = vehicle.cooling_cop * vehicle.cooling_kw
        self.cooled = (taken / (rate + half)).tolist()
        share = np.minimum(colder.share, STEEPEST)
        self.cooled_along = (taken / rate / (1.0 - share)).tolist()
        self.floor, self.colder = floor, colder
        self.usable = min(self.factor, default=1.0) > 0.0

    def forward(self, node: Interval, a: int, b: int, t0: float, t1: float) -> tuple[float, float]:
        """Tighten the nodes a + 1 .. b; return the interval at b."""
        if not self.usable:
            return float(node.lo[b]), float(node.hi[b])
        lo, hi = node.lo[a + 1 : b + 1].tolist(), node.hi[a + 1 : b + 1].tolist()
        end, floor = self.colder.end, self.floor
        for j, k in enumerate(range(a, b)):
            t1 = min(hi[j], self.factor[k] * t1 + self.gain_hi[k])
            along, t0 = end(k, t0), self.factor[k] * t0 + self.gain_lo[k]
            if along > floor:  # cooling ends no step below its floor
                along = max(floor, along - self.cooled_along[k])
            if t0 > floor:
                t0 = max(floor, t0 - self.cooled[k])
            t0 = max(lo[j], t0, along)
            lo[j], hi[j] = t0, t1
        node.lo[a + 1 : b + 1], node.hi[a + 1 : b + 1] = lo, hi
        return t0, t1

    def backward(self, node: Interval, a: int, b: int, first: bool) -> tuple[float, float]:
        """Tighten the nodes b - 1 .. a + 1 (and a if ``first``); return the start of step a."""
        t0, t1 = float(node.lo[b]), float(node.hi[b])
        if not self.usable:
            return -inf, inf
        lo, hi = node.lo.tolist(), node.hi.tolist()
        for k in range(b - 1, a - 1, -1):
            taken = self.cooled[k] if t1 > self.floor else 0.0
            t1 = (t1 - self.gain_lo[k] + taken) / self.factor[k]
            t0 = (t0 - self.gain_hi[k]) / self.factor[k]
            if k > a or first:
                lo[k] = t0 = max(t0, lo[k])
                hi[k] = t1 = min(t1, hi[k])
        node.lo[:], node.hi[:] = lo, hi
        return t0, t1


def _spent(rate: Array, hours: npt.ArrayLike) -> Array:
    """Return rate times hours; without a rate nothing, however long (hours may be infinite)."""
    return np.asarray(np.multiply(rate, hours, out=np.zeros_like(rate), where=rate != 0.0))


def _fallen(instance: Instance, i: int, stay: float, low: float, top: float) -> float:
    """Return what a stop falls to at least [degrees C].

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    i : int
        The stop.
    stay : float
        Its longest stay [h].
    low : float
        It begins there or warmer; not above what cooling may end at, so that below it
        nothing cools [degrees C].
    top : float
        No cell border is warmer [degrees C].
    """
    stop, vehicle = instance.stops[i], instance.vehicle
    at = np.linspace(low, max(top, low), FALL_POINTS)
    table = vehicle.heat_pump_cop
    # made never to fall, nowhere below the table: what is colder than ``low`` draws no more
    cop = np.interp(at, table.x, np.maximum.accumulate(table.f))
    _, drawn = _pump_heat(instance, stop.cabin_heat_kw, cop)
    fall = np.maximum(drawn + stop.heat_loss_kw_per_k * (at - stop.ambient_c), 0.0)
    pace = max(stay, 0.0) / vehicle.pack.heat_capacity_kwh_per_k
    fall = _spent(fall, pace)
    # the cell that crosses ``low`` may have its midpoint above, where more is drawn
    crossing = (at[:-1] - 0.5 * fall[1:]).min()
    return float(min(low - fall[0], crossing)) - ROUNDING_K * (1.0 + pace)


class _Drifts:
    """Largest fall and rise of temperature within every stop, and within each of its cells [K].

    Those of a stop are beside cooling and what ambient gives or takes, those of a cell beside
    cooling.
    """

    def __init__(self, instance: Instance, box: Box, cell_power: Array, dwell_hi: Array) -> None:
        stops, vehicle, shape = instance.stops, instance.vehicle, cell_power.shape
        pack, capacity = vehicle.pack, vehicle.pack.heat_capacity_kwh_per_k
        temp, out = box.cell_temperature, np.array([s.detour_out_kwh for s in stops])
        energy = Interval(box.arrive.lo, box.leave.hi + out)
        cop = range1(vehicle.heat_pump_cop, temp)
        q, ambient, exchange = (
            np.array([x]).reshape(-1, 1)
            for x in (
                [s.cabin_heat_kw for s in stops],
                [s.ambient_c for s in stops],
                [s.heat_loss_kw_per_k for s in stops],
            )
        )
        pump, _, drawn = pump_limits(instance, np.broadcast_to(q, shape), cop)
        gain = np.minimum(0.0, cop.lo * (1.0 - vehicle.heat_pump_droop_per_kw * pump) - 1.0)
        r = range1(pack.resistance_ohm, temp).hi
        r = r / range1(pack.voltage_squared, energy).lo[:, None]
        loss = r * cell_power * box.charge.hi[:, None] / instance.cells
        warm = vehicle.heater_battery_efficiency * vehicle.heater_kw - gain * pump
        warm = np.maximum(warm, 0.0)
        longest = box.stay.hi[:, None]
        # where the exchange is too fast a cell may overshoot ambient
        slow = _spent(0.5 * exchange, longest)[:, 0] < capacity
        fall = _spent(drawn.max(axis=1, initial=0.0), longest[:, 0])
        rise = loss.sum(axis=1) + _spent(warm.max(axis=1, initial=0.0), longest[:, 0])
        self.fall = np.where(slow, fall / capacity, inf).tolist()
        self.rise = np.where(slow, rise / capacity, inf).tolist()
        pace = np.maximum(dwell_hi, 0.0) / capacity
        falls = drawn + exchange * np.maximum(temp.hi - ambient, 0.0)
        rises = warm + exchange * np.maximum(ambient - temp.lo, 0.0)
        room = ROUNDING_K * (1.0 + pace)
        self.cell_fall = (_spent(falls, pace) + room).tolist()
        self.cell_rise = (_spent(rises, pace) + loss / capacity + room).tolist()
        cooling = np.full(shape, vehicle.cooling_cop * vehicle.cooling_kw)
        self.cell_cooled = _spent(cooling, pace).tolist()

    def forward(self, i: int, lo: Array, hi: Array, floor: float) -> None:
        """Tighten the cell borders of stop i from the first to the last."""
        low, high = float(lo[0]), float(hi[0])
        for j, (fall, rise) in enumerate(zip(self.cell_fall[i], self.cell_rise[i], strict=True)):
            lo[j + 1] = low = max(float(lo[j + 1]), min(low - fall, floor))
            hi[j + 1] = high = min(float(hi[j + 1]), high + rise)

    def backward(self, i: int, lo: Array, hi: Array, floor: float) -> None:
        """Tighten them from the last to the first."""
        low, high = float(lo[-1]), float(hi[-1])
        for j in reversed(range(len(lo) - 1)):
            cooled = self.cell_cooled[i][j] if high > floor else 0.0
            lo[j] = low = max(float(lo[j]), low - self.cell_rise[i][j])
            hi[j] = high = min(float(hi[j]), high + self.cell_fall[i][j] + cooled)
