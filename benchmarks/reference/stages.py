"""Owns the smooth model of one driving step and one charging cell, as CasADi functions.

The equations of the transcription with splines for tables, by the implicit
midpoint or by Runge-Kutta 4. One function per kind of stage, written once per
vehicle and inlined at every stage: that is ten times faster than writing each
stage anew. Knows nothing of programs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca

from benchmarks.reference.splines import Spline, SplineSum, fit_curve, fit_surface
from relax.instance import Instance
from relax.vehicle import Vehicle

__all__ = [
    "CELL_INPUTS",
    "INTEGRATORS",
    "OUTCOMES",
    "STEP_INPUTS",
    "FittedCar",
    "Stages",
    "fit_car",
    "make_stages",
]

INTEGRATORS = ("midpoint", "rk4")
"""How a stage leads from its state to the next."""
OUTCOMES = ("power", "rise")
"""Arguments of a driving step that Runge-Kutta computes instead of taking."""
STEP_INPUTS = (
    "energy", "temperature", "power", "rise", "heater", "cooling", "pump", "brake",
    "duration", "base", "ripple", "drivetrain_heat", "conductance", "ambient", "demand",
)  # fmt: skip
"""Arguments of the function of a driving step, in physical units."""
CELL_INPUTS = (
    "energy", "temperature", "portion", "power", "rise", "heater", "cooling", "pump",
    "base", "conductance", "ambient", "demand",
)  # fmt: skip
"""Arguments of the function of a charging cell, in physical units."""


@dataclass(frozen=True)
class Stages:
    """The stage functions of a vehicle between two internal energies.

    Parameters
    ----------
    integrator : str
        ``midpoint`` or ``rk4``: what the functions return.
    step : casadi.Function
        Midpoint: ``STEP_INPUTS`` to power residual, heat residual [kW], heat pump heat, cabin
        heater and room below the charge limit [kW]. RK4: ``STEP_INPUTS`` without the
        ``OUTCOMES`` to power, rise [kW, K], heat pump heat, cabin heater and room.
    cell : casadi.Function
        Midpoint: ``CELL_INPUTS`` to heat residual [kWh], heat pump heat, cabin heater [kW],
        dwell [h], grid power [kW], room below the charge limit [kW]. RK4: ``CELL_INPUTS``
        without the rise to rise [K], then the same.
    discharge_room : casadi.Function
        Internal energy, temperature and power to the room below the discharge limit [kW].
    """

    integrator: str
    step: Any
    cell: Any
    discharge_room: Any


@dataclass(frozen=True)
class FittedCar:
    """A car with splines for tables; its equations hold at any instant.

    Parameters
    ----------
    vehicle : Vehicle
        Actuators and efficiencies.
    resistance, voltage_squared, cop : Spline
        Over temperature, internal energy, temperature.
    charge_limit, discharge_limit : SplineSum
        Over internal energy and temperature.
    """

    vehicle: Vehicle
    resistance: Spline
    voltage_squared: Spline
    cop: Spline
    charge_limit: SplineSum
    discharge_limit: SplineSum

    def pump_heat(self, temp: Any, pump: Any) -> Any:
        """Return the heat of the heat pump [kW]."""
        return self.cop(temp) * pump * (1.0 - self.vehicle.heat_pump_droop_per_kw * pump)

    def cabin_heater(self, demand: Any, heat: Any) -> Any:
        """Return the power of the cabin heater [kW]."""
        return (demand - heat) / self.vehicle.heater_cabin_efficiency

    def flow(self, loss: Any, heat: Any, temp: Any, c: dict[str, Any]) -> Any:
        """Return the heat that flows into the pack, drivetrain apart [kW]."""
        return (
            loss
            + self.vehicle.heater_battery_efficiency * c["heater"]
            - self.vehicle.cooling_cop * c["cooling"]
            - (heat - c["pump"])
            + c["conductance"] * (c["ambient"] - temp)
        )


def fit_car(instance: Instance) -> FittedCar:
    """Fit the maps of an instance's vehicle.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> car = fit_car(make_instance(load_trip("paper-400km"), (0,)))
    >>> bool(car.resistance(-10.0) > car.resistance(20.0))
    True
    """
    car, pack = instance.vehicle, instance.vehicle.pack
    e_lo = min(float(instance.energy_min_kwh.min()), instance.end_energy_min_kwh)
    e_hi, t_lo, t_hi = (
        instance.ceiling_kwh, instance.temperature_min_c, instance.temperature_max_c,
    )  # fmt: skip
    return FittedCar(
        car,
        fit_curve(pack.resistance_ohm, t_lo, t_hi),
        fit_curve(pack.voltage_squared, e_lo, e_hi),
        fit_curve(car.heat_pump_cop, t_lo, t_hi),
        fit_surface(pack.charge_limit_kw, e_lo, e_hi, t_lo, t_hi),
        fit_surface(pack.discharge_limit_kw, e_lo, e_hi, t_lo, t_hi),
    )


def _midpoint_step(car: FittedCar) -> Any:
    s = {name: ca.SX.sym(name) for name in STEP_INPUTS}
    mid = s["temperature"] + 0.5 * s["rise"]
    energy_mid = s["energy"] - 0.5 * s["duration"] * s["power"]
    r = car.resistance(mid) / car.voltage_squared(energy_mid)
    loss = r * (s["power"] * s["power"] + s["ripple"])
    heat = car.pump_heat(mid, s["pump"])
    cabin = car.cabin_heater(s["demand"], heat)
    load = s["base"] + s["heater"] + s["cooling"] + s["pump"] + cabin + s["brake"]
    flow = car.flow(loss + s["drivetrain_heat"], heat, mid, s)
    capacity = car.vehicle.pack.heat_capacity_kwh_per_k
    return ca.Function(
        "step",
        list(s.values()),
        [
            s["power"] - loss - load,
            capacity / s["duration"] * s["rise"] - flow,
            heat,
            cabin,
            s["power"] + car.charge_limit(energy_mid, mid),
        ],
    )


def _midpoint_cell(car: FittedCar) -> Any:
    c = {name: ca.SX.sym(name) for name in CELL_INPUTS}
    mid = c["temperature"] + 0.5 * c["rise"]
    energy_mid = c["energy"] + 0.5 * c["portion"]
    loss = car.resistance(mid) / car.voltage_squared(energy_mid) * (c["power"] * c["power"])
    heat = car.pump_heat(mid, c["pump"])
    cabin = car.cabin_heater(c["demand"], heat)
    dwell = c["portion"] / c["power"]
    flow = car.flow(loss, heat, mid, c)
    return ca.Function(
        "cell",
        list(c.values()),
        [
            car.vehicle.pack.heat_capacity_kwh_per_k * c["rise"] - flow * dwell,
            heat,
            cabin,
            dwell,
            c["power"] + loss + c["base"] + c["heater"] + c["cooling"] + c["pump"] + cabin,
            car.charge_limit(energy_mid, mid) - c["power"],
        ],
    )


def _runge_kutta(rates: Callable[[Any, Any], list[Any]], energy: Any, temp: Any) -> list[Any]:
    """Return the means over a stage of the classical fourth-order method.

    ``rates`` gives, at an internal energy and temperature, the changes over the whole
    stage: of energy, of temperature, and of whatever else is summed up.
    """
    one = rates(energy, temp)
    two = rates(energy + 0.5 * one[0], temp + 0.5 * one[1])
    three = rates(energy + 0.5 * two[0], temp + 0.5 * two[1])
    four = rates(energy + three[0], temp + three[1])
    return [(a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in zip(one, two, three, four, strict=True)]


def _rk4_step(car: FittedCar) -> Any:
    s = {name: ca.SX.sym(name) for name in STEP_INPUTS if name not in OUTCOMES}
    capacity = car.vehicle.pack.heat_capacity_kwh_per_k

    def rates(energy: Any, temp: Any) -> list[Any]:
        heat = car.pump_heat(temp, s["pump"])
        load = s["base"] + s["heater"] + s["cooling"] + s["pump"] + s["brake"]
        load = load + car.cabin_heater(s["demand"], heat)
        r = car.resistance(temp) / car.voltage_squared(energy)
        demand = load + r * s["ripple"]
        power = 2.0 * demand / (1.0 + ca.sqrt(1.0 - 4.0 * r * demand))
        flow = car.flow(power - load + s["drivetrain_heat"], heat, temp, s)
        return [-s["duration"] * power, s["duration"] / capacity * flow]

    spent, rise = _runge_kutta(rates, s["energy"], s["temperature"])
    power, mid = -spent / s["duration"], s["temperature"] + 0.5 * rise
    heat = car.pump_heat(mid, s["pump"])
    room = power + car.charge_limit(s["energy"] + 0.5 * spent, mid)
    out = [power, rise, heat, car.cabin_heater(s["demand"], heat), room]
    return ca.Function("step", list(s.values()), out)


def _rk4_cell(car: FittedCar) -> Any:
    c = {name: ca.SX.sym(name) for name in CELL_INPUTS if name not in OUTCOMES}
    # the charging power is the cell's control here too; OUTCOMES names that of driving
    c["power"] = ca.SX.sym("power")
    inputs = [c[name] for name in CELL_INPUTS if name != "rise"]
    dwell = c["portion"] / c["power"]
    capacity = car.vehicle.pack.heat_capacity_kwh_per_k

    def rates(energy: Any, temp: Any) -> list[Any]:
        heat = car.pump_heat(temp, c["pump"])
        loss = car.resistance(temp) / car.voltage_squared(energy) * (c["power"] * c["power"])
        grid = c["power"] + loss + c["base"] + c["heater"] + c["cooling"] + c["pump"]
        grid = grid + car.cabin_heater(c["demand"], heat)
        return [c["portion"], dwell / capacity * car.flow(loss, heat, temp, c), grid]

    charged, rise, grid = _runge_kutta(rates, c["energy"], c["temperature"])
    mid = c["temperature"] + 0.5 * rise
    heat = car.pump_heat(mid, c["pump"])
    room = car.charge_limit(c["energy"] + 0.5 * charged, mid) - c["power"]
    out = [rise, heat, car.cabin_heater(c["demand"], heat), dwell, grid, room]
    return ca.Function("cell", inputs, out)


def make_stages(instance: Instance, integrator: str = "midpoint") -> Stages:
    """Fit the maps of an instance's vehicle and write its stage functions.

    Parameters
    ----------
    instance : Instance
        Any subset of the trip: all share the vehicle and its limits.
    integrator : str
        ``midpoint``: the transcription's implicit rule. ``rk4``: the classical explicit
        rule of fourth order, with the controls constant over the stage; power limits stay
        where the transcription has them, at the middle of the stage and for its mean power.

    Raises
    ------
    ValueError
        Unknown integrator.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (0,))
    >>> [(s.step.n_in(), s.cell.n_out()) for s in map(lambda i: make_stages(instance, i),
    ...     INTEGRATORS)]
    [(15, 6), (13, 6)]
    """
    if integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {integrator!r}; known: {', '.join(INTEGRATORS)}")
    car = fit_car(instance)
    at = [ca.SX.sym(name) for name in ("energy", "temperature", "power")]
    room = ca.Function("discharge_room", at, [car.discharge_limit(at[0], at[1]) - at[2]])
    if integrator == "midpoint":
        return Stages(integrator, _midpoint_step(car), _midpoint_cell(car), room)
    return Stages(integrator, _rk4_step(car), _rk4_cell(car), room)
