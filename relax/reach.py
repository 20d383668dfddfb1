"""Owns reachability: which intervals follow from dynamics, limits and energy balance.

Every feasible trajectory of the transcription lies in the box, whatever its
controls and its cost. Vectorised over steps; a Python loop runs over stops
alone. Knows nothing of programs and solvers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from relax.box import Box, Cell
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.intervals import EMPTY_MARGIN, Interval, pick, range1, range2
from relax.physics import battery_power
from relax.reach_heat import cooling_floor_c, pump_limits, temperatures

__all__ = ["FULL_SLACK_KWH", "make_box", "may_fill", "propagate"]

Array = npt.NDArray[np.float64]

FULL_SLACK_KWH = 1e-6
"""How far below the largest energy a battery counts as full: more than rounding [kWh]."""
ROUNDS = 2
"""Sweeps of ``make_box``; a third raises first bounds by at most 0.04 % on the paper trip, by 1.2 %
with four stops from Goteborg to Stockholm, and takes the time that it saves."""


def _least(start: Array, cap: Array, used: Array) -> Array:
    """x_0 = start, x_{k+1} = min(cap_k, x_k - used_k), without a loop; several in rows."""
    total = np.zeros((used.shape[0], used.shape[1] + 1))
    np.cumsum(used, axis=1, out=total[:, 1:])
    out = np.empty_like(total)
    out[:, 0], out[:, 1:] = start, cap + total[:, 1:]
    return np.asarray(np.minimum.accumulate(out, axis=1) - total)


def may_fill(instance: Instance, box: Box) -> npt.NDArray[np.bool_]:
    """Return the steps that may end with a full battery, which refuses recuperation, shape (n,).

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box
        A valid box.
    """
    full = box.energy.hi[1:] >= instance.ceiling_kwh - FULL_SLACK_KWH
    return np.asarray(full & (instance.drive.base_kw < 0.0))


def _drive_flow(instance: Instance, box: Box) -> tuple[Interval, Interval]:
    """Intervals of battery power and of pack heat before cooling."""
    drive, vehicle, pack = instance.drive, instance.vehicle, instance.vehicle.pack
    temp, energy = box.middle_temperature, box.middle_energy
    resistance, square = range1(pack.resistance_ohm, temp), range1(pack.voltage_squared, energy)
    r = Interval(np.maximum(resistance.lo, 0.0) / square.hi, resistance.hi / square.lo)
    cop = range1(vehicle.heat_pump_cop, temp)
    q, eta_c, ripple = drive.cabin_heat_kw, vehicle.heater_cabin_efficiency, drive.ripple_kw2
    pump_hi, heat_hi, drawn_hi = pump_limits(instance, q, cop)
    saved = heat_hi * np.minimum(0.0, 1.0 / np.maximum(cop.hi, 1e-9) - 1.0 / eta_c)
    load_lo = drive.base_kw + q / eta_c + saved
    cools = box.temperature.hi[1:] >= cooling_floor_c(vehicle)
    load_hi = drive.base_kw + vehicle.heater_kw + pump_hi + np.where(cools, vehicle.cooling_kw, 0.0)
    out_hi = range2(pack.discharge_limit_kw, energy, temp).hi
    lo = _power(load_lo, r.lo, ripple)
    hi = np.where(2.0 * r.hi * out_hi < 1.0, _power(load_hi, r.hi, ripple), out_hi)
    # when the charge limit refuses power, the brake takes it and P is minus the limit; a
    # battery that is full in the end takes what is left of it, at least 0
    on = lo < 0.0
    if on.any():
        taken = range2(pack.charge_limit_kw, pick(energy, on), pick(temp, on))
        hi[on] = np.where(lo[on] < -taken.lo, np.maximum(hi[on], -taken.lo), hi[on])
        lo[on] = np.maximum(lo[on], -taken.hi)
    hi = np.where(may_fill(instance, box), np.maximum(hi, 0.0), hi)
    start = box.start_energy
    power = (
        box.power.meet(lo, np.minimum(hi, out_hi))
        .meet(
            (start.lo - box.energy.hi[1:]) / drive.duration_h,
            (start.hi - box.energy.lo[1:]) / drive.duration_h,
        )
        .outward()
    )
    square_hi = np.maximum(power.lo**2, power.hi**2) + ripple
    square_lo = np.maximum(np.maximum(power.lo, -power.hi), 0.0) ** 2 + ripple
    heater_hi = np.clip(vehicle.heater_kw - (q - heat_hi) / eta_c, 0.0, None)
    # with cop * (1 - droop hp) < 1 the compressor's own heat warms the pack
    least_gain = np.minimum(0.0, cop.lo * (1.0 - vehicle.heat_pump_droop_per_kw * pump_hi) - 1.0)
    heat = Interval(  # cooling apart: it stops at its own temperature
        r.lo * square_lo + drive.drivetrain_heat_kw - drawn_hi,
        r.hi * square_hi + drive.drivetrain_heat_kw
        + vehicle.heater_battery_efficiency * heater_hi - least_gain * pump_hi,
    )  # fmt: skip
    return power, heat


def _power(load: Array, r: Array, ripple: Array) -> Array:
    """``battery_power``, at most the power 1 / (2r) of the largest load the pack can serve."""
    largest = 0.25 / np.maximum(r, 1e-12) - r * ripple
    return battery_power(np.minimum(load, largest - 1e-9 * (1.0 + np.abs(largest))), r, ripple)


def _stop_dwell(instance: Instance, box: Box) -> tuple[Interval, Array]:
    """Intervals of the cells' dwell and the largest internal power per cell, shape (S, K)."""
    stops, pack = instance.stops, instance.vehicle.pack
    shape = box.dwell.lo.shape
    energy = box.cell_energy(np.array([s.detour_out_kwh for s in stops]))
    flat = Interval(energy.lo.ravel(), energy.hi.ravel())
    temp = Interval(box.cell_temperature.lo.ravel(), box.cell_temperature.hi.ravel())
    power = range2(pack.charge_limit_kw, flat, temp).hi.reshape(shape)
    for i, stop in enumerate(stops):
        grid = range1(stop.grid_limit_kw, Interval(energy.lo[i], energy.hi[i])).hi
        power[i] = np.minimum(power[i], grid - min(stop.base_kw, 0.0))
    power = np.maximum(power, 1e-6)  # a cell that cannot charge: its dwell below is beyond limits
    lo = np.maximum(box.charge.lo[:, None] / shape[1] / power, box.dwell.lo)
    others = lo.sum(axis=1, keepdims=True) - lo
    return Interval(lo, np.minimum(box.dwell.hi, box.stay.hi[:, None] - others)), power


def _energies(instance: Instance, box: Box, power: Interval, charge_hi: Array) -> dict[str, Any]:
    """Forward and backward energy intervals along the chain of segments and stops."""
    drive, stops = instance.drive, instance.stops
    borders = [0, *(s.node for s in stops), drive.n_steps]
    energy = Interval(box.energy.lo.copy(), box.energy.hi.copy())
    arrive = Interval(box.arrive.lo.copy(), box.arrive.hi.copy())
    leave = Interval(box.leave.lo.copy(), box.leave.hi.copy())
    charge = Interval(box.charge.lo.copy(), np.minimum(box.charge.hi, charge_hi))
    # both ends in one array: the lower one with its sign turned, so that each is a least
    ends = np.stack([-energy.lo, energy.hi])
    used = drive.duration_h * np.stack([-power.hi, power.lo])
    after = Interval(box.after.lo.copy(), box.after.hi.copy())
    usable = ~box.unusable
    # segment i: its start (after stop i - 1), then the arrivals at nodes a + 1 .. b
    segments: list[Array] = []
    for i in range(len(stops) + 1):
        a, b = borders[i], borders[i + 1]
        first = np.array([-after.lo[i - 1], after.hi[i - 1]]) if i else ends[:, 0]
        segments.append(_least(first, ends[:, a + 1 : b + 1], used[:, a:b]))
        last_lo, last_hi = -float(segments[i][0, -1]), float(segments[i][1, -1])
        if i < len(stops):
            stop = stops[i]
            arrive.lo[i] = max(arrive.lo[i], last_lo - stop.detour_in_kwh)
            arrive.hi[i] = min(arrive.hi[i], last_hi - stop.detour_in_kwh)
            charge.hi[i] = min(charge.hi[i], instance.energy_max_kwh - arrive.lo[i])
            out = stop.detour_out_kwh
            leave.lo[i] = max(leave.lo[i], arrive.lo[i] + charge.lo[i] - out)
            leave.hi[i] = min(leave.hi[i], arrive.hi[i] + charge.hi[i] - out)
            low, high = leave.lo[i], leave.hi[i]
            if stop.optional:
                usable[i] &= all(x.lo[i] <= x.hi[i] + EMPTY_MARGIN for x in (arrive, charge, leave))
                low = min(low, last_lo) if usable[i] else last_lo
                high = max(high, last_hi) if usable[i] else last_hi
            after.lo[i], after.hi[i] = max(after.lo[i], low), min(after.hi[i], high)
    for i in range(len(stops), -1, -1):
        a, b = borders[i], borders[i + 1]
        caps = segments[i][:, ::-1]
        ends = _least(caps[:, 0], caps[:, 1:], used[::-1, a:b][:, ::-1])[:, ::-1]
        energy.lo[a + 1 : b + 1], energy.hi[a + 1 : b + 1] = -ends[0, 1:], ends[1, 1:]
        first_lo, first_hi = -float(ends[0, 0]), float(ends[1, 0])
        if i == 0:
            energy.lo[0], energy.hi[0] = first_lo, first_hi
            break
        j, stop = i - 1, stops[i - 1]
        after.lo[j], after.hi[j] = max(after.lo[j], first_lo), min(after.hi[j], first_hi)
        leave.lo[j], leave.hi[j] = max(leave.lo[j], after.lo[j]), min(leave.hi[j], after.hi[j])
        full_lo, full_hi = leave.lo[j] + stop.detour_out_kwh, leave.hi[j] + stop.detour_out_kwh
        charge.lo[j] = max(charge.lo[j], full_lo - arrive.hi[j])
        charge.hi[j] = min(charge.hi[j], full_hi - arrive.lo[j])
        arrive.lo[j] = max(arrive.lo[j], full_lo - charge.hi[j])
        arrive.hi[j] = min(arrive.hi[j], full_hi - charge.lo[j])
        low, high = arrive.lo[j] + stop.detour_in_kwh, arrive.hi[j] + stop.detour_in_kwh
        if stop.optional:
            low = min(low, after.lo[j]) if usable[j] else after.lo[j]
            high = max(high, after.hi[j]) if usable[j] else after.hi[j]
        segments[j][:, -1] = np.minimum(segments[j][:, -1], [-low, high])
    never = box.unusable  # crossed already: every sweep would cross them by more, without end
    if never.any():
        for now, given in ((arrive, box.arrive), (leave, box.leave), (charge, box.charge)):
            now.lo[never], now.hi[never] = given.lo[never], given.hi[never]
    return {
        "energy": energy.outward(),
        "arrive": arrive.outward(),
        "leave": leave.outward(),
        "charge": charge.outward(),
        "after": after.outward(),
    }


def propagate(instance: Instance, box: Box) -> Box:
    """Return the box after one forward and backward sweep: never larger, still valid.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    box : Box
        A valid box.

    Returns
    -------
    Box
        Intersected with what the dynamics, limits and maps allow; ``empty`` if
        nothing is feasible.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> box = make_box(instance)
    >>> bool((propagate(instance, box).charge.hi <= box.charge.hi + 1e-6).all())
    True
    """
    power, heat = _drive_flow(instance, box)
    dwell, cell_power = _stop_dwell(instance, box)
    charge_hi = instance.cells * box.stay.hi / (1.0 / cell_power).sum(axis=1)
    stay = box.stay.meet(dwell.lo.sum(axis=1), dwell.hi.sum(axis=1))
    sure = np.where(instance.optional, 0.0, stay.lo)
    stay = stay.meet(stay.lo, instance.total_dwell_h - sure.sum() + sure)
    return replace(
        box,
        power=power,
        dwell=dwell.outward(),
        stay=stay.outward(),
        **_energies(instance, box, power, charge_hi),
        **temperatures(instance, box, power, heat, cell_power, dwell.hi),
    )


def make_box(instance: Instance, start: Cell | None = None, end: Cell | None = None) -> Box:
    """Return the intervals that dynamics and limits alone imply.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    start, end : Cell, optional
        Where a stage starts and ends: before the first step, and after the last stop or step.

    Returns
    -------
    Box
        Valid for every feasible control; ``empty`` proves that there is none.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> make_box(make_instance(load_trip("paper-400km"), ())).empty
    'energy'
    """
    n, S, K = instance.drive.n_steps, len(instance.stops), instance.cells
    e_hi, w = instance.energy_max_kwh, MIN_CHARGE_KWH
    t_lo, t_hi = instance.temperature_min_c, instance.temperature_max_c
    start_energy, temp = instance.start_energy_kwh, instance.start_temperature_c
    energy = Interval(instance.energy_min_kwh.copy(), np.full(n + 1, instance.ceiling_kwh))
    energy.lo[0] = max(energy.lo[0], start_energy)
    energy.hi[0] = min(energy.hi[0], start_energy)
    temperature = Interval(np.full(n + 1, t_lo), np.full(n + 1, t_hi))
    temperature.lo[0], temperature.hi[0] = max(t_lo, temp), min(t_hi, temp)
    if start is not None:
        energy.lo[0], energy.hi[0] = start.energy
        temperature.lo[0], temperature.hi[0] = start.temperature
    least = np.array([s.arrive_min_kwh for s in instance.stops])
    leave = np.array([s.leave_min_kwh for s in instance.stops])
    # past an optional stop the limits of its node hold, at the end those of the end
    node = np.array([s.node for s in instance.stops], dtype=np.int64)
    after = np.where(instance.optional, np.minimum(instance.energy_min_kwh[node], leave), leave)
    if S and node[-1] == n:
        after[-1] = instance.end_energy_min_kwh
    out = np.array([s.detour_out_kwh for s in instance.stops])
    longest = np.array([min(s.max_dwell_h, instance.total_dwell_h) for s in instance.stops])
    box = Box(
        energy=energy,
        temperature=temperature,
        power=Interval(np.full(n, -np.inf), np.full(n, np.inf)),
        charge=Interval(np.full(S, w), e_hi - least),
        arrive=Interval(least, np.full(S, e_hi - w)),
        leave=Interval(leave, e_hi - out),
        stop_temperature=Interval(np.full((S, K + 1), t_lo), np.full((S, K + 1), t_hi)),
        dwell=Interval(np.zeros((S, K)), np.broadcast_to(longest[:, None], (S, K)).copy()),
        stay=Interval(np.zeros(S), longest),
        after=Interval(after, np.where(instance.optional, instance.ceiling_kwh, e_hi - out)),
        after_temperature=Interval(np.full(S, t_lo), np.full(S, t_hi)),
        optional=instance.optional,
        node=node,
        count=(S - int(instance.optional.sum()), S),
    )
    if end is not None:
        box = box.with_end(end)
    for _ in range(ROUNDS):
        if box.empty:
            break
        box = propagate(instance, box)
    return box
