"""Refined plans are right where the optimum is known by hand: which charger gives how much.

A road without resistance or heat, 50 kW at any temperature and charge.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_simulate import toy_trip

from relax import Instance, RefineSettings, Trajectory, Trip, make_instance, refine
from relax.instance import MIN_CHARGE_KWH
from relax.simulate import FEASIBLE
from relax.starts import even_start


def energy_needed(trip: Trip, detour_kwh: float = 0.0) -> float:
    """What must be charged: driving, auxiliaries, detours and the end's minimum."""
    energy = trip.vehicle.pack.energy_kwh
    used = float((trip.route.duration_h * (trip.route.propulsion_kw + 0.5)).sum())
    return used + detour_kwh + float(energy(trip.end_soc_min) - energy(trip.start_soc))


def charges(instance: Instance, **settings: Any) -> tuple[list[float], Trajectory]:
    found = refine(instance, even_start(instance), RefineSettings(**settings))
    assert found.feasible
    return [float(np.ptp(s.energy_kwh)) for s in found.trajectory.stops], found.trajectory


def priced(trip: Trip, *chargers: dict[str, Any], **changes: Any) -> Trip:
    """The trip with its first charger copied, each copy changed; no time value."""
    base = replace(
        trip.chargers[0], detour_in_kwh=0.0, detour_out_kwh=0.0, detour_in_h=0.0, detour_out_h=0.0
    )
    copies = tuple(replace(base, name=f"c{i}", **c) for i, c in enumerate(chargers))
    settings: dict[str, Any] = {"time_value_per_h": 0.0, "start_soc": 0.35} | changes
    return replace(trip, chargers=copies, **settings)


def test_toy_one_stop_by_hand() -> None:
    trip = toy_trip()
    instance = make_instance(trip, (0,))
    (charged,), t = charges(instance)
    need = energy_needed(trip, detour_kwh=0.4)
    hours = need / 50.0
    assert charged == pytest.approx(need, abs=3e-5)
    cost = 0.6 * (need + 0.5 * hours) + 10.0 * hours + 10.0 * 4.0 / 60.0
    assert t.cost == pytest.approx(cost, rel=1e-5)


@pytest.mark.parametrize("cheap", [0, 1])
def test_toy_all_energy_comes_from_the_cheaper_charger(cheap: int) -> None:
    prices = [0.5, 0.5]
    prices[cheap] = 0.4
    trip = priced(
        toy_trip(),
        {"position_km": 45.0, "price_per_kwh": prices[0]},
        {"position_km": 85.0, "price_per_kwh": prices[1]},
    )
    charged, _ = charges(make_instance(trip, (0, 1)))
    need = energy_needed(trip)
    assert charged[1 - cheap] == pytest.approx(MIN_CHARGE_KWH, abs=1e-4)
    assert charged[cheap] == pytest.approx(need - MIN_CHARGE_KWH, abs=2e-4)


def test_toy_a_full_battery_limits_the_cheaper_charger() -> None:
    trip = priced(
        toy_trip(),
        {"position_km": 45.0, "price_per_kwh": 0.3},
        {"position_km": 85.0, "price_per_kwh": 0.5},
        soc_max=0.5,
        start_soc=0.45,
        end_soc_min=0.3,
    )
    instance = make_instance(trip, (0, 1))
    charged, t = charges(instance)
    assert t.stops[0].energy_kwh[-1] == pytest.approx(instance.energy_max_kwh, abs=1e-4)
    assert sum(charged) == pytest.approx(energy_needed(trip), abs=1e-4)
    assert charged[1] > MIN_CHARGE_KWH + 0.1


def test_toy_the_reserve_makes_an_expensive_charger_carry_what_the_cheap_one_cannot() -> None:
    """The cheap charger comes second: the first gives just enough to arrive there."""
    trip = priced(
        toy_trip(),
        {"position_km": 45.0, "price_per_kwh": 0.5},
        {"position_km": 85.0, "price_per_kwh": 0.3},
        start_soc=0.23,
    )
    instance = make_instance(trip, (0, 1))
    charged, t = charges(instance)
    assert charged[0] > MIN_CHARGE_KWH + 0.1
    assert t.stops[1].energy_kwh[0] == pytest.approx(instance.stops[1].arrive_min_kwh, abs=1e-4)


def occupied(free_h: float, price_per_h: float) -> Trip:
    """The cheaper of two chargers has a price of occupancy."""
    return priced(
        toy_trip(),
        {
            "position_km": 45.0,
            "price_per_kwh": 0.4,
            "occupancy_free_h": free_h,
            "occupancy_price_per_h": price_per_h,
        },
        {"position_km": 85.0, "price_per_kwh": 0.5},
    )


def test_toy_occupancy_moves_the_rest_to_the_other_charger() -> None:
    """0.1 h are free at the cheaper one; beyond, an hour costs more than the price difference."""
    trip = occupied(free_h=0.1, price_per_h=10.0)
    charged, t = charges(make_instance(trip, (0, 1)))
    need = energy_needed(trip)
    assert charged == pytest.approx([5.0, need - 5.0], abs=2e-3)
    cost = 0.4 * (5.0 + 0.05) + 0.5 * (need - 5.0) * 1.01
    assert t.cost == pytest.approx(cost, rel=1e-4)


def test_toy_occupancy_is_paid_where_it_is_cheaper_than_the_other_price() -> None:
    trip = occupied(free_h=0.05, price_per_h=2.0)
    charged, t = charges(make_instance(trip, (0, 1)))
    need = energy_needed(trip)
    assert charged == pytest.approx([need - MIN_CHARGE_KWH, MIN_CHARGE_KWH], abs=2e-4)
    hours = (need - MIN_CHARGE_KWH) / 50.0
    cost = 0.4 * (need - MIN_CHARGE_KWH) * 1.01 + 2.0 * (hours - 0.05) + 0.5 * 0.1 * 1.01
    assert t.cost == pytest.approx(cost, rel=1e-4)


def test_toy_the_longest_dwell_caps_the_cheaper_charger() -> None:
    trip = priced(
        toy_trip(),
        {"position_km": 45.0, "price_per_kwh": 0.4, "max_dwell_h": 0.08},
        {"position_km": 85.0, "price_per_kwh": 0.5},
    )
    charged, t = charges(make_instance(trip, (0, 1)))
    assert charged[0] == pytest.approx(4.0, abs=2e-3)
    assert t.stops[0].dwell_h.sum() <= 0.08 + FEASIBLE


def test_toy_time_decides_between_a_cheap_and_a_fast_charger() -> None:
    """0.4 per kWh at 25 kW or 0.5 at 50 kW: the break-even is 5 per hour."""
    spots = (
        {"position_km": 45.0, "price_per_kwh": 0.4, "power_kw": 25.5},
        {"position_km": 85.0, "price_per_kwh": 0.5, "power_kw": 150.0},
    )
    for value, best in ((3.0, 0), (8.0, 1)):  # per kWh: 0.1 dearer, 0.02 h faster
        trip = priced(toy_trip(), *spots, time_value_per_h=value)
        charged, _ = charges(make_instance(trip, (0, 1)))
        assert charged[1 - best] == pytest.approx(MIN_CHARGE_KWH, abs=1e-3), value
