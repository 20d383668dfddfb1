"""Owns the forward pass: from cost-to-go tables to the controls of a plan.

At every state the best control against the cost-to-go, with finer levels than the backward
recursion used. The marginal cells of a stop are then averaged, weighted by time, onto the
transcription's cells of equal energy. Judges nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

import numpy as np
import numpy.typing as npt

from benchmarks.reference.dynamic_car import Levels, make_levels
from benchmarks.reference.dynamic_tables import BIG, ValueTables
from benchmarks.reference.dynamic_value import BROKEN_KWH, departure_frontier, edge_cells
from relax.instance import MIN_CHARGE_KWH
from relax.plan import Controls, StopControls

__all__ = ["Forward", "follow"]

Array = npt.NDArray[np.float64]

SLACK_KWH = 0.02
"""Missing surplus that the forward pass accepts: the frontier is interpolated over temperature,
and the charged energies are corrected afterwards [kWh]."""
FINER = 3
"""Levels of the forward pass per level of the backward one."""
TIE_PER_KWH = 1e-6
"""Of controls that cost the same, the one that leaves more energy [currency/kWh]."""
AT_FULL_POWER = 1.0 - 1e-9
"""Share of the charging limit from which a cell charges as fast as it may."""


@dataclass(frozen=True)
class Forward:
    """What following the tables gives.

    Parameters
    ----------
    subset : tuple of int
        The chargers used, in driving order.
    controls : Controls
        For the instance of that subset.
    tight : frozenset of int
        Stops (by their place in the subset) reached with the least energy.
    cold_end_k : float
        Least distance of the battery's temperature from the cold end of the mesh [K].
    cooling_kw : float
        Largest cooling power used.
    """

    subset: tuple[int, ...]
    controls: Controls
    tight: frozenset[int]
    cold_end_k: float
    cooling_kw: float


@dataclass
class _Marginal:
    """Marginal cells of one stop as they are charged."""

    energy_kwh: list[float] = field(default_factory=list)
    dwell_h: list[float] = field(default_factory=list)
    heater_kw: list[float] = field(default_factory=list)
    cooling_kw: list[float] = field(default_factory=list)
    pump_kw: list[float] = field(default_factory=list)
    full: list[float] = field(default_factory=list)
    cost: list[float] = field(default_factory=list)

    def controls(self, cells: int) -> StopControls:
        """Average onto cells of equal energy: energies of the actuators are kept."""
        borders = np.concatenate([[0.0], np.cumsum(self.energy_kwh)])
        total = float(borders[-1])
        if total < MIN_CHARGE_KWH:
            none = np.zeros(cells)
            return StopControls(MIN_CHARGE_KWH, np.full(cells, inf), none, none, none)
        wanted = np.linspace(0.0, total, cells + 1)

        def share(per_cell: Array) -> Array:
            """Return how much of a quantity falls into every cell of equal energy."""
            summed = np.concatenate([[0.0], np.cumsum(per_cell)])
            return np.diff(np.interp(wanted, borders, summed))

        hours = np.array(self.dwell_h)
        dwell = share(hours)
        powers = [
            share(np.array(column) * hours) / dwell
            for column in (self.heater_kw, self.cooling_kw, self.pump_kw)
        ]
        slow = share((1.0 - np.array(self.full)) * hours) > 0.0
        power = np.where(slow, total / cells / dwell, inf)
        return StopControls(total, power, *powers)


def follow(tables: ValueTables) -> Forward | None:
    """Return the plan that the tables lead to; None if the start has no way on.

    Examples
    --------
    >>> from benchmarks.reference.dynamic_tables import Resolution
    >>> from benchmarks.reference.dynamic_value import compute_tables
    >>> from relax import load_trip
    >>> coarse = Resolution(temperature_k=5.0, cell_kwh=5.0, surplus=10, heater=2, pump=2)
    >>> plan = follow(compute_tables(load_trip("paper-400km"), coarse))
    >>> plan.subset, plan.controls.heater_kw.shape
    ((1,), (100,))
    """
    energy, temp = tables.start_energy, tables.trip.start_temperature_c
    found = [p for p in tables.departure(energy, temp, 0, tables.order[-1]) if p[1] < 0.5 * BIG]
    if not found:
        return None
    j = min(found, key=lambda pair: pair[1])[0]
    n = tables.drive.n_steps
    settings = np.zeros((3, n))
    stops: list[StopControls] = []
    used: list[int] = []
    tight: list[int] = []
    coldest, cooling = temp, 0.0
    k = 0
    while True:
        end_node = n if j == len(tables.stops) else tables.stops[j].node
        for step in range(k, end_node):
            energy, temp, settings[:, step] = _step(tables, j, step, energy, temp)
            coldest = min(coldest, temp)
        k = end_node
        if j == len(tables.stops):
            break
        stop = tables.stops[j]
        energy -= stop.detour_in_kwh
        if energy - float(tables.stop_energy_kwh[j][0]) < 2.0 * SLACK_KWH:
            tight.append(len(used))
        used.append(stop.charger)
        energy, temp, following, marginal = _stop(tables, j, energy, temp)
        energy -= stop.detour_out_kwh
        stops.append(marginal.controls(tables.trip.grid.cells))
        cooling = max(cooling, *marginal.cooling_kw, 0.0)
        coldest = min(coldest, temp)
        j = following
    return Forward(
        subset=tuple(used),
        controls=Controls(settings[0], settings[1], settings[2], tuple(stops)),
        tight=frozenset(m for m in tight if m > 0),
        cold_end_k=coldest - float(tables.temperature_c[0]),
        cooling_kw=max(cooling, float(settings[1].max())),
    )


def _finer(tables: ValueTables, demand: float, power: tuple[float, ...] = (1.0,)) -> Levels:
    """Return the control levels of the forward pass."""
    m = tables.resolution
    heater, pump = FINER * (m.heater - 1) + 1, FINER * (m.pump - 1) + 1
    return make_levels(tables.trip.vehicle, demand, heater, pump, power, m.cooling)


def _step(
    tables: ValueTables, j: int, k: int, energy: float, temp: float
) -> tuple[float, float, Array]:
    """Return the state after the best control of step k, and that control's powers."""
    levels = _finer(tables, float(tables.drive.cabin_heat_kw[k]))
    steps = tables.car.drive(tables.drive, k, np.array([energy]), np.array([temp]), levels)
    broken = steps.broken + tables.off_mesh(steps.end_c)
    drop = np.maximum(steps.drop_kwh, energy - tables.ceiling)  # a full battery refuses the rest
    left = energy - drop - tables.along(tables.frontier[j][k + 1], steps.end_c)
    left = left - BROKEN_KWH * broken
    open_ = left >= -SLACK_KWH
    if tables.value[j] and np.any(open_):
        cost = tables.at(j, k + 1, np.maximum(left, 0.0), steps.end_c) - TIE_PER_KWH * left
        best = int(np.argmin(np.where(open_, cost + tables.limit_price * broken, inf)))
    else:  # all that is left to do is to save energy
        best = int(np.argmax(left))
    powers = np.array([steps.heater_kw[best], steps.cooling_kw[best], steps.pump_kw[best]])
    return energy - float(drop[best]), float(steps.end_c[best]), powers


def _stop(
    tables: ValueTables, i: int, energy: float, temp: float
) -> tuple[float, float, int, _Marginal]:
    """Charge at stop i as the tables say; return state, next stop and the cells.

    With an occupancy fee the tables of every weight are followed, and what they really
    cost decides.
    """
    stop = tables.stops[i]
    tried = []
    for weight, table in zip(tables.weights(i), tables.stop_value[i], strict=True):
        left, end, j, done = _charged(tables, i, energy, temp, weight, table)
        hours = sum(done.dwell_h)
        onward = tables.departure(left - stop.detour_out_kwh + SLACK_KWH, end, stop.node, (j,))
        cost = sum(done.cost) + stop.occupancy_price_per_h * max(0.0, hours - stop.occupancy_free_h)
        tried.append((cost + (onward[0][1] if onward else BIG), (left, end, j, done)))
    return min(tried, key=lambda pair: pair[0])[1]


def _charged(
    tables: ValueTables, i: int, energy: float, temp: float, weight: float, table: Array
) -> tuple[float, float, int, _Marginal]:
    """Follow one table of stop i."""
    stop, mesh = tables.stops[i], tables.stop_energy_kwh[i]
    portion = float(mesh[1] - mesh[0])
    levels = _finer(tables, stop.cabin_heat_kw, tables.resolution.power)
    done = _Marginal()
    while True:
        choices: list[tuple[float, int, float, float, tuple[float, ...]]] = []
        for j, cost in tables.departure(
            energy - stop.detour_out_kwh, temp, stop.node, tables.order[i]
        ):
            if energy - stop.detour_out_kwh >= stop.leave_min_kwh:
                choices.append((cost, j, 0.0, temp, ()))
        edges = [(j, float(m)) for j in tables.order[i] for m in tables.margins(j)]
        for j, ahead in (*edges, (-1, 0.0)):
            if j < 0:
                part = np.full(levels.heater.size, min(portion, float(mesh[-1]) - energy))
                if part[0] <= 0.0:
                    continue
                cells = tables.car.charge(stop, np.array([energy]), np.array([temp]), part, levels)
                good = cells.allowed
                row = np.clip((energy + part - mesh[0]) / portion, 0.0, None)
                onward = tables.blend(table, row, cells.end_c)
            else:
                edge = departure_frontier(tables, i, j, stop.node) + ahead
                part, cells = edge_cells(
                    tables, i, edge, np.array([energy]), np.array([temp]), portion, levels
                )
                good = part > 0.0
                onward = tables.at(j, stop.node, np.array([ahead]), cells.end_c)
            cost_of = np.where(good, tables.cell_cost(stop, cells, weight) + onward, inf)
            b = int(np.argmin(cost_of))
            if cost_of[b] < inf:
                row_of = tuple(
                    float(c[b])
                    for c in (
                        cells.dwell_h, cells.heater_kw, cells.cooling_kw, cells.pump_kw,
                        levels.power >= AT_FULL_POWER, tables.cell_cost(stop, cells, 0.0),
                    )
                )  # fmt: skip
                choices.append(
                    (float(cost_of[b]), j, float(part[b]), float(cells.end_c[b]), row_of)
                )
        if not choices:  # a dead end, which the judge will refuse
            return energy, temp, tables.order[i][-1], done
        _, j, part_b, end, row_of = min(choices, key=lambda c: c[0])
        energy, temp = energy + part_b, end
        if row_of:
            columns = (
                done.dwell_h, done.heater_kw, done.cooling_kw, done.pump_kw, done.full, done.cost,
            )  # fmt: skip
            done.energy_kwh.append(part_b)
            for column, number in zip(columns, row_of, strict=True):
                column.append(number)
        if j >= 0:
            return energy, temp, j, done
