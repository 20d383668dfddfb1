"""Whatever the input is, it loads or is one InputError on one line: no file, no text, any wreck.

The tables of single mistakes: test_bad_trip.py, test_bad_route.py, test_bad_override.py.
"""

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
from input_errors import check
from trips import CAR, ROAD, TRIP, to_toml, write_trip

from relax.errors import InputError
from relax.load import load_trip, load_vehicle

NAN, INF = math.nan, math.inf


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
    message = str(caught.value)
    assert message.startswith(f"{kind}: {str(name)!r}; allowed: ") and allowed in message
    assert caught.value.source == str(name)


def test_empty_name_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^trip: '';"):
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
    assert "greater than or equal to 100" in error.allowed


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
