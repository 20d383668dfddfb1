"""The file of proofs keeps every bit, appears whole, and is refused when it is damaged."""

from __future__ import annotations

import dataclasses
import json
import os
import zipfile
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from audited import TWO, plan_of_two
from trips import small_trip

from enumerate import Result, load_proofs, save_proofs
from enumerate.evidence import Evidence
from enumerate.evidence_file import fingerprint, save_evidence
from relax import InputError, load_trip
from relax.maps import Table1

TRIP = TWO


@pytest.fixture(scope="module")
def result() -> Result:
    return plan_of_two()


def parts(evidence: Evidence) -> Any:
    """Everything in it, comparable: arrays as bytes, infinities as themselves."""

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        return value.tobytes() if isinstance(value, np.ndarray) else value

    return plain(evidence)


def test_every_bit_comes_back(result: Result, file: Path, tmp_path: Path) -> None:
    found = load_proofs(file)
    assert found.cost == result.cost and found.lower_bound == result.lower_bound
    assert found.gap == result.gap and found.status == result.status.value
    assert found.grid == TRIP.grid and found.n_chargers == 2
    assert [parts(n) for n in found.nodes] == [parts(n) for n in result.proofs]  # type: ignore[arg-type]
    kept = ("subset", "outcome", "cost", "lower_bound", "undecided", "count", "without", "reason")
    for row, same in zip(found.rows, result.ledger.rows, strict=True):
        assert all(getattr(row, name) == getattr(same, name) for name in kept)
    assert found.driven is not None and result.execution is not None
    assert parts(found.driven.controls) == parts(result.execution.controls)  # type: ignore[arg-type]
    assert found.driven.targets_kwh == result.execution.targets_kwh
    save_evidence(tmp_path / "again", found)
    assert parts(load_proofs(tmp_path / "again")) == parts(found)


def test_the_file_is_a_plain_archive(file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        assert {n.removesuffix(".npy") for n in archive.namelist()} == {
            "header", "duals", "stages", "controls"
        }  # fmt: skip
    with np.load(file, allow_pickle=False) as arrays:
        header = json.loads(arrays["header"].tobytes())
        assert header["format"] == "evrelax proofs" and header["trip"] == TRIP.name
        assert arrays["duals"].dtype == np.float64


def test_an_old_file_survives_a_failure_and_nothing_is_left(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "trip.proofs"
    path.write_text("old", encoding="utf-8")

    def full(*_: object, **__: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="no space left"):
        save_proofs(path, TRIP, result)
    assert path.read_text(encoding="utf-8") == "old" and list(tmp_path.iterdir()) == [path]
    monkeypatch.undo()
    save_proofs(path, TRIP, result)
    assert load_proofs(path).cost == result.cost and list(tmp_path.iterdir()) == [path]
    with pytest.raises(OSError):
        save_proofs(tmp_path / "nowhere" / "trip.proofs", TRIP, result)


def test_only_kept_proofs_of_this_trip_are_written(result: Result, tmp_path: Path) -> None:
    for wrong, trip, named in (
        (dataclasses.replace(result, proofs=()), TRIP, "keep_proofs=True"),
        (result, load_trip("paper-400km"), "another trip"),
        (dataclasses.replace(result, execution=None), TRIP, "not its controls"),
    ):
        with pytest.raises(ValueError, match=named):
            save_proofs(tmp_path / "x", trip, wrong)
    assert not list(tmp_path.iterdir())


def test_a_link_stays_and_what_it_names_is_written(result: Result, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "target", tmp_path / "link"
    link.symlink_to(target)
    for _ in range(2):  # a name that is free yet, and an old file
        save_proofs(link, TRIP, result)
        assert link.is_symlink() and not target.is_symlink()
        assert load_proofs(target).cost == load_proofs(link).cost == result.cost
        assert [p.name for p in target.parent.iterdir()] == ["target"]


@pytest.mark.parametrize("through_a_link", [False, True])
def test_pipes_and_folders_are_not_replaced(
    result: Result, tmp_path: Path, through_a_link: bool
) -> None:
    pipe, folder = tmp_path / "pipe", tmp_path / "folder"
    os.mkfifo(pipe)  # as a device would be
    folder.mkdir()
    for place in (pipe, folder):
        path = place
        if through_a_link:
            path = tmp_path / f"link to {place.name}"
            path.symlink_to(place)
        with pytest.raises(OSError, match="not a regular file"):
            save_proofs(path, TRIP, result)
    assert pipe.is_fifo() and folder.is_dir() and not list(folder.iterdir())
    assert {p.name.removeprefix("link to ") for p in tmp_path.iterdir()} == {"pipe", "folder"}


# ---------------------------------------------------------------------------- damage


def refused(path: Path, named: str = "") -> None:
    with pytest.raises(InputError) as error:
        load_proofs(path)
    text = str(error.value)
    assert str(path) in text and named in text and "\n" not in text and len(text) < 800


def test_what_is_no_file_of_proofs_is_refused(file: Path, tmp_path: Path) -> None:
    refused(tmp_path / "nothing", "a file that exists")
    refused(tmp_path, "")
    for name, content in (("empty", b""), ("text", b"plain text"), ("half", b"PK\x03\x04rest")):
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name, "no archive")
    with (tmp_path / "array").open("wb") as stream:
        np.save(stream, np.zeros(3))
    refused(tmp_path / "array", "no archive")
    with (tmp_path / "other").open("wb") as stream:
        np.savez(stream, a=np.zeros(3))
    refused(tmp_path / "other", "other members")
    with (tmp_path / "pickle").open("wb") as stream:
        np.savez(stream, header=np.array([{}], dtype=object), duals=np.zeros(1), controls=[1.0])
    refused(tmp_path / "pickle", "allow_pickle=False")


def test_every_cut_and_every_flipped_byte_is_noticed(file: Path, tmp_path: Path) -> None:
    whole, known = file.read_bytes(), parts(load_proofs(file))
    rng = np.random.default_rng(1)
    path = tmp_path / "damaged"
    for at in rng.integers(0, len(whole), 25).tolist():
        path.write_bytes(whole[:at])
        refused(path)
    noticed = 0
    for at in rng.integers(0, len(whole), 60).tolist():
        flipped = bytearray(whole)
        flipped[at] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(bytes(flipped))
        try:  # some bytes of an archive say nothing, a date for example
            assert parts(load_proofs(path)) == known
        except InputError:
            noticed += 1
    assert noticed >= 50
    encrypted = bytearray(whole)
    encrypted[whole.rindex(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(bytes(encrypted))
    refused(path, "encrypted")


def rewritten(file: Path, path: Path, change: Any) -> None:
    """Write the file again with another header."""
    with np.load(file, allow_pickle=False) as arrays:
        members = {name: arrays[name] for name in arrays.files}
    header = json.loads(members["header"].tobytes())
    text = change if isinstance(change, str) else json.dumps(change(header) or header)
    members["header"] = np.frombuffer(text.encode(), dtype=np.uint8)
    with path.open("wb") as stream:
        np.savez(stream, **members)


def put(*keys: Any) -> Any:
    """Return a change of a header: the value at a place in it."""
    *way, last, value = keys

    def change(header: Any) -> None:
        for key in way:
            header = header[key]
        header[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ("{", ""),
        ("[" * 100_000, ""),
        ('{"format": "evrelax proofs", "version": NaN}', "NaN"),
        ("[]", "no file of proofs"),
        (put("format", "other"), "no file of proofs"),
        (put("version", 2), "version 2, not 4"),
        (put("grid", "cells", 10**9), "grid"),
        (put("grid", "step_km", 1e-9), "grid"),
        *((put("asked_gap", gap), "gap asked for") for gap in ("inf", 1.0, 0.0, -0.5)),
        (put("cost", "nan"), "no number"),
        (put("cost", True), "no number"),
        (put("cost", None), "no number"),
        (put("n_chargers", 2.0), "no whole number"),
        (put("n_chargers", 10**30), "no whole number"),
        (put("rows", 0, 0, ["a"]), "no whole number"),
        (put("rows", 0, 4, "BEST"), "BEST"),
        (put("rows", 0, []), ""),
        (put("nodes", 0, 1, None), "no whole number"),
        (put("nodes", 0, 5, [0]), ""),
        (put("nodes", 1, 9, 0, 0, "guess"), "no step of a proof"),
        (put("nodes", 1, 9, 0, 1, 1), "neither true nor false"),
        (put("nodes", 1, 9, 0, 4, 10**9), "sizes stated"),
        (put("nodes", 1, 9, 0, 4, -1), "sizes stated"),
        (put("nodes", 1, 9, 0, 4, 1), "sizes stated"),
        (put("nodes", 1, 8, ["halve", ["charge", [0, 1, 2], "charge"], 1.0, 0]), ""),
        (put("stops", []), "sizes stated"),
        (put("stops", [0, 1, 0, 1, 0, 1]), "sizes stated"),
        (put("nodes", {"0": 1}), ""),
        (put("rows", None), ""),
    ],
)
def test_a_header_that_makes_no_sense_is_refused(
    file: Path, tmp_path: Path, change: Any, named: str
) -> None:
    rewritten(file, tmp_path / "odd", change)
    refused(tmp_path / "odd", named)


# ---------------------------------------------------------------------------- fingerprint


def test_the_fingerprint_is_that_of_the_numbers() -> None:
    vehicle, pack, route = TRIP.vehicle, TRIP.vehicle.pack, TRIP.route
    print_ = fingerprint(TRIP)
    assert print_ == fingerprint(small_trip(start_soc=0.45, time_value_per_h=60.0))
    first = TRIP.chargers[0]
    speed = route.speed_kmh.copy()
    speed[3] = np.nextafter(speed[3], inf)
    table = pack.resistance_ohm
    warmer = Table1(table.x, np.r_[table.f[:-1], table.f[-1] * 1.0001], table.name)
    changed = [
        dataclasses.replace(TRIP, start_soc=0.46),
        dataclasses.replace(TRIP, stop_time_h=2.0),
        dataclasses.replace(TRIP, chargers=TRIP.chargers[::-1]),
        dataclasses.replace(TRIP, chargers=TRIP.chargers[:1]),
        dataclasses.replace(
            TRIP, chargers=(dataclasses.replace(first, current_a=300.0), *TRIP.chargers[1:])
        ),
        dataclasses.replace(TRIP, route=dataclasses.replace(route, speed_kmh=speed)),
        dataclasses.replace(
            TRIP,
            vehicle=dataclasses.replace(
                vehicle, pack=dataclasses.replace(pack, resistance_ohm=warmer)
            ),
        ),
    ]
    prints = {fingerprint(trip) for trip in changed}
    assert len(prints) == len(changed) and print_ not in prints
    renamed = dataclasses.replace(first, name="other")
    names = dataclasses.replace(
        TRIP, name="n", currency="c", chargers=(renamed, *TRIP.chargers[1:])
    )
    assert fingerprint(names) == print_
