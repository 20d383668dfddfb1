"""Owns the exact equations (P1) .. (P7) of the car in floats, for one right-hand side at a time.

Written apart from the transcription's twin in ``step``. Tables are read where they are
defined, or, for a car *at the edge*, also a little beyond, at their nearest point. Knows
nothing of trips, plans or integrators.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import numpy.typing as npt

from relax.errors import DomainError
from relax.maps import Table1, Table2
from relax.vehicle import Vehicle

__all__ = ["EDGE_K", "EDGE_KWH", "ExactCar", "discharge_power"]

MANAGED_K = 0.2
"""Band below a limit in which heater or cooling is taken back to zero [K]."""
MANAGED_KWH = 0.02
"""Band below the largest energy in which recuperation is taken back to zero [kWh]."""
EDGE_K = 5.0
"""How far beyond its tables a car at the edge is driven: a plan that misses a limit by more
is not one that a repair would bring back [K]."""
EDGE_KWH = 1.0
"""Likewise for the energy [kWh]."""


def _read(table: Table1, beyond: float) -> Callable[[float], float]:
    """Return a table as a function, with its nearest point up to ``beyond`` its ends."""
    if beyond == 0.0:
        return table.at
    lo, hi = table.lo, table.hi

    def at(x: float) -> float:
        try:
            return table.at(x)
        except DomainError:
            inside = min(max(x, lo), hi)
            if not abs(x - inside) <= beyond:  # also if it is no number
                raise
            return table.at(inside)

    return at


def _read2(table: Table2, beyond: tuple[float, float]) -> Callable[[float, float], float]:
    """Return a table of energy and temperature as a function, likewise."""
    if beyond == (0.0, 0.0):
        return table.at
    (x_lo, x_hi), (y_lo, y_hi) = ((float(g[0]), float(g[-1])) for g in (table.x, table.y))

    def at(x: float, y: float) -> float:
        try:
            return table.at(x, y)
        except DomainError:
            in_x, in_y = min(max(x, x_lo), x_hi), min(max(y, y_lo), y_hi)
            if not (abs(x - in_x) <= beyond[0] and abs(y - in_y) <= beyond[1]):
                raise
            return table.at(in_x, in_y)

    return at


def _common(axes: list[npt.NDArray[np.float64]]) -> tuple[float, float]:
    """Return the range that all axes cover."""
    return max(float(x[0]) for x in axes), min(float(x[-1]) for x in axes)


class ExactCar:
    """The vehicle's maps and actuators as floats and functions of floats.

    Parameters
    ----------
    vehicle : Vehicle
        The car.
    edge : bool
        Whether tables are read a little beyond their ends too, at their nearest point. A
        state there breaks a limit, so no plan that holds rests on it, rounding aside.
    """

    def __init__(self, vehicle: Vehicle, edge: bool = False) -> None:
        pack = vehicle.pack
        self.vehicle = vehicle
        self._kwh, self._k = (EDGE_KWH, EDGE_K) if edge else (0.0, 0.0)
        both = self._kwh, self._k
        self.resistance = _read(pack.resistance_ohm, self._k)
        self.voltage_squared = self.over_energy(pack.voltage_squared)
        self.cop = _read(vehicle.heat_pump_cop, self._k)
        self.charge_limit = _read2(pack.charge_limit_kw, both)
        self.discharge_limit = _read2(pack.discharge_limit_kw, both)
        self.capacity = pack.heat_capacity_kwh_per_k
        self.top, self.floor = pack.temperature_max_c, vehicle.cooling_from_c
        limits = (pack.charge_limit_kw, pack.discharge_limit_kw)
        energies = [pack.voltage_squared.x, *(t.x for t in limits)]
        temps = [pack.resistance_ohm.x, *(t.y for t in limits)]
        if vehicle.heat_pump_kw > 0.0:
            temps.append(vehicle.heat_pump_cop.x)
        self.energy_range = _common(energies)
        self.temperature_range = _common(temps)

    def over_energy(self, table: Table1) -> Callable[[float], float]:
        """Return a table over the energy as a function, read as the car's own are."""
        return _read(table, self._kwh)

    def managed(self, temp: float, heater: float, cooling: float) -> tuple[float, float]:
        """Return heater and cooling as the car allows them near its temperature limits.

        Both are taken back in proportion: the heater to zero at the battery's
        limit, cooling to zero at the temperature from which it works.
        """
        if heater > 0.0 and temp > self.top - MANAGED_K:
            heater *= max((self.top - temp) / MANAGED_K, 0.0)
        if cooling > 0.0 and temp < self.floor + MANAGED_K:
            cooling *= max((temp - self.floor) / MANAGED_K, 0.0)
        return heater, cooling

    def accepted(self, power: float, room: float) -> float:
        """Return the internal power that a battery with so much room left takes [kW].

        Recuperation is taken back in proportion, to zero where the battery is full.
        """
        if power < 0.0 and room < MANAGED_KWH:
            power *= max(room / MANAGED_KWH, 0.0)
        return power

    def heating(
        self, temp: float, demand: float, heater_set: float, pump_set: float
    ) -> tuple[float, float, float, float]:
        """Return heater, heat pump, its heat and cabin heater power, clipped to what is asked."""
        v = self.vehicle
        pump = heat = 0.0
        if pump_set > 0.0 and demand > 0.0:
            cop, droop = self.cop(temp), v.heat_pump_droop_per_kw
            pump = min(pump_set, v.heat_pump_kw)
            heat = cop * pump * (1.0 - droop * pump)
            if heat > demand:
                ratio = demand / cop
                pump = 2.0 * ratio / (1.0 + sqrt(1.0 - 4.0 * droop * ratio))
                heat = demand
        cabin = (demand - heat) / v.heater_cabin_efficiency
        return max(min(heater_set, v.heater_kw - cabin), 0.0), pump, heat, cabin

    def rates(
        self,
        power: float,
        r: float,
        use: tuple[float, float, float, float, float, float],
        climate: tuple[float, float, float],
        grid: float,
        temp: float,
    ) -> list[float]:
        """Return the time derivatives of the integrated state."""
        v = self.vehicle
        base, heater, cooling, pump, heat, cabin = use
        ambient, conductance, drivetrain = climate
        loss = r * power * power
        exchange = conductance * (ambient - temp)
        flow = loss + drivetrain + exchange - (heat - pump)
        flow += v.heater_battery_efficiency * heater - v.cooling_cop * cooling
        return [
            -power, flow / self.capacity, 1.0, grid, loss, base, heater, cabin, cooling, pump, heat,
            exchange, drivetrain, 0.0,
        ]  # fmt: skip


def discharge_power(load: float, r: float) -> float:
    """Return the internal power that serves a load (P3) [kW].

    Raises
    ------
    DomainError
        No power does.

    Examples
    --------
    >>> discharge_power(19.9, 0.00025)
    20.0
    """
    root = 1.0 - 4.0 * r * load
    if root < 0.0:
        raise DomainError("the electrical load exceeds the largest power of the pack")
    return 2.0 * load / (1.0 + sqrt(root))
