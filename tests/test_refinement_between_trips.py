"""Between trips that differ in one thing, refined plans differ as that thing explains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from refined import paper
from trips import small_trip

from relax import Grid, Trip, load_trip, make_instance, refine
from relax.simulate import FEASIBLE
from relax.starts import even_start


def test_a_temperature_limit_binds_and_cooling_keeps_it() -> None:
    trip = small_trip(ambient_c=30.0, pack__temperature_max_c=35.0)
    instance = make_instance(trip, (0,))
    found = refine(instance, even_start(instance))
    t = found.trajectory
    assert found.feasible
    peak = max(t.temperature_c.max(), t.stops[0].temperature_c.max())
    assert 34.9 < peak <= 35.0 + FEASIBLE
    assert max(t.cooling_kw.max(), t.stops[0].cooling_kw.max()) > 0.1
    loose = make_instance(replace_limit(trip, 45.0), (0,))
    free = refine(loose, even_start(loose))
    assert free.trajectory.cost < t.cost
    d = instance.drive.duration_h
    assert float(free.trajectory.cooling_kw @ d) < 0.1 * float(t.cooling_kw @ d)


def replace_limit(trip: Trip, top_c: float) -> Trip:
    pack = replace(trip.vehicle.pack, temperature_max_c=top_c)
    return replace(trip, vehicle=replace(trip.vehicle, pack=pack))


def test_preheating_pays_when_time_is_dear_and_not_when_it_is_free() -> None:
    """The point of the whole exercise, on the paper's trip at -10 C without heat pump."""
    heat = {}
    for value in (0.0, 400.0):
        instance = paper((1,), pump=0.0, time=value)
        found = refine(instance, even_start(instance))
        heat[value] = float(found.trajectory.heater_kw @ instance.drive.duration_h)
    assert heat[0.0] < 0.05
    assert heat[400.0] > 0.3


def test_halving_the_steps_changes_the_cost_little() -> None:
    trip = load_trip("paper-400km")
    costs = []
    for grid in (Grid(4.0, 12), Grid(2.0, 24)):
        instance = make_instance(trip, (1,), grid)
        costs.append(refine(instance, even_start(instance)).trajectory.cost)
    assert abs(costs[1] / costs[0] - 1.0) < 1e-3


@pytest.mark.parametrize("ambient", [-10.0, 5.0])
def test_a_larger_heat_pump_is_never_worse(ambient: float) -> None:
    """Each plan of the smaller pump is a start for the larger one."""
    cost, start = np.inf, None
    for pump in (0.0, 1.0, 3.0):
        instance = paper((0, 2), ambient=ambient, pump=pump)
        starts = [even_start(instance), *([start] if start else [])]
        found = [refine(instance, s) for s in starts]
        best = min(found, key=lambda r: r.trajectory.cost)
        assert all(r.feasible for r in found)
        assert best.trajectory.cost <= cost * (1.0 + 1e-6)
        cost, start = best.trajectory.cost, best.controls


@pytest.mark.long
def test_one_more_charger_is_never_worse() -> None:
    from enumerate import plan

    trip = load_trip("paper-400km")
    spots = trip.chargers
    cost = np.inf
    for chargers in (spots[1:2], spots[1:], spots):
        result = plan(replace(trip, chargers=chargers))
        assert result.cost <= cost * (1.0 + 2e-3)  # replayed costs; local optima to 0.2 %
        cost = min(cost, result.cost)


def test_a_warmer_start_is_never_slower() -> None:
    trip = load_trip("paper-400km", {"vehicle.heat_pump_kw": 0, "objective.time_value_per_h": 4e3})
    hours = []
    for start in (-10.0, 0.0, 15.0):
        instance = make_instance(replace(trip, start_temperature_c=start), (1,))
        found = refine(instance, even_start(instance))
        hours.append(float(found.trajectory.stops[0].dwell_h.sum()))
    assert hours[0] >= hours[1] - 1e-4 >= hours[2] - 2e-4
