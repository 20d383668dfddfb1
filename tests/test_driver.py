"""Drivers with rules: honest trips, judged like ours, and never better than the optimal plan."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isnan

import numpy as np
import pytest
from trips import small_trip

from benchmarks.reference.driver import (
    PLAIN,
    PREHEATING,
    DriverTrip,
    drive_by_rules,
    value_to_driver,
)
from relax.instance import make_instance
from relax.replay import replay
from relax.simulate import simulate
from relax.trip import Trip

START = 0.35
"""Start of charge from which the small trip needs one stop."""


def winter(**changes: object) -> Trip:
    return small_trip(**{"ambient_c": -10.0, "start_soc": START, **changes})


@pytest.fixture(scope="module")
def driven() -> DriverTrip:
    return drive_by_rules(winter(), PREHEATING)


def test_a_driver_gets_there_and_the_judge_agrees(driven: DriverTrip) -> None:
    trip = winter()
    assert driven.reason == "" and driven.subset
    instance = make_instance(trip, driven.subset)
    assert simulate(instance, driven.controls).violation.max() <= 2e-5
    targets = tuple(s.depart_energy_kwh for s in driven.replay.stops)
    again = replay(trip, instance, driven.controls, targets)
    assert again.violations == ()
    assert again.cost == pytest.approx(driven.cost, rel=1e-9)


def test_no_more_is_charged_than_needed(driven: DriverTrip) -> None:
    instance = make_instance(winter(), driven.subset)
    assert driven.replay.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=1e-3)


def test_the_reserve_is_kept_at_chargers(driven: DriverTrip) -> None:
    trip = winter()
    pack = trip.vehicle.pack
    for stop in driven.replay.stops:
        assert float(pack.soc(stop.arrive_energy_kwh)) >= 0.05 + PREHEATING.reserve_soc - 1e-4


def test_preheating_is_full_late_and_ends_at_its_target(driven: DriverTrip) -> None:
    instance = make_instance(winter(), driven.subset)
    node = instance.stops[0].node
    clock = np.cumsum(instance.drive.duration_h)
    on = np.flatnonzero(driven.controls.heater_kw > 1e-9)
    assert on.size and on[-1] == node - 1  # still cold: heats until it arrives
    longest = float(instance.drive.duration_h.max())
    assert clock[node - 1] - clock[on[0]] <= PREHEATING.preheat_h
    assert clock[node - 1] - (clock[on[0]] - longest) >= PREHEATING.preheat_h
    # full: all the heater has beside the cabin
    left = 6.0 - driven.trajectory.cabin_heater_kw[on]
    np.testing.assert_allclose(driven.trajectory.heater_kw[on], left, atol=1e-6)
    assert all(np.all(s.heater_kw == 0.0) for s in driven.controls.stops)
    mild = drive_by_rules(winter(), replace(PREHEATING, preheat_c=-6.0))
    heated = np.flatnonzero(mild.controls.heater_kw > 1e-9)
    assert mild.trajectory.temperature_c[heated + 1].max() <= -6.0 + 1e-6


def test_preheating_arrives_warmer(driven: DriverTrip) -> None:
    plain = drive_by_rules(winter(), PLAIN)
    assert plain.reason == ""
    assert np.all(plain.controls.heater_kw == 0.0)
    cold, warm = (d.replay.stops[0].arrive_temperature_c for d in (plain, driven))
    assert warm > cold + 3.0


@pytest.mark.parametrize("ambient_c", [-10.0, 5.0, 30.0])
def test_the_optimal_plan_never_costs_more(ambient_c: float) -> None:
    trip = winter(ambient_c=ambient_c)
    best, *drivers = value_to_driver(trip)
    assert best.driver == "optimal plan" and best.saved_cost == 0.0 and best.saved_min == 0.0
    assert [d.driver for d in drivers] == ["no preheating", "preheating"]
    for row in drivers:
        assert row.reason == ""
        assert row.cost >= best.cost * (1.0 - 1e-4)
        assert row.saved_cost == pytest.approx(row.cost - best.cost)
        assert row.saved_kwh == pytest.approx(row.grid_kwh - best.grid_kwh)
        assert row.saved_min == pytest.approx(60.0 * (row.stop_h - best.stop_h))
        assert row.stop_h > row.charging_h


def test_no_stop_where_none_is_needed() -> None:
    done = drive_by_rules(winter(start_soc=0.9))
    assert done.reason == "" and done.subset == () and done.cost == 0.0


def test_out_of_reach_is_said() -> None:
    done = drive_by_rules(winter(start_soc=0.12))
    assert done.cost == inf and done.replay is None
    assert done.reason == "nothing is in reach from the start"


def test_a_driver_who_fails_has_no_figures() -> None:
    timid = replace(PLAIN, name="timid", reserve_soc=0.8)
    _, row = value_to_driver(winter(), rules=(timid,))
    assert row.reason and isnan(row.cost) and isnan(row.saved_cost) and isnan(row.saved_kwh)


def test_a_longer_stop_than_allowed_is_avoided_or_said() -> None:
    trip = winter()
    short = replace(trip, chargers=tuple(replace(c, max_dwell_h=0.1) for c in trip.chargers))
    done = drive_by_rules(short, PLAIN)
    assert done.reason or all(s.dwell_h <= 0.1 + 1e-4 for s in done.replay.stops)


def test_a_cold_battery_is_not_cooled_further() -> None:
    rules = replace(PLAIN, heat_pump_from_c=-9.0)
    done = drive_by_rules(winter(), rules)
    below = done.trajectory.temperature_c[1:] < -9.5
    assert np.all(done.trajectory.heat_pump_kw[below] == 0.0)
