"""The limit of charging and detour time, from the file to the replay: kept by plans, implied by the
relaxation for every trajectory that keeps it, named when it is broken."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from test_relaxation import ROW_TOLERANCE, feasible, instances
from trips import small_trip, write_trip

from enumerate import Status, plan
from relax import (
    InputError,
    Instance,
    execute,
    idle_controls,
    load_trip,
    make_instance,
    refine,
    replay,
    simulate,
)
from relax.bound import relax_subset
from relax.reach import make_box, propagate
from relax.refinement import Refined
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.simulate import FEASIBLE
from relax.solve import SolveSettings, solve_cone
from relax.spec import make_spec
from relax.starts import best_start, even_start
from relax.tighten import prove

CASES = [c for c in instances() if c[1].stops][::2]


def limited(instance: Instance, hours: float) -> Instance:
    return replace(instance, total_dwell_h=hours)


def best(instance: Instance) -> Refined:
    rough = relax_subset(instance)
    assert rough.lower_bound is not None
    return refine(instance, best_start(instance, rough.point, rough.lower_bound))


def hours(found: Refined) -> float:
    return sum(float(s.dwell_h.sum()) for s in found.trajectory.stops)


def test_the_limit_comes_from_the_file_and_is_none_by_default(tmp_path: Path) -> None:
    assert load_trip(write_trip(tmp_path)).stop_time_h == inf
    assert load_trip(write_trip(tmp_path, **{"limits.stop_time_h": 0.75})).stop_time_h == 0.75
    assert load_trip(write_trip(tmp_path), {"limits.stop_time_h": 0}).stop_time_h == 0.0


@pytest.mark.parametrize("value", [-0.1, "an hour", inf])
def test_a_bad_limit_is_named(tmp_path: Path, value: object) -> None:
    with pytest.raises(InputError, match=r"limits\.stop_time_h.*charging and detour time"):
        load_trip(write_trip(tmp_path), {"limits.stop_time_h": value})


def test_what_detours_leave_is_for_charging() -> None:
    trip = small_trip(stop_time_h=0.5)
    left = [make_instance(trip, s).total_dwell_h for s in ((), (0,), (1,), (0, 1))]
    assert left == pytest.approx([0.5, 0.5 - 4 / 60, 0.5 - 8 / 60, 0.5 - 12 / 60])
    assert make_instance(small_trip(), (0, 1)).total_dwell_h == inf


def test_the_simulation_states_the_excess() -> None:
    instance = make_instance(small_trip(stop_time_h=0.3), (0, 1))
    trajectory = simulate(instance, idle_controls(instance, (6.0, 6.0)))
    spent = sum(float(s.dwell_h.sum()) for s in trajectory.stops)
    assert spent > 0.1
    assert trajectory.violation[3] == pytest.approx(spent - 0.1)
    roomy = replace(instance, total_dwell_h=spent + 1e-9)
    assert simulate(roomy, idle_controls(roomy, (6.0, 6.0))).violation[3] == 0.0
    alone = make_instance(small_trip(stop_time_h=0.0, start_soc=0.9), ())
    assert simulate(alone, idle_controls(alone, ())).violation[3] == 0.0


@pytest.mark.parametrize(
    ("trip", "subset"),
    [
        (load_trip("paper-400km", {"objective.time_value_per_h": 0}), (1,)),
        (load_trip("paper-400km", {"objective.time_value_per_h": 0, "route.ambient_c": 0}), (1, 2)),
        (small_trip(time_value_per_h=0.0), (0, 1)),
    ],
)
def test_plans_keep_a_shrinking_limit_and_cost_more(trip, subset) -> None:  # type: ignore[no-untyped-def]
    """Also from starts that are far too slow; and the least cost is that of a weighted sum."""
    instance = make_instance(trip, subset)
    free = best(instance)
    start, cost = free.controls, free.trajectory.cost
    hurried = best(make_instance(replace(trip, time_value_per_h=200.0), subset))
    for share in (0.75, 0.5, 0.25, 0.0):
        most = share * hours(free) + (1.0 - share) * hours(hurried)
        found = refine(limited(instance, most), start)
        assert found.feasible
        assert hours(found) <= most + FEASIBLE
        assert found.trajectory.cost >= cost * (1.0 - 1e-4)
        start, cost = found.controls, found.trajectory.cost
    paid = sum(s.price_per_kwh * float(d.grid_kwh.sum()) for s, d in _done(instance, hurried))
    paid += instance.fixed_cost + _occupied(instance, hurried)
    assert cost == pytest.approx(paid, rel=2e-3)


def _done(instance: Instance, found: Refined):  # type: ignore[no-untyped-def]
    return zip(instance.stops, found.trajectory.stops, strict=True)


def _occupied(instance: Instance, found: Refined) -> float:
    return sum(
        s.occupancy_price_per_h * max(0.0, float(d.dwell_h.sum()) - s.occupancy_free_h)
        for s, d in _done(instance, found)
    )


def test_trajectories_within_the_limit_lie_in_box_and_rows() -> None:
    seen = broken = 0
    for seed, (name, instance) in enumerate(CASES):
        for trajectory in feasible(instance, seed, tries=40, want=2):
            spent = sum(float(s.dwell_h.sum()) for s in trajectory.stops)
            tight = limited(instance, spent * (1.0 + 1e-9))
            box = make_box(tight)
            assert box.empty is None, f"{name}: {box.empty}"
            for _ in range(2):
                box = propagate(tight, box)
            program = build_relaxation(tight, box)
            x = lift(tight, program, trajectory)
            assert np.all(x >= program.l - 1e-8) and np.all(x <= program.u + 1e-8), name
            assert program.slack(x).min() > -ROW_TOLERANCE, name
            shorter = make_box(limited(instance, 0.98 * spent))
            if not shorter.empty:
                program = build_relaxation(limited(instance, 0.98 * spent), shorter)
                slack = program.slack(lift(instance, program, trajectory))
                broken += slack[program.rows["stop time at most"]].min() < 0.0
            seen += 1
    assert seen > 40 and broken > 20


def test_bounds_rise_as_the_limit_falls_and_stay_below_every_plan() -> None:
    instance = make_instance(load_trip("paper-400km"), (1,))
    free = best(instance)
    bounds = []
    for share in (1.5, 1.0, 0.95, 0.9):
        tight = limited(instance, share * hours(free))
        result = relax_subset(tight)
        found = refine(tight, free.controls)
        assert result.lower_bound is not None and not result.infeasible
        assert not found.feasible or result.lower_bound <= found.trajectory.cost
        bounds.append(result.lower_bound)
    assert bounds == sorted(bounds) and bounds[-1] > bounds[0] + 1.0
    cost = free.trajectory.cost
    proof = prove(limited(instance, hours(free) + 1e-6), 1.001 * cost, max_boxes=3)
    assert not proof.closed and proof.lower_bound <= cost
    proof = prove(limited(instance, hours(free)), 0.98 * cost)
    assert proof.closed


def test_too_little_time_is_proved_infeasible() -> None:
    instance = make_instance(load_trip("paper-400km"), (1, 2))
    assert relax_subset(limited(instance, -0.01)).infeasible
    assert relax_subset(limited(instance, 0.1)).infeasible
    result = plan(load_trip("paper-400km", {"limits.stop_time_h": 0.25}))
    assert result.status is Status.INFEASIBLE
    assert result.diagnosis is not None
    assert any("limits.stop_time_h" in text for text in result.diagnosis.remedies)


@pytest.mark.parametrize("name", ["small 0.0 3.0 (0, 1)", "small -20.0 0.0 (0, 1)"])
def test_the_twin_in_cvxpy_has_the_row_too(name: str) -> None:
    instance = next(i for n, i in instances() if n == name)
    trajectory = feasible(instance, 3, want=1)[0]
    spent = sum(float(s.dwell_h.sum()) for s in trajectory.stops)
    free = build_relaxation(instance, make_box(instance))
    tight = limited(instance, 0.8 * spent)
    box = make_box(instance)  # the free box, so that the row must do it
    program = build_relaxation(tight, box)
    values = [solve_cone(p, SolveSettings(tolerance=1e-8)).objective for p in (free, program)]
    spec = make_spec(tight, box)
    spec.problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-7, tol_gap_rel=1e-7, tol_feas=1e-7)
    assert spec.problem.value == pytest.approx(values[1] + program.constant, rel=1e-5)
    assert values[1] >= values[0] - 1e-6


def test_the_replay_names_the_limit_and_the_execution_repairs_a_hair() -> None:
    trip = load_trip("paper-400km", {"grid.step_km": 20.0, "grid.cells": 3})
    instance = make_instance(trip, (1, 2))
    found = refine(instance, even_start(instance))
    targets = tuple(float(s.energy_kwh[-1]) for s in found.trajectory.stops)
    driven = replay(trip, instance, found.controls, targets)
    spent = sum(s.dwell_h for s in driven.stops)
    late = replay(trip, limited(instance, spent - 0.01), found.controls, targets)
    rules = {v.rule: v for v in late.violations}
    broken = rules["charging and detours beyond the time allowed for all stops"]
    assert (broken.position_km, broken.unit) == (400.0, "h")
    assert broken.amount == pytest.approx(0.01, abs=1e-6)
    tight = limited(instance, spent - 0.002)
    done = execute(trip, tight, refine(tight, found.controls))
    assert done.reason == "" and done.replay is not None
    assert sum(s.dwell_h for s in done.replay.stops) <= spent - 0.002 + 1e-4


def test_a_planned_trip_arrives_in_time() -> None:
    changes = {"route.ambient_c": 10.0, "objective.time_value_per_h": 0.0}
    free = plan(load_trip("paper-400km", changes))
    assert free.plan is not None
    most = 0.9 * free.plan.stop_time_h
    result = plan(load_trip("paper-400km", {**changes, "limits.stop_time_h": most}))
    assert result.plan is not None and result.replay is not None and result.replay.feasible
    assert result.plan.stop_time_h <= most + 2e-4
    assert result.plan.total_h == pytest.approx(result.plan.driving_h + result.plan.stop_time_h)
    assert free.cost <= result.cost <= 1.05 * free.cost
