"""The nonlinear reference: its maps, its program, its plans on the tables, its benchmark rows."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytest.importorskip("casadi", reason="the nonlinear reference needs CasADi (extra: bench)")

from benchmarks.reference.nlp import Model, make_model
from benchmarks.reference.peer import SOLVERS, build_peer, solve_peer
from benchmarks.reference.polish import polish, release
from benchmarks.reference.search import all_subsets, is_out_of_reach, reference_best
from benchmarks.reference.splines import fit_curve, fit_spline, fit_surface
from benchmarks.reference.stages import INTEGRATORS, fit_car, make_stages
from benchmarks.reference.starts import Start, make_start, single_start, starts
from relax import load_trip, make_instance, simulate
from relax.instance import Instance
from relax.maps import Table1
from relax.plan import Controls, Trajectory
from relax.simulate import is_feasible
from relax.trip import Grid, Trip

SMALL = Grid(20.0, 4)


def small_trip(**changes: float) -> Trip:
    overrides = {"route.ambient_c": -10.0, "vehicle.heat_pump_kw": 1.0} | changes
    return replace(load_trip("paper-400km", overrides=overrides), grid=SMALL)


def point_of(model: Model, controls: Controls, trajectory: Trajectory) -> np.ndarray:
    """The program's variables along a simulated trip: the inverse of ``Model.controls``."""
    value = np.zeros(model.scale.size)
    for k, row in enumerate(model.steps):
        entries = {
            "energy": trajectory.energy_start_kwh[k],
            "temperature": trajectory.temperature_start_c[k],
            "power": trajectory.power_kw[k],
            "rise": trajectory.temperature_c[k + 1] - trajectory.temperature_start_c[k],
            "heater": trajectory.heater_kw[k],
            "cooling": trajectory.cooling_kw[k],
            "pump": trajectory.heat_pump_kw[k],
            "brake": trajectory.brake_kw[k],
        }
        for name in row:
            value[row[name]] = entries[name]
    for rows, stop, done, order in zip(
        model.cells, model.instance.stops, trajectory.stops, controls.stops, strict=True
    ):
        spent = np.concatenate([[0.0], np.cumsum(done.dwell_h)])
        over = max(0.0, spent[-1] - stop.occupancy_free_h)
        for j, row in enumerate(rows):
            entries = {
                "energy": done.energy_kwh[j] + (stop.detour_in_kwh if j == 0 else 0.0),
                "temperature": done.temperature_c[j],
                "rise": done.temperature_c[j + 1] - done.temperature_c[j],
                "charge": order.energy_kwh,
                "charge_power": done.power_kw[j],
                "dwell": spent[j],
                "heater": done.heater_kw[j],
                "cooling": done.cooling_kw[j],
                "pump": done.heat_pump_kw[j],
                "over": over,
            }
            for name in row:
                value[row[name]] = entries[name]
    value[model.last["energy"]] = trajectory.final_energy_kwh
    value[model.last["temperature"]] = trajectory.final_temperature_c
    return value / model.scale


def violation(model: Model, point: np.ndarray) -> tuple[float, float]:
    """Largest violation of constraints and of bounds, scaled; and the program's cost."""
    import casadi as ca

    program = model.program
    f, g = ca.Function("fg", [program["x"]], [program["f"], program["g"]])(point)
    values = np.array(g).ravel()
    worst = max(
        float((model.g_lo - values).max()),
        float((values - model.g_hi).max()),
        float((model.x_lo - point).max()),
        float((point - model.x_hi).max()),
    )
    return worst, float(f)


def test_spline_of_an_affine_table_is_the_table() -> None:
    spline = fit_curve(Table1([0.0, 1.0, 4.0], [1.0, 3.0, 9.0]), 0.0, 4.0)
    assert spline.knots == ()
    x = np.linspace(0.0, 4.0, 9)
    np.testing.assert_allclose(spline(x), 1.0 + 2.0 * x, atol=1e-12)


def test_splines_are_near_the_shipped_maps() -> None:
    instance = make_instance(small_trip(), (1,))
    pack = instance.vehicle.pack
    t = np.linspace(-30.0, 40.0, 701)
    for table in (pack.resistance_ohm, instance.vehicle.heat_pump_cop):
        np.testing.assert_allclose(fit_curve(table, -30.0, 40.0)(t), table(t), rtol=2.5e-3)
    energy, temp = np.meshgrid(
        np.linspace(4.0, instance.energy_max_kwh, 60), np.linspace(-30.0, 40.0, 71)
    )
    for surface in (pack.charge_limit_kw, pack.discharge_limit_kw):
        fit = fit_surface(surface, 3.6, instance.energy_max_kwh, -30.0, 40.0)
        error = np.abs(fit(energy, temp) - surface(energy, temp))
        assert error.max() < 6e-3 * surface.f.max()


def test_a_spline_has_two_continuous_derivatives_at_its_knots() -> None:
    x = np.linspace(0.0, 1.0, 21)
    spline = fit_spline(x, np.abs(x - 0.5) + 0.1)
    assert len(spline.knots) > 3
    h = 1e-4
    for knot in spline.knots:
        left, right = (
            spline(knot - np.array([0.0, h, 2 * h])),
            spline(knot + np.array([0.0, h, 2 * h])),
        )
        bend = [(v[2] - 2 * v[1] + v[0]) / h**2 for v in (left, right)]
        scale = 6.0 * max(abs(j) for j in spline.jumps) * 2 * h
        assert abs(bend[0] - bend[1]) <= scale + 1e-4


@pytest.mark.parametrize("subset", [(0,), (1,), (0, 2), (0, 1, 2)])
def test_stage_counts_add_up(subset: tuple[int, ...]) -> None:
    model = make_model(make_instance(small_trip(), subset))
    stages = 20 + len(subset) * SMALL.cells + 1
    assert len(model.nx) == len(model.nu) == len(model.ng) == stages
    assert sum(model.nx) + sum(model.nu) == model.x_lo.size
    assert sum(model.nx) + sum(model.ng) == model.g_lo.size
    assert len(model.discharge) == 20


def test_the_program_is_the_transcription() -> None:
    """A simulated plan is a point of the program: same dynamics, limits and cost."""
    instance = make_instance(small_trip(), (0, 2))
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    assert run.feasible
    model = make_model(instance)
    worst, cost = violation(model, point_of(model, run.controls, run.trajectory))
    assert worst < 6e-3  # of order-one rows: what splines and tables differ by
    assert cost * 100.0 + instance.fixed_cost == pytest.approx(run.cost, rel=3e-5)
    moved = point_of(model, run.controls, run.trajectory)
    moved[model.steps[3]["power"]] += 0.1
    assert violation(model, moved)[0] > 5e-2


@pytest.mark.parametrize("solver", SOLVERS)
def test_plans_hold_on_the_tables_and_end_empty(solver: str) -> None:
    instance = make_instance(small_trip(), (1, 2))
    run = solve_peer(build_peer(instance, solver), single_start(instance))
    assert run.success and run.feasible
    assert run.cost == pytest.approx(run.claimed_cost, rel=1e-3)
    again = simulate(instance, run.controls)
    assert again.cost == run.cost and is_feasible(again)
    assert again.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=1e-4)
    assert 0.0 < run.evaluation_s < run.solve_s


def test_both_solvers_and_both_limits_agree() -> None:
    instance = make_instance(small_trip(), (0, 2))
    stages = make_stages(instance)
    costs = [
        solve_peer(build_peer(instance, solver, stages, lazy=lazy), single_start(instance)).cost
        for solver in SOLVERS
        for lazy in (True, False)
    ]
    assert max(costs) - min(costs) < 1e-4 * costs[0]


def test_a_discharge_limit_that_binds_is_kept() -> None:
    trip = small_trip()
    pack = trip.vehicle.pack
    weak = replace(
        pack, discharge_limit_soc_kw=replace_values(pack.discharge_limit_soc_kw, 0.0, 26.0)
    )
    trip = replace(trip, vehicle=replace(trip.vehicle, pack=weak))
    instance = make_instance(trip, (1,))
    free = solve_peer(
        build_peer(make_instance(small_trip(), (1,)), "ipopt"), single_start(instance)
    )
    assert free.trajectory.power_kw.max() > 26.5
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    assert run.feasible and run.build_s > 0.0
    assert run.trajectory.power_kw.max() <= 26.0 + 2e-5
    assert run.cost > free.cost


def replace_values(table, lo: float, hi: float):  # type: ignore[no-untyped-def]
    return type(table)(table.x, table.y, np.clip(table.f, lo, hi), table.name)


def test_polish_repairs_energy_and_takes_what_is_left() -> None:
    instance = make_instance(small_trip(), (0, 2))
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    for change in (-0.3, 0.3):
        stops = list(run.controls.stops)
        stops[0] = replace(stops[0], energy_kwh=stops[0].energy_kwh + change)
        wrong = replace(run.controls, stops=tuple(stops))
        before = simulate(instance, wrong)
        _, after = polish(instance, wrong)
        assert is_feasible(after)
        assert after.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=2e-5)
        if change < 0.0:
            assert not is_feasible(before)
        else:
            assert after.cost < before.cost
        assert after.cost == pytest.approx(run.cost, rel=5e-3)


def test_release_frees_only_what_is_at_a_limit() -> None:
    instance = make_instance(small_trip(), (1,))
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    stop = run.controls.stops[0]
    applied = run.trajectory.stops[0].power_kw
    slow = replace(stop, power_kw=applied * np.array([1.0, 0.995, 0.5, 0.9]))
    freed = release(instance, replace(run.controls, stops=(slow,))).stops[0].power_kw
    np.testing.assert_array_equal(np.isinf(freed), [True, True, False, False])


def test_polish_of_a_hopeless_plan_says_infeasible() -> None:
    instance = make_instance(small_trip(), (2,))
    model = make_model(instance)
    controls = model.controls(make_start(model, single_start(instance)))
    _, trajectory = polish(instance, controls)
    assert not is_feasible(trajectory)


def test_starts_are_inside_the_bounds_and_differ() -> None:
    instance = make_instance(small_trip(), (0, 2))
    model = make_model(instance)
    points = [make_start(model, s) for s in starts(instance)]
    assert len(points) == 12
    for point in points:
        assert np.all(point >= model.x_lo) and np.all(point <= model.x_hi)
    assert len({point.tobytes() for point in points}) == 12
    np.testing.assert_array_equal(points[0], make_start(model, starts(instance)[0]))
    with pytest.raises(ValueError, match="one share per stop"):
        make_start(model, Start(20.0, (1.0,)))


def test_unknown_solver() -> None:
    with pytest.raises(ValueError, match="unknown solver"):
        build_peer(make_instance(small_trip(), (1,)), "snopt")


def reach(instance: Instance) -> bool:
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    return run.success and run.feasible


def test_out_of_reach_gives_no_false_alarm() -> None:
    trip = small_trip()
    verdicts = {s: is_out_of_reach(make_instance(trip, s)) for s in all_subsets(3)}
    assert verdicts[()]
    for subset, out in verdicts.items():
        if out and subset:
            assert not reach(make_instance(trip, subset))
    assert not verdicts[(1,)] and reach(make_instance(trip, (1,)))


def test_enumeration_keeps_the_best_and_logs_every_solve(tmp_path) -> None:  # type: ignore[no-untyped-def]
    trip = small_trip()
    trip = replace(trip, chargers=trip.chargers[1:])
    file = tmp_path / "rows.jsonl"
    seen: list[dict[str, object]] = []
    reference = reference_best(trip, "fatrop", False, file=file, progress=seen.append)
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert rows == json.loads(json.dumps(seen)) and len(rows) == len(reference.rows)
    assert [r["subset"] for r in rows] == [[0], [1], [0, 1]]  # () is out of reach
    costs = {tuple(r["subset"]): r["cost"] for r in rows if r["feasible"]}
    assert reference.best is not None
    assert reference.best_subset == min(costs, key=lambda s: costs[s])
    assert reference.best.cost == min(costs.values())


def test_a_destination_stop_and_two_stops_at_one_place() -> None:
    trip = small_trip()
    first, second, third = trip.chargers
    moved = (first, replace(second, position_km=100.0), replace(third, position_km=400.0))
    instance = make_instance(replace(trip, chargers=moved, end_soc_min=0.3), (0, 1, 2))
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    assert run.success and run.feasible
    assert run.trajectory.final_energy_kwh == pytest.approx(instance.end_energy_min_kwh, abs=1e-4)


def test_occupancy_cost_is_in_the_program() -> None:
    trip = small_trip()
    busy = tuple(
        replace(c, occupancy_free_h=0.1, occupancy_price_per_h=200.0) for c in trip.chargers
    )
    free, paid = (
        solve_peer(
            build_peer(make_instance(t, (1,)), "ipopt"), single_start(make_instance(t, (1,)))
        )
        for t in (trip, replace(trip, chargers=busy))
    )
    assert paid.feasible and paid.cost > free.cost
    assert paid.cost == pytest.approx(paid.claimed_cost, rel=1e-3)
    dwell = [float(r.trajectory.stops[0].dwell_h.sum()) for r in (free, paid)]
    assert dwell[1] < dwell[0]  # a dear dwell is shorter


def test_runge_kutta_integrates_a_driving_step() -> None:
    """Against an adaptive integration of the same equations, written out here."""
    instance = make_instance(small_trip(), (1,))
    car, drive, vehicle = fit_car(instance), instance.drive, instance.vehicle
    k, start, heater, cooling, pump = 4, [50.0, 5.0], 2.0, 0.0, 0.8
    d, base, ripple, q_ed, g, ambient, demand = (
        float(a[k])
        for a in (
            drive.duration_h, drive.base_kw, drive.ripple_kw2, drive.drivetrain_heat_kw,
            drive.heat_loss_kw_per_k, drive.ambient_c, drive.cabin_heat_kw,
        )
    )  # fmt: skip

    def rates(_: float, state: np.ndarray) -> list[float]:
        energy, temp = state
        heat = car.cop(temp) * pump * (1.0 - vehicle.heat_pump_droop_per_kw * pump)
        load = base + heater + cooling + pump + (demand - heat) / vehicle.heater_cabin_efficiency
        r = car.resistance(temp) / car.voltage_squared(energy)
        power = (1.0 - np.sqrt(1.0 - 4.0 * r * (load + r * ripple))) / (2.0 * r)
        flow = r * (power**2 + ripple) + q_ed + vehicle.heater_battery_efficiency * heater
        flow += pump - heat + g * (ambient - temp)
        return [-power, flow / vehicle.pack.heat_capacity_kwh_per_k]

    step, errors = make_stages(instance, "rk4").step, []
    for part in (d, 0.25 * d):
        end = solve_ivp(rates, (0.0, part), start, rtol=1e-12, atol=1e-12).y[:, -1]
        known = (part, base, ripple, q_ed, g, ambient, demand)
        power, rise, *_ = (float(v) for v in step(*start, heater, cooling, pump, 0.0, *known))
        errors.append(np.abs([start[0] - part * power - end[0], start[1] + rise - end[1]]).max())
    assert errors[0] < 1e-4 and errors[1] < errors[0] / 200.0
    # the midpoint rule is near, but another one: its residuals are those of its order
    implicit = make_stages(instance).step
    residuals = implicit(*start, power, rise, heater, cooling, pump, 0.0, *known)[:2]
    assert 1e-6 < max(abs(float(v)) for v in residuals) < 1e-2


def test_runge_kutta_integrates_a_cell() -> None:
    instance = make_instance(small_trip(), (1,))
    car, vehicle, stop = fit_car(instance), instance.vehicle, instance.stops[0]
    portion, charge_power, heater, pump, start = 8.0, 60.0, 3.0, 0.5, [30.0, 5.0, 0.0]

    def rates(_: float, state: np.ndarray) -> list[float]:
        energy, temp, _grid = state
        heat = car.cop(temp) * pump * (1.0 - vehicle.heat_pump_droop_per_kw * pump)
        loss = car.resistance(temp) / car.voltage_squared(energy) * charge_power**2
        cabin = (stop.cabin_heat_kw - heat) / vehicle.heater_cabin_efficiency
        flow = loss + vehicle.heater_battery_efficiency * heater + pump - heat
        flow += stop.heat_loss_kw_per_k * (stop.ambient_c - temp)
        grid = charge_power + loss + stop.base_kw + heater + pump + cabin
        return [charge_power, flow / vehicle.pack.heat_capacity_kwh_per_k, grid]

    dwell = portion / charge_power
    end = solve_ivp(rates, (0.0, dwell), start, rtol=1e-11, atol=1e-11).y[:, -1]
    rise, _, _, spent, grid, _ = (
        float(v)
        for v in make_stages(instance, "rk4").cell(
            *start[:2], portion, charge_power, heater, 0.0, pump,
            stop.base_kw, stop.heat_loss_kw_per_k, stop.ambient_c, stop.cabin_heat_kw,
        )
    )  # fmt: skip
    assert spent == dwell
    assert start[1] + rise == pytest.approx(end[1], abs=2e-5)
    assert grid * dwell == pytest.approx(end[2], abs=2e-5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_runge_kutta_and_midpoint_meet_on_a_finer_grid(solver: str) -> None:
    apart = []
    for grid in (Grid(40.0, 2), Grid(20.0, 4), Grid(10.0, 8)):
        instance = make_instance(replace(small_trip(), grid=grid), (1,))
        runs = [
            solve_peer(build_peer(instance, solver, integrator=i), single_start(instance))
            for i in INTEGRATORS
        ]
        assert all(run.success and run.feasible for run in runs)
        assert runs[1].cost == pytest.approx(runs[0].cost, rel=2e-3)  # the same controls, nearly
        apart.append(abs(runs[1].claimed_cost / runs[0].claimed_cost - 1.0))
    assert 1e-7 < apart[2] < 0.5 * apart[1] < 0.25 * apart[0]
    with pytest.raises(ValueError, match="unknown integrator"):
        build_peer(instance, solver, integrator="euler")


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_limit_of_all_time_at_stops_is_kept(solver: str) -> None:
    trip = small_trip()
    free = solve_peer(
        build_peer(make_instance(trip, (0, 2)), solver), single_start(make_instance(trip, (0, 2)))
    )
    dwell = sum(float(s.dwell_h.sum()) for s in free.trajectory.stops)
    detours = sum(c.detour_in_h + c.detour_out_h for c in (trip.chargers[0], trip.chargers[2]))
    trip = replace(trip, stop_time_h=detours + 0.97 * dwell)
    instance = make_instance(trip, (0, 2))
    run = solve_peer(build_peer(instance, solver), single_start(instance))
    assert run.success and run.feasible and run.cost > free.cost
    stopped = sum(float(s.dwell_h.sum()) for s in run.trajectory.stops)
    assert stopped == pytest.approx(0.97 * dwell, rel=2e-3) and stopped <= 0.97 * dwell + 1e-5
    assert is_out_of_reach(make_instance(replace(trip, stop_time_h=0.9 * detours), (0, 2)))


def test_a_start_above_the_largest_charge_is_no_contradiction() -> None:
    trip = replace(small_trip(), soc_max=0.8)
    instance = make_instance(trip, (1,))
    assert instance.start_energy_kwh > instance.energy_max_kwh
    run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    assert run.success and run.feasible
    assert run.trajectory.energy_kwh[1] > instance.energy_max_kwh


def test_benchmarks_smoke(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    import os

    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    try:
        from benchmarks import optimality, speed

        rows, figures = tmp_path / "o.csv", tmp_path / "s.json"
        assert optimality.main(["--smoke", "--file", str(rows)]) == 0
        first = rows.read_text()
        assert optimality.main(["--smoke", "--resume", "--file", str(rows)]) == 0
        assert rows.read_text() == first  # resumed: nothing left to do
        assert speed.main(["--smoke", "--file", str(figures)]) == 0
    finally:
        if cores is not None:
            os.sched_setaffinity(0, cores)
    assert {"evrelax", "ipopt", "fatrop"} == {line.split(",")[3] for line in first.splitlines()[1:]}
    median = json.loads(figures.read_text())["median"]
    assert median["fatrop"]["solve_s"] > 0.0 and "ours/best" in capsys.readouterr().out
