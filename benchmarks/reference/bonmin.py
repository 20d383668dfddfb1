"""Owns BONMIN on the whole problem: which chargers, and everything else, in one program.

The paper's way. One program holds every charger with a variable that uses it
or not; BONMIN branches on these. Its bounds hold for convex programs, ours is
none: the answer is a plan without a proof, judged on the tables like every
other. Knows nothing of our own solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from benchmarks.reference.nlp import make_model
from benchmarks.reference.peer import MAX_REPAIRS, REPAIR_MARGIN, Run, evaluation_s, tightened
from benchmarks.reference.polish import polish, release
from benchmarks.reference.program import COST_SCALE, Model
from benchmarks.reference.quiet import quiet
from benchmarks.reference.starts import make_start, single_start
from relax.instance import Drive, Instance, make_drive, make_instance
from relax.plan import Controls
from relax.simulate import FEASIBLE, is_feasible
from relax.trip import Trip

__all__ = ["BonminResult", "BonminSettings", "bonmin_best"]

Array = npt.NDArray[np.float64]

INTEGRAL = 1e-4
"""How near a choice must be to 0 or 1."""
KEPT = 1e-3
"""Violation of the scaled constraints up to which an answer is worth a look on the tables."""


@dataclass(frozen=True)
class BonminSettings:
    """How BONMIN is run.

    Parameters
    ----------
    tolerance : float
        Of the scaled program, in every node.
    mu_init : float
        First barrier parameter of every node.
    max_iterations : int
        Of one node: nodes without a feasible point would take thousands.
    restarts : int
        Random starts of the root beside the first; each is worth a node.
    """

    tolerance: float = 1e-6
    mu_init: float = 1e-2
    max_iterations: int = 150
    restarts: int = 0


@dataclass(frozen=True)
class BonminResult:
    """What BONMIN gave for a trip.

    Parameters
    ----------
    success : bool
        Whether it says it is done: within the time limit, on its own terms.
    status : str
        Its words.
    subset : tuple of int
        Chargers that its plan uses; empty without a plan.
    run : Run or None
        The plan judged on the tables; None if no binary choice came out.
    build_s, solve_s : float
        Times of writing the program and in the solver [s].
    """

    success: bool
    status: str
    subset: tuple[int, ...]
    run: Run | None
    build_s: float
    solve_s: float


def _build(model: Model, settings: BonminSettings, time_limit_s: float) -> Any:
    discrete = [False] * model.x_lo.size
    for rows in model.cells:
        discrete[rows[0]["use"]] = True
    own = {
        "time_limit": time_limit_s,
        "max_cpu_time": time_limit_s,
        "tol": settings.tolerance,
        "mu_init": settings.mu_init,
        "max_iter": settings.max_iterations,
        "num_resolve_at_root": settings.restarts,
        "print_level": 0,
        "bb_log_level": 0,
        "nlp_log_level": 0,
        "sb": "yes",
    }
    options: dict[str, Any] = {
        "discrete": discrete,
        "print_time": False,
        "error_on_fail": False,
        "bonmin": own,
    }
    return ca.nlpsol("bonmin", "bonmin", model.program, options)


def _chosen(
    trip: Trip, model: Model, point: Array, drive: Drive
) -> tuple[tuple[int, ...], Instance, Controls]:
    """Return the subset that a point uses, its instance and the controls on it."""
    used = model.used(point)
    subset = tuple(model.instance.stops[i].charger for i in used)
    controls = model.controls(point)
    controls = replace(controls, stops=tuple(controls.stops[i] for i in used))
    return subset, make_instance(trip, subset, drive=drive), controls


def bonmin_best(
    trip: Trip,
    time_limit_s: float = 60.0,
    integrator: str = "midpoint",
    settings: BonminSettings | None = None,
) -> BonminResult:
    """Return the plan that BONMIN finds for a trip, over all subsets of chargers at once.

    A plan that misses a limit on the tables is looked for again with that limit
    tightened, or written if it was left out, as for the other peers.

    Parameters
    ----------
    trip : Trip
        The trip.
    time_limit_s : float
        Processor time in the solver, repairs included [s]. BONMIN looks at the clock
        between nodes; a node ends at the limit too.
    integrator : str
        ``midpoint`` or ``rk4``.
    settings : BonminSettings, optional
        How it is run.

    Returns
    -------
    BonminResult
        The plan and its cost on the tables.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from relax import load_trip
    >>> from relax.trip import Grid
    >>> trip = replace(load_trip("paper-400km"), grid=Grid(40.0, 2))
    >>> found = bonmin_best(replace(trip, chargers=trip.chargers[1:]))
    >>> found.subset, found.run.feasible, found.run.cost / found.run.claimed_cost < 1.001
    ((0,), True, True)
    """
    settings = settings or BonminSettings()
    drive = make_drive(trip, trip.grid.step_km)
    everything = make_instance(trip, tuple(range(len(trip.chargers))), drive=drive)
    lazy, hot, room, long = True, 0.0, 0.0, 0.0
    build_s = solve_s = judge_s = evaluated_s = 0.0
    model, point = None, np.zeros(0)
    subset: tuple[int, ...] = ()
    run: Run | None = None
    success, status = False, "no time"
    for _ in range(1 + MAX_REPAIRS):
        if solve_s >= time_limit_s:
            break
        begin = perf_counter()
        if model is None:
            model = make_model(everything, None, not lazy, integrator, optional=True)
            point = make_start(model, single_start(everything))
        with quiet():
            function = _build(model, settings, time_limit_s - solve_s)
            build_s += perf_counter() - begin
            x_lo, x_hi, g_lo, g_hi = tightened(model, hot, room, long)
            begin = perf_counter()
            answer = function(x0=point, lbx=x_lo, ubx=x_hi, lbg=g_lo, ubg=g_hi)
            solve_s += perf_counter() - begin
        stats = function.stats()
        evaluated_s += evaluation_s(stats)
        found = np.array(answer["x"]).ravel()
        success, status = bool(stats["success"]), str(stats["return_status"])
        if not _is_point(model, found):
            break
        begin = perf_counter()
        subset, instance, planned = _chosen(trip, model, found, drive)
        controls, trajectory = polish(instance, release(instance, planned))
        judge_s += perf_counter() - begin
        run = Run(
            success=success,
            status=status,
            iterations=int(stats["n_call_nlp_hess_l"]),
            claimed_cost=float(answer["f"]) * COST_SCALE,
            cost=trajectory.cost,
            feasible=is_feasible(trajectory),
            controls=controls,
            trajectory=trajectory,
            build_s=0.0,
            solve_s=solve_s,
            evaluation_s=evaluated_s,
            judge_s=judge_s,
        )
        _, kelvin, kilowatt, hours = trajectory.violation.tolist()
        if run.feasible or max(kelvin, kilowatt, hours) <= FEASIBLE:
            break
        if kilowatt > FEASIBLE and lazy:
            lazy, model = False, None
            continue
        hot += REPAIR_MARGIN * kelvin
        room += REPAIR_MARGIN * kilowatt
        long += REPAIR_MARGIN * hours
        point = found
    return BonminResult(success, status, subset, run, build_s, solve_s)


def _is_point(model: Model, point: Array) -> bool:
    """Return whether an answer is a plan at all: binaries integral, constraints nearly kept."""
    if not np.isfinite(point).all():
        return False
    uses = np.array([point[rows[0]["use"]] for rows in model.cells])
    rows = np.array(ca.Function("g", [model.program["x"]], [model.program["g"]])(point)).ravel()
    missed = np.maximum(model.g_lo - rows, rows - model.g_hi)
    return bool(np.abs(uses - np.round(uses)).max(initial=0.0) < INTEGRAL and missed.max() < KEPT)
