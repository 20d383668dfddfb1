"""Owns SCIP on the transcription: a global solver, for one subset of chargers or for all at once.

It branches over temperatures, energies and powers and so proves a bound that
holds for the transcription itself (``scip_model`` says why); its plan is judged
on the tables like every other. Knows nothing of our own solver, but may be
given a plan to start from: then what counts is the bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from time import perf_counter
from typing import Any

from benchmarks.reference.polish import polish, release
from benchmarks.reference.quiet import quiet
from benchmarks.reference.scip_maps import FIT_TOLERANCE
from benchmarks.reference.scip_model import ScipModel, make_scip_model
from benchmarks.reference.scip_point import point_of, read_controls, used_stops
from relax.instance import make_drive, make_instance
from relax.plan import Controls, Trajectory
from relax.simulate import is_feasible, simulate
from relax.trip import Trip

__all__ = ["SETTINGS", "ScipResult", "WarmStart", "scip_solve"]

SETTINGS: dict[str, Any] = {
    "propagating/obbt/itlimitfactor": 2.0,
    "heuristics/multistart/freq": -1,
}
"""Parameters that differ from SCIP's own. Bound tightening by linear programs and the search for
starting points take nearly all the time of the root node otherwise, and gain no more."""
PROVED = 1e-6
"""Relative gap at which SCIP stops."""


@dataclass(frozen=True)
class WarmStart:
    """A plan to begin with.

    Parameters
    ----------
    subset : tuple of int
        Chargers it uses.
    controls : Controls
        What the car does.
    """

    subset: tuple[int, ...]
    controls: Controls


@dataclass(frozen=True)
class ScipResult:
    """What SCIP gave.

    Parameters
    ----------
    status : str
        Its words: ``optimal``, ``gaplimit``, ``timelimit``, ``infeasible``, ...
    primal, dual : float
        Its best cost and its lower bound, fixed cost included; ``inf`` and ``-inf`` without
        one, both ``inf`` if it proved the subset infeasible [currency].
    nodes : int
        Nodes of its tree.
    started : bool
        Whether it took the plan it was given.
    subset : tuple of int
        Chargers that its plan uses; empty without a plan.
    cost : float
        Cost of its plan on the tables, after ``polish``; ``inf`` without one [currency].
    feasible : bool
        Whether that keeps all limits there.
    controls, trajectory : Controls, Trajectory or None
        The plan and what it causes on the tables.
    deviation : dict of str to float
        Largest relative distance between its maps and the tables.
    build_s, solve_s : float
        Times of writing the program and in the solver [s].
    """

    status: str
    primal: float
    dual: float
    nodes: int
    started: bool
    subset: tuple[int, ...]
    cost: float
    feasible: bool
    controls: Controls | None
    trajectory: Trajectory | None
    deviation: dict[str, float]
    build_s: float
    solve_s: float

    @property
    def gap(self) -> float:
        """Relative gap (primal - dual) / primal that SCIP proved; ``inf`` without both."""
        if self.primal == self.dual:
            return 0.0
        if not (abs(self.primal) < inf and abs(self.dual) < inf) or self.primal == 0.0:
            return inf
        return (self.primal - self.dual) / abs(self.primal)


def _start(written: ScipModel, trip: Trip, warm: WarmStart) -> bool:
    """Hand a plan to SCIP; returns whether it accepts it."""
    instance = make_instance(trip, warm.subset)
    trajectory = simulate(instance, warm.controls)
    solution = written.model.createOrigSol()
    for variable, value in point_of(written, instance.subset, trajectory):
        lo, hi = variable.getLbOriginal(), variable.getUbOriginal()
        written.model.setSolVal(solution, variable, min(max(value, lo), hi))  # rounding only
    if not written.model.checkSol(solution, printreason=False, original=True):
        return False
    return bool(written.model.addSol(solution))


def scip_solve(
    trip: Trip,
    subset: tuple[int, ...] | None = None,
    time_limit_s: float = 60.0,
    warm_start: WarmStart | None = None,
    gap: float = PROVED,
    tables: bool = False,
    settings: dict[str, Any] | None = None,
) -> ScipResult:
    """Solve a trip by SCIP, for one subset of chargers or with the choice left to it.

    Parameters
    ----------
    trip : Trip
        The trip; its grid counts.
    subset : tuple of int, optional
        Chargers to use; all subsets at once, by binary variables, without one.
    time_limit_s : float
        Wall-clock time in the solver [s].
    warm_start : WarmStart, optional
        A plan for that subset, or for any if there is a choice.
    gap : float
        Relative gap at which to stop.
    tables : bool
        Whether to write the tables kink by kink instead of short forms with margins.
    settings : dict, optional
        More parameters of SCIP by their names.

    Returns
    -------
    ScipResult
        Bounds, and the plan judged on the tables. ``dual`` is below the cost of every plan
        of the transcription, up to SCIP's feasibility tolerance of 1e-6 per row.

    Raises
    ------
    KeyboardInterrupt
        SCIP was interrupted.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from relax import load_trip
    >>> from relax.trip import Grid
    >>> trip = replace(load_trip("paper-400km"), grid=Grid(100.0, 1))
    >>> found = scip_solve(trip, (1,), time_limit_s=5.0, gap=0.05)
    >>> found.feasible, found.dual <= found.cost, found.subset
    (True, True, (1,))
    """
    begin = perf_counter()
    drive = make_drive(trip, trip.grid.step_km)
    chosen = tuple(range(len(trip.chargers))) if subset is None else subset
    instance = make_instance(trip, chosen, drive=drive)
    with quiet(errors=True):
        written = make_scip_model(instance, subset is None, 0.0 if tables else FIT_TOLERANCE)
        model = written.model
        model.hideOutput()
        model.setParam("limits/time", time_limit_s)
        model.setParam("limits/gap", gap)
        for name, setting in {**SETTINGS, **(settings or {})}.items():
            model.setParam(name, setting)
        started = warm_start is not None and _start(written, trip, warm_start)
        build_s = perf_counter() - begin
        begin = perf_counter()
        model.optimize()
        solve_s = perf_counter() - begin
    status = str(model.getStatus())
    if status == "userinterrupt":
        raise KeyboardInterrupt
    used: tuple[int, ...] = ()
    controls: Controls | None = None
    trajectory: Trajectory | None = None
    if model.getNSols() > 0:
        solution = model.getBestSol()

        def value(variable: Any) -> float:
            return float(model.getSolVal(solution, variable))

        used = tuple(instance.stops[i].charger for i in used_stops(written, value))
        own = make_instance(trip, used, drive=drive)
        controls, trajectory = polish(own, release(own, read_controls(written, value)))
    return ScipResult(
        status=status,
        primal=_finite(model, model.getPrimalbound()),
        dual=_finite(model, model.getDualbound()),
        nodes=int(model.getNTotalNodes()),
        started=started,
        subset=used,
        cost=inf if trajectory is None else trajectory.cost,
        feasible=trajectory is not None and is_feasible(trajectory),
        controls=controls,
        trajectory=trajectory,
        deviation=written.maps.deviation,
        build_s=build_s,
        solve_s=solve_s,
    )


def _finite(model: Any, bound: float) -> float:
    """Return a bound with SCIP's infinity as ours."""
    if model.isInfinity(abs(bound)):
        return inf if bound > 0.0 else -inf
    return float(bound)
