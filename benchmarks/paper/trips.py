"""Owns the trips of the experiments: ``paper-400km`` with a few values replaced."""

from __future__ import annotations

from typing import Any

from benchmarks.data.paper import Fit, overrides
from relax import load_trip
from relax.trip import Trip

__all__ = ["FAST_PER_H", "paper_trip", "shipped_or"]

FAST_PER_H = 20000.0
"""Value of time that stands for least time: the energy of a stop then weighs less than a
second, and decides between equally fast plans [SEK/h]."""


def paper_trip(
    ambient_c: float,
    heat_pump_kw: float,
    time_value_per_h: float = 0.0,
    stop_time_h: float | None = None,
    fit: Fit | None = None,
) -> Trip:
    """Return the paper's trip.

    Parameters
    ----------
    ambient_c, heat_pump_kw : float
        Ambient temperature, at which the battery starts [degrees C]; size of the heat pump [kW].
    time_value_per_h : float
        Value of charging and detour time [SEK/h].
    stop_time_h : float, optional
        Most charging and detour time [h].
    fit : Fit, optional
        Another car than the shipped one.

    Examples
    --------
    >>> trip = paper_trip(10.0, 3.0, 40.0)
    >>> trip.start_temperature_c, trip.vehicle.heat_pump_kw, trip.time_value_per_h
    (10.0, 3.0, 40.0)
    """
    given = shipped_or(fit) | {
        "route.ambient_c": ambient_c,
        "vehicle.heat_pump_kw": heat_pump_kw,
        "objective.time_value_per_h": time_value_per_h,
    }
    if stop_time_h is not None:
        given["limits.stop_time_h"] = stop_time_h
    return load_trip("paper-400km", given)


def shipped_or(fit: Fit | None) -> dict[str, Any]:
    """Return the overrides that make the car of a fit; none for the shipped one."""
    return {} if fit is None else dict(overrides(fit))
