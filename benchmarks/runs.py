"""Owns how each solver is called: one function per solver, all returning the same value.

An answer is what a solver claims, with the controls to check it by; nothing in it is verified
here (``judge`` does that). Peers are imported when they are run, so that a missing one harms
nobody.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from time import perf_counter
from typing import Any

from benchmarks.probe import PARTS, watch
from enumerate import plan
from enumerate.explore import Progress
from enumerate.result import Status
from relax.plan import Controls
from relax.trip import Trip

__all__ = [
    "ASKED_GAP",
    "TIME_LIMIT",
    "Answer",
    "Limits",
    "run_bonmin",
    "run_driver",
    "run_dynamic",
    "run_enumerated",
    "run_ours",
    "run_scip",
]

EXECUTE = "relax.execute.execute"
TIME_LIMIT = "time limit"
"""Said by an enumeration that did not get to its end."""
ASKED_GAP = 0.01
"""Relative gap that who gives bounds is asked to prove."""
Trace = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Limits:
    """What a run may take.

    Parameters
    ----------
    time_s : float
        Time limit of solvers that have one [s].
    our_time_s : float
        Our certified time on the same case, for who is compared at that moment [s].
    """

    time_s: float = 120.0
    our_time_s: float = inf


@dataclass(frozen=True)
class Answer:
    """What a solver claims.

    Parameters
    ----------
    subset : tuple of int
        Chargers used.
    controls : Controls or None
        The plan; None without one.
    claimed_cost : float
        Cost as the solver has it, ``inf`` without a plan [currency].
    targets_kwh : tuple of float or None
        Internal energy at which each stop ends, if the solver says so [kWh].
    lower_bound : float
        ``-inf`` from who has none [currency].
    claims_infeasible : bool
        The solver says that there is no plan.
    build_s, solve_s, judge_s : float
        Writing programs, solving them, correcting and judging on the way [s].
    subsets, programs : int
        Choices of stops looked at, and programs solved.
    message : str
        The solver's words.
    trace : tuple of (float, float, float)
        Elapsed time [s], cost and bound at that moment.
    """

    subset: tuple[int, ...] = ()
    controls: Controls | None = None
    claimed_cost: float = inf
    targets_kwh: tuple[float, ...] | None = None
    lower_bound: float = -inf
    claims_infeasible: bool = False
    build_s: float = 0.0
    solve_s: float = 0.0
    judge_s: float = 0.0
    subsets: int = 0
    programs: int = 0
    message: str = ""
    trace: Trace = ()


def run_ours(trip: Trip, limits: Limits, gap: float | None) -> Answer:
    """Plan with evrelax; its controls are those that it drove itself."""
    trace: list[tuple[float, float, float]] = []
    begin = perf_counter()

    def note(progress: Progress) -> None:
        now = (perf_counter() - begin, progress.cost, progress.lower_bound)
        if not trace or trace[-1][1:] != now[1:]:
            trace.append(now)

    with watch((*PARTS["solve"], EXECUTE), keep=(EXECUTE,)) as probe:
        result = plan(trip, gap=gap, time_limit_s=limits.time_s, progress=note)
    spent = perf_counter() - begin
    trace.append((spent, result.cost, result.lower_bound))
    solve_s = sum(probe.own_s[name] for name in PARTS["solve"])
    answer = Answer(
        lower_bound=result.lower_bound,
        claims_infeasible=result.status is Status.INFEASIBLE,
        build_s=spent - solve_s,
        solve_s=solve_s,
        subsets=len(result.ledger.rows),
        programs=probe.programs,
        message=result.status.value + (f", {result.interrupted}" if result.interrupted else ""),
        trace=tuple(trace),
    )
    if result.plan is None:
        return answer
    ((_, instance, *_), done) = next(
        call for call in probe.kept[EXECUTE] if call[1].replay is result.replay
    )
    return _with_plan(
        answer,
        subset=tuple(stop.charger for stop in instance.stops),
        controls=done.controls,
        targets_kwh=done.targets_kwh,
        claimed_cost=result.cost,
    )


def _with_plan(answer: Answer, **entries: Any) -> Answer:
    return Answer(**(vars(answer) | entries))


# ------------------------------------------------------------------ nonlinear programs, enumerated


def run_enumerated(
    trip: Trip, limits: Limits, solver: str, multi_start: bool, integrator: str
) -> Answer:
    """IPOPT or FATROP over all choices of stops, few stops first, until the time limit."""
    from benchmarks.reference.peer import CAREFUL, FAST
    from benchmarks.reference.search import reference_best

    trace: list[tuple[float, float, float]] = []
    begin = perf_counter()

    def note(row: Mapping[str, Any]) -> None:
        best = trace[-1][1] if trace else inf
        if row["feasible"] and row["cost"] < best:
            trace.append((perf_counter() - begin, float(row["cost"]), -inf))

    settings = CAREFUL if multi_start else FAST
    found = reference_best(
        trip, solver, multi_start, progress=note, settings=settings, integrator=integrator,
        time_limit_s=limits.time_s,
    )  # fmt: skip
    best = found.best
    return Answer(
        subset=found.best_subset,
        controls=None if best is None else best.controls,
        claimed_cost=inf if best is None else best.claimed_cost,
        build_s=found.build_s,
        solve_s=found.solve_s,
        judge_s=found.judge_s,
        subsets=2 ** len(trip.chargers) - found.left,
        programs=len(found.rows),
        message=f"{sum(not row['feasible'] for row in found.rows)} solves failed"
        + (f", {TIME_LIMIT} with {found.left} choices left" if found.left else ""),
        trace=tuple(trace),
    )


# --------------------------------------------------------------------------------- other peers


def run_bonmin(trip: Trip, limits: Limits, integrator: str) -> Answer:
    """Plan with BONMIN: one program with binaries."""
    from benchmarks.reference.bonmin import bonmin_best

    found = bonmin_best(trip, time_limit_s=limits.time_s, integrator=integrator)
    run = found.run
    return Answer(
        subset=found.subset,
        controls=None if run is None else run.controls,
        claimed_cost=inf if run is None else run.claimed_cost,
        build_s=found.build_s,
        solve_s=found.solve_s,
        judge_s=0.0 if run is None else run.judge_s,
        subsets=2 ** len(trip.chargers),
        programs=1,
        message=found.status,
    )


def run_scip(trip: Trip, limits: Limits, ours: bool) -> Answer:
    """Plan with SCIP, the choice of stops left to it; its time is the limit's or ours."""
    from benchmarks.reference.scip import scip_solve

    limit = limits.our_time_s if ours else limits.time_s
    found = scip_solve(trip, None, time_limit_s=limit, gap=ASKED_GAP)
    return Answer(
        subset=tuple(found.subset or ()),
        controls=found.controls,
        claimed_cost=found.primal,
        lower_bound=-inf if found.dual == inf else found.dual,
        claims_infeasible=found.dual == inf,
        build_s=found.build_s,
        solve_s=found.solve_s,
        subsets=2 ** len(trip.chargers),
        programs=1,
        message=f"{found.status}, {found.nodes} nodes",
    )


def run_dynamic(trip: Trip, limits: Limits) -> Answer:
    """Plan by dynamic programming on three meshes; the claim is the extrapolated value."""
    from benchmarks.reference.dynamic import dynamic_best

    found = dynamic_best(trip)
    return Answer(
        subset=found.subset,
        controls=found.controls,
        claimed_cost=found.extrapolated,
        claims_infeasible=False,  # no plan on a grid of states is no proof
        solve_s=sum(found.seconds),
        judge_s=found.judge_s,
        subsets=2 ** len(trip.chargers),
        programs=len(found.seconds),
        message=f"grid error {found.error:.3g}",
    )


def run_driver(trip: Trip, limits: Limits, rules: str) -> Answer:
    """Drive by rules; a driver who does not arrive has no plan."""
    from benchmarks.reference import driver

    begin = perf_counter()
    found = driver.drive_by_rules(trip, getattr(driver, rules))
    return Answer(
        subset=found.subset,
        controls=None if found.reason else found.controls,  # nothing of a driver is repaired
        claimed_cost=found.cost,
        solve_s=perf_counter() - begin,
        subsets=1,
        message=found.reason,
    )
