"""Owns one driving step and one charging stop of the transcription, solved to rounding.

Implicit midpoint in plain floats (a trip is a few hundred scalar equations;
arrays would cost more than they save). Clips the controls as the car's own
management would. Knows nothing of trips as a whole and of optimisation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, sqrt

import numpy as np

from relax.errors import DomainError
from relax.instance import HEATER_SHARE, LEAST_ROOM_KW, Drive, Instance, Stop
from relax.plan import StopControls, StopTrajectory

__all__ = ["Car", "StepResult", "charge", "drive_rows", "drive_step"]

TEMPERATURE_TOLERANCE_K = 1e-9
"""Change of the end temperature at which a step's implicit equation counts as solved [K]."""
POWER_TOLERANCE_KW = 1e-6
"""Change of the battery power at which a step counts as solved [kW]: it enters only through
the midpoint energy at which resistance and limits are read."""
REFUSED_TOLERANCE_KW = 1e-10
"""Width at which the bisection of a refused recuperation ends [kW]."""
NEARLY_SOLVED_K = 2e-8
"""Likewise, if the equation's measured slope says that the end temperature's error is less [K]."""
MAX_ITERATIONS = 20
"""Secant steps of one implicit equation before it is bracketed; 2 to 4 are usual."""


def _pump_power(heat_kw: float, cop: float, droop: float) -> float:
    """Scalar twin of ``physics.heat_pump_power`` (P4); ``inf`` if unreachable."""
    ratio = heat_kw / cop
    root = 1.0 - 4.0 * droop * ratio
    return 2.0 * ratio / (1.0 + sqrt(root)) if root >= 0.0 else inf


def _solve_implicit(
    phi: Callable[[float], float], guess: float, slope: float = 0.0
) -> tuple[float, float]:
    """Solve T' = phi(T') by secant steps, and by bracketing where those do not settle.

    Returns the last value of phi, and its slope: a good first one for a similar equation.

    Raises
    ------
    DomainError
        No solution within 1000 K: the controls make no sense.
    """
    x0, y0 = guess, phi(guess)
    for _ in range(MAX_ITERATIONS):
        missed = y0 - x0
        size = abs(missed)
        # of the error of x0, phi(x0) keeps the share of its slope
        if size <= TEMPERATURE_TOLERANCE_K or (
            size <= NEARLY_SOLVED_K and abs(2.0 * slope) * size <= TEMPERATURE_TOLERANCE_K
        ):
            return y0, slope if abs(slope) < 0.5 else 0.0
        x1 = x0 + (missed / (1.0 - slope) if slope < 0.9 else missed)
        if x1 == x0:  # a rounding away, where numbers are large
            break
        y1 = phi(x1)
        slope = (y1 - y0) / (x1 - x0)
        x0, y0 = x1, y1
    lo = hi = guess
    width = 1.0
    while phi(lo) < lo or phi(hi) > hi:
        if width > 1000.0:
            raise DomainError("a charging cell or driving step has no end temperature")
        lo, hi, width = guess - width, guess + width, 2.0 * width
    while hi - lo > TEMPERATURE_TOLERANCE_K:
        middle = 0.5 * (lo + hi)
        lo, hi = (middle, hi) if phi(middle) > middle else (lo, middle)
    return phi(0.5 * (lo + hi)), 0.0


class Car:
    """The vehicle's maps and actuators as plain floats and functions of floats."""

    def __init__(self, instance: Instance) -> None:
        vehicle, pack = instance.vehicle, instance.vehicle.pack
        self.resistance = pack.resistance_ohm.clamped()
        self.voltage_squared = pack.voltage_squared.clamped()
        self.cop = vehicle.heat_pump_cop.clamped()
        self.charge_limit = pack.charge_limit_kw.clamped()
        self.discharge_limit = pack.discharge_limit_kw.clamped()
        self.capacity = pack.heat_capacity_kwh_per_k
        self.ceiling = instance.ceiling_kwh
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


def _refused(car: Car, energy: float, half_d: float, mid: float, power: float) -> float:
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


def drive_step(
    car: Car,
    row: tuple[float, ...],
    energy: float,
    temp: float,
    heater_set: float,
    cooling_set: float,
    pump_set: float,
    guess: tuple[float, float, float],
    cap: float,
) -> tuple[StepResult, float]:
    """Advance one driving step.

    The heater is cut back where it would heat beyond ``cap``, cooling where it would
    cool below the temperature from which it works, recuperation where it would charge
    faster than the battery allows or beyond its largest energy.

    Returns end temperature, power, loss, brake, heater, pump, pump heat, cabin heater,
    cooling and the excess over the discharge limit, or over the largest load of the pack.
    """
    d, base, ripple, q_ed, ambient, conductance, demand = row
    half_d, scale = 0.5 * d, d / car.capacity
    heater_eff, actuators = car.heater_eff, car.actuators
    resistance, voltage_squared = car.resistance, car.voltage_squared
    rise, extra, slope = guess
    power, moved = base + extra, 0.0
    filling = -max(car.ceiling - energy, 0.0) / d  # ends the step with a full battery
    out: StepResult = (0.0,) * 10

    def phi(end: float) -> float:
        nonlocal power, moved, out
        mid, before = 0.5 * (temp + end), power
        heater, pump, heat, cabin = actuators(mid, demand, heater_set, pump_set)
        r = resistance(mid) / voltage_squared(energy - half_d * power)
        flow = q_ed - (heat - pump) + conductance * (ambient - mid)
        cooling = cooling_set
        if heater > 0.0 or cooling > 0.0:
            load = max(base + heater + cooling + pump + cabin, filling)  # a full battery takes less
            end_free = temp + scale * (flow + r * (load * load + ripple))
            most = (cap - end_free) / (scale * heater_eff)
            if heater > most:
                heater = most if most > 0.0 else 0.0
        if cooling > 0.0:
            # cooling's own load would overstate the loss; so would power that goes into the
            # pack, which cooling lessens and the charge limit may refuse
            load = max(base + heater + pump + cabin, 0.0)
            end_free = temp + scale * (flow + r * (load * load + ripple))
            spare = end_free + scale * heater_eff * heater - car.cooling_from
            cooling = max(min(cooling, spare / (scale * car.cooling_cop)), 0.0)
            flow -= car.cooling_cop * cooling
        load = base + heater + cooling + pump + cabin
        total = load + r * ripple
        root = 1.0 - 4.0 * r * total
        power = 2.0 * total / (1.0 + sqrt(root)) if root > 0.0 else 2.0 * total
        brake = 0.0
        if power < 0.0:
            taken = max(power, filling)
            if taken < -car.charge_limit(energy - half_d * taken, mid):
                taken = _refused(car, energy, half_d, mid, taken)
            if taken > power:
                power = taken
                r = resistance(mid) / voltage_squared(energy - half_d * power)
                brake = max(power - r * (power * power + ripple) - load, 0.0)
        moved = abs(power - before)
        loss = r * (power * power + ripple)
        result = temp + scale * (flow + loss + heater_eff * heater)
        beyond = total - 0.25 / r if root < 0.0 else 0.0  # what no power of the pack serves
        out = (result, power, loss, brake, heater, pump, heat, cabin, cooling, beyond)
        return result

    end, slope = _solve_implicit(phi, temp + rise, slope)
    for _ in range(MAX_ITERATIONS):  # the temperature may settle before the power does
        if moved <= POWER_TOLERANCE_KW:
            break
        end, slope = _solve_implicit(phi, end, slope)
    over = out[1] - car.discharge_limit(energy - half_d * power, 0.5 * (temp + end))
    return (*out[:9], max(over, out[9])), slope


def drive_rows(drive: Drive) -> list[tuple[float, ...]]:
    """Return what ``drive_step`` needs of every step, as plain floats."""
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


def charge(
    car: Car,
    stop: Stop,
    controls: StopControls,
    energy: float,
    temp: float,
    caps: Sequence[float],
) -> tuple[StopTrajectory, float]:
    """Charge at one stop from the state after the detour in; heaters as in ``drive_step``.

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
    rise = excess = slope = 0.0
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
            free = grid_max - base - cabin - pump - cooling_set
            if heater > HEATER_SHARE * free:
                heater = max(HEATER_SHARE * free, 0.0)
            room = max(free - heater, LEAST_ROOM_KW)
            power = 2.0 * room / (1.0 + sqrt(1.0 + 4.0 * r * room))
            if power > limit:
                power = limit
            if power > power_set:
                power = power_set
            dwell = e / power
            loss = r * power * power
            flow = loss - (heat - pump) + stop.heat_loss_kw_per_k * (stop.ambient_c - mid)
            cooling = cooling_set
            if heater > 0.0 or cooling > 0.0:
                rate = car.capacity / dwell
                most = ((cap - start) * rate - flow) / car.heater_eff
                if heater > most:
                    heater = most if most > 0.0 else 0.0
                spare = flow + car.heater_eff * heater + (start - car.cooling_from) * rate
                cooling = max(min(cooling, spare / car.cooling_cop), 0.0)
            flow += car.heater_eff * heater - car.cooling_cop * cooling
            grid = power + loss + base + heater + cooling + pump + cabin
            row = (
                dwell, power, grid * dwell, loss * dwell, heater, cooling, pump, heat, cabin, limit,
            )  # fmt: skip
            return start + flow * dwell / car.capacity

        end, slope = _solve_implicit(phi, start + rise, slope)
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
