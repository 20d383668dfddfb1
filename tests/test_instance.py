"""The transcription keeps time, energy and second moment of the road, for any step size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trips import small_trip

from relax import Grid, Route, Table1, Trip, load_trip, make_drive, make_instance

FAST = settings(max_examples=60, deadline=None, derandomize=True)


@st.composite
def rough_trips(draw: st.DrawFn) -> Trip:
    """The small trip on a random road: unequal samples, recuperation, changing weather."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 60))
    cuts = np.unique(np.round(rng.uniform(0.5, 119.5, n), 3))
    node = np.concatenate([[0.0], cuts, [120.0]])
    m = node.size - 1
    route = Route(
        "random",
        node,
        rng.uniform(20.0, 130.0, m),
        rng.uniform(-40.0, 60.0, m),
        rng.uniform(0.0, 3.0, m),
        rng.uniform(-20.0, 30.0, m),
    )
    return small_trip(route=route)


def at(trip: Trip, *positions: float, **changes: Any) -> Trip:
    """The trip with chargers at these positions, copies of its first."""
    first = trip.chargers[0]
    chargers = tuple(
        replace(first, name=f"c{i}", position_km=km, **changes) for i, km in enumerate(positions)
    )
    return replace(trip, chargers=chargers)


@FAST
@given(rough_trips(), st.floats(0.3, 200.0))
def test_steps_keep_time_energy_and_second_moment(trip: Trip, step_km: float) -> None:
    route, vehicle = trip.route, trip.vehicle
    drive = make_drive(trip, step_km)
    d, time = drive.duration_h, np.diff(route.node_km) / route.speed_kmh
    assert d.sum() == pytest.approx(time.sum(), rel=1e-12)
    power = route.propulsion_kw
    assert d @ drive.propulsion_kw == pytest.approx(time @ power, rel=1e-10, abs=1e-10)
    moment = d @ (drive.propulsion_kw**2 + drive.ripple_kw2)
    assert moment == pytest.approx(time @ power**2, rel=1e-8)
    assert d @ drive.drivetrain_heat_kw == pytest.approx(time @ route.drivetrain_heat_kw, rel=1e-10)
    heating = np.interp(route.ambient_c, vehicle.cabin_heating_kw.x, vehicle.cabin_heating_kw.f)
    cooling = np.interp(route.ambient_c, vehicle.cabin_cooling_kw.x, vehicle.cabin_cooling_kw.f)
    assert d @ drive.cabin_heat_kw == pytest.approx(time @ heating, rel=1e-10)
    consumers = time @ (power + vehicle.auxiliary_kw + cooling)
    assert d @ drive.base_kw == pytest.approx(consumers, rel=1e-10, abs=1e-10)


@FAST
@given(rough_trips(), st.floats(0.3, 200.0), st.floats(-30.0, 40.0))
def test_steps_keep_the_heat_exchange_at_any_battery_temperature(
    trip: Trip, step_km: float, temp: float
) -> None:
    route, table = trip.route, trip.vehicle.heat_loss_kw_per_k
    drive = make_drive(trip, step_km)
    conductance = np.interp(route.speed_kmh, table.x, table.f)
    expected = (route.duration_h * conductance) @ (route.ambient_c - temp)
    got = (drive.duration_h * drive.heat_loss_kw_per_k) @ (drive.ambient_c - temp)
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-10)


@FAST
@given(rough_trips(), st.floats(0.3, 50.0), st.lists(st.floats(0.0, 120.0), max_size=5))
def test_steps_border_on_every_charger_and_are_no_longer_than_asked(
    trip: Trip, step_km: float, positions: list[float]
) -> None:
    trip = at(trip, *positions)
    drive = make_drive(trip, step_km)
    assert set(positions) <= set(drive.node_km.tolist())
    assert (drive.node_km[0], drive.node_km[-1]) == (0.0, 120.0)
    assert np.all(np.diff(drive.node_km) > 0.0)
    assert np.diff(drive.node_km).max() <= step_km * (1.0 + 1e-6)
    instance = make_instance(trip, tuple(range(len(positions))), Grid(step_km, 3))
    for stop in instance.stops:
        assert drive.node_km[stop.node] == positions[stop.charger]
    assert [s.node for s in instance.stops] == sorted(s.node for s in instance.stops)


def test_a_constant_power_has_no_ripple() -> None:
    trip = small_trip()
    flat = replace(trip.route, propulsion_kw=np.full(trip.route.speed_kmh.size, 13.7))
    drive = make_drive(replace(trip, route=flat), 4.0)
    assert np.all(drive.ripple_kw2 == 0.0)
    np.testing.assert_allclose(drive.propulsion_kw, 13.7, rtol=1e-13)


def test_ripple_by_hand() -> None:
    """One step over 10 km at 50 km/h and 10 kW, then 10 km at 100 km/h and 40 kW."""
    trip = at(small_trip(), 0.0)
    route = Route(
        "two", np.array([0.0, 10.0, 20.0]), np.array([50.0, 100.0]), np.array([10.0, 40.0]),
        np.zeros(2), np.zeros(2),
    )  # fmt: skip
    drive = make_drive(replace(trip, route=route, soc_min=Table1.constant(0.0, 0.0, 20.0)), 20.0)
    assert drive.duration_h.tolist() == pytest.approx([0.3])
    assert drive.propulsion_kw.tolist() == pytest.approx([20.0])
    assert drive.ripple_kw2.tolist() == pytest.approx([2.0 / 3.0 * 100.0 + 400.0 / 3.0])


def test_all_subsets_share_the_driving_grid() -> None:
    trip = load_trip("paper-400km")
    drives = [make_instance(trip, s).drive for s in ((), (0,), (1, 2), (0, 1, 2))]
    for drive in drives[1:]:
        np.testing.assert_array_equal(drive.node_km, drives[0].node_km)
        np.testing.assert_array_equal(drive.base_kw, drives[0].base_kw)
    given_drive = make_drive(trip, 4.0)
    assert make_instance(trip, (1,), None, given_drive).drive is given_drive


def test_the_order_of_the_subset_does_not_matter() -> None:
    trip = load_trip("paper-400km")
    assert make_instance(trip, (2, 0)).subset == make_instance(trip, (0, 2)).subset == (0, 2)


def test_least_energies_without_a_stop_at_the_destination() -> None:
    trip = small_trip()
    pack = trip.vehicle.pack
    instance = make_instance(trip, (0,))
    way, end = float(pack.energy_kwh(0.05)), float(pack.energy_kwh(0.20))
    np.testing.assert_allclose(instance.energy_min_kwh[:-1], way)
    assert instance.energy_min_kwh[-1] == instance.end_energy_min_kwh == end
    assert instance.stops[0].arrive_min_kwh == instance.stops[0].leave_min_kwh == way
    assert instance.energy_max_kwh == float(pack.energy_kwh(0.95))
    assert instance.start_energy_kwh == float(pack.energy_kwh(0.5))


def test_a_stop_at_the_destination_may_arrive_at_the_least_on_the_way() -> None:
    """The end's minimum then holds after the last charge, not before it."""
    trip = at(small_trip(), 60.0, 120.0, 120.0)
    pack = trip.vehicle.pack
    way, end = float(pack.energy_kwh(0.05)), float(pack.energy_kwh(0.20))
    instance = make_instance(trip, (0, 1, 2))
    n = instance.drive.n_steps
    assert [s.node for s in instance.stops[1:]] == [n, n]
    assert [s.arrive_min_kwh for s in instance.stops] == [way, way, way]
    assert [s.leave_min_kwh for s in instance.stops] == [way, way, end]
    assert instance.energy_min_kwh[-1] == way
    assert instance.end_energy_min_kwh == end
    # the shared grid is untouched: a subset without that stop still needs the end's minimum
    assert instance.drive.energy_min_kwh[-1] == end
    assert make_instance(trip, (0,), None, instance.drive).energy_min_kwh[-1] == end


def test_a_reserve_above_the_end_minimum_wins() -> None:
    trip = replace(small_trip(), soc_min=Table1([0.0, 120.0], [0.05, 0.30]))
    pack = trip.vehicle.pack
    instance = make_instance(trip, ())
    assert instance.end_energy_min_kwh == pytest.approx(float(pack.energy_kwh(0.30)))
    half = make_instance(at(trip, 60.0), (0,))
    assert half.stops[0].arrive_min_kwh == pytest.approx(float(pack.energy_kwh(0.175)))


def test_a_charger_at_the_start_and_two_at_one_position() -> None:
    trip = at(small_trip(), 0.0, 50.0, 50.0)
    instance = make_instance(trip, (2, 1, 0))
    assert instance.subset == (0, 1, 2)
    assert instance.stops[0].node == 0
    assert instance.stops[1].node == instance.stops[2].node > 0


def test_costs_and_limits_of_a_stop_by_hand() -> None:
    trip = replace(small_trip(), time_value_per_h=12.0)
    stop = make_instance(trip, (1,)).stops[0]
    assert stop.fixed_cost == pytest.approx(12.0 * 8.0 / 60.0 + 0.5)
    assert (stop.occupancy_free_h, stop.occupancy_price_per_h) == (0.5, 6.0)
    assert (stop.max_dwell_h, stop.price_per_kwh, stop.time_price_per_h) == (1.5, 0.4, 12.0)
    assert (stop.detour_in_kwh, stop.detour_out_kwh) == (0.2, 0.3)
    assert stop.detour_h == pytest.approx(8.0 / 60.0)
    assert stop.heat_loss_kw_per_k == 0.010  # parked
    assert stop.cabin_heat_kw == pytest.approx(2.5 + 5.0 / 30.0 * 3.0)  # at -5 C
    assert stop.base_kw == 0.5
    instance = make_instance(trip, (0, 1))
    assert instance.fixed_cost == pytest.approx(12.0 * 12.0 / 60.0 + 0.5)


def test_grid_limit_is_the_least_of_rating_current_and_curve() -> None:
    trip = at(
        small_trip(), 60.0, power_kw=100.0, current_a=200.0,
        curve_kw=Table1([0.1, 0.6, 0.9], [120.0, 90.0, 20.0]),
    )  # fmt: skip
    pack = trip.vehicle.pack
    limit = make_instance(trip, (0,)).stops[0].grid_limit_kw
    for soc in (0.0, 0.1, 0.5, 0.6, 0.9, 1.0):
        volt = float(np.interp(soc, pack.ocv_v.x, pack.ocv_v.f))
        curve = float(np.interp(soc, [0.1, 0.6, 0.9], [120.0, 90.0, 20.0]))
        expected = min(100.0, 0.2 * volt, curve)
        assert limit.at(float(pack.energy_kwh(soc))) == pytest.approx(expected, rel=1e-12), soc


@pytest.mark.parametrize(
    ("used", "maybe"), [((1, 1), ()), ((-1,), ()), ((3,), ()), ((1,), (1,)), ((), (0, 3))]
)
def test_chargers_are_those_of_the_trip_each_once(
    used: tuple[int, ...], maybe: tuple[int, ...]
) -> None:
    with pytest.raises(ValueError, match="chargers are 0 to 2, each once"):
        make_instance(load_trip("paper-400km"), used, undecided=maybe)


@pytest.mark.parametrize(("step_km", "cells"), [(0.0, 12), (-4.0, 12), (np.nan, 12), (4.0, 0)])
def test_a_grid_cuts_a_trip(step_km: float, cells: int) -> None:
    with pytest.raises(ValueError, match="steps above 0 km and 1 cell or more"):
        Grid(step_km, cells)
