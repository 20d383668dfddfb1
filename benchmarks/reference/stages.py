"""Owns the smooth model of one driving step and one charging cell, as CasADi functions.

The equations of the transcription with splines for tables. One function per
kind of stage, written once per vehicle and inlined at every stage: that is
ten times faster than writing each stage anew. Knows nothing of programs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from benchmarks.reference.splines import fit_curve, fit_surface
from relax.instance import Instance
from relax.vehicle import Vehicle

__all__ = ["CELL_INPUTS", "STEP_INPUTS", "Stages", "make_stages"]

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
    step : casadi.Function
        ``STEP_INPUTS`` to power residual, heat residual [kW], heat pump heat, cabin heater
        and room below the charge limit [kW].
    cell : casadi.Function
        ``CELL_INPUTS`` to heat residual [kWh], heat pump heat, cabin heater [kW], dwell [h],
        grid power [kW], room below the charge limit [kW].
    discharge_room : casadi.Function
        Internal energy, temperature and power to the room below the discharge limit [kW].
    """

    step: Any
    cell: Any
    discharge_room: Any


def _pump_heat(vehicle: Vehicle, cop: Any, pump: Any) -> Any:
    return cop * pump * (1.0 - vehicle.heat_pump_droop_per_kw * pump)


def make_stages(instance: Instance) -> Stages:
    """Fit the maps of an instance's vehicle and write its stage functions.

    Parameters
    ----------
    instance : Instance
        Any subset of the trip: all share the vehicle and its limits.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> stages = make_stages(make_instance(load_trip("paper-400km"), (0,)))
    >>> stages.step.n_out(), stages.cell.n_out()
    (5, 6)
    """
    car, pack = instance.vehicle, instance.vehicle.pack
    e_lo = min(float(instance.energy_min_kwh.min()), instance.end_energy_min_kwh)
    e_hi, t_lo, t_hi = (
        instance.energy_max_kwh, instance.temperature_min_c, instance.temperature_max_c,
    )  # fmt: skip
    resistance = fit_curve(pack.resistance_ohm, t_lo, t_hi)
    voltage_squared = fit_curve(pack.voltage_squared, e_lo, e_hi)
    cop = fit_curve(car.heat_pump_cop, t_lo, t_hi)
    charge_limit = fit_surface(pack.charge_limit_kw, e_lo, e_hi, t_lo, t_hi)

    s = {name: ca.SX.sym(name) for name in STEP_INPUTS}
    mid = s["temperature"] + 0.5 * s["rise"]
    energy_mid = s["energy"] - 0.5 * s["duration"] * s["power"]
    r = resistance(mid) / voltage_squared(energy_mid)
    loss = r * (s["power"] * s["power"] + s["ripple"])
    heat = _pump_heat(car, cop(mid), s["pump"])
    cabin = (s["demand"] - heat) / car.heater_cabin_efficiency
    load = s["base"] + s["heater"] + s["cooling"] + s["pump"] + cabin + s["brake"]
    flow = (
        loss
        + s["drivetrain_heat"]
        + car.heater_battery_efficiency * s["heater"]
        - car.cooling_cop * s["cooling"]
        - (heat - s["pump"])
        + s["conductance"] * (s["ambient"] - mid)
    )
    step = ca.Function(
        "step",
        [s[name] for name in STEP_INPUTS],
        [
            s["power"] - loss - load,
            pack.heat_capacity_kwh_per_k / s["duration"] * s["rise"] - flow,
            heat,
            cabin,
            s["power"] + charge_limit(energy_mid, mid),
        ],
    )

    c = {name: ca.SX.sym(name) for name in CELL_INPUTS}
    mid = c["temperature"] + 0.5 * c["rise"]
    energy_mid = c["energy"] + 0.5 * c["portion"]
    loss = resistance(mid) / voltage_squared(energy_mid) * (c["power"] * c["power"])
    heat = _pump_heat(car, cop(mid), c["pump"])
    cabin = (c["demand"] - heat) / car.heater_cabin_efficiency
    dwell = c["portion"] / c["power"]
    flow = (
        loss
        + car.heater_battery_efficiency * c["heater"]
        - car.cooling_cop * c["cooling"]
        - (heat - c["pump"])
        + c["conductance"] * (c["ambient"] - mid)
    )
    cell = ca.Function(
        "cell",
        [c[name] for name in CELL_INPUTS],
        [
            pack.heat_capacity_kwh_per_k * c["rise"] - flow * dwell,
            heat,
            cabin,
            dwell,
            c["power"] + loss + c["base"] + c["heater"] + c["cooling"] + c["pump"] + cabin,
            charge_limit(energy_mid, mid) - c["power"],
        ],
    )
    discharge_limit = fit_surface(pack.discharge_limit_kw, e_lo, e_hi, t_lo, t_hi)
    at = [ca.SX.sym(name) for name in ("energy", "temperature", "power")]
    room = ca.Function("discharge_room", at, [discharge_limit(at[0], at[1]) - at[2]])
    return Stages(step, cell, room)
