"""Owns the call that plans a trip: what is asked, the phases in their order, and the sum of it all.

The search itself is ``explore``'s. Knows no solver.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from math import inf
from typing import Literal

from enumerate.diagnose import diagnose
from enumerate.evidence import StageProof
from enumerate.explore import FEW_CHARGERS, Progress, Search
from enumerate.gap import DEFAULT_GAP, closing_cost, is_proved
from enumerate.ledger import Ledger, Outcome
from enumerate.phases import REPLAY, run_phases
from enumerate.pool import open_pool
from enumerate.proving import prove
from enumerate.result import Result, Status
from enumerate.tasks import Setting
from relax.instance import make_drive
from relax.refinement import RefineSettings
from relax.report import make_report
from relax.trip import Grid, Trip

__all__ = ["MAX_CHARGERS", "MAX_PLANNED", "plan"]

MAX_CHARGERS = 64
"""More chargers than this are refused."""
MAX_PLANNED = 10
"""Up to this many chargers all subsets can be planned (``prune=False``)."""
GRACE, GRACE_S = 1.25, 1.0
"""A plan or a reason that is being looked for when time is up may take this multiple of the time
allowed and so much more [s]: little, for an answer instead of none."""


def plan(
    trip: Trip,
    *,
    gap: float | None = None,
    time_limit_s: float | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    solver: Literal["clarabel", "osqp"] = "clarabel",
    grid: Grid | None = None,
    prune: bool = True,
    progress: Callable[[Progress], None] | None = None,
    keep_proofs: bool = False,
) -> Result:
    """Plan a trip: stops, charging, heating and cooling, with a bound on what any plan costs.

    Parameters
    ----------
    trip : Trip
        From ``load_trip``.
    gap : float, optional
        Relative gap to prove: boxes of every subset that could be better are tightened
        and split until no plan can be cheaper by more than this; without a plan, until
        one is found or none is left possible. Without a gap only the root bounds are
        computed, which is fast, and the gap is whatever they give.
    time_limit_s : float, optional
        Wall-clock limit; the best plan and bound at that moment are returned [s].
    workers : int
        Processes over subsets and leaves (threads where processes cannot be forked); 1 runs
        everything here.
    executor : Executor, optional
        Any ``concurrent.futures.Executor`` instead, for example processes.
    solver : {"clarabel", "osqp"}
        Solver of the quadratic programs. OSQP is less accurate, see ``docs/refinement.md``.
    grid : Grid, optional
        Other steps and cells than the trip's.
    prune : bool
        Skip subsets whose bound shows that they cannot be better; False plans them all.
    progress : callable, optional
        Called with a ``Progress`` after every subset or leaf.
    keep_proofs : bool
        Keep the dual vectors of all bounds in ``result.proofs``, to be written and audited.

    Returns
    -------
    Result
        The same for any number of workers, timings aside. Ctrl-C and the time
        limit return what is known by then, with ``interrupted`` set.

    Raises
    ------
    ValueError
        More than 64 chargers, or 10 with ``prune=False``; a gap not above 0 and below 1; a
        time limit below 0, or no worker.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip
    >>> result = plan(load_trip("paper-400km", overrides={"route.ambient_c": 10}))
    >>> result.replay.feasible, result.lower_bound <= result.cost
    (True, True)
    """
    begin = time.perf_counter()
    n_chargers = len(trip.chargers)
    if n_chargers > MAX_CHARGERS:
        raise ValueError(f"at most {MAX_CHARGERS} chargers, not {n_chargers}")
    if not prune and n_chargers > MAX_PLANNED:
        raise ValueError(f"all subsets of at most {MAX_PLANNED} chargers are planned")
    if gap is not None and not 0.0 < gap < 1.0:
        raise ValueError(f"gap must be above 0 and below 1, not {gap}")
    if time_limit_s is not None and not time_limit_s >= 0.0:
        raise ValueError(f"time_limit_s must not be below 0, not {time_limit_s}")
    grid = grid or trip.grid
    allowed = inf if time_limit_s is None else time_limit_s
    refinement = RefineSettings(solver=solver, deadline=begin + GRACE * allowed + GRACE_S)
    setting = Setting(trip, make_drive(trip, grid.step_km), grid, refinement)
    with open_pool(workers, executor) as pool:
        search = Search(
            setting,
            pool,
            begin + allowed,
            progress,
            single=not prune or n_chargers <= FEW_CHARGERS,
            keep_proofs=keep_proofs,
        )
        phases: list[tuple[str, Callable[[], None]]] = [
            ("relax", lambda: search.relax(prune)),
            ("refine", lambda: search.refine(prune)),
            (REPLAY, search.drive_or_rescue),
        ]
        if gap is not None:
            phases.append(("prove", lambda: prove(search, gap)))
        timings = run_phases(search, phases, begin)
    return _result(search, gap, timings, begin)


def _result(search: Search, gap: float | None, timings: dict[str, float], begin: float) -> Result:
    """Sum up a finished or interrupted search."""
    trip, done, account = search.setting.trip, search.road.execution, search.account
    report, replayed, instance, cost = None, None, None, inf
    if done is not None and done.replay is not None and search.road.node is not None:
        instance = search.setting.instance(search.road.node.row.subset)
        report = make_report(trip, instance, done)
        replayed, cost = done.replay, done.replay.cost
    enough = DEFAULT_GAP if gap is None else gap
    closing = inf if done is None else closing_cost(cost, enough, done.trajectory.cost)
    rows = account.rows({s: n.row for s, n in search.nodes.items()}, closing)
    ledger = Ledger(len(trip.chargers), tuple(rows))
    status = Status.UNKNOWN
    if done is not None and report is not None:
        within = is_proved(cost, done.trajectory.cost, ledger.lower_bound, enough)
        status = Status.OPTIMAL if within else Status.FEASIBLE
    elif all(row.outcome is Outcome.INFEASIBLE for row in ledger.rows):
        status = Status.INFEASIBLE
    settled = report is None and not search.interrupted
    diagnosis = None
    if settled:
        try:
            diagnosis = diagnose(trip, search.setting.drive, search.setting.refine.deadline)
        except KeyboardInterrupt:
            pass  # what is proved is worth more than the reason
    timings["total"] = time.perf_counter() - begin
    return Result(
        trip=trip.name,
        currency=trip.currency,
        status=status,
        cost=cost,
        transcribed_cost=inf if done is None else done.trajectory.cost,
        lower_bound=ledger.lower_bound,
        plan=report,
        replay=replayed,
        ledger=ledger,
        programs=account.programs + sum(n.row.programs for n in search.nodes.values()),
        proofs=tuple(account.proofs),
        chargers=tuple(c.name for c in trip.chargers),
        timings_s=timings,
        asked_gap=gap,
        interrupted=search.interrupted,
        diagnosis=diagnosis,
        grid=search.setting.grid,
        instance=instance,
        execution=None if report is None else done,
        stages=StageProof(account.stage_closing, account.stages, account.stage_bound)
        if account.stages
        else None,
    )
