"""Owns the way between SCIP's variables and plans: a plan as a point, a point as controls.

A plan simulated on the tables satisfies the program up to SCIP's tolerance,
for every map may take any value within its margin. Knows no search.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.reference.scip_maps import Band
from benchmarks.reference.scip_model import Row, ScipModel, scale_of
from relax.instance import Stop
from relax.plan import Controls, StopControls, StopTrajectory, Trajectory

__all__ = ["point_of", "read_controls", "used_stops"]

Values = list[tuple[Any, float]]
IDLE_H = 1e-7
"""Dwell of a cell below which its powers are none [h]."""


def _put(out: Values, row: Row, **entries: float) -> None:
    out.extend(
        (row[name], float(value) / scale_of(name)) for name, value in entries.items() if name in row
    )


def _put_band(out: Values, row: Row, name: str, band: Band, at: float, value: float) -> None:
    _put(out, row, **{name: value, f"{name}_form": float(band.form(at))})


def _put_maps(out: Values, written: ScipModel, row: Row, energy: float, temp: float) -> None:
    maps, car = written.maps, written.instance.vehicle
    pack = car.pack
    _put_band(out, row, "resistance", maps.resistance, temp, pack.resistance_ohm.at(temp))
    _put_band(out, row, "voltage", maps.voltage_squared, energy, pack.voltage_squared.at(energy))
    if maps.cop is not None:
        cop = car.heat_pump_cop.at(temp)
        _put_band(out, row, "cop", maps.cop, temp, 1.0 / cop if maps.inverse_cop else cop)
    for n, (f, g) in enumerate(maps.charge_limit.terms):
        _put(out, row, **{f"cap_e{n}": float(f(energy)), f"cap_t{n}": float(g(temp))})


def _put_cell(
    out: Values, written: ScipModel, i: int, j: int, done: StopTrajectory | None, state: Any
) -> None:
    """Set one cell; an unused one by the state (energy, temperature) that passes through."""
    row, stop = written.cells[i][j], written.instance.stops[i]
    if done is None:
        energy, temp = state
        _put(out, row, **dict.fromkeys(row, 0.0))
        _put(out, row, end=temp)
    else:
        y = float(done.dwell_h[j])
        energy = 0.5 * float(done.energy_kwh[j] + done.energy_kwh[j + 1])
        temp = 0.5 * float(done.temperature_c[j] + done.temperature_c[j + 1])
        _put(
            out, row, dwell=y, charge_power=done.power_kw[j], loss=done.loss_kwh[j],
            heater=done.heater_kw[j] * y, cooling=done.cooling_kw[j] * y,
            pump=done.heat_pump_kw[j] * y, pump_power=done.heat_pump_kw[j],
            heat=done.pump_heat_kw[j] * y, end=done.temperature_c[j + 1],
        )  # fmt: skip
    _put_maps(out, written, row, energy, temp)
    limit = stop.grid_limit_kw.at(energy)
    _put_band(out, row, "grid_limit", written.maps.grid_limit[i], energy, limit)


def _put_stop(
    out: Values, written: ScipModel, i: int, done: StopTrajectory | None, energy: float, temp: float
) -> float:
    """Set one stop reached with an internal energy; returns that on leaving."""
    stop, row = written.instance.stops[i], written.stops[i]
    cells = written.instance.cells
    arrive, charge, leave, over = energy, 0.0, energy, 0.0
    if done is not None:
        arrive = float(done.energy_kwh[0])
        charge = float(done.energy_kwh[-1]) - arrive
        leave = arrive + charge - stop.detour_out_kwh
        over = max(0.0, float(done.dwell_h.sum()) - stop.occupancy_free_h)
    _put(
        out, row, use=float(done is not None), charge=charge, arrive=arrive,
        portion=charge / cells, leave=leave, over=over,
    )  # fmt: skip
    for j in range(cells):
        _put_cell(out, written, i, j, done, (energy, temp))
    return leave


def point_of(written: ScipModel, subset: tuple[int, ...], trajectory: Trajectory) -> Values:
    """Return the program's variables along a simulated trip, as pairs of variable and value.

    Parameters
    ----------
    written : ScipModel
        The program; with optional stops, of more chargers than the trajectory uses.
    subset : tuple of int
        Chargers that the trajectory uses, in driving order.
    trajectory : Trajectory
        As ``relax.simulate`` gives it for that subset.

    Raises
    ------
    ValueError
        The trajectory uses a charger that the program has not.
    """
    instance = written.instance
    known = [s.charger for s in instance.stops]
    if not set(subset) <= set(known) or len(subset) != len(trajectory.stops):
        raise ValueError(f"the plan stops at {subset}, the program knows {tuple(known)}")
    done = dict(zip(subset, trajectory.stops, strict=True))
    out: Values = []
    n = instance.drive.n_steps

    def stops_at(node: int, energy: float, temp: float) -> None:
        stop: Stop
        for i, stop in enumerate(instance.stops):
            if stop.node == node:
                found = done.get(stop.charger)
                energy = _put_stop(out, written, i, found, energy, temp)
                temp = temp if found is None else float(found.temperature_c[-1])

    for k in range(n + 1):
        stops_at(k, float(trajectory.energy_kwh[k]), float(trajectory.temperature_c[k]))
        if k == n:
            break
        row = written.steps[k]
        end, end_energy = trajectory.temperature_c[k + 1], trajectory.energy_kwh[k + 1]
        _put(
            out, row, power=trajectory.power_kw[k], loss=trajectory.loss_kw[k],
            heater=trajectory.heater_kw[k], cooling=trajectory.cooling_kw[k],
            pump=trajectory.heat_pump_kw[k], heat=trajectory.pump_heat_kw[k],
            brake=trajectory.brake_kw[k], energy=end_energy, end=end,
        )  # fmt: skip
        energy = 0.5 * float(trajectory.energy_start_kwh[k] + end_energy)
        temp = 0.5 * float(trajectory.temperature_start_c[k] + end)
        _put_maps(out, written, row, energy, temp)
    return out


def used_stops(written: ScipModel, value: Callable[[Any], float]) -> tuple[int, ...]:
    """Return the positions of the stops that a solution uses."""
    uses = [value(row["use"]) if "use" in row else 1.0 for row in written.stops]
    return tuple(i for i, use in enumerate(uses) if use > 0.5)


def read_controls(written: ScipModel, value: Callable[[Any], float]) -> Controls:
    """Return the controls of a solution at the stops that it uses.

    Parameters
    ----------
    written : ScipModel
        The program.
    value : callable
        Gives the solution's value of a variable.
    """

    def column(rows: list[Row], name: str) -> Any:
        scale = scale_of(name)
        return np.array([max(0.0, scale * value(r[name])) if name in r else 0.0 for r in rows])

    stops = []
    for i in used_stops(written, value):
        rows = written.cells[i]
        dwell = column(rows, "dwell")
        power = {
            name: np.where(dwell > IDLE_H, column(rows, name) / np.maximum(dwell, IDLE_H), 0.0)
            for name in ("heater", "cooling", "pump")
        }
        charge = scale_of("charge") * value(written.stops[i]["charge"])
        stops.append(
            StopControls(
                charge, column(rows, "charge_power"), power["heater"], power["cooling"],
                power["pump"],
            )
        )  # fmt: skip
    steps = written.steps
    return Controls(
        column(steps, "heater"), column(steps, "cooling"), column(steps, "pump"), tuple(stops)
    )
