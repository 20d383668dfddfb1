"""Owns the values of a relaxed point, and the lift of a trajectory into the relaxation.

``unpack_point`` reads a solver's vector back by name; ``lift`` is the other way:
the vector a simulated trajectory has in the program, auxiliary variables at
their exact values. The lift is how validity and tightness are measured. Knows
nothing of rows and of solvers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.instance import Instance
from relax.plan import Trajectory
from relax.program import ConeProgram

__all__ = ["Optimum", "RelaxedPoint", "RelaxedStop", "lift", "unpack_point"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RelaxedStop:
    """One stop of a relaxed point; arrays of shape (K,) unless stated.

    Parameters
    ----------
    energy_kwh : float
        Internal energy charged, W [kWh].
    dwell_h : ndarray
        Dwell of every cell [h].
    temperature_c : ndarray, shape (K + 1,)
        Battery temperature at the cell borders [degrees C].
    heater_kwh, cooling_kwh, heat_pump_kwh : ndarray
        Electrical energies of battery heater, battery cooling and heat pump [kWh].
    """

    energy_kwh: float
    dwell_h: Array
    temperature_c: Array
    heater_kwh: Array
    cooling_kwh: Array
    heat_pump_kwh: Array


@dataclass(frozen=True)
class RelaxedPoint:
    """A point of the relaxation: a suggestion for refinement, never a plan.

    Parameters
    ----------
    energy_kwh, temperature_c : ndarray, shape (n + 1,)
        State on arrival at every node [kWh, degrees C].
    heater_kw, cooling_kw, heat_pump_kw : ndarray, shape (n,)
        Electrical powers of every driving step [kW].
    stops : tuple of RelaxedStop
        One per stop.
    """

    energy_kwh: Array
    temperature_c: Array
    heater_kw: Array
    cooling_kw: Array
    heat_pump_kw: Array
    stops: tuple[RelaxedStop, ...]


@dataclass(frozen=True)
class Optimum:
    """Where the solver ended on a box: a proof about the box goes on from there.

    Parameters
    ----------
    box : Box
        The box.
    program : ConeProgram
        Its relaxation.
    x : ndarray, shape (n,)
        Primal point; it chooses what is bounded next and proves nothing.
    z : ndarray, shape (m,)
        Dual vector, to be certified.
    """

    box: Box
    program: ConeProgram
    x: Array
    z: Array


def unpack_point(program: ConeProgram, x: Array) -> RelaxedPoint:
    """Return the quantities of a program's vector by name.

    Parameters
    ----------
    program : ConeProgram
        From ``build_relaxation``.
    x : ndarray
        Scaled vector, e.g. a solver's.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> unpack_point(program, 0.5 * (program.l + program.u)).stops[0].dwell_h.shape
    (12,)
    """
    value = {name: program.value(name, x) for name in program.variables}
    stops = []
    for i, charged in enumerate(value["charge"]):
        stops.append(
            RelaxedStop(
                energy_kwh=float(charged),
                dwell_h=value["dwell"][i],
                temperature_c=value["border"][i],
                heater_kwh=value["cell_heater"][i],
                cooling_kwh=value["cell_cooling"][i],
                heat_pump_kwh=value["cell_pump"][i],
            )
        )
    return RelaxedPoint(
        energy_kwh=value["energy"],
        temperature_c=value["temperature"],
        heater_kw=value["heater"],
        cooling_kw=value["cooling"],
        heat_pump_kw=value["pump"],
        stops=tuple(stops),
    )


def lift(
    instance: Instance,
    program: ConeProgram,
    trajectory: Trajectory,
    subset: tuple[int, ...] | None = None,
) -> Array:
    """Return the vector that a trajectory of the transcription has in a relaxation.

    Parameters
    ----------
    instance : Instance
        Subset and grid of both.
    program : ConeProgram
        From ``build_relaxation``.
    trajectory : Trajectory
        From ``simulate``.
    subset : tuple of int, optional
        The trajectory's chargers, if the instance has optional stops besides.

    Returns
    -------
    ndarray
        Scaled; satisfies every row if the trajectory is feasible and in the box,
        and has the trajectory's cost.

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance, simulate
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> trajectory = simulate(instance, idle_controls(instance, (45.0,)))
    >>> x = lift(instance, program, trajectory)
    >>> bool(abs(program.q @ x + program.constant - trajectory.cost) < 1e-9 * trajectory.cost)
    True
    """
    out = np.zeros(program.q.size)

    def put(name: str, value: npt.ArrayLike) -> None:
        index = program.variables[name]
        out[index[index >= 0]] = np.broadcast_to(np.asarray(value), index.shape)[index >= 0]

    for name, value in (
        ("energy", trajectory.energy_kwh),
        ("temperature", trajectory.temperature_c),
        ("power", trajectory.power_kw),
        ("loss", trajectory.loss_kw),
        ("heater", trajectory.heater_kw),
        ("cooling", trajectory.cooling_kw),
        ("pump", trajectory.heat_pump_kw),
        ("pump_heat", trajectory.pump_heat_kw),
        ("brake", trajectory.brake_kw),
    ):
        put(name, value)
    on = np.array([subset is None or s.charger in subset for s in instance.stops], dtype=bool)
    stops = trajectory.stops
    if stops:
        dwell = np.array([s.dwell_h for s in stops])
        border = np.array([s.temperature_c for s in stops])
        energy = np.array([s.energy_kwh for s in stops])
        middle = 0.5 * (border[:, 1:] + border[:, :-1])
        charge_limit = instance.vehicle.pack.charge_limit_kw
        limit = charge_limit(0.5 * (energy[:, 1:] + energy[:, :-1]), middle)
        free = np.array([s.occupancy_free_h for s in instance.stops])[on]

        def put_used(name: str, value: npt.ArrayLike) -> None:
            value = np.asarray(value, dtype=np.float64)
            full = np.zeros((on.size, *value.shape[1:]))
            full[on] = value
            put(name, full)

        put_used("charge", energy[:, -1] - energy[:, 0])
        put_used("stop_temperature", border[:, 1:])
        put_used("dwell", dwell)
        put_used("temp_dwell", middle * dwell)
        put_used("cell_loss", [s.loss_kwh for s in stops])
        put_used("cell_limit", limit)
        put_used("occupied", np.maximum(0.0, dwell.sum(axis=1) - free))
        for name, field in (
            ("cell_heater", "heater_kw"),
            ("cell_cooling", "cooling_kw"),
            ("cell_pump", "heat_pump_kw"),
            ("cell_pump_heat", "pump_heat_kw"),
        ):
            put_used(name, np.array([getattr(s, field) for s in stops]) * dwell)
    if instance.stops:
        _put_passage(instance, trajectory, on, put)
    return out / program.scale


def _put_passage(
    instance: Instance,
    trajectory: Trajectory,
    on: npt.NDArray[np.bool_],
    put: Callable[[str, npt.ArrayLike], None],
) -> None:
    """Put the states before and after every stop, used or passed."""
    count = on.size
    before, after = np.zeros((2, count)), np.zeros((2, count))
    used = iter(trajectory.stops)
    for i, stop in enumerate(instance.stops):
        node = stop.node
        here = np.array([trajectory.energy_kwh[node], trajectory.temperature_c[node]])
        if i and instance.stops[i - 1].node == node:
            here = after[:, i - 1]
        before[:, i] = after[:, i] = here
        if on[i]:
            ran = next(used)
            after[:, i] = ran.energy_kwh[-1] - stop.detour_out_kwh, ran.temperature_c[-1]
    put("leave", after[0])
    put("used", on.astype(np.float64))
    put("share", np.where(on, before[0], 0.0))
    put("share_temperature", np.where(on, before[1], 0.0))
    put("after_temperature", after[1])
