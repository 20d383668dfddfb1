"""Every bad input is one InputError on one line: file, field, value and what is allowed."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trips import CAR, ROAD, TRIP, to_toml, write_trip

from relax.errors import InputError
from relax.load import load_trip, load_vehicle

NAN, INF = math.nan, math.inf

CASES: list[tuple[dict[str, Any], str, str, str, str]] = [
    # changes, file, field, value, part of what is allowed
    # missing, unknown and mistyped keys
    ({"objective": None}, "trip.toml", "objective", "missing", "required"),
    ({"start.soc": None}, "trip.toml", "start.soc", "missing", "state of charge"),
    ({"currency": None}, "trip.toml", "currency", "missing", "required"),
    ({"strat": {"soc": 1.0}}, "trip.toml", "strat", "{'soc': 1.0}", "did you mean 'start'?"),
    ({"start.sok": 0.5}, "trip.toml", "start.sok", "0.5", "one of battery_temperature_c, soc"),
    ({"a\nb": 1}, "trip.toml", r"'a\nb'", "1", "one of charger, currency"),
    ({"start.soc": "0.5"}, "trip.toml", "start.soc", "'0.5'", "a number"),
    ({"start.soc": True}, "trip.toml", "start.soc", "True", "a number"),
    ({"name": ""}, "trip.toml", "name", "''", "not empty"),
    ({"format": 2}, "trip.toml", "format", "2", "1"),
    ({"route": 3}, "trip.toml", "route", "3", "a table"),
    ({"charger": {"name": "x"}}, "trip.toml", "charger", "{'name': 'x'}", "a list"),
    ({"grid.cells": 3.5}, "trip.toml", "grid.cells", "3.5", "a whole number"),
    ({"grid.cells": 1}, "trip.toml", "grid.cells", "1", "2 to 200"),
    ({"grid.step_km": 0}, "trip.toml", "grid.step_km", "0", "greater than 0"),
    # states of charge
    ({"start.soc": 90}, "trip.toml", "start.soc", "90", "less than or equal to 1"),
    ({"start.soc": NAN}, "trip.toml", "start.soc", "nan", "a finite number"),
    (
        {"start.soc": 0.01},
        "trip.toml",
        "start.soc",
        "0.01",
        "at least limits.soc_min at km 0, 0.05",
    ),
    ({"end.soc_min": -0.1}, "trip.toml", "end.soc_min", "-0.1", "greater than or equal to 0"),
    ({"end.soc_min": 0.96}, "trip.toml", "end.soc_min", "0.96", "at most limits.soc_max, 0.95"),
    ({"limits.soc_max": 0.05}, "trip.toml", "limits.soc_max", "0.05", "more than limits.soc_min"),
    ({"limits.soc_min": []}, "trip.toml", "limits.soc_min", "[]", "a number or points [km, soc]"),
    (
        {"limits.soc_min": [[50, 0.1], [50, 0.2]]},
        "trip.toml",
        "limits.soc_min.2",
        "[50.0, 0.2]",
        "position more than in the point before, 50 km",
    ),
    # temperatures
    (
        {"start.battery_temperature_c": 41},
        "trip.toml",
        "start.battery_temperature_c",
        "41.0",
        "-30 to 40 degrees C",
    ),
    (
        {"route.ambient_c": -40, "car.cabin_heating_kw": 1.0, "car.cabin_cooling_kw": 0.0},
        "trip.toml",
        "start.battery_temperature_c",
        "-40.0",
        "the ambient temperature at km 0 when left out",
    ),
    (
        {"limits.temperature_max_c": 50},
        "trip.toml",
        "limits.temperature_max_c",
        "50",
        "within the vehicle's limits, -30 to 40",
    ),
    (
        {"limits.temperature_max_c": 5, "limits.temperature_min_c": 5},
        "trip.toml",
        "limits.temperature_max_c",
        "5",
        "more than the least, 5",
    ),
    (
        {"limits.temperature_min_c": 40},
        "trip.toml",
        "limits.temperature_min_c",
        "40",
        "less than 40",
    ),
    # objective
    (
        {"objective.time_value_per_h": -1},
        "trip.toml",
        "objective.time_value_per_h",
        "-1",
        "or equal",
    ),
    (
        {"objective.time_value_per_h": INF},
        "trip.toml",
        "objective.time_value_per_h",
        "inf",
        "finite",
    ),
    # chargers
    (
        {"charger.2.power_kw": 0},
        "trip.toml",
        "charger.2.power_kw ('Cheap')",
        "0",
        "greater than 0",
    ),
    (
        {"charger.1.price_per_kwh": None},
        "trip.toml",
        "charger.1.price_per_kwh ('Fast')",
        "missing",
        "currency per kWh",
    ),
    ({"charger.1.name": None}, "trip.toml", "charger.1.name", "missing", "unique name"),
    (
        {"charger.2.name": "Fast"},
        "trip.toml",
        "charger.2.name ('Fast')",
        "'Fast'",
        "charger.1 has it",
    ),
    (
        {"charger.2.position_km": 120.1},
        "trip.toml",
        "charger.2.position_km ('Cheap')",
        "120.1",
        "0 to the trip's length, 120 km",
    ),
    (
        {"charger.1.position_km": -1},
        "trip.toml",
        "charger.1.position_km ('Fast')",
        "-1",
        "greater than or equal to 0",
    ),
    (
        {"charger.1.detour_min": "5"},
        "trip.toml",
        "charger.1.detour_min ('Fast')",
        "'5'",
        "a number, half in and half out, or a pair",
    ),
    (
        {"charger.2.detour_min": [3.0, -5.0]},
        "trip.toml",
        "charger.2.detour_min.2 ('Cheap')",
        "-5.0",
        "greater than or equal to 0",
    ),
    (
        {"charger.2.detour_kwh": [0.1, 0.1, 0.1]},
        "trip.toml",
        "charger.2.detour_kwh ('Cheap')",
        "[0.1, 0.1, 0.1]",
        "or a pair [in, out]",
    ),
    (
        {"charger.1.max_dwell_min": 0.0},
        "trip.toml",
        "charger.1.max_dwell_min ('Fast')",
        "0.0",
        "greater than 0",
    ),
    (
        {"charger.1.current_a": INF},
        "trip.toml",
        "charger.1.current_a ('Fast')",
        "inf",
        "a finite number",
    ),
    (
        {"charger.1.curve": [[0.0, 100.0]]},
        "trip.toml",
        "charger.1.curve ('Fast')",
        "[[0.0, 100.0]]",
        "at least 2 entries",
    ),
    (
        {"charger.1.curve": [[0.0, 100.0], [0.9, 50.0]]},
        "trip.toml",
        "charger.1.curve ('Fast')",
        "'SoC 0 to 0.9'",
        "covers SoC 0.05 to 0.95",
    ),
    (
        {"charger.1.curve": [[0.0, 100.0], [1.0, -1.0]]},
        "trip.toml",
        "charger.1.curve.2 ('Fast')",
        "[1.0, -1.0]",
        "values at least 0",
    ),
    (
        {"charger.1.curve": [[0.0, 100.0], [0.0, 50.0]]},
        "trip.toml",
        "charger.1.curve.2 ('Fast')",
        "[0.0, 50.0]",
        "SoC more than in the point before, 0",
    ),
    # vehicle
    ({"vehicle": {}}, "trip.toml", "vehicle.preset", "missing", "preset or file"),
    ({"vehicle.file": "gone.toml"}, "trip.toml", "vehicle.file", "'gone.toml'", "that exists"),
    ({"vehicle.file": 3}, "trip.toml", "vehicle.file", "3", "a string"),
    (
        {"vehicle": {"preset": "papr-2022"}},
        "trip.toml",
        "vehicle.preset",
        "'papr-2022'",
        "did you mean 'paper-2022'?",
    ),
    (
        {"vehicle.preset": "paper-2022"},
        "trip.toml",
        "vehicle.file",
        "'car.toml'",
        "either preset ('paper-2022') or file",
    ),
    (
        {"vehicle.heat_pump": 3},
        "trip.toml",
        "vehicle.heat_pump",
        "3",
        "did you mean 'heat_pump_kw'?",
    ),
    ({"vehicle.heater_kw": -6}, "trip.toml", "vehicle.heater_kw", "-6", "or equal to 0"),
    ({"vehicle.heater_kw": 2}, "trip.toml", "vehicle.heater_kw", "2.0", "heater alone must"),
    ({"car.heater_kw": 2}, "car.toml", "heater_kw", "2.0", "cabin's heating demand of 3 kW at -5"),
    (
        {"car.heater_cabin_efficiency": 0.4},
        "car.toml",
        "heater_kw",
        "6.0",
        "at least 7.5 kW: the heater alone",
    ),
    ({"car.capacity_ah": None}, "car.toml", "capacity_ah", "missing", "Ah"),
    ({"car.drive_efficiency": 1.1}, "car.toml", "drive_efficiency", "1.1", "or equal to 1"),
    ({"car.ocv_v": [[0.0, 330.0], [0.5]]}, "car.toml", "ocv_v.2", "[0.5]", "a full pair"),
    ({"car.ocv_v": [[0.0, 330.0], [1.0, NAN]]}, "car.toml", "ocv_v.2.2", "nan", "finite"),
    ({"car.ocv_v": [[0.0, 0.0], [1.0, 400]]}, "car.toml", "ocv_v.1", "[0.0, 0.0]", "more than 0"),
    ({"car.ocv_v": 0}, "car.toml", "ocv_v", "0.0", "more than 0"),
    (
        {"car.ocv_v": [[0.0, 330.0], [100.0, 400.0]]},
        "car.toml",
        "ocv_v",
        "'SoC 0 to 100'",
        "SoC from 0 to 1",
    ),
    (
        {"car.ocv_v": [[0.1, 330.0], [1.0, 400.0]]},
        "car.toml",
        "ocv_v",
        "'SoC 0.1 to 1'",
        "covers SoC 0.05 to 0.95",
    ),
    (
        {"car.ocv_v": [[0.0, 330.0], [0.97, 400.0]], "start.soc": 0.98},
        "car.toml",
        "ocv_v",
        "'SoC 0 to 0.97'",
        "covers SoC 0.05 to 0.98",
    ),
    (
        {"vehicle.resistance_ohm": [[-20, 0.2], [40, 0.1]]},
        "trip.toml",
        "vehicle.resistance_ohm",
        "'battery temperature -20 to 40 degrees C'",
        "covers battery temperature -30 to 40 degrees C",
    ),
    (
        {"car.resistance_ohm": [[-40, 0.2], [40, -0.1]]},
        "car.toml",
        "resistance_ohm.2",
        "[40.0, -0.1]",
        "values at least 0",
    ),
    (
        {"car.temperature_min_c": 50, "car.temperature_max_c": 40},
        "car.toml",
        "temperature_max_c",
        "40.0",
        "more than temperature_min_c, 50",
    ),
    ({"car.heat_pump_cop": None}, "car.toml", "heat_pump_cop", "missing", "required when"),
    ({"car.heat_pump_cop": 0.9}, "car.toml", "heat_pump_cop", "0.9", "at least 1"),
    (
        {"vehicle.heat_pump_droop_per_kw": 0.6},
        "trip.toml",
        "vehicle.heat_pump_droop_per_kw",
        "0.6",
        "at most 0.5 with heat_pump_kw 1",
    ),
    (
        {"car.charge_limit": 100},
        "car.toml",
        "charge_limit",
        "100",
        "{curve_kw, temperature_factor}",
    ),
    (
        {"car.charge_limit.soc": [0, 1]},
        "car.toml",
        "charge_limit.soc",
        "[0, 1]",
        "one of curve_kw, temperature_factor",
    ),
    (
        {"car.charge_limit.temperature_factor": [[-40, 0.1], [60, -1]]},
        "car.toml",
        "charge_limit.temperature_factor.2",
        "[60.0, -1.0]",
        "values at least 0",
    ),
    (
        {"car.discharge_limit.power_kw": [[1, 2, 3], [1, 2]]},
        "car.toml",
        "discharge_limit.power_kw",
        "'2 rows of [2, 3] numbers'",
        "3 rows (soc) of 3 numbers",
    ),
    (
        {"car.discharge_limit.soc": [0.0, 0.5, 0.5]},
        "car.toml",
        "discharge_limit.soc",
        "[0.0, 0.5, 0.5]",
        "strictly increasing",
    ),
    (
        {"car.discharge_limit.temperature_c": [-20, 0, 60]},
        "car.toml",
        "discharge_limit",
        "'battery temperature -20 to 60 degrees C'",
        "covers battery temperature -30 to 40",
    ),
    (
        {"car.heat_loss_kw_per_k": [[0, 0.01], [100, 0.04]]},
        "car.toml",
        "heat_loss_kw_per_k",
        "'speed 0 to 100 km/h'",
        "covers speed 0 to 110 km/h",
    ),
    (
        {"car.heat_loss_kw_per_k": [[10, 0.01], [130, 0.04]]},
        "car.toml",
        "heat_loss_kw_per_k",
        "'speed 10 to 130 km/h'",
        "parked",
    ),
    (
        {"car.cabin_heating_kw": [[0, 2], [20, 0]]},
        "car.toml",
        "cabin_heating_kw",
        "'ambient temperature 0 to 20 degrees C'",
        "covers ambient temperature -5 to -5",
    ),
    # route
    ({"route.ambient_c": None}, "trip.toml", "route.ambient_c", "missing", "column ambient_c"),
    ({"route.ambient_c": "cold"}, "trip.toml", "route.ambient_c", "'cold'", "number or points"),
    ({"route.ambient_c": 263}, "trip.toml", "route.ambient_c", "263", "-60 to 100"),
    (
        {"route.ambient_c": [[0, -5], [9, 200]]},
        "trip.toml",
        "route.ambient_c.2.2",
        "200",
        "less than or equal to 100",
    ),
    ({"route.end_km": 130}, "trip.toml", "route.end_km", "130.0", "file's length, 120 km"),
    ({"route.start_km": 120}, "trip.toml", "route.start_km", "120.0", "less than the end, 120 km"),
    ({"route.sample_km": 0}, "trip.toml", "route.sample_km", "0", "greater than 0"),
    ({"route.sample_km": 1e-9}, "trip.toml", "route.sample_km", "1e-09", "at least 0.0012 km"),
    ({"route.file": "gone.csv"}, "trip.toml", "route.file", "'gone.csv'", "that exists"),
    ({"route.file": None}, "trip.toml", "route.preset", "missing", "preset or file"),
]

HEAD = "distance_km,speed_kmh"

ROADS: list[tuple[str, str, str, str]] = [
    # CSV, field, value, part of what is allowed
    ("", "header", "missing", "distance_km"),
    ("# only a comment\n", "header", "missing", "distance_km"),
    (f"{HEAD}\n0,50\n", "rows", "1", "at least 2 rows"),
    ("distance_km,speed\n0,50\n9,\n", "header", "'speed'", "did you mean 'speed_kmh'?"),
    (f"{HEAD},speed_kmh\n0,50,50\n9,,\n", "header", "'speed_kmh'", "each column once"),
    (f"{HEAD},grade,elevation_m\n0,50,0,0\n9,,,0\n", "header", "'grade'", "not both"),
    ("distance_km\n0\n9\n", "header speed_kmh", "missing", "columns distance_km and speed_kmh"),
    (f"{HEAD}\n0,50\n9,fast\n12,\n", "line 3 speed_kmh", "'fast'", "a number, 0 to 300"),
    (f"{HEAD}\n0,50\n9,\n12,\n", "line 3 speed_kmh", "missing", "a number, 0 to 300"),
    (f"{HEAD}\n0,0\n9,\n", "line 2 speed_kmh", "0.0", "leave standstill out"),
    (f"{HEAD}\n0,nan\n9,\n", "line 2 speed_kmh", "nan", "a number, 0 to 300"),
    (f"{HEAD}\n0,50\ninf,\n", "line 3 distance_km", "inf", "a number, 0 to 20000"),
    (f"{HEAD}\n1,50\n9,\n", "line 2 distance_km", "1.0", "0 at first"),
    (
        f"#\n{HEAD}\n0,50\n9,50\n\n9,50\n",
        "line 6 distance_km",
        "9.0",
        "more than the row before, 9",
    ),
    (f"{HEAD}\n0,50,3\n9,\n", "line 2", "'0,50,3'", "2 cells"),
    (f"{HEAD}\n0\n9,50\n", "line 2", "'0'", "2 cells"),
    (f"{HEAD},grade\n0,50,3\n9,,\n", "line 2 grade", "3.0", "-0.4 to 0.4"),
    (
        f"{HEAD},elevation_m\n0,50,0\n1,50,900\n2,50,0\n",
        "line 2 elevation_m",
        "0.0",
        "a grade from",
    ),
    (f"{HEAD},elevation_m\n0,50,0\n9,50,\n", "line 3 elevation_m", "missing", "-500 to 9000"),
    (
        f"{HEAD},drivetrain_heat_kw\n0,50,-1\n9,,\n",
        "line 2 drivetrain_heat_kw",
        "-1.0",
        "0 to 1000",
    ),
]

OVERRIDES: list[tuple[dict[str, Any], str, str, str]] = [
    # overrides, field, value, part of what is allowed
    ({"rout.ambient_c": 3}, "rout.ambient_c", "3", "did you mean 'route'?"),
    ({"route.ambient": 3}, "route.ambient", "3", "did you mean 'route.ambient_c'?"),
    (
        {"vehicle.heatpump_kw": 3},
        "vehicle.heatpump_kw",
        "3",
        "did you mean 'vehicle.heat_pump_kw'?",
    ),
    (
        {"charger.Fats.power_kw": 3},
        "charger.Fats.power_kw",
        "3",
        "charger.Cheap.power_kw, charger.F",
    ),
    ({"charger.3.power_kw": 3}, "charger.3.power_kw", "3", "one of charger.Cheap.power_kw"),
    (
        {"charger.Fast.powr_kw": 3},
        "charger.Fast.powr_kw",
        "3",
        "did you mean 'charger.Fast.power_kw'",
    ),
    ({"charger.Fast.power_kw": -3}, "charger.1.power_kw ('Fast')", "-3", "greater than 0"),
    ({"start.soc": "full"}, "start.soc", "'full'", "a number"),
    ({"name.first": "x"}, "name.first", "'x'", "name"),
    ({"vehicle.heater_kw": 1}, "vehicle.heater_kw", "1.0", "heater alone must"),
    ({"vehicle.preset": "none"}, "vehicle.preset", "'none'", "one of"),
    ({"route.file": "gone.csv"}, "route.file", "gone.csv", "that exists"),
]


def names(cases: list[Any]) -> list[str]:
    return [f"{k}-{case[-3]}" for k, case in enumerate(cases)]


def check(message: str, source: str, field: str, value: str, allowed: str) -> None:
    assert "\n" not in message
    head, separator, tail = message.partition("; allowed: ")
    assert separator
    assert head.startswith(f"{source}: {field}: ")
    assert value in head.removeprefix(f"{source}: {field}: ")
    assert allowed in tail


@pytest.mark.parametrize(("changes", "file", "field", "value", "allowed"), CASES, ids=names(CASES))
def test_bad_trip(
    tmp_path: Path, changes: dict[str, Any], file: str, field: str, value: str, allowed: str
) -> None:
    path = write_trip(tmp_path, **changes)
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(tmp_path / file), field, value, allowed)


@pytest.mark.parametrize(("road", "field", "value", "allowed"), ROADS, ids=names(ROADS))
def test_bad_route(tmp_path: Path, road: str, field: str, value: str, allowed: str) -> None:
    path = write_trip(tmp_path, road=road, charger=[])
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(tmp_path / "road.csv"), field, value, allowed)


@pytest.mark.parametrize(
    ("overrides", "field", "value", "allowed"), OVERRIDES, ids=names(OVERRIDES)
)
def test_bad_override(
    tmp_path: Path, overrides: dict[str, Any], field: str, value: str, allowed: str
) -> None:
    path = write_trip(tmp_path)
    with pytest.raises(InputError) as caught:
        load_trip(path, overrides)
    check(str(caught.value), "override", field, value, allowed)


def test_toml_syntax_names_file_line_and_text(tmp_path: Path) -> None:
    path = write_trip(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "soc = = 3", *lines[2:]]))
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(path), "line 3", "'soc = = 3'", "valid TOML")


def test_toml_that_ends_too_early_names_the_last_line(tmp_path: Path) -> None:
    path = tmp_path / "trip.toml"
    path.write_text('name = "a"\ncharger = [')
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(path), "line 2", "'charger = ['", "valid TOML")


@pytest.mark.parametrize("file", ["trip.toml", "car.toml", "road.csv"])
def test_text_that_is_not_utf8(tmp_path: Path, file: str) -> None:
    path = write_trip(tmp_path)
    (tmp_path / file).write_bytes(b"# \xff\n")
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(tmp_path / file), "byte 2", r"b'\xff'", "UTF-8")


@pytest.mark.parametrize(
    ("load", "name", "kind", "allowed"),
    [
        (load_trip, "paper-400", "trip", "did you mean 'paper-400km'?"),
        (load_trip, "gone/trip.toml", "trip", "one of"),
        (load_trip, Path("paper-400km"), "trip", "a .toml file that exists"),
        (load_vehicle, "papr-2022", "vehicle", "did you mean 'paper-2022'?"),
    ],
)
def test_missing_file_names_what_is_shipped(load: Any, name: Any, kind: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        load(name)
    check(str(caught.value), str(name), kind, str(name), allowed)


def test_empty_name_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^'': trip: '';"):
        load_trip("")
    with pytest.raises(InputError, match=r"a \.toml file that exists"):
        load_trip(tmp_path)


def test_first_problem_is_told_and_the_others_counted(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"start.soc": 3, "end.soc_min": "x", "charger.1.power_kw": -1})
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(
        str(caught.value), str(path), "charger.1.power_kw ('Fast')", "-1", "(and 2 more problems)"
    )


def test_error_carries_its_parts(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_trip(write_trip(tmp_path, **{"car.mass_kg": -5.0}))
    error = caught.value
    assert (error.source, error.field, error.value) == (str(tmp_path / "car.toml"), "mass_kg", -5.0)
    assert "greater than 0" in error.allowed


def test_nan_anywhere_is_refused(tmp_path: Path) -> None:
    numbers = [
        f"{section}.{key}"
        for section in ("objective", "start", "end", "limits")
        for key in TRIP[section]
    ] + [f"charger.2.{key}" for key, value in TRIP["charger"][1].items() if value != "Cheap"]
    for name in numbers:
        for value in (NAN, INF, -INF):
            with pytest.raises(InputError):
                load_trip(write_trip(tmp_path, **{name: value}))
    for row in range(len(ROAD)):
        road = [list(r) for r in ROAD]
        road[row][0] = NAN
        with pytest.raises(InputError, match=f"line {row + 2} distance_km"):
            load_trip(write_trip(tmp_path, road=road))


def leaves(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in pairs:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))


PLACES = [(file, path) for file, base in (("trip", TRIP), ("car", CAR)) for path in leaves(base)]
WRECKS: list[Any] = [
    *("", "a\nb", 0, -1, 1, 2.5, 1e308, -1e308, 1e-308, 10**400, NAN, INF, -INF, True),
    *([], {}, [[]], [[0]], [[0, 1], [1, 2]], {"x": 1}, [1, 2], [{"name": "q"}]),
]


@given(st.sampled_from(PLACES), st.sampled_from(WRECKS), st.sampled_from(PLACES))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_any_wreck_loads_or_is_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, place: Any, wreck: Any, gone: Any
) -> None:
    """Whatever stands in a place, and with another place missing: one line, never a traceback."""
    documents = {"trip": copy.deepcopy(TRIP), "car": copy.deepcopy(CAR)}
    for file, path in (place, gone):
        node: Any = documents[file]
        for part in path[:-1]:
            node = node[part] if not isinstance(node, list) or part < len(node) else {}
            if not isinstance(node, dict | list):
                return
        if (file, path) == place:
            node[path[-1]] = wreck
        elif isinstance(node, dict) and path[-1] in node:
            del node[path[-1]]
    folder = tmp_path_factory.mktemp("wreck")
    file_path = write_trip(folder)
    file_path.write_text(to_toml(documents["trip"]), encoding="utf-8")
    (folder / "car.toml").write_text(to_toml(documents["car"]), encoding="utf-8")
    try:
        trip = load_trip(file_path)
    except InputError as error:
        assert "\n" not in str(error)
        assert "; allowed: " in str(error)
    else:
        assert np.isfinite(trip.route.propulsion_kw).all()
