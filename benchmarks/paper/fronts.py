"""Owns the fronts of charged energy against time: nine trips, certified.

Tables and cases are read off them. One row per ambient temperature and heat pump holds the
front's points with their gaps and the curve of every choice of stops.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from benchmarks.paper.kept import plain
from benchmarks.paper.published import ENERGY_AT_MIN
from enumerate import pareto
from enumerate.subset import Subset
from relax.trip import Trip

__all__ = [
    "ABOVE_LEAST_MIN",
    "GAP",
    "TIMES_MIN",
    "At",
    "by_set",
    "energy_at",
    "front_row",
    "least_energy",
    "least_time",
    "runner_up",
]

GAP = 0.01
"""Relative gap asked for."""
TIMES_MIN = {
    -10.0: (24.0, 24.25, 24.5, 25.0, 25.5, 26.0, 26.25, 26.5, 27.0, 28.0, 29.0, 30.0, 32.0, 35.0),
    0.0: (15.75, 16.0, 16.5, 17.0, 18.0, 20.0, 22.0, 22.35, 22.4, 22.5, 22.6, 23.0, 24.0, 26.0),
    10.0: (14.3, 14.5, 14.75, 15.0, 15.5, 16.0, 17.0, 18.0, 19.0, 20.0),
}
"""Times that are looked at beside the ends of each front [min]."""
ABOVE_LEAST_MIN = 0.1
"""The energy "at 22 min" is read at most so far above the least time where the published
time lies below it [min]."""
Row = Mapping[str, Any]


def front_row(trip: Trip, times_min: Mapping[float, Sequence[float]], gap: float) -> dict[str, Any]:
    """Return the front of a trip as a row.

    Parameters
    ----------
    trip : Trip
        Its value of time is of no effect.
    times_min : mapping
        Times to look at, by ambient temperature [min].
    gap : float
        To be certified.
    """
    times = times_min[float(trip.route.ambient_c[0])]
    front = pareto(trip, times_h=[t / 60.0 for t in times], gap=gap, every_subset=True)
    found = plain(front.to_dict())
    assert isinstance(found, dict)
    return found


@dataclass(frozen=True)
class At:
    """One figure read off a front.

    Parameters
    ----------
    value : float
        Charged energy [kWh] or charging and detour time [min].
    lower_bound : float
        No plan has less.
    at_min : float
        Time allowed for charging and detours [min]; ``inf``: no limit.
    stops : tuple of int
        Chargers used, by index.
    """

    value: float
    lower_bound: float
    at_min: float
    stops: Subset

    @property
    def gap(self) -> float:
        """Relative distance to the bound.

        Examples
        --------
        >>> At(2.0, 1.5, inf, (1,)).gap
        0.25
        """
        return max(0.0, 1.0 - self.lower_bound / self.value)


def energy_at(row: Row, ambient_c: float) -> At:
    """Return the least energy within the table's time, or just above the least time."""
    least = 60.0 * row["points"][0]["time_h"]
    limit = max(ENERGY_AT_MIN[ambient_c], least + ABOVE_LEAST_MIN)
    slack = 0.03  # s of the drive against the transcription: 1.8 s, as in Front.at [min]
    within = [p for p in row["points"] if 60.0 * p["time_h"] <= limit + slack]
    point = within[-1]
    at = 60.0 * max(point["time_h"], point["budget_h"] or point["time_h"])
    return At(point["value"], point["lower_bound"], at, tuple(point["subset"]))


def least_energy(row: Row) -> At:
    """Return the least energy at any time."""
    point = row["points"][-1]
    return At(point["value"], point["lower_bound"], inf, tuple(point["subset"]))


def least_time(row: Row) -> At:
    """Return the least charging and detour time [min]."""
    point = row["points"][0]
    minutes, least = 60.0 * point["time_h"], 60.0 * point["least_time_h"]
    return At(minutes, least, minutes, tuple(point["subset"]))


def by_set(row: Row, aim: str, names: tuple[str, ...]) -> dict[Subset, float]:
    """Return the best plan per choice of stops, on the transcription.

    Parameters
    ----------
    row : mapping
        Of ``front_row``.
    aim : {"energy", "time"}
        Least energy [kWh] or least time [min].
    names : tuple of str
        The chargers, by index.
    """
    found = {}
    for curve in row["curves"]:
        stops = tuple(names.index(n) for n in curve["stops"])
        if aim == "energy":
            found[stops] = min(p["value"] for p in curve["points"])
        else:
            found[stops] = 60.0 * min(p["time_h"] for p in curve["points"])
    return found


def runner_up(values: Mapping[Subset, float], stops: Subset) -> tuple[Subset, float]:
    """Return the best other choice of stops and how much worse it is; negative: better.

    Examples
    --------
    >>> runner_up({(1,): 34.0, (1, 2): 33.5, (0,): 50.0}, (1, 2))
    ((1,), 0.5)
    """
    others = {s: v for s, v in values.items() if s != stops}
    if not others:
        return (), inf
    best = min(others, key=lambda s: others[s])
    return best, others[best] - values[stops]
