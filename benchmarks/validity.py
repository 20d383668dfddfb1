"""Does any proof ever contradict a plan? Thousands of random trips, every claim attacked.

    python -m benchmarks.validity [--trips 2000] [--seconds S] [--resume]
    python -m benchmarks.validity --seed 123        one trip, its findings in full

Per trip the search itself with a random gap, and for its subsets: the root bound, proofs with
cutoffs below, at and above the best plan known, refinements from random starts, random drives.
Nothing may contradict anything: a bound above a cost, an infeasible subset with a plan, a box
(also a tightened one) that leaves out a plan that costs less than its cutoff, a closed proof with
a plan below its cutoff, a certificate from a spoilt dual vector, a status that does not fit. One
row per trip is appended as it comes, by seed; the exit code is 1 if there was any finding.

Bounds hold for the transcription and are compared with costs of the transcription. The driven
cost of the same plan differs by the transcription's error, which is reported.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest import mock

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from benchmarks.machine import make_single_threaded, processor, versions

if __name__ == "__main__":
    make_single_threaded()

import relax.proof as proof_steps
import relax.tighten as tighten
from benchmarks.random_trips import describe, random_trip
from enumerate import Outcome, Result, Status, plan
from enumerate.gap import DEFAULT_GAP, closing_cost
from relax.bound import relax_subset
from relax.box import Box
from relax.certify import (
    Infeasible,
    LowerBound,
    certify_infeasible,
    certify_lower_bound,
)
from relax.instance import MIN_CHARGE_KWH, Instance, make_drive, make_instance
from relax.plan import Controls, StopControls, Trajectory
from relax.program import ConeProgram, add_cutoff
from relax.reach import make_box
from relax.refinement import RefineSettings, complete, merit, refine
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.simulate import Simulation, simulate
from relax.solve import SolveSettings, SolveStatus, solve_cone
from relax.starts import best_start, even_start, warm_start
from relax.trip import Trip

__all__ = ["Audit", "Effort", "Finding", "attacked", "audit_trip", "main", "summary"]

Array = npt.NDArray[np.float64]
Random = np.random.Generator

RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
STREAM = 4711
"""Mixed with every seed: the audit's own choices."""
ROUNDING = 1e-6
"""Relative excess of a bound over a cost that counts as rounding; plans meet limits to 2e-5 kWh."""
STRICT = 1e-9
"""Largest violation of a trajectory that must lie in every box [kWh, K, kW, h]."""
INSIDE_KWH = 4e-5
"""How far inside its energy limits a plan is moved to be strictly feasible [kWh]."""
BOX_TOLERANCE = 1e-6
"""How far outside a box counts as rounding [kWh, K, kW, h]."""
ROW_TOLERANCE = 1e-7
"""Violation of a scaled row by a lifted trajectory that counts as rounding."""
SOLVED = 1e-5
"""Relative error granted to the objective of a solved program where no plan is known."""


@dataclass(frozen=True)
class Effort:
    """How much is tried per trip.

    Parameters
    ----------
    subsets : int
        Subsets audited in full; the others by root bound and random drives.
    starts, drives : int
        Random starts refined and random drives tried per subset.
    plan_s, prove_s : float
        Time limits of the search and of each proof [s].
    """

    subsets: int = 3
    starts: int = 1
    drives: int = 5
    plan_s: float = 5.0
    prove_s: float = 1.0


LIGHT = Effort(subsets=1, starts=1, drives=2, plan_s=1.0, prove_s=0.25)
"""What most trips of a long campaign get."""


@dataclass(frozen=True)
class Finding:
    """Something that contradicts something.

    Parameters
    ----------
    kind : str
        Which rule is broken.
    subset : tuple of int or None
        Where.
    detail : str
        The numbers.
    """

    kind: str
    subset: tuple[int, ...] | None
    detail: str


@dataclass
class Audit:
    """What was checked of one trip and what was found.

    Parameters
    ----------
    counts : Counter of str
        How often each thing was checked.
    findings : list of Finding
        Contradictions.
    worst : float
        Least relative distance from a bound up to a cost; negative: beyond it.
    worst_kind : str
        Which bound that was.
    facts : dict
        Of the search: status, cost, bound.
    """

    counts: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)
    worst: float = inf
    worst_kind: str = ""
    facts: dict[str, Any] = field(default_factory=dict)

    def found(self, kind: str, subset: tuple[int, ...] | None, detail: str) -> None:
        """Note a contradiction."""
        self.findings.append(Finding(kind, subset, detail))

    def bound(
        self,
        kind: str,
        subset: tuple[int, ...] | None,
        bound: float,
        cost: float,
        slack: float | None = None,
    ) -> None:
        """Check that a bound does not exceed a cost; one known to ``slack`` has no margin."""
        if not (isfinite(cost) and bound > -inf):
            return
        self.counts["bounds"] += 1
        margin = (cost + (slack or 0.0) - bound) / max(abs(cost), 1.0)
        if slack is None and margin < self.worst:
            self.worst, self.worst_kind = margin, kind
        if not margin >= -ROUNDING:
            self.found(f"{kind} above a cost", subset, f"bound {bound!r}, cost {cost!r}")


# --- adversaries: controls, plans, dual vectors ------------------------------------------------


def random_controls(instance: Instance, rng: Random) -> Controls:
    """Return controls of any kind: idle, full, in bursts; the energy split at random."""
    car, n, cells = instance.vehicle, instance.drive.n_steps, instance.cells

    def powers(most: float, size: int, chance: float) -> Array:
        if rng.random() > chance:
            return np.zeros(size)
        level = most * (rng.uniform(0.0, 1.3, size) if rng.random() < 0.5 else rng.random())
        return np.where(rng.random(size) < rng.choice([0.2, 0.6, 1.0]), level, 0.0)

    need = float(instance.drive.base_kw @ instance.drive.duration_h) * rng.uniform(1.0, 1.5)
    need += instance.end_energy_min_kwh - instance.start_energy_kwh
    share = rng.dirichlet(np.full(max(len(instance.stops), 1), 0.7))
    stops = tuple(
        StopControls(
            max(float(w) * max(need, 1.0), MIN_CHARGE_KWH),
            np.where(rng.random(cells) < 0.7, np.inf, rng.uniform(3.0, 90.0, cells)),
            powers(car.heater_kw, cells, 0.5),
            powers(car.cooling_kw, cells, 0.3),
            powers(car.heat_pump_kw, cells, 0.7),
        )
        for w in share[: len(instance.stops)]
    )
    return Controls(
        powers(car.heater_kw, n, 0.5),
        powers(car.cooling_kw, n, 0.3),
        powers(car.heat_pump_kw, n, 0.7),
        stops,
    )


def strictly_feasible(instance: Instance, controls: Controls) -> Trajectory | None:
    """Return a trajectory near the controls' that keeps every limit exactly, if there is one."""
    trajectory = simulate(instance, controls)
    if float(trajectory.violation.max()) <= STRICT:
        return trajectory
    least = instance.energy_min_kwh + INSIDE_KWH
    inner = replace(
        instance,
        energy_min_kwh=least,
        end_energy_min_kwh=instance.end_energy_min_kwh + INSIDE_KWH,
        energy_max_kwh=instance.energy_max_kwh - INSIDE_KWH,
        stops=tuple(
            replace(
                s,
                arrive_min_kwh=s.arrive_min_kwh + INSIDE_KWH,
                leave_min_kwh=s.leave_min_kwh + INSIDE_KWH,
            )
            for s in instance.stops
        ),
    )
    moved, _ = complete(Simulation(inner), controls)
    trajectory = simulate(instance, moved)
    return trajectory if float(trajectory.violation.max()) <= STRICT else None


def attacked(z: Array, rng: Random) -> Iterator[tuple[str, Array]]:
    """Yield spoilt dual vectors, with their names.

    Parameters
    ----------
    z : ndarray, shape (m,)
        A solver's dual vector or ray.
    rng : Generator
        For the random ones.

    Examples
    --------
    >>> names = [name for name, _ in attacked(np.ones(4), np.random.default_rng(0))]
    >>> "permuted" in names and "not a number" in names
    True
    """
    size = float(np.abs(z[np.isfinite(z)]).max(initial=0.0)) or 1.0
    some = rng.random(z.size)
    yield "noise", z + rng.normal(size=z.size) * size * 10.0 ** rng.uniform(-9, 1)
    yield "scaled", z * 10.0 ** rng.uniform(-4, 4)
    yield "scaled row by row", z * np.exp(rng.normal(size=z.size))
    yield "huge", z * 1e80
    yield "tiny", z * 1e-180
    yield "negated", -z
    yield "signs flipped", np.where(some < 0.2, -z, z)
    yield "rows dropped", np.where(some < 0.3, 0.0, z)
    yield "permuted", rng.permutation(z)
    yield "shifted by one", np.roll(z, 1)
    yield "reversed", z[::-1].copy()
    yield "truncated", z[: z.size // 2]
    yield "too long", np.append(z, 1.0)
    yield "second half zero", np.where(np.arange(z.size) < z.size // 2, z, 0.0)
    yield "single precision", z.astype(np.float32).astype(np.float64)
    yield "half precision", np.clip(z, -6e4, 6e4).astype(np.float16).astype(np.float64)
    yield "rounded", np.round(z, 2)
    yield "one huge entry", np.where(np.arange(z.size) == int(some[0] * z.size), 1e12, z)
    yield "random", rng.normal(size=z.size) * size
    yield "ones", np.ones(z.size)
    for name, value in (("not a number", np.nan), ("infinite", np.inf)):
        spoilt = z.copy()
        spoilt[int(some[-1] * z.size)] = value
        yield name, spoilt


# --- judges ------------------------------------------------------------------------------------


def outside(box: Box, instance: Instance, trajectory: Trajectory) -> str:
    """Return the quantity by which a trajectory lies outside a box, empty if inside."""
    stops = trajectory.stops
    S, K = len(stops), instance.cells
    energy = np.array([s.energy_kwh for s in stops]).reshape(S, K + 1)
    dwell = np.array([s.dwell_h for s in stops]).reshape(S, K)
    out = np.array([s.detour_out_kwh for s in instance.stops])
    for name, value in (
        ("energy", trajectory.energy_kwh),
        ("temperature", trajectory.temperature_c),
        ("power", trajectory.power_kw),
        ("charge", energy[:, -1] - energy[:, 0]),
        ("arrive", energy[:, 0]),
        ("leave", energy[:, -1] - out),
        ("stop_temperature", np.array([s.temperature_c for s in stops]).reshape(S, K + 1)),
        ("dwell", dwell),
        ("stay", dwell.sum(axis=1)),
    ):
        interval = getattr(box, name)
        size = BOX_TOLERANCE * (1.0 + np.abs(value))
        beyond = np.maximum(interval.lo - value, value - interval.hi) - size
        if beyond.size and beyond.max() > 0.0:
            at = np.unravel_index(int(beyond.argmax()), beyond.shape)
            where = ", ".join(str(int(i)) for i in at)
            return f"{name}[{where}] by {float(beyond.max()):.3g}"
    return ""


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


@dataclass
class Known:
    """What is known of a subset: its instance, its root bound and plans anybody found.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    lower_bound : float
        Root bound, ``inf`` if proved infeasible.
    strict : list of Trajectory
        Trajectories that keep every limit exactly.
    cost : float
        Least cost of any feasible plan, what it misses limits by paid for; ``inf`` without one.
    """

    instance: Instance
    lower_bound: float = -inf
    strict: list[Trajectory] = field(default_factory=list)
    cost: float = inf

    def add(self, trajectory: Trajectory, feasible: bool) -> None:
        """Note a plan."""
        if float(trajectory.violation.max()) <= STRICT:
            self.strict.append(trajectory)
        if feasible or float(trajectory.violation.max()) <= STRICT:
            self.cost = min(self.cost, merit(self.instance, trajectory))


def _drive_at_random(known: Known, rng: Random, effort: Effort) -> None:
    """Add random drives that happen to be feasible."""
    simulation = Simulation(known.instance)
    for _ in range(effort.drives):
        controls = random_controls(known.instance, rng)
        if rng.random() < 0.7:
            controls, _ = complete(simulation, controls)
        trajectory = strictly_feasible(known.instance, controls)
        if trajectory is not None:
            known.add(trajectory, True)


def _refine_at_random(known: Known, rng: Random, effort: Effort) -> None:
    """Add refined plans from random and from sensible starts."""
    instance = known.instance
    even = even_start(instance)
    starts = [even, *(random_controls(instance, rng) for _ in range(effort.starts))]
    if instance.stops:
        starts.append(warm_start(instance, even, float(rng.uniform(5.0, 35.0)), rng.random()))
    point = relax_subset(instance).point
    starts.append(best_start(instance, point, known.lower_bound))
    for start in starts:
        refined = refine(instance, start, RefineSettings(max_programs=25))
        known.add(refined.trajectory, refined.feasible)
        if refined.feasible:
            trajectory = strictly_feasible(instance, refined.controls)
            if trajectory is not None:
                known.add(trajectory, True)


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
    for row in result.ledger.rows:
        known = Known(make_instance(trip, row.subset, trip.grid, drive))
        root = relax_subset(known.instance)
        known.lower_bound = inf if root.infeasible else root.lower_bound or -inf
        if root.lower_bound == 0.0:
            known.lower_bound = 0.0
        _drive_at_random(known, rng, effort)
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
        _refine_at_random(nodes[i], rng, effort)
    best = min(k.cost for k in nodes)
    for known, row in zip(nodes, result.ledger.rows, strict=True):
        audit.counts["trajectories"] += len(known.strict)
        _audit_root(audit, known)
        audit.bound("ledger bound", row.subset, _claimed(row), known.cost)
        if row.outcome is Outcome.INFEASIBLE and isfinite(known.cost):
            audit.found("infeasible row with a plan", row.subset, f"cost {known.cost!r}")
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


def _claimed(row: Any) -> float:
    """Return what a row claims of its plans' costs; an infeasible row is judged apart."""
    return -inf if row.outcome is Outcome.INFEASIBLE else float(row.lower_bound)


# --- the campaign ------------------------------------------------------------------------------

CHECKS = (
    "subsets", "plans", "trajectories", "infeasible", "bounds", "boxes", "rows", "tightened",
    "proofs", "closed", "programs", "attacks", "driven_below_bound",
)  # fmt: skip
"""What is counted."""
FACTS = ("chargers", "steps", "cells", "status", "cost", "lower_bound", "replay_error")
COLUMNS = ("seed", *FACTS, *CHECKS, "worst_margin", "worst_kind", "findings", "first", "seconds")
"""Columns of the result file."""


def _row(seed: int, audit: Audit, seconds: float) -> dict[str, Any]:
    first = audit.findings[0] if audit.findings else None

    def short(value: Any) -> Any:
        return f"{value:.6g}" if isinstance(value, float) else value

    return {
        "seed": seed,
        **{k: short(audit.facts.get(k, "")) for k in FACTS},
        **{k: audit.counts[k] for k in CHECKS},
        "worst_margin": short(audit.worst),
        "worst_kind": audit.worst_kind,
        "findings": len(audit.findings),
        "first": "" if first is None else f"{first.kind} {first.subset}: {first.detail}",
        "seconds": f"{seconds:.2f}",
    }


def summary(rows: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Return counts, the worst margin and the seeds with findings.

    Parameters
    ----------
    rows : iterable of dict
        As in the result file; strings or numbers.

    Examples
    --------
    >>> row = _row(46, audit_trip(46, Effort(subsets=1, starts=0, drives=1)), 0.1)
    >>> summary([row])["trips"], summary([row])["findings"]
    (1, 0)
    """
    rows = list(rows)
    worst = min(rows, key=lambda r: float(r["worst_margin"]), default=None)
    bad = [r for r in rows if int(r["findings"])]
    errors = [abs(float(r["replay_error"])) for r in rows if r["replay_error"] not in ("", None)]
    return {
        "trips": len(rows),
        "findings": sum(int(r["findings"]) for r in bad),
        "seeds_with_findings": [int(r["seed"]) for r in bad],
        "first_findings": [r["first"] for r in bad[:20]],
        "worst_margin": None if worst is None else float(worst["worst_margin"]),
        "worst_kind": None if worst is None else worst["worst_kind"],
        "worst_seed": None if worst is None else int(worst["seed"]),
        "status": dict(Counter(str(r["status"]) for r in rows)),
        "checks": {k: sum(int(r[k]) for r in rows) for k in CHECKS},
        "replay_error_median": float(np.median(errors)) if errors else None,
        "replay_error_largest": max(errors, default=None),
        "seconds": round(sum(float(r["seconds"]) for r in rows), 1),
    }


def _read(file: Path) -> list[dict[str, Any]]:
    """Return the complete rows of a file; a row cut short by a kill is dropped."""
    with file.open(newline="", encoding="utf-8") as stream:
        rows = [dict(row) for row in csv.DictReader(stream)]
    return [r for r in rows if tuple(r) == COLUMNS and all(v is not None for v in r.values())]


def _tell(seed: int, audit: Audit) -> None:
    for finding in audit.findings:
        tqdm.write(
            f"seed {seed}: {finding.kind}, subset {finding.subset}: {finding.detail}\n"
            f"    again: python -m benchmarks.validity --seed {seed}",
            file=sys.stderr,
        )


def main(arguments: list[str] | None = None) -> int:
    """Run the campaign; returns the exit code: 0 nothing found, 1 a finding, 130 interrupted."""
    parser = argparse.ArgumentParser(prog="benchmarks.validity", description=__doc__)
    parser.add_argument("--trips", type=int, default=2000, help="seeds 0 to TRIPS - 1")
    parser.add_argument("--first", type=int, default=0, help="begin with this seed")
    parser.add_argument("--seconds", type=float, default=inf, help="stop after this long")
    parser.add_argument("--resume", action="store_true", help="keep the rows already in the file")
    parser.add_argument("--seed", type=int, help="one trip only, nothing is written")
    parser.add_argument(
        "--full-every", type=int, default=1, help="full effort for every so many trips only"
    )
    parser.add_argument("--file", type=Path, default=RESULTS / "validity.csv")
    options = parser.parse_args(arguments)
    if options.seed is not None:
        print(describe(random_trip(options.seed)))
        audit = audit_trip(options.seed)
        _tell(options.seed, audit)
        print(json.dumps(audit.facts | dict(audit.counts), default=float))
        print(f"worst margin {audit.worst:.3g} ({audit.worst_kind})")
        return int(bool(audit.findings))
    file = options.file
    rows = _read(file) if options.resume and file.is_file() else []
    done = {int(r["seed"]) for r in rows}
    todo = [s for s in range(options.first, options.first + options.trips) if s not in done]
    begin, interrupted = perf_counter(), False
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        bar = tqdm(todo, file=sys.stderr, desc="validity", disable=None)
        try:
            for seed in bar:
                if perf_counter() - begin > options.seconds:
                    break
                start = perf_counter()
                audit = audit_trip(seed, Effort() if seed % options.full_every == 0 else LIGHT)
                row = _row(seed, audit, perf_counter() - start)
                writer.writerow(row)
                stream.flush()
                rows.append(row)
                _tell(seed, audit)
        except KeyboardInterrupt:
            interrupted = True
    total = summary(rows) | {"processor": processor(), "versions": versions()}
    file.with_suffix(".json").write_text(json.dumps(total, indent=2) + "\n", encoding="utf-8")
    print(json.dumps({k: v for k, v in total.items() if k not in ("versions",)}, indent=2))
    return 130 if interrupted else int(total["findings"] > 0)


if __name__ == "__main__":
    sys.exit(main())
