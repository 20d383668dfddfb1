"""Owns the exact solution of the transcription for given controls: what the car does on the grid.

Implicit midpoint in every step and cell, solved to rounding in plain floats
(a trip is a few hundred scalar equations; arrays would cost more than they
save). Clips the controls as the car's own management would. Knows nothing of
optimisation.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, sqrt

import numpy as np

from relax.instance import Drive, Instance, Stop
from relax.maps import Table1, Table2
from relax.plan import Controls, StopControls, StopTrajectory, Trajectory

__all__ = ["idle_controls", "simulate", "stop_cost"]

TEMPERATURE_TOLERANCE_K = 1e-10
"""Change of the end temperature at which a step's implicit equation counts as solved [K]."""
MAX_ITERATIONS = 60
"""Bound on the iterations of one implicit equation; 3 to 5 are usual."""
MIN_CHARGE_SHARE = 0.1
"""Share of a charger's free power that heaters may not take, so that charging goes on."""


def _clamped1(table: Table1) -> Callable[[float], float]:
    """Return the table at the nearest point of its domain.

    Iterates may stray outside for a moment; such a trajectory breaks a limit
    and is reported as infeasible, so no accepted plan uses a clamped value.
    """
    lo, hi, at = table.lo, table.hi, table.at
    return lambda x: at(min(max(x, lo), hi))


def _clamped2(table: Table2) -> Callable[[float, float], float]:
    """Return the table at the nearest point of its domain, see ``_clamped1``."""
    xs, ys, at = table.x, table.y, table.at
    x_lo, x_hi, y_lo, y_hi = float(xs[0]), float(xs[-1]), float(ys[0]), float(ys[-1])
    return lambda x, y: at(min(max(x, x_lo), x_hi), min(max(y, y_lo), y_hi))


def _pump_power(heat_kw: float, cop: float, droop: float) -> float:
    """Scalar twin of ``physics.heat_pump_power`` (P4); ``inf`` if unreachable."""
    ratio = heat_kw / cop
    root = 1.0 - 4.0 * droop * ratio
    return 2.0 * ratio / (1.0 + sqrt(root)) if root >= 0.0 else inf


class _Fixed:
    """Solve T' = phi(T') by secant steps; phi is a mild contraction."""

    @staticmethod
    def solve(phi: Callable[[float], float], guess: float) -> float:
        x0 = guess
        f0 = phi(x0) - x0
        x1 = x0 + f0
        for _ in range(MAX_ITERATIONS):
            f1 = phi(x1) - x1
            if abs(f1) <= TEMPERATURE_TOLERANCE_K:
                break
            slope = (f1 - f0) / (x1 - x0)
            step = -f1 / slope if slope < -0.1 else f1
            x0, f0, x1 = x1, f1, x1 + step
        return x1


class _Car:
    """The vehicle's maps and actuators as plain floats and functions of floats."""

    def __init__(self, instance: Instance) -> None:
        vehicle, pack = instance.vehicle, instance.vehicle.pack
        self.resistance = _clamped1(pack.resistance_ohm)
        self.voltage_squared = _clamped1(pack.voltage_squared)
        self.cop = _clamped1(vehicle.heat_pump_cop)
        self.charge_limit = _clamped2(pack.charge_limit_kw)
        self.discharge_limit = _clamped2(pack.discharge_limit_kw)
        self.capacity = pack.heat_capacity_kwh_per_k
        self.heater_kw = vehicle.heater_kw
        self.heater_eff = vehicle.heater_battery_efficiency
        self.cabin_eff = vehicle.heater_cabin_efficiency
        self.cooling_kw = vehicle.cooling_kw
        self.cooling_cop = vehicle.cooling_cop
        self.pump_kw = vehicle.heat_pump_kw
        self.droop = vehicle.heat_pump_droop_per_kw

    def actuators(
        self, temp: float, demand: float, heater: float, pump: float
    ) -> tuple[float, float, float, float]:
        """Clip heater and heat pump at one battery temperature.

        Returns heater, heat pump, heat-pump heat and cabin heater power [kW].
        """
        heat = 0.0
        if pump > 0.0:
            cop = self.cop(temp)
            pump = min(pump, self.pump_kw, _pump_power(demand, cop, self.droop))
            heat = cop * pump * (1.0 - self.droop * pump)
        cabin = (demand - heat) / self.cabin_eff
        return max(min(heater, self.heater_kw - cabin), 0.0), max(pump, 0.0), heat, cabin


StepResult = tuple[float, float, float, float, float, float, float, float, float]


def _drive_step(
    car: _Car,
    row: tuple[float, ...],
    energy: float,
    temp: float,
    heater_set: float,
    cooling: float,
    pump_set: float,
    guess: float,
) -> StepResult:
    """Advance one driving step.

    Returns end temperature, power, loss, brake, heater, pump, pump heat, cabin heater
    and the excess over the discharge limit.
    """
    d, base, ripple, q_ed, ambient, conductance, demand = row
    half_d, scale = 0.5 * d, d / car.capacity
    power = 0.0
    out: StepResult = (0.0,) * 9

    def phi(end: float) -> float:
        nonlocal power, out
        mid = 0.5 * (temp + end)
        heater, pump, heat, cabin = car.actuators(mid, demand, heater_set, pump_set)
        load = base + heater + cooling + pump + cabin
        e_mid = energy - half_d * power
        r = car.resistance(mid) / car.voltage_squared(e_mid)
        total = load + r * ripple
        root = 1.0 - 4.0 * r * total
        power = 2.0 * total / (1.0 + sqrt(root)) if root > 0.0 else 2.0 * total
        brake = 0.0
        if power < 0.0:
            limit = car.charge_limit(e_mid, mid)
            if power < -limit:
                power = -limit
                brake = power - r * (power * power + ripple) - load
        loss = r * (power * power + ripple)
        flow = loss + q_ed + car.heater_eff * heater - car.cooling_cop * cooling - (heat - pump)
        flow += conductance * (ambient - mid)
        result = temp + scale * flow
        out = (result, power, loss, brake, heater, pump, heat, cabin, 0.0)
        return result

    end = _Fixed.solve(phi, guess)
    over = out[1] - car.discharge_limit(energy - half_d * power, 0.5 * (temp + end))
    return (end, *out[1:8], over)


def _drive_rows(drive: Drive) -> list[tuple[float, ...]]:
    columns = (
        drive.duration_h,
        drive.base_kw,
        drive.ripple_kw2,
        drive.drivetrain_heat_kw,
        drive.ambient_c,
        drive.heat_loss_kw_per_k,
        drive.cabin_heat_kw,
    )
    return list(zip(*(c.tolist() for c in columns), strict=True))


def _charge(
    car: _Car, stop: Stop, controls: StopControls, energy: float, temp: float
) -> StopTrajectory:
    """Charge at one stop from the state after the detour in."""
    cells = controls.power_kw.size
    e = controls.energy_kwh / cells
    rows: list[tuple[float, ...]] = []
    temps = [temp]
    grid_limit = _clamped1(stop.grid_limit_kw)
    demand, base = stop.cabin_heat_kw, stop.base_kw
    settings = zip(
        controls.power_kw.tolist(),
        controls.heater_kw.tolist(),
        controls.cooling_kw.tolist(),
        controls.heat_pump_kw.tolist(),
        strict=True,
    )
    rise = 0.0
    for j, (power_set, heater_set, cooling_set, pump_set) in enumerate(settings):
        e_mid = energy + (j + 0.5) * e
        voltage_squared = car.voltage_squared(e_mid)
        grid_max = grid_limit(e_mid)
        cooling = min(cooling_set, car.cooling_kw)
        start = temps[-1]
        row: tuple[float, ...] = ()

        def phi(
            end: float,
            start: float = start,
            e_mid: float = e_mid,
            voltage_squared: float = voltage_squared,
            grid_max: float = grid_max,
            cooling: float = cooling,
            power_set: float = power_set,
            heater_set: float = heater_set,
            pump_set: float = pump_set,
        ) -> float:
            nonlocal row
            mid = 0.5 * (start + end)
            heater, pump, heat, cabin = car.actuators(mid, demand, heater_set, pump_set)
            r = car.resistance(mid) / voltage_squared
            limit = car.charge_limit(e_mid, mid)
            power = min(power_set, limit)
            free = grid_max - base - cabin - pump - cooling
            heater = max(min(heater, (1.0 - MIN_CHARGE_SHARE) * free), 0.0)
            room = max(free - heater, MIN_CHARGE_SHARE * grid_max)
            power = min(power, 2.0 * room / (1.0 + sqrt(1.0 + 4.0 * r * room)))
            dwell = e / power
            loss = r * power * power
            flow = loss + car.heater_eff * heater - car.cooling_cop * cooling - (heat - pump)
            flow += stop.heat_loss_kw_per_k * (stop.ambient_c - mid)
            grid = power + loss + base + heater + cooling + pump + cabin
            row = (
                dwell, power, grid * dwell, loss * dwell, heater, cooling, pump, heat, cabin, limit,
            )  # fmt: skip
            return start + flow * dwell / car.capacity

        end = _Fixed.solve(phi, start + rise)
        rise = end - start
        temps.append(end)
        rows.append(row)
    columns = [np.array(c) for c in zip(*rows, strict=True)]
    return StopTrajectory(
        energy + e * np.arange(cells + 1),
        np.array(temps),
        *columns,
    )


def stop_cost(stop: Stop, dwell_h: float, grid_kwh: float) -> float:
    """Return the cost of one stop: energy, time, occupancy, detour and penalty [currency]."""
    occupied = max(0.0, dwell_h - stop.occupancy_free_h)
    return (
        stop.price_per_kwh * grid_kwh
        + stop.time_price_per_h * dwell_h
        + stop.occupancy_price_per_h * occupied
        + stop.fixed_cost
    )


def simulate(instance: Instance, controls: Controls) -> Trajectory:
    """Return the trajectory that the controls cause on the transcription.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        Powers per step and cell; clipped to the actuators, the cabin's demand
        and the charge limits where they exceed them.

    Returns
    -------
    Trajectory
        Exact for the transcription (equations (T1) .. (T9) of ``docs/maths.md``),
        feasible in the dynamics; limits of energy, temperature, discharge power
        and dwell may be violated, by the amounts it states.

    Examples
    --------
    >>> from relax import load_trip, make_instance, simulate, idle_controls
    >>> instance = make_instance(load_trip("paper-400km"), (0, 2))
    >>> trajectory = simulate(instance, idle_controls(instance, energy_kwh=(20.0, 20.0)))
    >>> len(trajectory.stops), trajectory.power_kw.shape
    (2, (100,))
    """
    drive = instance.drive
    car = _Car(instance)
    n = drive.n_steps
    heater, cooling, pump = (
        c.tolist() for c in (controls.heater_kw, controls.cooling_kw, controls.heat_pump_kw)
    )
    energy_min = instance.energy_min_kwh.tolist()
    energy, temp = instance.start_energy_kwh, instance.start_temperature_c
    arrival: list[tuple[float, float]] = []
    start: list[tuple[float, float]] = []
    rows: list[StepResult] = []
    stops: list[StopTrajectory] = []
    cost, short, excess_h, rise = 0.0, 0.0, 0.0, 0.0
    for k, row in enumerate([*_drive_rows(drive), ()]):
        arrival.append((energy, temp))
        short = max(short, energy_min[k] - energy)
        while len(stops) < len(instance.stops) and instance.stops[len(stops)].node == k:
            stop = instance.stops[len(stops)]
            done = _charge(
                car, stop, controls.stops[len(stops)], energy - stop.detour_in_kwh, temp
            )
            dwell = float(done.dwell_h.sum())
            cost += stop_cost(stop, dwell, float(done.grid_kwh.sum()))
            short = max(
                short,
                stop.arrive_min_kwh - float(done.energy_kwh[0]),
                stop.leave_min_kwh - float(done.energy_kwh[-1]) + stop.detour_out_kwh,
                float(done.energy_kwh[-1]) - instance.energy_max_kwh,
            )
            excess_h = max(excess_h, dwell - stop.max_dwell_h)
            energy = float(done.energy_kwh[-1]) - stop.detour_out_kwh
            temp = float(done.temperature_c[-1])
            stops.append(done)
            rise = 0.0
        if k == n:
            break
        start.append((energy, temp))
        result = _drive_step(
            car, row, energy, temp, heater[k], min(cooling[k], car.cooling_kw), pump[k], temp + rise
        )
        rise = result[0] - temp
        energy, temp = energy - row[0] * result[1], result[0]
        rows.append(result)
    arrive, begin = np.array(arrival), np.array(start)
    table = np.array(rows)
    peak = max([arrive[:, 1].max(), *(float(s.temperature_c.max()) for s in stops)])
    low = min([arrive[:, 1].min(), *(float(s.temperature_c.min()) for s in stops)])
    return Trajectory(
        energy_kwh=arrive[:, 0],
        temperature_c=arrive[:, 1],
        energy_start_kwh=begin[:, 0],
        temperature_start_c=begin[:, 1],
        power_kw=table[:, 1],
        loss_kw=table[:, 2],
        brake_kw=table[:, 3],
        heater_kw=table[:, 4],
        cooling_kw=np.minimum(controls.cooling_kw, car.cooling_kw),
        heat_pump_kw=table[:, 5],
        pump_heat_kw=table[:, 6],
        cabin_heater_kw=table[:, 7],
        stops=tuple(stops),
        final_energy_kwh=energy,
        final_temperature_c=temp,
        cost=cost,
        violation=np.maximum(
            [
                max(short, float(arrive[:, 0].max()) - instance.energy_max_kwh),
                max(peak - instance.temperature_max_c, instance.temperature_min_c - low),
                float(table[:, 8].max()),
                excess_h,
            ],
            0.0,
        ),
    )


def idle_controls(instance: Instance, energy_kwh: tuple[float, ...]) -> Controls:
    """Return controls that heat nothing, pump nothing and charge as fast as the limits allow.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    energy_kwh : tuple of float
        Internal energy charged at every stop [kWh].
    """
    n, cells = instance.drive.n_steps, instance.cells
    zero, none = np.zeros(n), np.zeros(cells)
    full = np.full(cells, inf)
    return Controls(
        zero, zero, zero, tuple(StopControls(w, full, none, none, none) for w in energy_kwh)
    )
