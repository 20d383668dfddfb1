"""Owns the trip as values: route, chargers, objective, limits. Validated on load, frozen after.

Knows nothing of files (``load`` makes these) and nothing of any grid (``instance`` cuts it).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
import numpy.typing as npt

from relax.maps import Table1
from relax.vehicle import Vehicle

__all__ = ["DRIVE", "Charger", "Grid", "Route", "Trip"]

Array = npt.NDArray[np.float64]


DRIVE = "drive"
"""Name of the drive among the traces of a plan: no charger has it."""


@dataclass(frozen=True)
class Route:
    """Known profile of the road, constant within each sample.

    Parameters
    ----------
    name : str
        For reports.
    node_km : ndarray, shape (n + 1,)
        Sample borders, strictly increasing from 0 [km].
    speed_kmh : ndarray, shape (n,)
        Mean speed, > 0 [km/h].
    propulsion_kw : ndarray, shape (n,)
        Mean battery-side propulsion power; negative when recuperating [kW].
    drivetrain_heat_kw : ndarray, shape (n,)
        Drivetrain heat that reaches the battery [kW].
    ambient_c : ndarray, shape (n,)
        Ambient temperature [degrees C].
    """

    name: str
    node_km: Array
    speed_kmh: Array
    propulsion_kw: Array
    drivetrain_heat_kw: Array
    ambient_c: Array

    @property
    def length_km(self) -> float:
        """Length of the route [km]."""
        return float(self.node_km[-1])

    @cached_property
    def duration_h(self) -> Array:
        """Driving time of every sample [h], shape (n,)."""
        return np.diff(self.node_km) / self.speed_kmh

    @property
    def driving_h(self) -> float:
        """Total driving time [h]."""
        return float(self.duration_h.sum())


@dataclass(frozen=True)
class Charger:
    """A place to charge.

    Parameters
    ----------
    name : str
        Unique in the trip.
    position_km : float
        Where on the route [km].
    power_kw : float
        Rated grid power [kW].
    price_per_kwh : float
        Price of grid energy [currency/kWh].
    detour_in_h, detour_out_h : float
        Time lost on the way in and out of a used stop [h].
    detour_in_kwh, detour_out_kwh : float
        Energy lost on the way in and out of a used stop [kWh].
    occupancy_free_h : float
        Dwell without occupancy cost [h].
    occupancy_price_per_h : float
        Cost of dwell beyond it [currency/h].
    stop_penalty : float
        Fixed cost of using the charger [currency].
    max_dwell_h : float
        Longest dwell [h].
    current_a : float or None
        Limit of the charger's current: grid power <= current * U_oc [A].
    curve_kw : Table1 or None
        The charger's own limit over SoC [kW].
    ambient_c : float
        Ambient temperature at the stop [degrees C].
    """

    name: str
    position_km: float
    power_kw: float
    price_per_kwh: float
    detour_in_h: float
    detour_out_h: float
    detour_in_kwh: float
    detour_out_kwh: float
    occupancy_free_h: float
    occupancy_price_per_h: float
    stop_penalty: float
    max_dwell_h: float
    current_a: float | None
    curve_kw: Table1 | None
    ambient_c: float

    @property
    def detour_h(self) -> float:
        """Time a stop costs beside the dwell [h]."""
        return self.detour_in_h + self.detour_out_h


@dataclass(frozen=True)
class Grid:
    """How finely a trip is transcribed.

    Parameters
    ----------
    step_km : float
        Longest driving step [km].
    cells : int
        Cells of equal internal energy per charging stop.

    Raises
    ------
    ValueError
        The step is not above 0, or there is no cell.
    """

    step_km: float = 4.0
    cells: int = 12

    def __post_init__(self) -> None:
        """Check that a trip can be cut so."""
        if not (0.0 < self.step_km < inf and self.cells == int(self.cells) >= 1):
            raise ValueError(
                "a grid has steps above 0 km and 1 cell or more, "
                f"not {self.step_km} and {self.cells}"
            )


@dataclass(frozen=True)
class Trip:
    """Everything that defines one planning problem.

    Parameters
    ----------
    name, currency : str
        For reports.
    vehicle : Vehicle
        The car.
    route : Route
        The road.
    chargers : tuple of Charger
        In the order of the file.
    time_value_per_h : float
        Cost of charging and detour time [currency/h].
    start_soc, start_temperature_c : float
        State at departure.
    end_soc_min : float
        Least SoC at the destination.
    soc_min : Table1
        Least SoC on the way over position [km].
    soc_max : float
        Largest SoC after charging.
    grid : Grid
        Default transcription.
    stop_time_h : float
        Most charging and detour time of the whole trip [h]; ``inf``: no limit.
    """

    name: str
    currency: str
    vehicle: Vehicle
    route: Route
    chargers: tuple[Charger, ...]
    time_value_per_h: float
    start_soc: float
    start_temperature_c: float
    end_soc_min: float
    soc_min: Table1
    soc_max: float
    grid: Grid
    stop_time_h: float = inf
