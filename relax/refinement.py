"""Owns the search for a locally optimal plan of one subset: sequential convex quadratic programs.

Every iterate is an exactly simulated trajectory, so a plan is always feasible in
the dynamics; limits of state enter through an exact penalty. An approximation:
it suggests plans and never proves anything. Method and what failed: docs/refinement.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf
from typing import Literal

import numpy as np
import numpy.typing as npt

from relax.expansion import expand_cells, expand_drive
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, StopControls, Trajectory
from relax.quadratic import QuadraticStep, StepProgram, TrustRegion
from relax.simulate import FEASIBLE, Simulation, is_feasible
from relax.solve import QpSolution, SolveStatus, solve_qp
from relax.step_layout import Watch

__all__ = ["RefineSettings", "Refined", "complete", "merit", "refine"]

Array = npt.NDArray[np.float64]

AT_LIMIT = 1e-5
"""Slack below which a control counts as lying on its limit [kW, kWh or h]."""
END_TOLERANCE_KWH = 2e-5
"""How exactly the energy at the end of the trip meets its limit [kWh]."""
NEARLY_FEASIBLE = 1e-2
"""Violation that further steps are worth, however little they gain [kWh, K, kW, h]."""
GROW = 0.4
"""Share of the predicted gain above which the trust region grows."""
SETTLED = 10.0
"""Multiple of the tolerance: a step that was predicted to gain at most this, did gain it, and was
not held back by the trust region is the last one; the next would gain the square of it."""
AS_PREDICTED = 0.25
"""Relative difference between gain and prediction up to which it did."""
SAME_PLACE = 0.3
"""Trajectories this near to each other, and of the same cost, lead to the same optimum [K, kWh]."""
LEAST_TRUST_K = 0.05
"""Trust region below which the search ends: it stands on a kink [K]."""
MAX_RESTARTS = 1
"""How often a search that ended on a kink is begun again from there."""
LARGEST_TRUST_K = 16.0
"""Trust region beyond which it does not grow [K]."""
LOSING = 2e-3
"""Relative tolerance for subsets that cannot reach the best plan any more: without one the costs
of other choices are up to 17 % too high from Goteborg to Stockholm in winter."""
HOPE = 5.0
"""Multiple of its predicted gain that a search is trusted to reach."""
DEARER = (10.0, 100.0)
"""Multiples of the penalties with which a search goes on that ended beyond a limit: where only
time keeps a battery cool, a kelvin may be worth more than any energy."""
USABLE = (SolveStatus.SOLVED, SolveStatus.INACCURATE)
"""Solver results a step may be taken from: it is judged by simulation anyway."""
MAX_PASSES = 6
"""Bound on the simulations that meet the energy limits; each gains a factor of about 50."""


@dataclass(frozen=True)
class RefineSettings:
    """When to stop and how to solve.

    Parameters
    ----------
    tolerance : float
        Predicted relative decrease of the cost at which to stop.
    max_programs : int
        Bound on the quadratic programs.
    solver : {"clarabel", "osqp"}
        Who solves them.
    solver_tolerance : float
        Tolerance of each program.
    hopeless : float
        Cost to beat: a search that could not reach it with several times its
        predicted gain ends at a looser tolerance, 0.2 % [currency].
    deadline : float
        ``time.perf_counter()`` from which on no program is solved [s].
    """

    tolerance: float = 2e-5
    max_programs: int = 40
    solver: Literal["clarabel", "osqp"] = "clarabel"
    solver_tolerance: float = 1e-5
    hopeless: float = inf
    deadline: float = inf

    @property
    def late(self) -> bool:
        """Whether time is up."""
        return time.perf_counter() > self.deadline


@dataclass(frozen=True)
class Refined:
    """A locally optimal plan of one subset.

    Parameters
    ----------
    controls : Controls
        What the car executes.
    trajectory : Trajectory
        What the transcription says happens.
    feasible : bool
        No limit violated by more than rounding.
    programs : int
        Quadratic programs solved.
    """

    controls: Controls
    trajectory: Trajectory
    feasible: bool
    programs: int


def penalty_prices(instance: Instance) -> Array:
    """Return the prices of violated limits, shape (4,) [currency per kWh, K, kW, h].

    Far above what a kWh can be worth on the trip: its energy price, and its share of
    the dwell at a slow, cold charger; so the penalty is exact. The others weigh
    10 K, 10 kW and 6 minutes like 1 kWh; under a limit of the time in all 36 seconds:
    near the least time of a trip a minute is worth several kWh.
    """
    prices = [abs(s.price_per_kwh) for s in instance.stops]
    hours = [s.time_price_per_h + s.occupancy_price_per_h for s in instance.stops]
    price = 20.0 * max([0.1, *prices]) + 2.0 * max([0.0, *hours])
    hour = 10.0 if np.isinf(instance.total_dwell_h) else 100.0
    return price * np.array([1.0, 0.1, 0.1, hour])


def merit(instance: Instance, trajectory: Trajectory, weight: float = 1.0) -> float:
    """Return cost plus penalty of a trajectory, its prices times a weight [currency]."""
    return trajectory.cost + weight * float(penalty_prices(instance) @ trajectory.violation)


def complete(
    simulation: Simulation, controls: Controls, tight: frozenset[int] = frozenset()
) -> tuple[Controls, Trajectory]:
    """Simulate, with charged energies such that binding energy limits are met exactly.

    Parameters
    ----------
    simulation : Simulation
        Of the instance.
    controls : Controls
        Any controls; only charged energies change.
    tight : frozenset of int
        Stops at which the car is to arrive with the least energy: the stop before
        each gives or takes what is missing. The largest stop after the last of them
        makes the trip end at its least energy.

    Returns
    -------
    tuple of Controls and Trajectory
        The limits are met to 2e-5 kWh unless a full or an empty battery prevents it.
    """
    trajectory = simulation.run(controls)
    for _ in range(MAX_PASSES if controls.stops else 0):
        shift = _shortage(simulation.instance, controls, trajectory, tight, simulation.worth)
        changed = np.flatnonzero(np.abs(shift) > END_TOLERANCE_KWH)
        if not changed.size:
            break
        stops = tuple(
            replace(s, energy_kwh=s.energy_kwh + w)
            for s, w in zip(controls.stops, shift.tolist(), strict=True)
        )
        controls = replace(controls, stops=stops)
        before = trajectory.final_energy_kwh
        trajectory = simulation.run(controls, keep=int(changed[0]))
        gained, added = trajectory.final_energy_kwh - before, float(shift.sum())
        if gained * added > 0.0 and 0.5 < added / gained < 2.0:
            simulation.worth = added / gained
    return controls, trajectory


def _shortage(
    instance: Instance,
    controls: Controls,
    trajectory: Trajectory,
    tight: frozenset[int],
    rate: float,
) -> Array:
    """Return the changes of the charged energies that meet the energy limits to first order."""
    charged = [s.energy_kwh for s in controls.stops]
    arrive = [float(s.energy_kwh[0]) for s in trajectory.stops]
    shifts = np.zeros(len(charged))
    first = 0

    def give(i: int, amount: float) -> float:
        full = instance.energy_max_kwh - arrive[i] - float(shifts[:i].sum())
        target = max(min(charged[i] + rate * amount, full), MIN_CHARGE_KWH)
        shifts[i] = target - charged[i]
        return float(shifts[i]) / rate

    for m in range(1, len(charged)):
        missing = instance.stops[m].arrive_min_kwh - arrive[m] - float(shifts.sum())
        if m in tight or missing > END_TOLERANCE_KWH:
            give(m - 1, missing)
            first = m
    missing = instance.end_energy_min_kwh - trajectory.final_energy_kwh - float(shifts.sum()) / rate
    for i in sorted(range(first, len(charged)), key=lambda i: (-charged[i], i)):
        if abs(missing) <= END_TOLERANCE_KWH:
            break
        missing -= give(i, missing)
    return shifts


def _next_controls(
    step: QuadraticStep, program: StepProgram, x: Array, now: Trajectory, length: float
) -> Controls:
    """Return the controls at ``length`` times the program's step.

    What lies on a limit stays *on the limit*: the simulation clips it there,
    wherever the limit moves with the temperature.
    """
    vehicle, rows = step.instance.vehicle, step.rows.slices
    spare = program.b - program.A @ x

    def bound(name: str) -> npt.NDArray[np.bool_]:
        return np.asarray(spare[rows[name]] <= AT_LIMIT)

    x = length * x
    heater = np.where(
        bound("heater_max"), vehicle.heater_kw, np.maximum(now.heater_kw + x[step.heater], 0.0)
    )
    cooling = now.cooling_kw
    if step.watch.cooling:
        cooling = np.clip(cooling + x[step.cooling], 0.0, vehicle.cooling_kw)
    pump = np.zeros_like(heater)
    if step.has_pump:
        wanted = np.clip(now.heat_pump_kw + x[step.pump], 0.0, vehicle.heat_pump_kw)
        pump = np.where(bound("cabin"), vehicle.heat_pump_kw, wanted)
    stops: list[StopControls] = []
    cells = step.instance.cells
    for i, done in enumerate(now.stops):
        part = slice(i * cells, (i + 1) * cells)
        y = done.dwell_h + x[step.dwell[part]]
        y = np.maximum(y, 0.05 * done.dwell_h)
        charged = float(done.energy_kwh[-1] - done.energy_kwh[0]) + float(x[step.charged[i]])
        charged = max(charged, MIN_CHARGE_KWH)

        def power(
            before: Array, change: Array, y: Array = y, done_h: Array = done.dwell_h
        ) -> Array:
            return np.maximum((before * done_h + change) / y, 0.0)

        fast = bound("least_dwell")[part] | bound("grid_limit")[part]
        for k in step.kinks:
            fast |= bound(f"other_dwell_{k}")[part]
        cell_heater = power(done.heater_kw, x[step.cell_heater[part]])
        cell_heater[bound("cell_heater_max")[part]] = vehicle.heater_kw
        cell_pump = np.zeros(cells)
        if step.has_pump:
            cell_pump = power(done.heat_pump_kw, x[step.cell_pump[part]])
            cell_pump = np.minimum(cell_pump, vehicle.heat_pump_kw)
            full = bound("cell_cabin")[part] | bound("cell_pump_max")[part]
            cell_pump[full] = vehicle.heat_pump_kw
        cell_cooling = done.cooling_kw
        if step.watch.cooling:
            cell_cooling = power(cell_cooling, x[step.cell_cooling[part]])
        stops.append(
            StopControls(
                energy_kwh=charged,
                power_kw=np.where(fast, inf, charged / cells / y),
                heater_kw=cell_heater,
                cooling_kw=np.minimum(cell_cooling, vehicle.cooling_kw),
                heat_pump_kw=cell_pump,
            )
        )
    return Controls(heater, cooling, pump, tuple(stops))


def _tight_arrivals(step: QuadraticStep, program: StepProgram, x: Array) -> frozenset[int]:
    """Return the stops at which the program arrives with the least energy."""
    if not step.instance.stops:
        return frozenset()
    rows = step.rows.slices["arrive_min"]
    spare = program.b[rows] - (program.A @ x)[rows]
    return frozenset(np.flatnonzero(spare <= AT_LIMIT).tolist())


def refine(
    instance: Instance,
    start: Controls,
    settings: RefineSettings | None = None,
    simulation: Simulation | None = None,
    known: Trajectory | None = None,
) -> Refined:
    """Improve controls to a locally optimal plan of the transcription.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    start : Controls
        Any controls.
    settings : RefineSettings, optional
        When to stop and how to solve.
    simulation : Simulation, optional
        Of the instance; one that has just run ``start`` need not do so again.
    known : Trajectory, optional
        A locally optimal one: a search that arrives there ends.

    Returns
    -------
    Refined
        The best iterate; ``feasible`` says whether it keeps every limit.
    """
    settings, simulation = settings or RefineSettings(), simulation or Simulation(instance)
    found = first = _descend(simulation, start, settings, 1.0, known)
    for weight in DEARER:
        left = settings.max_programs - found.programs
        if found.feasible or left <= 0 or found.trajectory.cost >= settings.hopeless:
            break
        if settings.late:
            break
        begin = start if found is first else found.controls
        again = _descend(simulation, begin, replace(settings, max_programs=left), weight)
        found = replace(
            again,
            programs=found.programs + again.programs,
        )
    if found.feasible:
        return found
    nearest = min(first, found, key=lambda r: float(r.trajectory.violation.max()))
    return replace(nearest, programs=found.programs)


def _descend(
    simulation: Simulation,
    start: Controls,
    settings: RefineSettings,
    weight: float,
    known: Trajectory | None = None,
) -> Refined:
    """Improve controls until the merit with penalties times a weight gains no more."""
    instance = simulation.instance
    controls, now = complete(simulation, start)

    def value_of(trajectory: Trajectory) -> float:
        return merit(instance, trajectory, weight)

    value = value_of(now)
    step = QuadraticStep(instance, Watch().extended(instance, now))
    trust = TrustRegion()
    multipliers: Array | None = None
    penalty = weight * penalty_prices(instance)
    programs = 0

    def solve(program: StepProgram) -> QpSolution:
        nonlocal programs
        solution = solve_qp(
            program.P,
            program.q,
            program.A,
            program.b,
            program.n_eq,
            solver=settings.solver,
            tolerance=settings.solver_tolerance,
        )
        programs += 1
        return solution

    restarts = MAX_RESTARTS
    while programs < settings.max_programs:
        drive = expand_drive(instance, now)
        cells = expand_cells(instance, now, kinks=bool(step.kinks)) if now.stops else None
        accepted = False
        while programs < settings.max_programs and trust.temperature_k > LEAST_TRUST_K:
            if settings.late:
                return Refined(controls, now, is_feasible(now), programs)
            program = step.build(now, drive, cells, multipliers, penalty, trust)
            solution = solve(program)
            if solution.status not in USABLE:
                return Refined(controls, now, is_feasible(now), programs)
            x = solution.x
            model = now.cost - _occupancy(instance, now) + program.change(x)
            predicted = value - model
            near = FEASIBLE < float(now.violation.max()) < NEARLY_FEASIBLE
            size = merit(instance, now)  # its usual penalty: a dearer one would loosen tolerances
            least = settings.tolerance * max(abs(size), 1.0)
            if value - HOPE * predicted > settings.hopeless and predicted < LOSING * size:
                return Refined(controls, now, is_feasible(now), programs)
            if predicted <= (1e-3 * least if near else least):
                return Refined(controls, now, is_feasible(now), programs)
            tight = _tight_arrivals(step, program, x)
            trial, then = complete(simulation, _next_controls(step, program, x, now, 1.0), tight)
            gained = value - value_of(then)
            if gained <= 0.05 * predicted and not is_feasible(then):
                program = step.corrected(program, x, now, then)
                solution = solve(program)
                if solution.status not in USABLE:
                    break
                x = solution.x
                trial, then = complete(
                    simulation, _next_controls(step, program, x, now, 1.0), tight
                )
                gained = value - value_of(then)
            if gained > 0.05 * predicted:
                accepted = True
                break
            trust = trust.scaled(0.3)
        if not accepted and restarts and trust.temperature_k <= LEAST_TRUST_K:
            # on a kink: once more with a wide region and without the old curvature
            restarts, trust, multipliers = restarts - 1, TrustRegion(), None
            continue
        if not accepted:
            break
        if gained > 1.25 * predicted:
            for length in (2.0, 4.0, 8.0, 16.0) if gained > 10.0 * least else ():
                longer, far = complete(
                    simulation, _next_controls(step, program, x, now, length), tight
                )
                if value_of(far) >= value_of(then):
                    break
                trial, then = longer, far
        if gained > GROW * predicted and trust.temperature_k < LARGEST_TRUST_K:
            trust = trust.scaled(2.0)
        controls, now, value = trial, then, value_of(then)
        if (
            predicted <= SETTLED * least
            and abs(gained - predicted) <= AS_PREDICTED * predicted
            and trust.temperature_k >= TrustRegion().temperature_k
            and is_feasible(now)
        ):
            break
        if known is not None and abs(now.cost - known.cost) <= least and _is_near(now, known):
            break
        multipliers = solution.z
        watch = step.watch.extended(instance, now)
        if watch != step.watch:
            step, multipliers = QuadraticStep(instance, watch), None
    return Refined(controls, now, is_feasible(now), programs)


def _is_near(now: Trajectory, known: Trajectory) -> bool:
    """Return whether two trajectories differ by less than decides where a search ends."""
    apart_k = np.abs(now.temperature_c - known.temperature_c).max()
    apart_kwh = np.abs(now.energy_kwh - known.energy_kwh).max()
    return bool(apart_k <= SAME_PLACE and apart_kwh <= SAME_PLACE)


def _occupancy(instance: Instance, now: Trajectory) -> float:
    """Return the occupancy cost of a trajectory: the program counts it anew, not as a change."""
    return sum(
        s.occupancy_price_per_h * max(0.0, float(done.dwell_h.sum()) - s.occupancy_free_h)
        for s, done in zip(instance.stops, now.stops, strict=True)
    )


def best_of(candidates: Iterable[Refined], instance: Instance) -> Refined:
    """Return the feasible candidate of least merit, or of all if none is; the first of equals."""
    return min(candidates, key=lambda c: (not c.feasible, merit(instance, c.trajectory)))
