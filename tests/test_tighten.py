"""A closed subset must not hold a plan below the cutoff: what a proof may never get wrong."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from test_simulate import random_controls
from trips import small_trip

from relax import load_trip, make_instance, simulate
from relax.bound import relax_subset
from relax.completion import complete
from relax.instance import Instance
from relax.intervals import Interval
from relax.program import add_cutoff, make_cone_program
from relax.reach import make_box, propagate
from relax.refinement import Refined, refine
from relax.simulate import Simulation
from relax.solve import SolveStatus, solve_cone
from relax.starts import best_start
from relax.tighten import prove, tighten


def paper(subset: tuple[int, ...], **changes: object) -> Instance:
    return make_instance(load_trip("paper-400km", dict(changes)), subset)


CASES = {
    "paper one stop": paper((1,)),
    "paper two stops": paper((1, 2), **{"objective.time_value_per_h": 400.0}),
    "paper 10 C": paper((2,), **{"route.ambient_c": 10.0}),
    "paper no pump": paper((0, 2), **{"vehicle.heat_pump_kw": 0.0}),
    "small": make_instance(small_trip(), (0, 1)),
    "small hot": make_instance(small_trip(ambient_c=33.0), (1,)),
    "small cold": make_instance(small_trip(ambient_c=-15.0), (0,)),
    "summer": make_instance(load_trip("goteborg-stockholm-summer"), (3,)),
}


@pytest.fixture(scope="module")
def plans() -> dict[str, Refined]:
    found = {}
    for name, instance in CASES.items():
        rough = relax_subset(instance)
        assert rough.lower_bound is not None
        found[name] = refine(instance, best_start(instance, rough.point, rough.lower_bound))
        assert found[name].feasible, name
    return found


@pytest.mark.parametrize("name", CASES)
def test_a_subset_with_a_cheaper_plan_is_never_closed(name: str, plans: dict[str, Refined]) -> None:
    """Cutoffs just above a known plan: tightening must keep that plan, so it cannot close."""
    instance, cost = CASES[name], plans[name].trajectory.cost
    for share in (1e-4, 0.02):
        proof = prove(instance, cost * (1.0 + share), max_boxes=4)
        assert not proof.closed
        assert proof.lower_bound <= cost * (1.0 + 1e-9)


@pytest.mark.parametrize("name", CASES)
def test_what_is_closed_lies_below_every_plan(name: str, plans: dict[str, Refined]) -> None:
    instance, cost = CASES[name], plans[name].trajectory.cost
    proof = prove(instance, 0.93 * cost, max_boxes=12)
    assert proof.lower_bound <= cost
    rough = relax_subset(instance).lower_bound
    assert rough is not None and proof.lower_bound >= min(rough, 0.93 * cost) * (1.0 - 1e-3)
    assert proof.closed == (proof.lower_bound >= 0.93 * cost)


def test_tightening_raises_the_bound_where_the_root_is_loose(plans: dict[str, Refined]) -> None:
    instance, cost = CASES["paper one stop"], plans["paper one stop"].trajectory.cost
    rough = relax_subset(instance).lower_bound
    assert rough is not None and rough < 0.97 * cost
    proof = prove(instance, 0.985 * cost)
    assert proof.closed and proof.lower_bound >= 0.985 * cost


def test_what_is_wide_only_between_stops_is_cut_there(plans: dict[str, Refined]) -> None:
    """Otherwise such a box, which holds a plan below the cutoff, would stay open for ever."""
    instance, plan = CASES["paper one stop"], plans["paper one stop"].trajectory
    stop, box = plan.stops[0], make_box(instance)
    ends = np.zeros(box.stop_temperature.lo.shape, dtype=bool)
    ends[:, [0, -1]] = True
    warm, slow = stop.temperature_c[None], stop.dwell_h[None]
    charged = np.diff(stop.energy_kwh[[0, -1]])
    known = replace(
        box,
        charge=box.charge.meet(charged - 0.1, charged + 0.1),
        dwell=box.dwell.meet(slow - 1e-4, slow + 1e-4),
        stay=box.stay.meet(slow.sum(axis=1) - 1e-3, slow.sum(axis=1) + 1e-3),
        stop_temperature=box.stop_temperature.meet(
            np.where(ends, warm - 0.3, -np.inf), np.where(ends, warm + 0.3, np.inf)
        ),
    )
    done = tighten(instance, known, cutoff=1.02 * plan.cost)
    assert not done.closed and done.how is not None and done.how.target is not None
    interval: Interval = getattr(done.box, done.how.target.name)
    assert interval.width[done.how.target.index] > 1.0
    assert done.how.target.variable in ("temperature", "border")


def test_no_feasible_trajectory_leaves_the_box_backwards_in_time() -> None:
    """Reachability with cooling and with the temperatures at the stops narrowed to a plan's own."""
    rng = np.random.default_rng(5)
    seen = 0
    for name, instance in CASES.items():
        box = make_box(instance)
        for _ in range(6):
            controls = random_controls(instance, rng)
            _, plan = complete(Simulation(instance), controls)
            if plan.violation.max() > 1e-6:
                continue
            seen += 1
            assert (plan.temperature_c >= box.temperature.lo - 1e-6).all(), name
            assert (plan.temperature_c <= box.temperature.hi + 1e-6).all(), name
            narrow = box
            for stop in instance.stops:
                lo, hi = narrow.temperature.lo.copy(), narrow.temperature.hi.copy()
                here = plan.temperature_c[stop.node]
                lo[stop.node], hi[stop.node] = here - 0.01, here + 0.01
                narrow = _replaced(narrow, lo, hi)
            for _ in range(3):
                narrow = propagate(instance, narrow)
            assert narrow.empty is None, name
            assert (plan.temperature_c >= narrow.temperature.lo - 1e-6).all(), name
            assert (plan.temperature_c <= narrow.temperature.hi + 1e-6).all(), name
    assert seen >= 10


def _replaced(box, lo, hi):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    from relax.intervals import Interval

    return replace(box, temperature=Interval(lo, hi))


def test_a_deadline_in_the_past_keeps_the_known_bound() -> None:
    proof = prove(CASES["small"], 1e6, bound=1.5, deadline=time.perf_counter() - 1.0)
    assert not proof.closed and proof.lower_bound == 1.5 and proof.programs == 0


def test_cooling_never_takes_a_step_below_its_temperature() -> None:
    """The rule of the box is the rule of the simulation, for any controls."""
    instance = CASES["small hot"]
    floor = instance.vehicle.cooling_from_c
    rng = np.random.default_rng(11)
    cooled = 0
    for _ in range(20):
        plan = simulate(instance, random_controls(instance, rng))
        on = plan.cooling_kw > 0.0
        cooled += int(on.sum())
        assert np.all(plan.temperature_c[1:][on] >= floor - 0.01)
        for stop in plan.stops:
            on = stop.cooling_kw > 0.0
            assert np.all(stop.temperature_c[1:][on] >= floor - 0.01)
    assert cooled > 20


def test_a_cutoff_row_cuts_exactly_the_dearer_points() -> None:
    program = make_cone_program(
        [1.0, 2.0], [[-1.0, 0.0], [0.0, -1.0]], [-1.0, -1.0], n_nonneg=2, l=[0, 0], u=[9, 9]
    )
    assert solve_cone(add_cutoff(program, 3.1)).status is SolveStatus.SOLVED
    assert solve_cone(add_cutoff(program, 2.9)).status is SolveStatus.INFEASIBLE
    dense = add_cutoff(program, 4.0).A.toarray()
    np.testing.assert_allclose(dense[2], [0.5, 1.0])
