"""Owns random trips: realistic, varied, each determined by its seed. Knows nothing of planning.

    python -m benchmarks.random_trips SEED ...

prints what a seed stands for. Every shipped car, as it is or perturbed, with either cell
chemistry, with and without heat pump, droop and cooling; -25 to 40 C, also varying along the way;
flat, rolling and alpine roads with recuperation; 1 to 5 chargers of all kinds, also at one place,
at the start and at the destination; coarse grids, so that thousands can be planned.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from relax.load import load_vehicle, shipped_vehicles
from relax.maps import Table1, Table2
from relax.propulsion import Profile, make_route, propulsion_kw, wheel_force_n
from relax.trip import Charger, Grid, Route, Trip
from relax.vehicle import Pack, RoadLoad, Vehicle

__all__ = ["describe", "random_trip"]

Array = npt.NDArray[np.float64]
Random = np.random.Generator

STREAM = 20240
"""Mixed with every seed; another number makes another family of trips."""
LONGEST_KM = 450.0
"""Length of the road that a trip is cut from [km]."""
SHORTEST_KM = 15.0
"""Least length of a trip [km]."""
LFP = ((0.0, 0.78), (0.05, 0.94), (0.1, 0.97), (0.3, 1.0), (0.7, 1.008), (0.95, 1.02), (1.0, 1.07))
"""Shape of the flat open-circuit voltage of an iron phosphate cell: (SoC, share of nominal)."""
ROADS = ("flat", "rolling", "alpine", "pass")
"""Kinds of road."""


def random_trip(seed: int) -> Trip:
    """Return the trip of a seed.

    Parameters
    ----------
    seed : int
        At least 0. The same seed gives the same trip.

    Returns
    -------
    Trip
        Valid: every map covers what the trip needs. It need not be feasible.

    Examples
    --------
    >>> trip = random_trip(7)
    >>> trip.name, 1 <= len(trip.chargers) <= 5
    ('random-7', True)
    >>> describe(trip) == describe(random_trip(7)) != describe(random_trip(8))
    True
    """
    rng = np.random.default_rng([STREAM, seed])
    ambient = _ambient(rng)
    vehicle = _vehicle(rng, ambient)
    limits = _limits(rng, vehicle.pack)
    route, reach = _route(rng, vehicle, ambient, limits)
    length = route.length_km
    soc_min = Table1.constant(limits["soc_min"], 0.0, length, "soc_min")
    if rng.random() < 0.2:  # a reserve that depends on the place
        more = limits["soc_min"] + rng.uniform(0.0, 0.1, 3)
        more[0] = limits["soc_min"]
        soc_min = Table1([0.0, 0.5 * length, length], np.minimum(more, 0.7), "soc_min")
    scale = float(rng.choice([1.0, 10.0], p=[0.7, 0.3]))
    time_value = 0.0 if rng.random() < 0.2 else float(np.exp(rng.uniform(0.0, np.log(500.0))))
    pack = vehicle.pack
    start_c = ambient.at(0.0) + (float(rng.uniform(0.0, 25.0)) if rng.random() < 0.3 else 0.0)
    trip = Trip(
        name=f"random-{seed}",
        currency="EUR" if scale == 1.0 else "SEK",
        vehicle=vehicle,
        route=route,
        chargers=_chargers(rng, length, reach, ambient, scale),
        time_value_per_h=time_value,
        start_soc=limits["start"],
        start_temperature_c=float(
            np.clip(start_c, pack.temperature_min_c + 1.0, pack.temperature_max_c - 1.0)
        ),
        end_soc_min=limits["end"],
        soc_min=soc_min,
        soc_max=limits["soc_max"],
        grid=Grid(length / float(rng.integers(6, 40)), int(rng.choice([2, 3, 4, 6, 8, 12]))),
    )
    if rng.random() < 0.12:
        trip = replace(trip, stop_time_h=float(rng.uniform(0.2, 2.0)))
    return trip


@cache
def _preset(name: str) -> Vehicle:
    return load_vehicle(name)


def _ambient(rng: Random) -> Table1:
    """Ambient temperature over position on the longest road."""
    here = float(rng.uniform(-25.0, 40.0))
    if rng.random() < 0.6:
        return Table1.constant(here, 0.0, LONGEST_KM, "ambient")
    values = np.clip(here + rng.uniform(-12.0, 12.0, 5), -25.0, 40.0)
    return Table1(np.linspace(0.0, LONGEST_KM, 5), values, "ambient")


def _vehicle(rng: Random, ambient: Table1) -> Vehicle:
    """Return a shipped car, mostly perturbed; its heater can always keep the cabin warm."""
    vehicle = _preset(str(rng.choice(shipped_vehicles())))
    pump = 0.0 if rng.random() < 0.3 else float(rng.choice([0.5, 1.0, 2.0, 3.0, 4.0]))
    vehicle = replace(vehicle, heat_pump_kw=pump)
    if rng.random() < 0.25:
        return vehicle

    def near(value: float, spread: float) -> float:
        return value * float(np.exp(rng.uniform(-spread, spread)))

    # small packs make short trips: as many decisions on fewer steps
    pack = _perturbed_pack(rng, vehicle.pack, float(np.exp(rng.uniform(np.log(0.25), 0.2))))
    demand = near(1.0, 0.4)
    cabin = Table1(
        vehicle.cabin_heating_kw.x, vehicle.cabin_heating_kw.f * demand, "cabin_heating_kw"
    )
    to_cabin = float(rng.choice([0.85, 1.0]))
    needed = 1.001 * float(cabin(ambient.f).max()) / to_cabin
    loss = vehicle.heat_loss_kw_per_k
    return replace(
        vehicle,
        pack=pack,
        heat_loss_kw_per_k=Table1(loss.x, loss.f * near(1.0, 0.7), "heat_loss_kw_per_k"),
        heater_kw=max(needed, near(vehicle.heater_kw, 0.6)),
        heater_battery_efficiency=float(rng.uniform(0.6, 1.0)),
        heater_cabin_efficiency=to_cabin,
        cooling_kw=0.0 if rng.random() < 0.35 else float(rng.uniform(0.5, 5.0)),
        cooling_cop=float(rng.uniform(0.8, 3.0)),
        cooling_from_c=float(rng.choice([10.0, 20.0, 25.0, 32.0])),
        heat_pump_droop_per_kw=float(rng.choice([0.0, 0.03, 0.055, 0.12])),
        heat_pump_cop=_perturbed_cop(rng, vehicle.heat_pump_cop),
        cabin_heating_kw=cabin,
        auxiliary_kw=float(rng.uniform(0.2, 1.2)),
    )


def _perturbed_cop(rng: Random, cop: Table1) -> Table1:
    if rng.random() < 0.1:  # an ideal one that does not feel the battery
        return Table1.constant(float(rng.uniform(1.2, 4.0)), cop.lo, cop.hi, "heat_pump_cop")
    return Table1(cop.x, 1.0 + (cop.f - 1.0) * rng.uniform(0.5, 1.3), "heat_pump_cop")


def _perturbed_pack(rng: Random, pack: Pack, size: float) -> Pack:
    """Return a pack of another size and chemistry, its maps scaled and bent."""
    ocv = pack.ocv_v
    if rng.random() < 0.35:
        soc, share = zip(*LFP, strict=True)
        ocv = Table1(soc, np.array(share) * float(rng.uniform(320.0, 420.0)), "ocv_v")
    elif rng.random() < 0.15:
        ocv = Table1.constant(float(rng.uniform(300.0, 750.0)), 0.0, 1.0, "ocv_v")
    resistance = pack.resistance_ohm
    if rng.random() < 0.1:
        level = float(rng.choice([0.0, 0.05, 0.2]))
        resistance = Table1.constant(level, resistance.lo, resistance.hi, "resistance_ohm")
    else:
        factor = (ocv.f.mean() / pack.ocv_v.f.mean()) ** 2 / size
        bend = np.exp(rng.normal(0.0, 0.15, resistance.x.size) * (rng.random() < 0.3))
        value = resistance.f * factor * np.exp(rng.uniform(-0.7, 0.5)) * bend
        resistance = Table1(resistance.x, value, "resistance_ohm")
    charge, discharge = pack.charge_limit_soc_kw, pack.discharge_limit_soc_kw
    rough = np.exp(rng.normal(0.0, 0.25, charge.f.shape) * (rng.random() < 0.3))
    faster = size * np.exp(rng.uniform(-0.6, 0.5))
    stronger = np.exp(rng.uniform(-0.2, 0.4)) * max(size, 0.6)
    top = pack.temperature_max_c - float(rng.choice([0.0, 0.0, 3.0, 8.0]))
    return replace(
        pack,
        capacity_ah=pack.capacity_ah * size * float(pack.ocv_v.f.mean() / ocv.f.mean()),
        ocv_v=ocv,
        resistance_ohm=resistance,
        charge_limit_soc_kw=Table2(charge.x, charge.y, charge.f * faster * rough, "charge_limit"),
        discharge_limit_soc_kw=Table2(
            discharge.x, discharge.y, discharge.f * stronger, "discharge_limit"
        ),
        heat_capacity_kwh_per_k=pack.heat_capacity_kwh_per_k
        * size
        * float(np.exp(rng.uniform(-0.5, 0.5))),
        temperature_max_c=top,
    )


def _limits(rng: Random, pack: Pack) -> dict[str, float]:
    """Return SoC at the start, at the end and its limits, within the pack's maps."""
    maps = (pack.ocv_v, pack.charge_limit_soc_kw, pack.discharge_limit_soc_kw)
    lo = max(float(m.x[0]) for m in maps)
    hi = min(float(m.x[-1]) for m in maps)
    soc_min = max(lo, float(rng.choice([0.0, 0.05, 0.1], p=[0.15, 0.5, 0.35])))
    soc_max = min(hi, float(rng.choice([0.8, 0.9, 1.0])))
    start = min(hi, max(soc_min + 0.02, float(rng.uniform(0.25, 1.0))))
    end = float(rng.uniform(soc_min, 0.25 if rng.random() < 0.7 else 0.75))
    return {"soc_min": soc_min, "soc_max": soc_max, "start": start, "end": min(end, soc_max)}


def _profile(rng: Random) -> Profile:
    """Return the longest road: speeds of town, country and motorway; slopes of one kind."""
    kind = str(rng.choice(ROADS))
    node = np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 9.0, 300))])
    node = np.append(node[node < LONGEST_KM - 1.0], LONGEST_KM)
    n = node.size - 1
    pace = float(rng.choice([70.0, 95.0, 115.0]))
    speed = np.clip(pace * rng.uniform(0.6, 1.15, n), 25.0, 140.0)
    speed[rng.random(n) < 0.1] = float(rng.uniform(30.0, 50.0))
    grade = np.zeros(n)
    if kind == "rolling":
        grade = rng.uniform(-0.03, 0.03, n)
    elif kind == "alpine":
        grade = np.repeat(rng.uniform(-0.06, 0.06, n // 3 + 1), 3)[:n]
    elif kind == "pass":  # up and down once every 80 km or so
        phase = 2.0 * np.pi * node[:-1] / float(rng.uniform(50.0, 110.0)) + rng.uniform(0.0, 6.3)
        grade = 0.045 * np.sign(np.sin(phase)) * rng.uniform(0.6, 1.0, n)
    return Profile(kind, node, speed, grade)


def _route(
    rng: Random, vehicle: Vehicle, ambient: Table1, limits: dict[str, float]
) -> tuple[Route, float]:
    """Return a road some charging is needed for, and how far the first charge gets [km]."""
    profile, load = _profile(rng), vehicle.road_load
    node, speed = profile.node_km, profile.speed_kmh
    outside = 0.5 * (ambient(node[1:]) + ambient(node[:-1]))
    power = propulsion_kw(load, wheel_force_n(load, node, speed, profile.grade), speed)
    power = power + vehicle.auxiliary_kw + vehicle.cabin_cooling_kw(outside)
    power += vehicle.cabin_heating_kw(outside) / vehicle.heater_cabin_efficiency
    used = np.concatenate([[0.0], np.cumsum(1.05 * power * np.diff(node) / speed)])
    pack = vehicle.pack
    full = float(pack.energy_kwh(limits["soc_max"]) - pack.energy_kwh(limits["soc_min"]))
    first = float(pack.energy_kwh(limits["start"]) - pack.energy_kwh(limits["soc_min"]))
    spare = float(pack.energy_kwh(limits["start"]) - pack.energy_kwh(limits["end"]))

    def position(energy: float) -> float:
        beyond = np.flatnonzero(used > energy)
        return float(node[beyond[0]]) if beyond.size else LONGEST_KM

    target = max(spare + full * float(rng.uniform(-0.05, 0.85)), 0.1 * full)
    cut = profile.cut(0.0, max(position(target), SHORTEST_KM))
    row = profile.row_at(cut.node_km[:-1])
    route = make_route(replace(cut, ambient_c=outside[row]), _braking(rng, load))
    return route, min(position(first), cut.node_km[-1])


def _braking(rng: Random, load: RoadLoad) -> RoadLoad:
    """Return the road load, at times without recuperation or with more drivetrain heat."""
    if rng.random() < 0.1:
        load = replace(load, regen_max_kw=0.0)
    if rng.random() < 0.3:
        load = replace(load, heat_share=float(rng.uniform(0.0, 1.0)))
    return load


def _chargers(
    rng: Random, length: float, reach: float, ambient: Table1, scale: float
) -> tuple[Charger, ...]:
    """Return chargers, mostly one of them within reach; some share a place or lie at an end."""
    count = int(rng.choice([1, 2, 3, 4, 5], p=[0.2, 0.3, 0.3, 0.12, 0.08]))
    chargers: list[Charger] = []
    level = float(rng.uniform(0.15, 0.9)) * scale
    for i in range(count):
        where = float(rng.uniform(0.0, length))
        if i == 0 and rng.random() < 0.85:
            where = float(rng.uniform(0.3, 0.95)) * reach
        draw = float(rng.random())
        if draw < 0.04:
            where = 0.0
        elif draw < 0.10:
            where = length
        elif draw < 0.20 and chargers:
            where = chargers[-1].position_km
        elif draw < 0.30 and chargers:
            where = min(chargers[-1].position_km + float(rng.uniform(0.2, 1.0)), length)
        chargers.append(_charger(rng, f"charger {i}", where, ambient, level, scale))
    return tuple(rng.permutation(np.array(chargers, dtype=object)))


def _charger(
    rng: Random, name: str, where: float, ambient: Table1, level: float, scale: float
) -> Charger:
    power = float(rng.choice([11.0, 22.0, 50.0, 100.0, 150.0, 250.0, 350.0]))
    curve = None
    if rng.random() < 0.25:
        share = np.minimum(1.0, rng.uniform(0.3, 1.3, 4))
        curve = Table1([0.0, 0.3, 0.7, 1.0], power * share, "curve")
    price = level * float(rng.uniform(0.6, 1.6))
    odd = rng.random()
    price = 0.0 if odd < 0.05 else (-0.2 * price if odd < 0.07 else price)
    nearby = rng.random() < 0.2  # right at the road: no detour
    minutes = np.zeros(2) if nearby else rng.uniform(0.0, 5.0, 2)
    paid = rng.random() < 0.3
    slow = 12.0 if power < 40.0 else 4.0
    extra: dict[str, Any] = {
        "occupancy_free_h": float(rng.choice([0.0, 0.1, 0.33, 1.0])) if paid else 0.0,
        "occupancy_price_per_h": float(rng.uniform(1.0, 40.0)) * scale if paid else 0.0,
        "stop_penalty": float(rng.choice([0.5, 2.0, 5.0])) * scale if rng.random() < 0.3 else 0.0,
        "max_dwell_h": float(rng.uniform(0.15, 1.5)) if rng.random() < 0.2 else slow,
        "current_a": float(rng.choice([32.0, 125.0, 200.0, 400.0])) if rng.random() < 0.3 else None,
    }
    return Charger(
        name=name,
        position_km=where,
        power_kw=power,
        price_per_kwh=price,
        detour_in_h=float(minutes[0]) / 60.0,
        detour_out_h=float(minutes[1]) / 60.0,
        detour_in_kwh=0.08 * float(minutes[0]),
        detour_out_kwh=0.08 * float(minutes[1]),
        curve_kw=curve,
        ambient_c=ambient.at(where),
        **extra,
    )


def describe(trip: Trip) -> str:
    """Return a trip in one line.

    Examples
    --------
    >>> describe(random_trip(7)).startswith("random-7: ")
    True
    """
    car, outside = trip.vehicle, trip.route.ambient_c
    return (
        f"{trip.name}: {car.name}, {trip.route.name} {trip.route.length_km:.0f} km, "
        f"{outside.min():.0f} to {outside.max():.0f} C, heat pump {car.heat_pump_kw:g} kW, "
        f"cooling {car.cooling_kw:.1f} kW, {len(trip.chargers)} chargers, "
        f"SoC {trip.start_soc:.2f} to {trip.end_soc_min:.2f}, "
        f"time {trip.time_value_per_h:.0f} {trip.currency}/h, "
        f"steps of {trip.grid.step_km:.1f} km, {trip.grid.cells} cells"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Describe the trips of some seeds; returns the exit code."""
    for text in sys.argv[1:] if arguments is None else arguments:
        print(describe(random_trip(int(text))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
