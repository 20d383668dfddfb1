"""Owns the cases A to E at -10 C: stop sets, ties, and what the trajectories do.

Values and margins of A, B, C and E are those of the fronts' ends; D is a plan of its own. The
trajectories shown are the best ones *with the published stops*, also where another choice ties.
``Behaviour`` measures in a trajectory what the paper describes in words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from benchmarks.paper.fronts import At, by_set, least_energy, least_time, runner_up
from benchmarks.paper.kept import plain, report_from, report_to
from benchmarks.paper.published import CASES, SWEEP_TIME_VALUE_PER_H, Case
from benchmarks.paper.trips import FAST_PER_H, paper_trip
from enumerate import plan
from enumerate.subset import Subset
from relax.bound import relax_subset
from relax.execute import execute
from relax.instance import make_instance
from relax.refinement import best_of, refine
from relax.report import PlanReport, make_report
from relax.starts import best_start, split_starts
from relax.trip import Trip

__all__ = [
    "AMBIENT_C",
    "TIE",
    "Behaviour",
    "Found",
    "all_found",
    "behaviour",
    "case_row",
    "case_trip",
    "found",
    "published_plan",
    "time_value",
]

AMBIENT_C = -10.0
"""Of all cases."""
TIE = {"energy": 0.1, "time": 0.1, "cost": 0.87}
"""Difference below which two choices of stops tie: 0.1 kWh, 0.1 min, the price of 0.1 kWh."""
UNIT = {"energy": "kWh", "time": "min", "cost": "SEK"}
BEFORE_KM = 12.0
"""What counts as just before a stop: three of the paper's steps."""
FIRST_CELLS = 3
"""What counts as the first part of a stop: cells of twelve."""
USELESS = 0.01
"""Efficiency of a battery heater that no plan uses."""
OFF_KW = 0.02
"""Mean power below which a device counts as off."""
Row = Mapping[str, Any]


def case_trip(case: Case) -> Trip:
    """Return the trip whose cheapest plan is the case.

    Examples
    --------
    >>> from benchmarks.paper.published import CASES
    >>> [case_trip(c).time_value_per_h for c in CASES]
    [0.0, 0.0, 0.0, 40.0, 20000.0]
    """
    return paper_trip(AMBIENT_C, case.heat_pump_kw, time_value(case))


def time_value(case: Case) -> float:
    """Return the value of time whose cheapest plan is the case [SEK/h]."""
    return {"energy": 0.0, "cost": SWEEP_TIME_VALUE_PER_H, "time": FAST_PER_H}[case.aim]


def published_plan(trip: Trip, stops: Subset) -> PlanReport:
    """Return the best plan of a trip that uses the stops which the paper states, driven.

    Parameters
    ----------
    trip : Trip
        Of ``case_trip``.
    stops : tuple of int
        Chargers to use, by index.

    Raises
    ------
    RuntimeError
        No plan with these stops holds on the continuous model.
    """
    instance = make_instance(trip, stops)
    relaxed = relax_subset(instance)
    bound = -inf if relaxed.lower_bound is None else relaxed.lower_bound
    best = refine(instance, best_start(instance, relaxed.point, bound))
    if len(stops) > 1:
        splits = [refine(instance, s) for s in split_starts(instance, best.controls)]
        best = best_of([best, *splits], instance)
    done = execute(trip, instance, best)
    if done.reason:
        raise RuntimeError(f"stops {stops}: {done.reason}")
    return make_report(trip, instance, done)


def case_row(trip: Trip, stops: Subset, gap: float | None) -> dict[str, Any]:
    """Return the plan with the published stops; with a gap also every other, certified."""
    best = published_plan(trip, stops)
    row: dict[str, Any] = {"published": report_to(best), "unheated_kwh": 0.0}
    if trip.time_value_per_h == 0.0:
        car = replace(trip.vehicle, heater_battery_efficiency=USELESS)
        without = published_plan(replace(trip, vehicle=car), stops)
        row["unheated_kwh"] = plain(without.grid_kwh - best.grid_kwh)
    if gap is None:
        return row
    result = plan(trip, gap=gap, prune=False)
    assert result.plan is not None
    names = list(result.chargers)
    found = plain(
        {
            "value": result.cost,
            "lower_bound": result.lower_bound,
            "stops": [names.index(s.charger) for s in result.plan.stops],
            "costs": [[list(r.subset), r.cost] for r in result.ledger.rows],
            "timings_s": result.timings_s,
        }
    )
    assert isinstance(found, dict)
    return row | found


@dataclass(frozen=True)
class Found:
    """One case as it came out.

    Parameters
    ----------
    case : Case
        The paper's.
    at : At
        Value, bound and stops of the best plan [kWh, min or SEK].
    other : tuple of int
        The best other choice of stops.
    margin : float
        How much worse the published choice is than the best other one, negative: better
        [kWh, min or SEK]. On the transcription.
    report : PlanReport
        The best plan with the published choice.
    unheated_kwh : float
        How much more it charges without battery heating; 0 for other aims than energy.
    """

    case: Case
    at: At
    other: Subset
    margin: float
    report: PlanReport
    unheated_kwh: float = 0.0

    @property
    def unit(self) -> str:
        """Of value and margin."""
        return UNIT[self.case.aim]

    @property
    def verdict(self) -> str:
        """What can be said of the published choice of stops."""
        if abs(self.margin) < TIE[self.case.aim]:
            return "tie"
        return "as published" if self.margin < 0.0 else "not as published"


def found(case: Case, fronts: Mapping[tuple[float, float], Row], own: Row | None) -> Found | None:
    """Return a case from the rows, None if they are not there yet.

    Parameters
    ----------
    case : Case
        Which.
    fronts : mapping
        Rows by ambient temperature and heat pump.
    own : mapping or None
        Row of ``case_row``.
    """
    if own is None:
        return None
    if case.aim == "cost":
        at = At(own["value"], own["lower_bound"], inf, tuple(own["stops"]))
        values = {tuple(s): cost for s, cost in own["costs"] if cost is not None}
    else:
        row = fronts.get((AMBIENT_C, case.heat_pump_kw))
        if row is None:
            return None
        names = tuple(c.name for c in case_trip(case).chargers)
        at = least_energy(row) if case.aim == "energy" else least_time(row)
        values = by_set(row, case.aim, names)
    other, ahead = runner_up(values, case.stops)
    report = report_from(own["published"])
    return Found(case, at, other, -ahead, report, own["unheated_kwh"])


@dataclass(frozen=True)
class Behaviour:
    """What a trajectory does, in figures.

    Parameters
    ----------
    heating_kwh : float
        Battery heater in all.
    heating_before_kwh, heating_at_stops_kwh : float
        Of which driving before the last stop and at stops.
    final_c : float
        Battery temperature at the destination.
    arrive_c, depart_c : tuple of float
        At the stops.
    pump_before_kw, pump_first_kw, pump_else_kw : tuple of float
        Mean heat-pump power in the last 12 km before each stop, in the first quarter of
        its energy, and on the rest of the leg before it.
    heater_full : tuple of float
        Share of each stop's dwell with the heater, cabin and battery together, at full power.
    pump_at_stops_kwh : float
        Heat pump at the stops.
    """

    heating_kwh: float
    heating_before_kwh: float
    heating_at_stops_kwh: float
    final_c: float
    arrive_c: tuple[float, ...]
    depart_c: tuple[float, ...]
    pump_before_kw: tuple[float, ...]
    pump_first_kw: tuple[float, ...]
    pump_else_kw: tuple[float, ...]
    heater_full: tuple[float, ...]
    pump_at_stops_kwh: float


def behaviour(report: PlanReport, heater_kw: float) -> Behaviour:
    """Return the behaviour of a plan.

    Parameters
    ----------
    report : PlanReport
        The plan.
    heater_kw : float
        Full power of the heater [kW].
    """
    drive = report.drive
    hours, start = drive.duration_h, drive.node_km[:-1]
    places = [s.position_km for s in report.stops]
    before, first, rest, full = [], [], [], []
    at_stops, pump_at_stops = 0.0, 0.0
    last = 0.0
    for place, trace in zip(places, report.charge, strict=True):
        near = (start >= place - BEFORE_KM - 1e-9) & (start < place - 1e-9)
        leg = (start >= last - 1e-9) & (start < place - BEFORE_KM - 1e-9)
        before.append(_mean(drive.heat_pump_kw[near], hours[near]))
        rest.append(_mean(drive.heat_pump_kw[leg], hours[leg]))
        dwell = np.diff(trace.time_h)
        first.append(_mean(trace.heat_pump_kw[:FIRST_CELLS], dwell[:FIRST_CELLS]))
        both = trace.battery_heater_kw + trace.cabin_heater_kw
        full.append(float(dwell[both >= 0.98 * heater_kw].sum() / dwell.sum()))
        at_stops += float(trace.battery_heater_kw @ dwell)
        pump_at_stops += float(trace.heat_pump_kw @ dwell)
        last = place
    driving = drive.battery_heater_kw * hours
    return Behaviour(
        heating_kwh=float(driving.sum()) + at_stops,
        heating_before_kwh=float(driving[start < last - 1e-9].sum()),
        heating_at_stops_kwh=at_stops,
        final_c=report.final_temperature_c,
        arrive_c=tuple(s.arrive_temperature_c for s in report.stops),
        depart_c=tuple(s.depart_temperature_c for s in report.stops),
        pump_before_kw=tuple(before),
        pump_first_kw=tuple(first),
        pump_else_kw=tuple(rest),
        heater_full=tuple(full),
        pump_at_stops_kwh=pump_at_stops,
    )


def _mean(values: Any, weights: Any) -> float:
    total = float(np.sum(weights))
    return float(np.sum(values * weights)) / total if total > 0.0 else 0.0


def all_found(fronts: Mapping[tuple[float, float], Row], own: Mapping[str, Row]) -> list[Found]:
    """Return the cases that the rows hold; ``own`` by the cases' names."""
    each = (found(case, fronts, own.get(case.name)) for case in CASES)
    return [f for f in each if f is not None]
