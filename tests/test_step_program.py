"""The program of a refinement's step is the linearisation of the simulation, row by row.

The nonlinear limits are written out here a second time, on the arrays of a trajectory.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from test_expansion import INSTANCE as SMOOTH
from trips import small_trip

from relax import Controls, Instance, Trajectory, idle_controls, make_instance, simulate
from relax.completion import penalty_prices
from relax.expansion import expand_cells, expand_drive
from relax.quadratic import QuadraticStep, TrustRegion
from relax.step_layout import Watch

Array = npt.NDArray[np.float64]


def distance(now: Trajectory, then: Trajectory, step: QuadraticStep) -> Array:
    """The step program's columns that lead from one trajectory to another."""
    x = np.zeros(step.n_columns)
    n = now.power_kw.size
    x[step.energy], x[step.temperature] = (
        then.energy_kwh - now.energy_kwh,
        then.temperature_c - now.temperature_c,
    )
    x[step.heater] = then.heater_kw - now.heater_kw
    x[step.cooling] = then.cooling_kw - now.cooling_kw
    x[step.pump] = then.heat_pump_kw - now.heat_pump_kw
    x[step.brake] = (then.brake_kw - now.brake_kw)[step.regen]
    cells = step.instance.cells
    for i, (a, b) in enumerate(zip(now.stops, then.stops, strict=True)):
        part = slice(i * cells, (i + 1) * cells)
        x[step.charged[i]] = np.ptp(b.energy_kwh) - np.ptp(a.energy_kwh)
        x[step.leave[i]] = b.energy_kwh[-1] - a.energy_kwh[-1]
        x[step.cell_temperature[i]] = (b.temperature_c - a.temperature_c)[1:]
        x[step.dwell[part]] = b.dwell_h - a.dwell_h
        for name, column in (
            ("heater_kw", step.cell_heater),
            ("cooling_kw", step.cell_cooling),
            ("heat_pump_kw", step.cell_pump),
        ):
            x[column[part]] = getattr(b, name) * b.dwell_h - getattr(a, name) * a.dwell_h
        free = step.instance.stops[i].occupancy_free_h
        x[step.occupancy[i]] = max(0.0, float(b.dwell_h.sum()) - free)
    assert n == step.heater.size
    return x


def interior_controls(instance: Instance, share: float) -> Controls:
    """Controls away from every limit, moving smoothly with ``share``."""
    n, cells, v = instance.drive.n_steps, instance.cells, instance.vehicle
    wave = np.sin(np.arange(n))
    ripple = np.cos(np.arange(cells))
    idle = idle_controls(instance, (9.0 + share, 7.0 - 0.5 * share))
    stops = tuple(
        replace(
            s,
            power_kw=25.0 + 3.0 * ripple + 2.0 * share,
            heater_kw=1.0 + 0.3 * ripple + 0.5 * share,
            cooling_kw=np.full(cells, 0.4 * v.cooling_kw + 0.2 * share),
            heat_pump_kw=0.3 + 0.1 * ripple - 0.1 * share,
        )
        for s in idle.stops
    )
    return Controls(
        1.0 + 0.2 * wave + 0.6 * share,
        np.full(n, 0.5) + 0.2 * share,
        0.4 + 0.1 * wave + 0.1 * share,
        stops,
    )


def test_the_step_program_is_the_linearisation_of_the_simulation() -> None:
    """Rows and objective along simulated trajectories: errors shrink with the square of the step.

    On affine tables, with every optional part switched on; a wrong coefficient anywhere leaves
    an error that only halves.
    """
    # cooling works at any temperature here: where it stops is the next test's
    instance = replace(SMOOTH, vehicle=replace(SMOOTH.vehicle, cooling_from_c=-25.0))
    now = simulate(instance, interior_controls(instance, 0.0))
    step = QuadraticStep(instance, Watch(cooling=True, discharge=True))
    program = step.build(
        now,
        expand_drive(instance, now),
        expand_cells(instance, now),
        None,
        penalty_prices(instance),
        TrustRegion(1e6, 1e6),
    )
    slack = _slack(instance, now)
    errors = []
    for share in (0.2, 0.1):
        then = simulate(instance, interior_controls(instance, share))
        x = distance(now, then, step)
        missed = program.A @ x - program.b
        rows = step.rows.slices
        found = {"objective": abs(float(program.q @ x) - (then.cost - now.cost))}
        for name in ("origin", "balance", "heat", "leave", "cell_heat"):
            found[name] = float(np.abs(missed[rows[name]]).max())
        after = _slack(instance, then)
        for name, value in after.items():
            # rows are A x <= b, their spare b - A x is the slack of the limit after the step
            found[name] = float(np.abs(-missed[rows[name]] - value).max())
            assert np.abs(program.b[rows[name]] - slack[name]).max() < 1e-6, name
        errors.append(found)
    for name, coarse in errors[0].items():
        fine = errors[1][name]
        assert coarse < 1e-6 or fine < 0.3 * coarse, (name, coarse, fine)


@pytest.mark.parametrize("downhill", [False, True])
def test_the_program_cools_as_far_as_the_simulation_does(downhill: bool) -> None:
    """First step and first cell: what it allows is what is left of any larger wish."""
    trip = small_trip(ambient_c=33.0, vehicle__cooling_from_c=30.0)
    if downhill:  # what recuperation heats does not count there
        power = np.where(np.arange(trip.route.propulsion_kw.size) < 3, -30.0, 25.0)
        trip = replace(trip, start_soc=0.6, route=replace(trip.route, propulsion_kw=power))
    binding = 0
    for start_c in (28.0, 30.05, 30.3, 31.0, 38.0):
        for node in (False, True):
            first = trip.chargers[0]
            places = (replace(first, position_km=0.0) if node else first, trip.chargers[1])
            here = replace(trip, start_temperature_c=start_c, chargers=places)
            instance = make_instance(here, (0,))
            idle = idle_controls(instance, (8.0,))
            v, n = instance.vehicle, instance.drive.n_steps
            cool = replace(
                idle,
                cooling_kw=np.full(n, 0.1),
                stops=tuple(
                    replace(s, cooling_kw=np.full(instance.cells, 0.1)) for s in idle.stops
                ),
            )
            full = replace(
                cool,
                cooling_kw=np.full(n, v.cooling_kw),
                stops=tuple(
                    replace(s, cooling_kw=np.full(instance.cells, v.cooling_kw)) for s in cool.stops
                ),
            )
            now, then = simulate(instance, cool), simulate(instance, full)
            step = QuadraticStep(instance, Watch(cooling=True))
            program = step.build(
                now, expand_drive(instance, now), expand_cells(instance, now), None,
                penalty_prices(instance), TrustRegion(1e6, 1e6),
            )  # fmt: skip
            rows, allowed, done = step.rows.slices, 0.0, 0.0
            if node:
                a, b = now.stops[0], then.stops[0]
                allowed = float(program.b[rows["cell_cooling_max"]][0])
                done = float(b.cooling_kw[0] * b.dwell_h[0] - a.cooling_kw[0] * a.dwell_h[0])
                done -= v.cooling_kw * float(b.dwell_h[0] - a.dwell_h[0])
            else:
                allowed = float(program.b[rows["cooling_max"]][0])
                done = float(then.cooling_kw[0] - now.cooling_kw[0])
            assert allowed == pytest.approx(done, abs=0.03 * v.cooling_kw * (0.1 if node else 1.0))
            binding += 1e-6 < allowed < 0.9 * (v.cooling_kw - 0.1)
    assert binding


def test_a_cell_that_cannot_cool_may_be_left_sooner() -> None:
    """A battery below the temperature from which cooling works: charging faster breaks no row."""
    trip = small_trip(ambient_c=10.0, vehicle__cooling_from_c=30.0)
    instance = make_instance(replace(trip, start_temperature_c=15.0), (0,))

    def charged(power_kw: float) -> Trajectory:
        idle = idle_controls(instance, (8.0,))
        power = np.full(instance.cells, power_kw)
        return simulate(
            instance, replace(idle, stops=tuple(replace(s, power_kw=power) for s in idle.stops))
        )

    now, then = charged(20.0), charged(25.0)
    assert now.stops[0].temperature_c.max() < 30.0
    assert then.stops[0].dwell_h.sum() < 0.9 * now.stops[0].dwell_h.sum()
    step = QuadraticStep(instance, Watch(cooling=True))
    program = step.build(
        now, expand_drive(instance, now), expand_cells(instance, now), None,
        penalty_prices(instance), TrustRegion(1e6, 1e6),
    )  # fmt: skip
    spare = program.b - program.A @ distance(now, then, step)
    assert spare[step.rows.slices["cell_cooling_max"]].min() > -1e-9


def _slack(instance: Instance, t: Trajectory) -> dict[str, Array]:
    """Slack of the nonlinear limits, written out here; rows of one name in the program."""
    v, d, pack = instance.vehicle, instance.drive, instance.vehicle.pack
    em = 0.5 * (t.energy_start_kwh + t.energy_kwh[1:])
    tm = 0.5 * (t.temperature_start_c + t.temperature_c[1:])
    y = np.concatenate([s.dwell_h for s in t.stops])

    def joined(name: str) -> Array:
        return np.concatenate([getattr(s, name) for s in t.stops])

    middle = np.concatenate([0.5 * (s.energy_kwh[1:] + s.energy_kwh[:-1]) for s in t.stops])
    grid = np.concatenate(
        [
            s.grid_limit_kw(m)
            for s, m in zip(instance.stops, np.split(middle, len(t.stops)), strict=True)
        ]
    )
    demand = np.repeat([s.cabin_heat_kw for s in instance.stops], instance.cells)
    e = np.concatenate([np.diff(s.energy_kwh) for s in t.stops])
    heater, cabin = joined("heater_kw"), joined("cabin_heater_kw")
    dwell = np.array([s.dwell_h.sum() for s in t.stops])
    longest = np.array([s.max_dwell_h for s in instance.stops])
    return {
        "heater_max": v.heater_kw - t.cabin_heater_kw - t.heater_kw,
        "cabin": d.cabin_heat_kw - t.pump_heat_kw,
        "pump_max": v.heat_pump_kw - t.heat_pump_kw,
        "cooling_max": v.cooling_kw - t.cooling_kw,
        "discharge": pack.discharge_limit_kw(em, tm) - 1e-3 - t.power_kw,
        "energy_min": t.energy_kwh[1:] - instance.energy_min_kwh[1:],
        "least_dwell": y - e / joined("limit_kw"),
        "grid_limit": grid * y - joined("grid_kwh"),
        "cell_heater_max": (v.heater_kw - heater - cabin) * y,
        "cell_cabin": (demand - joined("pump_heat_kw")) * y,
        "cell_pump_max": (v.heat_pump_kw - joined("heat_pump_kw")) * y,
        "cell_cooling_max": (v.cooling_kw - joined("cooling_kw")) * y,
        "dwell_max": longest - 1e-5 - dwell,
        "charged_full": instance.energy_max_kwh - np.array([s.energy_kwh[-1] for s in t.stops]),
    }
