"""Owns the transcription's driving step and charging cell for many states and controls at once.

Arrays only, written apart from ``relax.step``: the same equations ((T1) .. (T9) of
``docs/maths.md``), solved by fixed-point iteration instead of secants. Controls are *levels*
between nothing and what the actuators allow at that state, so the extreme ones are met
exactly. Knows nothing of value functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from relax.instance import HEATER_SHARE, LEAST_ROOM_KW, Drive, Stop
from relax.maps import Table2
from relax.physics import heat_pump_power
from relax.vehicle import Vehicle

__all__ = ["CarArrays", "Cells", "Levels", "Steps", "make_levels"]

Array = npt.NDArray[np.float64]

ITERATIONS = 5
"""Fixed-point iterations of the implicit midpoint; each gains a factor of 10 or more."""
COOLING = (0.1, 0.3, 1.0)
"""Levels of battery cooling: the least that keeps a limit is what is wanted of it."""
LEAST_COP = 1e-9
"""A cooling without effect is no division by zero."""
LEAST_LIMIT_KW = 0.05
"""Charging power below which a cell counts as impossible [kW]: cells need a finite dwell."""


@dataclass(frozen=True)
class Levels:
    """Combinations of control levels, each from 0 to 1; arrays of shape (u,).

    Parameters
    ----------
    heater, cooling, pump : ndarray
        Share of what the actuator may take: the heater of what the cabin leaves, the heat
        pump of the lesser of its power and the cabin's demand.
    power : ndarray
        Share of the charging limit; not used while driving.
    """

    heater: Array
    cooling: Array
    pump: Array
    power: Array


def make_levels(
    vehicle: Vehicle,
    demand_kw: float,
    heater: int,
    pump: int,
    power: tuple[float, ...] = (1.0,),
    cooling: bool = True,
) -> Levels:
    """Return all combinations worth a look: never heating and cooling at once.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    demand_kw : float
        Cabin heat demand; without one there is nothing to pump.
    heater, pump : int
        Number of levels from 0 to 1 of heater and heat pump.
    power : tuple of float
        Levels of the charging power.
    cooling : bool
        Whether the battery may be cooled.
    """
    has_pump = vehicle.heat_pump_kw > 0.0 and demand_kw > 0.0
    heats = np.linspace(0.0, 1.0, heater).tolist() if vehicle.heater_kw > 0.0 else [0.0]
    pumps = np.linspace(0.0, 1.0, pump).tolist() if has_pump else [0.0]
    thermal = [(h, 0.0) for h in heats]
    if cooling and vehicle.cooling_kw > 0.0:
        thermal += [(0.0, level) for level in COOLING]
    rows = np.array([(*t, p, f) for t, p, f in product(thermal, pumps, power)])
    return Levels(*(np.ascontiguousarray(column) for column in rows.T))


@dataclass(frozen=True)
class Steps:
    """Outcome of driving steps; arrays of one shape.

    Parameters
    ----------
    drop_kwh : ndarray
        Internal energy used.
    end_c : ndarray
        Temperature at the end.
    broken : ndarray
        By how much limits are broken: discharge power and temperature [kW and K, summed].
    heater_kw, cooling_kw, pump_kw : ndarray
        Powers behind the levels.
    """

    drop_kwh: Array
    end_c: Array
    broken: Array
    heater_kw: Array
    cooling_kw: Array
    pump_kw: Array


@dataclass(frozen=True)
class Cells:
    """Outcome of charging cells; arrays of one shape.

    Parameters
    ----------
    end_c : ndarray
        Temperature at the end.
    dwell_h, grid_kwh : ndarray
        Time and energy from the grid.
    power_kw, heater_kw, cooling_kw, pump_kw : ndarray
        Internal charging power, and powers behind the levels.
    broken : ndarray
        By how much temperature limits are broken [K].
    allowed : ndarray of bool
        Whether there is any charging power.
    """

    end_c: Array
    dwell_h: Array
    grid_kwh: Array
    power_kw: Array
    heater_kw: Array
    cooling_kw: Array
    pump_kw: Array
    broken: Array
    allowed: npt.NDArray[np.bool_]


def _bilinear(table: Table2, x: Array, y: Array) -> Array:
    """Return a table at points of one shape, clamped to its domain."""
    x, y = np.clip(x, table.x[0], table.x[-1]), np.clip(y, table.y[0], table.y[-1])
    i = np.clip(np.searchsorted(table.x, x, "right") - 1, 0, table.x.size - 2)
    j = np.clip(np.searchsorted(table.y, y, "right") - 1, 0, table.y.size - 2)
    u = (x - table.x[i]) / (table.x[i + 1] - table.x[i])
    v = (y - table.y[j]) / (table.y[j + 1] - table.y[j])
    low = table.f[i, j] + v * (table.f[i, j + 1] - table.f[i, j])
    high = table.f[i + 1, j] + v * (table.f[i + 1, j + 1] - table.f[i + 1, j])
    return np.asarray(low + u * (high - low))


class CarArrays:
    """The car's equations on arrays.

    Parameters
    ----------
    vehicle : Vehicle
        Maps and actuators.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.pack = vehicle, vehicle.pack
        self.capacity = vehicle.pack.heat_capacity_kwh_per_k

    def _resistance(self, energy: Array, temp: Array) -> Array:
        pack = self.pack
        ohm = np.interp(temp, pack.resistance_ohm.x, pack.resistance_ohm.f)
        square = pack.voltage_squared
        return np.asarray(ohm / np.interp(energy, square.x, square.f))

    def _actuators(
        self, temp: Array, demand: float, levels: Levels
    ) -> tuple[Array, Array, Array, Array]:
        """Return heater, heat pump, heat taken from the battery, and cabin heater power."""
        v = self.vehicle
        if demand > 0.0 and v.heat_pump_kw > 0.0:
            cop = np.interp(temp, v.heat_pump_cop.x, v.heat_pump_cop.f)
            droop = v.heat_pump_droop_per_kw
            most = np.minimum(heat_pump_power(np.array(demand), cop, droop), v.heat_pump_kw)
            pump = levels.pump * most
            heat = cop * pump * (1.0 - droop * pump)
        else:
            pump = heat = np.zeros(np.broadcast_shapes(temp.shape, levels.pump.shape))
        cabin = (demand - heat) / v.heater_cabin_efficiency
        heater = levels.heater * np.maximum(v.heater_kw - cabin, 0.0)
        return heater, pump, heat - pump, cabin

    def drive(self, drive: Drive, k: int, energy: Array, temp: Array, levels: Levels) -> Steps:
        """Advance step k; ``energy`` and ``temp`` broadcast with the levels in the last axis."""
        v = self.vehicle
        d, base, ripple, q_ed, ambient, g, demand = (
            float(column[k])
            for column in (
                drive.duration_h, drive.base_kw, drive.ripple_kw2, drive.drivetrain_heat_kw,
                drive.ambient_c, drive.heat_loss_kw_per_k, drive.cabin_heat_kw,
            )
        )  # fmt: skip
        shape = np.broadcast_shapes(energy.shape, temp.shape, levels.heater.shape)
        energy, temp = np.broadcast_to(energy, shape), np.broadcast_to(temp, shape)
        end, power = temp, np.full(shape, base)
        rate = self.capacity / d
        for _ in range(ITERATIONS):
            mid, e_mid = 0.5 * (temp + end), energy - 0.5 * d * power
            heater, pump, drawn, cabin = self._actuators(mid, demand, levels)
            r = self._resistance(e_mid, mid)
            free = q_ed - drawn + g * (ambient - mid) + r * (power * power + ripple)
            heater, cooling = self._thermostats(temp, free, rate, heater, levels)
            load = base + heater + cooling + pump + cabin + r * ripple
            root = np.sqrt(np.maximum(1.0 - 4.0 * r * load, 0.0))
            power = 2.0 * load / (1.0 + root)
            if base < 0.0:  # the battery refuses what it cannot take: friction brake
                limit = _bilinear(self.pack.charge_limit_kw, energy - 0.5 * d * power, mid)
                power = np.maximum(power, -limit)
            flow = r * (power * power + ripple) + q_ed + v.heater_battery_efficiency * heater
            flow = flow - v.cooling_cop * cooling - drawn + g * (ambient - mid)
            end = temp + flow / rate
        broken = self._broken(end)
        most = self.pack.discharge_limit_kw
        if float(power.max()) > float(most.f.min()):
            room = _bilinear(most, energy - 0.5 * d * power, 0.5 * (temp + end))
            broken = broken + np.maximum(power - room, 0.0)
        return Steps(d * power, end, broken, heater, cooling, pump)

    def _broken(self, end: Array) -> Array:
        """Return by how much temperature limits are broken [K]."""
        over = np.maximum(end - self.pack.temperature_max_c, 0.0)
        return np.asarray(over + np.maximum(self.pack.temperature_min_c - end, 0.0))

    def _thermostats(
        self, temp: Array, free: Array, rate: Array | float, heater: Array, levels: Levels
    ) -> tuple[Array, Array]:
        """Return heater and cooling, cut back at the limit and at cooling's own temperature.

        ``free`` is the heat flow without both [kW], ``rate`` the heat capacity over the
        duration [kW/K].
        """
        v = self.vehicle
        most = (self.pack.temperature_max_c - temp) * rate - free
        heater = np.maximum(np.minimum(heater, most / v.heater_battery_efficiency), 0.0)
        spare = free + v.heater_battery_efficiency * heater + (temp - v.cooling_from_c) * rate
        cooling = np.minimum(levels.cooling * v.cooling_kw, spare / max(v.cooling_cop, LEAST_COP))
        return heater, np.maximum(cooling, 0.0)

    def charge(
        self, stop: Stop, energy: Array, temp: Array, portion: Array | float, levels: Levels
    ) -> Cells:
        """Charge a cell of ``portion`` kWh from ``energy``; broadcasting as in ``drive``."""
        v = self.vehicle
        shape = np.broadcast_shapes(energy.shape, temp.shape, levels.heater.shape)
        temp = np.broadcast_to(temp, shape)
        e_mid = np.broadcast_to(energy + 0.5 * portion, shape)
        grid = stop.grid_limit_kw
        grid_max = np.interp(e_mid, grid.x, grid.f)
        end = temp
        wanted = np.broadcast_to(levels.cooling * v.cooling_kw, shape)
        for _ in range(ITERATIONS):
            mid = 0.5 * (temp + end)
            heater, pump, drawn, cabin = self._actuators(mid, stop.cabin_heat_kw, levels)
            r = self._resistance(e_mid, mid)
            free = grid_max - stop.base_kw - cabin - pump - wanted
            heater = np.maximum(np.minimum(heater, HEATER_SHARE * free), 0.0)
            room = np.maximum(free - heater, LEAST_ROOM_KW)
            most = np.minimum(
                _bilinear(self.pack.charge_limit_kw, e_mid, mid),
                2.0 * room / (1.0 + np.sqrt(1.0 + 4.0 * r * room)),
            )
            power = levels.power * np.maximum(most, LEAST_LIMIT_KW)
            dwell = portion / power
            loss = r * power * power
            flow = loss - drawn + stop.heat_loss_kw_per_k * (stop.ambient_c - mid)
            heater, cooling = self._thermostats(temp, flow, self.capacity / dwell, heater, levels)
            flow = flow + v.heater_battery_efficiency * heater - v.cooling_cop * cooling
            end = temp + flow * dwell / self.capacity
        use = power + loss + stop.base_kw + heater + cooling + pump + cabin
        allowed = most > LEAST_LIMIT_KW
        broken = self._broken(end)
        return Cells(end, dwell, use * dwell, power, heater, cooling, pump, broken, allowed)
