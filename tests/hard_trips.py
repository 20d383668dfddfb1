"""Owns short trips that are hard in a named way: where their chargers stand, and their weather.

What a kind asks for beyond that (limits, prices, times) stands with the tests that ask for it.
"""

from __future__ import annotations

from dataclasses import replace

from trips import small_trip

from relax.trip import Trip

__all__ = ["hard_trip"]


def hard_trip(kind: str, step_km: float) -> Trip:
    """Return 120 km in winter, or in summer, with three or four chargers and coarse cells.

    Every charger is dearer than the one before; the second is of the other kind. Names other
    than those below: three chargers apart from each other.
    """
    base = small_trip(
        ambient_c=33.0 if kind == "summer" else -12.0,
        start_soc=0.45,
        grid__cells=3,
        grid__step_km=step_km,
    )
    first, last = base.chargers
    length = base.route.length_km
    places = {
        "same node": (45.0, 45.0, 85.0),
        "ends": (0.0, 60.0, length),
        "two at the end": (45.0, length, length),
        "one step": (0.0, 0.0, length),
        "limits": (20.0, 45.0, 70.0, 100.0),
    }.get(kind, (45.0, 60.0, 85.0))
    chargers = tuple(
        replace(first if i != 1 else last, name=f"c{i}", position_km=x, price_per_kwh=0.4 + 0.1 * i)
        for i, x in enumerate(places)
    )
    return replace(base, chargers=chargers)
