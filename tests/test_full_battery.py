"""A battery that takes no more: recuperation is refused, on the grid and in the drive alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_replay import drive
from test_simulate import downhill_trip
from trips import small_trip

from relax import idle_controls, make_instance, replay, simulate
from relax.exact import MANAGED_KWH


def test_refused_recuperation_is_counted_and_not_charged() -> None:
    trip = downhill_trip(ambient_c=0.0)
    instance = make_instance(trip, (1,))
    controls = idle_controls(instance, (2.0,))
    driven, planned = drive(trip, instance, controls), simulate(instance, controls)
    refused = float(planned.brake_kw @ instance.drive.duration_h)
    assert refused > 1.0
    assert driven.totals_kwh["refused_recuperation"] == pytest.approx(refused, rel=0.05)


@pytest.mark.parametrize("step_km", [2.0, 10.0])
@pytest.mark.parametrize("soc_max", [0.9, 0.92])
def test_a_full_battery_refuses_recuperation(soc_max: float, step_km: float) -> None:
    """Downhill with a battery that is full, or nearly: its charge limit alone would allow more."""
    trip = downhill_trip(ambient_c=0.0, soc_max=soc_max, grid__step_km=step_km)
    instance = make_instance(trip, (1,))
    controls = idle_controls(instance, (2.0,))
    planned, driven = simulate(instance, controls), drive(trip, instance, controls)
    assert planned.energy_kwh.max() == pytest.approx(instance.energy_max_kwh, abs=1e-9)
    full = instance.energy_max_kwh - driven.energy_kwh.max()
    assert -1e-7 < full < MANAGED_KWH
    assert planned.violation[0] == 0.0 and driven.violations == ()
    free = make_instance(replace(trip, soc_max=1.0), (1,))
    refused = [float(t.brake_kw @ i.drive.duration_h) for i, t in
               ((instance, planned), (free, simulate(free, controls)))]  # fmt: skip
    assert refused[0] > refused[1] + 0.3
    near = pytest.approx(refused[0], rel=0.01 * step_km)
    assert driven.totals_kwh["refused_recuperation"] == near
    assert driven.final_energy_kwh == pytest.approx(planned.final_energy_kwh, abs=1e-3)
    assert abs(driven.balance_kwh) < 1e-9 and abs(driven.heat_balance_kwh) < 1e-9


@pytest.mark.parametrize(("step_km", "kwh"), [(1.0, 0.0), (4.0, 0.6), (10.0, 0.6)])
def test_a_long_step_keeps_what_the_drive_refuses(step_km: float, kwh: float) -> None:
    """Full, 35 km steeply down and then up again: the grid looks at the ends of its steps."""
    trip = small_trip(start_soc=0.9, soc_max=0.9, grid__step_km=step_km)
    power = np.where(trip.route.node_km[:-1] < 35.0, -60.0, 20.0)
    trip = replace(trip, route=replace(trip.route, propulsion_kw=power))
    instance = make_instance(trip, ())
    controls = idle_controls(instance, ())
    planned, driven = simulate(instance, controls), drive(trip, instance, controls)
    more = planned.final_energy_kwh - driven.final_energy_kwh
    assert more == pytest.approx(kwh, abs=0.15)


def test_a_battery_overfilled_at_a_stop_is_noticed() -> None:
    trip = downhill_trip(ambient_c=0.0)
    instance = make_instance(trip, (1,))
    target = instance.energy_max_kwh + 0.5
    driven = replay(trip, instance, idle_controls(instance, (2.0,)), (target,))
    (broken,) = (v for v in driven.violations if v.rule == "energy above the largest allowed")
    assert broken.amount == pytest.approx(0.5, abs=1e-6)
