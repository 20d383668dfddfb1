"""Owns the synthetic route ``long-1000km``: seeded speeds and hills. Writes nothing.

No road is meant. The route exists to give a planner many chargers on a trip of
several stops; its speeds and heights are drawn from a generator with a fixed seed.
Only ``Random.random`` is used, whose sequence Python keeps from version to version,
and only arithmetic follows, so the file is the same everywhere.
"""

from __future__ import annotations

from random import Random

import numpy as np
import numpy.typing as npt

from benchmarks.data.corridor import smooth

__all__ = ["LENGTH_KM", "draw", "elevation_m", "long_route_text", "speed_sections"]

Array = npt.NDArray[np.float64]

SEED = 1000
LENGTH_KM = 1000.0
SAMPLE_KM = 0.5

START: tuple[tuple[float, float], ...] = ((0.0, 50.0), (3.0, 70.0), (8.0, 90.0))
"""From km, mean speed [km/h] when leaving a town; arriving mirrors it."""
TOWN_KM = 12.0
"""Length of the stretch above [km]."""
PIECE_KM = (12.0, 30.0)
"""Length of a motorway piece of constant speed [km]."""
MOTORWAY_KMH = (107.0, 119.0)
SLOW_EVERY_KM = (60.0, 100.0)
"""Motorway between two slower stretches [km]: interchanges, roadworks, towns."""
SLOW_KM = (3.0, 7.0)
SLOW_KMH = (70.0, 90.0)

RELIEF_KM, RELIEF_M = 25.0, (20.0, 200.0)
"""Distance of the knots of the broad relief [km], their heights [m]."""
HILL_KM, HILL_M = 2.5, (-15.0, 15.0)
"""The same for single hills, on top."""
SMOOTH = 5
"""Samples of the running mean that rounds the knots."""

HEADER = f"""\
# A synthetic motorway trip of {LENGTH_KM:.0f} km: no real road. Licence: own numbers, Apache-2.0.
# Computed by `python -m benchmarks.data.routes` (benchmarks/data/long_route.py), seed {SEED}.
# Assumed: motorway in pieces at {MOTORWAY_KMH[0]:.0f} to {MOTORWAY_KMH[1]:.0f} km/h, slower \
stretches ({SLOW_KMH[0]:.0f} to {SLOW_KMH[1]:.0f} km/h), a town
# at both ends; heights: knots every {RELIEF_KM:.0f} km ({RELIEF_M[0]:.0f} to {RELIEF_M[1]:.0f} m) \
plus knots every {HILL_KM:g} km ({HILL_M[0]:+.0f} to {HILL_M[1]:+.0f} m),
# straight between, {SMOOTH * SAMPLE_KM:g} km mean.
"""


def draw(random: Random, between: tuple[float, float]) -> float:
    """Return a number drawn evenly from an interval.

    Examples
    --------
    >>> 3.0 <= draw(Random(1), (3.0, 4.0)) < 4.0
    True
    """
    return between[0] + (between[1] - between[0]) * random.random()


def speed_sections(random: Random) -> list[tuple[float, float]]:
    """Return the sections of constant speed: from km, mean speed [km/h].

    Borders fall on samples.

    Examples
    --------
    >>> speed_sections(Random(SEED))[:3]
    [(0.0, 50.0), (3.0, 70.0), (8.0, 90.0)]
    """

    def length(between: tuple[float, float]) -> float:
        return SAMPLE_KM * round(draw(random, between) / SAMPLE_KM)

    sections, at = list(START), TOWN_KM
    end = LENGTH_KM - TOWN_KM
    slow_at = at + length(SLOW_EVERY_KM)
    while at < end:
        if at >= slow_at:
            sections.append((at, float(round(draw(random, SLOW_KMH)))))
            at += length(SLOW_KM)
            slow_at = at + length(SLOW_EVERY_KM)
        else:
            sections.append((at, float(round(draw(random, MOTORWAY_KMH)))))
            at = min(at + length(PIECE_KM), slow_at)
    sections = [section for section in sections if section[0] < end]
    leaving = [*(start for start, _ in START[1:]), TOWN_KM]
    speeds = [speed for _, speed in START]
    arriving = [(LENGTH_KM - km, v) for km, v in zip(leaving, speeds, strict=True)]
    return sections + arriving[::-1]


def elevation_m(random: Random, border_km: Array) -> Array:
    """Return the heights at the borders of the samples.

    Parameters
    ----------
    random : Random
        Where the knots come from.
    border_km : ndarray, shape (n,)
        Positions [km].

    Returns
    -------
    ndarray, shape (n,)
        Heights [m].

    Examples
    --------
    >>> elevation_m(Random(SEED), np.arange(0.0, 100.1, 0.5)).shape
    (201,)
    """
    total: Array = np.zeros(border_km.size)
    for step, between in ((RELIEF_KM, RELIEF_M), (HILL_KM, HILL_M)):
        knot = np.arange(0.0, border_km[-1] + step, step)
        total += np.interp(border_km, knot, [draw(random, between) for _ in knot])
    return smooth(total, SMOOTH)


def long_route_text() -> str:
    """Return the text of the route file.

    Examples
    --------
    >>> text = long_route_text()
    >>> text.splitlines()[6].startswith("0.0,50.0,"), text == long_route_text()
    (True, True)
    """
    random = Random(SEED)
    starts, speeds = np.array(speed_sections(random)).T
    border = np.arange(0.0, LENGTH_KM + SAMPLE_KM / 2, SAMPLE_KM)
    speed = speeds[np.searchsorted(starts, border[:-1], side="right") - 1]
    height = elevation_m(random, border)
    rows = zip(border, np.append(speed, speed[-1]), height, strict=True)
    body = "".join(f"{s:.1f},{v:.1f},{z:.1f}\n" for s, v, z in rows)
    return HEADER + "distance_km,speed_kmh,elevation_m\n" + body
