"""BONMIN and SCIP on tiny trips: they agree with all others, and bounds are bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest

pytest.importorskip("casadi", reason="the nonlinear reference needs CasADi (extra: bench)")
pytest.importorskip("pyscipopt", reason="the global reference needs PySCIPOpt (extra: bench)")

from benchmarks.reference.bonmin import bonmin_best
from benchmarks.reference.quiet import quiet
from benchmarks.reference.scip import ScipResult, WarmStart, scip_solve
from benchmarks.reference.scip_maps import Form, fit_band, fit_cap, fit_form
from benchmarks.reference.scip_model import make_scip_model
from benchmarks.reference.scip_point import point_of
from benchmarks.reference.search import reference_best
from enumerate import plan
from relax import load_trip, make_instance, simulate
from relax.instance import Instance
from relax.maps import Table1, Table2
from relax.plan import Controls
from relax.refinement import refine
from relax.simulate import idle_controls
from relax.trip import Grid, Trip
from tests.trips import small_trip

AGREE = 1e-4
"""Relative difference of costs that two solvers may have on one problem."""
BOUND_ROUNDING = 1e-6
"""What SCIP's tolerance per row may add to its bound."""


def tiny_trip(**changes: object) -> Trip:
    return replace(small_trip(**changes), grid=Grid(60.0, 1))


def our_controls(instance: Instance) -> Controls:
    share = 20.0 / len(instance.stops)
    return refine(instance, idle_controls(instance, (share,) * len(instance.stops))).controls


@cache
def proved() -> ScipResult:
    """The tiny trip on its tables, solved to the end."""
    return scip_solve(tiny_trip(), None, 120.0, tables=True, gap=1e-5)


def test_all_solvers_agree_on_the_best_subset_and_its_cost() -> None:
    trip = tiny_trip()
    ours = plan(trip)
    ipopt, bonmin = reference_best(trip, "ipopt"), bonmin_best(trip)
    assert ours.is_feasible and ipopt.best is not None and bonmin.run is not None
    names = [c.name for c in trip.chargers]
    assert ours.plan is not None
    subset = tuple(names.index(s.charger) for s in ours.plan.stops)
    assert subset == ipopt.best_subset == bonmin.subset == proved().subset
    assert bonmin.success and bonmin.run.feasible and proved().feasible
    costs = [ours.transcribed_cost, ipopt.best.cost, bonmin.run.cost, proved().cost]
    assert max(costs) - min(costs) < AGREE * min(costs)
    assert proved().gap <= 1e-5
    assert proved().dual <= min(costs) + BOUND_ROUNDING * min(costs)
    # no solver beats the proved optimum: then one of the two models would not be the other
    assert min(costs) >= proved().primal - BOUND_ROUNDING * proved().primal
    assert ours.lower_bound <= proved().primal * (1.0 + BOUND_ROUNDING)


@pytest.mark.parametrize("tables", [True, False])
def test_the_dual_bound_is_below_our_plan(tables: bool) -> None:
    trip = tiny_trip()
    instance = make_instance(trip, (1,))
    cost = simulate(instance, our_controls(instance)).cost
    found = scip_solve(trip, (1,), 60.0, gap=1e-3, tables=tables)
    assert found.subset == (1,) and found.feasible
    assert found.dual <= cost * (1.0 + BOUND_ROUNDING)
    assert found.cost == pytest.approx(cost, rel=AGREE)
    assert 0.0 <= found.gap <= 1e-3
    assert found.dual > 0.98 * cost  # and not below for nothing
    if tables:
        assert max(found.deviation.values()) < 1e-9
        assert found.primal == pytest.approx(found.cost, rel=1e-6)
    else:
        assert 0.0 < max(found.deviation.values()) < 0.01
        assert found.primal < found.cost  # the margins favour the solver


@pytest.mark.parametrize("tables", [True, False])
@pytest.mark.parametrize("subset", [(0,), (1,), (0, 1)])
def test_a_simulated_plan_is_a_point_of_the_program(subset: tuple[int, ...], tables: bool) -> None:
    trip = replace(small_trip(ambient_c=-10.0), grid=Grid(20.0, 3))
    everything = make_instance(trip, (0, 1))
    instance = make_instance(trip, subset)
    trajectory = simulate(instance, our_controls(instance))
    assert trajectory.cost > 0.0
    for whole, optional in ((instance, False), (everything, True)):
        written = make_scip_model(whole, optional, *([0.0] if tables else []))
        model = written.model
        model.hideOutput()
        solution = model.createOrigSol()
        values = point_of(written, subset, trajectory)
        assert len(values) >= model.getNVars(transformed=False)
        for variable, value in values:
            model.setSolVal(solution, variable, value)
        assert model.checkSol(solution, printreason=False, original=True)
        assert model.getSolObjVal(solution) == pytest.approx(trajectory.cost, rel=1e-9)
        row = written.steps[2]
        model.setSolVal(solution, row["power"], 1.01 * model.getSolVal(solution, row["power"]))
        assert not model.checkSol(solution, printreason=False, original=True)


def test_a_plan_to_start_from_is_taken_and_kept() -> None:
    trip = replace(small_trip(), grid=Grid(20.0, 3))
    instance = make_instance(trip, (0,))
    controls = our_controls(instance)
    cost = simulate(instance, controls).cost
    for subset in ((0,), None):
        found = scip_solve(trip, subset, 0.5, WarmStart((0,), controls))
        assert found.started and found.primal <= cost * (1.0 + 1e-9)
        assert found.dual <= found.primal and found.feasible
    stranger = scip_solve(trip, (0,), 0.1, WarmStart((0,), idle_controls(instance, (0.2,))))
    assert not stranger.started  # it strands the car


def test_infeasible_is_infeasible_for_both() -> None:
    trip = tiny_trip(start_soc=0.07)
    found = scip_solve(trip, None, 20.0)
    assert found.status == "infeasible" and found.primal == found.dual == inf
    assert found.controls is None and found.subset == () and found.cost == inf
    answer = bonmin_best(trip)
    assert not answer.success
    assert answer.run is None or not answer.run.feasible


def test_without_a_stop_nothing_is_paid() -> None:
    trip = tiny_trip(start_soc=0.9)
    found, answer = scip_solve(trip, None, 20.0), bonmin_best(trip)
    assert found.subset == answer.subset == ()
    assert answer.run is not None and answer.run.feasible and found.feasible
    assert found.primal == pytest.approx(0.0, abs=1e-9) and answer.run.cost == 0.0


def test_bonmin_sees_what_no_single_stop_can_do() -> None:
    """Both chargers are weak and may be used for short: only together they suffice."""
    trip = tiny_trip(ambient_c=10.0)
    short = tuple(replace(c, max_dwell_h=0.09, power_kw=50.0) for c in trip.chargers)
    trip = replace(trip, chargers=short)
    ipopt, found = reference_best(trip, "ipopt"), bonmin_best(trip)
    assert found.run is not None and ipopt.best is not None
    assert found.subset == ipopt.best_subset == (0, 1)
    assert found.run.cost == pytest.approx(ipopt.best.cost, rel=AGREE)
    assert found.run.claimed_cost == pytest.approx(found.run.cost, rel=2e-3)


def test_the_limit_of_all_time_at_stops_counts_used_stops_only() -> None:
    """The stop that is best without a limit takes too long; the other one is faster."""
    trip = tiny_trip()
    free = bonmin_best(trip)
    assert free.run is not None and free.subset == (1,)
    dwell = sum(float(s.dwell_h.sum()) for s in free.run.trajectory.stops)
    slow = trip.chargers[1]
    trip = replace(trip, stop_time_h=dwell + slow.detour_in_h + slow.detour_out_h - 0.05)
    ipopt, bonmin = reference_best(trip, "ipopt"), bonmin_best(trip)
    scip = scip_solve(trip, None, 60.0, gap=1e-4, tables=True)
    assert ipopt.best is not None and bonmin.run is not None and bonmin.run.feasible
    assert ipopt.best_subset == bonmin.subset == scip.subset
    assert bonmin.run.cost > free.run.cost
    assert bonmin.run.cost == pytest.approx(ipopt.best.cost, rel=AGREE)
    assert scip.dual <= bonmin.run.cost * (1.0 + BOUND_ROUNDING)
    assert scip.primal == pytest.approx(bonmin.run.cost, rel=AGREE)


def test_bonmin_by_runge_kutta_and_within_its_time() -> None:
    trip = replace(load_trip("paper-400km"), grid=Grid(40.0, 2))
    trip = replace(trip, chargers=trip.chargers[1:])
    implicit, explicit = bonmin_best(trip), bonmin_best(trip, integrator="rk4")
    assert implicit.run is not None and explicit.run is not None
    assert explicit.subset == implicit.subset
    assert explicit.run.cost == pytest.approx(implicit.run.cost, rel=3e-3)
    assert explicit.run.cost != implicit.run.cost
    hasty = bonmin_best(trip, time_limit_s=1e-3)
    assert hasty.solve_s < 0.5 * implicit.solve_s + 0.5
    assert not hasty.success


def test_solvers_print_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    trip = tiny_trip()
    bonmin_best(trip)
    scip_solve(trip, (1,), 0.5)
    printed = capfd.readouterr()
    assert printed.out == "" and printed.err == ""
    with quiet():
        print("lost")
    print("kept")
    assert capfd.readouterr().out == "kept\n"


def test_forms_with_margins_contain_their_tables() -> None:
    instance = make_instance(load_trip("paper-400km"), (1,))
    pack, car = instance.vehicle.pack, instance.vehicle
    t = np.random.default_rng(3).uniform(-30.0, 40.0, 4000)
    e = np.random.default_rng(4).uniform(4.0, instance.energy_max_kwh, 4000)
    for tolerance in (0.0, 5e-3, 5e-2):
        for table, inverse in (
            (pack.resistance_ohm, False),
            (car.heat_pump_cop, False),
            (car.heat_pump_cop, True),
        ):
            band = fit_band(table, -30.0, 40.0, inverse, tolerance)
            value = 1.0 / table(t) if inverse else table(t)
            assert np.all(band.lower * band.form(t) <= value * (1.0 + 1e-12))
            assert np.all(band.upper * band.form(t) >= value * (1.0 - 1e-12))
            assert band.deviation <= (3.0 * tolerance if tolerance else 1e-3)
        cap = fit_cap(pack.charge_limit_kw, 4.0, instance.energy_max_kwh, -30.0, 40.0, tolerance)
        form = cap.level + sum(f(e) * g(t) for f, g in cap.terms)
        assert np.all(cap.factor * form >= pack.charge_limit_kw(e, t) * (1.0 - 1e-12))
        assert cap.deviation < 4.0 * tolerance + 1e-5
    assert len(fit_band(pack.resistance_ohm, -30.0, 40.0).form.kinks) == 0


def test_a_form_of_kinks_is_the_table_and_a_surface_of_full_rank_is_capped() -> None:
    x = np.array([0.0, 1.0, 3.0, 4.0, 7.0])
    f = np.array([2.0, 5.0, 1.0, 1.5, 4.0])
    form = fit_form(x, f, tolerance=0.0)
    points = np.linspace(0.0, 7.0, 57)
    np.testing.assert_allclose(form(points), np.interp(points, x, f), atol=1e-12)
    with pytest.raises(ValueError, match="not positive"):
        fit_band(Table1([0.0, 1.0], [0.0, 1.0]), 0.0, 1.0)
    values = np.random.default_rng(5).uniform(10.0, 20.0, (5, 5))
    cap = fit_cap(Table2(x, x, values), 0.0, 7.0, 0.0, 7.0, 0.0)
    a, b = np.meshgrid(points, points)
    total = cap.level + sum(u(a) * v(b) for u, v in cap.terms)
    np.testing.assert_allclose(cap.factor * total, Table2(x, x, values)(a, b), rtol=1e-5)


def test_a_form_says_what_it_is() -> None:
    assert Form(0.0, 1.0, (1.0, 2.0)).is_affine
    assert not Form(0.0, 1.0, (1.0, 2.0, 0.5)).is_affine
    assert not Form(0.0, 1.0, (1.0, 2.0), 1.0, 1.0).is_affine
    assert Form(0.0, 1.0, (1.0, 2.0), 1.0, 3.0)(1.0) == pytest.approx(3.0 + 3.0 * np.e)
