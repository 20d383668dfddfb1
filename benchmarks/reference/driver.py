"""Owns what a plan is worth to a driver: its savings against drivers who follow rules.

Both are replayed on the continuous model. Knows nothing of how either was found.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

from benchmarks.reference.driver_rules import (
    PLAIN,
    PREHEATING,
    DriverRules,
    DriverTrip,
    drive_by_rules,
)
from relax.trip import Trip

if TYPE_CHECKING:
    from enumerate.result import Result
    from relax.driven import Replay

__all__ = [
    "PLAIN",
    "PREHEATING",
    "DriverRow",
    "DriverRules",
    "DriverTrip",
    "drive_by_rules",
    "value_to_driver",
]

MINUTES_PER_H = 60.0
"""Savings of time are stated in minutes."""


@dataclass(frozen=True)
class DriverRow:
    """One way to make a trip, and what the optimal plan saves against it.

    Parameters
    ----------
    driver : str
        Who drives; the first row is the optimal plan.
    reason : str
        Why it fails; empty if it gets there. Then all figures are NaN.
    stops : tuple of str
        Chargers used.
    cost : float
        Replayed cost [currency].
    grid_kwh : float
        Charged energy.
    charging_h, stop_h : float
        Dwell; dwell and detours [h].
    saved_cost, saved_share : float
        What the optimal plan saves [currency, share of this driver's cost].
    saved_min, saved_kwh : float
        Time of charging and detours, and grid energy, that it saves [min, kWh];
        negative where it takes more.
    """

    driver: str
    reason: str
    stops: tuple[str, ...]
    cost: float
    grid_kwh: float
    charging_h: float
    stop_h: float
    saved_cost: float
    saved_share: float
    saved_min: float
    saved_kwh: float


def _row(trip: Trip, name: str, driven: Replay, best: Replay) -> DriverRow:
    """Return a row from two replays."""

    def hours(replay: Replay) -> tuple[float, float]:
        dwell = sum(s.dwell_h for s in replay.stops)
        return dwell, dwell + sum(trip.chargers[s.charger].detour_h for s in replay.stops)

    charging, stopped = hours(driven)
    saved = driven.cost - best.cost
    return DriverRow(
        driver=name,
        reason="",
        stops=tuple(trip.chargers[s.charger].name for s in driven.stops),
        cost=driven.cost,
        grid_kwh=driven.totals_kwh["grid"],
        charging_h=charging,
        stop_h=stopped,
        saved_cost=saved,
        saved_share=saved / driven.cost if driven.cost else 0.0,
        saved_min=MINUTES_PER_H * (stopped - hours(best)[1]),
        saved_kwh=driven.totals_kwh["grid"] - best.totals_kwh["grid"],
    )


def value_to_driver(
    trip: Trip,
    result: Result | None = None,
    rules: tuple[DriverRules, ...] = (PLAIN, PREHEATING),
) -> tuple[DriverRow, ...]:
    """Return what the optimal plan saves against drivers with rules.

    Parameters
    ----------
    trip : Trip
        The trip.
    result : Result, optional
        Of ``plan(trip)``; planned here if not given.
    rules : tuple of DriverRules
        The drivers.

    Returns
    -------
    tuple of DriverRow
        The optimal plan first, then one row per driver, in order.

    Raises
    ------
    ValueError
        There is no optimal plan to compare with.

    Examples
    --------
    >>> from relax import load_trip
    >>> rows = value_to_driver(load_trip("paper-400km"))
    >>> [row.driver for row in rows], all(row.saved_cost >= 0.0 for row in rows)
    (['optimal plan', 'no preheating', 'preheating'], True)
    """
    if result is None:
        from enumerate import plan

        result = plan(trip)
    if result.replay is None or not result.is_feasible:
        raise ValueError(f"{trip.name}: no plan to compare drivers with")
    best = result.replay
    rows = [_row(trip, "optimal plan", best, best)]
    for rule in rules:
        done = drive_by_rules(trip, rule)
        if done.reason or done.replay is None:
            used = tuple(trip.chargers[i].name for i in done.subset)
            rows.append(DriverRow(rule.name, done.reason, used, *(nan,) * 8))
        else:
            rows.append(_row(trip, rule.name, done.replay, best))
    return tuple(rows)
