"""A mistake in a route's CSV is told with its line, column, value and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest
from input_errors import check, names
from trips import write_trip

from relax.errors import InputError
from relax.load import load_trip

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


@pytest.mark.parametrize(("road", "field", "value", "allowed"), ROADS, ids=names(ROADS))
def test_bad_route(tmp_path: Path, road: str, field: str, value: str, allowed: str) -> None:
    path = write_trip(tmp_path, road=road, charger=[])
    with pytest.raises(InputError) as caught:
        load_trip(path)
    check(str(caught.value), str(tmp_path / "road.csv"), field, value, allowed)
