"""Owns one nonlinear solver on one subset: build once, solve from a start, judge on the tables.

The claim of a solver is its own cost; the cost that counts is that of its
controls on ``relax.simulate``. Build and solve times are kept apart. Knows
nothing of other subsets.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from benchmarks.reference.nlp import make_model
from benchmarks.reference.polish import polish, release
from benchmarks.reference.program import COST_SCALE, LIMIT_SCALE_KW, SCALES, Model
from benchmarks.reference.stages import Stages
from benchmarks.reference.starts import Start, make_start
from relax.descent import NEARLY_FEASIBLE
from relax.instance import Instance
from relax.plan import Controls, Trajectory
from relax.simulate import FEASIBLE, is_feasible

__all__ = [
    "CAREFUL",
    "FAST",
    "MAX_REPAIRS",
    "REPAIR_MARGIN",
    "SOLVERS",
    "Peer",
    "PeerSettings",
    "Run",
    "build_peer",
    "evaluation_s",
    "solve_peer",
    "tightened",
]

Array = npt.NDArray[np.float64]

SOLVERS = ("ipopt", "fatrop")
"""Names of CasADi's plugins."""
MAX_REPAIRS = 3
"""Repeated solves of a plan that misses a limit on the tables."""
REPAIR_MARGIN = 1.5
"""By how much a missed limit is tightened, as a multiple of the violation."""


@dataclass(frozen=True)
class PeerSettings:
    """How a solver is run.

    Parameters
    ----------
    tolerance : float
        Of the scaled program.
    mu_init : float
        First barrier parameter.
    max_iterations : int
        Of one solve; 15 to 60 are usual.
    """

    tolerance: float
    mu_init: float
    max_iterations: int


FAST = {"ipopt": PeerSettings(1e-6, 1e-2, 200), "fatrop": PeerSettings(1e-6, 1e-1, 200)}
"""Where time counts. Costs are within 2e-5 of ``CAREFUL``; a tolerance of 1e-5 costs up to 2e-4.
The barrier parameters are the best of 1, 0.1, 0.03 and 0.01, FATROP's the more robust of two."""
CAREFUL = {"ipopt": PeerSettings(1e-7, 1e-1, 500), "fatrop": PeerSettings(1e-7, 1e-1, 200)}
"""Where cost counts. At 1e-8 FATROP fails often, and costs are better by 1e-6 only."""


@dataclass(frozen=True)
class Peer:
    """A solver with its program built.

    Parameters
    ----------
    solver : str
        One of ``SOLVERS``.
    model : Model
        The program, discharge limit left out if ``lazy``.
    function : casadi.Function
        The solver.
    lazy : bool
        Whether the discharge limit is left out until a plan misses it.
    settings : PeerSettings
        How it is run.
    build_s : float
        Time to write and build [s].
    """

    solver: str
    model: Model
    function: Any
    lazy: bool
    settings: PeerSettings
    build_s: float


@dataclass(frozen=True)
class Run:
    """What one solve gave.

    Parameters
    ----------
    success : bool
        Whether the solver reports a local optimum.
    status : str
        The solver's words.
    iterations : int
        Interior-point iterations, repairs included.
    claimed_cost : float
        Cost on the splines, fixed cost included [currency].
    cost : float
        Cost on the tables, after ``polish`` [currency].
    feasible : bool
        Whether the plan keeps all limits on the tables; then it counts, though the
        solver may not call it optimal (FATROP stops at the optimum without saying so).
    controls, trajectory : Controls, Trajectory
        The plan and what it causes on the tables.
    build_s, solve_s, judge_s : float
        Times of building, in the solver, and of polishing [s].
    evaluation_s : float
        Part of ``solve_s`` spent evaluating functions and derivatives [s].
    """

    success: bool
    status: str
    iterations: int
    claimed_cost: float
    cost: float
    feasible: bool
    controls: Controls
    trajectory: Trajectory
    build_s: float
    solve_s: float
    evaluation_s: float
    judge_s: float


def _options(solver: str, model: Model, settings: PeerSettings) -> dict[str, Any]:
    own: dict[str, Any] = {
        "print_level": 0,
        "tol": settings.tolerance,
        "max_iter": settings.max_iterations,
        "mu_init": settings.mu_init,
    }
    options: dict[str, Any] = {"print_time": False, "error_on_fail": False, solver: own}
    if solver == "ipopt":
        own["sb"] = "yes"
    else:
        options.update(
            structure_detection="manual",
            nx=model.nx,
            nu=model.nu,
            ng=model.ng,
            N=len(model.nx) - 1,
        )
    return options


def build_peer(
    instance: Instance,
    solver: str,
    stages: Stages | None = None,
    lazy: bool = True,
    settings: PeerSettings | None = None,
    integrator: str = "midpoint",
) -> Peer:
    """Write the program of an instance and build a solver for it.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    solver : str
        ``ipopt`` or ``fatrop``.
    stages : Stages, optional
        Shared by all subsets of a trip.
    lazy : bool
        Leave the discharge limit out at first: half the work of an iteration.
    settings : PeerSettings, optional
        How it is run; ``FAST`` by default.
    integrator : str
        ``midpoint`` or ``rk4``; that of ``stages`` if they are given.

    Raises
    ------
    ValueError
        Unknown solver or integrator.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> peer = build_peer(make_instance(load_trip("paper-400km"), (1,)), "fatrop")
    >>> peer.build_s > 0.0
    True
    """
    if solver not in SOLVERS:
        raise ValueError(f"unknown solver {solver!r}; known: {', '.join(SOLVERS)}")
    settings = settings or FAST[solver]
    begin = perf_counter()
    model = make_model(instance, stages, not lazy, integrator)
    function = ca.nlpsol(solver, solver, model.program, _options(solver, model, settings))
    return Peer(solver, model, function, lazy, settings, perf_counter() - begin)


def evaluation_s(stats: dict[str, Any]) -> float:
    """Return the time that a solver spent in functions and derivatives [s]."""
    return sum(float(v) for k, v in stats.items() if k.startswith("t_wall_nlp_"))


def solve_peer(peer: Peer, start: Start) -> Run:
    """Solve from a start, then polish and judge the plan on the tables.

    A plan that misses a limit of temperature or dwell on the tables is solved again with that
    limit tightened, from where it is; one that misses the discharge limit, with that limit
    written.

    Parameters
    ----------
    peer : Peer
        Built for the subset.
    start : Start
        Where to begin.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from benchmarks.reference.starts import single_start
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> run = solve_peer(build_peer(instance, "ipopt"), single_start(instance))
    >>> run.success, run.feasible, abs(run.cost / run.claimed_cost - 1.0) < 1e-3
    (True, True, True)
    """
    model, instance = peer.model, peer.model.instance
    point = make_start(model, start)
    hot = room = long = 0.0
    build_s = solve_s = evaluated_s = judge_s = 0.0
    iterations = 0
    for _ in range(1 + MAX_REPAIRS):
        x_lo, x_hi, g_lo, g_hi = tightened(model, hot, room, long)
        begin = perf_counter()
        answer = peer.function(x0=point, lbx=x_lo, ubx=x_hi, lbg=g_lo, ubg=g_hi)
        judged = perf_counter()
        stats = peer.function.stats()
        planned = model.controls(np.array(answer["x"]).ravel())
        controls, trajectory = polish(instance, release(instance, planned))
        solve_s += judged - begin
        judge_s += perf_counter() - judged
        evaluated_s += evaluation_s(stats)
        iterations += int(stats["iter_count"])
        success, feasible = bool(stats["success"]), is_feasible(trajectory)
        if feasible or not (success or float(trajectory.violation.max()) < NEARLY_FEASIBLE):
            break
        _, kelvin, kilowatt, hours = trajectory.violation.tolist()
        if kilowatt > FEASIBLE and peer.lazy:
            peer = build_peer(
                instance, peer.solver, None, False, peer.settings, peer.model.integrator
            )
            model = peer.model
            build_s += peer.build_s
            point = make_start(model, start)
            continue
        if max(kelvin, kilowatt, hours) <= FEASIBLE:
            break
        hot += REPAIR_MARGIN * kelvin
        room += REPAIR_MARGIN * kilowatt
        long += REPAIR_MARGIN * hours
        point = np.array(answer["x"]).ravel()
    return Run(
        success=success,
        status=str(stats["return_status"]),
        iterations=iterations,
        claimed_cost=float(answer["f"]) * COST_SCALE + instance.fixed_cost,
        cost=trajectory.cost,
        feasible=feasible,
        controls=controls,
        trajectory=trajectory,
        build_s=build_s,
        solve_s=solve_s,
        evaluation_s=evaluated_s,
        judge_s=judge_s,
    )


def tightened(
    model: Model, hot_k: float, room_kw: float, long_h: float
) -> tuple[Array, Array, Array, Array]:
    """Return bounds of variables and of constraints with limits tightened.

    Parameters
    ----------
    model : Model
        The program.
    hot_k : float
        By how much the limits of temperature move inwards [K].
    room_kw : float
        By how much the discharge limit does [kW].
    long_h : float
        By how much the limits of dwells do [h].
    """
    x_lo, x_hi, g_lo, g_hi = model.x_lo, model.x_hi, model.g_lo, model.g_hi
    if hot_k > 0.0:
        margin = np.zeros(x_lo.size)
        rows = (*model.steps, *(row for stop in model.cells for row in stop), model.last)
        margin[[row["temperature"] for row in rows if "temperature" in row]] = (
            hot_k / SCALES["temperature"]
        )
        x_lo, x_hi = x_lo + margin, x_hi - margin
    if room_kw > 0.0:
        g_lo = g_lo.copy()
        g_lo[list(model.discharge)] += room_kw / LIMIT_SCALE_KW
    if long_h > 0.0:
        g_hi = g_hi.copy()
        g_hi[list(model.dwell)] -= long_h / SCALES["dwell"]
    return x_lo, x_hi, g_lo, g_hi
