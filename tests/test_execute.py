"""Executed plans hold on the continuous model, or are refused with the reason."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_simulate import toy_trip
from trips import small_trip

from relax import (
    Execution,
    Instance,
    Refined,
    Replay,
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
from relax.instance import MIN_CHARGE_KWH
from relax.replay import Violation
from relax.simulate import is_feasible
from relax.starts import even_start

ENERGY = 2e-5
"""Energy that may be missing, as in the replay [kWh]."""
KELVIN = 2e-3
"""Temperature that may be exceeded, as in the replay [K]."""


def run(trip: Trip, subset: tuple[int, ...]) -> tuple[Instance, Refined, Execution]:
    instance = make_instance(trip, subset)
    plan = refine(instance, even_start(instance))
    return instance, plan, execute(trip, instance, plan)


def assert_holds(trip: Trip, instance: Instance, done: Execution) -> None:
    """Check every limit on the driven arrays, apart from the replay's own account."""
    driven = done.replay
    assert driven is not None
    assert driven.feasible
    pack = trip.vehicle.pack
    least = pack.energy_kwh(trip.soc_min(driven.position_km))
    assert np.all(driven.energy_kwh >= least - ENERGY)
    assert driven.final_energy_kwh >= instance.end_energy_min_kwh - ENERGY
    temps = np.concatenate([driven.temperature_c, *(s.temperature_c for s in driven.stops)])
    assert temps.max() <= instance.temperature_max_c + KELVIN
    assert temps.min() >= instance.temperature_min_c - KELVIN
    for stop, ran, target in zip(instance.stops, driven.stops, done.targets_kwh, strict=True):
        assert ran.arrive_energy_kwh >= stop.arrive_min_kwh - ENERGY
        assert ran.depart_energy_kwh - stop.detour_out_kwh >= stop.leave_min_kwh - ENERGY
        assert ran.depart_energy_kwh <= instance.energy_max_kwh + ENERGY
        assert ran.depart_energy_kwh - ran.arrive_energy_kwh >= MIN_CHARGE_KWH - ENERGY
        assert ran.depart_energy_kwh == pytest.approx(target, abs=1e-6)
        assert ran.dwell_h <= stop.max_dwell_h + 2e-4
        power = ran.grid_kwh / ran.dwell_h
        assert power <= trip.chargers[stop.charger].power_kw * (1.0 + 1e-9)


def paper(**overrides: float) -> Trip:
    return load_trip("paper-400km", {k.replace("__", "."): v for k, v in overrides.items()})


CASES: dict[str, tuple[Trip, tuple[int, ...]]] = {
    "paper": (paper(), (0, 2)),
    "paper, one stop": (paper(), (1,)),
    "paper, fast": (paper(objective__time_value_per_h=400), (0, 1, 2)),
    "summer": (load_trip("goteborg-stockholm-summer"), (3, 6)),
    "winter": (load_trip("goteborg-stockholm-winter"), (1, 4)),
    "tight temperature": (small_trip(ambient_c=30.0, pack__temperature_max_c=35.0), (0,)),
    "hot": (small_trip(ambient_c=35.0), (0,)),
    "tight dwell": (small_trip(start_soc=0.35), (0, 1)),
    "reserve binds": (small_trip(start_soc=0.3), (0, 1)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_plan_without_a_reason_breaks_no_limit(name: str) -> None:
    trip, subset = CASES[name]
    instance, plan, done = run(trip, subset)
    assert plan.feasible
    assert done.reason == ""
    assert_holds(trip, instance, done)


@pytest.mark.parametrize("name", CASES)
def test_the_execution_is_the_replay_of_what_it_returns(name: str) -> None:
    trip, subset = CASES[name]
    instance, _, done = run(trip, subset)
    again = replay(trip, instance, done.controls, done.targets_kwh)
    assert done.replay is not None
    assert again.cost == pytest.approx(done.replay.cost, rel=1e-7)
    np.testing.assert_allclose(again.energy_kwh, done.replay.energy_kwh, atol=2e-6)


@pytest.mark.parametrize("name", ["paper", "paper, one stop", "winter", "summer"])
def test_the_trip_ends_exactly_at_its_least_energy(name: str) -> None:
    """Neither a kWh too little nor one paid for in vain."""
    trip, subset = CASES[name]
    instance, _, done = run(trip, subset)
    assert done.replay is not None
    spare = done.replay.final_energy_kwh - instance.end_energy_min_kwh
    assert -ENERGY <= spare <= 1e-4


def test_energy_charged_in_vain_is_given_back() -> None:
    """A plan that charges 2 kWh too much is driven with 2 kWh less."""
    trip = paper()
    instance = make_instance(trip, (1,))
    plan = refine(instance, even_start(instance))
    stop = plan.controls.stops[0]
    rich = replace(plan.controls, stops=(replace(stop, energy_kwh=stop.energy_kwh + 2.0),))
    done = execute(
        trip, instance, replace(plan, controls=rich, trajectory=simulate(instance, rich))
    )
    assert done.reason == ""
    assert done.replay is not None
    spare = done.replay.final_energy_kwh - instance.end_energy_min_kwh
    assert -ENERGY <= spare <= 1e-4


def test_a_stop_that_nobody_needs_charges_the_least() -> None:
    """Energy to spare at the end is given back, but no stop ends below its least charge."""
    trip = small_trip(start_soc=0.9, end_soc_min=0.1)
    instance, _, done = run(trip, (0, 1))
    assert done.reason == ""
    assert done.replay is not None
    assert done.replay.final_energy_kwh > instance.end_energy_min_kwh + 1.0
    assert_holds(trip, instance, done)
    for ran in done.replay.stops:
        charged = ran.depart_energy_kwh - ran.arrive_energy_kwh
        assert charged == pytest.approx(MIN_CHARGE_KWH, abs=2e-5)


def test_a_temperature_missed_by_a_hair_is_repaired() -> None:
    """The plan lies on the limit of the grid's states; the drive exceeds it between them."""
    trip = small_trip(ambient_c=30.0, pack__temperature_max_c=35.0, grid__step_km=12.0)
    instance = make_instance(trip, (0,))
    plan = refine(instance, even_start(instance))
    assert plan.feasible
    targets = tuple(float(s.energy_kwh[-1]) for s in plan.trajectory.stops)
    raw = replay(trip, instance, plan.controls, targets)
    assert any(v.unit == "K" for v in raw.violations)
    done = execute(trip, instance, plan)
    assert done.reason == ""
    assert_holds(trip, instance, done)


def test_a_start_beyond_the_tightened_limit_does_not_stop_a_repair() -> None:
    """It starts 0.1 K below the limit, which its steps exceed by 0.3 K between their nodes."""
    trip = small_trip(
        ambient_c=32.0, pack__temperature_max_c=35.0, start_temperature_c=34.9, grid__step_km=20.0
    )
    instance = make_instance(trip, (0,))
    plan = refine(instance, even_start(instance))
    targets = tuple(float(s.energy_kwh[-1]) for s in plan.trajectory.stops)
    (missed,) = (v for v in replay(trip, instance, plan.controls, targets).violations
                 if v.unit == "K")  # fmt: skip
    assert missed.amount > 0.2
    done = execute(trip, instance, plan)
    assert done.reason == ""
    assert_holds(trip, instance, done)


def test_missing_energy_is_repaired_by_the_targets_alone() -> None:
    """A coarse grid misses the end by some Wh; the charging target moves by about as much."""
    trip = paper(grid__step_km=25.0, grid__cells=3)
    instance = make_instance(trip, (0, 2))
    plan = refine(instance, even_start(instance))
    targets = [float(s.energy_kwh[-1]) for s in plan.trajectory.stops]
    raw = replay(trip, instance, plan.controls, tuple(targets))
    missed = instance.end_energy_min_kwh - raw.final_energy_kwh
    assert abs(missed) > 1e-4
    done = execute(trip, instance, plan)
    assert done.reason == ""
    assert_holds(trip, instance, done)
    moved = sum(done.targets_kwh) - sum(targets)
    if done.controls is plan.controls:
        assert moved == pytest.approx(missed, abs=0.3 * abs(missed) + 1e-3)


def test_a_plan_that_breaks_a_limit_on_the_grid_is_refused_unseen() -> None:
    trip = small_trip()
    instance = make_instance(trip, ())
    done = execute(trip, instance, refine(instance, even_start(instance)))
    assert done.replay is None
    assert done.reason == "it violates a limit already on the grid"


def test_a_car_that_runs_empty_is_refused_with_the_reason() -> None:
    """A plan that calls itself feasible and is not: the verdict is the replay's."""
    trip = small_trip(start_soc=0.1)
    instance = make_instance(trip, ())
    controls = idle_controls(instance, ())
    liar = Refined(controls, simulate(instance, controls), True, 0)
    done = execute(trip, instance, liar)
    assert done.replay is None
    assert "cannot drive it" in done.reason


def test_a_limit_that_no_repair_meets_is_refused_with_its_name() -> None:
    """The claimed plan needs 30 kW from a pack that sustains 12: no refinement helps."""
    weak = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), 12.0))
    trip = toy_trip(pack__discharge_limit_soc_kw=weak)
    instance = make_instance(trip, (0,))
    controls = idle_controls(instance, (8.0,))
    trajectory = simulate(instance, controls)
    assert not is_feasible(trajectory)
    done = execute(trip, instance, Refined(controls, trajectory, True, 0))
    assert done.reason != ""
    assert "discharge limit" in done.reason or "on the grid" in done.reason


@pytest.mark.parametrize("unit", ["kW", "kWh", "K", "h"])
def test_the_judge_is_never_overruled(unit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A violation that stays, whatever is tried: all repairs end in its name."""
    calls = 0

    def strict(*args: Any) -> Replay:
        nonlocal calls
        calls += 1
        return replace(replay(*args), violations=(Violation("made up", 7.0, 1e-3, unit),))

    monkeypatch.setattr(sys.modules["relax.execute"], "replay", strict)
    trip = paper()
    instance = make_instance(trip, (1,))
    done = execute(trip, instance, refine(instance, even_start(instance)))
    assert done.reason == f"made up at 7.0 km by 0.001 {unit}"
    assert done.replay is not None
    assert not done.replay.feasible
    assert calls >= 2


@pytest.mark.parametrize(("ambient", "top"), [(20.0, 40.0), (30.0, 36.0)])
def test_a_reason_is_empty_exactly_if_the_replay_is_feasible(ambient: float, top: float) -> None:
    """Plans that claim to be feasible, at random: execute believes none of them."""
    rng = np.random.default_rng(8)
    trip = small_trip(ambient_c=ambient, pack__temperature_max_c=top)
    instance = make_instance(trip, (0,))
    for _ in range(4):
        heat = rng.uniform(0.0, 0.6) * rng.random(instance.drive.n_steps)
        controls = replace(
            idle_controls(instance, (float(rng.uniform(4.0, 12.0)),)), heater_kw=heat
        )
        done = execute(trip, instance, Refined(controls, simulate(instance, controls), True, 0))
        held = done.replay is not None and done.replay.feasible
        assert (done.reason == "") == held
        if done.reason == "":
            assert_holds(trip, instance, done)


@pytest.mark.parametrize(("ambient", "top", "kw"), [(-5.0, 25.0, 2.0), (5.0, 40.0, 4.0)])
def test_a_heater_left_on_stops_at_the_limit_and_the_plan_holds(
    ambient: float, top: float, kw: float
) -> None:
    """Commanded to heat all the way after the stop: car and transcription both cut it back."""
    trip = small_trip(ambient_c=ambient, pack__temperature_max_c=top)
    instance = make_instance(trip, (0,))
    heat = np.where(np.arange(instance.drive.n_steps) < instance.stops[0].node, 0.0, kw)
    controls = replace(idle_controls(instance, (10.0,)), heater_kw=heat)
    t = simulate(instance, controls)
    assert is_feasible(t)
    assert (t.heater_kw < heat - 0.1).sum() > 3
    done = execute(trip, instance, Refined(controls, t, True, 0))
    assert done.reason == ""
    assert_holds(trip, instance, done)


@pytest.mark.parametrize("power_kw", [4.0, 5.3, 8.0])
def test_a_weak_charger_never_gives_more_than_its_rating(power_kw: float) -> None:
    """5 kW for the cabin and 0.5 kW auxiliaries: a 4 kW charger cannot even keep the car warm."""
    trip = small_trip(ambient_c=-25.0, vehicle__heat_pump_kw=0.0, time_value_per_h=0.0)
    weak = replace(trip.chargers[0], power_kw=power_kw, max_dwell_h=99.0)
    trip = replace(trip, chargers=(weak,))
    instance, _, done = run(trip, (0,))
    if done.reason == "":
        assert_holds(trip, instance, done)
    else:
        assert power_kw < 8.0, done.reason
