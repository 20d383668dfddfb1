"""Dynamic programming: its equations are the transcription's, its value converges to our cost."""

from __future__ import annotations

import ast
from dataclasses import replace
from itertools import pairwise
from math import inf, isnan
from pathlib import Path

import numpy as np
import pytest
from trips import small_trip

from benchmarks.reference.dynamic import Resolution, dynamic_best, grid_error
from benchmarks.reference.dynamic_car import CarArrays, Levels, make_levels
from benchmarks.reference.dynamic_tables import BIG, cubic, slopes
from benchmarks.reference.dynamic_value import compute_tables
from enumerate import plan
from relax.instance import make_instance
from relax.plan import Controls, StopControls
from relax.simulate import Simulation, simulate
from relax.trip import Trip

TINY = Resolution(8.0, 2.0, 10, heater=2, pump=2, power=(1.0, 0.7))
SMALL = Resolution(4.0, 1.0, 20, heater=2, pump=2, power=(1.0, 0.7))
CELLS_AND_LEVELS = 2e-3
"""Relative difference of values that cells of W/K and coarse interpolation may cause."""


def levels(*rows: tuple[float, float, float, float]) -> Levels:
    return Levels(*np.array(rows).T)


@pytest.mark.parametrize("ambient_c", [-15.0, 5.0, 18.0])
def test_driving_steps_are_those_of_the_simulation(ambient_c: float) -> None:
    """Two authors of one equation: arrays with a fixed point, floats with secants."""
    trip = small_trip(ambient_c=ambient_c, pack__temperature_max_c=60.0)
    instance = make_instance(trip, ())
    n = instance.drive.n_steps
    rng = np.random.default_rng(3)
    heat, pump = rng.integers(0, 2, n), rng.integers(0, 2, n)
    wanted = Controls(heat * 1e3, np.zeros(n), pump * 1e3, ())  # as much as there is, or nothing
    done = simulate(instance, wanted)
    car = CarArrays(trip.vehicle)
    for k in range(n):
        steps = car.drive(
            instance.drive,
            k,
            done.energy_start_kwh[k : k + 1],
            done.temperature_start_c[k : k + 1],
            levels((heat[k], 0, pump[k], 1)),
        )
        used = instance.drive.duration_h[k] * done.power_kw[k]
        assert float(steps.drop_kwh[0]) == pytest.approx(used, abs=1e-6)
        assert float(steps.end_c[0]) == pytest.approx(done.temperature_c[k + 1], abs=1e-5)
        assert float(steps.pump_kw[0]) == pytest.approx(done.heat_pump_kw[k], abs=1e-6)
        assert float(steps.heater_kw[0]) == pytest.approx(done.heater_kw[k], abs=1e-6)


def test_charging_cells_are_those_of_the_simulation() -> None:
    trip = small_trip(ambient_c=-5.0)
    instance = make_instance(trip, (0,))
    zero, n, cells = np.zeros(instance.cells), instance.drive.n_steps, instance.cells
    stop = StopControls(12.0, np.full(cells, inf), np.full(cells, inf), zero, zero)
    idle = np.zeros(n)
    done = simulate(instance, Controls(idle, idle, idle, (stop,))).stops[0]
    got = CarArrays(trip.vehicle).charge(
        instance.stops[0], done.energy_kwh[:-1, None], done.temperature_c[:-1, None], 1.0,
        levels((1, 0, 0, 1)),
    )  # fmt: skip
    np.testing.assert_allclose(got.end_c[:, 0], done.temperature_c[1:], atol=1e-4)
    np.testing.assert_allclose(got.dwell_h[:, 0], done.dwell_h, rtol=1e-5)
    np.testing.assert_allclose(got.grid_kwh[:, 0], done.grid_kwh, rtol=1e-5)


def test_levels_never_heat_and_cool_at_once() -> None:
    made = make_levels(small_trip().vehicle, 3.0, 4, 3, (1.0, 0.5))
    assert made.heater.size == (4 + 3) * 3 * 2
    assert not np.any((made.heater > 0.0) & (made.cooling > 0.0))
    assert np.all(make_levels(small_trip().vehicle, 0.0, 4, 3).pump == 0.0)


def test_nothing_is_mixed_with_what_has_no_way_on() -> None:
    line = np.array([1.0, 2.0, 3.0, BIG, BIG, 3.0, 2.0])
    at = np.array([0, 1, 2, 2, 4, 5])
    v = np.array([0.5, 0.5, 0.0, 0.5, 0.5, 0.5])
    got = cubic(line, slopes(line), at, v)
    np.testing.assert_allclose(got, [1.5, 2.5, 3.0, BIG, BIG, 2.5])


def test_interpolation_does_not_overshoot_beside_a_kink() -> None:
    line = np.array([0.0, 0.0, 0.0, 1e4, 2e4, 1.9e4, 1.9e4])
    v = np.linspace(0.0, 1.0, 21)
    for i in range(line.size - 1):
        got = cubic(line, slopes(line), np.full(v.size, i), v)
        lo, hi = sorted(line[i : i + 2])
        assert got.min() >= lo - 1e-9 and got.max() <= hi + 1e-9
        assert np.all(np.diff(got) * np.sign(line[i + 1] - line[i]) >= -1e-9)


def test_interpolation_is_of_high_order_where_it_is_smooth() -> None:
    def error(cells: int) -> float:
        x = np.linspace(0.0, 1.0, cells + 1)
        inner = np.arange(1, cells - 1)
        got = cubic(np.exp(x), slopes(np.exp(x)), inner, np.full(inner.size, 0.4))
        return float(np.abs(got - np.exp((inner + 0.4) / cells)).max())

    assert error(16) < error(8) / 6.0


def test_grid_error() -> None:
    value, error, order = grid_error((12.0, 11.0, 10.5))  # order 1, limit 10
    assert (value, error, order) == (10.0, 0.5, 1.0)
    value, error, order = grid_error((11.0, 10.0))
    assert (value, error) == (10.0, 1.0) and isnan(order)
    assert grid_error((11.0,))[1] == inf
    assert grid_error((9.0, 10.0, 12.0))[:2] == (12.0, 2.0)  # diverging: no extrapolation
    assert grid_error((5.0, inf))[0] == inf


@pytest.fixture(scope="module")
def trip() -> Trip:
    return small_trip(start_soc=0.35, time_value_per_h=20.0, grid__step_km=10.0)


def test_value_cost_and_bound_agree_with_plan(trip: Trip) -> None:
    ours = plan(trip)
    found = dynamic_best(trip, resolutions=(TINY, SMALL))
    assert found.feasible and found.error < 0.1 * ours.cost
    assert abs(found.extrapolated - ours.transcribed_cost) <= (
        found.error + CELLS_AND_LEVELS * ours.cost
    )
    # its plan is a plan: not below any bound, and not far above our cost
    assert found.cost >= ours.lower_bound
    assert found.cost == pytest.approx(ours.transcribed_cost, rel=0.01)
    assert found.replayed_cost == pytest.approx(found.cost, rel=0.01)
    assert found.subset == tuple(
        [c.name for c in trip.chargers].index(s.charger) for s in ours.plan.stops
    )


def test_the_plan_keeps_every_limit(trip: Trip) -> None:
    found = dynamic_best(trip, resolutions=(TINY,))
    done = Simulation(make_instance(trip, found.subset)).run(found.controls)
    assert done.violation.max() <= 2e-5
    assert done.cost == found.cost
    assert found.cold_end_k > 0.0 and found.cooling_kw == 0.0


def test_value_converges(trip: Trip) -> None:
    coarsest = replace(TINY, temperature_k=16.0, cell_kwh=4.0, surplus=5)
    coarse, medium, fine = (
        compute_tables(trip, mesh).value_at_start for mesh in (coarsest, TINY, SMALL)
    )
    assert abs(fine - medium) < abs(medium - coarse)
    assert abs(fine - medium) < 0.01 * fine


def test_all_subsets_at_once_are_the_best_subset(trip: Trip) -> None:
    at_once = compute_tables(trip, TINY).value_at_start
    each = [compute_tables(trip, TINY, s).value_at_start for s in ((), (0,), (1,), (0, 1))]
    assert at_once == pytest.approx(min(each), rel=CELLS_AND_LEVELS)


def test_cooling_is_idle_in_winter(trip: Trip) -> None:
    with_it, without = (
        compute_tables(trip, replace(SMALL, cooling=cooling)).value_at_start
        for cooling in (True, False)
    )
    assert with_it == pytest.approx(without, rel=CELLS_AND_LEVELS)


def test_the_frontier_is_the_least_energy_that_gets_there() -> None:
    """Without a stop: starting on the frontier, with no heating, the car ends with its least."""
    trip = small_trip(start_soc=0.9, vehicle__heat_pump_kw=0.0)
    tables = compute_tables(trip, SMALL, ())
    start_c = trip.start_temperature_c
    frontier = float(tables.along(tables.frontier[0][0], np.array(start_c)))
    instance = replace(make_instance(trip, ()), start_energy_kwh=frontier)
    idle = np.zeros(instance.drive.n_steps)
    done = simulate(instance, Controls(idle, idle, idle, ()))
    assert done.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=0.01)


def test_an_occupancy_fee_is_in_the_value() -> None:
    """A stop longer than the free half hour, at the charger with a fee alone."""
    trip = small_trip(start_soc=0.55, end_soc_min=0.6, time_value_per_h=5.0, grid__step_km=10.0)
    trip = replace(trip, chargers=trip.chargers[1:])
    found = dynamic_best(trip, resolutions=(TINY, SMALL))
    assert found.trajectory.stops[0].dwell_h.sum() > trip.chargers[0].occupancy_free_h
    assert found.cost == pytest.approx(plan(trip).transcribed_cost, rel=CELLS_AND_LEVELS)
    assert found.value == pytest.approx(found.cost, rel=2.0 * CELLS_AND_LEVELS)


def test_out_of_reach_has_no_value() -> None:
    far = small_trip(start_soc=0.06)
    found = dynamic_best(far, resolutions=(TINY,))
    assert found.value == inf and found.controls is None and not found.feasible


def test_a_limit_of_the_time_in_all_is_refused(trip: Trip) -> None:
    with pytest.raises(ValueError, match="time in all"):
        compute_tables(replace(trip, stop_time_h=1.0), TINY)


def test_more_energy_at_the_start_never_costs_more(trip: Trip) -> None:
    tables = compute_tables(trip, SMALL)
    costs = []
    for soc in (0.3, 0.4, 0.5, 0.6):
        energy = float(trip.vehicle.pack.energy_kwh(soc))
        found = tables.departure(energy, trip.start_temperature_c, 0, tables.order[-1])
        costs.append(min(cost for _, cost in found))
    assert all(a >= b - 1e-3 for a, b in pairwise(costs))


def test_no_solver_is_imported() -> None:
    folder = Path(__file__).resolve().parents[1] / "benchmarks" / "reference"
    files = [*folder.glob("dynamic*.py"), *folder.glob("driver*.py")]
    assert len(files) >= 6
    for file in files:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        modules += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        for module in modules:
            assert not module.startswith(("casadi", "clarabel", "relax.relaxation", "relax.solve"))
