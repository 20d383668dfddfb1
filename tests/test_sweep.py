"""A sweep is its separate plans, in the order of the grid, whatever the executor; what is saved is
not computed again, what was torn or lost is."""

from __future__ import annotations

import json
import os
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from trips import write_trip

from enumerate import Sweep, plan, sweep
from enumerate.cli import main
from enumerate.sweep import front_task, plan_task
from relax import InputError, load_trip
from relax.trip import Trip

OVER: dict[str, Any] = {"route.ambient_c": range(-5, 6, 5), "vehicle.heat_pump_kw": [0.0, 1.0]}
COARSE = {"grid.step_km": 20.0, "grid.cells": 4}


@pytest.fixture(scope="module")
def trip(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_trip(tmp_path_factory.mktemp("trip")))


def quick(trip: Trip) -> dict[str, Any]:
    """A task that costs nothing."""
    return {"length": trip.route.length_km, "pump": trip.vehicle.heat_pump_kw}


def refusing(trip: Trip) -> dict[str, Any]:
    """A task that has its own input, and refuses it."""
    raise InputError("a", "b", 3, "less")


def deadly(trip: Trip, folder: str) -> dict[str, Any]:
    """A task that kills its process the first time that it meets 0 C."""
    flag = Path(folder) / "died"
    if trip.start_temperature_c == 0.0 and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(trip)


def content(found: Sweep) -> list[tuple[int, dict[str, Any], Any]]:
    return [(r.index, r.variant, r.result) for r in found.rows]


def test_a_sweep_is_its_separate_plans(trip: str) -> None:
    found = sweep(trip, OVER, overrides=COARSE, gap=0.05)
    assert len(found.rows) == 6 and not found.missing and found.interrupted == ""
    assert found.column("route.ambient_c") == [-5, -5, 0, 0, 5, 5]
    assert found.column("vehicle.heat_pump_kw") == [0.0, 1.0] * 3
    for row in found.rows[::2]:
        alone = plan(load_trip(trip, {**COARSE, **row.variant}), gap=0.05)
        assert row.result is not None and alone.plan is not None
        assert (row.result["cost"], row.result["lower_bound"]) == (alone.cost, alone.lower_bound)
        assert row.result["plan"]["grid_kwh"] == alone.plan.grid_kwh
        assert "drive" not in row.result["plan"]
    assert found.column("plan.grid_kwh")[0] == found.rows[0].result["plan"]["grid_kwh"]  # type: ignore[index]
    assert found.column("no.such.thing") == [None] * 6


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_the_same_rows_in_the_same_order(trip: str, pool: Any) -> None:
    alone = sweep(trip, OVER, task=quick)
    with pool(2) as executor:
        assert content(sweep(trip, OVER, task=quick, executor=executor)) == content(alone)


def test_what_is_saved_is_not_computed_again(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    calls: list[str] = []

    def counted(trip: Trip) -> dict[str, Any]:
        calls.append(trip.name)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return quick(trip)

    cut = sweep(trip, OVER, task=counted, file=file)
    assert len(cut.rows) == 3 and len(cut.missing) == 3 and cut.interrupted == "interrupted"
    assert len(file.read_text().splitlines()) == 3
    with file.open("a") as stream:  # a line torn in the middle, as by a power cut
        stream.write('{"sweep": {"trip": "half a li')
    calls += ["one more", "so that none is the fourth"]
    whole = sweep(trip, OVER, task=counted, file=file)
    assert len(calls) == 4 + 2 + 3
    assert content(whole) == content(sweep(trip, OVER, task=quick)) and not whole.missing
    again = sweep(trip, OVER, task=counted, file=file)
    assert len(calls) == 4 + 2 + 3 and content(again) == content(whole)
    wider = sweep(trip, OVER | {"route.ambient_c": [5, -5, 7]}, task=counted, file=file)
    assert len(calls) == 4 + 2 + 3 + 2
    assert wider.column("route.ambient_c") == [5, 5, -5, -5, 7, 7]


def test_rows_of_other_trips_tasks_and_settings_are_left_alone(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    over = {"start.soc": [0.5, 0.6]}
    seen: list[int] = []
    for settings in (
        {"task": quick},
        {"task": partial(plan_task, gap=None)},
        {"task": partial(plan_task, gap=0.5)},
        {"task": quick, "overrides": {"end.soc_min": 0.1}},
    ):
        fixed = {**COARSE, **settings.pop("overrides", {})}  # type: ignore[dict-item]
        found = sweep(trip, over, file=file, overrides=fixed, **settings)  # type: ignore[arg-type]
        assert not found.missing
        seen.append(len(file.read_text().splitlines()))
    assert seen == [2, 4, 6, 8]


def test_a_killed_worker_costs_nothing(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    task = partial(deadly, folder=str(tmp_path))
    found = sweep(trip, OVER, task=task, workers=2, file=file)
    assert (tmp_path / "died").exists()
    assert content(found) == content(sweep(trip, OVER, task=quick)) and found.interrupted == ""
    assert len(file.read_text().splitlines()) == 6


def test_a_lost_executor_leaves_what_is_missing(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    task = partial(deadly, folder=str(tmp_path))
    with ProcessPoolExecutor(1) as pool:
        found = sweep(trip, OVER, task=task, executor=pool, file=file)
    assert found.missing and "lost" in found.interrupted
    assert {r.variant["route.ambient_c"] for r in found.rows} <= {-5}
    whole = sweep(trip, OVER, task=task, file=file)
    assert content(whole) == content(sweep(trip, OVER, task=quick))


def test_a_variant_that_is_no_trip_is_a_row_with_its_error(trip: str) -> None:
    found = sweep(trip, {"start.soc": [0.5, 1.7]}, task=quick)
    assert [r.error == "" for r in found.rows] == [True, False]
    assert "start.soc" in found.rows[1].error and found.rows[1].result is None
    with pytest.raises(InputError, match="no-such-trip"):
        sweep("no-such-trip", {"start.soc": [0.5]})
    with pytest.raises(ValueError, match=r"start\.soc has no values"):
        sweep(trip, {"start.soc": []})


@pytest.mark.parametrize(
    ("over", "named"),
    [
        ({"foo": [1, 2]}, "foo: 1; allowed: one of charger"),
        ({"start.soc": [0.5], "route.ambient": [3]}, "route.ambient: 3; allowed: did you mean"),
        ({"route.ambient_c": ["abc", "de"]}, "route.ambient_c: 'abc'; allowed: degrees C"),
        ({"start.soc": [1.7, -1], "end.soc_min": [0.1, 0.2]}, "start.soc: 1.7; allowed: "),
    ],
)
def test_where_no_variant_is_a_trip_nothing_runs(
    trip: str, tmp_path: Path, over: dict[str, Any], named: str
) -> None:
    def never(_: Trip) -> dict[str, Any]:
        raise AssertionError("run in vain")

    file = tmp_path / "rows.jsonl"
    with pytest.raises(InputError) as caught:
        sweep(trip, over, task=never, file=file)
    assert named in str(caught.value) and not file.exists()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"# A page\n\ntext\n", "line 1: '# A page'"),
        (b'{"name": "other"}\n', "line 1: "),
        (b"[1, 2]", "line 1: '[1, 2]'"),
        (b'\n{"sweep": {"torn": 1\nname,value\n', "line 3: 'name,value'"),
        (b"PK\x03\x04\xff\xfe", "byte 4"),
    ],
)
def test_any_other_file_is_refused_and_kept(
    trip: str, tmp_path: Path, content: bytes, line: str
) -> None:
    file = tmp_path / "notes"
    file.write_bytes(content)
    with pytest.raises(InputError) as caught:
        sweep(trip, {"start.soc": [0.5]}, task=quick, file=file)
    assert f"{file}: {line}" in str(caught.value) and file.read_bytes() == content


@pytest.mark.parametrize("kept", [0, 1, 6, 40])
def test_a_line_torn_anywhere_is_computed_again(trip: str, tmp_path: Path, kept: int) -> None:
    file = tmp_path / "rows.jsonl"
    over = {"start.soc": [0.5, 0.6]}
    sweep(trip, over, task=quick, file=file)
    first, second = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(first + second[:kept])
    new: list[int] = []
    for _ in range(2):  # the torn line stays in the middle and harms nobody
        found = sweep(trip, over, task=quick, file=file, progress=lambda done, *_: new.append(done))
        assert len(found.rows) == 2 and not found.missing
    assert new == [2]


def test_an_error_of_the_task_is_not_hidden(trip: str, tmp_path: Path) -> None:
    def broken(trip: Trip) -> dict[str, Any]:
        raise ZeroDivisionError(trip.name)

    with pytest.raises(ZeroDivisionError):
        sweep(trip, {"start.soc": [0.5]}, task=broken, file=tmp_path / "rows.jsonl")


def test_a_plan_that_ctrl_c_cut_short_is_not_kept(trip: str, tmp_path: Path) -> None:
    """The plan took the signal and returned what it had: no further variant is run."""
    file = tmp_path / "rows.jsonl"
    run: list[float] = []

    def stopped(t: Trip) -> dict[str, Any]:
        run.append(t.start_soc)
        return {"interrupted": "interrupted" if len(run) == 2 else ""}

    found = sweep(trip, {"start.soc": [0.5, 0.6, 0.7, 0.8]}, task=stopped, file=file)
    assert run == [0.5, 0.6]
    assert len(found.rows) == 1 and len(found.missing) == 3 and found.interrupted == "interrupted"
    assert len(file.read_text().splitlines()) == 1


@pytest.mark.parametrize("workers", [1, 2])
def test_an_input_error_of_the_task_comes_through(trip: str, workers: int) -> None:
    with pytest.raises(InputError, match="a: b: 3; allowed: less"):
        sweep(trip, {"start.soc": [0.5]}, task=refusing, workers=workers)


def test_a_key_has_one_value_or_several(trip: str) -> None:
    with pytest.raises(InputError, match="a value of its own, or several"):
        sweep(trip, {"start.soc": [0.5, 0.6]}, task=quick, overrides={"start.soc": 0.5})


def test_numbers_of_numpy_are_numbers(trip: str) -> None:
    found = sweep(trip, {"start.soc": np.linspace(0.5, 0.6, 2)}, task=quick)
    assert json.dumps([r.variant for r in found.rows]) == '[{"start.soc": 0.5}, {"start.soc": 0.6}]'


def test_progress_counts_every_row(trip: str) -> None:
    seen: list[tuple[int, int]] = []
    sweep(trip, OVER, task=quick, progress=lambda done, total, row: seen.append((done, total)))
    assert seen == [(k, 6) for k in range(1, 7)]


def test_fronts_can_be_swept(trip: str) -> None:
    task = partial(front_task, points=2, gap=None)
    found = sweep(
        trip, {"route.ambient_c": [5.0]}, task=task, overrides={**COARSE, "start.soc": 0.4}
    )
    (row,) = found.rows
    assert row.result is not None
    assert row.result["unit"] == "kWh" and len(row.result["points"]) >= 2


def call(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["sweep", *(str(a) for a in arguments), "-q"])


def test_the_command_saves_rows_and_goes_on(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    options = ["--set", "grid.step_km=20", "--set", "grid.cells=4", "--file", file]
    wide = ["--over", "route.ambient_c=-5:5:5", "--over", "vehicle.heat_pump_kw=0,1.0"]
    first = call(trip, "--over", "route.ambient_c=5", wide[2], wide[3], *options)
    assert first.exit_code == 0 and f"2 rows in {file} (2 planned, 0 inf" in first.stdout
    again = call(trip, *wide, *options)
    assert again.exit_code == 0 and again.stderr == ""
    counted = f"6 rows in {file} (6 planned, 0 infeasible, 0 invalid; 4 computed anew)"
    assert again.stdout.splitlines()[-1] == counted
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert len(rows) == 6 and all(row["result"]["status"] for row in rows)
    assert [r["variant"]["route.ambient_c"] for r in rows] == [5, 5, -5, -5, 0, 0]
    listed = [line.split() for line in again.stdout.splitlines()]
    for row in rows:
        variant, result = row["variant"], row["result"]
        (line,) = [c for c in listed if c[:2] == [str(v) for v in variant.values()]]
        stops = " + ".join(s["charger"] for s in result["plan"]["stops"]) or "none"
        assert line[2:4] == [f"{result['cost']:.2f}", f"{result['lower_bound']:.2f}"]
        assert " ".join(line[5:]) == stops
    for bad in ("route.ambient_c", "route.ambient_c=", "route.ambient_c=1:2:0", "=1", "a=1:0:1"):
        done = call(trip, "--over", bad, *options)
        assert done.exit_code == 2 and done.stderr.startswith("evrelax: command line: --over: ")
        assert done.stderr.count("\n") == 1 and repr(bad) in done.stderr


def test_the_command_says_what_became_of_every_row(trip: str, tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    options = ["--set", "grid.step_km=20", "--set", "grid.cells=4", "--file", file]
    done = call(trip, "--over", "start.soc=0.5,0.06,abc", *options)
    assert done.exit_code == 0 and done.stderr == ""
    text = " ".join(done.stdout.split())
    assert "infeasible: the car gets to" in text
    assert "invalid: override: start.soc: 'abc'; allowed: a number" in text
    assert done.stdout.endswith("(1 planned, 1 infeasible, 1 invalid; 3 computed anew)\n")
    other = write_trip(tmp_path, **{"objective.time_value_per_h": 20.0})
    done = call(other, "--over", "start.soc=0.5", *options)
    assert f"1 row in {file} (1 planned, 0 infeasible, 0 invalid; 1 computed anew)" in done.stdout
    assert len(file.read_text().splitlines()) == 4  # the rows of the first trip are there too


@pytest.mark.parametrize("over", ["foo=1,2", "route.ambient_c=abc", "start.socc=0.5"])
def test_the_command_refuses_what_no_row_could_use(trip: str, tmp_path: Path, over: str) -> None:
    file = tmp_path / "rows.jsonl"
    done = call(trip, "--over", over, "--file", file)
    assert done.exit_code == 2 and done.stdout == "" and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"evrelax: override: {over.split('=')[0]}: ")
    assert not file.exists()


def test_the_command_appends_to_no_other_file(trip: str, tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("# Title\n", encoding="utf-8")
    done = call(trip, "--over", "start.soc=0.5", "--file", page)
    assert done.exit_code == 2 and done.stdout == "" and done.stderr.count("\n") == 1
    assert "README.md: line 1: '# Title'; allowed: a row of a sweep" in done.stderr
    assert page.read_text(encoding="utf-8") == "# Title\n"
    os.mkfifo(tmp_path / "pipe")
    done = call(trip, "--over", "start.soc=0.5", "--file", tmp_path / "pipe")
    assert done.exit_code == 2 and "--file: " in done.stderr and "regular file" in done.stderr


def test_values_of_a_key_come_in_one_option(trip: str, tmp_path: Path) -> None:
    twice = ("--over", "start.soc=0.5", "--over", "start.soc=0.6")
    done = call(trip, *twice, "--file", tmp_path / "rows.jsonl")
    assert done.exit_code == 2 and "all values of start.soc in one --over" in done.stderr
