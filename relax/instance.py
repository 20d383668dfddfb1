"""Owns the transcription: one trip, one subset of chargers, one grid, as arrays.

Relaxation, refinement and the nonlinear reference all read these arrays, so
their bounds and costs compare. Driving steps run over distance; every stop is
``cells`` cells of equal internal energy, each with its own dwell. The driving
grid depends on *all* chargers of the trip, so all subsets share it. Knows
nothing of solvers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from relax.maps import Table1
from relax.trip import Grid, Trip
from relax.vehicle import Vehicle

__all__ = [
    "HEATER_SHARE",
    "LEAST_ROOM_KW",
    "MIN_CHARGE_KWH",
    "Drive",
    "Instance",
    "Stop",
    "make_drive",
    "make_instance",
]

Array = npt.NDArray[np.float64]

HEATER_SHARE = 0.9
"""Share of a charger's free power that the battery heater may take: charging goes on."""
LEAST_ROOM_KW = 0.02
"""Charging power left when a charger cannot serve the cabin; the excess is a violation [kW]."""
MIN_CHARGE_KWH = 0.1
"""Least internal energy of a used stop [kWh]: cells of zero energy have no power. A rule of the
model, which simulation and drive check; nobody heats at a charger without charging."""


@dataclass(frozen=True)
class Drive:
    """Driving steps; arrays of shape (n,) unless stated.

    Parameters
    ----------
    node_km : ndarray, shape (n + 1,)
        Step borders [km].
    duration_h : ndarray
        Driving time [h].
    base_kw : ndarray
        Mean propulsion, auxiliaries and cabin cooling [kW].
    propulsion_kw : ndarray
        Mean propulsion alone, for reports [kW].
    ripple_kw2 : ndarray
        Variance of the propulsion power within the step [kW^2].
    drivetrain_heat_kw : ndarray
        Mean drivetrain heat to the battery [kW].
    ambient_c, heat_loss_kw_per_k : ndarray
        Mean ambient temperature and conductance, such that the mean heat loss is
        conductance * (ambient - T).
    cabin_heat_kw : ndarray
        Cabin heating demand q [kW].
    energy_min_kwh : ndarray, shape (n + 1,)
        Least internal energy at every node on the way; at the destination the
        least at the end of the trip [kWh].
    """

    node_km: Array
    duration_h: Array
    base_kw: Array
    propulsion_kw: Array
    ripple_kw2: Array
    drivetrain_heat_kw: Array
    ambient_c: Array
    heat_loss_kw_per_k: Array
    cabin_heat_kw: Array
    energy_min_kwh: Array

    @property
    def n_steps(self) -> int:
        """Number of driving steps."""
        return int(self.duration_h.size)


@dataclass(frozen=True)
class Stop:
    """A used charger, before driving step ``node`` (``n_steps``: at the destination).

    Parameters
    ----------
    charger : int
        Index into ``trip.chargers``.
    node : int
        Node of the driving grid where the stop is.
    detour_in_kwh, detour_out_kwh : float
        Internal energy lost before and after charging [kWh].
    grid_limit_kw : Table1
        Grid power limit over internal energy [kW over kWh].
    price_per_kwh : float
        Price of grid energy [currency/kWh].
    time_price_per_h : float
        Cost of an hour of dwell [currency/h].
    occupancy_free_h, occupancy_price_per_h : float
        Occupancy cost: price * max(0, dwell - free).
    fixed_cost : float
        Detour time and stop penalty [currency].
    detour_h : float
        Time lost to the detour [h].
    max_dwell_h : float
        Longest dwell [h].
    base_kw : float
        Auxiliaries and cabin cooling while parked [kW].
    cabin_heat_kw : float
        Cabin heating demand while parked [kW].
    ambient_c, heat_loss_kw_per_k : float
        Ambient temperature and conductance while parked.
    arrive_min_kwh, leave_min_kwh : float
        Least internal energy after the detour in and after the detour out [kWh].
    optional : bool
        Not decided yet whether it is used: for bounds of many subsets at once.
    """

    charger: int
    node: int
    detour_in_kwh: float
    detour_out_kwh: float
    grid_limit_kw: Table1
    price_per_kwh: float
    time_price_per_h: float
    occupancy_free_h: float
    occupancy_price_per_h: float
    fixed_cost: float
    detour_h: float
    max_dwell_h: float
    base_kw: float
    cabin_heat_kw: float
    ambient_c: float
    heat_loss_kw_per_k: float
    arrive_min_kwh: float
    leave_min_kwh: float
    optional: bool = False


@dataclass(frozen=True)
class Instance:
    """One subset on one grid, or with optional stops a family of subsets, for programs.

    Simulation and refinement need a fixed subset; bounds also take optional stops.

    Parameters
    ----------
    vehicle : Vehicle
        Maps and actuators.
    drive : Drive
        The driving steps.
    stops : tuple of Stop
        Used chargers, ordered by node.
    cells : int
        Charging cells per stop.
    start_energy_kwh, start_temperature_c : float
        State at departure.
    energy_min_kwh : ndarray, shape (n + 1,)
        Least internal energy on arrival at every node [kWh]; at the last one the
        least at the end of the trip, unless a stop is there (then its ``leave_min_kwh``).
    end_energy_min_kwh : float
        Least internal energy at the end of the trip [kWh].
    energy_max_kwh : float
        Largest internal energy after charging [kWh].
    temperature_min_c, temperature_max_c : float
        Limits of the battery temperature [degrees C].
    total_dwell_h : float
        Most dwell of all stops together: what the trip's limit of charging and detour
        time leaves after the detours, below 0 if these alone exceed it [h].
    free_start : bool
        The car starts anywhere in the box's first interval: a stage of a longer trip.
    """

    vehicle: Vehicle
    drive: Drive
    stops: tuple[Stop, ...]
    cells: int
    start_energy_kwh: float
    start_temperature_c: float
    energy_min_kwh: Array
    end_energy_min_kwh: float
    energy_max_kwh: float
    temperature_min_c: float
    temperature_max_c: float
    total_dwell_h: float = math.inf
    free_start: bool = False

    @property
    def ceiling_kwh(self) -> float:
        """Largest internal energy on the way: a full charge, or the start if that is above it.

        Recuperation beyond it is refused.
        """
        return max(self.energy_max_kwh, self.start_energy_kwh)

    @property
    def subset(self) -> tuple[int, ...]:
        """Indices of the used chargers, in driving order; optional ones are left out."""
        return tuple(stop.charger for stop in self.stops if not stop.optional)

    @property
    def optional(self) -> npt.NDArray[np.bool_]:
        """Which stops are optional, shape (S,)."""
        return np.array([stop.optional for stop in self.stops], dtype=np.bool_)

    @property
    def fixed_cost(self) -> float:
        """Cost that no control changes: detour time and stop penalties [currency]."""
        return sum(stop.fixed_cost for stop in self.stops if not stop.optional)


def _step_borders(trip: Trip, step_km: float) -> Array:
    """Return borders of equal steps of at most ``step_km`` between consecutive chargers."""
    length = trip.route.length_km
    anchors = sorted({0.0, length, *(c.position_km for c in trip.chargers)})
    borders = [0.0]
    for lo, hi in pairwise(anchors):
        count = max(1, math.ceil((hi - lo) / step_km - 1e-9))
        borders.extend(np.linspace(lo, hi, count + 1)[1:].tolist())
    return np.array(borders)


def make_drive(trip: Trip, step_km: float) -> Drive:
    """Average the route's samples over the driving steps.

    Parameters
    ----------
    trip : Trip
        The trip.
    step_km : float
        Longest step [km]; borders also fall on every charger.

    Returns
    -------
    Drive
        Time-weighted means; ``ripple_kw2`` keeps the variance of the propulsion
        power, so the mean Joule loss of a step is exact for its mean state (P2).
    """
    route, vehicle = trip.route, trip.vehicle
    borders = _step_borders(trip, step_km)
    fine = np.unique(np.concatenate([route.node_km, borders]))
    middle = 0.5 * (fine[1:] + fine[:-1])
    sample = np.searchsorted(route.node_km, middle, side="right") - 1
    step = np.searchsorted(borders, middle, side="right") - 1
    time = np.diff(fine) / route.speed_kmh[sample]
    n = borders.size - 1
    duration = np.bincount(step, time, n).astype(np.float64)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(step, time * values[sample], n) / duration)

    propulsion = mean(route.propulsion_kw)
    ripple = np.maximum(mean(route.propulsion_kw**2) - propulsion**2, 0.0)
    ripple[ripple < 1e-9 * (1.0 + propulsion**2)] = 0.0  # rounding of a constant power
    conductance = vehicle.heat_loss_kw_per_k(route.speed_kmh)
    mean_conductance = mean(conductance)
    mean_flow = mean(conductance * route.ambient_c)
    ambient = np.where(
        mean_conductance > 0.0,
        mean_flow / np.where(mean_conductance > 0.0, mean_conductance, 1.0),
        mean(route.ambient_c),
    )
    energy_min = trip.vehicle.pack.energy_kwh(trip.soc_min(borders))
    energy_min[-1] = max(energy_min[-1], float(trip.vehicle.pack.energy_kwh(trip.end_soc_min)))
    return Drive(
        node_km=borders,
        duration_h=duration,
        base_kw=propulsion + vehicle.auxiliary_kw + mean(vehicle.cabin_cooling_kw(route.ambient_c)),
        propulsion_kw=propulsion,
        ripple_kw2=ripple,
        drivetrain_heat_kw=mean(route.drivetrain_heat_kw),
        ambient_c=ambient,
        heat_loss_kw_per_k=mean_conductance,
        cabin_heat_kw=mean(vehicle.cabin_heating_kw(route.ambient_c)),
        energy_min_kwh=energy_min,
    )


def _grid_limit(trip: Trip, charger: int) -> Table1:
    """Return the charger's power limit over internal energy: rating, curve and current."""
    spec, pack = trip.chargers[charger], trip.vehicle.pack
    soc = pack.ocv_v.x
    if spec.curve_kw is not None:
        inside = spec.curve_kw.x[(spec.curve_kw.x > soc[0]) & (spec.curve_kw.x < soc[-1])]
        soc = np.union1d(soc, inside)
    limit = np.full(soc.size, spec.power_kw)
    if spec.current_a is not None:
        limit = np.minimum(limit, spec.current_a * pack.ocv_v(soc) / 1000.0)
    if spec.curve_kw is not None:
        limit = np.minimum(limit, spec.curve_kw(np.clip(soc, spec.curve_kw.lo, spec.curve_kw.hi)))
    return Table1(pack.energy_kwh(soc), limit, f"grid limit of {spec.name}")


def make_stop(trip: Trip, drive: Drive, charger: int) -> Stop:
    """Return one charger as a stop on the driving grid."""
    spec, vehicle = trip.chargers[charger], trip.vehicle
    least = float(vehicle.pack.energy_kwh(trip.soc_min.at(spec.position_km)))
    return Stop(
        charger=charger,
        node=int(np.argmin(np.abs(drive.node_km - spec.position_km))),
        detour_in_kwh=spec.detour_in_kwh,
        detour_out_kwh=spec.detour_out_kwh,
        grid_limit_kw=_grid_limit(trip, charger),
        price_per_kwh=spec.price_per_kwh,
        time_price_per_h=trip.time_value_per_h,
        occupancy_free_h=spec.occupancy_free_h,
        occupancy_price_per_h=spec.occupancy_price_per_h,
        fixed_cost=trip.time_value_per_h * spec.detour_h + spec.stop_penalty,
        detour_h=spec.detour_h,
        max_dwell_h=spec.max_dwell_h,
        base_kw=vehicle.auxiliary_kw + vehicle.cabin_cooling_kw.at(spec.ambient_c),
        cabin_heat_kw=vehicle.cabin_heating_kw.at(spec.ambient_c),
        ambient_c=spec.ambient_c,
        heat_loss_kw_per_k=vehicle.heat_loss_kw_per_k.at(0.0),
        arrive_min_kwh=least,
        leave_min_kwh=least,
    )


def make_instance(
    trip: Trip,
    subset: tuple[int, ...],
    grid: Grid | None = None,
    drive: Drive | None = None,
    undecided: tuple[int, ...] = (),
) -> Instance:
    """Transcribe a trip for a fixed subset of chargers, or for all subsets between two.

    Parameters
    ----------
    trip : Trip
        The trip.
    subset : tuple of int
        Indices of the chargers to use, in any order.
    grid : Grid, optional
        Steps and cells; the trip's own by default.
    drive : Drive, optional
        Steps made before with the same grid: all subsets share them.
    undecided : tuple of int
        Further chargers that may be used or not: optional stops.

    Returns
    -------
    Instance
        Arrays for the programs.

    Raises
    ------
    ValueError
        A charger that the trip does not have, or one named twice.
    """
    every = (*subset, *undecided)
    if len(set(every)) < len(every) or not all(0 <= i < len(trip.chargers) for i in every):
        raise ValueError(
            f"chargers are 0 to {len(trip.chargers) - 1}, each once, not {subset} and {undecided}"
        )
    grid = grid or trip.grid
    drive = drive or make_drive(trip, grid.step_km)
    used = [make_stop(trip, drive, i) for i in subset]
    maybe = [replace(make_stop(trip, drive, i), optional=True) for i in undecided]
    stops = sorted([*used, *maybe], key=lambda s: (s.node, s.charger))
    pack = trip.vehicle.pack
    energy_min = drive.energy_min_kwh
    end_min = float(energy_min[-1])
    if stops and stops[-1].node == drive.n_steps:
        energy_min = energy_min.copy()
        energy_min[-1] = min(s.arrive_min_kwh for s in stops if s.node == drive.n_steps)
        if all(s.optional for s in stops if s.node == drive.n_steps):
            energy_min[-1] = min(float(energy_min[-1]), end_min)
        stops[-1] = replace(stops[-1], leave_min_kwh=end_min)
    return Instance(
        vehicle=trip.vehicle,
        drive=drive,
        stops=tuple(stops),
        cells=grid.cells,
        start_energy_kwh=float(pack.energy_kwh(trip.start_soc)),
        start_temperature_c=trip.start_temperature_c,
        energy_min_kwh=energy_min,
        end_energy_min_kwh=end_min,
        energy_max_kwh=float(pack.energy_kwh(trip.soc_max)),
        temperature_min_c=pack.temperature_min_c,
        temperature_max_c=pack.temperature_max_c,
        total_dwell_h=trip.stop_time_h - sum(s.detour_h for s in stops if not s.optional),
    )
