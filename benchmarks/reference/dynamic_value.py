"""Owns the backward recursion: the cost-to-go over energy, temperature and next stop.

Energy is counted as the *surplus* over the frontier, the least energy from which the next
stop (or the destination) can still be reached. The frontier has a recursion of its own over
temperature alone, so no interpolation ever reaches across the border of feasibility, on
which optimal plans lie. One cost-to-go per next stop: driving past a charger is the decision
for a later next stop, taken on departure, so all 2^N subsets cost N + 1 recursions. Knows
nothing of our relaxation, our refinement, and of plans.
"""

from __future__ import annotations

from math import inf

import numpy as np
import numpy.typing as npt

from benchmarks.reference.dynamic_car import Cells, Levels
from benchmarks.reference.dynamic_tables import (
    BIG,
    SURPLUS_TOLERANCE_KWH,
    Resolution,
    ValueTables,
    cubic,
    slopes,
)
from relax.instance import Drive, make_drive, make_stop
from relax.trip import Trip

__all__ = ["BROKEN_KWH", "compute_tables", "departure_frontier", "edge_cells"]

Array = npt.NDArray[np.float64]

FRONTIER_PASSES = 6
"""Fixed-point passes of the frontier's implicit equation; each gains a factor of 50."""
EDGE_MARGIN = 0.5
"""Share of a cell by which the frontier may move while the cell warms the battery."""
LEAST_PART = 1e-3
"""Least share of a cell: cells need a finite power."""
EDGE_TOLERANCE_KWH = 1e-4
"""How exactly a cell must end on a frontier [kWh]."""
LOSS_KWH = 5.0
"""Spacing of energies at which the outcome of a step is computed; linear between, for losses
and limits hardly depend on the energy [kWh]."""
LEAST_SPACING_KWH = 1e-3
"""Distance below which two of them count as one [kWh]."""
LOSS_MARGIN = 1.3
"""Factor by which losses may raise the power above the load."""
CHUNK = 400_000
"""Points per array operation: the working set stays in the processor's cache and memory low."""
BROKEN_KWH = 1.0
"""Virtual energy that a broken limit costs [kWh per K or kW]: the frontier stays finite, and
what breaks a limit is never on it if anything else is."""


def _temperatures(trip: Trip, drive: Drive, resolution: Resolution) -> Array:
    """Return the mesh: from below anything reachable to the battery's limit."""
    pack = trip.vehicle.pack
    cold = min(trip.start_temperature_c, float(drive.ambient_c.min()))
    cold = min([cold, *(c.ambient_c for c in trip.chargers)])
    has_pump = trip.vehicle.heat_pump_kw > 0.0
    lo = max(pack.temperature_min_c, cold - (resolution.below_ambient_k if has_pump else 2.0))
    spacing = resolution.temperature_k
    count = int(np.ceil((pack.temperature_max_c - lo) / spacing - 1e-9))
    lo = max(pack.temperature_min_c, pack.temperature_max_c - count * spacing)
    return np.linspace(lo, pack.temperature_max_c, count + 1)


def compute_tables(
    trip: Trip, resolution: Resolution | None = None, subset: tuple[int, ...] | None = None
) -> ValueTables:
    """Compute the cost-to-go from the destination back to the departure.

    Parameters
    ----------
    trip : Trip
        The trip.
    resolution : Resolution, optional
        The mesh.
    subset : tuple of int, optional
        Use exactly these chargers; any of them by default.

    Raises
    ------
    ValueError
        The trip limits the time of all stops together: that would be one more state.

    Examples
    --------
    >>> from relax import load_trip
    >>> coarse = Resolution(temperature_k=5.0, cell_kwh=5.0, surplus=10, heater=2, pump=2)
    >>> tables = compute_tables(load_trip("paper-400km"), coarse, (1,))
    >>> 300.0 < tables.value_at_start < 330.0
    True
    """
    if trip.stop_time_h < inf:
        raise ValueError(f"{trip.name}: dynamic programming knows no limit of the time in all")
    resolution = resolution or Resolution()
    drive = make_drive(trip, trip.grid.step_km)
    used = range(len(trip.chargers)) if subset is None else subset
    stops = sorted((make_stop(trip, drive, i) for i in used), key=lambda s: (s.node, s.charger))
    n = len(stops)
    if subset is None:
        order = (*(tuple(range(i + 1, n + 1)) for i in range(n)), tuple(range(n + 1)))
    else:
        order = (*((i + 1,) for i in range(n)), (0,))
    tables = ValueTables(
        trip, resolution, drive, tuple(stops), order,
        _temperatures(trip, drive, resolution),
    )  # fmt: skip
    tables.frontier = [[] for _ in range(n + 1)]
    tables.value = [[] for _ in range(n + 1)]
    tables.stop_energy_kwh = [np.empty(0)] * n
    tables.stop_value = [[] for _ in range(n)]
    _sweep(tables)
    return tables


def _sweep(tables: ValueTables) -> None:
    """Go back from the destination: all next stops share the outcome of every step."""
    stops, drive, temp = tables.stops, tables.drive, tables.temperature_c
    n = len(stops)
    energy = _energies(tables)
    for k in range(drive.n_steps, -1, -1):
        if k < drive.n_steps:
            levels = tables.drive_levels(k)
            steps = tables.car.drive(drive, k, energy[:, None, None], temp[:, None], levels)
            broken = steps.broken + tables.off_mesh(steps.end_c)
            drop = steps.drop_kwh + BROKEN_KWH * broken
            packed = np.stack([drop, steps.end_c, broken])
            for j in range(n + 1):
                if tables.frontier[j]:
                    _step_back(tables, j, k, energy, packed)
        else:
            tables.frontier[n].append(np.full(temp.size, float(drive.energy_min_kwh[-1])))
            if float(drive.base_kw.min()) < 0.0:  # the battery might get too full on the way
                tables.value[n].append(np.zeros((tables.surplus_kwh.size, temp.size)))
        for i in range(n - 1, -1, -1):
            if stops[i].node == k:
                frontier, value = _stop_back(tables, i)
                tables.frontier[i].append(frontier)
                tables.value[i].append(value)
    for j in range(n + 1):
        tables.frontier[j].reverse()
        tables.value[j].reverse()


def _energies(tables: ValueTables) -> Array:
    """Return the energies at which steps are computed; with the kinks of a limit that may bind."""
    car, drive = tables.trip.vehicle, tables.drive
    lo = float(min([drive.energy_min_kwh.min(), *(s.leave_min_kwh for s in tables.stops)]))
    mesh = np.linspace(lo, tables.ceiling, 1 + max(2, int(np.ceil(tables.ceiling / LOSS_KWH))))
    limit = car.pack.discharge_limit_kw
    extra = car.heater_kw + car.cooling_kw + car.heat_pump_kw
    if LOSS_MARGIN * (float(drive.base_kw.max()) + extra) > float(limit.f.min()):
        inside = limit.x[(limit.x > lo) & (limit.x < tables.ceiling)]
        mesh = np.union1d(mesh, inside)
        mesh = mesh[np.concatenate([[True], np.diff(mesh) > LEAST_SPACING_KWH])]
    return np.asarray(mesh)


def _place(coarse: Array, energy: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return cell and weight of energies on a mesh; clipped to it."""
    place = np.interp(energy, coarse, np.arange(coarse.size))
    i = np.minimum(place.astype(np.intp), coarse.size - 2)
    return i, place - i


def _read(packed: Array, coarse: Array, energy: Array, column: Array) -> Array:
    """Return drop, end temperature and excess at energies, shape (3, *energy.shape, u)."""
    i, w = _place(coarse, energy)
    w = w[..., None]
    low = packed[:, i, column]
    return np.asarray(low + w * (packed[:, i + 1, column] - low))


def _step_back(tables: ValueTables, j: int, k: int, coarse: Array, packed: Array) -> None:
    """Append frontier and cost-to-go of next stop j at node k to those at node k + 1."""
    frontier = tables.frontier[j][-1]
    temp = tables.temperature_c
    n, controls = temp.size, packed.shape[-1]
    column = np.arange(n)
    need = np.broadcast_to((frontier + packed[0, 0].max(axis=-1))[:, None], (n, controls))
    for _ in range(FRONTIER_PASSES):
        i, w = _place(coarse, need)
        u = np.arange(controls)
        low = packed[:, i, column[:, None], u]
        drop, end, _ = low + w * (packed[:, i + 1, column[:, None], u] - low)
        need = drop + tables.along(frontier, end)
    least = np.maximum(need.min(axis=1), float(tables.drive.energy_min_kwh[k]))
    tables.frontier[j].append(least)
    if not tables.value[j]:
        return
    value = tables.value[j][-1]
    rows = value.shape[0]
    table = np.empty((rows, n))
    chunk = max(1, CHUNK // (n * controls))
    for first in range(0, rows, chunk):
        energy = least + tables.surplus_kwh[first : first + chunk, None]
        drop, end, broken = _read(packed, coarse, energy, np.broadcast_to(column, energy.shape))
        # a full battery refuses the rest; the little heat of charging it is kept
        drop = np.maximum(drop, energy[..., None] - tables.ceiling)
        left = energy[..., None] - drop - tables.along(frontier, end)
        cost = tables.blend(value, tables.row(left), end) + tables.limit_price * broken
        open_ = left >= -SURPLUS_TOLERANCE_KWH
        table[first : first + chunk] = np.where(open_, cost, BIG).min(axis=-1)
    tables.value[j].append(table)


def _stop_back(tables: ValueTables, i: int) -> tuple[Array, Array]:
    """Fill the cost-to-go inside stop i; return frontier and cost-to-go on arrival at its node."""
    stop, m = tables.stops[i], tables.resolution
    temp = tables.temperature_c
    least = stop.arrive_min_kwh + stop.detour_in_kwh
    if stop.node < tables.drive.n_steps:
        least = max(least, float(tables.drive.energy_min_kwh[stop.node]))
    first = least - stop.detour_in_kwh
    count = max(2, int(np.ceil((tables.energy_max - first) / m.cell_kwh - 1e-9)))
    energy = np.linspace(first, tables.energy_max, count + 1)
    tables.stop_energy_kwh[i] = energy
    leave = np.full((count + 1, temp.size), BIG)
    for j in tables.order[i]:
        surplus = energy[:, None] - departure_frontier(tables, i, j)
        cost = tables.at(j, -1, np.maximum(surplus, 0.0), temp)
        leave = np.minimum(leave, np.where(surplus >= -SURPLUS_TOLERANCE_KWH, cost, BIG))
    tables.stop_value[i] = [leave.copy() for _ in tables.weights(i)]
    _leave_on_frontiers(tables, i)
    _charge_back(tables, i)
    portion = float(energy[1] - energy[0])
    row = np.minimum(tables.surplus_kwh / portion, float(count))  # none is charged above the top
    arrive = np.max(
        [
            tables.blend(table, row[:, None], temp) - weight * stop.occupancy_free_h
            for weight, table in zip(tables.weights(i), tables.stop_value[i], strict=True)
        ],
        axis=0,
    )
    return np.full(temp.size, least), np.minimum(arrive + stop.fixed_cost, BIG)


def departure_frontier(tables: ValueTables, i: int, j: int, node: int = -1) -> Array:
    """Return the least energy on unplugging at stop i for next stop j, shape (t,) [kWh]."""
    stop = tables.stops[i]
    edge = np.maximum(tables.frontier[j][node], stop.leave_min_kwh)
    return np.asarray(edge + stop.detour_out_kwh)


def _leave_on_frontiers(tables: ValueTables, i: int) -> None:
    """Add departures exactly on a frontier, after a cell of less than the usual energy."""
    stop, energy, temp = tables.stops[i], tables.stop_energy_kwh[i], tables.temperature_c
    portion = float(energy[1] - energy[0])
    levels = tables.stop_levels(stop)
    for j in tables.order[i]:
        for ahead in tables.margins(j):
            edge = departure_frontier(tables, i, j) + ahead
            gap = edge - energy[:-1, None]
            near = portion * (1.0 + EDGE_MARGIN)
            r, c = np.nonzero((gap > -EDGE_MARGIN * portion) & (gap < near))
            part, cells = edge_cells(
                tables, i, edge, energy[r, None], temp[c, None], portion, levels
            )
            onward = tables.at(j, -1, np.array([ahead]), cells.end_c)
            for weight, table in zip(tables.weights(i), tables.stop_value[i], strict=True):
                cost = np.where(part > 0.0, tables.cell_cost(stop, cells, weight) + onward, BIG)
                table[r, c] = np.minimum(table[r, c], cost.min(axis=-1))


def edge_cells(
    tables: ValueTables,
    i: int,
    edge: Array,
    energy: Array,
    temp: Array,
    portion: float,
    levels: Levels,
) -> tuple[Array, Cells]:
    """Return cells that end on a frontier, and their energies (0 where there is none) [kWh].

    Parameters
    ----------
    edge : ndarray, shape (t,)
        The frontier over the mesh of temperatures.
    energy, temp : ndarray
        States, the last axis of length 1 for the controls.
    portion : float
        Largest energy of a cell.
    """
    end = temp
    for _ in range(FRONTIER_PASSES):
        wanted = tables.along(edge, end) - energy
        part = np.clip(wanted, LEAST_PART * portion, portion)
        cells = tables.car.charge(tables.stops[i], energy, temp, part, levels)
        end = cells.end_c
    wanted = tables.along(edge, end) - energy
    met = np.abs(wanted - part) <= EDGE_TOLERANCE_KWH
    return np.where(met & cells.allowed, part, 0.0), cells


def _charge_back(tables: ValueTables, i: int) -> None:
    """Sweep from a full battery down: leave, or charge one more cell."""
    stop, energy = tables.stops[i], tables.stop_energy_kwh[i]
    portion = float(energy[1] - energy[0])
    levels = tables.stop_levels(stop)
    temp = tables.temperature_c[:, None]
    batch = max(1, CHUNK // (temp.size * levels.heater.size))
    for top in range(energy.size - 1, 0, -batch):
        rows = np.arange(max(top - batch, 0), top)
        cells = tables.car.charge(stop, energy[rows, None, None], temp, portion, levels)
        at, v = tables.column(cells.end_c)
        for weight, table in zip(tables.weights(i), tables.stop_value[i], strict=True):
            cost = tables.cell_cost(stop, cells, weight)
            for b in range(rows.size - 1, -1, -1):
                ahead = table[rows[b] + 1]
                onward = cost[b] + cubic(ahead, slopes(ahead), at[b], v[b])
                np.minimum(table[rows[b]], onward.min(axis=-1), out=table[rows[b]])
