"""The front of energy or cost against time: monotone, above its bounds, no budget finds a plan
below them, complete where no weighted sum reaches, the same for any pool."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from trips import small_trip, write_trip

from enumerate import Front, pareto, plan
from enumerate.cli_studies import pareto as command
from enumerate.front import Cut, earliest_h, front_gap, least_value
from enumerate.stretch import Corner, make_stretches
from relax import load_trip
from relax.trip import Trip

COARSE: dict[str, Any] = {"grid__step_km": 8.0, "grid__cells": 6, "start_soc": 0.4}
TRIPS: dict[str, tuple[Trip, str]] = {
    "one stop": (small_trip(**COARSE), "energy"),
    "fast or cheap": (small_trip(**COARSE), "cost"),
    "two stops": (
        load_trip(
            "paper-400km", {"route.ambient_c": 0, "vehicle.heat_pump_kw": 0, "grid.step_km": 8}
        ),
        "energy",
    ),
}


@pytest.fixture(scope="module")
def fronts() -> dict[str, Front]:
    return {
        name: pareto(trip, points=6, measure=measure, gap=0.02)  # type: ignore[arg-type]
        for name, (trip, measure) in TRIPS.items()
    }


def measured(trip: Trip, measure: str) -> Trip:
    """Return the trip whose cost at no value of time is the front's value."""
    if measure == "cost":
        return replace(trip, time_value_per_h=0.0)
    free = [
        replace(c, price_per_kwh=1.0, occupancy_price_per_h=0.0, stop_penalty=0.0)
        for c in trip.chargers
    ]
    return replace(trip, chargers=tuple(free), time_value_per_h=0.0)


@pytest.mark.parametrize("name", TRIPS)
def test_the_front_is_monotone_and_proved(name: str, fronts: dict[str, Front]) -> None:
    front = fronts[name]
    times, values = ([getattr(p, k) for p in front.points] for k in ("time_h", "value"))
    assert len(times) >= 5
    assert all(b > a for a, b in pairwise(times))
    assert all(b < a for a, b in pairwise(values))
    assert all(p.proved and p.front_gap <= 0.02 for p in front.points)
    assert front.gap == max(p.front_gap for p in front.points)
    bounds = [front.lower_bound(t) for t in times]
    assert bounds == sorted(bounds, reverse=True)


@pytest.mark.parametrize("name", TRIPS)
def test_a_point_is_its_plan_and_lies_above_its_bounds(name: str, fronts: dict[str, Front]) -> None:
    trip, measure = TRIPS[name]
    for p in fronts[name].points:
        assert p.lower_bound <= p.value and p.least_time_h <= p.time_h * (1.0 + 1e-6)
        assert p.front_gap <= min(p.gap, p.time_gap) + 1e-6
        assert p.time_h == pytest.approx(p.plan.stop_time_h)
        assert p.time_h == pytest.approx(p.charging_h + p.detour_h)
        assert p.energy_kwh == p.plan.grid_kwh
        assert p.stops == tuple(s.charger for s in p.plan.stops)
        at_own_prices = 0.0
        for index, stop in zip(p.subset, p.plan.stops, strict=True):
            spec = trip.chargers[index]
            occupied = max(0.0, stop.dwell_h - spec.occupancy_free_h)
            paid = spec.price_per_kwh * stop.grid_kwh + spec.stop_penalty
            paid += spec.occupancy_price_per_h * occupied
            assert stop.cost == pytest.approx(paid)
            at_own_prices += paid
        assert abs(p.plan.deviation.cost) < 0.01, "driven and on the grid at the same prices"
        expected = p.energy_kwh if measure == "energy" else at_own_prices
        assert p.value == pytest.approx(expected)


@pytest.mark.parametrize("name", TRIPS)
def test_no_budget_finds_a_plan_below_the_bounds(name: str, fronts: dict[str, Front]) -> None:
    """Plans of the whole search within budgets: of a grid of their own, and of the points."""
    trip, measure = TRIPS[name]
    front = fronts[name]
    first, last = front.points[0].time_h, front.points[-1].time_h
    budgets = [first + share * (last - first) for share in (0.05, 0.3, 0.8, 1.2)]
    for budget in [*budgets, *(p.time_h for p in front.points[2::3])]:
        found = plan(replace(measured(trip, measure), stop_time_h=budget))
        assert found.plan is not None
        value, time = found.transcribed_cost, found.plan.stop_time_h
        assert value >= front.lower_bound(budget) * (1.0 - 1e-9)
        for p in front.points:
            assert value >= p.lower_bound or time > p.time_h - 1e-4
            assert value > 0.98 * p.value - 1e-6 or time > 0.98 * p.time_h
        # and the front is as good as the search: a point at the budget is no dearer
        near = [p for p in front.points if abs(p.time_h - budget) < 1e-9]
        assert all(value > 0.998 * p.value for p in near)


def test_the_ends_are_the_least_time_and_the_least_value(fronts: dict[str, Front]) -> None:
    for name, (trip, measure) in TRIPS.items():
        front, own = fronts[name], measured(trip, measure)
        least = plan(own)
        assert least.transcribed_cost == pytest.approx(front.points[-1].value, rel=2e-3)
        free = [
            replace(c, price_per_kwh=0.0, occupancy_price_per_h=0.0, stop_penalty=0.0)
            for c in trip.chargers
        ]
        hurried = plan(replace(trip, chargers=tuple(free), time_value_per_h=60.0))
        assert hurried.transcribed_cost / 60.0 == pytest.approx(front.points[0].time_h, rel=5e-3)
        assert front.lower_bound(0.9 * front.points[0].time_h) == inf


def hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Lower convex hull of points sorted by time."""
    kept: list[tuple[float, float]] = []
    for t, v in points:
        while len(kept) > 1:
            (a, x), (b, y) = kept[-2:]
            if (y - x) * (t - a) < (v - x) * (b - a):
                break
            kept.pop()
        kept.append((t, v))
    return kept


def test_parts_that_no_weighted_sum_reaches_are_found(fronts: dict[str, Front]) -> None:
    """Between a fast dear charger and a slow cheap one the front is not convex."""
    trip, _ = TRIPS["fast or cheap"]
    front = fronts["fast or cheap"]
    corners = [(p.time_h, p.value) for p in front.points]
    low = hull(corners)
    above = {
        p.time_h: p.value - float(np.interp(p.time_h, *zip(*low, strict=True)))
        for p in front.points
    }
    inner = [t for t, height in above.items() if height > 0.05]
    assert len(inner) >= 3 and max(above.values()) > 0.5
    assert {p.stops for p in front.points} == {("Fast",), ("Cheap",)}
    weighted = set()
    for value in (1.0, 5.0, 10.0, 15.0, 17.0, 18.0, 19.0, 20.0, 25.0, 30.0, 100.0):
        found = plan(replace(trip, time_value_per_h=value)).plan
        assert found is not None
        weighted.add(round(60.0 * found.stop_time_h, 2))
    lo, hi = 60.0 * min(inner), 60.0 * max(inner)
    assert not any(lo - 0.01 < t < hi + 0.01 for t in weighted)
    assert min(weighted) < lo and max(weighted) > hi


def test_curves_show_where_one_choice_takes_over(fronts: dict[str, Front]) -> None:
    front = fronts["fast or cheap"]
    fast, cheap = front.curves[(0,)], front.curves[(1,)]
    assert fast[-1].time_h < cheap[0].time_h and fast[-1].value > cheap[0].value
    for p in front.points:
        curve = front.curves[p.subset]
        near = min(curve, key=lambda c: abs(c.time_h - p.time_h))
        assert near.value == pytest.approx(p.value, rel=0.02)


def test_times_are_looked_at_as_asked() -> None:
    trip, _ = TRIPS["one stop"]
    asked = [0.21, 0.24, 0.27, 0.05]
    front = pareto(trip, times_h=asked, gap=None, every_subset=True)
    budgets = [p.budget_h for p in front.points]
    assert set(asked) - {0.05} <= set(budgets)
    assert set(front.curves) == {(0,), (1,), (0, 1)}
    for t in asked[:3]:
        assert front.at(t).budget_h == t and front.at(t).time_h <= t + 1.1e-4
    with pytest.raises(ValueError, match=r"within 3\.00 min"):
        front.at(0.05)
    late = pareto(trip, points=3, gap=None, latest_h=0.24)
    assert late.points[-1].time_h <= 0.24 + 1e-3
    assert late.points[-1].value == pytest.approx(front.at(0.24).value, rel=1e-3)


def test_threads_change_nothing() -> None:
    trip, _ = TRIPS["fast or cheap"]

    def told(front: Front) -> str:
        found = front.to_dict()
        del found["timings_s"]
        return json.dumps(found, allow_nan=False)

    alone = pareto(trip, points=3, measure="cost", gap=0.08)
    with ThreadPoolExecutor(3) as pool:
        assert told(pareto(trip, points=3, measure="cost", gap=0.08, executor=pool)) == told(alone)


def test_a_time_limit_and_ctrl_c_return_what_is_known() -> None:
    trip, _ = TRIPS["one stop"]
    none = pareto(trip, time_limit_s=0.0)
    assert none.interrupted == "time limit reached" and none.lower_bound(0.3) <= 14.0
    calls = 0

    def stop(progress: object) -> None:
        nonlocal calls
        calls += 1
        if "prove" in str(progress):
            raise KeyboardInterrupt

    front = pareto(trip, points=3, progress=stop)
    assert front.interrupted == "interrupted" and len(front.points) >= 3 and calls > 3
    assert all(p.lower_bound <= p.value for p in front.points)


def test_a_trip_without_need_to_charge_has_one_point() -> None:
    front = pareto(small_trip(start_soc=0.9, grid__step_km=20.0), points=3)
    (only,) = front.points
    assert (only.time_h, only.value, only.stops, only.proved) == (0.0, 0.0, (), True)


def test_a_trip_without_a_plan_has_none() -> None:
    front = pareto(small_trip(start_soc=0.06, grid__step_km=20.0), points=3)
    assert front.points == () and front.gap == inf and front.lower_bound(1.0) == inf


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"points": 1}, "at least 2 points"),
        ({"gap": 0.0}, "gap must be above 0"),
        ({"gap": 1.0}, "gap must be above 0 and below 1"),
        ({"latest_h": -1.0}, "latest_h must be above 0"),
        ({"times_h": [0.5, -1.0]}, "times_h must be above 0"),
        ({"measure": "time"}, "measure must be"),
    ],
)
def test_bad_arguments_are_named(changes: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        pareto(small_trip(), **changes)


# ------------------------------------------------------------------ arithmetic of cuts and lines

PLANS = st.lists(
    st.tuples(st.floats(0.1, 2.0), st.floats(1.0, 50.0)), min_size=1, max_size=8, unique=True
)


@given(
    PLANS,
    st.lists(st.tuples(st.sampled_from([0.0, 1.0]), st.floats(0.1, 90.0), st.floats(0.1, 3.0))),
    st.floats(0.05, 2.5),
    st.floats(1.0, 60.0),
)
@settings(max_examples=200, deadline=None)
def test_bounds_follow_from_true_cuts(
    plans: list[tuple[float, float]], lines: list[tuple[float, float, float]], t: float, v: float
) -> None:
    """Cuts that hold for a set of plans: no plan contradicts what is derived from them."""
    cuts = [Cut((0,), 1.0, 0.0, inf, -inf)]
    for weight, slope, budget in lines:
        within = [weight * value + slope * time for time, value in plans if time <= budget]
        cuts.append(Cut((0,), weight, slope, budget, min(within, default=inf)))
    within = [value for time, value in plans if time <= t]
    assert least_value(cuts, t) <= min(within, default=inf) + 1e-9
    good = [time for time, value in plans if value <= v]
    assert earliest_h(cuts, v) <= min(good, default=inf) + 1e-9
    for time, value in plans:
        share = front_gap(cuts, time, value)
        assert share >= 0.0
        better = [1.0 - max(b / value, a / time) for a, b in plans]
        assert share >= max(better) - 1e-6  # value >= 1: the size of the gap is the value


@given(PLANS, st.floats(0.005, 0.05))
@settings(max_examples=200, deadline=None)
def test_stretches_certify_every_corner_once_proved(
    plans: list[tuple[float, float]], gap: float
) -> None:
    corners: list[Corner] = []
    for time, value in sorted(plans):
        if not corners or (value < corners[-1].value and time > corners[-1].time_h):
            corners.append(Corner(time, value))
    known = [Corner(*p) for p in plans]
    stretches = make_stretches(corners, known, gap, inf)
    cuts = [Cut((0,), s.value_weight, s.time_weight, s.budget_h, s.bound) for s in stretches]
    for corner in corners:
        assert front_gap(cuts, corner.time_h, corner.value) <= gap
    for cut in cuts:  # and none is above a plan: it can be true
        for time, value in plans:
            if time <= cut.budget_h:
                assert cut.value_weight * value + cut.time_weight * time >= cut.bound - 1e-9


def test_the_command_prints_the_front_and_its_json(tmp_path: Path) -> None:
    path = str(write_trip(tmp_path, **{"start.soc": 0.4}))
    options = ["--set", "grid.step_km=20", "--set", "grid.cells=4", "--points", "3", "-q"]
    shown = CliRunner().invoke(command, [path, *options, "--gap", "0.05"])
    assert shown.exit_code == 0, shown.output
    assert "small trip: energy against time" in shown.output and "Fast" in shown.output
    told = CliRunner().invoke(command, [path, *options, "--no-proof", "--json", "-"])
    front = json.loads(told.stdout)
    assert told.exit_code == 0 and len(front["points"]) >= 3 and front["asked_gap"] is None
    assert f"{front['points'][0]['value']:.2f}" in shown.output
    hopeless = CliRunner().invoke(command, [path, *options, "--set", "start.soc=0.06"])
    assert hopeless.exit_code == 3 and "infeasible" in hopeless.output
    assert CliRunner().invoke(command, [path, "--latest-min", "-1"]).exit_code == 2
