"""Owns what is done against the claims made of one random trip, and who wins.

The search itself, root bounds, boxes and rows, proofs with cutoffs below, at and above
the best plan known, proofs over stages, the certifier: each claim is held against the plans
and vectors of ``rivals``. Knows nothing of campaigns and files.
"""

from __future__ import annotations

import json
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations
from math import inf, isfinite
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest import mock

import numpy as np

import relax.proof as proof_steps
import relax.tighten as tighten
from benchmarks.contradiction import ROUNDING, Audit, Effort, outside
from benchmarks.random_trips import random_trip
from benchmarks.rivals import Known, attacked, drive_at_random, refine_at_random
from benchmarks.stage_claims import audit_stages
from enumerate import Outcome, Result, Status, plan
from enumerate.gap import DEFAULT_GAP, closing_cost
from enumerate.ledger import Row
from relax.bound import relax_subset
from relax.box import Box
from relax.certify import (
    Infeasible,
    LowerBound,
    certify_infeasible,
    certify_lower_bound,
)
from relax.instance import Instance, make_drive, make_instance
from relax.program import ConeProgram, add_cutoff
from relax.reach import make_box
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.solve import SolveSettings, SolveStatus, solve_cone
from relax.trip import Trip

__all__ = ["audit_trip"]

Random = np.random.Generator

STREAM = 4711
"""Mixed with every seed: the audit's own choices."""
ROW_TOLERANCE = 1e-7
"""Violation of a scaled row by a lifted trajectory that counts as rounding."""
MEMBERS = 2
"""Subsets audited of each family that one row of the ledger speaks of."""
SOLVED = 1e-5
"""Relative error granted to the objective of a solved program where no plan is known."""


@contextmanager
def boxes_of_tightening() -> Iterator[list[Box]]:
    """Collect every box that a proof builds a program on or propagates."""
    seen: list[Box] = []

    def watched(function: Any) -> Any:
        def call(instance: Instance, box: Box, *more: Any, **named: Any) -> Any:
            seen.append(box)
            result = function(instance, box, *more, **named)
            if isinstance(result, Box):
                seen.append(result)
            return result

        return call

    names = ("build_relaxation", "propagate")
    patches = [mock.patch.object(proof_steps, n, watched(getattr(proof_steps, n))) for n in names]
    for patch in patches:
        patch.start()
    try:
        yield seen
    finally:
        for patch in patches:
            patch.stop()


def _audit_root(audit: Audit, known: Known) -> None:
    """Check root bound, root box and root rows against the plans."""
    instance, name = known.instance, known.instance.subset
    box = make_box(instance)
    program = None if box.empty else build_relaxation(instance, box)
    if known.lower_bound == inf:
        audit.counts["infeasible"] += 1
        if isfinite(known.cost):
            audit.found("root infeasible with a plan", name, f"cost {known.cost!r}")
    else:
        audit.bound("root bound", name, known.lower_bound, known.cost)
    for trajectory in known.strict:
        audit.counts["boxes"] += 1
        if program is None:
            audit.found("empty box with a plan", name, f"{box.empty}, cost {trajectory.cost!r}")
            continue
        if left := outside(box, instance, trajectory):
            audit.found("plan outside the root box", name, left)
            continue
        x = lift(instance, program, trajectory)
        slack = program.slack(x)
        audit.counts["rows"] += slack.size
        if slack.min(initial=0.0) < -ROW_TOLERANCE:
            rows = {k: float(slack[i].min()) for k, i in program.rows.items() if slack[i].size}
            worst = min(rows, key=lambda k: rows[k])
            audit.found("plan breaks a row", name, f"{worst} by {-rows[worst]:.3g}")
        value = float(program.q @ x) + program.constant
        if abs(value - trajectory.cost) > 1e-8 * max(1.0, abs(value)):
            audit.found("lifted cost differs", name, f"{value!r}, {trajectory.cost!r}")


def _audit_proofs(audit: Audit, known: Known, best: float, rng: Random, effort: Effort) -> None:
    """Check proofs with cutoffs below, at and above the best plan."""
    instance, name, cost = known.instance, known.instance.subset, known.cost
    unit = max(abs(cost), 1.0) if isfinite(cost) else 1.0
    if not isfinite(cost):
        cutoffs = [("of the search", best)] if isfinite(best) else []
    else:
        cutoffs = [
            [("of the search", best)],
            [("at", cost)],
            [("below", cost - unit * float(10.0 ** rng.uniform(-4, -0.5)))],
        ][int(rng.integers(3))]
        cutoffs.append(("above", cost + unit * float(10.0 ** rng.uniform(-4, -1))))
    for where, cutoff in cutoffs:
        one = where == "above" and rng.random() < 0.7
        bound = known.lower_bound if rng.random() < 0.5 else -inf
        with boxes_of_tightening() as boxes:
            proof = tighten.prove(
                instance,
                cutoff,
                bound=bound,
                max_boxes=1 if one else int(rng.integers(2, 8)),
                deadline=perf_counter() + effort.prove_s,
            )
        audit.counts["proofs"] += 1
        audit.counts["closed"] += proof.closed
        audit.counts["programs"] += proof.programs
        # a closed subset may hold plans that cost the cutoff or more
        audit.bound(f"proof {where}", name, proof.lower_bound, cost)
        if proof.closed and cutoff > cost + ROUNDING * unit:
            audit.found("closed with a plan below", name, f"cutoff {cutoff!r}, cost {cost!r}")
        if proof.closed and proof.lower_bound < cutoff - ROUNDING * unit:
            audit.found("closed below its cutoff", name, f"{proof.lower_bound!r} < {cutoff!r}")
        if not one:
            continue
        cheap = [t for t in known.strict if t.cost < cutoff - ROUNDING * unit]
        for box in boxes:  # no branching: each box keeps every plan below the cutoff
            for trajectory in cheap:
                audit.counts["tightened"] += 1
                if left := outside(box, instance, trajectory):
                    text = f"{left}, cost {trajectory.cost!r}, cutoff {cutoff!r}"
                    audit.found("plan outside a tightened box", name, text)
                    break


def _audit_certifier(audit: Audit, known: Known, rng: Random) -> None:
    """Attack the certifier with spoilt dual vectors of the subset's programs."""
    instance, name = known.instance, known.instance.subset
    box = make_box(instance)
    if box.empty:
        return
    root = build_relaxation(instance, box)
    programs = [root]
    if known.strict:
        cheapest = min(t.cost for t in known.strict)
        programs.append(add_cutoff(root, cheapest + 0.02 * max(abs(cheapest), 1.0)))
    for program in programs:
        ceiling, slack = _optimum_at_most(program, known)
        found = solve_cone(program, SolveSettings(tolerance=float(10.0 ** rng.uniform(-8, -2))))
        for kind, z in (("as solved", found.z), *attacked(found.z, rng)):
            audit.counts["attacks"] += 1
            bound = certify_lower_bound(program, z)
            if isinstance(bound, LowerBound):
                if np.isnan(bound.value):
                    audit.found("bound is not a number", name, kind)
                audit.bound(f"attack {kind}", name, bound.value, ceiling, slack)
            if kind in ("truncated", "too long", "not a number", "infinite") and isinstance(
                bound, LowerBound
            ):
                audit.found("unusable vector accepted", name, kind)
            if isfinite(ceiling) and isinstance(certify_infeasible(program, z), Infeasible):
                audit.found("infeasible claimed of a feasible program", name, kind)


def _optimum_at_most(program: ConeProgram, known: Known) -> tuple[float, float]:
    """Return a cost that some point of the program has, and how well it is known."""
    if known.strict:
        return min(t.cost for t in known.strict), 0.0
    found = solve_cone(program, SolveSettings(tolerance=1e-8))
    if found.status is not SolveStatus.SOLVED:
        return inf, 0.0
    value = found.objective + program.constant
    return value, SOLVED * max(abs(value), 1.0)


def _audit_result(audit: Audit, trip: Trip, result: Result, gap: float | None) -> None:
    """Check that status, plan, ledger and bound of a search fit together."""
    counts = result.ledger.counts()
    total = sum(v for k, v in counts.items() if k != "total")
    if not counts["total"] == total == 2 ** len(trip.chargers):
        audit.found("ledger does not add up", None, str(counts))
    has_plan = result.plan is not None
    wrong = ""
    if has_plan != (result.status in (Status.OPTIMAL, Status.FEASIBLE)):
        wrong = f"plan {has_plan}"
    elif has_plan and (result.replay is None or not result.replay.feasible):
        wrong = "the replay of the plan is not feasible"
    elif has_plan and result.replay is not None and result.replay.cost != result.cost:
        wrong = f"cost {result.cost!r} is not the replay's {result.replay.cost!r}"
    elif not has_plan and isfinite(result.cost):
        wrong = f"cost {result.cost!r} without a plan"
    elif (result.status is Status.INFEASIBLE) != (counts["infeasible"] == counts["total"]):
        wrong = f"{counts['infeasible']} of {counts['total']} rows infeasible"
    elif (result.status is Status.OPTIMAL) and result.gap > (gap or 0.01) * (1.0 + 1e-6):
        wrong = f"gap {result.gap!r}, asked {gap!r}"
    if wrong:
        audit.found("status does not fit", None, f"{result.status.value}: {wrong}")
    if result.lower_bound != min(r.lower_bound for r in result.ledger.rows):
        rows = [r.lower_bound for r in result.ledger.rows]
        audit.found("bound is not the ledger's", None, f"{result.lower_bound!r} of {rows}")
    json.dumps(result.to_dict(), allow_nan=False)
    if has_plan:
        unit = max(abs(result.cost), 1.0)
        error = (result.cost - result.transcribed_cost) / unit
        audit.facts["replay_error"] = error
        audit.bound("search bound", None, result.lower_bound, result.transcribed_cost)
        if result.lower_bound > result.cost:
            audit.counts["driven_below_bound"] += 1
            # no more than the transcription's own error of this very plan, or it is no error
            if result.lower_bound > result.cost + max(abs(error), ROUNDING) * unit * (1 + 1e-6):
                audit.found("bound above the drive", None, f"{result.lower_bound}, {result.cost}")


def audit_trip(seed: int, effort: Effort | None = None) -> Audit:
    """Audit everything that is claimed of a random trip.

    Parameters
    ----------
    seed : int
        Of the trip, and of the audit's own choices.
    effort : Effort, optional
        How much is tried.

    Returns
    -------
    Audit
        ``findings`` is empty if nothing contradicts anything.

    Examples
    --------
    >>> audit_trip(46, Effort(subsets=1, starts=0, drives=1)).findings
    []
    """
    effort, audit = effort or Effort(), Audit()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            _audit_trip(audit, seed, effort)
    except Exception as error:  # the campaign goes on and reports it
        trace = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(trace.filename).name}:{trace.lineno}"
        audit.found("exception", None, f"{type(error).__name__} at {where}: {error}")
    return audit


def _audit_trip(audit: Audit, seed: int, effort: Effort) -> None:
    rng = np.random.default_rng([STREAM, seed])
    trip = random_trip(seed)
    drive = make_drive(trip, trip.grid.step_km)
    gap = [None, 0.1, 0.02, 0.005][int(rng.integers(4))]
    result = plan(trip, gap=gap, time_limit_s=effort.plan_s)
    audit.counts["subsets"] = len(result.ledger.rows)
    audit.facts |= {
        "chargers": len(trip.chargers),
        "steps": drive.n_steps,
        "cells": trip.grid.cells,
        "status": result.status.value,
        "cost": result.cost,
        "lower_bound": result.lower_bound,
    }
    _audit_result(audit, trip, result, gap)

    nodes: list[Known] = []
    for subset, row in _subsets(audit, trip, result, rng):
        known = Known(make_instance(trip, subset, trip.grid, drive))
        root = relax_subset(known.instance)
        known.lower_bound = inf if root.infeasible else root.lower_bound or -inf
        if root.lower_bound == 0.0:
            known.lower_bound = 0.0
        drive_at_random(known, rng, effort)
        if isfinite(row.cost):
            known.cost = min(known.cost, row.cost)
            audit.counts["plans"] += 1
        nodes.append(known)
    open_ = [i for i, k in enumerate(nodes) if k.lower_bound < inf]
    order = [int(i) for i in rng.permutation(open_)] + [
        i for i, k in enumerate(nodes) if k.lower_bound == inf
    ]
    chosen = order[: effort.subsets]
    for i in chosen:
        refine_at_random(nodes[i], rng, effort)
    best = min(k.cost for k in nodes)
    for known in nodes:
        audit.counts["trajectories"] += len(known.strict)
        _audit_root(audit, known)
    for row in result.ledger.rows:
        for known in (k for k in nodes if row.holds(k.instance.subset)):
            name = known.instance.subset
            audit.bound("ledger bound", name, _claimed(row), known.cost)
            if row.outcome is Outcome.INFEASIBLE and isfinite(known.cost):
                audit.found("infeasible row with a plan", name, f"cost {known.cost!r}")
        if row.outcome is Outcome.BOUNDED and isfinite(result.cost):
            closing = closing_cost(result.cost, gap or DEFAULT_GAP, result.transcribed_cost)
            limit = min(result.transcribed_cost, closing)
            if row.lower_bound < limit - ROUNDING * max(abs(limit), 1.0):
                audit.found("bounded below the plan", row.subset, f"{row.lower_bound}, {limit}")
    audit.bound("search bound", None, result.lower_bound, best)
    for i in chosen:
        _audit_proofs(audit, nodes[i], best, rng, effort)
    if chosen:
        _audit_certifier(audit, nodes[chosen[0]], rng)
    audit_stages(audit, trip, drive, nodes, rng, effort)


def _subsets(
    audit: Audit, trip: Trip, result: Result, rng: Random
) -> Iterator[tuple[tuple[int, ...], Row]]:
    """Yield subsets to audit with the rows that speak of them; of a family some at random."""
    n = len(trip.chargers)
    every = [s for k in range(n + 1) for s in combinations(range(n), k)]
    for subset in every:
        if (times := sum(row.holds(subset) for row in result.ledger.rows)) != 1:
            audit.found("subset not in one row", subset, f"in {times}")
    for row in result.ledger.rows:
        held = [s for s in every if row.holds(s)]
        for i in rng.permutation(len(held))[:MEMBERS] if len(held) > 1 else range(len(held)):
            yield held[i], row


def _claimed(row: Row) -> float:
    """Return what a row claims of its plans' costs; an infeasible row is judged apart."""
    return -inf if row.outcome is Outcome.INFEASIBLE else float(row.lower_bound)
