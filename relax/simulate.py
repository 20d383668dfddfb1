"""Owns the exact solution of the transcription for given controls: what the car does on the grid.

Implicit midpoint in every step and cell, solved to rounding in plain floats
(a trip is a few hundred scalar equations; arrays would cost more than they
save). Clips the controls as the car's own management would. Knows nothing of
optimisation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf, sqrt

import numpy as np

from relax.errors import DomainError
from relax.instance import HEATER_SHARE, LEAST_ROOM_KW, Drive, Instance, Stop
from relax.plan import Controls, StopControls, StopTrajectory, Trajectory

__all__ = ["Simulation", "Thermostat", "idle_controls", "simulate", "stop_cost"]

TEMPERATURE_TOLERANCE_K = 1e-9
"""Change of the end temperature at which a step's implicit equation counts as solved [K]."""
POWER_TOLERANCE_KW = 1e-6
"""Change of the battery power at which a step counts as solved [kW]: it enters only through
the midpoint energy at which resistance and limits are read."""
REFUSED_TOLERANCE_KW = 1e-10
"""Width at which the bisection of a refused recuperation ends [kW]."""
MAX_ITERATIONS = 20
"""Secant steps of one implicit equation before it is bracketed; 3 to 5 are usual."""


def _pump_power(heat_kw: float, cop: float, droop: float) -> float:
    """Scalar twin of ``physics.heat_pump_power`` (P4); ``inf`` if unreachable."""
    ratio = heat_kw / cop
    root = 1.0 - 4.0 * droop * ratio
    return 2.0 * ratio / (1.0 + sqrt(root)) if root >= 0.0 else inf


def _solve_implicit(phi: Callable[[float], float], guess: float) -> float:
    """Solve T' = phi(T') by secant steps, and by bracketing where those do not settle.

    Raises
    ------
    DomainError
        No solution within 1000 K: the controls make no sense.
    """
    x0 = guess
    f0 = phi(x0) - x0
    x1 = x0 + f0
    for _ in range(MAX_ITERATIONS):
        f1 = phi(x1) - x1
        if abs(f1) <= TEMPERATURE_TOLERANCE_K:
            return x1
        slope = (f1 - f0) / (x1 - x0)
        step = -f1 / slope if slope < -0.1 else f1
        x0, f0, x1 = x1, f1, x1 + step
    lo = hi = guess
    width = 1.0
    while phi(lo) < lo or phi(hi) > hi:
        if width > 1000.0:
            raise DomainError("a charging cell or driving step has no end temperature")
        lo, hi, width = guess - width, guess + width, 2.0 * width
    while hi - lo > TEMPERATURE_TOLERANCE_K:
        middle = 0.5 * (lo + hi)
        lo, hi = (middle, hi) if phi(middle) > middle else (lo, middle)
    return 0.5 * (lo + hi)


class _Car:
    """The vehicle's maps and actuators as plain floats and functions of floats."""

    def __init__(self, instance: Instance) -> None:
        vehicle, pack = instance.vehicle, instance.vehicle.pack
        self.resistance = pack.resistance_ohm.clamped()
        self.voltage_squared = pack.voltage_squared.clamped()
        self.cop = vehicle.heat_pump_cop.clamped()
        self.charge_limit = pack.charge_limit_kw.clamped()
        self.discharge_limit = pack.discharge_limit_kw.clamped()
        self.capacity = pack.heat_capacity_kwh_per_k
        self.heater_kw = vehicle.heater_kw
        self.heater_eff = vehicle.heater_battery_efficiency
        self.cabin_eff = vehicle.heater_cabin_efficiency
        self.cooling_kw = vehicle.cooling_kw
        self.cooling_cop = vehicle.cooling_cop
        self.cooling_from = vehicle.cooling_from_c
        self.pump_kw = vehicle.heat_pump_kw
        self.droop = vehicle.heat_pump_droop_per_kw

    def actuators(
        self, temp: float, demand: float, heater: float, pump: float
    ) -> tuple[float, float, float, float]:
        """Clip heater and heat pump at one battery temperature.

        Returns heater, heat pump, heat-pump heat and cabin heater power [kW].
        """
        # branches instead of min and max: this is the innermost call of every simulation
        heat = 0.0
        if pump > 0.0:
            if pump > self.pump_kw:
                pump = self.pump_kw
            cop = self.cop(temp)
            heat = cop * pump * (1.0 - self.droop * pump)
            if heat > demand:
                pump = _pump_power(demand, cop, self.droop)
                heat = demand
        else:
            pump = 0.0
        cabin = (demand - heat) / self.cabin_eff
        room = self.heater_kw - cabin
        if heater > room:
            heater = room
        return heater if heater > 0.0 else 0.0, pump, heat, cabin


StepResult = tuple[float, float, float, float, float, float, float, float, float, float]


def _refused(car: _Car, energy: float, half_d: float, mid: float, power: float) -> float:
    """Return the charging power that equals the limit at its own midpoint energy, by bisection.

    Charging less lowers the midpoint energy and so, if at all, raises the limit:
    there is one such power between the unlimited one and zero.
    """
    lo, hi = power, 0.0
    while hi - lo > REFUSED_TOLERANCE_KW:
        middle = 0.5 * (lo + hi)
        if middle < -car.charge_limit(energy - half_d * middle, mid):
            lo = middle
        else:
            hi = middle
    return hi


def _drive_step(
    car: _Car,
    row: tuple[float, ...],
    energy: float,
    temp: float,
    heater_set: float,
    cooling_set: float,
    pump_set: float,
    guess: float,
    cap: float,
) -> StepResult:
    """Advance one driving step.

    The heater is cut back where it would heat beyond ``cap``, cooling where it would
    cool below the temperature from which it works.

    Returns end temperature, power, loss, brake, heater, pump, pump heat, cabin heater,
    cooling and the excess over the discharge limit.
    """
    d, base, ripple, q_ed, ambient, conductance, demand = row
    half_d, scale = 0.5 * d, d / car.capacity
    power, moved = base, 0.0
    out: StepResult = (0.0,) * 10

    def phi(end: float) -> float:
        nonlocal power, moved, out
        mid, before = 0.5 * (temp + end), power
        heater, pump, heat, cabin = car.actuators(mid, demand, heater_set, pump_set)
        e_mid = energy - half_d * power
        r = car.resistance(mid) / car.voltage_squared(e_mid)
        flow = q_ed - (heat - pump) + conductance * (ambient - mid)
        cooling = cooling_set
        if heater > 0.0 or cooling > 0.0:
            load = base + heater + cooling + pump + cabin
            end_free = temp + scale * (flow + r * (load * load + ripple))
            heater = max(min(heater, (cap - end_free) / (scale * car.heater_eff)), 0.0)
            load = base + heater + pump + cabin  # cooling's own load would overstate the loss
            end_free = temp + scale * (flow + r * (load * load + ripple))
            spare = end_free + scale * car.heater_eff * heater - car.cooling_from
            cooling = max(min(cooling, spare / (scale * car.cooling_cop)), 0.0)
            flow -= car.cooling_cop * cooling
        load = base + heater + cooling + pump + cabin
        total = load + r * ripple
        root = 1.0 - 4.0 * r * total
        power = 2.0 * total / (1.0 + sqrt(root)) if root > 0.0 else 2.0 * total
        brake = 0.0
        if power < 0.0 and power < -car.charge_limit(energy - half_d * power, mid):
            power = _refused(car, energy, half_d, mid, power)
            r = car.resistance(mid) / car.voltage_squared(energy - half_d * power)
            brake = max(power - r * (power * power + ripple) - load, 0.0)
        moved = abs(power - before)
        loss = r * (power * power + ripple)
        result = temp + scale * (flow + loss + car.heater_eff * heater)
        out = (result, power, loss, brake, heater, pump, heat, cabin, cooling, 0.0)
        return result

    end = _solve_implicit(phi, guess)
    for _ in range(MAX_ITERATIONS):  # the temperature may settle before the power does
        if moved <= POWER_TOLERANCE_KW:
            break
        end = _solve_implicit(phi, end)
    over = out[1] - car.discharge_limit(energy - half_d * power, 0.5 * (temp + end))
    return (end, *out[1:9], over)


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
    car: _Car,
    stop: Stop,
    controls: StopControls,
    energy: float,
    temp: float,
    caps: Sequence[float],
) -> tuple[StopTrajectory, float]:
    """Charge at one stop from the state after the detour in; heaters as in ``_drive_step``.

    Also returns by how much the charger's power would be exceeded [kW].
    """
    cells = controls.power_kw.size
    e = controls.energy_kwh / cells
    rows: list[tuple[float, ...]] = []
    temps = [temp]
    grid_limit = stop.grid_limit_kw.clamped()
    demand, base = stop.cabin_heat_kw, stop.base_kw
    settings = zip(
        controls.power_kw.tolist(),
        controls.heater_kw.tolist(),
        controls.cooling_kw.tolist(),
        controls.heat_pump_kw.tolist(),
        strict=True,
    )
    rise = excess = 0.0
    for j, (power_set, heater_set, cooling_set, pump_set) in enumerate(settings):
        e_mid = energy + (j + 0.5) * e
        voltage_squared = car.voltage_squared(e_mid)
        grid_max = grid_limit(e_mid)
        cooling_set = min(cooling_set, car.cooling_kw)
        start, cap = temps[-1], caps[j]
        row: tuple[float, ...] = ()

        def phi(
            end: float,
            start: float = start,
            e_mid: float = e_mid,
            voltage_squared: float = voltage_squared,
            grid_max: float = grid_max,
            cooling_set: float = cooling_set,
            power_set: float = power_set,
            heater_set: float = heater_set,
            pump_set: float = pump_set,
            cap: float = cap,
        ) -> float:
            nonlocal row
            mid = 0.5 * (start + end)
            heater, pump, heat, cabin = car.actuators(mid, demand, heater_set, pump_set)
            r = car.resistance(mid) / voltage_squared
            limit = car.charge_limit(e_mid, mid)
            power = min(power_set, limit)
            free = grid_max - base - cabin - pump - cooling_set
            heater = max(min(heater, HEATER_SHARE * free), 0.0)
            room = max(free - heater, LEAST_ROOM_KW)
            power = min(power, 2.0 * room / (1.0 + sqrt(1.0 + 4.0 * r * room)))
            dwell = e / power
            loss = r * power * power
            flow = loss - (heat - pump) + stop.heat_loss_kw_per_k * (stop.ambient_c - mid)
            cooling = cooling_set
            if heater > 0.0 or cooling > 0.0:
                rate = car.capacity / dwell
                heater = max(min(heater, ((cap - start) * rate - flow) / car.heater_eff), 0.0)
                spare = flow + car.heater_eff * heater + (start - car.cooling_from) * rate
                cooling = max(min(cooling, spare / car.cooling_cop), 0.0)
            flow += car.heater_eff * heater - car.cooling_cop * cooling
            grid = power + loss + base + heater + cooling + pump + cabin
            row = (
                dwell, power, grid * dwell, loss * dwell, heater, cooling, pump, heat, cabin, limit,
            )  # fmt: skip
            return start + flow * dwell / car.capacity

        end = _solve_implicit(phi, start + rise)
        rise = end - start
        temps.append(end)
        excess = max(excess, row[2] / row[0] - grid_max)
        rows.append(row)
    columns = [np.array(c, dtype=np.float64) for c in zip(*rows, strict=True)]
    done = StopTrajectory(
        np.asarray(energy + e * np.arange(cells + 1), dtype=np.float64),
        np.array(temps),
        *columns,
    )
    return done, excess


def stop_cost(stop: Stop, dwell_h: float, grid_kwh: float) -> float:
    """Return the cost of one stop: energy, time, occupancy, detour and penalty [currency]."""
    occupied = max(0.0, dwell_h - stop.occupancy_free_h)
    return (
        stop.price_per_kwh * grid_kwh
        + stop.time_price_per_h * dwell_h
        + stop.occupancy_price_per_h * occupied
        + stop.fixed_cost
    )


@dataclass
class _Walk:
    """What has been simulated so far: the state, and the rows of the trajectory."""

    energy: float
    temp: float
    arrival: list[tuple[float, float]] = field(default_factory=list)
    start: list[tuple[float, float]] = field(default_factory=list)
    rows: list[StepResult] = field(default_factory=list)
    stops: list[StopTrajectory] = field(default_factory=list)
    cost: float = 0.0
    short: float = 0.0
    excess_kw: float = 0.0
    excess_h: float = 0.0

    def copy(self) -> _Walk:
        """Return an independent copy; the rows themselves are immutable."""
        return replace(
            self,
            arrival=self.arrival.copy(),
            start=self.start.copy(),
            rows=self.rows.copy(),
            stops=self.stops.copy(),
        )


@dataclass(frozen=True)
class Thermostat:
    """Battery temperatures beyond which the heater does not heat.

    Parameters
    ----------
    drive_c : sequence of float, length n
        At the end of every driving step [degrees C].
    stops_c : sequence of sequences of float
        At the end of every cell, per stop [degrees C].
    """

    drive_c: Sequence[float]
    stops_c: Sequence[Sequence[float]]


class Simulation:
    """Simulates one instance again and again, keeping what a change leaves untouched.

    Parameters
    ----------
    instance : Instance
        Subset and grid.

    Notes
    -----
    ``worth`` is how much charged energy one kWh at the end takes, by the losses on
    the way: kept here for those who charge until an end energy is met.
    """

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self._car = _Car(instance)
        self._drive_rows = _drive_rows(instance.drive)
        self._at_stop: list[_Walk] = []
        self.worth = 1.0
        n, cells = instance.drive.n_steps, instance.cells
        top = instance.temperature_max_c
        self._limit = Thermostat([top] * n, [[top] * cells] * len(instance.stops))
        self._thermostat = self._limit

    def run(
        self, controls: Controls, keep: int | None = None, thermostat: Thermostat | None = None
    ) -> Trajectory:
        """Return the trajectory of the controls.

        Parameters
        ----------
        controls : Controls
            Powers per step and cell.
        keep : int, optional
            The controls before stop ``keep`` are those of the last run: it goes on
            from the arrival there.
        thermostat : Thermostat, optional
            Temperatures beyond which the heaters do not heat; the battery's limit
            by default.
        """
        stops = self.instance.stops
        self._thermostat = thermostat or self._limit
        walk = _Walk(self.instance.start_energy_kwh, self.instance.start_temperature_c)
        node = 0
        if keep is not None and keep < len(self._at_stop):
            walk, node = self._at_stop[keep].copy(), stops[keep].node
            self._at_stop = self._at_stop[: keep + 1]
        else:
            keep = 0
            self._at_stop = []
            if stops:
                node = stops[0].node
                self._leg(walk, controls, 0, node)
                self._at_stop = [walk.copy()]
        for i in range(keep, len(stops)):
            self._stop(walk, controls, i)
            last = i + 1 == len(stops)
            end = self.instance.drive.n_steps if last else stops[i + 1].node
            self._leg(walk, controls, node, end)
            node = end
            if not last:
                self._at_stop.append(walk.copy())
        if not stops:
            self._leg(walk, controls, 0, self.instance.drive.n_steps)
        return self._trajectory(walk, controls)

    def _leg(self, walk: _Walk, controls: Controls, begin: int, end: int) -> None:
        """Drive from node to node."""
        car, energy, temp, rise = self._car, walk.energy, walk.temp, 0.0
        least = self.instance.energy_min_kwh
        if begin == 0 and not walk.arrival:
            walk.arrival.append((energy, temp))
        settings = zip(
            self._drive_rows[begin:end],
            controls.heater_kw[begin:end].tolist(),
            np.minimum(controls.cooling_kw[begin:end], car.cooling_kw).tolist(),
            controls.heat_pump_kw[begin:end].tolist(),
            least[begin + 1 : end + 1].tolist(),
            self._thermostat.drive_c[begin:end],
            strict=True,
        )
        short = walk.short
        for row, heater, cooling, pump, low, cap in settings:
            walk.start.append((energy, temp))
            result = _drive_step(car, row, energy, temp, heater, cooling, pump, temp + rise, cap)
            rise = result[0] - temp
            energy, temp = energy - row[0] * result[1], result[0]
            if low - energy > short:
                short = low - energy
            walk.rows.append(result)
            walk.arrival.append((energy, temp))
        walk.energy, walk.temp, walk.short = energy, temp, short

    def _stop(self, walk: _Walk, controls: Controls, i: int) -> None:
        """Charge at stop i."""
        stop = self.instance.stops[i]
        done, excess = _charge(
            self._car,
            stop,
            controls.stops[i],
            walk.energy - stop.detour_in_kwh,
            walk.temp,
            self._thermostat.stops_c[i],
        )
        first, last = float(done.energy_kwh[0]), float(done.energy_kwh[-1])
        dwell = float(done.dwell_h.sum())
        walk.cost += stop_cost(stop, dwell, float(done.grid_kwh.sum()))
        walk.short = max(
            walk.short,
            stop.arrive_min_kwh - first,
            stop.leave_min_kwh - last + stop.detour_out_kwh,
            last - self.instance.energy_max_kwh,
        )
        walk.excess_kw = max(walk.excess_kw, excess)
        walk.excess_h = max(walk.excess_h, dwell - stop.max_dwell_h)
        walk.energy, walk.temp = last - stop.detour_out_kwh, float(done.temperature_c[-1])
        walk.stops.append(done)

    def _trajectory(self, walk: _Walk, controls: Controls) -> Trajectory:
        instance = self.instance
        arrive, begin = np.array(walk.arrival), np.array(walk.start)
        table = np.array(walk.rows)
        peak = max([arrive[:, 1].max(), *(s.temperature_c.max() for s in walk.stops)])
        low = min([arrive[:, 1].min(), *(s.temperature_c.min() for s in walk.stops)])
        violation = np.array(
            [
                max(walk.short, float(arrive[:, 0].max()) - instance.ceiling_kwh),
                max(peak - instance.temperature_max_c, instance.temperature_min_c - low),
                max(float(table[:, 9].max()), walk.excess_kw),
                walk.excess_h,
            ]
        )
        return Trajectory(
            energy_kwh=arrive[:, 0],
            temperature_c=arrive[:, 1],
            energy_start_kwh=begin[:, 0],
            temperature_start_c=begin[:, 1],
            power_kw=table[:, 1],
            loss_kw=table[:, 2],
            brake_kw=table[:, 3],
            heater_kw=table[:, 4],
            cooling_kw=table[:, 8],
            heat_pump_kw=table[:, 5],
            pump_heat_kw=table[:, 6],
            cabin_heater_kw=table[:, 7],
            stops=tuple(walk.stops),
            final_energy_kwh=walk.energy,
            final_temperature_c=walk.temp,
            cost=walk.cost,
            violation=np.maximum(violation, 0.0),
        )


def simulate(instance: Instance, controls: Controls) -> Trajectory:
    """Return the trajectory that the controls cause on the transcription.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        Powers per step and cell; clipped to the actuators, the cabin's demand
        and the charge limits where they exceed them. The battery heater never
        heats beyond the battery's temperature limit.

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
    return Simulation(instance).run(controls)


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
