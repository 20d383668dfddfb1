"""Loading gives the values the files state; odd but legal inputs load; overrides act."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from trips import CAR, ROAD, TRIP, small_trip, to_toml, write_trip

from relax.document import with_overrides
from relax.load import (
    load_trip,
    load_vehicle,
    shipped_routes,
    shipped_trips,
    shipped_vehicles,
    trip_schema,
    vehicle_schema,
)
from relax.maps import Table1, Table2
from relax.schema import TripFile
from relax.trip import Trip
from relax.vehicle_file import LIMIT_TOLERANCE_KW


def assert_same(a: Any, b: Any, where: str = "trip") -> None:
    """Compare two values field by field; tables as functions, so extra nodes do not matter."""
    assert type(a) is type(b), where
    if isinstance(a, Table1):
        assert (a.lo, a.hi) == (b.lo, b.hi), where
        x = np.linspace(a.lo, a.hi, 101)
        np.testing.assert_allclose(a(x), b(x), rtol=1e-12, atol=1e-12, err_msg=where)
    elif isinstance(a, Table2):
        x, y = np.meshgrid(np.linspace(a.x[0], a.x[-1], 41), np.linspace(a.y[0], a.y[-1], 41))
        np.testing.assert_allclose(a(x, y), b(x, y), rtol=1e-12, atol=1e-12, err_msg=where)
    elif isinstance(a, np.ndarray):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=where)
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}.{k}")
    elif dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            if field.name != "name":
                assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-12), where
    else:
        assert a == b, where


def test_files_give_the_values_built_by_hand(tmp_path: Path) -> None:
    assert_same(load_trip(write_trip(tmp_path)), small_trip())


def test_same_by_string_and_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_trip(tmp_path)
    monkeypatch.chdir(tmp_path.parent)
    assert_same(load_trip(f"{tmp_path.name}/trip.toml"), small_trip())


def test_names_survive(tmp_path: Path) -> None:
    trip = load_trip(write_trip(tmp_path))
    assert (trip.name, trip.vehicle.name, trip.route.name) == ("small trip", "small car", "road")
    assert [charger.name for charger in trip.chargers] == ["Fast", "Cheap"]


ODD: list[dict[str, Any]] = [
    {"charger": []},
    {"charger": None},
    {"charger.1.position_km": 0},
    {"charger.1.position_km": 120},
    {"charger.2.position_km": 45.0},  # two at one place
    {"charger.1.position_km": 100.0},  # not in order along the road
    {"charger.1.detour_min": 0, "charger.1.detour_kwh": 0},
    {"charger.1.detour_min": [0, 5]},
    {"charger.1.price_per_kwh": 0},
    {"charger.1.price_per_kwh": -0.1},
    {"charger.1.name": 'Göteborg 2.0 – "Nord"'},
    {"charger.1.curve": [[0, 150], [1, 0]]},
    {"charger.1.current_a": 125},
    {"objective.time_value_per_h": 0},
    {"end.soc_min": 0},
    {"end.soc_min": 0.95},
    {"start.soc": 1},  # above limits.soc_max
    {"start.soc": 0.05},
    {"limits": None},
    {"limits.soc_min": 0},
    {"limits.soc_min": [[60, 0.2]]},
    {"limits.soc_min": [[0, 0.05], [60, 0.3], [500, 0.1]]},
    {"limits.temperature_max_c": 35, "limits.temperature_min_c": -20},
    {"car.resistance_ohm": 0},
    {"car.heat_pump_cop": None, "car.heat_pump_kw": 0},
    {"car.heat_pump_droop_per_kw": 5, "car.heat_pump_kw": 0},
    {"car.ocv_v": 360},
    {"car.heat_loss_kw_per_k": 0},
    {"car.cabin_heating_kw": 0, "car.cabin_cooling_kw": 0, "car.heater_kw": 0},
    {"car.charge_limit": {"curve_kw": [[0, 0], [1, 0]], "temperature_factor": [[-30, 1], [40, 1]]}},
    {"car.drivetrain_heat_share": 0, "car.regen_max_kw": 0, "car.road_load_b_n_per_kmh": -1.5},
    {"car.drive_efficiency": 1, "car.regen_efficiency": 1},
    {"car.heater_kw": 3},  # just enough for the cabin
    {"route.ambient_c": 0},
    {"route.ambient_c": [[60, -5]]},
    {"route.sample_km": 1000},
    {"route.sample_km": 0.7},
    {"route.start_km": 119.5},
    {"route.end_km": 0.001, "charger": []},
    {"road": "distance_km,speed_kmh\n0,50\n120,\n"},
    {"road": "\ufeff# BOM, CRLF, blank lines\r\nspeed_kmh , distance_km\r\n\r\n50,0\r\n,120\r\n"},
    {"road": "distance_km,speed_kmh,grade\n0,50,0.01\n120"},
    {"description": "x" * 10_000},
]


@pytest.mark.parametrize("changes", ODD, ids=[str(sorted(odd))[:60] for odd in ODD])
def test_odd_but_legal(tmp_path: Path, changes: dict[str, Any]) -> None:
    if "route.start_km" in changes:
        changes = changes | {"charger": []}
    trip = load_trip(write_trip(tmp_path, **changes))
    assert isinstance(trip, Trip)
    assert trip.route.node_km[0] == 0.0
    assert np.all(np.diff(trip.route.node_km) > 0.0)
    assert np.all(np.isfinite(trip.route.propulsion_kw))


def test_bom_and_crlf_in_toml(tmp_path: Path) -> None:
    path = write_trip(tmp_path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert load_trip(path).name == "small trip"


def test_chargers_keep_their_order(tmp_path: Path) -> None:
    trip = load_trip(write_trip(tmp_path, **{"charger.1.position_km": 100.0}))
    assert [charger.position_km for charger in trip.chargers] == [100.0, 85.0]


def test_units_of_a_charger(tmp_path: Path) -> None:
    fast, cheap = load_trip(write_trip(tmp_path)).chargers
    assert fast.detour_in_h == fast.detour_out_h == pytest.approx(2 / 60)
    assert (cheap.detour_in_kwh, cheap.detour_out_kwh) == (0.2, 0.3)
    assert cheap.detour_h == pytest.approx(8 / 60)
    assert cheap.occupancy_price_per_h == pytest.approx(6.0)
    assert (cheap.occupancy_free_h, cheap.max_dwell_h) == (0.5, 1.5)
    assert fast.max_dwell_h == 4.0


def test_position_a_rounding_beyond_the_end_is_the_end(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"charger.1.position_km": 120.0 + 1e-9})
    assert load_trip(path).chargers[0].position_km == 120.0


def test_battery_starts_at_ambient_of_km_0_unless_told(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"route.ambient_c": [[0, -12], [120, 0]]})
    assert load_trip(path).start_temperature_c == -12.0
    assert load_trip(path, {"start.battery_temperature_c": 20}).start_temperature_c == 20.0


def test_charger_ambient_is_that_of_the_road(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"route.ambient_c": [[0, -12], [90, -3], [100, 7]]})
    fast, cheap = load_trip(path).chargers
    assert fast.ambient_c == pytest.approx(-7.5)
    assert cheap.ambient_c == pytest.approx(-3.5)


def test_ambient_points_are_averaged_within_samples(tmp_path: Path) -> None:
    changes = {"route.ambient_c": [[0, 0], [120, 12]], "route.sample_km": 40}
    road = "distance_km,speed_kmh\n0,60\n120,\n"
    trip = load_trip(write_trip(tmp_path, road=road, **changes))
    assert trip.route.ambient_c == pytest.approx([2.0, 6.0, 10.0])


def test_cut_counts_positions_from_its_start(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"route.start_km": 15, "route.end_km": 105})
    trip = load_trip(path)
    assert trip.route.node_km[[0, 1, -1]].tolist() == [0.0, 5.0, 90.0]
    assert trip.route.speed_kmh[[0, 1, -1]].tolist() == [90.0, 105.0, 100.0]
    assert [charger.position_km for charger in trip.chargers] == [45.0, 85.0]


def test_overrides_leave_the_document_alone() -> None:
    document = {"start": {"soc": 0.5}, "charger": [{"name": "A", "power_kw": 50.0}]}
    before = json.dumps(document)
    changed, replaced = with_overrides(
        document, {"start.soc": 0.6, "charger.A.power_kw": 60.0}, TripFile
    )
    assert json.dumps(document) == before
    assert changed == {"start": {"soc": 0.6}, "charger": [{"name": "A", "power_kw": 60.0}]}
    assert set(replaced) == {"start.soc", "charger.1.power_kw"}


def test_ambient_column_and_its_override(tmp_path: Path) -> None:
    road = "distance_km,speed_kmh,ambient_c\n0,60,-8\n50,60,2\n120,,\n"
    path = write_trip(tmp_path, road=road, **{"route.ambient_c": None})
    trip = load_trip(path)
    assert trip.route.ambient_c.tolist() == [-8.0, 2.0]
    assert [charger.ambient_c for charger in trip.chargers] == [-8.0, 2.0]
    assert trip.start_temperature_c == -8.0
    assert load_trip(path, {"route.ambient_c": 5}).route.ambient_c.tolist() == [5.0, 5.0]


def test_soc_min_points_hold_beyond_their_ends(tmp_path: Path) -> None:
    soc_min = load_trip(write_trip(tmp_path, **{"limits.soc_min": [[40, 0.1], [60, 0.2]]})).soc_min
    assert (soc_min.lo, soc_min.hi) == (0.0, 120.0)
    assert [soc_min.at(km) for km in (0.0, 40.0, 50.0, 120.0)] == pytest.approx(
        [0.1, 0.1, 0.15, 0.2]
    )


def test_trip_limits_tighten_the_pack(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"limits.temperature_max_c": 35})
    assert load_trip(path).vehicle.pack.temperature_max_c == 35.0


def test_maps_need_only_cover_the_tightened_limits(tmp_path: Path) -> None:
    changes = {"car.resistance_ohm": [[-20, 0.2], [35, 0.1]]}
    limits = {"limits.temperature_min_c": -20, "limits.temperature_max_c": 35}
    assert load_trip(write_trip(tmp_path, **changes, **limits)).vehicle.pack.resistance_ohm.hi == 35


OVERRIDES: list[tuple[str, Any, Any]] = [
    ("route.ambient_c", -9.5, lambda t: t.route.ambient_c[3]),
    ("vehicle.heat_pump_kw", 3.0, lambda t: t.vehicle.heat_pump_kw),
    ("vehicle.mass_kg", 2500.0, lambda t: t.vehicle.road_load.mass_kg),
    ("objective.time_value_per_h", 40.0, lambda t: t.time_value_per_h),
    ("charger.Fast.power_kw", 51.0, lambda t: t.chargers[0].power_kw),
    ("charger.2.power_kw", 52.0, lambda t: t.chargers[1].power_kw),
    ("start.soc", 0.8, lambda t: t.start_soc),
    ("limits.soc_max", 0.9, lambda t: t.soc_max),
    ("grid.cells", 7, lambda t: t.grid.cells),  # a section the file does not have
    ("name", "other", lambda t: t.name),
]


@pytest.mark.parametrize(("key", "value", "read"), OVERRIDES, ids=[o[0] for o in OVERRIDES])
def test_override(tmp_path: Path, key: str, value: Any, read: Any) -> None:
    path = write_trip(tmp_path)
    before = path.read_text()
    assert read(load_trip(path)) != value
    assert read(load_trip(path, {key: value})) == value
    assert path.read_text() == before


def test_override_may_be_a_numpy_number(tmp_path: Path) -> None:
    overrides = {"start.soc": np.float64(0.7), "grid.cells": np.int64(5)}
    trip = load_trip(write_trip(tmp_path), overrides)
    assert (trip.start_soc, trip.grid.cells) == (0.7, 5)


def test_charger_name_with_dots_and_digits(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"charger.1.name": "E4.2 N", "charger.2.name": "1"})
    trip = load_trip(path, {"charger.E4.2 N.power_kw": 99.0, "charger.1.power_kw": 11.0})
    assert [charger.power_kw for charger in trip.chargers] == [99.0, 11.0]


def test_override_of_preset_replaces_file_and_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_trip(tmp_path)
    trip = load_trip(path, {"vehicle.preset": "paper-2022"})
    assert trip.vehicle.name == load_vehicle("paper-2022").name
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.toml").write_text(to_toml(CAR | {"name": "mine"}))
    monkeypatch.chdir(tmp_path / "here")
    assert load_trip(path, {"vehicle.file": "mine.toml"}).vehicle.name == "mine"
    assert load_trip("paper-400km", {"vehicle.file": "mine.toml"}).vehicle.name == "mine"


def test_load_vehicle_with_override(tmp_path: Path) -> None:
    write_trip(tmp_path)
    assert load_vehicle(tmp_path / "car.toml").heater_kw == 6.0
    assert load_vehicle(tmp_path / "car.toml", {"heater_kw": 7}).heater_kw == 7.0


def test_product_limit_is_the_product_between_energies(tmp_path: Path) -> None:
    pack = load_trip(write_trip(tmp_path)).vehicle.pack
    curve = np.array(CAR["charge_limit"]["curve_kw"])
    factor = np.array(CAR["charge_limit"]["temperature_factor"])
    soc, temperature = np.meshgrid(np.linspace(0, 1, 173), np.linspace(-40, 60, 89))
    exact = np.interp(soc, *curve.T) * np.interp(temperature, *factor.T)
    np.testing.assert_allclose(pack.charge_limit_soc_kw(soc, temperature), exact, atol=1e-10)
    worst = np.abs(pack.charge_limit_kw(pack.energy_kwh(soc), temperature) - exact).max()
    assert worst <= LIMIT_TOLERANCE_KW
    plain = Table2(curve[:, 0], factor[:, 0], np.outer(curve[:, 1], factor[:, 1]))
    coarse = Table2(pack.energy_kwh(plain.x), plain.y, plain.f)
    assert np.abs(coarse(pack.energy_kwh(soc), temperature) - exact).max() > LIMIT_TOLERANCE_KW


def test_limit_is_cut_to_the_voltage_map(tmp_path: Path) -> None:
    path = write_trip(tmp_path, **{"car.ocv_v": [[0.04, 330], [0.96, 400]]})
    pack = load_trip(path).vehicle.pack
    for table in (pack.charge_limit_soc_kw, pack.discharge_limit_soc_kw):
        assert (table.x[0], table.x[-1]) == (0.04, 0.96)
    curve = np.array(CAR["charge_limit"]["curve_kw"])
    assert pack.charge_limit_soc_kw.at(0.04, 25.0) == pytest.approx(np.interp(0.04, *curve.T))


def test_shipped_names_are_names() -> None:
    assert "paper-400km" in shipped_trips()
    assert "paper-2022" in shipped_vehicles()
    assert shipped_routes()
    for name in (*shipped_trips(), *shipped_vehicles(), *shipped_routes()):
        assert "." not in name


@pytest.mark.parametrize("name", shipped_trips())
def test_shipped_trip_loads(name: str) -> None:
    trip = load_trip(name)
    assert trip.route.driving_h > 0.0
    assert trip.name == name


@pytest.mark.parametrize("name", shipped_vehicles())
def test_shipped_vehicle_loads(name: str) -> None:
    assert load_vehicle(name).pack.energy_kwh(1.0) > 10.0


def shipped_documents() -> list[tuple[str, str]]:
    kinds = (("trips", shipped_trips()), ("vehicles", shipped_vehicles()))
    return [(kind, name) for kind, shipped in kinds for name in shipped]


@pytest.mark.parametrize(("kind", "name"), shipped_documents())
def test_shipped_file_obeys_the_json_schema(kind: str, name: str) -> None:
    schema = trip_schema() if kind == "trips" else vehicle_schema()
    text = (files("relax") / "data" / kind / f"{name}.toml").read_text(encoding="utf-8")
    jsonschema.Draft202012Validator(schema).validate(tomllib.loads(text))


def test_json_schema_is_one_and_refuses_what_loading_refuses() -> None:
    for schema in (trip_schema(), vehicle_schema()):
        jsonschema.Draft202012Validator.check_schema(schema)
        assert json.loads(json.dumps(schema)) == schema
    validator = jsonschema.Draft202012Validator(trip_schema())
    validator.validate(TRIP)
    both = TRIP | {"vehicle": {"file": "car.toml", "preset": "paper-2022"}}
    for wrong in (both, TRIP | {"strat": 1}, TRIP | {"vehicle": {"file": "a", "heatpump": 1}}):
        assert not validator.is_valid(wrong)


def modules_after(program: str) -> set[str]:
    program += "; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    command = [sys.executable, "-c", "import sys, types; " + program]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


def test_loading_needs_no_solver_and_no_plots() -> None:
    """Nothing that ``relax.load`` imports imports these, whatever the package itself offers."""
    bare = (
        "import importlib.util as u; "
        "package = types.ModuleType('relax'); "
        "package.__path__ = list(u.find_spec('relax').submodule_search_locations); "
        "sys.modules['relax'] = package; import relax.load"
    )
    loaded = modules_after(bare)
    assert {"numpy", "pydantic", "relax"} <= loaded
    assert not {"scipy", "cvxpy", "matplotlib", "pandas", "clarabel", "osqp"} & loaded


def test_importing_the_package_imports_no_cvxpy_and_no_plots() -> None:
    assert not {"cvxpy", "matplotlib", "pandas"} & modules_after("import relax.load")


def test_small_trip_takes_changes() -> None:
    trip = small_trip(start_soc=0.3, vehicle__heat_pump_kw=0.0, grid__cells=4, ambient_c=-10.0)
    assert (trip.start_soc, trip.vehicle.heat_pump_kw, trip.grid.cells) == (0.3, 0.0, 4)
    assert trip.start_temperature_c == trip.chargers[0].ambient_c == -10.0
    assert trip.route.length_km == ROAD[-1][0]


@pytest.mark.parametrize("ambient", [-30.0, 40.0])
def test_ambient_at_the_edge_of_a_table_is_covered(ambient: float) -> None:
    """A mean of equal temperatures misses them by rounding."""
    overrides = {"route.ambient_c": ambient, "start.battery_temperature_c": 20.0}
    points = [[-30.0, 4.0], [40.0, 0.0]]
    cabin = {"vehicle.cabin_heating_kw": points, "vehicle.cabin_cooling_kw": points}
    trip = load_trip("paper-400km", {**overrides, **cabin})
    assert trip.route.ambient_c == pytest.approx(np.full(trip.route.ambient_c.shape, ambient))
