"""A mistake in an override is told with its name as given, or with the field it has spoilt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from input_errors import check, names
from trips import write_trip

from relax.errors import InputError
from relax.load import load_trip

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
