"""Owns the named cases of the comparison: which trips, and what a case is called.

``paper/...`` are 27 variants of ``paper-400km``, ``corridor/...`` the other shipped trips,
``random/...`` trips of fixed seeds, taken as they come, on a finer grid than the tests use.
Knows nothing of solvers. The digest tells whether a stored row still belongs to its case.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from itertools import product
from math import inf
from typing import Any

import numpy as np

from benchmarks.random_trips import random_trip
from relax import load_trip, shipped_trips
from relax.trip import Grid, Trip

__all__ = [
    "CASES",
    "GROUPS",
    "PAPER_CASES",
    "SEEDS",
    "SMOKE",
    "Case",
    "digest",
    "load_paper",
    "select",
    "small",
]

PAPER = "paper-400km"
AMBIENT_C = (-10.0, 0.0, 10.0)
HEAT_PUMP_KW = (0.0, 1.0, 3.0)
TIME_VALUE_PER_H = (0.0, 40.0, 400.0)
PAPER_CASES = tuple(product(AMBIENT_C, HEAT_PUMP_KW, TIME_VALUE_PER_H))
"""Ambient temperature [degrees C], heat pump [kW], value of time [SEK/h]."""
SEEDS = tuple(range(1, 13))
"""Seeds of the random trips: the first twelve, none left out."""
LEAST_STEPS = 40
"""Driving steps of a random trip at least; else 4 km each."""
GROUPS = ("paper", "corridor", "random")
"""First part of a case's name."""


@dataclass(frozen=True)
class Case:
    """A trip with a name.

    Parameters
    ----------
    name : str
        ``group/...``, without spaces.
    load : callable
        Returns the trip.
    """

    name: str
    load: Callable[[], Trip]

    @property
    def group(self) -> str:
        """First part of the name."""
        return self.name.split("/", 1)[0]


def load_paper(ambient_c: float, heat_pump_kw: float, time_value_per_h: float) -> Trip:
    """Return a variant of the paper's trip.

    Examples
    --------
    >>> trip = load_paper(0.0, 3.0, 400.0)
    >>> trip.vehicle.heat_pump_kw, trip.time_value_per_h
    (3.0, 400.0)
    """
    return load_trip(
        PAPER,
        overrides={
            "route.ambient_c": ambient_c,
            "vehicle.heat_pump_kw": heat_pump_kw,
            "objective.time_value_per_h": time_value_per_h,
        },
    )


def _random(seed: int) -> Trip:
    """Return a random trip on a grid whose error does not hide what is compared.

    Without a limit on the time of all stops together: the peers do not know it.
    """
    trip = random_trip(seed)
    grid = Grid(min(4.0, trip.route.length_km / LEAST_STEPS), 12)
    return replace(trip, grid=grid, stop_time_h=inf)


def small(trip: Trip) -> Trip:
    """Return a trip with one charger less, on a coarse grid: a second or two for every solver.

    Examples
    --------
    >>> trip = small(load_paper(0.0, 1.0, 40.0))
    >>> len(trip.chargers), trip.grid.cells
    (2, 4)
    """
    return replace(trip, chargers=trip.chargers[1:], grid=Grid(20.0, 4))


def _smoke() -> Trip:
    return small(load_paper(0.0, 1.0, 40.0))


SMOKE = Case("smoke/paper", _smoke)
"""Not part of the comparison."""


def _cases() -> Iterator[Case]:
    for ambient, pump, value in PAPER_CASES:
        name = f"paper/{ambient:g}C-pump{pump:g}-time{value:g}"
        yield Case(name, partial(load_paper, ambient, pump, value))
    for trip in shipped_trips():
        if trip != PAPER:
            yield Case(f"corridor/{trip}", partial(load_trip, trip))
    for seed in SEEDS:
        yield Case(f"random/{seed:02d}", partial(_random, seed))


CASES = tuple(_cases())
"""All cases, in order."""


def select(patterns: Iterable[str]) -> tuple[Case, ...]:
    """Return the cases whose name matches one of the patterns (``*`` and ``?``); all without.

    Raises
    ------
    ValueError
        A pattern matches no case.

    Examples
    --------
    >>> [case.name for case in select(["paper/-10C-pump1-*"])][0]
    'paper/-10C-pump1-time0'
    >>> len(select([])) == len(CASES) >= 39
    True
    """
    asked = list(patterns)
    for pattern in asked:
        if not any(fnmatchcase(case.name, pattern) for case in (*CASES, SMOKE)):
            raise ValueError(f"no case matches {pattern!r}; names are like {CASES[0].name!r}")
    if not asked:
        return CASES
    return tuple(c for c in (*CASES, SMOKE) if any(fnmatchcase(c.name, p) for p in asked))


def _feed(hasher: Any, value: Any) -> None:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        hasher.update(type(value).__name__.encode())
        for entry in dataclasses.fields(value):
            hasher.update(entry.name.encode())
            _feed(hasher, getattr(value, entry.name))
    elif isinstance(value, np.ndarray):
        hasher.update(str(value.shape).encode() + value.astype(np.float64).tobytes())
    elif isinstance(value, list | tuple):
        hasher.update(f"[{len(value)}".encode())
        for entry in value:
            _feed(hasher, entry)
    else:
        hasher.update(repr(value).encode())


def digest(trip: Trip) -> str:
    """Return twelve hexadecimal digits that change with any value of a trip, its grid included.

    Examples
    --------
    >>> trip = SMOKE.load()
    >>> digest(trip) == digest(SMOKE.load()), digest(trip) == digest(replace(trip, start_soc=0.8))
    (True, False)
    """
    hasher = hashlib.sha256()
    _feed(hasher, trip)
    return hasher.hexdigest()[:12]
