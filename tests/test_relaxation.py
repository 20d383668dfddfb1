"""The relaxation against simulation: every feasible trajectory, whatever its controls, lies in the
box, satisfies every row at its own cost, and costs no less than the certified bound; on shipped
trips, the small trip and trips made to be nasty. Its cvxpy twin has the same optimum."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from trips import small_trip

from relax.bound import relax_subset
from relax.box import Box
from relax.instance import MIN_CHARGE_KWH, Instance, make_instance
from relax.intervals import Interval
from relax.load import load_trip
from relax.maps import Table1, Table2
from relax.plan import Controls, StopControls, Trajectory
from relax.reach import make_box, propagate
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift, unpack_point
from relax.simulate import simulate
from relax.solve import SolveSettings, SolveStatus, solve_cone
from relax.spec import make_spec
from relax.trip import Trip

ROW_TOLERANCE = 1e-7
"""Largest violation of a scaled row by a lifted trajectory; the simulation is exact to 1e-9."""


def random_controls(rng: np.random.Generator, instance: Instance, charge: float) -> Controls:
    """Controls of any kind: idle, full, alternating; the energy split at random over the stops."""

    def schedule(most: float, size: int, chance: float = 0.7) -> Any:
        if rng.random() > chance:
            return np.zeros(size)
        level = rng.uniform(0.0, most, size) if rng.random() < 0.5 else most * rng.random()
        return np.where(rng.random(size) < rng.choice([0.2, 0.6, 1.0]), level, 0.0)

    car, n, K, S = instance.vehicle, instance.drive.n_steps, instance.cells, len(instance.stops)
    split = rng.dirichlet(np.full(S, 0.7)) * charge if S else []
    stops = tuple(
        StopControls(
            max(float(w), MIN_CHARGE_KWH),
            rng.choice([np.inf, 25.0, 70.0], size=K, p=[0.7, 0.1, 0.2]),
            schedule(car.heater_kw, K),
            schedule(car.cooling_kw, K, 0.2),
            schedule(car.heat_pump_kw, K),
        )
        for w in split
    )
    return Controls(
        schedule(car.heater_kw, n),
        schedule(car.cooling_kw, n, 0.2),
        schedule(car.heat_pump_kw, n),
        stops,
    )


def feasible(instance: Instance, seed: int, tries: int = 90, want: int = 5) -> list[Trajectory]:
    rng = np.random.default_rng(seed)
    found: list[Trajectory] = []
    for _ in range(tries):
        room = instance.energy_max_kwh * 0.9
        trajectory = simulate(instance, random_controls(rng, instance, rng.uniform(1.0, room)))
        if not trajectory.violation.max() > 0.0:
            found.append(trajectory)
            if len(found) == want:
                break
    return found


def nasty_trip(seed: int) -> Trip:
    """Kinked, non-monotone maps; chargers limited by curve, current or grid, at start and end."""
    rng = np.random.default_rng(seed)
    t = np.array([-40.0, -15.0, -5.0, 0.0, 8.0, 20.0, 33.0, 60.0])
    soc = np.array([0.0, 0.15, 0.4, 0.6, 0.85, 1.0])
    charge = 40.0 * np.exp(rng.normal(size=(6, 8)) * 0.6) + 5.0
    car: dict[str, Any] = {
        "vehicle__heat_pump_kw": float(rng.choice([0.0, 1.0, 4.0])),
        "vehicle__heat_pump_droop_per_kw": float(rng.choice([0.0, 0.05, 0.2])),
        "vehicle__heat_pump_cop": Table1(t, rng.uniform(0.7, 4.5, 8)),
        "vehicle__heater_cabin_efficiency": float(rng.choice([0.8, 1.0])),
        "vehicle__cooling_kw": float(rng.choice([0.0, 2.0])),
        "pack__resistance_ohm": Table1(t, rng.uniform(0.03, 0.4, 8)),
        "pack__ocv_v": Table1(soc, 330.0 + np.cumsum(rng.uniform(2.0, 30.0, 6))),
    }
    charge_map = Table2(soc, t, charge)
    ambient = float(rng.uniform(-20.0, 30.0))
    if seed % 3 == 0:  # no cabin to heat and no heater: only its losses warm the pack
        ambient = 22.0
        car |= {"vehicle__heater_kw": 0.0, "pack__heat_capacity_kwh_per_k": 0.04}
    trip = small_trip(ambient_c=ambient, start_soc=0.6, **car)
    if seed % 3 == 1:  # long descents: more recuperation than the battery takes
        power = np.where(np.arange(trip.route.propulsion_kw.size) % 2 == 0, -55.0, 35.0)
        trip = replace(trip, route=replace(trip.route, propulsion_kw=power))
    pack = replace(
        trip.vehicle.pack,
        charge_limit_soc_kw=charge_map,
        discharge_limit_soc_kw=Table2(soc, t, rng.uniform(60.0, 120.0, (6, 8))),
    )
    fast, cheap = trip.chargers
    chargers = (
        replace(fast, position_km=float(rng.choice([0.0, 45.0])), power_kw=22.0, max_dwell_h=6.0),
        replace(cheap, position_km=45.0, current_a=90.0, occupancy_free_h=0.1, max_dwell_h=3.0),
        replace(
            fast, name="C", position_km=float(rng.choice([45.0, 120.0])), power_kw=80.0,
            curve_kw=Table1([0.0, 0.3, 0.8, 1.0], [80.0, 60.0, 75.0, 10.0]),
        ),
    )  # fmt: skip
    return replace(trip, vehicle=replace(trip.vehicle, pack=pack), chargers=chargers)


def instances() -> Iterator[tuple[str, Instance]]:
    for seed in range(12):
        trip = nasty_trip(seed)
        for subset in ((), (0,), (1,), (2,), (0, 1), (0, 1, 2)):
            yield f"nasty {seed} {subset}", make_instance(trip, subset)
    for seed in (1, 4, 7):  # down the hills with a battery that gets full
        for subset in ((), (0,), (1, 2)):
            yield (
                f"full {seed} {subset}",
                make_instance(replace(nasty_trip(seed), soc_max=0.62), subset),
            )
    for ambient in (-20.0, 0.0, 30.0):
        for pump in (0.0, 3.0):
            trip = small_trip(ambient_c=ambient, vehicle__heat_pump_kw=pump)
            for subset in ((0,), (1,), (0, 1)):
                yield f"small {ambient} {pump} {subset}", make_instance(trip, subset)
    for soc in (0.2, 0.24, 0.27, 0.3, 0.33):  # from hopeless to just enough
        for subset in ((), (0,), (1,)):
            yield f"short {soc} {subset}", make_instance(small_trip(start_soc=soc), subset)
    for ambient in (-10.0, 10.0):
        changes = {"route.ambient_c": ambient, "vehicle.heat_pump_kw": 3.0}
        trip = load_trip("paper-400km", changes)
        for subset in ((1,), (0, 2), (1, 2)):
            yield f"paper {ambient} {subset}", make_instance(trip, subset)
    trip = load_trip("goteborg-stockholm-winter")
    for subset in ((2, 5), (1, 4)):
        yield f"winter {subset}", make_instance(trip, subset)


CASES = list(instances())


def test_every_feasible_trajectory_satisfies_box_and_rows_at_its_own_cost() -> None:
    seen = 0
    for seed, (name, instance) in enumerate(CASES):
        box = make_box(instance)
        found = feasible(instance, seed)
        if not found:
            continue
        assert box.empty is None, f"{name}: {box.empty}"
        program = build_relaxation(instance, box)
        for trajectory in found:
            x = lift(instance, program, trajectory)
            names = [
                k for k, i in program.variables.items()
                if np.any((x < program.l - 1e-8)[i[i >= 0]] | (x > program.u + 1e-8)[i[i >= 0]])
            ]  # fmt: skip
            assert names == [], f"{name}: outside the box"
            slack = program.slack(x)
            broken = {k: slack[i].min() for k, i in program.rows.items()
                      if slack[i].min() < -ROW_TOLERANCE}  # fmt: skip
            assert broken == {}, name
            assert program.q @ x + program.constant == pytest.approx(trajectory.cost, rel=1e-9)
            seen += 1
    assert seen > 200


def test_the_certified_bound_is_below_every_feasible_cost() -> None:
    bounds = 0
    for seed, (name, instance) in enumerate(CASES):
        found = feasible(instance, seed + 1000, want=3)
        result = relax_subset(instance)
        if found:
            assert not result.infeasible, name
            assert result.status is SolveStatus.SOLVED, name
            assert result.lower_bound is not None
            assert result.lower_bound <= min(t.cost for t in found), name
            bounds += 1
    assert bounds > 40


def box_around(instance: Instance, trajectory: Trajectory, width: float) -> Box:
    """A small box that contains one trajectory."""
    box, stops = make_box(instance), trajectory.stops

    def near(x: Interval, value: Any, size: float) -> Interval:
        v = np.asarray(value)
        return x.meet(v - width * size, v + width * size)

    box = replace(
        box,
        energy=near(box.energy, trajectory.energy_kwh, 5.0),
        temperature=near(box.temperature, trajectory.temperature_c, 10.0),
        power=near(box.power, trajectory.power_kw, 5.0),
        charge=near(box.charge, [s.energy_kwh[-1] - s.energy_kwh[0] for s in stops], 5.0),
        dwell=near(box.dwell, [s.dwell_h for s in stops], 0.1),
        stop_temperature=near(box.stop_temperature, [s.temperature_c for s in stops], 10.0),
    )
    return propagate(instance, box)


def test_valid_and_nearly_exact_on_small_boxes_around_a_trajectory() -> None:
    for name, instance in CASES[7:70:7]:
        for trajectory in feasible(instance, 5, want=1):
            if not trajectory.stops:
                continue
            values = []
            for width in (1.0, 0.1, 1e-4):
                box = box_around(instance, trajectory, width)
                assert box.empty is None, name
                program = build_relaxation(instance, box)
                slack = program.slack(lift(instance, program, trajectory))
                assert slack.min() > -ROW_TOLERANCE, name
                found = solve_cone(program)
                values.append(found.objective + program.constant)
                assert values[-1] <= trajectory.cost * (1.0 + 1e-6), name
            assert values[0] <= values[1] + 1e-5 * abs(values[1]), name
            assert values[1] <= values[2] + 1e-5 * abs(values[2]), name
            # in a box of a few watts, nothing but this trajectory is left
            assert values[2] == pytest.approx(trajectory.cost, rel=5e-3), name


def test_propagation_never_enlarges_a_box() -> None:
    for _, instance in CASES[::6]:
        box = make_box(instance)
        if box.empty:
            continue
        again = propagate(instance, box)
        for name in ("energy", "temperature", "power", "charge", "leave", "dwell"):
            old, new = getattr(box, name), getattr(again, name)
            assert (new.lo >= old.lo - 1e-6).all() and (new.hi <= old.hi + 1e-6).all()


TWIN = {
    "tol_gap_abs": 1e-7,
    "tol_gap_rel": 1e-7,
    "tol_feas": 1e-7,
    "iterative_refinement_max_iter": 50,
    "iterative_refinement_reltol": 1e-14,
    "iterative_refinement_abstol": 1e-14,
}
"""Tolerances, and what Clarabel needs to reach them on the twin's unscaled rows."""


@pytest.mark.parametrize(
    "index", [k for k, (name, _) in enumerate(CASES) if name.split()[1] in {"1", "4", "-20.0"}][::3]
)
def test_the_twin_in_cvxpy_has_the_same_optimum(index: int) -> None:
    name, instance = CASES[index]
    box = make_box(instance)
    if box.empty:
        pytest.skip(f"{name}: infeasible by its box")
    program = build_relaxation(instance, box)
    found = solve_cone(program, SolveSettings(tolerance=1e-8))
    spec = make_spec(instance, box)
    assert spec.problem.is_dcp() and spec.problem.is_dcp(dpp=True)
    spec.problem.solve(solver=cp.CLARABEL, **TWIN)
    if found.status is SolveStatus.INFEASIBLE:
        assert spec.problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE)
    else:
        assert spec.problem.value == pytest.approx(found.objective + program.constant, rel=1e-5)


def test_prices_of_the_twin_are_parameters() -> None:
    trip = load_trip("paper-400km", {"objective.time_value_per_h": 40.0})
    dearer = load_trip("paper-400km", {"objective.time_value_per_h": 400.0})
    instance, other = make_instance(trip, (1,)), make_instance(dearer, (1,))
    box = make_box(instance)
    spec = make_spec(instance, box)
    spec.time_price.value = np.array([400.0])
    spec.problem.solve(solver=cp.CLARABEL)
    program = build_relaxation(other, box)
    found = solve_cone(program, SolveSettings(tolerance=1e-8))
    expected = found.objective + program.constant - other.fixed_cost + instance.fixed_cost
    assert spec.problem.value == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("subset", [(1,), (0, 2)])
def test_a_lean_program_lacks_cones_where_planes_are_near_and_nothing_else(
    subset: tuple[int, ...],
) -> None:
    instance = make_instance(load_trip("paper-400km"), subset)
    known, steps = make_box(instance), instance.drive.n_steps
    wide = replace(known, power=Interval(known.power.lo - 100.0, known.power.hi + 100.0))
    for box, left in ((known, 0), (wide, 3 * steps)):
        lean, every = (build_relaxation(instance, box, lean=lean) for lean in (True, False))
        assert every.rows["loss cone"].size == 3 * steps
        assert lean.rows.get("loss cone", np.zeros(0)).size == left
        assert {**lean.rows, "loss cone": 0}.keys() == every.rows.keys()
        assert every.b.size - lean.b.size == 3 * steps - left
    settings = SolveSettings(tolerance=1e-7)
    lean, every = (build_relaxation(instance, known, lean=lean) for lean in (True, False))
    low, high = (solve_cone(x, settings).objective + x.constant for x in (lean, every))
    assert (1.0 - 5e-4) * high <= low <= (1.0 + 1e-6) * high


def test_no_charge_is_infeasible_and_one_stop_is_not() -> None:
    trip = load_trip("paper-400km")
    assert relax_subset(make_instance(trip, ())).infeasible
    result = relax_subset(make_instance(trip, (1,)))
    assert not result.infeasible and result.point is not None
    assert result.point.stops[0].temperature_c.shape == (13,)
    assert result.point.energy_kwh.shape == (101,)


def test_infeasible_subsets_are_never_driven() -> None:
    """Where the proof says infeasible, no random control finds a plan; and some are proved."""
    proved = 0
    for seed, (name, instance) in enumerate(CASES):
        if relax_subset(instance).infeasible:
            proved += 1
            assert feasible(instance, seed + 2000, tries=20) == [], name
    assert proved > 5


def test_one_more_charger_and_cheaper_time_keep_the_bounds_in_order() -> None:
    bounds = []
    for value in (0.0, 40.0, 400.0):
        trip = load_trip("paper-400km", {"objective.time_value_per_h": value})
        bounds.append(relax_subset(make_instance(trip, (1,))).lower_bound)
    assert None not in bounds and bounds == sorted(bounds)


def test_lift_and_unpack_agree() -> None:
    name, instance = next(c for c in CASES if c[0].startswith("paper 10.0"))
    trajectory = feasible(instance, 1, want=1)[0]
    program = build_relaxation(instance, make_box(instance))
    point = unpack_point(program, lift(instance, program, trajectory))
    assert point.energy_kwh == pytest.approx(trajectory.energy_kwh), name
    assert point.stops[0].temperature_c == pytest.approx(trajectory.stops[0].temperature_c)
    assert point.stops[0].dwell_h == pytest.approx(trajectory.stops[0].dwell_h)


def test_an_invalid_row_would_be_noticed() -> None:
    """The validity test bites: a loss plane lowered by 1 % is broken by some trajectory."""
    _, instance = next(c for c in CASES if c[0].startswith("paper 10.0"))
    trajectory = feasible(instance, 1, want=1)[0]
    program = build_relaxation(instance, box_around(instance, trajectory, 0.01))
    x = lift(instance, program, trajectory)
    rows = program.rows["loss above"]
    wrong = replace(program, b=program.b.copy())
    wrong.b[rows] -= 0.02 * np.abs(wrong.b[rows])
    assert program.slack(x)[rows].min() > -ROW_TOLERANCE > wrong.slack(x)[rows].min()


def test_rejects_an_empty_box() -> None:
    hopeless = make_instance(small_trip(start_soc=0.06), ())
    with pytest.raises(ValueError, match="empty"):
        build_relaxation(hopeless, make_box(hopeless))
