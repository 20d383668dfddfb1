"""How cold a battery can get: never warmer than said, and nearly as cold as it was driven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trips import small_trip

from relax import idle_controls, load_trip, make_instance, simulate
from relax.instance import Instance
from relax.intervals import Interval, range1
from relax.maps import Table1
from relax.plan import Controls
from relax.reach import make_box, propagate
from relax.reach_heat import STEEPEST, _Colder, _fallen, _steepest
from relax.trip import Trip


def coldest(instance: Instance, energy_kwh: float = 10.0) -> Controls:
    """Heat pump and cooling at full power, the heater off."""
    vehicle = instance.vehicle
    controls = idle_controls(instance, (energy_kwh,) * len(instance.stops))
    full = np.full(instance.cells, vehicle.heat_pump_kw)
    cool = np.full(instance.cells, vehicle.cooling_kw)
    return replace(
        controls,
        heat_pump_kw=np.full(instance.drive.n_steps, vehicle.heat_pump_kw),
        cooling_kw=np.full(instance.drive.n_steps, vehicle.cooling_kw),
        stops=tuple(
            replace(s, heat_pump_kw=full, cooling_kw=cool, power_kw=np.full(instance.cells, 15.0))
            for s in controls.stops
        ),
    )


@pytest.mark.parametrize("pump_kw", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("ambient_c", [-10.0, 0.0, 20.0])
def test_the_lower_end_is_near_the_coldest_drive(pump_kw: float, ambient_c: float) -> None:
    changes = {"route.ambient_c": ambient_c, "vehicle.heat_pump_kw": pump_kw}
    instance = make_instance(load_trip("paper-400km", overrides=changes), (1, 2))
    box, driven = make_box(instance), simulate(instance, coldest(instance))
    first = instance.stops[0].node + 1
    above = driven.temperature_c[:first] - box.temperature.lo[:first]
    assert above.min() >= -1e-6
    assert above.max() < 3.0  # with the heat drawn from a warm battery it was up to 19 K


@pytest.mark.parametrize("step_km", [2.0, 15.0, 60.0])
@pytest.mark.parametrize("capacity", [0.02, 0.09])
def test_no_drive_is_colder_than_the_box(step_km: float, capacity: float) -> None:
    """Also where steps are so long that a step's end moves fast with its midpoint."""
    steep = Table1([-40.0, -20.0, 0.0, 10.0, 20.0, 60.0], [0.9, 1.1, 2.4, 4.0, 6.5, 6.0])
    rng = np.random.default_rng(7)
    for start in (-20.0, 0.0, 25.0, 38.0):
        held = 0
        trip = small_trip(
            start_temperature_c=start, grid__step_km=step_km,
            pack__heat_capacity_kwh_per_k=capacity, vehicle__heat_pump_cop=steep,
            vehicle__heat_pump_kw=3.0,
        )  # fmt: skip
        instance = make_instance(trip, (0, 1))
        box = make_box(instance)
        for scale in (0.0, 0.3, 1.0):
            controls = coldest(instance)
            heater = scale * rng.uniform(0.0, 6.0, instance.drive.n_steps)
            cooling = rng.choice([0.0, 2.0], instance.drive.n_steps)
            driven = simulate(instance, replace(controls, heater_kw=heater, cooling_kw=cooling))
            stops = np.stack([s.temperature_c for s in driven.stops])
            if not driven.violation.any():
                held += 1
                assert np.all(driven.temperature_c >= box.temperature.lo - 1e-6)
                assert np.all(stops >= box.stop_temperature.lo - 1e-6)
        assert held >= 1


def _cell(start: float, dwell_h: float, trip: Trip, instance: Instance) -> float:
    """End of a cell that only loses heat: implicit midpoint, by bisection."""
    vehicle, stop = trip.vehicle, instance.stops[0]
    per_cop = vehicle.heat_pump_kw * (1.0 - vehicle.heat_pump_droop_per_kw * vehicle.heat_pump_kw)

    def flow(at: float) -> float:
        cop = float(np.interp(at, vehicle.heat_pump_cop.x, vehicle.heat_pump_cop.f))
        drawn = max(min(stop.cabin_heat_kw, cop * per_cop) * (1.0 - 1.0 / cop), 0.0)
        return stop.heat_loss_kw_per_k * (stop.ambient_c - at) - drawn

    lo, hi = start - 500.0, start + 50.0
    for _ in range(80):
        end = 0.5 * (lo + hi)
        moved = start + dwell_h * flow(0.5 * (start + end)) / vehicle.pack.heat_capacity_kwh_per_k
        lo, hi = (end, hi) if moved > end else (lo, end)
    return end


@pytest.mark.parametrize("cop", [(1.4, 1.8, 2.4, 4.0), (3.0, 1.2, 6.0, 2.0)])
def test_a_stop_falls_no_further_than_said(cop: tuple[float, ...]) -> None:
    """However its time is spread over the cells, also over one whose midpoint lies far above."""
    rng = np.random.default_rng(3)
    table = Table1([-200.0, -10.0, 5.0, 60.0], cop)
    trip = small_trip(vehicle__heat_pump_cop=table, vehicle__heat_pump_kw=3.0)
    instance = make_instance(trip, (0,))
    nearest = np.inf
    for _ in range(400):
        low, stay = rng.uniform(-20.0, 20.0), rng.choice([0.05, 0.3, 1.0, 3.0])
        top = low + rng.choice([0.0, 5.0, 40.0])
        said = _fallen(instance, 0, stay, low, top)
        temp = rng.uniform(low, top)
        for part in rng.dirichlet(np.full(rng.choice([1, 3, 12]), 0.5)):
            temp = _cell(temp, stay * part, trip, instance)
            assert temp >= said - 1e-6
        nearest = min(nearest, temp - said)
    assert nearest < 0.5  # and it is no more than that either


def test_the_steepest_slope_is_that_of_the_interval() -> None:
    table = Table1([0.0, 1.0, 2.0, 4.0], [0.0, 3.0, 2.0, 2.0])
    where = Interval(np.array([0.2, 1.5, 2.5, -3.0]), np.array([0.4, 3.0, 3.5, 9.0]))
    assert _steepest(table, where).tolist() == [3.0, 1.0, 0.0, 3.0]


def _around(x: np.ndarray, at: slice, lo: np.ndarray, hi: np.ndarray, by: float) -> Interval:
    lo, hi = lo.copy(), hi.copy()
    lo[..., at], hi[..., at] = (
        np.maximum(lo[..., at], x[..., at] - by),
        np.minimum(hi[..., at], x[..., at] + by),
    )
    return Interval(lo, hi)


@pytest.mark.parametrize("ambient_c", [-15.0, 10.0, 32.0])
@pytest.mark.parametrize("seed", range(6))
def test_what_is_known_at_some_cells_bounds_their_neighbours(seed: int, ambient_c: float) -> None:
    """Boxes drawn closely around a drive at every fourth border: the drive stays inside."""
    rng, heater = np.random.default_rng(seed), 1.0 if ambient_c > 30.0 else 5.0
    exchange = (0.01, 0.4, 0.01)[seed % 3]  # kW/K
    trip = small_trip(
        ambient_c=ambient_c, start_soc=0.8, end_soc_min=0.05, pack__temperature_max_c=55.0,
        start_temperature_c=-10.0 if exchange > 0.1 and ambient_c > 30.0 else ambient_c + 15.0,
        vehicle__heat_loss_kw_per_k=Table1([0.0, 130.0], [exchange, 0.04]),
    )  # fmt: skip
    least_on = heater if seed % 3 == 2 else 0.0  # the heater on throughout
    instance = make_instance(trip, (0, 1))
    cells, steps = instance.cells, instance.drive.n_steps
    controls = idle_controls(instance, tuple(rng.uniform(6.0, 9.0, 2)))
    controls = replace(
        controls,
        heater_kw=rng.choice([0.0, heater], steps),
        cooling_kw=rng.choice([0.0, 2.0], steps),
        heat_pump_kw=rng.uniform(0.0, 1.0, steps),
        stops=tuple(
            replace(
                s,
                power_kw=rng.uniform(8.0, 80.0, cells),
                heater_kw=rng.choice([least_on, heater], cells) * (seed % 3 != 1),
                cooling_kw=rng.choice([0.0, 2.0], cells) * (seed % 3 == 0),
                heat_pump_kw=rng.uniform(0.0, 1.0, cells),
            )
            for s in controls.stops
        ),
    )
    driven = simulate(instance, controls)
    assert driven.violation.max() < 1e-9
    temps = np.stack([s.temperature_c for s in driven.stops])
    dwells = np.stack([s.dwell_h for s in driven.stops])
    box = make_box(instance)
    free, at = box.stop_temperature, slice(0, None, 4)
    longest = np.maximum(dwells * 1.1, box.dwell.lo)
    box = replace(
        box,
        stop_temperature=_around(temps, at, free.lo, free.hi, 0.2),
        dwell=Interval(box.dwell.lo, np.minimum(box.dwell.hi, longest)),
    )
    for _ in range(3):
        box = propagate(instance, box)
    assert box.empty is None
    found = box.stop_temperature
    assert np.all(temps >= found.lo - 1e-6) and np.all(temps <= found.hi + 1e-6)
    assert np.all(driven.temperature_c >= box.temperature.lo - 1e-6)
    assert np.all(driven.temperature_c <= box.temperature.hi + 1e-6)
    assert found.width[:, 1:].max() < 0.5 * free.width[:, 1:].max()


def test_a_long_cell_of_a_warm_battery_ends_colder_than_a_cold_one() -> None:
    """Its midpoint lies where the pump draws much: the second case of the rule."""
    table = Table1([-200.0, 0.0, 5.0, 90.0], [1.0, 1.0, 6.0, 6.0])
    trip = small_trip(vehicle__heat_pump_cop=table, vehicle__heat_pump_kw=3.0)
    instance = make_instance(trip, (0,))
    for stay in (0.3, 1.0, 3.0):
        said = _fallen(instance, 0, stay, -2.0, 60.0)
        ends = np.array([_cell(t, stay, trip, instance) for t in np.linspace(-2.0, 60.0, 200)])
        assert -1e-6 <= ends.min() - said < 4.0


def test_no_battery_falls_because_ambient_is_warmer() -> None:
    table = Table1([-200.0, 90.0], [1.0, 1.0])  # nothing is drawn
    trip = small_trip(vehicle__heat_pump_cop=table, vehicle__heat_pump_kw=3.0)
    stop = make_instance(trip, (0,)).stops[0]
    said = _fallen(make_instance(trip, (0,)), 0, 5.0, stop.ambient_c - 30.0, stop.ambient_c - 20.0)
    assert said == pytest.approx(stop.ambient_c - 30.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_the_coldest_end_is_the_solution_of_its_equation(seed: int) -> None:
    """With the least heat at its own midpoint, by bisection; from warmer starts, never below."""
    rng = np.random.default_rng(seed)
    trip = small_trip(
        vehicle__heat_pump_kw=3.0, grid__step_km=float(rng.choice([1.0, 3.0, 6.0])),
        pack__heat_capacity_kwh_per_k=float(rng.choice([0.07, 0.2])),
        pack__resistance_ohm=Table1([-40.0, 0.0, 20.0, 60.0], [0.9, 0.2, 0.1, 0.3]),
        vehicle__heat_loss_kw_per_k=Table1([0.0, 130.0], rng.uniform(0.0, [0.3, 1.0])),
        vehicle__heat_pump_cop=Table1([-40.0, 0.0, 10.0, 60.0], [0.8, 1.5, 4.0, 3.0]),
    )  # fmt: skip
    instance = make_instance(trip, (0, 1))
    box, drive, vehicle = make_box(instance), instance.drive, instance.vehicle
    middle = box.middle_temperature
    lo = np.where(rng.random(box.power.lo.size) < 0.3, -5.0, box.power.lo)  # either sign
    power = Interval(lo, box.power.hi)
    colder, used = _Colder(instance, box, power), 0
    square = range1(vehicle.pack.voltage_squared, box.middle_energy)
    least = np.maximum(np.maximum(power.lo, -power.hi), 0.0) ** 2 + drive.ripple_kw2
    per_cop = 3.0 * (1.0 - 3.0 * vehicle.heat_pump_droop_per_kw)
    for k in range(drive.n_steps):
        start = box.start_temperature.lo[k]
        said = colder.end(k, start)
        if said == -np.inf:
            assert colder.share[k] > STEEPEST
            continue
        used += 1

        def missing(end: float, begin: float, k: int = k) -> float:
            mid = 0.5 * (begin + end)
            at = min(max(mid, middle.lo[k]), middle.hi[k])
            cop = float(np.interp(at, vehicle.heat_pump_cop.x, vehicle.heat_pump_cop.f))
            drawn = max(min(drive.cabin_heat_kw[k], cop * per_cop) * (1.0 - 1.0 / cop), 0.0)
            R = vehicle.pack.resistance_ohm
            flow = np.interp(at, R.x, R.f) * least[k] / square.hi[k] - drawn
            flow += drive.drivetrain_heat_kw[k]
            flow += drive.heat_loss_kw_per_k[k] * (drive.ambient_c[k] - mid)
            pace = drive.duration_h[k] / vehicle.pack.heat_capacity_kwh_per_k
            return float(end - begin - pace * flow)

        for above in (0.0, 0.3, 3.0):
            a, b = start - 200.0, start + 200.0
            for _ in range(70):
                end = 0.5 * (a + b)
                a, b = (a, end) if missing(end, start + above) > 0.0 else (end, b)
            assert end >= said - 1e-7
            assert above > 0.0 or colder.share[k] > 0.4 or end - said < 1.0
    assert used >= 1


def test_no_number_of_a_box_is_lost_where_a_stay_has_no_limit() -> None:
    trip = small_trip(
        ambient_c=20.0, vehicle__cabin_heating_kw=Table1([-40.0, 60.0], [0.0, 0.0]),
        vehicle__heat_loss_kw_per_k=Table1([0.0, 130.0], [0.0, 0.03]), vehicle__cooling_kw=0.0,
        vehicle__heater_kw=0.0,
    )  # fmt: skip
    trip = replace(trip, chargers=tuple(replace(c, max_dwell_h=np.inf) for c in trip.chargers))
    box = make_box(make_instance(trip, (0,), undecided=(1,)))
    for name in ("stop_temperature", "temperature", "after_temperature", "stay", "dwell"):
        interval: Interval = getattr(box, name)
        assert not np.isnan(interval.lo).any() and not np.isnan(interval.hi).any()
