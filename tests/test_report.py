"""The report says what was driven: sums, clock, states and the deviation stated beside."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from trips import small_trip

from relax import Execution, Instance, Trip, execute, load_trip, make_instance, refine
from relax.report import PlanReport, make_report
from relax.starts import even_start

Done = tuple[Trip, Instance, Execution, PlanReport]


def reported(trip: Trip, subset: tuple[int, ...]) -> Done:
    instance = make_instance(trip, subset)
    done = execute(trip, instance, refine(instance, even_start(instance)))
    assert done.reason == ""
    return trip, instance, done, make_report(trip, instance, done)


CASES = {
    "paper": reported(load_trip("paper-400km"), (0, 2)),
    "summer": reported(load_trip("goteborg-stockholm-summer"), (3, 6)),
    "small": reported(small_trip(), (0, 1)),
    "no stop": reported(small_trip(start_soc=0.9), ()),
}


@pytest.mark.parametrize("name", CASES)
def test_sums_are_those_of_the_drive(name: str) -> None:
    trip, _, done, report = CASES[name]
    driven = done.replay
    assert driven is not None
    assert report.grid_kwh == pytest.approx(driven.totals_kwh["grid"], abs=1e-9)
    assert report.charging_h == pytest.approx(sum(s.dwell_h for s in driven.stops))
    assert report.driving_h == pytest.approx(float(trip.route.duration_h.sum()))
    assert report.total_h == pytest.approx(report.driving_h + report.charging_h + report.detour_h)
    assert sum(s.cost for s in report.stops) == pytest.approx(driven.cost)
    soc = float(trip.vehicle.pack.soc(driven.final_energy_kwh))
    assert report.final_soc == soc >= trip.end_soc_min - 1e-6
    assert report.final_temperature_c == driven.final_temperature_c
    totals = dict(report.totals_kwh)
    cooling = totals.pop("cabin_cooling")
    assert totals == driven.totals_kwh
    assert 0.0 <= cooling < totals["propulsion_and_auxiliaries"]


@pytest.mark.parametrize("name", CASES)
def test_cabin_cooling_is_what_propulsion_and_auxiliaries_leave(name: str) -> None:
    trip, _, done, report = CASES[name]
    assert done.replay is not None
    hours = report.driving_h + sum(s.dwell_h for s in done.replay.stops)
    propulsion = float(trip.route.propulsion_kw @ trip.route.duration_h)
    rest = report.totals_kwh["propulsion_and_auxiliaries"] - propulsion
    rest -= trip.vehicle.auxiliary_kw * hours
    cooling = report.totals_kwh["cabin_cooling"]
    assert cooling == pytest.approx(rest, abs=1e-6)
    assert (cooling > 0.0) == (name == "summer")


@pytest.mark.parametrize("name", CASES)
def test_stops_say_what_happened_at_their_charger(name: str) -> None:
    trip, instance, done, report = CASES[name]
    assert done.replay is not None
    pack = trip.vehicle.pack
    for stop, ran, said in zip(instance.stops, done.replay.stops, report.stops, strict=True):
        spec = trip.chargers[stop.charger]
        assert (said.charger, said.position_km) == (spec.name, spec.position_km)
        assert said.arrive_soc == pytest.approx(float(pack.soc(ran.arrive_energy_kwh)))
        assert said.depart_soc == pytest.approx(float(pack.soc(ran.depart_energy_kwh)))
        assert said.depart_soc > said.arrive_soc
        assert said.arrive_temperature_c == ran.arrive_temperature_c
        assert said.depart_temperature_c == ran.depart_temperature_c
        assert said.energy_cost == pytest.approx(spec.price_per_kwh * said.grid_kwh)
        time = trip.time_value_per_h * (said.dwell_h + spec.detour_h)
        occupied = max(0.0, said.dwell_h - spec.occupancy_free_h)
        extra = spec.occupancy_price_per_h * occupied + spec.stop_penalty
        assert said.cost == pytest.approx(said.energy_cost + time + extra)
        assert said.average_kw == pytest.approx(said.grid_kwh / said.dwell_h)
        assert said.average_kw <= spec.power_kw * (1.0 + 1e-12)


@pytest.mark.parametrize("name", CASES)
def test_the_clock_runs_through_driving_detours_and_stops(name: str) -> None:
    trip, _, _, report = CASES[name]
    route = trip.route
    waited = 0.0
    for said in report.stops:
        spec = next(c for c in trip.chargers if c.name == said.charger)
        part = np.clip(spec.position_km - route.node_km[:-1], 0.0, np.diff(route.node_km))
        driving = float((part / route.speed_kmh).sum())
        assert said.arrive_h == pytest.approx(driving + waited + spec.detour_in_h, rel=1e-9)
        assert said.depart_h == pytest.approx(said.arrive_h + said.dwell_h)
        waited += said.dwell_h + spec.detour_in_h + spec.detour_out_h
    assert report.total_h == pytest.approx(route.driving_h + waited)


@pytest.mark.parametrize("name", CASES)
def test_traces_are_replayed_states_and_planned_powers(name: str) -> None:
    trip, instance, done, report = CASES[name]
    assert done.replay is not None
    n, trace = instance.drive.n_steps, report.drive
    pack = trip.vehicle.pack
    np.testing.assert_allclose(pack.energy_kwh(trace.soc), done.replay.node_energy_kwh, atol=1e-9)
    np.testing.assert_array_equal(trace.temperature_c, done.replay.node_temperature_c)
    np.testing.assert_array_equal(trace.battery_kw, done.trajectory.power_kw)
    assert np.all(trace.battery_kw <= trace.discharge_limit_kw + 0.1)
    assert np.all(-trace.battery_kw <= trace.charge_limit_kw + 0.1)
    vehicle = trip.vehicle
    heat = trace.cabin_heater_kw * vehicle.heater_cabin_efficiency + trace.heat_pump_heat_kw
    np.testing.assert_allclose(heat, instance.drive.cabin_heat_kw, atol=1e-9)
    for field in fields(trace):
        size = n + 1 if field.name in {"node_km", "soc", "temperature_c"} else n
        assert getattr(trace, field.name).shape == (size,), field.name
    for charge, ran, said in zip(report.charge, done.replay.stops, report.stops, strict=True):
        assert charge.charger == said.charger
        assert charge.time_h[0] == 0.0
        assert charge.time_h[-1] == pytest.approx(said.dwell_h)
        assert np.all(np.diff(charge.time_h) > 0.0)
        np.testing.assert_allclose(charge.soc[[0, -1]], [said.arrive_soc, said.depart_soc])
        np.testing.assert_array_equal(charge.temperature_c, ran.temperature_c)
        assert np.all(charge.battery_kw <= charge.limit_kw * (1.0 + 1e-9))
        assert np.all(charge.grid_kw > charge.battery_kw)


@pytest.mark.parametrize("name", CASES)
def test_the_deviation_is_that_of_transcription_and_drive(name: str) -> None:
    trip, _, done, report = CASES[name]
    assert done.replay is not None
    pack, said = trip.vehicle.pack, report.deviation
    gap = pack.soc(done.trajectory.energy_kwh) - pack.soc(done.replay.node_energy_kwh)
    assert said.soc == pytest.approx(float(np.abs(gap).max()))
    temp = done.trajectory.temperature_c - done.replay.node_temperature_c
    assert said.temperature_k == pytest.approx(float(np.abs(temp).max()))
    if done.trajectory.cost:
        assert (1.0 + said.cost) * done.trajectory.cost == pytest.approx(done.replay.cost)
    else:
        assert said.cost == 0.0
    assert said.soc < 0.001
    assert said.temperature_k < 0.5
    assert abs(said.cost) < 0.002


def test_the_trajectory_is_all_arrays_by_name() -> None:
    _, _, _, report = CASES["paper"]
    got = report.trajectory()
    assert list(got) == ["drive", "km 100", "km 300"]
    assert "charger" not in got["km 100"]
    np.testing.assert_array_equal(got["drive"]["soc"], report.drive.soc)
    np.testing.assert_array_equal(got["km 300"]["grid_kw"], report.charge[1].grid_kw)


def test_a_plan_may_leave_the_tables_by_rounding() -> None:
    """A battery charged full lies a hair beyond the last energy of its limits."""
    trip, instance, done, report = CASES["small"]
    table = trip.vehicle.pack.charge_limit_kw
    energy = done.trajectory.energy_start_kwh.copy()
    energy[-1] = table.x[-1] + 1e-5
    full = replace(done, trajectory=replace(done.trajectory, energy_start_kwh=energy))
    limit = make_report(trip, instance, full).drive.charge_limit_kw
    assert limit[-1] == table(table.x[-1], done.trajectory.temperature_start_c[-1])
    assert np.array_equal(limit[:-1], report.drive.charge_limit_kw[:-1])


def test_a_plan_never_driven_has_no_report() -> None:
    trip, instance, done, _ = CASES["paper"]
    with pytest.raises(ValueError, match="nothing to report"):
        make_report(trip, instance, replace(done, replay=None))
