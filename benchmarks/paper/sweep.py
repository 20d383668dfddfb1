"""Owns the sweep over ambient temperature: energy, stops and saving at 40 SEK/h. Not fitted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from benchmarks.paper.kept import plain
from benchmarks.paper.published import HEAT_PUMP_KW
from enumerate import plan
from relax.trip import Trip

__all__ = ["AMBIENT_C", "Point", "markdown", "point_row", "points", "switches"]

AMBIENT_C = tuple(float(t) for t in range(-15, 22))
"""Every degree from -15 to 21 C."""
Row = Mapping[str, Any]


def point_row(trip: Trip, gap: float) -> dict[str, Any]:
    """Return the certified plan of one trip as a row, without its arrays."""
    result = plan(trip, gap=gap)
    report = result.plan
    value = {
        "status": result.status.value,
        "cost": result.cost,
        "lower_bound": result.lower_bound,
        "gap": result.gap,
        "stops": [] if report is None else [s.charger for s in report.stops],
        "grid_kwh": None if report is None else report.grid_kwh,
        "minutes": None if report is None else 60.0 * (report.charging_h + report.detour_h),
        "heating_kwh": None if report is None else report.totals_kwh["battery_heater"],
        "timings_s": result.timings_s,
    }
    found = plain(value)
    assert isinstance(found, dict)
    return found


@dataclass(frozen=True)
class Point:
    """One plan of the sweep.

    Parameters
    ----------
    ambient_c, heat_pump_kw : float
        Where.
    grid_kwh, minutes : float
        Charged energy; charging and detour time.
    stops : tuple of str
        Chargers used.
    gap : float
        Certified relative gap of its cost.
    saving : float or None
        Energy saved against no heat pump [%].
    """

    ambient_c: float
    heat_pump_kw: float
    grid_kwh: float
    minutes: float
    stops: tuple[str, ...]
    gap: float
    saving: float | None


def points(rows: Mapping[tuple[float, float], Row]) -> list[Point]:
    """Return the points of the rows that hold a plan, by heat pump and temperature.

    Parameters
    ----------
    rows : mapping
        By ambient temperature and heat pump.
    """
    found = []
    for (t, p), row in sorted(rows.items(), key=lambda item: (item[0][1], item[0][0])):
        if row["grid_kwh"] is None:
            continue
        without = rows.get((t, 0.0))
        saving = None
        if p > 0.0 and without is not None and without["grid_kwh"] is not None:
            saving = 100.0 * (1.0 - row["grid_kwh"] / without["grid_kwh"])
        stops, minutes = tuple(row["stops"]), row["minutes"]
        found.append(Point(t, p, row["grid_kwh"], minutes, stops, row["gap"], saving))
    return found


def switches(found: Iterable[Point], heat_pump_kw: float) -> list[tuple[float, str, str]]:
    """Return where the choice of stops changes: midpoint in between, choices before and after.

    Examples
    --------
    >>> a = Point(0.0, 1.0, 30.0, 20.0, ("km 200",), 0.01, None)
    >>> b = Point(1.0, 1.0, 29.0, 20.0, ("km 300",), 0.01, None)
    >>> switches([a, b], 1.0)
    [(0.5, 'km 200', 'km 300')]
    """
    own = sorted((p for p in found if p.heat_pump_kw == heat_pump_kw), key=lambda p: p.ambient_c)
    return [
        (0.5 * (a.ambient_c + b.ambient_c), " + ".join(a.stops), " + ".join(b.stops))
        for a, b in pairwise(own)
        if a.stops != b.stops
    ]


def markdown(found: Iterable[Point]) -> str:
    """Return the table of the sweep, every third degree; all are in the result file."""
    by = {(p.ambient_c, p.heat_pump_kw): p for p in found}
    lines = [
        "| ambient | off: kWh, stops | 1 kW: kWh, stops | 3 kW: kWh, stops | saving 1 kW | 3 kW "
        "| largest gap |",
        "|---:|---|---|---|---:|---:|---:|",
    ]
    for t in AMBIENT_C[::3]:
        row = [by.get((t, p)) for p in HEAT_PUMP_KW]
        if any(p is None for p in row):
            continue
        full = [p for p in row if p is not None]
        cells = [f"{p.grid_kwh:.2f}, {len(p.stops)}" for p in full]
        saved = [f"{p.saving:.1f} %" for p in full if p.saving is not None]
        gap = max(p.gap for p in full)
        lines.append(f"| {t:.0f} °C | {' | '.join([*cells, *saved])} | {100.0 * gap:.1f} % |")
    return "\n".join(lines)
