"""Owns the small trip that tests plan: 120 km in winter, two chargers, once as values and as files.

``small_trip()`` builds the values by hand; ``write_trip(folder)`` writes the same trip as a
TOML file beside its vehicle and route. Both take changes, so a test states only what it varies.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from relax.maps import Table1, Table2
from relax.propulsion import Profile, make_route
from relax.trip import Charger, Grid, Trip
from relax.vehicle import Pack, RoadLoad, Vehicle

__all__ = ["CAR", "ROAD", "TRIP", "small_trip", "to_toml", "write_trip"]

CAR: dict[str, Any] = {
    "name": "small car",
    "source": "made up for tests",
    "capacity_ah": 160.0,
    "ocv_v": [[0.0, 330.0], [0.5, 365.0], [1.0, 410.0]],
    "resistance_ohm": [[-40.0, 0.40], [-10.0, 0.22], [10.0, 0.13], [60.0, 0.07]],
    "charge_limit": {
        "curve_kw": [[0.0, 90.0], [0.2, 120.0], [0.5, 115.0], [0.8, 60.0], [1.0, 8.0]],
        "temperature_factor": [[-40.0, 0.04], [-10.0, 0.25], [10.0, 0.7], [25.0, 1.0], [60.0, 1.0]],
    },
    "discharge_limit": {
        "soc": [0.0, 0.1, 1.0],
        "temperature_c": [-40.0, 0.0, 60.0],
        "power_kw": [[30.0, 60.0, 80.0], [60.0, 120.0, 180.0], [80.0, 180.0, 250.0]],
    },
    "heat_capacity_kwh_per_k": 0.09,
    "temperature_min_c": -30.0,
    "temperature_max_c": 40.0,
    "heat_loss_kw_per_k": [[0.0, 0.010], [130.0, 0.045]],
    "heater_kw": 6.0,
    "heater_battery_efficiency": 0.9,
    "heater_cabin_efficiency": 1.0,
    "cooling_kw": 2.0,
    "cooling_cop": 1.5,
    "heat_pump_kw": 1.0,
    "heat_pump_cop": [[-40.0, 1.4], [0.0, 2.4], [60.0, 4.0]],
    "heat_pump_droop_per_kw": 0.05,
    "cabin_heating_kw": [[-30.0, 5.5], [0.0, 2.5], [20.0, 0.0], [40.0, 0.0]],
    "cabin_cooling_kw": [[-30.0, 0.0], [20.0, 0.0], [40.0, 2.0]],
    "auxiliary_kw": 0.5,
    "mass_kg": 2000.0,
    "road_load_a_n": 150.0,
    "road_load_b_n_per_kmh": 1.0,
    "road_load_c_n_per_kmh2": 0.03,
    "drive_efficiency": 0.9,
    "regen_efficiency": 0.85,
    "regen_max_kw": 80.0,
    "propulsion_factor": 1.0,
    "drivetrain_heat_share": 0.5,
}

ROAD: list[tuple[float, float, float]] = [  # distance_km, speed_kmh, elevation_m; the last an end
    (0.0, 60.0, 20.0),
    (10.0, 90.0, 40.0),
    (20.0, 105.0, 60.0),
    (35.0, 110.0, 140.0),
    (50.0, 95.0, 190.0),
    (60.0, 105.0, 160.0),
    (75.0, 110.0, 90.0),
    (90.0, 100.0, 120.0),
    (105.0, 85.0, 70.0),
    (114.0, 50.0, 30.0),
    (120.0, 50.0, 25.0),
]

TRIP: dict[str, Any] = {
    "name": "small trip",
    "currency": "EUR",
    "vehicle": {"file": "car.toml"},
    "route": {"file": "road.csv", "ambient_c": -5.0},
    "charger": [
        {
            "name": "Fast",
            "position_km": 45.0,
            "power_kw": 150.0,
            "price_per_kwh": 0.60,
            "detour_min": 4.0,
            "detour_kwh": 0.4,
        },
        {
            "name": "Cheap",
            "position_km": 85.0,
            "power_kw": 50.0,
            "price_per_kwh": 0.40,
            "detour_min": [3.0, 5.0],
            "detour_kwh": [0.2, 0.3],
            "occupancy_free_min": 30.0,
            "occupancy_price_per_min": 0.1,
            "stop_penalty": 0.5,
            "max_dwell_min": 90.0,
        },
    ],
    "objective": {"time_value_per_h": 10.0},
    "start": {"soc": 0.50},
    "end": {"soc_min": 0.20},
    "limits": {"soc_min": 0.05, "soc_max": 0.95},
}


def small_trip(**changes: Any) -> Trip:
    """Build the trip of ``TRIP``, ``CAR`` and ``ROAD`` without reading a file.

    ``changes`` replace fields of the Trip; those of its vehicle, pack, route or grid are named
    with the part in front, e.g. ``small_trip(start_soc=0.3, vehicle__heat_pump_kw=0.0)``.
    ``ambient_c`` changes the ambient temperature everywhere, the battery's at the start included.
    """
    ambient_c = changes.pop("ambient_c", TRIP["route"]["ambient_c"])
    charge, discharge = CAR["charge_limit"], CAR["discharge_limit"]
    curve, factor = np.array(charge["curve_kw"]), np.array(charge["temperature_factor"])
    pack = Pack(
        capacity_ah=CAR["capacity_ah"],
        ocv_v=_table("ocv_v"),
        resistance_ohm=_table("resistance_ohm"),
        charge_limit_soc_kw=Table2(
            curve[:, 0], factor[:, 0], np.outer(curve[:, 1], factor[:, 1]), "charge_limit"
        ),
        discharge_limit_soc_kw=Table2(
            discharge["soc"], discharge["temperature_c"], discharge["power_kw"], "discharge_limit"
        ),
        heat_capacity_kwh_per_k=CAR["heat_capacity_kwh_per_k"],
        temperature_min_c=CAR["temperature_min_c"],
        temperature_max_c=CAR["temperature_max_c"],
    )
    road_load = RoadLoad(
        mass_kg=CAR["mass_kg"],
        a_n=CAR["road_load_a_n"],
        b_n_per_kmh=CAR["road_load_b_n_per_kmh"],
        c_n_per_kmh2=CAR["road_load_c_n_per_kmh2"],
        drive_efficiency=CAR["drive_efficiency"],
        regen_efficiency=CAR["regen_efficiency"],
        regen_max_kw=CAR["regen_max_kw"],
        factor=CAR["propulsion_factor"],
        heat_share=CAR["drivetrain_heat_share"],
    )
    vehicle = Vehicle(
        name=CAR["name"],
        pack=_replaced(pack, "pack", changes),
        road_load=road_load,
        heat_loss_kw_per_k=_table("heat_loss_kw_per_k"),
        heater_kw=CAR["heater_kw"],
        heater_battery_efficiency=CAR["heater_battery_efficiency"],
        heater_cabin_efficiency=CAR["heater_cabin_efficiency"],
        cooling_kw=CAR["cooling_kw"],
        cooling_cop=CAR["cooling_cop"],
        cooling_from_c=25.0,
        heat_pump_kw=CAR["heat_pump_kw"],
        heat_pump_cop=_table("heat_pump_cop"),
        heat_pump_droop_per_kw=CAR["heat_pump_droop_per_kw"],
        cabin_heating_kw=_table("cabin_heating_kw"),
        cabin_cooling_kw=_table("cabin_cooling_kw"),
        auxiliary_kw=CAR["auxiliary_kw"],
    )
    road = np.array(ROAD)
    node_km = road[:, 0]
    grade = np.diff(road[:, 2]) / (1000.0 * np.diff(node_km))
    profile = Profile(
        "road", node_km, road[:-1, 1], grade, ambient_c=np.full(grade.size, float(ambient_c))
    )
    trip = Trip(
        name=TRIP["name"],
        currency=TRIP["currency"],
        vehicle=_replaced(vehicle, "vehicle", changes),
        route=_replaced(make_route(profile, road_load), "route", changes),
        chargers=_chargers(float(ambient_c)),
        time_value_per_h=TRIP["objective"]["time_value_per_h"],
        start_soc=TRIP["start"]["soc"],
        start_temperature_c=float(ambient_c),
        end_soc_min=TRIP["end"]["soc_min"],
        soc_min=Table1.constant(TRIP["limits"]["soc_min"], 0.0, float(node_km[-1]), "soc_min"),
        soc_max=TRIP["limits"]["soc_max"],
        grid=_replaced(Grid(), "grid", changes),
    )
    return dataclasses.replace(trip, **changes)


def _table(name: str) -> Table1:
    x, f = zip(*CAR[name], strict=True)
    return Table1(x, f, name)


def _chargers(ambient_c: float) -> tuple[Charger, ...]:
    fast, cheap = TRIP["charger"]
    return (
        Charger(
            name=fast["name"],
            position_km=fast["position_km"],
            power_kw=fast["power_kw"],
            price_per_kwh=fast["price_per_kwh"],
            detour_in_h=2.0 / 60.0,
            detour_out_h=2.0 / 60.0,
            detour_in_kwh=0.2,
            detour_out_kwh=0.2,
            occupancy_free_h=0.0,
            occupancy_price_per_h=0.0,
            stop_penalty=0.0,
            max_dwell_h=4.0,
            current_a=None,
            curve_kw=None,
            ambient_c=ambient_c,
        ),
        Charger(
            name=cheap["name"],
            position_km=cheap["position_km"],
            power_kw=cheap["power_kw"],
            price_per_kwh=cheap["price_per_kwh"],
            detour_in_h=3.0 / 60.0,
            detour_out_h=5.0 / 60.0,
            detour_in_kwh=0.2,
            detour_out_kwh=0.3,
            occupancy_free_h=0.5,
            occupancy_price_per_h=6.0,
            stop_penalty=0.5,
            max_dwell_h=1.5,
            current_a=None,
            curve_kw=None,
            ambient_c=ambient_c,
        ),
    )


def _replaced(part: Any, name: str, changes: dict[str, Any]) -> Any:
    """Apply the changes ``name__field`` to one part, taking them out of ``changes``."""
    mine = [key for key in changes if key.startswith(f"{name}__")]
    return dataclasses.replace(part, **{k.split("__", 1)[1]: changes.pop(k) for k in mine})


def write_trip(folder: Path, **changes: Any) -> Path:
    """Write the trip into ``folder`` (trip.toml, car.toml, road.csv) and return the trip's path.

    Keys of ``changes`` are dotted names, given as ``**{"start.soc": 0.8}``; chargers count from 1:
    ``charger.2.power_kw``. ``car.NAME`` changes the vehicle file. ``None`` removes a key.
    ``road`` is the route: rows as in ``ROAD``, or the text of the CSV.
    """
    trip, car = copy.deepcopy(TRIP), copy.deepcopy(CAR)
    road = changes.pop("road", ROAD)
    for key, value in changes.items():
        node: Any = trip
        parts = key.split(".")
        if parts[0] == "car":
            node, parts = car, parts[1:]
        for part in parts[:-1]:
            node = node[int(part) - 1] if isinstance(node, list) else node.setdefault(part, {})
        if value is None:
            del node[parts[-1]]
        else:
            node[parts[-1]] = value
    if not isinstance(road, str):
        rows = [",".join(str(cell) for cell in row) for row in road]
        road = "\n".join(["distance_km,speed_kmh,elevation_m", *rows, ""])
    (folder / "road.csv").write_text(road, encoding="utf-8")
    (folder / "car.toml").write_text(to_toml(car), encoding="utf-8")
    path = folder / "trip.toml"
    path.write_text(to_toml(trip), encoding="utf-8")
    return path


def to_toml(document: dict[str, Any]) -> str:
    """Return a document as TOML: one line per top-level key, everything below inline."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in document.items())


def _key(key: str) -> str:
    plain = key.replace("_", "").replace("-", "")
    return key if plain.isascii() and plain.isalnum() else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # the escapes of TOML are those of JSON
    return repr(value)
