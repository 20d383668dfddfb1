"""Tightness: nought at a simulated trajectory, measured at a relaxed optimum; and the theorem on
the loss relaxed from below alone, both sides of it: lossless where a kWh of electricity is worth
more than a kWh of pack heat, and a heater of efficiency 1 where it is not."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from trips import small_trip

from relax.instance import Instance, make_instance
from relax.load import load_trip
from relax.maps import Table1
from relax.plan import Controls, StopControls
from relax.program import ConeProgram
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.simulate import idle_controls, simulate
from relax.solve import SolveSettings, SolveStatus, solve_cone
from relax.tightness import LossWorth, TermTightness, measure_loss_worth, measure_tightness

Array = npt.NDArray[np.float64]

DRIVING = (
    "Joule loss, driving", "heat-pump heat, driving", "discharge limit, driving",
    "charge limit, driving", "needless braking, driving", "undue cooling, driving",
)  # fmt: skip
STOPS = (
    "Joule loss, stops", "heat-pump heat, stops", "heat from ambient, stops",
    "charge limit, stops", "grid limit, stops", "undue cooling, stops",
)  # fmt: skip
LOSSES = ("Joule loss, driving", "Joule loss, stops")
FROM_ABOVE = ("loss above", "stop loss low", "stop loss high")
"""Rows that bound Joule losses from above."""
FIXED_R: dict[str, Any] = {
    "pack__resistance_ohm": Table1([-40.0, 60.0], [0.15, 0.15]),
    "pack__ocv_v": Table1([0.0, 1.0], [370.0, 370.0]),
    "vehicle__heat_pump_kw": 0.0,
}
"""R independent of T, U independent of E, no heat pump: then loss >= r P^2 is exactly convex."""


def without_rows(program: ConeProgram, *names: str) -> ConeProgram:
    """Return the program without some named rows; only inequalities may go."""
    gone = np.concatenate([program.rows[name] for name in names])
    first = program.n_zero
    assert ((gone >= first) & (gone < first + program.n_nonneg)).all()
    keep = np.ones(program.b.size, dtype=bool)
    keep[gone] = False
    row = np.cumsum(keep) - 1
    return replace(
        program,
        A=program.A.tocsr()[keep].tocsc(),
        b=program.b[keep],
        n_nonneg=program.n_nonneg - gone.size,
        row_scale=program.row_scale[keep],
        rows=MappingProxyType({k: row[v] for k, v in program.rows.items() if k not in names}),
    )


class Optimum(NamedTuple):
    value: float
    losses: dict[str, TermTightness]
    worth: LossWorth
    excess_kw: Array  # driving: relaxed loss beyond the exact one
    heater_kwh: float


def optimum(instance: Instance, one_sided: bool) -> Optimum:
    program = build_relaxation(instance, make_box(instance))
    if one_sided:
        program = without_rows(program, *FROM_ABOVE)
    # 1e-8 is where the solver's arithmetic ends: rounding decides whether it is reached
    solution = solve_cone(program, SolveSettings(tolerance=3e-8))
    assert solution.status is SolveStatus.SOLVED
    x = solution.x
    terms = measure_tightness(instance, program, x)
    pack = instance.vehicle.pack
    r = float(pack.resistance_ohm.f[0] / pack.voltage_squared.f[0])
    exact = r * (program.value("power", x) ** 2 + instance.drive.ripple_kw2)
    heater = float(instance.drive.duration_h @ program.value("heater", x))
    return Optimum(
        value=solution.objective + program.constant,
        losses={t.term: t for t in terms if t.term in LOSSES},
        worth=measure_loss_worth(instance, program, solution.z),
        excess_kw=program.value("loss", x) - exact,
        heater_kwh=heater + float(program.value("cell_heater", x).sum()),
    )


def warm_instance() -> Instance:
    """Warm enough for full charging speed, nothing to heat: pack heat is worthless."""
    return make_instance(small_trip(ambient_c=27.0, start_soc=0.4, **FIXED_R), (0,))


def cold_instance(ambient_c: float = -15.0) -> Instance:
    """Cold, and time is dear: heat before and at the stop is worth more than electricity."""
    trip = small_trip(ambient_c=ambient_c, start_soc=0.35, time_value_per_h=100.0, **FIXED_R)
    return make_instance(trip, (0,))


def test_one_sided_is_lossless_where_heat_is_worthless() -> None:
    found = optimum(warm_instance(), one_sided=True)
    for term in LOSSES:
        assert found.losses[term].largest_kw < 1e-5
        assert found.losses[term].above_kwh < 1e-5
    worth = found.worth
    assert (worth.drive_electricity > worth.drive_heat + 0.1).all()
    assert (worth.stop_electricity > worth.stop_heat + 0.1).all()
    assert worth.drive_heat.max() < 1e-6 and worth.stop_heat.max() < 1e-6
    # and then nothing is gained by the side from above
    assert optimum(warm_instance(), one_sided=False).value == pytest.approx(found.value, rel=1e-6)


def test_one_sided_is_a_heater_of_efficiency_one_where_heat_is_dear() -> None:
    one, two = (optimum(cold_instance(), one_sided) for one_sided in (True, False))
    fake = {
        name: sum(t.above_kwh for t in o.losses.values())
        for name, o in (("one", one), ("two", two))
    }
    assert fake["one"] > 1.5  # measured 2.13 kWh, in a battery of 59 kWh
    assert fake["two"] < 0.15  # measured 0.09 kWh
    # the real heater, 0.9 and 6 kW, is not touched while there is a fake one
    assert one.heater_kwh < 1e-5
    assert two.heater_kwh > 0.3
    assert two.value > 1.05 * one.value  # measured: 9 % of the bound


@pytest.mark.parametrize("ambient_c", [-15.0, -10.0, -5.0, 0.0])
def test_multipliers_say_where_the_one_sided_loss_is_tight(ambient_c: float) -> None:
    """Complementary slackness: electricity - heat >= 0, and tight wherever it is > 0."""
    found = optimum(cold_instance(ambient_c), one_sided=True)
    margin = found.worth.drive_electricity - found.worth.drive_heat
    price = found.worth.drive_electricity.max()
    assert (margin > -1e-4 * price).all()
    assert (found.excess_kw > -1e-6).all()
    assert (margin * found.excess_kw < 1e-3).all()
    at_stop = found.worth.stop_electricity - found.worth.stop_heat
    assert (at_stop > -1e-4 * price).all()
    loose = margin < 1e-3
    assert found.excess_kw[~loose].max(initial=0.0) < 1e-3
    assert bool(loose.any()) == (found.losses["Joule loss, driving"].above_kwh > 1e-3)


def test_two_sided_multipliers_show_where_the_side_from_above_binds() -> None:
    """Where heat is worth more than electricity, the loss sits on its planes from above."""
    instance = make_instance(load_trip("paper-400km"), (1,))
    program = build_relaxation(instance, make_box(instance))
    solution = solve_cone(program, SolveSettings(tolerance=1e-8))
    worth = measure_loss_worth(instance, program, solution.z)
    heat_dearer = worth.drive_heat > worth.drive_electricity + 0.05
    assert heat_dearer.any() and not heat_dearer.all()
    slack = program.slack(solution.x)[program.rows["loss above"]].reshape(2, -1).min(axis=0)
    assert slack[heat_dearer].max() < 1e-5
    below = worth.drive_heat < worth.drive_electricity - 0.05
    assert slack[below].max() > 1e-4
    # before the stop heat gains speed, after it none is left to gain
    node = instance.stops[0].node
    assert worth.drive_heat[node - 1] > worth.drive_heat[node + 1]


def heating(instance: Instance, charge: float) -> Controls:
    """Heat, cool and pump at the same time, in driving and at the stops."""
    car, n, K = instance.vehicle, instance.drive.n_steps, instance.cells
    half = np.where(np.arange(n) % 2 == 0, 1.0, 0.3)
    stops = tuple(
        StopControls(
            charge / len(instance.stops), np.full(K, np.inf), np.full(K, 0.5 * car.heater_kw),
            np.full(K, car.cooling_kw), np.full(K, 0.4 * car.heat_pump_kw),
        )
        for _ in instance.stops
    )  # fmt: skip
    return Controls(
        half * car.heater_kw, half * car.cooling_kw, half * car.heat_pump_kw, stops
    )  # fmt: skip


@pytest.mark.parametrize("subset", [(0,), (1,), (0, 1)])
@pytest.mark.parametrize("ambient_c", [-15.0, 5.0, 30.0])
@pytest.mark.parametrize("heated", [False, True])
def test_every_term_vanishes_at_a_simulated_trajectory(
    subset: tuple[int, ...], ambient_c: float, heated: bool
) -> None:
    instance = make_instance(small_trip(ambient_c=ambient_c, vehicle__heat_pump_kw=2.0), subset)
    charge = 12.0
    idle = idle_controls(instance, (charge / len(subset),) * len(subset))
    trajectory = simulate(instance, heating(instance, charge) if heated else idle)
    program = build_relaxation(instance, make_box(instance))
    terms = measure_tightness(instance, program, lift(instance, program, trajectory))
    assert tuple(t.term for t in terms) == DRIVING + STOPS
    for t in terms:
        assert t.largest_kwh < 1e-9 and t.largest_kw < 1e-6, t
        assert t.above_kwh < 1e-8 and t.below_kwh < 1e-8, t


@pytest.mark.parametrize("soc_max", [1.0, 0.9])
def test_braking_and_limits_vanish_at_a_trajectory_with_long_descents(soc_max: float) -> None:
    """Recuperation is too fast for the cold battery, or the battery is full."""
    trip = small_trip(start_soc=0.9, ambient_c=-15.0 if soc_max == 1.0 else 10.0, soc_max=soc_max)
    power = np.where(np.arange(trip.route.propulsion_kw.size) % 2 == 0, -55.0, 35.0)
    trip = replace(trip, route=replace(trip.route, propulsion_kw=power))
    instance = make_instance(trip, ())
    trajectory = simulate(instance, idle_controls(instance, ()))
    assert trajectory.brake_kw.max() > 1.0
    program = build_relaxation(instance, make_box(instance))
    terms = measure_tightness(instance, program, lift(instance, program, trajectory))
    assert tuple(t.term for t in terms) == DRIVING
    assert max(t.largest_kw for t in terms) < 1e-6
    if soc_max < 1.0:
        assert trajectory.energy_kwh.max() == pytest.approx(instance.ceiling_kwh, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "where", "by", "term", "kwh"),
    [
        ("loss", 7, 2.0, "Joule loss, driving", None),
        ("pump_heat", 3, -0.2, "heat-pump heat, driving", None),
        ("cell_loss", (0, 4), 0.3, "Joule loss, stops", 0.3),
        ("cell_pump_heat", (0, 2), -0.05, "heat-pump heat, stops", -0.05),
        ("temp_dwell", (0, 5), 2.0, "heat from ambient, stops", -2.0 * 0.010),
    ],
)
def test_a_wrong_value_is_measured_in_its_term_alone(
    name: str, where: Any, by: float, term: str, kwh: float | None
) -> None:
    """One auxiliary value moved by a known amount: that term reports it, with sign and place."""
    instance = make_instance(small_trip(ambient_c=-5.0, vehicle__heat_pump_kw=2.0), (0,))
    trajectory = simulate(instance, idle_controls(instance, (12.0,)))
    program = build_relaxation(instance, make_box(instance))
    x = lift(instance, program, trajectory)
    column = program.variables[name][where]
    x[column] += by / program.scale[column]
    found = {t.term: t for t in measure_tightness(instance, program, x)}
    expected = by * instance.drive.duration_h[where] if kwh is None else kwh
    assert found[term].net_kwh == pytest.approx(expected, rel=1e-6)
    assert found[term].largest_kwh == pytest.approx(abs(expected), rel=1e-6)
    node = where if kwh is None else instance.stops[0].node
    assert found[term].where_km == instance.drive.node_km[node]
    # losses and heat also enter the energy from the grid, whose limit may then be exceeded
    others = [t for k, t in found.items() if k not in (term, "grid limit, stops")]
    assert max(t.largest_kwh for t in others) < 1e-9


def test_sums_keep_too_much_and_too_little_apart() -> None:
    instance = make_instance(small_trip(), (0,))
    trajectory = simulate(instance, idle_controls(instance, (12.0,)))
    program = build_relaxation(instance, make_box(instance))
    x = lift(instance, program, trajectory)
    columns = program.variables["cell_loss"][0, :4]
    x[columns] += np.array([0.1, 0.2, -0.04, -0.05]) / program.scale[columns]
    found = {t.term: t for t in measure_tightness(instance, program, x)}["Joule loss, stops"]
    assert found.above_kwh == pytest.approx(0.3) and found.below_kwh == pytest.approx(0.09)
    assert found.net_kwh == pytest.approx(0.21)
    assert found.largest_kw == pytest.approx(
        max(0.1 / trajectory.stops[0].dwell_h[0], 0.2 / trajectory.stops[0].dwell_h[1])
    )


def test_faster_than_the_battery_allows_is_measured_as_energy() -> None:
    instance = make_instance(small_trip(), (0,))
    trajectory = simulate(instance, idle_controls(instance, (12.0,)))
    program = build_relaxation(instance, make_box(instance))
    x = lift(instance, program, trajectory)
    column = program.variables["dwell"][0, 3]
    x[column] *= 0.9
    found = {t.term: t for t in measure_tightness(instance, program, x)}["charge limit, stops"]
    assert found.above_kwh == pytest.approx(0.1 * 12.0 / instance.cells, rel=1e-6)
    assert found.where_km == instance.drive.node_km[instance.stops[0].node]


@pytest.mark.parametrize("subset", [(), (1,), (0, 2)])
def test_terms_are_consistent_at_a_relaxed_optimum(subset: tuple[int, ...]) -> None:
    trip = load_trip("paper-400km", {"start.soc": 0.95, "route.ambient_c": -10.0})
    if not subset:
        trip = small_trip(start_soc=0.9)
    instance = make_instance(trip, subset)
    program = build_relaxation(instance, make_box(instance))
    terms = measure_tightness(instance, program, solve_cone(program).x)
    assert tuple(t.term for t in terms) == DRIVING + (STOPS if subset else ())
    for t in terms:
        assert t.largest_kwh <= t.above_kwh + t.below_kwh + 1e-12
        assert t.label.startswith("(R") and np.isfinite(t.largest_kw)
        assert 0.0 <= t.where_km <= instance.drive.node_km[-1]
        if "limit" in t.term or "un" in t.term.split()[0]:
            assert t.below_kwh == 0.0
    if subset:
        assert max(t.largest_kwh for t in terms) > 1e-3  # the relaxation is not exact, and says so
