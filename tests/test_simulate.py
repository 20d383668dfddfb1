"""The simulation solves every equation of the transcription, written out here once more.

``residuals`` is an independent writing of (T1) .. (T9) of the maths page in numpy;
``random_controls`` and ``toy_trip`` serve other tests too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from trips import small_trip

from relax import (
    Controls,
    Grid,
    Instance,
    Table1,
    Table2,
    Trajectory,
    Trip,
    idle_controls,
    load_trip,
    make_instance,
    simulate,
)
from relax.errors import InputError
from relax.instance import MIN_CHARGE_KWH
from relax.plan import StopControls
from relax.simulate import Simulation, Thermostat

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-7
"""Largest residual of any equation [kW, kWh, K or h]."""


def toy_trip(limit_kw: float = 50.0, **changes: Any) -> Trip:
    """The small trip without resistance, heat flows or heat pump: all energies known by hand.

    20 C outside and inside, charge limit constant, 0.5 kW auxiliaries, no cabin demand.
    """
    flat = Table2([0.0, 1.0], [-40.0, 60.0], np.full((2, 2), limit_kw), "charge_limit")
    settings: dict[str, Any] = {
        "ambient_c": 20.0,
        "pack__resistance_ohm": Table1.constant(0.0, -40.0, 60.0),
        "pack__charge_limit_soc_kw": flat,
        "vehicle__heat_pump_kw": 0.0,
        "vehicle__heat_loss_kw_per_k": Table1.constant(0.0, 0.0, 130.0),
    }
    trip = small_trip(**(settings | changes))
    still = replace(trip.route, drivetrain_heat_kw=np.zeros(trip.route.speed_kmh.size))
    return replace(trip, route=still)


def downhill_trip(**changes: Any) -> Trip:
    """The small trip with a full battery, and 40 km of recuperation it can hardly take."""
    trip = small_trip(start_soc=0.9, **({"soc_max": 1.0} | changes))
    power = trip.route.propulsion_kw.copy()
    power[1:4] = [-35.0, -50.0, -25.0]
    return replace(trip, route=replace(trip.route, propulsion_kw=power))


def random_controls(instance: Instance, rng: np.random.Generator, excess: float = 1.3) -> Controls:
    """Powers from zero to beyond the actuators' limits; charged energies that get to the end."""
    vehicle, n, cells = instance.vehicle, instance.drive.n_steps, instance.cells

    def powers(most: float, size: int) -> Array:
        some = rng.uniform(0.0, excess * most, size)
        return np.where(rng.random(size) < 0.6 * rng.random(), some, 0.0)

    need = float(instance.drive.base_kw @ instance.drive.duration_h) * rng.uniform(1.1, 1.6)
    need += instance.end_energy_min_kwh - instance.start_energy_kwh
    share = rng.dirichlet(np.ones(max(len(instance.stops), 1)))
    stops = []
    for w in share[: len(instance.stops)]:
        planned = np.where(rng.random(cells) < 0.5, np.inf, rng.uniform(5.0, 80.0, cells))
        stops.append(
            StopControls(
                max(float(w) * max(need, 3.0), MIN_CHARGE_KWH),
                planned,
                powers(vehicle.heater_kw, cells),
                powers(vehicle.cooling_kw, cells),
                powers(vehicle.heat_pump_kw, cells),
            )
        )
    return Controls(
        powers(vehicle.heater_kw, n),
        powers(vehicle.cooling_kw, n),
        powers(vehicle.heat_pump_kw, n),
        tuple(stops),
    )


def read(table: Table1 | Table2, *at: Array) -> Array:
    """Read a table, with points outside it at its nearest point, as simulations of bad plans do."""
    axes = (table.x, table.y) if isinstance(table, Table2) else (table.x,)
    return table(*(np.clip(a, g[0], g[-1]) for a, g in zip(at, axes, strict=True)))


def residuals(instance: Instance, t: Trajectory) -> dict[str, float]:
    """Return the largest violation of every equation and of every clipped limit."""
    v, d, pack = instance.vehicle, instance.drive, instance.vehicle.pack
    out: dict[str, float] = {}

    def equal(name: str, left: Any, right: Any) -> None:
        gap = np.abs(np.asarray(left, float) - np.asarray(right, float))
        out[name] = max(out.get(name, 0.0), float(gap.max(initial=0.0)))

    def at_most(name: str, left: Any, right: Any) -> None:
        gap = np.asarray(left, float) - np.asarray(right, float)
        out[name] = max(out.get(name, 0.0), float(gap.max(initial=0.0)))

    # states between nodes: arrival, stops, start of the next step
    energy, temp = instance.start_energy_kwh, instance.start_temperature_c
    equal("start", [t.energy_kwh[0], t.temperature_c[0]], [energy, temp])
    cost = 0.0
    for k in range(d.n_steps + 1):
        energy, temp = float(t.energy_kwh[k]), float(t.temperature_c[k])
        for stop, s in zip(instance.stops, t.stops, strict=True):
            if stop.node != k:
                continue
            equal("detour in", s.energy_kwh[0], energy - stop.detour_in_kwh)
            equal("no heat on the detour", s.temperature_c[0], temp)
            energy = float(s.energy_kwh[-1]) - stop.detour_out_kwh
            temp = float(s.temperature_c[-1])
            dwell = float(s.dwell_h.sum())
            cost += stop.price_per_kwh * float(s.grid_kwh.sum()) + stop.time_price_per_h * dwell
            cost += stop.occupancy_price_per_h * max(0.0, dwell - stop.occupancy_free_h)
            cost += stop.fixed_cost
        if k < d.n_steps:
            equal("link", [t.energy_start_kwh[k], t.temperature_start_c[k]], [energy, temp])
    equal("end", [t.final_energy_kwh, t.final_temperature_c], [energy, temp])
    equal("cost", t.cost, cost)

    # driving
    hours, e0, t0 = d.duration_h, t.energy_start_kwh, t.temperature_start_c
    e1, t1 = t.energy_kwh[1:], t.temperature_c[1:]
    em, tm = 0.5 * (e0 + e1), 0.5 * (t0 + t1)
    power = (e0 - e1) / hours
    r = read(pack.resistance_ohm, tm) / read(pack.voltage_squared, em)
    loss = r * (power**2 + d.ripple_kw2)
    hp, a = t.heat_pump_kw, v.heat_pump_droop_per_kw
    h = read(v.heat_pump_cop, tm) * hp * (1.0 - a * hp)
    q = d.cabin_heat_kw
    ch = (q - h) / v.heater_cabin_efficiency
    equal("power", t.power_kw, power)
    equal("loss", t.loss_kw, loss)
    equal("pump heat", t.pump_heat_kw, h)
    equal("cabin", t.cabin_heater_kw, ch)
    load = d.base_kw + t.heater_kw + t.cooling_kw + hp + ch + t.brake_kw
    equal("power balance", power, loss + load)
    flow = loss + d.drivetrain_heat_kw + v.heater_battery_efficiency * t.heater_kw
    flow += d.heat_loss_kw_per_k * (d.ambient_c - tm) - v.cooling_cop * t.cooling_kw - (h - hp)
    equal("heat", pack.heat_capacity_kwh_per_k * (t1 - t0) / hours, flow)
    charge = read(pack.charge_limit_kw, em, tm)
    at_most("charge limit", -power, charge)
    at_most("brake", np.concatenate([-t.brake_kw, t.brake_kw + np.minimum(d.base_kw, 0.0)]), 0.0)
    refused = t.brake_kw > 1e-9
    most = np.minimum(charge, np.maximum(instance.ceiling_kwh - e0, 0.0) / hours)
    equal("brake only at the limit or full", -power[refused], most[refused])
    _actuators(at_most, v, t.heater_kw, t.cooling_kw, hp, h, ch, q)

    # charging
    for stop, s in zip(instance.stops, t.stops, strict=True):
        cells = instance.cells
        e = (s.energy_kwh[-1] - s.energy_kwh[0]) / cells
        middle = s.energy_kwh[0] + (np.arange(cells) + 0.5) * e
        tm, y = 0.5 * (s.temperature_c[1:] + s.temperature_c[:-1]), s.dwell_h
        heater, cooling, pump = s.heater_kw * y, s.cooling_kw * y, s.heat_pump_kw * y
        heat = read(v.heat_pump_cop, tm) * pump * (1.0 - a * pump / y)
        lost = read(pack.resistance_ohm, tm) / read(pack.voltage_squared, middle) * e**2 / y
        q0 = stop.cabin_heat_kw
        cabin = (q0 * y - heat) / v.heater_cabin_efficiency
        equal("cell energy", np.diff(s.energy_kwh), e)
        equal("cell power", s.power_kw, e / y)
        equal("cell limit", s.limit_kw, read(pack.charge_limit_kw, middle, tm))
        at_most("cell charge limit", e / y, read(pack.charge_limit_kw, middle, tm))
        equal("cell loss", s.loss_kwh, lost)
        stored = pack.heat_capacity_kwh_per_k * np.diff(s.temperature_c)
        flow = lost + v.heater_battery_efficiency * heater - v.cooling_cop * cooling
        flow += stop.heat_loss_kw_per_k * (stop.ambient_c - tm) * y - (heat - pump)
        equal("cell heat", stored, flow)
        grid = e + lost + stop.base_kw * y + heater + cooling + pump + cabin
        equal("grid", s.grid_kwh, grid)
        at_most("grid limit", grid, read(stop.grid_limit_kw, middle) * y)
        _actuators(at_most, v, s.heater_kw, s.cooling_kw, s.heat_pump_kw, heat / y, cabin / y, q0)
    return out


def _actuators(
    at_most: Any, v: Any, heater: Array, cooling: Array, pump: Array, h: Array, ch: Array, q: Any
) -> None:
    at_most("heater", np.concatenate([-heater, heater + ch - v.heater_kw]), 0.0)
    at_most("cooling", np.concatenate([-cooling, cooling - v.cooling_kw]), 0.0)
    at_most("pump", np.concatenate([-pump, pump - v.heat_pump_kw, -h, h - q]), 0.0)


def cases() -> dict[str, Instance]:
    paper = {
        f"paper {ambient} C, pump {pump} kW": load_trip(
            "paper-400km", {"route.ambient_c": ambient, "vehicle.heat_pump_kw": pump}
        )
        for ambient, pump in ((-10, 1), (0, 3), (10, 0))
    }
    found = {name: make_instance(trip, (0, 2)) for name, trip in paper.items()}
    found["summer"] = make_instance(load_trip("goteborg-stockholm-summer"), (1, 5))
    found["winter"] = make_instance(load_trip("goteborg-stockholm-winter"), (0, 3, 6))
    found["small"] = make_instance(small_trip(), (0, 1))
    found["hot"] = make_instance(small_trip(ambient_c=35.0), (0,))
    found["downhill"] = make_instance(downhill_trip(ambient_c=10.0), (1,))
    full = downhill_trip(ambient_c=10.0, soc_max=0.92)
    found["full downhill"] = make_instance(full, (1,))
    found["cold downhill"] = make_instance(downhill_trip(ambient_c=-15.0), (0, 1))
    found["coarse"] = make_instance(downhill_trip(ambient_c=5.0, grid__step_km=20.0), (0,))
    return found


CASES = cases()


@pytest.mark.parametrize("name", CASES)
def test_every_equation_of_the_transcription_holds(name: str) -> None:
    instance = CASES[name]
    rng = np.random.default_rng(7)
    for _ in range(8):
        controls = random_controls(instance, rng)
        trajectory = simulate(instance, controls)
        found = residuals(instance, trajectory)
        worst = {k: v for k, v in found.items() if v > TOLERANCE}
        assert not worst, worst


def test_the_downhill_cases_do_brake_and_the_hot_one_does_cool() -> None:
    """Guards the cases: without these events the residuals above would say little."""
    rng = np.random.default_rng(3)
    for name in ("downhill", "cold downhill"):
        trajectory = simulate(CASES[name], random_controls(CASES[name], rng))
        assert trajectory.brake_kw.max() > 1.0
    full = CASES["full downhill"]
    filled = simulate(full, idle_controls(full, (1.0,))).energy_kwh.max()
    assert filled == pytest.approx(full.ceiling_kwh, abs=1e-9)
    hot = simulate(CASES["summer"], random_controls(CASES["summer"], rng))
    assert hot.cooling_kw.max() > 0.5


@pytest.mark.parametrize("step_km", [4.0, 10.0, 20.0])
@pytest.mark.parametrize("floor_kw", [5.0, 1.0])
def test_a_steep_charge_limit_is_met_at_the_midpoint(floor_kw: float, step_km: float) -> None:
    """Recuperation against a limit that falls 12 kW per kWh, at a temperature that hardly moves."""
    soc, limit = [0.0, 0.88, 0.98, 1.0], [80.0, 80.0, floor_kw, floor_kw]
    trip = downhill_trip(
        ambient_c=20.0,
        pack__charge_limit_soc_kw=Table2(soc, [-40.0, 60.0], [[x, x] for x in limit]),
        pack__resistance_ohm=Table1.constant(1e-4, -40.0, 60.0),
        grid__step_km=step_km,
    )
    instance = make_instance(trip, (0,))
    trajectory = simulate(instance, idle_controls(instance, (1.0,)))
    assert trajectory.brake_kw.max() > 1.0
    worst = {k: v for k, v in residuals(instance, trajectory).items() if v > TOLERANCE}
    assert not worst, worst


def test_a_constant_temperature_does_not_stop_the_solver() -> None:
    """The first guess of the end temperature is already exact, the power is not."""
    trip = downhill_trip(
        ambient_c=20.0,
        pack__charge_limit_soc_kw=Table2(
            [0.0, 0.92, 0.94, 1.0], [-40.0, 60.0], [[x, x] for x in (80.0, 80.0, 5.0, 5.0)]
        ),
        pack__resistance_ohm=Table1.constant(1e-4, -40.0, 60.0),
        vehicle__heat_loss_kw_per_k=Table1.constant(0.0, 0.0, 130.0),
        grid__step_km=40.0,
    )
    instance = make_instance(trip, (0,))
    trajectory = simulate(instance, idle_controls(instance, (1.0,)))
    worst = {k: v for k, v in residuals(instance, trajectory).items() if v > TOLERANCE}
    assert not worst, worst


def test_a_weak_charger_in_the_cold_never_gives_more_than_it_can() -> None:
    """4 kW charger, 5 kW cabin demand: either the limit holds or the plan is not feasible."""
    trip = small_trip(ambient_c=-25.0)
    weak = replace(trip.chargers[0], power_kw=4.0, max_dwell_h=99.0)
    instance = make_instance(replace(trip, chargers=(weak, trip.chargers[1])), (0,))
    trajectory = simulate(instance, idle_controls(instance, (20.0,)))
    found = residuals(instance, trajectory)
    assert trajectory.violation[0] == 0.0  # the energy would do
    drawn = max(float((s.grid_kwh / s.dwell_h).max()) for s in trajectory.stops)
    assert trajectory.violation[2] == pytest.approx(max(drawn - 4.0, 0.0), abs=1e-6)
    assert found["grid limit"] <= TOLERANCE or drawn > 4.0


def test_zero_resistance_and_no_heat_by_hand() -> None:
    trip = toy_trip()
    instance = make_instance(trip, (0, 1))
    t = simulate(instance, idle_controls(instance, (6.0, 4.0)))
    route, pack = trip.route, trip.vehicle.pack
    used = float((route.duration_h * (route.propulsion_kw + 0.5)).sum())
    start = float(pack.energy_kwh(0.5))
    assert t.final_energy_kwh == pytest.approx(start - used + 10.0 - 0.4 - 0.5, abs=1e-9)
    np.testing.assert_allclose(t.temperature_c, 20.0, atol=1e-9)
    dwell = [6.0 / 50.0, 4.0 / 49.5]  # the second charger gives 50 kW, 0.5 of them to the car
    for s, hours, w in zip(t.stops, dwell, (6.0, 4.0), strict=True):
        assert float(s.dwell_h.sum()) == pytest.approx(hours, rel=1e-10)
        assert float(s.grid_kwh.sum()) == pytest.approx(w + 0.5 * hours, rel=1e-10)
    cost = 0.6 * (6.0 + 0.06) + 10.0 * dwell[0] + 10.0 * 4.0 / 60.0
    cost += 0.4 * 50.0 * dwell[1] + 10.0 * dwell[1] + 10.0 * 8.0 / 60.0 + 0.5
    assert t.cost == pytest.approx(cost, rel=1e-10)


def test_battery_heating_without_other_heat_by_hand() -> None:
    """1 kW at 0.9 for the whole trip: the pack warms by 0.9 kW * time / C."""
    trip = toy_trip()
    instance = make_instance(trip, ())
    n = instance.drive.n_steps
    t = simulate(instance, Controls(np.ones(n), np.zeros(n), np.zeros(n), ()))
    rise = 0.9 * trip.route.driving_h / 0.09
    assert t.final_temperature_c == pytest.approx(20.0 + rise, abs=1e-7)
    base = simulate(instance, idle_controls(instance, ()))
    spent = base.final_energy_kwh - t.final_energy_kwh
    assert spent == pytest.approx(trip.route.driving_h, abs=1e-8)


@pytest.mark.parametrize("name", ["small", "hot", "downhill"])
def test_the_battery_heater_never_heats_beyond_the_limit(name: str) -> None:
    """Full heating all the way: it reaches the limit and stays there."""
    instance = CASES[name]
    idle = idle_controls(instance, (6.0,) * len(instance.stops))
    full = np.full(instance.cells, instance.vehicle.heater_kw)
    controls = replace(
        idle,
        heater_kw=np.full(instance.drive.n_steps, instance.vehicle.heater_kw),
        stops=tuple(replace(s, heater_kw=full) for s in idle.stops),
    )
    t = simulate(instance, controls)
    top = instance.temperature_max_c
    heated = t.temperature_c[1:][t.heater_kw > 0.0]
    assert heated.max() > top - 0.1
    assert heated.max() <= top + 2e-5
    for s in t.stops:
        assert np.all(s.temperature_c[1:][s.heater_kw > 0.0] <= top + 2e-5)
    worst = {k: v for k, v in residuals(instance, t).items() if v > TOLERANCE}
    assert not worst, worst


def test_occupancy_is_paid_beyond_the_free_time_only() -> None:
    trip = toy_trip(limit_kw=10.0)
    instance = make_instance(trip, (1,))
    cost = [simulate(instance, idle_controls(instance, (w,))).cost for w in (2.0, 5.0, 8.0)]
    per_kwh = 0.4 * 1.05 + 1.0
    assert cost[1] - cost[0] == pytest.approx(3.0 * per_kwh, rel=1e-9)
    assert cost[2] - cost[1] == pytest.approx(3.0 * per_kwh + 6.0 * 0.3, rel=1e-9)


def test_controls_beyond_the_limits_are_clipped() -> None:
    instance = make_instance(small_trip(), (0,))
    n, k = instance.drive.n_steps, instance.cells
    many, none = np.full(k, 99.0), np.zeros(k)
    stop = StopControls(8.0, many * 9.0, many, none, many)
    t = simulate(instance, Controls(np.full(n, 99.0), np.zeros(n), np.full(n, 99.0), (stop,)))
    v, s = instance.vehicle, t.stops[0]
    cool = t.temperature_c[1:] < 39.0  # elsewhere the heater stops at the limit of 40 C
    np.testing.assert_allclose((t.heater_kw + t.cabin_heater_kw)[cool], v.heater_kw, atol=1e-12)
    assert cool.sum() > 5
    assert np.all(t.heat_pump_kw <= v.heat_pump_kw)
    assert np.all(t.pump_heat_kw <= instance.drive.cabin_heat_kw + 1e-12)
    assert np.all(s.power_kw <= s.limit_kw * (1.0 + 1e-12))
    demand_met = t.cabin_heater_kw * v.heater_cabin_efficiency + t.pump_heat_kw
    np.testing.assert_allclose(demand_met, instance.drive.cabin_heat_kw, atol=1e-12)


def test_cooling_is_clipped_and_stops_at_its_own_temperature() -> None:
    hot = CASES["hot"]
    n, k = hot.drive.n_steps, hot.cells
    many, none = np.full(k, 99.0), np.zeros(k)
    stop = StopControls(8.0, many * 9.0, none, many, none)
    controls = Controls(np.zeros(n), np.full(n, 99.0), np.zeros(n), (stop,))
    t = simulate(hot, controls)
    warm = t.temperature_c[1:] > 26.0
    np.testing.assert_allclose(t.cooling_kw[warm], hot.vehicle.cooling_kw)
    assert warm.sum() > 5
    assert t.cooling_kw.max() == hot.vehicle.cooling_kw == t.stops[0].cooling_kw.max()
    cold = make_instance(small_trip(ambient_c=22.0), (0,))
    t = simulate(cold, controls)
    used = t.cooling_kw > 0.0
    assert np.all(t.temperature_c[1:][used] >= cold.vehicle.cooling_from_c - 0.1)
    used = t.stops[0].cooling_kw > 0.0
    assert np.all(t.stops[0].temperature_c[1:][used] >= cold.vehicle.cooling_from_c - 0.1)
    assert used.any()


def test_the_heat_pump_stops_at_the_cabins_demand() -> None:
    instance = make_instance(small_trip(ambient_c=15.0, vehicle__heat_pump_kw=3.0), ())
    n = instance.drive.n_steps
    t = simulate(instance, Controls(np.zeros(n), np.zeros(n), np.full(n, 3.0), ()))
    np.testing.assert_allclose(t.pump_heat_kw, instance.drive.cabin_heat_kw, rtol=1e-12)
    assert t.heat_pump_kw.max() < 1.0
    np.testing.assert_allclose(t.cabin_heater_kw, 0.0, atol=1e-12)


def test_a_weak_charger_is_shared_and_never_exceeded() -> None:
    trip = small_trip()
    weak = replace(trip.chargers[0], power_kw=20.0)
    instance = make_instance(replace(trip, chargers=(weak,)), (0,))
    many = np.full(instance.cells, 99.0)
    none = np.zeros(instance.cells)
    idle = idle_controls(instance, (5.0,))
    for heater in (none, many):
        stop = StopControls(5.0, np.full(instance.cells, np.inf), heater, none, none)
        s = simulate(instance, replace(idle, stops=(stop,))).stops[0]
        np.testing.assert_allclose(s.grid_kwh / s.dwell_h, 20.0, rtol=1e-10)
        assert s.power_kw.min() > 0.0


@pytest.mark.parametrize("keep", [0, 1, 2])
def test_keeping_a_prefix_changes_nothing(keep: int) -> None:
    instance = CASES["winter"]
    rng = np.random.default_rng(11)
    first, second = random_controls(instance, rng), random_controls(instance, rng)
    # the controls before stop `keep` are those of the run before
    node = instance.stops[keep].node
    head = {
        name: np.concatenate([getattr(first, name)[:node], getattr(second, name)[node:]])
        for name in ("heater_kw", "cooling_kw", "heat_pump_kw")
    }
    changed = Controls(**head, stops=first.stops[:keep] + second.stops[keep:])
    simulation = Simulation(instance)
    simulation.run(first)
    for _ in range(2):  # and again: the kept prefix must survive its use
        _assert_equal(simulation.run(changed, keep=keep), simulate(instance, changed))
    _assert_equal(simulation.run(first), simulate(instance, first))


def test_the_same_controls_are_not_simulated_twice_in_a_row() -> None:
    instance = CASES["winter"]
    rng = np.random.default_rng(5)
    first, second = random_controls(instance, rng), random_controls(instance, rng)
    simulation = Simulation(instance)
    once = simulation.run(first)
    assert simulation.run(first) is once
    simulation.run(second)
    _assert_equal(simulation.run(first), once)
    cold = Thermostat([-40.0] * instance.drive.n_steps, [[-40.0] * instance.cells] * 3)
    unheated = simulation.run(first, thermostat=cold)  # other heaters, though the same controls
    assert unheated.heater_kw.max() < once.heater_kw.max()
    _assert_equal(simulation.run(first), once)


def _assert_equal(a: Trajectory, b: Trajectory) -> None:
    for name in a.__dataclass_fields__:
        if name != "stops":
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for s, r in zip(a.stops, b.stops, strict=True):
        for name in s.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(s, name), getattr(r, name), err_msg=name)


def test_stops_at_start_destination_and_one_position() -> None:
    trip = small_trip()
    first = replace(trip.chargers[0], max_dwell_h=9.0)
    spots = (0.0, 60.0, 60.0, 120.0)
    chargers = tuple(replace(first, name=f"c{i}", position_km=km) for i, km in enumerate(spots))
    trip = replace(trip, chargers=chargers)
    instance = make_instance(trip, (0, 1, 2, 3), Grid(6.0, 4))
    rng = np.random.default_rng(5)
    trajectory = simulate(instance, random_controls(instance, rng))
    assert max(residuals(instance, trajectory).values()) < TOLERANCE
    assert trajectory.stops[0].energy_kwh[0] == instance.start_energy_kwh - 0.2
    gap = trajectory.stops[2].energy_kwh[0] - trajectory.stops[1].energy_kwh[-1]
    assert gap == pytest.approx(-0.4)
    last = float(trajectory.stops[3].energy_kwh[-1])
    assert trajectory.final_energy_kwh == pytest.approx(last - 0.2)


def test_halving_the_steps_hardly_moves_the_trajectory() -> None:
    """Midpoint rule, second order: the coarse grid is near and the fine one four times nearer.

    Within the 4 km over which the route's samples are constant.
    """
    trip = load_trip("paper-400km")
    finals = []
    for step in (4.0, 2.0, 1.0):
        instance = make_instance(trip, (), Grid(step, 4))
        n = instance.drive.n_steps
        finals.append(simulate(instance, Controls(*[np.zeros(n)] * 3, ())).final_temperature_c)
    assert abs(finals[2] - finals[1]) < 0.3 * abs(finals[1] - finals[0]) < 0.001


def test_controls_of_other_cells_are_refused() -> None:
    trip = small_trip()
    fine = make_instance(trip, (0,), replace(trip.grid, cells=8))
    coarse = make_instance(trip, (0,), replace(trip.grid, cells=4))
    with pytest.raises(InputError, match="'8 values'; allowed: one for each of 4 cells"):
        simulate(coarse, idle_controls(fine, (20.0,)))
