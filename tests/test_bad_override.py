"""A mistake in an override is told with its name as given, or with the field it has spoilt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from input_errors import check, names
from trips import write_trip

from relax.errors import InputError
from relax.load import check_keys, load_trip

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


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("vehicle.heatpump", "vehicle.heat_pump_kw"),
        ("charger.Fast.powr", "charger.Fast.power_kw"),
        ("charger.Fats.power_kw", "charger.Fast.power_kw"),
        ("start.sok", "start.soc"),
    ],
)
def test_what_was_meant_comes_first_and_the_list_is_short(
    tmp_path: Path, key: str, meant: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_trip(write_trip(tmp_path), {key: 3})
    allowed = caught.value.allowed
    assert allowed.startswith(f"did you mean {meant!r}? one of ") and len(str(caught.value)) < 250
    assert meant in allowed.partition("? ")[2]


def test_of_many_names_without_a_likely_one_few_are_listed(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"allowed: one of .* or 29 others$") as caught:
        load_trip(write_trip(tmp_path), {"vehicle.qqq": 3})
    assert caught.value.allowed.count("vehicle.") == 5
    with pytest.raises(InputError, match=r"one of charger, .*, vehicle$"):  # of few, all
        load_trip(write_trip(tmp_path), {"qqq": 3})


def test_keys_are_checked_without_their_values(tmp_path: Path) -> None:
    path = write_trip(tmp_path)
    check_keys(path, {"route.ambient_c": "no number", "vehicle.mass_kg": -1})
    with pytest.raises(InputError, match=r"override: route\.ambient: 3; "):
        check_keys(path, {"route.ambient_c": 0, "route.ambient": 3})
