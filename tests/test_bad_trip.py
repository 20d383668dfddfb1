"""A mistake in a trip's or a car's file is told with its file, field, value and what is allowed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from input_errors import check, names
from trips import write_trip

from relax.errors import InputError
from relax.load import load_trip

NAN, INF = math.nan, math.inf

CASES: list[tuple[dict[str, Any], str, str, str, str]] = [
    # changes, file, field, value, part of what is allowed
    # missing, unknown and mistyped keys
    ({"objective": None}, "trip.toml", "objective", "missing", "required"),
    ({"start.soc": None}, "trip.toml", "start.soc", "missing", "state of charge"),
    ({"currency": None}, "trip.toml", "currency", "missing", "required"),
    ({"strat": {"soc": 1.0}}, "trip.toml", "strat", "{'soc': 1.0}", "did you mean 'start'?"),
    (
        {"start": None, "startt": {"soc": 1.0}},
        "trip.toml",
        "startt",
        "{'soc': 1.0}",
        "did you mean 'start'? one of charger, ",
    ),
    (
        {"charger.2.power_kw": None, "charger.2.powr_kw": 50},
        "trip.toml",
        "charger.2.powr_kw ('Cheap')",
        "50",
        "did you mean 'power_kw'?",
    ),
    (
        {"car.mass_kg": None, "car.mas_kg": 1800},
        "car.toml",
        "mas_kg",
        "1800",
        "did you mean 'mass_kg'?",
    ),
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
    ({"grid.step_km": 0}, "trip.toml", "grid.step_km", "0", "or equal to 0.05"),
    ({"grid.step_km": 0.001}, "trip.toml", "grid.step_km", "0.001", "or equal to 0.05"),
    ({"grid.step_km": NAN}, "trip.toml", "grid.step_km", "nan", "a finite number"),
    (
        {"charger.2.name": "drive"},
        "trip.toml",
        "charger.2.name ('drive')",
        "'drive'",
        "another name than",
    ),
    ({"name": "a\x1b[31m"}, "trip.toml", "name", "'a\\x1b[31m'", "without control characters"),
    # other units: J/K, t, mAh, W, mohm
    (
        {"car.heat_capacity_kwh_per_k": 375_000},
        "car.toml",
        "heat_capacity_kwh_per_k",
        "375000",
        "less than or equal to 10",
    ),
    ({"car.mass_kg": 2.1}, "car.toml", "mass_kg", "2.1", "greater than or equal to 100"),
    ({"car.capacity_ah": 2e5}, "car.toml", "capacity_ah", "200000.0", "or equal to 10000"),
    (
        {"charger.2.power_kw": 150_000},
        "trip.toml",
        "charger.2.power_kw ('Cheap')",
        "150000",
        "or equal to 10000",
    ),
    ({"car.resistance_ohm": 80}, "car.toml", "resistance_ohm", "80.0", "at most 10 ohm"),
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
        "ocv_v.2",
        "[100.0, 400.0]",
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


@pytest.mark.parametrize(("changes", "file", "field", "value", "allowed"), CASES, ids=names(CASES))
def test_bad_trip(
    tmp_path: Path, changes: dict[str, Any], file: str, field: str, value: str, allowed: str
) -> None:
    path = write_trip(tmp_path, **changes)
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(tmp_path / file), field, value, allowed)


def test_an_unknown_key_counts_what_is_missing_as_another_problem(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"start": None, "startt": {"soc": 1.0}})
    with pytest.raises(InputError, match=r"startt: .*\(and 1 more problem\)$"):
        load_trip(path)
