"""Refined plans are simulated, feasible and locally optimal, from any start, by either solver."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from refined import CASES, refined
from test_simulate import random_controls, residuals, toy_trip
from trips import small_trip

from relax import (
    Controls,
    Instance,
    RefineSettings,
    Table1,
    descent,
    idle_controls,
    load_trip,
    make_instance,
    refine,
    simulate,
)
from relax.completion import complete, merit, penalty_prices
from relax.descent import SAME_PLACE, Descent
from relax.instance import MIN_CHARGE_KWH
from relax.refinement import HEAT, Refined, refine_best
from relax.simulate import FEASIBLE, Simulation, is_feasible
from relax.starts import even_start, split_starts, warmer_start

Array = npt.NDArray[np.float64]


@pytest.mark.parametrize("name", CASES)
def test_a_refined_plan_is_the_simulation_of_its_controls(name: str) -> None:
    instance, found = CASES[name], refined(name)
    again = simulate(instance, found.controls)
    assert again.cost == pytest.approx(found.trajectory.cost, rel=1e-9)
    np.testing.assert_allclose(again.temperature_c, found.trajectory.temperature_c, atol=1e-6)
    assert max(residuals(instance, found.trajectory).values()) < 1e-7


@pytest.mark.parametrize("name", ["two stops", "winter"])
@pytest.mark.parametrize("pause", [1, 2, 3])
def test_a_descent_that_pauses_ends_where_one_does_that_does_not(name: str, pause: int) -> None:
    instance = CASES[name]
    search = Descent(Simulation(instance), even_start(instance), RefineSettings())
    most = 0
    while not search.ended:
        most += pause
        before = search.value
        found = search.run(most)
        assert search.value <= before
    assert search.run(RefineSettings().max_programs).trajectory is found.trajectory  # for good
    without = refine(instance, even_start(instance))
    assert found.trajectory.cost == pytest.approx(without.trajectory.cost, rel=1e-9)
    assert most >= found.programs == without.programs > pause


def two_starts(instance: Instance) -> list[Controls]:
    """Return a warm start and one that splits the energy badly."""
    even = even_start(instance)
    return [warmer_start(instance, even), split_starts(instance, even)[-1]]


@pytest.mark.parametrize("name", ["two stops", "winter", "summer"])
def test_of_several_starts_the_one_that_is_ahead_is_refined(name: str) -> None:
    """Whatever is refined is what that start alone leads to; the other takes a few programs."""
    instance = CASES[name]
    starts = two_starts(instance)
    found = refine_best(instance, starts)
    searches = [Descent(Simulation(instance), start, RefineSettings()) for start in starts]
    for search in searches:
        search.run(HEAT)
    ahead, behind = np.argsort([search.value for search in searches])
    alone = refine(instance, starts[ahead])
    assert found.feasible and found.trajectory.cost == pytest.approx(alone.trajectory.cost)
    assert found.programs == alone.programs + searches[behind].programs


def test_where_the_start_that_is_ahead_leads_to_no_plan_the_next_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    instance = CASES["winter"]
    barren, other = two_starts(instance)

    class Barren(Descent):
        """Ahead of all others, and beyond a limit to the end."""

        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            self.barren = self.start is barren or self.weight > 1.0
            self.value -= 1e6 * self.barren

        @property
        def found(self) -> Refined:
            return replace(super().found, feasible=super().found.feasible and not self.barren)

    monkeypatch.setattr("relax.refinement.Descent", Barren)
    found = refine_best(instance, [barren, other])
    assert found.feasible
    assert found.trajectory.cost == pytest.approx(refine(instance, other).trajectory.cost)


def test_a_start_that_ends_above_the_cost_to_beat_settles_it() -> None:
    instance, optimum = CASES["winter"], refined("winter")
    tried: list[Controls] = []

    def starts() -> Iterator[Controls]:
        for start in (optimum.controls, *two_starts(instance)):
            tried.append(start)
            yield start

    cost = optimum.trajectory.cost
    found = refine_best(instance, starts(), RefineSettings(hopeless=0.9 * cost))
    assert len(tried) == 1 and found.trajectory.cost == pytest.approx(cost)
    refine_best(instance, starts(), RefineSettings(hopeless=1.1 * cost))
    assert len(tried) == 4


@pytest.mark.parametrize("name", CASES)
def test_feasible_means_that_no_limit_is_broken(name: str) -> None:
    """The limits are checked here on the arrays, not by the simulation's own account."""
    instance, found = CASES[name], refined(name)
    t = found.trajectory
    assert found.feasible
    tol = 1.001 * FEASIBLE
    assert np.all(t.energy_kwh[1:] >= instance.energy_min_kwh[1:] - tol)
    assert t.final_energy_kwh >= instance.end_energy_min_kwh - tol
    temps = np.concatenate([t.temperature_c, *(s.temperature_c for s in t.stops)])
    assert temps.max() <= instance.temperature_max_c + tol
    assert temps.min() >= instance.temperature_min_c - tol
    em = 0.5 * (t.energy_start_kwh + t.energy_kwh[1:])
    tm = 0.5 * (t.temperature_start_c + t.temperature_c[1:])
    assert np.all(t.power_kw <= instance.vehicle.pack.discharge_limit_kw(em, tm) + tol)
    for stop, s in zip(instance.stops, t.stops, strict=True):
        assert s.energy_kwh[0] >= stop.arrive_min_kwh - tol
        assert s.energy_kwh[-1] - stop.detour_out_kwh >= stop.leave_min_kwh - tol
        assert s.energy_kwh[-1] <= instance.energy_max_kwh + tol
        assert s.energy_kwh[-1] - s.energy_kwh[0] >= MIN_CHARGE_KWH - 1e-9
        assert s.dwell_h.sum() <= stop.max_dwell_h + tol


@pytest.mark.parametrize("name", CASES)
def test_refining_is_never_worse_than_its_start(name: str) -> None:
    instance = CASES[name]
    rng = np.random.default_rng(1)
    simulation = Simulation(instance)
    for start in (even_start(instance), random_controls(instance, rng)):
        before = merit(instance, complete(simulation, start)[1])
        after = merit(instance, refine(instance, start).trajectory)
        assert after <= before + 1e-9 * abs(before)


def nudged(instance: Instance, now: Controls, rng: np.random.Generator, size: float) -> Controls:
    """Controls near others: all powers and energies move, within the actuators' limits."""
    vehicle = instance.vehicle

    def near(power: Array, most: float) -> Array:
        part = rng.random(power.size) < rng.uniform(0.05, 1.0)
        bump = size * most * rng.normal(size=power.size) * part
        return np.clip(np.minimum(power, most) + bump, 0.0, most)

    stops = []
    for s in now.stops:
        slower = np.where(rng.random(s.power_kw.size) < 0.2, 1.0 - 0.3 * size, 1.0)
        stops.append(
            replace(
                s,
                energy_kwh=max(s.energy_kwh + 10.0 * size * rng.normal(), MIN_CHARGE_KWH),
                power_kw=s.power_kw * slower,
                heater_kw=near(s.heater_kw, vehicle.heater_kw),
                cooling_kw=near(s.cooling_kw, vehicle.cooling_kw),
                heat_pump_kw=near(s.heat_pump_kw, vehicle.heat_pump_kw),
            )
        )
    return Controls(
        near(now.heater_kw, vehicle.heater_kw),
        near(now.cooling_kw, vehicle.cooling_kw),
        near(now.heat_pump_kw, vehicle.heat_pump_kw),
        tuple(stops),
    )


@pytest.mark.parametrize("name", CASES)
def test_no_small_change_of_the_controls_improves_a_refined_plan(name: str) -> None:
    instance, found = CASES[name], refined(name)
    simulation = Simulation(instance)
    rng = np.random.default_rng(5)
    cost, kept = found.trajectory.cost, 0
    for _ in range(60):
        size = float(10.0 ** rng.uniform(-3.0, -1.0))
        _, t = complete(simulation, nudged(instance, found.controls, rng, size))
        kept += is_feasible(t)
        # the penalty is exact: leaving the limits does not pay either
        assert merit(instance, t) >= cost * (1.0 - 1e-4), (size, t.cost, cost)
    assert kept >= 2


@pytest.mark.parametrize("name", ["two stops", "summer", "hot", "small, cold"])
def test_more_programs_never_make_a_plan_worse(name: str) -> None:
    """Every accepted step gains: the merit falls from iterate to iterate, from poor starts too."""
    instance = CASES[name]
    for start in (
        even_start(instance),
        random_controls(instance, np.random.default_rng(2), excess=0.9),
    ):
        value = np.inf
        for count in range(1, 10):
            found = refine(instance, start, RefineSettings(max_programs=count))
            now = merit(instance, found.trajectory)
            assert now <= value + 1e-9 * abs(now), count
            value = now


def test_feasible_is_a_matter_of_rounding_only() -> None:
    t = refined("small").trajectory
    for kind in range(4):
        for amount, verdict in ((0.0, True), (1e-5, True), (1e-4, False), (0.5, False)):
            violation = np.zeros(4)
            violation[kind] = amount
            assert is_feasible(replace(t, violation=violation)) is verdict


def test_violations_are_priced_above_what_they_could_save() -> None:
    """Exact penalty: no plan pays by missing a kWh, whatever the prices are."""
    for instance in CASES.values():
        energy = penalty_prices(instance)[0]
        for stop in instance.stops:
            slow = 1.0 / 10.0  # h per kWh at 10 kW
            assert energy > 2.0 * (stop.price_per_kwh + slow * stop.time_price_per_h)


@pytest.mark.parametrize("name", CASES)
def test_refining_again_gains_nothing(name: str) -> None:
    instance, found = CASES[name], refined(name)
    again = refine(instance, found.controls)
    assert again.trajectory.cost >= found.trajectory.cost * (1.0 - 1e-4)


@pytest.mark.parametrize("name", ["one stop", "two stops", "winter", "hot"])
def test_a_search_that_arrives_at_a_known_plan_ends_there(name: str) -> None:
    instance, found = CASES[name], refined(name)
    start = warmer_start(instance, found.controls)
    alone = refine(instance, start)
    again = refine(instance, start, known=alone.trajectory)
    assert again.feasible and again.programs <= alone.programs
    assert again.trajectory.cost == pytest.approx(alone.trajectory.cost, rel=1e-4)
    elsewhere = replace(
        alone.trajectory, temperature_c=alone.trajectory.temperature_c + 2.0 * SAME_PLACE
    )
    assert refine(instance, start, known=elsewhere).programs == alone.programs


@pytest.mark.parametrize("name", CASES)
def test_a_last_step_is_recognised_without_loss(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = refined(name)
    monkeypatch.setattr(descent, "SETTLED", 0.0)
    longer = refine(CASES[name], even_start(CASES[name]))
    assert found.programs <= longer.programs
    assert found.trajectory.cost <= longer.trajectory.cost * (1.0 + 2e-5)


@pytest.mark.parametrize("ambient", [30.0, 33.0])
def test_needless_cooling_in_the_start_is_given_up(ambient: float) -> None:
    """Every start is 1 kW of cooling away from another one, along a road that only falls."""
    instance = make_instance(small_trip(ambient_c=ambient), (1,))
    start = even_start(instance)
    costs = []
    for cooling in (0.0, 0.3, 1.0):
        stops = tuple(replace(s, cooling_kw=np.full(instance.cells, cooling)) for s in start.stops)
        cooled = np.full(instance.drive.n_steps, cooling)
        found = refine(instance, replace(start, cooling_kw=cooled, stops=stops))
        assert found.feasible
        costs.append(found.trajectory.cost)
    assert max(costs) <= min(costs) * (1.0 + 1e-3), costs


def test_completing_meets_the_end_exactly_and_changes_energies_only() -> None:
    for instance in CASES.values():
        start = even_start(instance)
        controls, t = complete(Simulation(instance), start)
        assert t.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=2e-5)
        np.testing.assert_array_equal(controls.heater_kw, start.heater_kw)
        for a, b in zip(controls.stops, start.stops, strict=True):
            np.testing.assert_array_equal(a.heat_pump_kw, b.heat_pump_kw)
            np.testing.assert_array_equal(a.power_kw, b.power_kw)


def test_completing_with_a_tight_arrival_meets_that_too() -> None:
    instance = CASES["two stops"]
    _, t = complete(Simulation(instance), even_start(instance), frozenset({1}))
    stop = instance.stops[1]
    assert t.stops[1].energy_kwh[0] == pytest.approx(stop.arrive_min_kwh, abs=2e-5)
    assert t.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=2e-5)


def test_a_trip_without_stops_is_simulated_as_it_is() -> None:
    instance = make_instance(replace(toy_trip(), start_soc=0.9), ())
    found = refine(instance, even_start(instance))
    assert found.feasible
    assert found.trajectory.cost == 0.0


def test_an_impossible_trip_is_not_called_feasible() -> None:
    instance = make_instance(small_trip(), ())
    found = refine(instance, even_start(instance))
    assert not found.feasible
    assert found.trajectory.violation[0] > 1.0


def test_a_stop_more_that_the_hot_trip_can_afford_is_found() -> None:
    """The plan with stop 0 alone, and 0.1 kWh at stop 1, shows that {0, 1} is feasible."""
    trip = small_trip(ambient_c=35.0)
    alone = refined("hot")
    instance = make_instance(trip, (0, 1))
    least = idle_controls(instance, (1.0, MIN_CHARGE_KWH)).stops[1]
    witness = replace(alone.controls, stops=(alone.controls.stops[0], least))
    _, t = complete(Simulation(instance), witness)
    found = refine(instance, even_start(instance))
    if is_feasible(t):
        assert found.feasible
        assert found.trajectory.cost <= t.cost * (1.0 + 1e-3)


def test_split_starts_put_the_energy_at_each_stop_in_turn() -> None:
    instance = CASES["three stops, fast"]
    start = even_start(instance)
    total = sum(s.energy_kwh for s in start.stops)
    starts = split_starts(instance, start)
    assert len(starts) == 3
    for most, split in zip(range(3), starts, strict=True):
        each = [s.energy_kwh for s in split.stops]
        assert sum(each) == pytest.approx(total)
        assert int(np.argmax(each)) == most
    assert split_starts(CASES["one stop"], even_start(CASES["one stop"])) == []


def test_the_table_of_one_car_need_not_cover_more_than_it_declares() -> None:
    """A cop table that ends inside the pack's range: read at its end, never beyond."""
    trip = small_trip(vehicle__heat_pump_cop=Table1([-40.0, 45.0], [1.4, 3.5]))
    instance = make_instance(trip, (0,))
    assert refine(instance, even_start(instance)).feasible


OSQP_COST = 1e-3
"""Relative cost above Clarabel's on the one kind of trip OSQP solves; docs/refinement.md."""


def test_osqp_reaches_the_cost_of_clarabel_where_it_converges() -> None:
    """Energy-optimal, without heat pump: the other cases do not converge from a cold start."""
    instance, reference = CASES["mild, no pump"], refined("mild, no pump")
    settings = RefineSettings(solver="osqp", solver_tolerance=1e-3)
    found = refine(instance, even_start(instance), settings)
    assert found.feasible
    assert found.trajectory.cost <= reference.trajectory.cost * (1.0 + OSQP_COST)


def osqp_table(tolerances: tuple[float, ...] = (1e-3, 1e-5)) -> None:
    """Print what OSQP reaches on every case: the figures of docs/refinement.md."""
    for name, instance in CASES.items():
        reference = refined(name).trajectory.cost
        for tolerance in tolerances:
            settings = RefineSettings(solver="osqp", solver_tolerance=tolerance)
            found = refine(instance, even_start(instance), settings)
            above = found.trajectory.cost / reference - 1.0
            state = "feasible" if found.feasible else "not feasible"
            print(f"{name:20s} {tolerance:7.0e} {found.programs:3d} QPs {above:+9.3%} {state}")


@pytest.mark.parametrize("name", ["one stop", "small", "small, cold"])
def test_osqp_never_spoils_what_it_is_given(name: str) -> None:
    """Not converged, it still returns simulated plans, no worse than their start."""
    instance, reference = CASES[name], refined(name)
    settings = RefineSettings(solver="osqp", solver_tolerance=1e-3, max_programs=4)
    start = even_start(instance)
    before = merit(instance, complete(Simulation(instance), start)[1])
    cold = refine(instance, start, settings)
    assert merit(instance, cold.trajectory) <= before * (1.0 + 1e-9)
    warm = refine(instance, reference.controls, settings)
    assert warm.feasible
    assert warm.trajectory.cost <= reference.trajectory.cost * (1.0 + 1e-6)


def test_a_completed_plan_is_what_its_controls_cause() -> None:
    """A stop that is nearly right keeps its charge while a later one is corrected."""
    instance = make_instance(load_trip("paper-400km"), (0, 2))
    begin = complete(Simulation(instance), even_start(instance), frozenset({1}))[0]
    for off in (1e-5, -1e-5):
        first, second = begin.stops
        stops = (
            replace(first, energy_kwh=first.energy_kwh + off),
            replace(second, energy_kwh=second.energy_kwh + 2.0),
        )
        controls = replace(begin, stops=stops)
        done, trajectory = complete(Simulation(instance), controls, frozenset({1}))
        again = simulate(instance, done)
        assert again.cost == trajectory.cost
        np.testing.assert_array_equal(again.energy_kwh, trajectory.energy_kwh)
