"""What a simulation states to be violated, and by how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_simulate import toy_trip
from trips import small_trip

from relax import Table1, Table2, idle_controls, make_instance, simulate
from relax.instance import MIN_CHARGE_KWH


def test_violations_are_stated_with_their_amounts() -> None:
    trip = toy_trip()
    pack = trip.vehicle.pack
    instance = make_instance(trip, ())
    t = simulate(instance, idle_controls(instance, ()))
    used = float((trip.route.duration_h * (trip.route.propulsion_kw + 0.5)).sum())
    short = float(pack.energy_kwh(0.2)) - (float(pack.energy_kwh(0.5)) - used)
    assert t.violation.tolist() == pytest.approx([short, 0.0, 0.0, 0.0], abs=1e-9)

    warm = make_instance(toy_trip(pack__temperature_max_c=19.0), ())
    hot = simulate(warm, idle_controls(warm, ()))
    assert hot.violation[1] == pytest.approx(1.0, abs=1e-9)
    cold = make_instance(small_trip(pack__temperature_min_c=0.0), ())
    frozen = simulate(cold, idle_controls(cold, ()))
    assert frozen.violation[1] == pytest.approx(-frozen.temperature_c.min(), abs=1e-9)

    over = make_instance(trip, (1,))
    s = simulate(over, idle_controls(over, (80.0,)))
    arrive = float(s.stops[0].energy_kwh[0])
    assert s.violation[0] == pytest.approx(arrive + 80.0 - over.energy_max_kwh, abs=1e-9)
    assert s.violation[3] == pytest.approx(80.0 / 49.5 - 1.5, abs=1e-9)

    enough = toy_trip(start_soc=0.9)
    assert simulate(make_instance(enough, ()), idle_controls(over, ())).violation[0] == 0.0
    barely = make_instance(enough, (1,))
    for charged in (0.03, MIN_CHARGE_KWH):
        b = simulate(barely, idle_controls(barely, (charged,)))
        assert b.violation[0] == pytest.approx(MIN_CHARGE_KWH - charged, abs=1e-12)


def test_a_battery_that_takes_no_charge_is_a_violation_not_an_error() -> None:
    """Its limit is 0 in the cold: 0.02 kW too much, and a dwell of days."""
    cold = Table2([0.0, 1.0], [-40.0, 10.0, 60.0], [[0.0, 0.0, 90.0], [0.0, 0.0, 90.0]])
    instance = make_instance(small_trip(pack__charge_limit_soc_kw=cold), (0,))
    t = simulate(instance, idle_controls(instance, (5.0,)))
    assert np.all(np.isfinite(t.violation))
    assert t.violation[2] == pytest.approx(0.02, abs=1e-9)
    assert t.violation[3] == pytest.approx(5.0 / 0.02 - 4.0, rel=0.5)
    assert t.stops[0].power_kw.min() == pytest.approx(0.02)
    warm = replace(instance, start_temperature_c=30.0)
    assert simulate(warm, idle_controls(warm, (5.0,))).violation[2] == 0.0


def test_the_discharge_limit_is_watched() -> None:
    weak = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), 12.0))
    instance = make_instance(toy_trip(pack__discharge_limit_soc_kw=weak), ())
    t = simulate(instance, idle_controls(instance, ()))
    assert t.violation[2] == pytest.approx(t.power_kw.max() - 12.0, abs=1e-9)
    assert t.violation[2] > 0.0


def test_a_load_beyond_what_the_pack_can_deliver_is_a_violation() -> None:
    """1/(4r) at most, whatever the table of discharge limits says."""
    strong = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), 1e4))
    trip = toy_trip(
        pack__resistance_ohm=Table1([-40.0, 60.0], [9.0, 9.0]), pack__discharge_limit_soc_kw=strong
    )
    instance = make_instance(trip, ())
    t = simulate(instance, idle_controls(instance, ()))
    r = t.loss_kw / (t.power_kw**2 + instance.drive.ripple_kw2)
    beyond = instance.drive.base_kw + t.cabin_heater_kw + r * instance.drive.ripple_kw2 - 0.25 / r
    assert beyond.max() > 1.0
    assert t.violation[2] == pytest.approx(beyond.max(), rel=1e-9)
