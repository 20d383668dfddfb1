"""A drive that touches the edge of a table misses a limit: it is measured, and repaired.

The tables are those of the small car, cut at the limits, so that a hair beyond a limit is
beyond the table too.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from test_execute import assert_holds, run
from trips import small_trip

from relax import (
    DomainError,
    Refined,
    Table1,
    Table2,
    Trip,
    execute,
    idle_controls,
    load_trip,
    make_instance,
    refine,
    replay,
    simulate,
)
from relax.exact import EDGE_K, EDGE_KWH, ExactCar
from relax.execute import _tightened
from relax.starts import best_start

Array = npt.NDArray[np.float64]


def cut(trip: Trip, lo: float, hi: float) -> Trip:
    """The trip with all tables of the battery temperature cut to an interval."""

    def nodes(x: Array) -> Array:
        return np.array([lo, *x[(x > lo) & (x < hi)], hi])

    def one(table: Table1) -> Table1:
        return Table1(nodes(table.x), table(nodes(table.x)), table.name)

    def two(table: Table2) -> Table2:
        y = nodes(table.y)
        return Table2(table.x, y, table(table.x[:, None], y[None, :]), table.name)

    vehicle, pack = trip.vehicle, trip.vehicle.pack
    pack = replace(
        pack,
        resistance_ohm=one(pack.resistance_ohm),
        charge_limit_soc_kw=two(pack.charge_limit_soc_kw),
        discharge_limit_soc_kw=two(pack.discharge_limit_soc_kw),
    )
    cop = one(vehicle.heat_pump_cop)
    return replace(trip, vehicle=replace(vehicle, pack=pack, heat_pump_cop=cop))


HOT = small_trip(ambient_c=30.0, pack__temperature_max_c=35.0, grid__step_km=12.0)
"""The plan lies on the limit of 35 C; the drive exceeds it between the nodes."""


def empty(**changes: float) -> Trip:
    """A trip that may run down to nothing, where the table of the voltage ends."""
    nothing = Table1.constant(0.0, 0.0, 120.0, "soc_min")
    return replace(small_trip(start_soc=0.3, **changes), soc_min=nothing, end_soc_min=0.0)


def full(soc_max: float, downhill_kw: float) -> Trip:
    """Downhill after a cheap charger, and a dear one for the last of a high end energy.

    Its nodes are before and after the hill: on the grid nobody sees that the battery gets full.
    """
    trip = small_trip(
        soc_max=soc_max, grid__step_km=20.0, grid__cells=4, end_soc_min=0.85, ambient_c=15.0
    )
    power = trip.route.propulsion_kw.copy()
    power[3] = downhill_kw
    cheap, dear = trip.chargers
    chargers = (replace(cheap, price_per_kwh=0.1), replace(dear, price_per_kwh=1.5))
    route = replace(trip.route, propulsion_kw=power)
    return replace(trip, route=route, chargers=chargers, time_value_per_h=1.0)


CASES = {
    "temperature": (cut(HOT, -40.0, 35.0), (0,), "battery temperature above its limit"),
    "empty": (empty(), (0,), "energy below the least"),
    "empty, two stops": (empty(), (0, 1), ""),
    "empty, coarse": (empty(grid__step_km=25.0, grid__cells=3), (0,), ""),
    "full": (full(1.0, -4.0), (0, 1), ""),
    "more than full": (full(1.0, -12.0), (0, 1), ""),
}


@pytest.mark.parametrize("name", CASES)
def test_a_plan_that_touches_an_edge_is_repaired(name: str) -> None:
    trip, subset, rule = CASES[name]
    instance, plan, done = run(trip, subset)
    assert plan.feasible
    targets = tuple(float(s.energy_kwh[-1]) for s in plan.trajectory.stops)
    raw = replay(trip, instance, plan.controls, targets)
    if rule:
        assert any(v.rule.startswith(rule) for v in raw.violations), raw.violations
    if name == "more than full":
        assert raw.totals_kwh["refused_recuperation"] > 0.3
    assert done.reason == ""
    assert_holds(trip, instance, done)
    assert done.trajectory.cost < 1.1 * plan.trajectory.cost


def test_the_edge_of_a_table_does_not_change_what_is_repaired() -> None:
    """With tables that go on to 60 C the same limit is missed by as much, and costs as much."""
    done, missed = [], []
    for trip in (HOT, cut(HOT, -40.0, 35.0)):
        instance, plan, execution = run(trip, (0,))
        targets = tuple(float(s.energy_kwh[-1]) for s in plan.trajectory.stops)
        raw = replay(trip, instance, plan.controls, targets)
        missed.append(next(v.amount for v in raw.violations if v.unit == "K"))
        assert execution.replay is not None
        done.append(execution.replay.cost)
    assert missed[1] == pytest.approx(missed[0], abs=0.02)
    assert done[1] == pytest.approx(done[0], rel=1e-4)


def test_a_battery_overfilled_by_a_hair_is_charged_less() -> None:
    """Away from any edge too: the repair lowers the largest energy instead of raising the least."""
    trip = full(0.95, -12.0)
    instance, plan, done = run(trip, (0, 1))
    above = (instance.energy_max_kwh + 1e-3, instance.energy_max_kwh)
    raw = replay(trip, instance, plan.controls, above)
    (missed,) = (v for v in raw.violations if v.rule == "energy above the largest allowed")
    assert missed.amount == pytest.approx(1e-3, abs=1e-6)
    tight = _tightened(instance, replace(raw, violations=(missed,)), 1.5)
    assert instance.energy_max_kwh - tight.energy_max_kwh == pytest.approx(1.5 * missed.amount)
    assert tight.end_energy_min_kwh == instance.end_energy_min_kwh
    assert done.reason == ""
    assert_holds(trip, instance, done)


@pytest.mark.parametrize("beyond", [0.0, 0.5, 4.9])
def test_within_the_tables_nothing_changes_at_the_edge(beyond: float) -> None:
    """The car at the edge reads the same numbers inside, bit for bit, and the end's outside."""
    pack = small_trip().vehicle.pack
    inside, edge = ExactCar(small_trip().vehicle), ExactCar(small_trip().vehicle, edge=True)
    rng = np.random.default_rng(4)
    top = pack.voltage_squared.hi
    for energy, temp in zip(rng.uniform(0.0, top, 200), rng.uniform(-40.0, 60.0, 200), strict=True):
        e, t = float(energy), float(temp)
        assert inside.resistance(t) == edge.resistance(t)
        assert inside.voltage_squared(e) == edge.voltage_squared(e)
        assert inside.charge_limit(e, t) == edge.charge_limit(e, t)
        assert inside.discharge_limit(e, t) == edge.discharge_limit(e, t)
    assert edge.resistance(60.0 + beyond) == inside.resistance(60.0)
    kwh = 0.2 * beyond
    at_end = inside.charge_limit(top, -40.0)
    assert edge.charge_limit(top + kwh, -40.0 - beyond) == pytest.approx(at_end, rel=1e-12)
    assert edge.voltage_squared(-kwh) == inside.voltage_squared(0.0)


def test_far_beyond_the_edge_there_is_no_table() -> None:
    edge = ExactCar(small_trip().vehicle, edge=True)
    top = edge.energy_range[1]
    calls: tuple[Callable[[], float], ...] = (
        lambda: edge.resistance(60.0 + 1.01 * EDGE_K),
        lambda: edge.resistance(np.nan),
        lambda: edge.voltage_squared(top + 1.01 * EDGE_KWH),
        lambda: edge.charge_limit(-1.01 * EDGE_KWH, 20.0),
        lambda: edge.discharge_limit(20.0, np.nan),
    )
    for read in calls:
        with pytest.raises(DomainError, match="outside the table"):
            read()


def test_a_limit_beyond_the_table_does_not_hide_that_it_ended() -> None:
    """By hand a car may be given a limit that its tables do not reach: they are the limit then."""
    whole = small_trip(ambient_c=20.0)
    instance = make_instance(whole, (0,))
    controls = idle_controls(instance, (2.0,))
    targets = tuple(float(s.energy_kwh[-1]) for s in simulate(instance, controls).stops)
    free = replay(whole, instance, controls, targets)
    assert not any(v.unit == "K" for v in free.violations)
    top = max([free.temperature_c.max(), *(s.temperature_c.max() for s in free.stops)])
    trip = cut(whole, -40.0, float(top) - 2.0)
    driven = replay(trip, make_instance(trip, (0,)), controls, targets)
    (broken,) = (v for v in driven.violations if v.unit == "K")
    assert broken.rule == "battery temperature above its limit"
    assert broken.amount == pytest.approx(2.0, abs=0.2)


def test_a_drive_goes_on_from_an_earlier_one_at_the_edge() -> None:
    trip, subset, _ = CASES["empty"]
    instance, plan, _ = run(trip, subset)
    first = tuple(float(s.energy_kwh[-1]) for s in plan.trajectory.stops)
    second = (first[0] - 0.01,)
    before = replay(trip, instance, plan.controls, first)
    fresh = replay(trip, instance, plan.controls, second)
    again = replay(trip, instance, plan.controls, second, before)
    assert again.violations == fresh.violations != ()
    assert fresh.energy_kwh.min() < -0.005
    assert again.cost == fresh.cost
    np.testing.assert_array_equal(again.energy_kwh, fresh.energy_kwh)


def test_a_car_far_beyond_the_edge_is_refused_with_place_and_limit() -> None:
    trip = small_trip(start_soc=0.1)
    instance = make_instance(trip, ())
    controls = idle_controls(instance, ())
    done = execute(trip, instance, Refined(controls, simulate(instance, controls), True, 0))
    assert done.replay is None
    place = r"at (\d+\.\d) km"
    words = rf"the car cannot drive it: {place}: .* is outside the table .*; energy below the least"
    found = re.fullmatch(rf"{words} on the way {place} by \d.* kWh", done.reason)
    assert found is not None, done.reason
    assert found[1] == found[2]


# A battery that takes no charge in the cold.


def frozen() -> Trip:
    """The small car, whose battery takes nothing at all below 0 degrees C."""
    limit = Table2(
        [0.0, 1.0], [-40.0, 0.0, 60.0], [[0.0, 0.0, 120.0], [0.0, 0.0, 60.0]], "charge_limit"
    )
    return small_trip(pack__charge_limit_soc_kw=limit)


def test_a_drive_without_charge_says_where() -> None:
    trip = frozen()
    instance = make_instance(trip, (0,))
    with pytest.raises(DomainError, match=r"at 45\.0 km: the battery takes no charge at .* C"):
        replay(trip, instance, idle_controls(instance, (10.0,)), (30.0,))


def test_a_battery_that_must_be_warmed_to_charge_is_warmed() -> None:
    """Driven cold it takes no charge; the plan heats it before the stop."""
    trip = frozen()
    instance = make_instance(trip, (0,))
    plan = refine(instance, best_start(instance, None, 0.0))
    done = execute(trip, instance, plan)
    assert done.reason == ""
    assert_holds(trip, instance, done)
    assert done.replay is not None
    assert done.replay.stops[0].arrive_temperature_c > 0.0


def test_the_paper_trip_may_end_empty() -> None:
    """A limit of 0 at both ends is the edge of every shipped table."""
    trip = load_trip("paper-400km", {"limits.soc_min": 0.0, "end.soc_min": 0.0})
    instance, _, done = run(trip, (1,))
    assert done.reason == ""
    assert_holds(trip, instance, done)
