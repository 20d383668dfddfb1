"""Owns the mesh of the dynamic programme and its interpolation: cost-to-go tables as values.

Costs and frontiers are cubic between temperatures and between surpluses, and nothing is
mixed with what has no way on. Knows nothing of the recursion that fills the tables.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from benchmarks.reference.dynamic_car import CarArrays, Cells, Levels, make_levels
from relax.instance import Drive, Stop
from relax.trip import Trip

__all__ = ["BIG", "SURPLUS_TOLERANCE_KWH", "Resolution", "ValueTables", "cubic", "slopes"]

Array = npt.NDArray[np.float64]

BIG = 1e6
"""Cost of states without a way on: finite, so that interpolation stays defined, and so large
that no plan is tempted [currency]."""
OCCUPANCY = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Weights of an occupancy fee, as shares: each gives a lower estimate, the largest counts."""
LINEAR = 0.1
"""First interval of the surplus as a share of the mean one: the mesh is a parabola."""
NO_WAY = 0.5 * BIG
"""Interpolation with a cost or a frontier beyond this gives ``BIG``, and nothing between:
a mixture would look like a steep but passable slope."""
SURPLUS_TOLERANCE_KWH = 1e-6
"""Missing energy that is rounding of the frontier's own equation [kWh]."""


def slopes(table: Array) -> Array:
    """Return slopes at the nodes along the last axis such that the cubics are monotone.

    Harmonic means of the neighbouring differences, zero at extrema (Fritsch and Butland
    1984): no overshoot beside the kinks that limits and decisions make. One-sided beside
    what has no way on.
    """
    step = np.diff(table, axis=-1)
    wild = np.abs(step) > NO_WAY
    left = np.concatenate([step[..., :1], step], axis=-1)
    right = np.concatenate([step, step[..., -1:]], axis=-1)
    no_left = np.concatenate([wild[..., :1], wild], axis=-1)
    no_right = np.concatenate([wild, wild[..., -1:]], axis=-1)
    left, right = np.where(no_left, right, left), np.where(no_right, left, right)
    same = (left * right > 0.0) & ~(no_left & no_right)
    total = np.where(same, left + right, 1.0)
    return np.asarray(np.where(same, 2.0 * left * right / total, 0.0))


def cubic(flat: Array, slope: Array, at: npt.NDArray[np.intp], v: Array) -> Array:
    """Return the cubic through two nodes with their slopes, at weight v in [0, 1]."""
    return hermite(flat[at], flat[at + 1], slope[at], slope[at + 1], v)


def hermite(f0: Array, f1: Array, d0: Array, d1: Array, v: Array) -> Array:
    """Return the cubic from f0 to f1 with end slopes d0 and d1; no way on if one end has none."""
    rise = f1 - f0
    wave = (1.0 - v) * (d0 - rise) - v * (d1 - rise)
    smooth = f0 + v * rise + v * (1.0 - v) * wave
    blocked = ((f0 > NO_WAY) & (v < 1.0)) | ((f1 > NO_WAY) & (v > 0.0))
    return np.asarray(np.where(blocked, BIG, smooth))


@dataclass(frozen=True)
class Resolution:
    """Mesh of the state space and levels of the controls.

    Parameters
    ----------
    temperature_k : float
        Spacing of battery temperatures [K].
    cell_kwh : float
        Energy of a charging cell, and spacing of energies at stops [kWh].
    surplus : int
        Number of intervals of the surplus while driving: fine near zero, where the
        cost-to-go bends most, and wide for full batteries.
    heater, pump : int
        Levels of heater and heat pump.
    power : tuple of float
        Levels of the charging power, as shares of the limit.
    cooling : bool
        Whether the battery may be cooled.
    below_ambient_k : float
        How far below all ambient temperatures the mesh reaches, for a heat pump may cool
        the battery so far [K].
    """

    temperature_k: float = 1.0
    cell_kwh: float = 1.0
    surplus: int = 40
    heater: int = 4
    pump: int = 4
    power: tuple[float, ...] = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
    cooling: bool = True
    below_ambient_k: float = 12.0


@dataclass
class ValueTables:
    """Cost-to-go of a trip on one mesh.

    Parameters
    ----------
    trip : Trip
        The trip.
    resolution : Resolution
        The mesh.
    drive : Drive
        Its driving steps.
    stops : tuple of Stop
        The chargers in driving order; "next stop" ``len(stops)`` is the destination.
    order : tuple of tuple of int
        After stop i, the next stops allowed; the last row is the departure's.
    temperature_c : ndarray, shape (t,)
        The mesh of temperatures.
    frontier : list of list of ndarray, shape (t,)
        ``frontier[j][k]``: least energy at node k on the way to next stop j [kWh].
    value : list of list of ndarray, shape (s, t)
        ``value[j][k]``: cost-to-go over surplus and temperature; empty for the destination,
        where it is zero wherever there is a surplus (with recuperation, unless too full).
    surplus_kwh : ndarray, shape (s,)
        Mesh of the surplus.
    stop_energy_kwh : list of ndarray, shape (m,)
        Mesh of energies at every stop, after the detour in.
    stop_value : list of list of ndarray, shape (m, t)
        Cost-to-go inside every stop, per weight of the occupancy.
    """

    trip: Trip
    resolution: Resolution
    drive: Drive
    stops: tuple[Stop, ...]
    order: tuple[tuple[int, ...], ...]
    temperature_c: Array
    frontier: list[list[Array]] = field(default_factory=list)
    value: list[list[Array]] = field(default_factory=list)
    stop_energy_kwh: list[Array] = field(default_factory=list)
    stop_value: list[list[Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Prepare the car and what is shared by all recursions."""
        self.car = CarArrays(self.trip.vehicle)
        self.energy_max = float(self.trip.vehicle.pack.energy_kwh(self.trip.soc_max))
        self.start_energy = float(self.trip.vehicle.pack.energy_kwh(self.trip.start_soc))
        self.ceiling = max(self.energy_max, self.start_energy)
        # per K or kW: far above what breaking a limit could save
        price = max((s.price_per_kwh for s in self.stops), default=1.0)
        hour = max((s.time_price_per_h + s.occupancy_price_per_h for s in self.stops), default=0.0)
        self.limit_price = 10.0 * price + hour
        part = np.linspace(0.0, 1.0, self.resolution.surplus + 1)
        self.surplus_kwh = self.ceiling * part * (LINEAR + (1.0 - LINEAR) * part)

    @property
    def value_at_start(self) -> float:
        """Least cost of the trip over all plans the order allows [currency]."""
        found = self.departure(self.start_energy, self.trip.start_temperature_c, 0, self.order[-1])
        return min((cost for _, cost in found), default=BIG)

    def departure(
        self, energy: float, temp: float, node: int, choices: tuple[int, ...]
    ) -> list[tuple[int, float]]:
        """Return next stops within reach from a state, with the cost-to-go of each."""
        found = []
        for j in choices:
            surplus = energy - float(self.along(self.frontier[j][node], np.array(temp)))
            if surplus >= -SURPLUS_TOLERANCE_KWH:
                cost = self.at(j, node, np.array(surplus), np.array(temp))
                found.append((j, float(cost)))
        return found

    def margins(self, j: int) -> Array:
        """Return surpluses with which a stop may be left for next stop j between two cells [kWh].

        None is worth having on the way to the destination. Before a stop, a little lets
        the car heat its battery; departures with more are the ends of whole cells.
        """
        if not self.value[j]:
            return np.zeros(1)
        return self.surplus_kwh[self.surplus_kwh < self.resolution.cell_kwh]

    def weights(self, i: int) -> tuple[float, ...]:
        """Return the prices at which an hour at stop i may count as occupancy."""
        price = self.stops[i].occupancy_price_per_h
        return tuple(w * price for w in OCCUPANCY) if price > 0.0 else (0.0,)

    def column(self, temp: Array) -> tuple[npt.NDArray[np.intp], Array]:
        """Return cell and weight of temperatures on the mesh; clipped to it."""
        mesh = self.temperature_c
        place = (temp - mesh[0]) / (mesh[1] - mesh[0])
        j = np.clip(place.astype(np.intp), 0, mesh.size - 2)
        return j, np.clip(place - j, 0.0, 1.0)

    def at(self, j: int, node: int, surplus: Array, temp: Array) -> Array:
        """Return the cost-to-go to next stop j from a surplus >= 0 (clipped)."""
        if not self.value[j]:
            return np.zeros(np.broadcast_shapes(surplus.shape, temp.shape))
        return self.blend(self.value[j][node], self.row(surplus), temp)

    def row(self, surplus: Array) -> Array:
        """Return the place of a surplus >= 0 (clipped) on its mesh, in intervals."""
        half = 0.5 * LINEAR / (1.0 - LINEAR)
        scaled = np.clip(surplus / self.ceiling, 0.0, 1.0) / (1.0 - LINEAR)
        return np.asarray(self.resolution.surplus * (np.sqrt(half * half + scaled) - half))

    def along(self, line: Array, temp: Array) -> Array:
        """Return a line over the mesh, shape (t,), at temperatures; cubic between."""
        return cubic(line, slopes(line), *self.column(temp))

    def blend(self, table: Array, row: Array, temp: Array) -> Array:
        """Return a table, shape (s, t), at rows and temperatures; cubic between both."""
        n = table.shape[1]
        i = np.clip(row.astype(np.intp), 0, table.shape[0] - 2)
        u = np.clip(row - i, 0.0, 1.0)
        j, v = self.column(temp)
        flat, slope = table.ravel(), slopes(table).ravel()
        at = i * n + j
        low, high = cubic(flat, slope, at, v), cubic(flat, slope, at + n, v)
        bend = np.ascontiguousarray(slopes(table.T).T).ravel()
        d0 = bend[at] + v * (bend[at + 1] - bend[at])
        d1 = bend[at + n] + v * (bend[at + n + 1] - bend[at + n])
        return hermite(low, high, d0, d1, u)

    def drive_levels(self, k: int) -> Levels:
        """Return the control levels of driving step k."""
        m = self.resolution
        demand = float(self.drive.cabin_heat_kw[k])
        return make_levels(self.trip.vehicle, demand, m.heater, m.pump, cooling=m.cooling)

    def stop_levels(self, stop: Stop) -> Levels:
        """Return the control levels of charging cells."""
        m = self.resolution
        return make_levels(
            self.trip.vehicle, stop.cabin_heat_kw, 3, min(m.pump, 3), m.power, m.cooling
        )

    def off_mesh(self, end: Array) -> Array:
        """Return by how much temperatures lie below the mesh [K]."""
        return np.asarray(np.maximum(self.temperature_c[0] - 1e-9 - end, 0.0))

    def cell_cost(self, stop: Stop, cells: Cells, weight: float) -> Array:
        """Return the cost of charging cells [currency]."""
        cost = stop.price_per_kwh * cells.grid_kwh
        cost = cost + (stop.time_price_per_h + weight) * cells.dwell_h
        broken = cells.broken + self.off_mesh(cells.end_c)
        return np.where(cells.allowed, cost + self.limit_price * broken, BIG)
