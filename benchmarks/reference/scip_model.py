"""Owns the transcription as a program for SCIP: every choice, every product, bounds on everything.

Written as a global solver wants it: linear where it is linear, bilinear where
it must be, one power or dwell shared by all products of a cell, finite bounds
on all variables. Maps are the forms of ``scip_maps`` with their margins, so a
plan simulated on the tables is a point of the program (``values_of``), and
SCIP's dual bound is one for the transcription itself. Knows no search.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from pyscipopt import Model, quicksum

from benchmarks.reference.scip_car import Maps, fit_maps, largest_power, table_range
from benchmarks.reference.scip_maps import FIT_TOLERANCE, Band
from relax.instance import MIN_CHARGE_KWH, Instance, Stop

__all__ = ["COOLING_SLACK_K", "SCALES", "ScipModel", "make_scip_model", "scale_of"]

COOLING_SLACK_K = 0.01
"""Width of the thermostat of the cooling in the simulation, generously [K]."""
SCALES = {
    "resistance": 0.1,
    "voltage": 100.0,
    "dwell": 0.01,
    "charge_power": 100.0,
    "power": 10.0,
    "energy": 10.0,
    "arrive": 10.0,
    "leave": 10.0,
    "charge": 10.0,
    "end": 10.0,
}
"""Size of variables by their names, where it is not one [ohm, kW ohm, h, kW, kWh, K]."""
Row = dict[str, Any]


def scale_of(name: str) -> float:
    """Return the size of a variable by its name."""
    return SCALES.get(name.removesuffix("_form"), 1.0)


@dataclass
class ScipModel:
    """A program of SCIP and where its variables are.

    Parameters
    ----------
    instance : Instance
        What it transcribes.
    maps : Maps
        Its maps.
    model : pyscipopt.Model
        The program.
    steps, cells : list
        Variables by name: per driving step; per stop and cell.
    stops : list of dict
        ``use``, ``charge``, ``over`` of every stop.
    """

    instance: Instance
    maps: Maps
    model: Any
    steps: list[Row] = field(default_factory=list)
    cells: list[list[Row]] = field(default_factory=list)
    stops: list[Row] = field(default_factory=list)


class _Writer:
    """Writes steps and stops; the state runs along."""

    def __init__(self, instance: Instance, maps: Maps, optional: bool) -> None:
        self.instance, self.maps, self.optional = instance, maps, optional
        self.out = ScipModel(instance, maps, Model("trip"))
        self.model = self.out.model
        self.energy: Any = instance.start_energy_kwh
        self.temp: Any = instance.start_temperature_c
        self.costs: list[Any] = []
        self.stopped: list[Any] = []
        car, pack = instance.vehicle, instance.vehicle.pack
        t = instance.temperature_min_c, instance.temperature_max_c
        low = min(float(instance.energy_min_kwh.min()), instance.end_energy_min_kwh)
        self.resistance = table_range(pack.resistance_ohm, *t)
        self.voltage = table_range(pack.voltage_squared, low, instance.ceiling_kwh)
        self.cop = table_range(car.heat_pump_cop, *t)
        self.r_max = self.resistance[1] / self.voltage[0]
        self.low = low
        self.charge_max = float(pack.charge_limit_kw.f.max())

    def variable(self, row: Row, name: str, lo: float | None, hi: float | None) -> Any:
        """Add a variable under a name of a row; bounds and result in physical units."""
        scale = scale_of(name)
        row[name] = self.model.addVar(
            name, lb=None if lo is None else lo / scale, ub=None if hi is None else hi / scale
        )
        return row[name] * scale

    def temperature(self, row: Row) -> Any:
        """Add the temperature that follows."""
        instance = self.instance
        return self.variable(row, "end", instance.temperature_min_c, instance.temperature_max_c)

    def banded(self, row: Row, name: str, band: Band, at: Any, lo: float, hi: float) -> Any:
        """Return a variable for a table's value at an expression: anything within the margins."""
        if band.form.is_affine and band.deviation == 0.0:
            return band.form(at)
        form = band.form(at)
        if band.deviation == 0.0:
            value = self.variable(row, name, lo, hi)
            self.model.addCons(value == form)
            return value
        if not band.form.is_affine:
            own = self.variable(row, f"{name}_form", lo / band.upper, hi / band.lower)
            self.model.addCons(own == form)
            form = own
        value = self.variable(row, name, lo, hi)
        self.model.addCons(value >= band.lower * form)
        self.model.addCons(value <= band.upper * form)
        return value

    def loss_factors(self, row: Row, mid_energy: Any, mid: Any) -> tuple[Any, Any]:
        """Return resistance and squared voltage at a midpoint."""
        maps = self.maps
        voltage = self.banded(row, "voltage", maps.voltage_squared, mid_energy, *self.voltage)
        return self.banded(row, "resistance", maps.resistance, mid, *self.resistance), voltage

    def pump_balance(self, row: Row, heat: Any, work: Any, mid: Any) -> None:
        """Add heat = cop * work, work the compressor power without its droop."""
        band = self.maps.cop
        assert band is not None
        lo, hi = self.cop
        if self.maps.inverse_cop:
            inverse = self.banded(row, "cop", band, mid, 1.0 / hi, 1.0 / lo)
            self.model.addCons(heat * inverse == work)
        else:
            self.model.addCons(heat == self.banded(row, "cop", band, mid, lo, hi) * work)

    def floor(self, cooling: Any, most: Any, end: Any) -> None:
        """Add that cooling needs an end above its own temperature, as far as linear rows can."""
        car, lowest = self.instance.vehicle, self.instance.temperature_min_c
        floor = car.cooling_from_c - COOLING_SLACK_K
        if floor > lowest:
            self.model.addCons(cooling * (floor - lowest) <= most * (end - lowest))


def _write_step(w: _Writer, k: int) -> None:
    instance, car, drive, model = w.instance, w.instance.vehicle, w.instance.drive, w.model
    d, base, ripple, q_ed, g, ambient, demand = (
        float(a[k])
        for a in (
            drive.duration_h, drive.base_kw, drive.ripple_kw2, drive.drivetrain_heat_kw,
            drive.heat_loss_kw_per_k, drive.ambient_c, drive.cabin_heat_kw,
        )
    )  # fmt: skip
    row: Row = {}
    has_pump = car.heat_pump_kw > 0.0 and demand > 0.0
    cabin_most = demand / car.heater_cabin_efficiency
    most = base + max(car.heater_kw, cabin_most) + car.cooling_kw + car.heat_pump_kw
    most += max(0.0, -base)
    largest = largest_power(most, w.r_max, ripple)
    power = w.variable(row, "power", base, largest)
    loss = w.variable(row, "loss", 0.0, w.r_max * (max(base * base, largest * largest) + ripple))
    heater = w.variable(row, "heater", 0.0, car.heater_kw)
    cooling = w.variable(row, "cooling", 0.0, car.cooling_kw) if car.cooling_kw > 0.0 else 0.0
    pump = w.variable(row, "pump", 0.0, car.heat_pump_kw) if has_pump else 0.0
    heat = w.variable(row, "heat", 0.0, demand) if has_pump else 0.0
    brake = w.variable(row, "brake", 0.0, -base) if base < 0.0 else 0.0
    at_end = max(float(instance.energy_min_kwh[k + 1]), 0.0)
    end_energy = w.variable(row, "energy", at_end, instance.ceiling_kwh)
    end = w.temperature(row)
    mid_energy, mid = 0.5 * (w.energy + end_energy), 0.5 * (w.temp + end)
    cabin = (demand - heat) / car.heater_cabin_efficiency
    model.addCons(power * d == w.energy - end_energy)
    model.addCons(power == loss + base + heater + cooling + pump + cabin + brake)
    flow = loss + q_ed + car.heater_battery_efficiency * heater - car.cooling_cop * cooling
    flow = flow - (heat - pump) + g * (ambient - mid)
    model.addCons(car.pack.heat_capacity_kwh_per_k / d * (end - w.temp) == flow)
    resistance, voltage = w.loss_factors(row, mid_energy, mid)
    model.addCons(0.1 * loss * voltage == 0.1 * resistance * (power * power + ripple))
    if has_pump:
        w.pump_balance(row, heat, pump - car.heat_pump_droop_per_kw * pump * pump, mid)
    model.addCons(heater + cabin <= car.heater_kw)
    if car.cooling_kw > 0.0:
        w.floor(cooling, car.cooling_kw, end)
    w.energy, w.temp = end_energy, end
    w.out.steps.append(row)


def _write_cell(w: _Writer, i: int, j: int, stop: Stop, arrive: Any, portion: Any) -> Any:
    """One charging cell; returns its dwell."""
    car, model = w.instance.vehicle, w.model
    row: Row = {}
    demand, top = stop.cabin_heat_kw, w.instance.energy_max_kwh
    has_pump = car.heat_pump_kw > 0.0 and demand > 0.0
    longest = stop.max_dwell_h
    dwell = w.variable(row, "dwell", 0.0, longest)
    power = w.variable(row, "charge_power", 0.0, w.charge_max)
    loss_most = w.r_max * w.charge_max * top / w.instance.cells
    loss = w.variable(row, "loss", 0.0, loss_most)
    heater = w.variable(row, "heater", 0.0, car.heater_kw * longest)
    cooling = w.variable(row, "cooling", 0.0, car.cooling_kw * longest)
    pump = heat = 0.0
    end = w.temperature(row)
    mid_energy, mid = arrive + (j + 0.5) * portion, 0.5 * (w.temp + end)
    if has_pump:
        pump = w.variable(row, "pump", 0.0, car.heat_pump_kw * longest)
        heat = w.variable(row, "heat", 0.0, demand * longest)
        rate = w.variable(row, "pump_power", 0.0, car.heat_pump_kw)
        model.addCons(pump == rate * dwell)
        w.pump_balance(row, heat, pump - car.heat_pump_droop_per_kw * rate * pump, mid)
        model.addCons(heat <= demand * dwell)
        model.addCons(pump <= car.heat_pump_kw * dwell)
    model.addCons(portion == power * dwell)
    _cap(w, row, power, mid_energy, mid)
    resistance, voltage = w.loss_factors(row, mid_energy, mid)
    model.addCons(loss * voltage == resistance * (power * portion))
    model.addCons(loss <= w.r_max * w.charge_max * portion)
    cabin = (demand * dwell - heat) / car.heater_cabin_efficiency
    flow = loss + car.heater_battery_efficiency * heater - car.cooling_cop * cooling
    flow = flow - (heat - pump) + stop.heat_loss_kw_per_k * (stop.ambient_c * dwell - mid * dwell)
    model.addCons(car.pack.heat_capacity_kwh_per_k * (end - w.temp) == flow)
    model.addCons(heater + cabin <= car.heater_kw * dwell)
    model.addCons(cooling <= car.cooling_kw * dwell)
    if car.cooling_kw > 0.0:
        w.floor(cooling, car.cooling_kw * longest, end)
    grid = portion + loss + stop.base_kw * dwell + heater + cooling + pump + cabin
    model.addCons(grid <= _grid_limit(w, row, i, mid_energy) * dwell)
    w.costs.append(stop.price_per_kwh * grid + stop.time_price_per_h * dwell)
    w.temp = end
    w.out.cells[-1].append(row)
    return dwell


def _grid_limit(w: _Writer, row: Row, i: int, at: Any) -> Any:
    """Return the charger's limit: a number if it is constant."""
    table = w.instance.stops[i].grid_limit_kw
    lo, hi = table_range(table, w.low, w.instance.ceiling_kwh)
    return hi if hi == lo else w.banded(row, "grid_limit", w.maps.grid_limit[i], at, lo, hi)


def _cap(w: _Writer, row: Row, power: Any, energy: Any, temp: Any) -> None:
    """Add power <= charge limit."""
    cap = w.maps.charge_limit
    total: Any = cap.level
    for n, (f, g) in enumerate(cap.terms):
        factors = []
        for name, form, at in ((f"cap_e{n}", f, energy), (f"cap_t{n}", g, temp)):
            values = form(form.middle + form.half * np.linspace(-1.0, 1.0, 401))
            spread = 0.02 * float(np.ptp(values)) + 1e-6
            own = w.variable(row, name, float(values.min()) - spread, float(values.max()) + spread)
            w.model.addCons(own == form(at))
            factors.append(own)
        total = total + factors[0] * factors[1]
    w.model.addCons(power <= cap.factor * total)


def _write_stop(w: _Writer, i: int, stop: Stop) -> None:
    instance, model = w.instance, w.model
    top = instance.energy_max_kwh
    ceiling = instance.ceiling_kwh
    row: Row = {}
    w.out.stops.append(row)
    w.out.cells.append([])
    use: Any = 1.0
    charge = w.variable(row, "charge", 0.0 if w.optional else MIN_CHARGE_KWH, top)
    if w.optional:
        use = row["use"] = model.addVar("use", vtype="B")
        model.addCons(charge >= MIN_CHARGE_KWH * use)
        model.addCons(charge <= top * use)
    arrive = w.variable(row, "arrive", stop.arrive_min_kwh, ceiling)
    model.addCons(arrive == w.energy - stop.detour_in_kwh * use)
    portion = w.variable(row, "portion", 0.0, top / instance.cells)
    model.addCons(portion * instance.cells == charge)
    model.addCons(arrive + charge <= top + (ceiling - top) * (1.0 - use))
    dwell = quicksum([_write_cell(w, i, j, stop, arrive, portion) for j in range(instance.cells)])
    model.addCons(dwell <= stop.max_dwell_h * use)
    w.stopped.append(dwell + stop.detour_h * use)
    if stop.occupancy_price_per_h > 0.0:
        over = w.variable(row, "over", 0.0, stop.max_dwell_h)
        model.addCons(over >= dwell - stop.occupancy_free_h)
        w.costs.append(stop.occupancy_price_per_h * over)
    w.costs.append(stop.fixed_cost * use)
    leave = w.variable(row, "leave", stop.leave_min_kwh, ceiling)
    model.addCons(leave == arrive + charge - stop.detour_out_kwh * use)
    w.energy = leave


def make_scip_model(
    instance: Instance, optional: bool = False, tolerance: float = FIT_TOLERANCE
) -> ScipModel:
    """Write the program of an instance for SCIP.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    optional : bool
        Whether every stop is a choice.
    tolerance : float
        Error up to which a map may be a short form; 0: the tables themselves, kink by kink.

    Returns
    -------
    ScipModel
        The program. Left out are the limits of discharging and of recuperation and the
        share of a charger's power that the heater may take: all rarely bind, and without
        them the dual bound is one all the more.

    Raises
    ------
    ValueError
        A charge or voltage map is not positive.
    """
    w = _Writer(instance, fit_maps(instance, tolerance), optional)
    n = instance.drive.n_steps
    for k in range(n + 1):
        for i, stop in enumerate(instance.stops):
            if stop.node == k:
                _write_stop(w, i, stop)
        if k < n:
            _write_step(w, k)
    w.model.addCons(w.energy >= instance.end_energy_min_kwh)
    if isfinite(instance.total_dwell_h) and instance.stops:
        detours = sum(s.detour_h for s in instance.stops)
        w.model.addCons(quicksum(w.stopped) <= instance.total_dwell_h + detours)
    w.model.setObjective(quicksum(w.costs) if w.costs else 0.0)
    return w.out
