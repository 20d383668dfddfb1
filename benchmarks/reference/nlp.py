"""Owns the transcription as a smooth nonlinear program, ordered stage by stage.

Reads the same ``Instance`` arrays as the relaxation. Every driving step and
every charging cell is one stage with states first and controls after, which is
what FATROP exploits and what costs IPOPT nothing. The implicit midpoint stays
implicit: temperature rise and battery power are controls, heat and power
balance path constraints; with Runge-Kutta 4 both are outcomes. The energy of a
stop is a state that its first cell chooses and its other cells carry along.
Knows nothing of solvers and starts.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

from benchmarks.reference.program import (
    BALANCE_SCALE_KW,
    COST_SCALE,
    LIMIT_SCALE_KW,
    SCALES,
    Model,
    Row,
    Writer,
)
from benchmarks.reference.splines import fit_curve
from benchmarks.reference.stages import Stages, make_stages
from relax.instance import MIN_CHARGE_KWH, Instance, Stop

__all__ = ["COST_SCALE", "LIMIT_SCALE_KW", "SCALES", "Model", "make_model"]

MIN_CHARGE_KW = 1.0
"""Least charging power of a cell [kW]: bounds the dwell, far below any use."""


def _write_step(w: Writer, k: int, energy_bounds: tuple[float, float]) -> Row:
    """One driving step as a stage."""
    drive, instance = w.instance.drive, w.instance
    d, base, demand = (float(a[k]) for a in (drive.duration_h, drive.base_kw, drive.cabin_heat_kw))
    state = w.begin(
        energy=energy_bounds,
        temperature=(instance.temperature_min_c, instance.temperature_max_c),
        stopped=(0.0, inf),
    )
    explicit = w.stages.integrator == "rk4"
    chosen: Any = () if explicit else (w.variable("power"), w.variable("rise"))
    heater, cooling, pump = w.actuators(demand)
    brake = w.variable("brake", 0.0, -base) if base < 0.0 else 0.0
    known = (
        drive.ripple_kw2, drive.drivetrain_heat_kw, drive.heat_loss_kw_per_k, drive.ambient_c,
    )  # fmt: skip
    energy, temp = state["energy"], state["temperature"]
    first, second, heat, cabin_heater, room = w.stages.step(
        energy, temp, *chosen, heater, cooling, pump, brake,
        d, base, *(float(a[k]) for a in known), demand,
    )  # fmt: skip
    power, rise = (first, second) if explicit else chosen
    if not explicit:
        w.path(first, BALANCE_SCALE_KW, lo=0.0, hi=0.0)
        w.path(second, BALANCE_SCALE_KW, lo=0.0, hi=0.0)
    w.cabin(demand, heater, heat, cabin_heater)
    if base < 0.0:
        w.path(room, LIMIT_SCALE_KW, lo=0.0)
    if w.with_discharge_limit:
        mid = (energy - 0.5 * d * power, temp + 0.5 * rise)
        w.path(w.stages.discharge_room(*mid, power), LIMIT_SCALE_KW, lo=0.0, mark="discharge")
    return w.end(energy=energy - d * power, temperature=temp + rise)


def _write_stop(w: Writer, stop: Stop, bounds: tuple[float, float]) -> tuple[Row, ...]:
    """One stop, a stage per cell; ``bounds`` are those of the energy on arrival."""
    instance, optional = w.instance, w.optional
    cells, top = instance.cells, instance.energy_max_kwh
    ceiling = instance.ceiling_kwh if optional else top
    least = 0.0 if optional else MIN_CHARGE_KWH
    heat_scale = instance.vehicle.pack.heat_capacity_kwh_per_k * SCALES["rise"]
    limit = fit_curve(stop.grid_limit_kw, 0.0, ceiling)
    explicit = w.stages.integrator == "rk4"
    use: Any = 1.0
    rows = []
    for j in range(cells):
        state = w.begin(
            energy=bounds if j == 0 else (stop.arrive_min_kwh, ceiling),
            temperature=(instance.temperature_min_c, instance.temperature_max_c),
            charge=(least, top),
            dwell=(0.0, stop.max_dwell_h),
            stopped=(0.0, inf),
        )
        energy, temp = state["energy"], state["temperature"]
        if j == 0:
            charge, spent = w.variable("charge", least, top), 0.0
            if optional:
                use = w.variable("use", 0.0, 1.0)
                w.path(energy - use * stop.detour_in_kwh, SCALES["energy"], lo=stop.arrive_min_kwh)
                w.path(charge - use * MIN_CHARGE_KWH, SCALES["charge"], lo=0.0)
                w.path(charge - use * top, SCALES["charge"], hi=0.0)
            energy = energy - use * stop.detour_in_kwh
        else:
            charge, spent = state["charge"], state["dwell"]
        portion = charge / cells
        power = w.variable("charge_power", MIN_CHARGE_KW)
        chosen: Any = () if explicit else (w.variable("rise"),)
        heater, cooling, pump = w.actuators(stop.cabin_heat_kw)
        first, heat, cabin_heater, dwell, grid, room = w.stages.cell(
            energy, temp, portion, power, *chosen, heater, cooling, pump,
            stop.base_kw, stop.heat_loss_kw_per_k, stop.ambient_c, stop.cabin_heat_kw,
        )  # fmt: skip
        rise = first if explicit else chosen[0]
        if not explicit:
            w.path(first, heat_scale, lo=0.0, hi=0.0)
        w.cabin(stop.cabin_heat_kw, heater, heat, cabin_heater)
        idle = 1.0 - use  # an unused stop has cells of no energy; its least power needs no room
        w.path(room + idle * MIN_CHARGE_KW, LIMIT_SCALE_KW, lo=0.0)
        spare = limit(energy + 0.5 * portion) - grid
        w.path(spare + idle * _idle_grid_kw(stop), LIMIT_SCALE_KW, lo=0.0)
        w.costs.append((stop.price_per_kwh * grid + stop.time_price_per_h) * dwell)
        spent = spent + dwell
        energy, temp = energy + portion, temp + rise
        if j < cells - 1:
            rows.append(w.end(energy=energy, temperature=temp, charge=charge, dwell=spent))
            continue
        w.path(spent, SCALES["dwell"], hi=stop.max_dwell_h, mark="dwell")
        _limit_total(w, spent, use * stop.detour_h if optional else 0.0)
        if stop.occupancy_price_per_h > 0.0:
            over = w.variable("over", 0.0)
            w.path(over - spent, SCALES["over"], lo=-stop.occupancy_free_h)
            w.costs.append(stop.occupancy_price_per_h * over)
        if optional:
            w.costs.append(use * stop.fixed_cost)
            w.path(energy - idle * (ceiling - top), SCALES["energy"], hi=top)
        rows.append(w.end(energy=energy - use * stop.detour_out_kwh, temperature=temp))
    return tuple(rows)


def _limit_total(w: Writer, spent: Any, detour_h: Any) -> None:
    """Add a stop's time to that of all stops, if the trip limits it."""
    most = w.instance.total_dwell_h
    if not isfinite(most):
        return
    if w.optional:  # the instance counts the detours of all its stops, used or not
        most += sum(s.detour_h for s in w.instance.stops)
    before = 0.0 if w.stopped is None else w.stopped
    w.stopped = before + spent + detour_h
    w.path(w.stopped, SCALES["dwell"], hi=most, mark="dwell")


def _idle_grid_kw(stop: Stop) -> float:
    """Return at least the grid power of an unused stop's cells, which do not last [kW]."""
    return 2.0 * (MIN_CHARGE_KW + stop.base_kw + stop.cabin_heat_kw)


def make_model(
    instance: Instance,
    stages: Stages | None = None,
    with_discharge_limit: bool = True,
    integrator: str = "midpoint",
    optional: bool = False,
) -> Model:
    """Write the nonlinear program of an instance.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    stages : Stages, optional
        Written before for the same trip: all subsets share them. Theirs is the integrator then.
    with_discharge_limit : bool
        Whether to write the discharge limit. It rarely binds and is a third of the
        work of an iteration; without it, the caller checks the plan and comes back.
    integrator : str
        ``midpoint`` or ``rk4``.
    optional : bool
        Whether every stop is used or not by a variable ``use`` of its first cell, 0 or 1.
        An unused stop charges nothing, so its cells take no time and change nothing. Such a
        program has no stages for FATROP, and its cost includes the fixed one.

    Returns
    -------
    Model
        The program and where its variables are.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (0, 2))
    >>> model = make_model(instance)
    >>> len(model.nx) == 100 + 2 * 12 + 1, model.nx[:2]
    (True, (0, 2))
    >>> explicit = make_model(instance, integrator="rk4")
    >>> model.x_lo.size - explicit.x_lo.size == 2 * 100 + 2 * 12
    True
    """
    stages = stages or make_stages(instance, integrator)
    w = Writer(instance, stages, with_discharge_limit, optional)
    n, top, ceiling = instance.drive.n_steps, instance.energy_max_kwh, instance.ceiling_kwh
    steps, cells = [], []
    after = (0.0, ceiling)
    for k in range(n + 1):
        bounds = (max(after[0], float(instance.energy_min_kwh[k])), after[1])
        for stop in (s for s in instance.stops if s.node == k):
            if not optional:
                bounds = (max(bounds[0], stop.arrive_min_kwh + stop.detour_in_kwh), bounds[1])
            cells.append(_write_stop(w, stop, bounds))
            highest = ceiling if optional else top - stop.detour_out_kwh
            bounds = (stop.leave_min_kwh, highest)
        if k < n:
            steps.append(_write_step(w, k, bounds))
            after = (0.0, ceiling)
    w.begin(
        energy=(max(bounds[0], instance.end_energy_min_kwh), bounds[1]),
        temperature=(instance.temperature_min_c, instance.temperature_max_c),
        stopped=(0.0, inf),
    )
    w.ng.append(0)
    last = w.end()
    return w.model(tuple(steps), tuple(cells), last)
