"""Owns sweeps: many variants of one trip, on any executor, saved as they come.

A file of JSON lines holds what is done, so that a sweep goes on where it was stopped:
by Ctrl-C, by a killed worker, by a power cut in the middle of a line. Knows nothing of
what a task computes.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from enumerate.pareto import pareto
from enumerate.search import plan
from relax.document import read_text
from relax.errors import InputError
from relax.load import check_keys, load_trip
from relax.trip import Trip

__all__ = ["Sweep", "SweepRow", "front_task", "plan_task", "sweep"]

Task = Callable[[Trip], Mapping[str, Any]]
Variant = dict[str, Any]

MAX_POOLS = 4
"""Pools of worker processes begun before a sweep gives up: each ends when a worker is killed."""
STOPPED = "interrupted"
"""What a result says of itself when Ctrl-C cut it short: it is not kept."""
ROW = ("sweep", "variant", "result", "error", "seconds")
"""Entries of a line of the file, in their order."""
TORN = '{"sweep": '
"""How a line begins that was cut in the middle, if it is one of a sweep."""


@dataclass(frozen=True)
class SweepRow:
    """One finished variant.

    Parameters
    ----------
    index : int
        Place in the grid.
    variant : dict
        The overrides that make it.
    result : dict or None
        What the task returned; None if the variant is no valid trip.
    error : str
        Why not; empty if there is a result.
    seconds : float
        Time it took [s].
    """

    index: int
    variant: Variant
    result: dict[str, Any] | None
    error: str
    seconds: float


@dataclass(frozen=True)
class Sweep:
    """What a sweep has, in the order of the grid.

    Parameters
    ----------
    rows : tuple of SweepRow
        Finished variants.
    missing : tuple of dict
        Variants without a row: call again with the same file to go on.
    interrupted : str
        Why some are missing; empty if none is.
    """

    rows: tuple[SweepRow, ...]
    missing: tuple[Variant, ...]
    interrupted: str

    def column(self, name: str) -> list[Any]:
        """Return one entry of every row by its dotted name; None where there is none.

        Parameters
        ----------
        name : str
            A key of the variants, or a path into the results such as ``plan.grid_kwh``.
        """
        return [row.variant.get(name, _entry(row.result, name)) for row in self.rows]


def _entry(value: Any, name: str) -> Any:
    for key in name.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def plan_task(
    trip: Trip, gap: float | None = None, time_limit_s: float | None = None
) -> dict[str, Any]:
    """Return a plan as JSON types, without the arrays over distance and time.

    Parameters
    ----------
    trip : Trip
        The trip.
    gap, time_limit_s : float, optional
        As for ``plan``.
    """
    result = plan(trip, gap=gap, time_limit_s=time_limit_s).to_dict()
    del result["timings_s"]
    if result["plan"] is not None:
        del result["plan"]["drive"], result["plan"]["charge"]
    return result


def front_task(trip: Trip, **settings: Any) -> dict[str, Any]:
    """Return a front as JSON types.

    Parameters
    ----------
    trip : Trip
        The trip.
    **settings
        As for ``pareto``.
    """
    result = pareto(trip, **settings).to_dict()
    del result["timings_s"]
    return result


def _run(trip: str, overrides: Variant, task: Task) -> tuple[dict[str, Any] | None, str, float]:
    """Load a variant and run the task: result, error, seconds."""
    begin = time.perf_counter()
    result, error = None, ""
    try:
        loaded = load_trip(trip, overrides)
    except InputError as problem:
        error = str(problem)
    else:
        result = json.loads(json.dumps(task(loaded), allow_nan=False))
    return result, error, time.perf_counter() - begin


def _feed(digest: Any, value: Any) -> None:
    """Feed a value of plain types, arrays and objects of them into a hash."""
    digest.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        digest.update(value.tobytes())
    elif isinstance(value, list | tuple):
        for item in value:
            _feed(digest, item)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            _feed(digest, getattr(value, field.name))
    elif hasattr(value, "__dict__"):
        for name in sorted(vars(value)):
            _feed(digest, vars(value)[name])
    else:
        digest.update(repr(value).encode())


def _identity(trip: str, overrides: Variant, task: Task) -> Variant:
    """Return what must agree for a saved row to be the wanted one, beside its variant."""
    digest = hashlib.sha256()
    _feed(digest, load_trip(trip, overrides))
    name = task
    settings: Variant = {}
    if isinstance(task, partial):
        name, settings = task.func, {"args": list(task.args), **task.keywords}
    return {
        "trip": trip,
        "digest": digest.hexdigest()[:16],
        "task": getattr(name, "__qualname__", repr(name)),
        "settings": json.loads(json.dumps(settings, default=str)),
    }


class _File:
    """The rows on disk; None: nowhere."""

    def __init__(self, path: Path | None, identity: Variant) -> None:
        self.path, self.identity = path, identity

    def read(self) -> Iterator[SweepRow]:
        """Yield the rows of this sweep; torn lines and rows of other sweeps are passed over.

        Raises
        ------
        InputError
            A line is no row: the file is another one, and nothing may be appended to it.
        """
        if self.path is None or not self.path.exists():
            return
        lines = read_text(self.path, str(self.path)).split("\n")
        for number, line in enumerate(lines, start=1):
            try:
                row = json.loads(line)
                values = [row[name] for name in ROW]
            except (ValueError, KeyError, TypeError):
                if line.startswith(TORN[: len(line)]):  # nothing, or the beginning of a row
                    continue
                allowed = "a row of a sweep: give a file of an earlier one, or a free name"
                shown = line.strip()
                raise InputError(str(self.path), f"line {number}", shown, allowed) from None
            if values[0] == self.identity:
                yield SweepRow(-1, *values[1:])

    def write(self, row: SweepRow) -> None:
        """Append a row and hand it to the system before anything else happens."""
        if self.path is None:
            return
        values = (self.identity, row.variant, row.result, row.error, row.seconds)
        entry = dict(zip(ROW, values, strict=True))
        line = json.dumps(entry, allow_nan=False) + "\n"
        with self.path.open("ab+") as stream:
            if stream.tell() > 0:
                stream.seek(-1, 2)
                if stream.read(1) != b"\n":  # the line before was torn
                    line = "\n" + line
            stream.write(line.encode("utf-8"))


def sweep(
    trip: str | Path,
    over: Mapping[str, Iterable[Any]],
    *,
    gap: float | None = None,
    task: Task | None = None,
    overrides: Mapping[str, Any] | None = None,
    time_limit_s: float | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    file: str | Path | None = None,
    progress: Callable[[int, int, SweepRow], None] | None = None,
) -> Sweep:
    """Run every combination of some values of a trip.

    Parameters
    ----------
    trip : str or Path
        Shipped trip or TOML file.
    over : mapping of str to iterable
        Dotted key of the trip and its values; all combinations, the last key fastest.
    gap, time_limit_s : float, optional
        Of every plan, as for ``plan``.
    task : callable, optional
        Instead of a plan: takes the loaded trip, returns a dict of JSON types. Processes
        need one that can be pickled: ``functools.partial(front_task, points=12)``.
    overrides : mapping, optional
        Values that hold for all variants.
    workers : int
        Processes; 1 runs everything here. A pool that loses a worker is begun anew.
    executor : Executor, optional
        Any ``concurrent.futures.Executor`` instead: threads, processes, a cluster's.
    file : str or Path, optional
        JSON lines: each row is appended as it comes, rows found there are not computed
        again. Rows of another trip, task or setting may stand there too, anything else not.
    progress : callable, optional
        Called with rows done, rows in all and the row, after each.

    Returns
    -------
    Sweep
        Rows in the order of the grid, whatever the order in which they came. Ctrl-C and
        lost workers return what is known by then.

    Raises
    ------
    InputError
        The trip itself cannot be loaded, a key of ``over`` does not exist or is among the
        overrides, no variant is a valid trip, or ``file`` holds something else than rows:
        nothing is run then. Where some variants are valid trips, each of the others is a row
        with an error.
    ValueError
        A key of ``over`` has no values.

    Examples
    --------
    >>> from enumerate import sweep
    >>> found = sweep("paper-400km", {"route.ambient_c": [10, 20], "vehicle.heat_pump_kw": [0]})
    >>> found.column("route.ambient_c"), len(found.column("plan.grid_kwh"))
    ([10, 20], 2)
    """
    name, fixed = str(trip), {k: _plain(v) for k, v in (overrides or {}).items()}
    task = task or partial(plan_task, gap=gap, time_limit_s=time_limit_s)
    values = {key: [_plain(v) for v in some] for key, some in over.items()}
    for key, some in values.items():
        if not some:
            raise ValueError(f"{key} has no values")
        if key in fixed:
            raise InputError(name, key, fixed[key], "a value of its own, or several to sweep over")
    grid = [dict(zip(values, point, strict=True)) for point in product(*values.values())]
    path = None if file is None else Path(file)
    store = _File(path, _identity(name, fixed, task))
    rows: dict[int, SweepRow] = {}
    places: dict[str, list[int]] = {}
    for index, variant in enumerate(grid):
        places.setdefault(json.dumps(variant), []).append(index)
    _check_variants(name, fixed, grid)
    for row in store.read():
        for index in places.get(json.dumps(row.variant), ()):
            rows[index] = SweepRow(index, row.variant, row.result, row.error, row.seconds)

    def keep(index: int, found: tuple[dict[str, Any] | None, str, float]) -> None:
        result, error, seconds = found
        if result is not None and result.get("interrupted") == STOPPED:
            raise KeyboardInterrupt  # the plan took it and returned what it had
        rows[index] = SweepRow(index, grid[index], result, error, seconds)
        store.write(rows[index])
        if progress is not None:
            progress(len(rows), len(grid), rows[index])

    call = partial(_call, name, fixed, task)
    interrupted = ""
    try:
        todo = [i for i in range(len(grid)) if i not in rows]
        if executor is not None:
            _on(executor, call, grid, todo, keep)
        elif workers > 1:
            for _ in range(MAX_POOLS):
                with ProcessPoolExecutor(workers) as pool:
                    _on(pool, call, grid, todo, keep)
                todo = [i for i in todo if i not in rows]
                if not todo:
                    break
        else:
            for index in todo:
                keep(index, call(grid[index]))
    except KeyboardInterrupt:
        interrupted = STOPPED
    missing = tuple(v for i, v in enumerate(grid) if i not in rows)
    if missing and not interrupted:
        interrupted = "a worker was lost or stopped"
    return Sweep(tuple(rows[i] for i in sorted(rows)), missing, interrupted)


def _check_variants(trip: str, fixed: Variant, grid: Sequence[Variant]) -> None:
    """Raise what is wrong with the first variant if its keys do not exist, or if all are wrong."""
    if not grid:
        return
    check_keys(trip, {**fixed, **grid[0]})
    first: InputError | None = None
    for variant in grid:
        try:
            load_trip(trip, {**fixed, **variant})
            return
        except InputError as error:
            first = first or error
    if first is not None:
        raise first


def _call(
    trip: str, fixed: Variant, task: Task, variant: Variant
) -> tuple[dict[str, Any] | None, str, float]:
    return _run(trip, {**fixed, **variant}, task)


def _on(
    executor: Executor,
    call: Callable[[Variant], tuple[dict[str, Any] | None, str, float]],
    grid: Sequence[Variant],
    todo: Sequence[int],
    keep: Callable[[int, tuple[dict[str, Any] | None, str, float]], None],
) -> None:
    """Run variants on an executor, keeping each as it comes, until done or a worker is lost."""
    futures = {}
    try:
        for index in todo:
            futures[executor.submit(call, grid[index])] = index
        for future in as_completed(futures):
            keep(futures[future], future.result())
    except BrokenExecutor:
        pass  # rows that came are kept; the others are missing
    finally:
        for future in futures:
            future.cancel()


def _plain(value: Any) -> Any:
    """Return a value of JSON types: numpy's numbers become Python's."""
    return json.loads(json.dumps(value, default=lambda v: v.tolist()))
