"""Owns one descent to a local optimum of one subset: sequential convex quadratic programs.

Every iterate is an exactly simulated trajectory, so a plan is always feasible in
the dynamics; limits of state enter through an exact penalty. Method: docs/refinement.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np
import numpy.typing as npt

from relax.completion import complete, merit, penalty_prices
from relax.expansion import CellExpansion, DriveExpansion, expand_cells, expand_drive
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, StopControls, Trajectory
from relax.quadratic import QuadraticStep, StepProgram, TrustRegion
from relax.simulate import FEASIBLE, Simulation, is_feasible
from relax.solve import QpSolution, SolveStatus, solve_qp
from relax.step_layout import Watch

__all__ = ["NEARLY_FEASIBLE", "SAME_PLACE", "Descent", "RefineSettings", "Refined"]

Array = npt.NDArray[np.float64]

AT_LIMIT = 1e-5
"""Slack below which a control counts as lying on its limit [kW, kWh or h]."""
NEARLY_FEASIBLE = 1e-2
"""Violation that further steps are worth, however little they gain [kWh, K, kW, h]."""
WORTH_A_STEP = 0.05
"""Share of its predicted gain that a step must gain."""
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
LONGER = (2.0, 4.0, 8.0, 16.0)
"""Multiples of a step that gained more than was predicted: tried as long as each gains more."""
LOSING = 2e-3
"""Relative tolerance for subsets that cannot reach the best plan any more: without one the costs
of other choices are up to 17 % too high from Goteborg to Stockholm in winter."""
HOPE = 5.0
"""Multiple of its predicted gain that a search is trusted to reach."""
USABLE = (SolveStatus.SOLVED, SolveStatus.INACCURATE)
"""Solver results a step may be taken from: it is judged by simulation anyway."""


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


class Descent:
    """One search from a start, a step at a time; ``run`` may be called again to go on.

    Parameters
    ----------
    simulation : Simulation
        Of the instance; one that has just run ``start`` need not do so again.
    start : Controls
        Any controls.
    settings : RefineSettings
        When to stop and how to solve; ``max_programs`` is left to ``run``.
    weight : float
        Multiple of the penalty prices.
    known : Trajectory, optional
        A locally optimal one: a search that arrives there ends.
    """

    def __init__(
        self,
        simulation: Simulation,
        start: Controls,
        settings: RefineSettings,
        weight: float = 1.0,
        known: Trajectory | None = None,
    ) -> None:
        self.simulation, self.start, self.settings = simulation, start, settings
        self.instance, self.known = simulation.instance, known
        self.weight = weight
        self.penalty = weight * penalty_prices(self.instance)
        self.controls, self.now = complete(simulation, start)
        self.value = self._value(self.now)
        self.step = QuadraticStep(self.instance, Watch().extended(self.instance, self.now))
        self.trust = TrustRegion()
        self.multipliers: Array | None = None
        self.restarts = MAX_RESTARTS
        self.programs = 0
        self.ended = False

    @property
    def found(self) -> Refined:
        """The iterate it stands at, its best."""
        return Refined(self.controls, self.now, is_feasible(self.now), self.programs)

    def run(self, max_programs: int) -> Refined:
        """Improve the iterate until that gains no more, or ``max_programs`` in all are solved."""
        while not self.ended and self.programs < max_programs:
            self._advance(max_programs)
        return self.found

    def _value(self, trajectory: Trajectory) -> float:
        return merit(self.instance, trajectory, self.weight)

    def _solve(self, program: StepProgram) -> QpSolution | None:
        """Return the solution of a program, or none that a step may be taken from."""
        self.programs += 1
        solution = solve_qp(
            program.P,
            program.q,
            program.A,
            program.b,
            program.n_eq,
            solver=self.settings.solver,
            tolerance=self.settings.solver_tolerance,
        )
        return solution if solution.status in USABLE else None

    def _advance(self, max_programs: int) -> None:
        """Take one step, with as many programs as the trust region needs, or end."""
        now, step = self.now, self.step
        drive = expand_drive(self.instance, now)
        cells = expand_cells(self.instance, now, kinks=bool(step.kinks)) if now.stops else None
        while self.trust.temperature_k > LEAST_TRUST_K:
            if self.programs >= max_programs:
                return
            if self._try(drive, cells) or self.ended:
                return
            self.trust = self.trust.scaled(0.3)
        if self.restarts:
            # on a kink: once more with a wide region and without the old curvature
            self.restarts, self.trust, self.multipliers = self.restarts - 1, TrustRegion(), None
        else:
            self.ended = True

    def _try(self, drive: DriveExpansion, cells: CellExpansion | None) -> bool:
        """Solve the program within the trust region; take its step if that gains enough."""
        if self.settings.late:
            self.ended = True
            return False
        now, step = self.now, self.step
        program = step.build(now, drive, cells, self.multipliers, self.penalty, self.trust)
        solution = self._solve(program)
        if solution is None:
            self.ended = True
            return False
        x = solution.x
        model = now.cost - _occupancy(self.instance, now) + program.change(x)
        predicted = self.value - model
        size = merit(self.instance, now)  # its usual penalty: a dearer one would loosen tolerances
        least = self.settings.tolerance * max(abs(size), 1.0)
        if self._is_enough(predicted, least, size):
            self.ended = True
            return False
        tight = _tight_arrivals(step, program, x)

        def at(length: float) -> tuple[Controls, Trajectory]:
            controls = _next_controls(step, program, x, now, length)
            return complete(self.simulation, controls, tight)

        trial, then = at(1.0)
        gained = self.value - self._value(then)
        if gained <= WORTH_A_STEP * predicted and not is_feasible(then):
            program = step.corrected(program, x, now, then)
            solution = self._solve(program)
            if solution is None:
                self.ended = True
                return False
            x = solution.x
            trial, then = at(1.0)
            gained = self.value - self._value(then)
        if gained <= WORTH_A_STEP * predicted:
            return False
        if gained > 1.25 * predicted and gained > 10.0 * least:
            for length in LONGER:
                longer, far = at(length)
                if self._value(far) >= self._value(then):
                    break
                trial, then = longer, far
        if gained > GROW * predicted and self.trust.temperature_k < LARGEST_TRUST_K:
            self.trust = self.trust.scaled(2.0)
        self.controls, self.now, self.value = trial, then, self._value(then)
        self.ended = self._has_arrived(predicted, gained, least)
        watch = step.watch.extended(self.instance, then)
        self.multipliers = solution.z if watch == step.watch else None
        if watch != step.watch:
            self.step = QuadraticStep(self.instance, watch)
        return True

    def _is_enough(self, predicted: float, least: float, size: float) -> bool:
        """Return whether a predicted gain is not worth its step."""
        hopeless = self.value - HOPE * predicted > self.settings.hopeless
        near = FEASIBLE < float(self.now.violation.max()) < NEARLY_FEASIBLE
        return (hopeless and predicted < LOSING * size) or (
            predicted <= (1e-3 * least if near else least)
        )

    def _has_arrived(self, predicted: float, gained: float, least: float) -> bool:
        """Return whether the step just taken was the last one, or led to the known optimum."""
        settled = (
            predicted <= SETTLED * least
            and abs(gained - predicted) <= AS_PREDICTED * predicted
            and self.trust.temperature_k >= TrustRegion().temperature_k
            and is_feasible(self.now)
        )
        known = self.known
        if settled or known is None:
            return settled
        return abs(self.now.cost - known.cost) <= least and _is_near(self.now, known)


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
