"""Owns the way from a checked trip document to a :class:`~relax.trip.Trip`.

The only place where minutes become hours and where fields are checked against
each other. Knows nothing of how documents are found or read.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import numpy.typing as npt

from relax.document import Origin
from relax.maps import Table1
from relax.propulsion import Profile, make_route
from relax.schema import TripFile, VehicleFile
from relax.trip import DRIVE, Charger, Grid, Trip
from relax.vehicle import Vehicle
from relax.vehicle_file import (
    AMBIENT_C,
    LEAST_STEP,
    SOC,
    SPEED,
    check_covers,
    make_points_table,
    make_vehicle,
)

__all__ = ["make_trip"]

Array = npt.NDArray[np.float64]

MINUTES_PER_H = 60.0

MOST_SAMPLES = 100_000
"""Largest number of route samples: a smaller ``sample_km`` is a slip."""

POSITION_TOLERANCE_KM = 1e-6
"""A position this far beyond the end of the route [km] is rounding: it is moved there."""


def make_trip(
    spec: TripFile, origin: Origin, car: VehicleFile, car_origin: Origin, profile: Profile
) -> Trip:
    """Return the trip of checked documents.

    Parameters
    ----------
    spec, car : TripFile, VehicleFile
        The documents.
    origin, car_origin : Origin
        Where they came from, for errors.
    profile : Profile
        The road, cut.

    Returns
    -------
    Trip

    Raises
    ------
    InputError
        Fields contradict each other or a map does not cover what the trip needs.

    Examples
    --------
    >>> from relax.load import load_trip, shipped_trips
    >>> [load_trip(name).route.length_km > 0 for name in shipped_trips()[:1]]
    [True]
    """
    labels = {f"charger.{k}": c.name for k, c in enumerate(spec.charger, start=1)}
    origin = replace(origin, labels=labels)
    temperature_c = _temperature_limits(spec, origin, car)
    vehicle = make_vehicle(car, car_origin, *temperature_c)
    ambient = _Ambient(spec, origin, profile)
    length = float(profile.node_km[-1])
    sample = spec.route.sample_km
    if sample is not None and length / sample > MOST_SAMPLES:
        raise origin.error("route.sample_km", sample, f"at least {length / MOST_SAMPLES:g} km")
    route = make_route(profile, vehicle.road_load, ambient.integral, sample)
    chargers = _chargers(spec, origin, length, ambient)
    soc_min = _soc_min(spec, origin, length)
    _check_soc(spec, origin, vehicle, car_origin, soc_min, chargers)
    outside = np.array([*route.ambient_c, *(c.ambient_c for c in chargers)])
    _check_climate(vehicle, car_origin, float(route.speed_kmh.max()), outside)
    return Trip(
        name=spec.name,
        currency=spec.currency,
        vehicle=vehicle,
        route=route,
        chargers=chargers,
        time_value_per_h=spec.objective.time_value_per_h,
        start_soc=spec.start.soc,
        start_temperature_c=_start_temperature(spec, origin, vehicle, ambient),
        end_soc_min=spec.end.soc_min,
        soc_min=soc_min,
        soc_max=spec.limits.soc_max,
        grid=Grid(spec.grid.step_km, spec.grid.cells),
        stop_time_h=inf if spec.limits.stop_time_h is None else spec.limits.stop_time_h,
    )


class _Ambient:
    """Ambient temperature along the trip: points of the trip, else the profile's column."""

    def __init__(self, spec: TripFile, origin: Origin, profile: Profile) -> None:
        given = spec.route.ambient_c
        length = float(profile.node_km[-1])
        self.column: Array | None = None
        self.profile = profile
        if given is None:
            if profile.ambient_c is None:
                allowed = "a number or points [km, degrees C], or a column ambient_c in the route"
                raise origin.error("route.ambient_c", None, allowed)
            self.column = profile.ambient_c
            self.table = Table1.constant(0.0, 0.0, length)
        else:
            self.table = _along(given, "route.ambient_c", origin, length)

    def at(self, position_km: float) -> float:
        """Temperature at a position [degrees C]."""
        if self.column is not None:
            return float(self.column[self.profile.row_at(position_km)])
        return self.table.at(position_km)

    def integral(self, position_km: Array) -> Array:
        """Integral from km 0 to positions [degrees C * km]; exact."""
        if self.column is not None:
            node = self.profile.node_km
            total = np.concatenate([[0.0], np.cumsum(self.column * np.diff(node))])
            steps: Array = np.interp(position_km, node, total)
            return steps
        node, value = self.table.x, self.table.f
        total = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(node))])
        i = np.clip(np.searchsorted(node, position_km, side="right") - 1, 0, node.size - 2)
        part: Array = 0.5 * (value[i] + self.table(position_km)) * (position_km - node[i])
        whole: Array = total[i] + part
        return whole


def _along(
    given: float | list[tuple[float, float]],
    name: str,
    origin: Origin,
    length_km: float,
) -> Table1:
    """Return a number or points over position as a table over the whole trip, ends held."""
    if isinstance(given, int | float):
        return Table1.constant(float(given), 0.0, length_km, name)
    for k in range(1, len(given)):
        if not given[k][0] - given[k - 1][0] > LEAST_STEP:
            allowed = f"position more than in the point before, {given[k - 1][0]:g} km"
            raise origin.error(f"{name}.{k + 1}", list(given[k]), allowed)
    km, value = (np.array(column, dtype=np.float64) for column in zip(*given, strict=True))
    node = np.union1d([0.0, length_km], km[km < length_km])
    return Table1(node, np.interp(node, km, value), name)


def _temperature_limits(spec: TripFile, origin: Origin, car: VehicleFile) -> tuple[float, float]:
    lo, hi = car.temperature_min_c, car.temperature_max_c
    limits = spec.limits
    for field in ("temperature_min_c", "temperature_max_c"):
        value = getattr(limits, field)
        if value is not None and not lo <= value <= hi:
            allowed = f"within the vehicle's limits, {lo:g} to {hi:g} degrees C"
            raise origin.error(f"limits.{field}", value, allowed)
    lo = lo if limits.temperature_min_c is None else limits.temperature_min_c
    hi = hi if limits.temperature_max_c is None else limits.temperature_max_c
    if limits.temperature_max_c is not None and not lo < hi:
        raise origin.error("limits.temperature_max_c", hi, f"more than the least, {lo:g} degrees C")
    if limits.temperature_min_c is not None and not lo < hi:
        raise origin.error("limits.temperature_min_c", lo, f"less than {hi:g} degrees C")
    return lo, hi


def _chargers(
    spec: TripFile, origin: Origin, length_km: float, ambient: _Ambient
) -> tuple[Charger, ...]:
    chargers: list[Charger] = []
    for k, c in enumerate(spec.charger, start=1):
        if c.name in (known := [other.name for other in chargers]):
            allowed = f"a name not used before (charger.{known.index(c.name) + 1} has it)"
            raise origin.error(f"charger.{k}.name", c.name, allowed)
        if c.name == DRIVE:
            allowed = f"another name than {DRIVE!r}, by which arrays of the drive are known"
            raise origin.error(f"charger.{k}.name", c.name, allowed)
        if c.position_km > length_km + POSITION_TOLERANCE_KM:
            allowed = f"0 to the trip's length, {length_km:g} km"
            raise origin.error(f"charger.{k}.position_km", c.position_km, allowed)
        position = min(c.position_km, length_km)
        curve = None
        if c.curve is not None:
            curve = make_points_table(c.curve, f"charger.{k}.curve", origin, SOC)
        minutes_in, minutes_out = _pair(c.detour_min)
        energy_in, energy_out = _pair(c.detour_kwh)
        chargers.append(
            Charger(
                name=c.name,
                position_km=position,
                power_kw=c.power_kw,
                price_per_kwh=c.price_per_kwh,
                detour_in_h=minutes_in / MINUTES_PER_H,
                detour_out_h=minutes_out / MINUTES_PER_H,
                detour_in_kwh=energy_in,
                detour_out_kwh=energy_out,
                occupancy_free_h=c.occupancy_free_min / MINUTES_PER_H,
                occupancy_price_per_h=c.occupancy_price_per_min * MINUTES_PER_H,
                stop_penalty=c.stop_penalty,
                max_dwell_h=c.max_dwell_min / MINUTES_PER_H,
                current_a=c.current_a,
                curve_kw=curve,
                ambient_c=ambient.at(position),
            )
        )
    return tuple(chargers)


def _pair(detour: float | tuple[float, float]) -> tuple[float, float]:
    """In and out; a number is split in halves."""
    return detour if isinstance(detour, tuple) else (0.5 * detour, 0.5 * detour)


def _soc_min(spec: TripFile, origin: Origin, length_km: float) -> Table1:
    table = _along(spec.limits.soc_min, "limits.soc_min", origin, length_km)
    if not table.f.max() < spec.limits.soc_max:
        allowed = f"more than limits.soc_min, {table.f.max():g}"
        raise origin.error("limits.soc_max", spec.limits.soc_max, allowed)
    return table


def _start_temperature(
    spec: TripFile, origin: Origin, vehicle: Vehicle, ambient: _Ambient
) -> float:
    given = spec.start.battery_temperature_c
    value = ambient.at(0.0) if given is None else given
    lo, hi = vehicle.pack.temperature_min_c, vehicle.pack.temperature_max_c
    if not lo <= value <= hi:
        why = " (the ambient temperature at km 0 when left out)" if given is None else ""
        allowed = f"within the battery's limits, {lo:g} to {hi:g} degrees C{why}"
        raise origin.error("start.battery_temperature_c", value, allowed)
    return value


def _check_soc(
    spec: TripFile,
    origin: Origin,
    vehicle: Vehicle,
    car_origin: Origin,
    soc_min: Table1,
    chargers: tuple[Charger, ...],
) -> None:
    """Raise unless states of charge agree and every map over SoC covers them."""
    if spec.start.soc < soc_min.f[0]:
        allowed = f"at least limits.soc_min at km 0, {soc_min.f[0]:g}"
        raise origin.error("start.soc", spec.start.soc, allowed)
    if spec.end.soc_min > spec.limits.soc_max:
        allowed = f"at most limits.soc_max, {spec.limits.soc_max:g}"
        raise origin.error("end.soc_min", spec.end.soc_min, allowed)
    lo, hi = float(soc_min.f.min()), max(spec.limits.soc_max, spec.start.soc)
    why = "limits.soc_min to limits.soc_max or start.soc"
    pack = vehicle.pack
    for map_ in (pack.ocv_v, pack.charge_limit_soc_kw, pack.discharge_limit_soc_kw):
        check_covers(map_, SOC, lo, hi, car_origin, why)
    for charger in chargers:
        if charger.curve_kw is not None:
            check_covers(charger.curve_kw, SOC, lo, hi, origin, why)


def _check_climate(vehicle: Vehicle, origin: Origin, speed_kmh: float, outside_c: Array) -> None:
    """Raise unless heat loss and cabin are defined, and the heater can keep the cabin warm."""
    why = "the trip's speeds"
    check_covers(vehicle.heat_loss_kw_per_k, SPEED, 0.0, speed_kmh, origin, why)
    lo, hi = float(outside_c.min()), float(outside_c.max())
    for map_ in (vehicle.cabin_heating_kw, vehicle.cabin_cooling_kw):
        check_covers(map_, AMBIENT_C, lo, hi, origin, "the trip's ambient temperatures")
    demand = vehicle.cabin_heating_kw(outside_c)
    worst = int(demand.argmax())
    if demand[worst] > vehicle.heater_kw * vehicle.heater_cabin_efficiency:
        least = demand[worst] / vehicle.heater_cabin_efficiency
        allowed = (
            f"at least {least:.4g} kW: the heater alone must be able to cover the cabin's "
            f"heating demand of {demand[worst]:.4g} kW at {outside_c[worst]:.4g} degrees C"
        )
        raise origin.error("heater_kw", vehicle.heater_kw, allowed)
