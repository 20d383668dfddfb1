"""Owns the enumeration of a nonlinear peer: every subset, one or many starts, the best plan kept.

No bound prunes anything, for a local solver gives none; a subset is skipped
only when no charge level can carry the car over its gaps. Knows nothing of
our own solver.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.reference.peer import FAST, PeerSettings, Run, build_peer, solve_peer
from benchmarks.reference.stages import make_stages
from benchmarks.reference.starts import single_start, starts
from relax.instance import Instance, make_drive, make_instance
from relax.trip import Trip

__all__ = ["Reference", "all_subsets", "is_out_of_reach", "reference_best"]

MAX_FAILURES = 3
"""A subset is given up when so many starts fail before the first succeeds."""


@dataclass(frozen=True)
class Reference:
    """The best plan of a peer, and what every subset and start gave.

    Parameters
    ----------
    solver : str
        The peer.
    best : Run or None
        The cheapest plan that keeps all limits on the tables.
    best_subset : tuple of int
        Its stops; empty without a plan.
    rows : tuple of dict
        One per solve: subset, start, status, costs, times.
    build_s, solve_s, judge_s : float
        Sums over all subsets [s].
    left : int
        Subsets, large ones, that the time limit left out.
    """

    solver: str
    best: Run | None
    best_subset: tuple[int, ...]
    rows: tuple[dict[str, Any], ...]
    build_s: float
    solve_s: float
    judge_s: float
    left: int = 0


def all_subsets(count: int) -> list[tuple[int, ...]]:
    """Return all subsets of ``count`` chargers, small ones first.

    Examples
    --------
    >>> all_subsets(2)
    [(), (0,), (1,), (0, 1)]
    """
    return list(chain.from_iterable(combinations(range(count), k) for k in range(count + 1)))


def is_out_of_reach(instance: Instance) -> bool:
    """Return whether even lossless driving from full batteries, or the detours, take too much.

    No false alarms.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> [is_out_of_reach(make_instance(trip, s)) for s in ((), (1,))]
    [True, False]
    """
    car, drive = instance.vehicle, instance.drive
    if instance.stops and instance.total_dwell_h <= 0.0:
        return True
    cop = float(car.heat_pump_cop.f.max())
    pump = np.minimum(car.heat_pump_kw, drive.cabin_heat_kw / cop)
    cabin = np.minimum(
        drive.cabin_heat_kw / car.heater_cabin_efficiency,
        pump + (drive.cabin_heat_kw - cop * pump) / car.heater_cabin_efficiency,
    )
    least = drive.duration_h * (drive.base_kw + cabin)
    energy = instance.start_energy_kwh
    for k in range(drive.n_steps + 1):
        if energy < instance.energy_min_kwh[k]:
            return True
        for stop in (s for s in instance.stops if s.node == k):
            if energy - stop.detour_in_kwh < stop.arrive_min_kwh:
                return True
            energy = instance.energy_max_kwh - stop.detour_out_kwh
        if k < drive.n_steps:
            energy = min(energy - float(least[k]), instance.energy_max_kwh)
    return energy < instance.end_energy_min_kwh


def _row(subset: tuple[int, ...], solver: str, start: Any, build_s: float, run: Run) -> Any:
    return {
        "subset": list(subset),
        "solver": solver,
        "start_temperature_c": start.temperature_c,
        "start_shares": list(start.shares),
        "success": run.success,
        "status": run.status,
        "iterations": run.iterations,
        "claimed_cost": run.claimed_cost,
        "cost": run.cost,
        "feasible": run.feasible,
        "violation": run.trajectory.violation.tolist(),
        "build_s": build_s + run.build_s,
        "solve_s": run.solve_s,
        "evaluation_s": run.evaluation_s,
        "judge_s": run.judge_s,
    }


def reference_best(
    trip: Trip,
    solver: str,
    multi_start: bool = True,
    file: Path | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    settings: Mapping[str, PeerSettings] = FAST,
    integrator: str = "midpoint",
    time_limit_s: float = inf,
) -> Reference:
    """Return the best plan over all 2^N subsets.

    Parameters
    ----------
    trip : Trip
        The trip.
    solver : str
        ``ipopt`` or ``fatrop``.
    multi_start : bool
        All starts per subset, or one.
    file : Path, optional
        JSON lines, one appended per solve as it comes.
    progress : callable, optional
        Called with every row.
    settings : mapping of str to PeerSettings
        How the solver is run, by its name.
    integrator : str
        ``midpoint`` or ``rk4``.
    time_limit_s : float
        No further subset is begun after it [s].

    Returns
    -------
    Reference
        The best plan and all rows.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from relax import load_trip
    >>> trip = load_trip("paper-400km")
    >>> trip = replace(trip, chargers=trip.chargers[1:2])
    >>> reference = reference_best(trip, "fatrop", multi_start=False)
    >>> reference.best_subset, len(reference.rows), reference.best.feasible
    ((0,), 1, True)
    """
    begin = perf_counter()
    drive = make_drive(trip, trip.grid.step_km)
    stages, left = None, 0
    rows: list[dict[str, Any]] = []
    best: tuple[Run, tuple[int, ...]] | None = None
    for subset in all_subsets(len(trip.chargers)):
        if perf_counter() - begin > time_limit_s:
            left += 1
            continue
        instance = make_instance(trip, subset, drive=drive)
        if is_out_of_reach(instance):
            continue
        stages = stages or make_stages(instance, integrator)
        peer = build_peer(instance, solver, stages, settings=settings[solver])
        build_s, failed, found = peer.build_s, 0, False
        for start in starts(instance) if multi_start else (single_start(instance),):
            run = solve_peer(peer, start)
            row = _row(subset, solver, start, build_s, run)
            build_s = 0.0  # counted once
            rows.append(row)
            if file is not None:
                with file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(row) + "\n")
            if progress is not None:
                progress(row)
            if run.feasible and (best is None or run.cost < best[0].cost):
                best = run, subset
            found, failed = found or run.feasible, failed + (not run.feasible)
            if not found and failed >= MAX_FAILURES:
                break
    return Reference(
        solver=solver,
        best=best[0] if best else None,
        best_subset=best[1] if best else (),
        rows=tuple(rows),
        build_s=sum(r["build_s"] for r in rows),
        solve_s=sum(r["solve_s"] for r in rows),
        judge_s=sum(r["judge_s"] for r in rows),
        left=left,
    )
