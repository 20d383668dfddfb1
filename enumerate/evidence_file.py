"""Owns the file of proofs: ledger, proof trees, stages and the plan's controls as one ``.npz``.

A JSON header says what there is; float64 arrays hold all dual vectors and all controls,
one after the other, and a table the steps of stages. Written whole or not at all; read
without pickle and with every type, size and index checked. Judges no claim: that is ``audit``.
"""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import math
import os
import struct
import tempfile
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt

from enumerate.evidence import DrivenPlan, Evidence, ProofNode, StageProof
from enumerate.evidence_stages import from_table, to_table
from enumerate.ledger import Outcome, Row
from relax.branch import Branch, Target
from relax.errors import InputError
from relax.plan import Controls, StopControls
from relax.proof import Step
from relax.trip import Grid, Trip

if TYPE_CHECKING:
    from enumerate.result import Result

__all__ = ["fingerprint", "load_proofs", "save_evidence", "save_proofs"]

Array = npt.NDArray[np.float64]

# the version rises when steps or the rows they speak of change: dual vectors would not fit
FORMAT, VERSION = "evrelax proofs", 4
MEMBERS = ("header", "duals", "stages", "controls")
UNHASHED = {"name", "currency", "grid"}
"""Fields that name things for reports, and the grid, which the file states itself."""
LEAST_STEP_KM, MOST_CELLS = 0.01, 1000
"""A finer grid than this is damage [km, cells]."""
BROKEN = (
    OSError, EOFError, ValueError, KeyError, TypeError, IndexError, OverflowError, MemoryError,
    RuntimeError, SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What numpy, zip and JSON raise on damaged files; numpy reads a header as Python."""


# ---------------------------------------------------------------------------- fingerprint


def fingerprint(trip: Trip) -> str:
    """Return a hash of every number of a trip: vehicle, road, chargers, prices, limits.

    Names and the grid do not enter.

    Examples
    --------
    >>> from relax import load_trip
    >>> warm, cold = (load_trip("paper-400km", {"route.ambient_c": t}) for t in (10.0, -10.0))
    >>> fingerprint(warm) == fingerprint(warm), fingerprint(warm) == fingerprint(cold)
    (True, False)
    """
    state = hashlib.sha256()
    _feed(state.update, trip)
    return state.hexdigest()


def _feed(put: Any, value: Any) -> None:
    """Put a value's type, structure and numbers into a hash."""
    if value is None:
        put(b"none")
    elif isinstance(value, str):
        put(b"text%d:" % len(value.encode()) + value.encode())
    elif isinstance(value, bool | int | float | np.floating | np.integer):
        put(b"number" + struct.pack("<d", float(value) + 0.0))  # no negative zero
    elif isinstance(value, np.ndarray):
        put(b"array" + repr(value.shape).encode())
        put((value.astype("<f8") + 0.0).tobytes())
    elif isinstance(value, list | tuple):
        put(b"list%d:" % len(value))
        for item in value:
            _feed(put, item)
    elif dataclasses.is_dataclass(value):
        put(b"fields of " + type(value).__name__.encode())
        for field in dataclasses.fields(value):
            if field.name not in UNHASHED:
                put(field.name.encode() + b"=")
                _feed(put, getattr(value, field.name))
    else:
        raise TypeError(f"no hash for a {type(value).__name__}")


# ---------------------------------------------------------------------------- writing


def save_proofs(path: str | Path, trip: Trip, result: Result) -> None:
    """Write the ledger, the proofs and the controls of a result into one file.

    Parameters
    ----------
    path : str or Path
        File to write; it appears whole or not at all, and replaces an old one. A symbolic
        link stays, and what it names is written.
    trip : Trip
        What was planned.
    result : Result
        From ``plan(trip, ..., keep_proofs=True)``.

    Raises
    ------
    ValueError
        The result is of another trip, or its proofs were not kept.
    OSError
        The file cannot be written, or there is a folder, a pipe or a device of its name.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip
    >>> import tempfile
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> result = plan(trip, keep_proofs=True)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_proofs(Path(folder) / "trip.proofs", trip, result)
    ...     load_proofs(Path(folder) / "trip.proofs").cost == result.cost
    True
    """
    if not result.proofs:
        raise ValueError("the result has no proofs: plan with keep_proofs=True")
    if result.chargers != tuple(c.name for c in trip.chargers):
        raise ValueError("the result is of another trip")
    driven = None
    if result.plan is not None:
        if result.execution is None:
            raise ValueError("the result has a plan but not its controls")
        place = {c: i for i, c in zip(range(len(result.chargers)), result.chargers, strict=True)}
        driven = DrivenPlan(
            tuple(place[stop.charger] for stop in result.plan.stops),
            result.execution.controls,
            result.execution.targets_kwh,
        )
    save_evidence(
        path,
        Evidence(
            trip=trip.name,
            fingerprint=fingerprint(trip),
            n_chargers=len(trip.chargers),
            grid=result.grid,
            status=result.status.value,
            cost=result.cost,
            lower_bound=result.lower_bound,
            gap=result.gap,
            transcribed=result.transcribed_cost,
            asked_gap=result.asked_gap,
            rows=result.ledger.rows,
            nodes=result.proofs,
            driven=driven,
            stages=result.stages,
        ),
    )


def save_evidence(path: str | Path, evidence: Evidence) -> None:
    """Write evidence into a file, whole or not at all.

    Parameters
    ----------
    path : str or Path
        File to write or replace; through a symbolic link, what it names.
    evidence : Evidence
        What to write, true or not.

    Raises
    ------
    OSError
        The file cannot be written, or there is a folder, a pipe or a device of its name.
    """
    duals = [step.dual for node in evidence.nodes for step in node.steps]
    stages, table, targets = evidence.stages, *to_table([])
    if stages is not None:
        table, targets = to_table(stages.steps)
        duals += [step.dual for step in stages.steps]
    header = {
        "format": FORMAT,
        "version": VERSION,
        **{
            name: getattr(evidence, name)
            for name in ("trip", "fingerprint", "n_chargers", "status", "asked_gap")
        },
        **{
            name: _out(getattr(evidence, name))
            for name in ("cost", "lower_bound", "gap", "transcribed")
        },
        "grid": {"step_km": evidence.grid.step_km, "cells": evidence.grid.cells},
        "rows": [_row_out(row) for row in evidence.rows],
        "nodes": [_node_out(node) for node in evidence.nodes],
        "stops": None if evidence.driven is None else list(evidence.driven.stops),
        "stages": None if stages is None else {
            "closing": _out(stages.closing), "bound": _out(stages.bound),
            "targets": [_target_out(target) for target in targets],
        },
    }  # fmt: skip
    text = json.dumps(header, allow_nan=False, separators=(",", ":"))
    arrays: dict[str, npt.NDArray[Any]] = {
        "header": np.frombuffer(text.encode(), dtype=np.uint8),
        "duals": np.concatenate([np.zeros(0), *duals]).astype("<f8"),
        "stages": table.astype("<f8"),
        "controls": _controls_out(evidence.driven).astype("<f8"),
    }
    path = Path(os.path.realpath(path))  # a link would be replaced, not what it names
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **arrays)
            stream.flush()
            os.fsync(stream.fileno())
        mask = os.umask(0)  # a temporary file is private; this one is as any other
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _out(value: float) -> float | str:
    """Return a float as JSON can hold it; its decimals are exact."""
    return float(value) if math.isfinite(value) else repr(float(value))


def _row_out(row: Row) -> list[Any]:
    count = None if row.count is None else list(row.count)
    return [
        list(row.subset), list(row.undecided), count, [list(s) for s in row.without],
        row.outcome.name, _out(row.cost), _out(row.lower_bound), row.reason,
    ]  # fmt: skip


def _target_out(target: Target | None) -> list[Any] | None:
    if target is None:
        return None
    index = target.index
    return [target.name, list(index) if isinstance(index, tuple) else int(index), target.variable]


def _node_out(node: ProofNode) -> list[Any]:
    how = node.how
    cut = None if how is None else [how.kind, _target_out(how.target), _out(how.at), int(how.stop)]
    steps = [[s.kind, s.ray, _target_out(s.target), s.sign, int(s.dual.size)] for s in node.steps]
    return [
        node.number, node.parent, node.part, list(node.subset), list(node.undecided),
        list(node.count), _out(node.cutoff), _out(node.bound), cut, steps,
    ]  # fmt: skip


def _controls_out(driven: DrivenPlan | None) -> Array:
    if driven is None:
        return np.zeros(0)
    c = driven.controls
    parts = [c.heater_kw, c.cooling_kw, c.heat_pump_kw]
    for stop, target in zip(c.stops, driven.targets_kwh, strict=True):
        parts += [np.array([stop.energy_kwh, target])]
        parts += [stop.power_kw, stop.heater_kw, stop.cooling_kw, stop.heat_pump_kw]
    return np.concatenate(parts)


# ---------------------------------------------------------------------------- reading


def load_proofs(path: str | Path) -> Evidence:
    """Read a file of proofs.

    Parameters
    ----------
    path : str or Path
        Written by ``save_proofs``.

    Returns
    -------
    Evidence
        Well-formed, which does not make it true.

    Raises
    ------
    InputError
        There is no such file, or it is damaged.
    """
    shown = str(path)
    try:
        if Path(path).is_file() and not zipfile.is_zipfile(path):
            raise ValueError("it is no archive, or cut short")
        with np.load(path, allow_pickle=False) as file:
            header = _header(file)
            if sorted(file.files) != sorted(MEMBERS):
                raise ValueError("it has other members")
            duals, table, controls = (np.asarray(file[name]) for name in MEMBERS[1:])
        for array, axes in ((duals, 1), (table, 2), (controls, 1)):
            if array.dtype != np.float64 or array.ndim != axes:
                raise ValueError("its numbers are not in double precision")
        return _evidence(header, duals, table, controls)
    except FileNotFoundError as error:
        raise InputError(shown, "proofs", shown, "a file that exists") from error
    except BROKEN as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        allowed = f"a file that 'evrelax plan --ledger' wrote, undamaged ({reason})"
        raise InputError(shown, "proofs", shown, allowed) from error


def _header(file: Any) -> dict[str, Any]:
    """Return the header of an archive, if it is one of this version."""
    if MEMBERS[0] not in file.files:
        raise ValueError("it has other members")
    raw = np.asarray(file[MEMBERS[0]])
    if raw.dtype != np.uint8 or raw.ndim != 1:
        raise ValueError("its header is no text")
    header = json.loads(raw.tobytes().decode(), parse_constant=_no_constant)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError("it is no file of proofs")
    if header["version"] != VERSION:
        raise ValueError(f"version {header['version']!r}, not {VERSION}")
    return header


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} in its header")


def _evidence(header: dict[str, Any], duals: Array, table: Array, controls: Array) -> Evidence:
    """Build the values; every index and size is checked on the way."""
    grid = Grid(_number(header["grid"]["step_km"]), _whole(header["grid"]["cells"]))
    if not (LEAST_STEP_KM <= grid.step_km < math.inf and 1 <= grid.cells <= MOST_CELLS):
        raise ValueError("its grid is none")
    nodes, used = [], 0
    for item in header["nodes"]:
        node, used = _node(item, duals, used)
        nodes.append(node)
    stages = _stages(header["stages"], table, duals[used:])
    stops = header["stops"]
    asked = None if header["asked_gap"] is None else _number(header["asked_gap"])
    if asked is not None and not 0.0 < asked < 1.0:
        raise ValueError("the gap asked for is not above 0 and below 1")
    return Evidence(
        trip=_text(header["trip"]),
        fingerprint=_text(header["fingerprint"]),
        n_chargers=_whole(header["n_chargers"]),
        grid=grid,
        status=_text(header["status"]),
        cost=_number(header["cost"]),
        lower_bound=_number(header["lower_bound"]),
        gap=_number(header["gap"]),
        transcribed=_number(header["transcribed"]),
        asked_gap=asked,
        rows=tuple(_row(item) for item in header["rows"]),
        nodes=tuple(nodes),
        driven=None if stops is None else _driven(_whole_tuple(stops), grid.cells, controls),
        stages=stages,
    )


def _stages(item: Any, table: Array, duals: Array) -> StageProof | None:
    """Return the proof over stages, to which all further dual vectors belong."""
    targets = [] if item is None else [_target(entry) for entry in item["targets"]]
    steps = from_table(table, [t for t in targets if t is not None], duals)
    if item is None:
        if steps:
            raise ValueError("it has stages that its header does not know of")
        return None
    return StageProof(_number(item["closing"]), steps, _number(item["bound"]))


def _whole(value: Any) -> int:
    if type(value) is not int or abs(value) > 2**53:
        raise ValueError(f"{value!r:.40} is no whole number")
    return value


def _number(value: Any) -> float:
    if isinstance(value, str) and value in ("inf", "-inf"):
        return float(value)
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(f"{value!r:.40} is no number")
    return float(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r:.40} is no text")
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r:.40} is neither true nor false")
    return value


def _whole_tuple(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list):
        raise ValueError(f"{value!r:.40} is no list")
    return tuple(_whole(item) for item in value)


def _pair(value: Any) -> tuple[int, int]:
    first, second = _whole_tuple(value)
    return first, second


def _row(item: Any) -> Row:
    subset, undecided, count, without, outcome, cost, bound, reason = item
    return Row(
        _whole_tuple(subset),
        Outcome[_text(outcome)],
        _number(cost),
        _number(bound),
        _text(reason),
        undecided=_whole_tuple(undecided),
        count=None if count is None else _pair(count),
        without=tuple(_whole_tuple(s) for s in without),
    )


def _target(item: Any) -> Target | None:
    if item is None:
        return None
    name, index, variable = item
    at = _pair(index) if isinstance(index, list) else _whole(index)
    return Target(_text(name), at, _text(variable))


def _step(item: Any, duals: Array, used: int) -> tuple[Step, int]:
    kind, ray, target, sign, size = item
    if kind not in ("propagate", "relax", "shrink"):
        raise ValueError(f"{kind!r:.40} is no step of a proof")
    end = used + _whole(size)
    if not used <= end <= duals.size:
        raise ValueError("its dual vectors do not have the sizes stated")
    return Step(kind, duals[used:end], _flag(ray), _target(target), _whole(sign)), end


def _node(item: Any, duals: Array, used: int) -> tuple[ProofNode, int]:
    number, parent, part, subset, undecided, count, cutoff, bound, cut, listed = item
    how = None
    if cut is not None:
        kind, target, at, stop = cut
        how = Branch(_text(kind), _target(target), _number(at), _whole(stop))
    steps = []
    for entry in listed:
        step, used = _step(entry, duals, used)
        steps.append(step)
    node = ProofNode(
        _whole(number),
        _whole(parent),
        _whole(part),
        _whole_tuple(subset),
        _whole_tuple(undecided),
        _pair(count),
        _number(cutoff),
        tuple(steps),
        how,
        _number(bound),
    )
    return node, used


def _driven(stops: tuple[int, ...], cells: int, values: Array) -> DrivenPlan:
    """Cut the array of all controls: three schedules of the drive, then stop by stop."""
    each = 2 + 4 * cells
    drive, left = divmod(values.size - len(stops) * each, 3)
    if drive < 1 or left:
        raise ValueError("its controls do not have the sizes stated")
    heater, cooling, pump = values[: 3 * drive].reshape(3, drive)
    found, targets = [], []
    for row in values[3 * drive :].reshape(len(stops), each):
        power, *others = row[2:].reshape(4, cells)
        found.append(StopControls(float(row[0]), power, *others))
        targets.append(float(row[1]))
    return DrivenPlan(stops, Controls(heater, cooling, pump, tuple(found)), tuple(targets))
