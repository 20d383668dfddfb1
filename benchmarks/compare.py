"""How do we compare with others? Every solver on every case, its claims judged by our one judge.

    python -m benchmarks.compare [--cases PATTERN ...] [--solvers NAME ...] [--repeats 3]
                                 [--time-limit 120] [--file FILE] [--smoke] [--list]

Writes one row per solver and case into ``benchmarks/results/compare.csv`` as it comes, and a
summary into ``compare.json``. To resume, run the same command: what is there for the same case,
solver and version is skipped. Who is through within ``REPEAT_BELOW_S`` is run ``--repeats``
times, interleaved with the others, and its times are medians; slow ones run once.
``python -m benchmarks.report`` writes the page.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from datetime import UTC, date, datetime
from math import inf, isfinite
from pathlib import Path
from statistics import median
from typing import Any

from tqdm import tqdm

from benchmarks.cases import CASES, SMOKE, Case, digest, select
from benchmarks.contestants import CONTESTANTS, OURS, Contestant, find
from benchmarks.judge import judge
from benchmarks.machine import processor, versions
from benchmarks.rows import RESULTS, Row, RowFile, number
from benchmarks.runs import Limits
from benchmarks.sources import code_digest
from benchmarks.worker import Worker, WorkerError

__all__ = ["COLUMNS", "compare", "main", "measure"]

REPEAT_BELOW_S = 5.0
"""Runs that take longer are not repeated [s]."""
WARM_UP_S = 2.0
"""Time limit of the first run in a process, which loads what the solver needs [s]."""
KILL_AFTER_S = 1800.0
"""Beyond the time limit: who has none of its own is stopped then [s]."""
TIMES = ("build_s", "solve_s", "judge_s", "total_s")
KEY = ("case", "trip_digest", "solver", "version", "settings")
"""What names a measurement."""
COLUMNS = (
    *KEY[:2], "group", "ambient_c", "heat_pump_kw", "time_value_per_h", "currency", "chargers",
    "steps", "cells", *KEY[2:], "kind", "outcome", "message", "subset", "claimed_cost",
    "transcribed_cost", "replayed_cost", "feasible", "claims_infeasible", "lower_bound",
    "charging_h", "detour_h", "grid_kwh", "paid", *TIMES, "replay_s", "runs_s", "subsets",
    "programs", "trace", "judge", "date", "run", "processor", "versions",
)  # fmt: skip
"""Columns of the result file. ``outcome`` is the judge's, or ``stopped`` without an answer;
``run`` is when the command was started: times within one took turns."""
Run = Callable[[Case, Contestant, Limits], Row]


def measure(case: str, solver: str, limits: Limits) -> Row:
    """Run one solver on one case in this process and judge its plan.

    Parameters
    ----------
    case, solver : str
        Names.
    limits : Limits
        What it may take.

    Examples
    --------
    >>> row = measure("smoke/paper", "evrelax", Limits())
    >>> row["outcome"], row["lower_bound"] <= row["replayed_cost"]
    ('holds', True)
    """
    from time import perf_counter

    (chosen,) = select([case])
    (contestant,) = find([solver])
    trip = chosen.load()
    begin = perf_counter()
    answer = contestant.run(trip, limits)
    answered = perf_counter()
    verdict = judge(trip, answer.subset, answer.controls, answer.targets_kwh)
    return {
        "outcome": verdict.outcome,
        "message": "; ".join(text for text in (answer.message, verdict.reason) if text),
        "subset": " ".join(map(str, answer.subset)),
        "claimed_cost": answer.claimed_cost,
        "transcribed_cost": verdict.transcribed_cost,
        "replayed_cost": verdict.replayed_cost,
        "feasible": isfinite(verdict.replayed_cost),
        "claims_infeasible": answer.claims_infeasible,
        "lower_bound": answer.lower_bound,
        "charging_h": verdict.charging_h,
        "detour_h": verdict.detour_h,
        "grid_kwh": verdict.grid_kwh,
        "paid": verdict.paid,
        "build_s": answer.build_s,
        "solve_s": answer.solve_s,
        "judge_s": answer.judge_s,
        "total_s": answered - begin,
        "replay_s": perf_counter() - answered,
        "subsets": answer.subsets,
        "programs": answer.programs,
        "trace": answer.trace,
    }


def _describe(case: Case) -> Row:
    """Return what the rows of a case have in common."""
    trip = case.load()
    return {
        "case": case.name,
        "trip_digest": digest(trip),
        "group": case.group,
        "ambient_c": round(float(trip.route.ambient_c.mean()), 2),
        "heat_pump_kw": trip.vehicle.heat_pump_kw,
        "time_value_per_h": trip.time_value_per_h,
        "currency": trip.currency,
        "chargers": len(trip.chargers),
        "steps": round(trip.route.length_km / trip.grid.step_km),
        "cells": trip.grid.cells,
    }


def _identity(case: Row, contestant: Contestant, time_limit_s: float) -> Row:
    limit = "our time" if contestant.needs_our_time else f"{time_limit_s:g} s"
    return case | {
        "solver": contestant.name,
        "version": contestant.version,
        "settings": f"limit {limit}",
        "kind": contestant.kind,
    }


def _isolated(worker: Worker) -> Run:
    """Return a measurement in a process of its own; the first run in it does not count."""

    def run(case: Case, contestant: Contestant, limits: Limits) -> Row:
        def task(name: str, allowed: Limits) -> Row:
            arguments = (name, contestant.name, allowed)
            row: Row = worker.run(
                "benchmarks.compare", "measure", arguments, allowed.time_s + KILL_AFTER_S
            )
            return row

        try:
            if contestant.name not in warm and case.name != SMOKE.name:
                task(SMOKE.name, Limits(WARM_UP_S, WARM_UP_S))
            warm.add(contestant.name)
            return task(case.name, limits)
        except WorkerError as error:
            warm.clear()
            return {"outcome": "stopped", "message": str(error), "feasible": False}

    warm: set[str] = set()
    return run


def _our_time(runs: list[Row], file: RowFile, case: Row, time_limit_s: float) -> Limits | None:
    """Return the limits of who is compared at our finishing time; None without that time."""
    stored = file.find(case=case["case"], trip_digest=case["trip_digest"], solver=OURS)
    times = [number(row, "total_s") for row in runs or [stored or {}]]
    times = [spent for spent in times if spent > 0.0]
    return Limits(time_limit_s, median(times)) if times else None


def compare(
    cases: tuple[Case, ...],
    contestants: tuple[Contestant, ...],
    file: RowFile,
    *,
    repeats: int = 3,
    time_limit_s: float = 120.0,
    run: Run | None = None,
) -> int:
    """Measure what the file does not hold yet.

    Parameters
    ----------
    cases, contestants : tuple
        From ``select`` and ``find``.
    file : RowFile
        Grows by a row per solver and case.
    repeats : int
        Runs of the fast.
    time_limit_s : float
        For solvers that have one [s].
    run : callable, optional
        Runs one measurement; in this process by default.

    Returns
    -------
    int
        Rows added.
    """
    run = run or (lambda case, contestant, limits: measure(case.name, contestant.name, limits))
    where = {
        "judge": code_digest("benchmarks.judge", ("benchmarks", "relax")),
        "date": date.today().isoformat(),
        "run": datetime.now(UTC).isoformat(timespec="minutes"),
        "processor": processor(),
        "versions": " ".join(f"{k}={v}" for k, v in versions().items()),
    }
    todo: list[tuple[Case, list[tuple[Contestant, Row]]]] = []
    for case in cases:
        common = _describe(case)
        named = [(c, _identity(common, c, time_limit_s)) for c in contestants]
        todo.append((case, [(c, row) for c, row in named if not file.has(row)]))
    added = 0
    total = sum(len(open_) for _, open_ in todo)
    with tqdm(total=total, file=sys.stderr, desc="compare", disable=None) as bar:
        for case, open_ in todo:
            runs: dict[str, list[Row]] = {c.name: [] for c, _ in open_}
            for turn in range(repeats):
                for contestant, identity in open_:
                    own = runs[contestant.name]
                    if turn and not (own and _is_fast(own[0])):
                        continue
                    bar.set_postfix_str(f"{case.name} {contestant.name}")
                    limits: Limits | None = Limits(time_limit_s)
                    if contestant.needs_our_time:
                        limits = _our_time(runs.get(OURS, []), file, identity, time_limit_s)
                    if limits is None:  # ours did not finish: nothing to compare with
                        bar.update()
                        continue
                    own.append(run(case, contestant, limits))
                    if turn + 1 == repeats or not _is_fast(own[0]):
                        file.append(_together(own) | identity | where)
                        added += 1
                        bar.update()
    return added


def _is_fast(row: Row) -> bool:
    return float(row.get("total_s", inf)) < REPEAT_BELOW_S


def _together(runs: list[Row]) -> Row:
    """Return the first of several runs with the medians of their times."""
    good = [row for row in runs if "total_s" in row]
    times = {name: median(row[name] for row in good) for name in TIMES} if good else {}
    return runs[0] | times | {"runs_s": [row["total_s"] for row in good]}


def main(arguments: list[str] | None = None) -> int:
    """Run the comparison, write the files, print the summary; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.compare", description=__doc__)
    parser.add_argument("--cases", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--solvers", nargs="*", default=[], metavar="NAME")
    parser.add_argument("--repeats", type=int, default=3, help="runs of fast solvers")
    parser.add_argument("--time-limit", type=float, default=120.0, help="where one can be set [s]")
    parser.add_argument("--file", type=Path, default=RESULTS / "compare.csv")
    parser.add_argument("--smoke", action="store_true", help="one small case, once, anew")
    parser.add_argument("--list", action="store_true", help="names of cases and solvers")
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(case.name for case in CASES))
        for contestant in CONTESTANTS:
            print(f"{contestant.name:<20} {contestant.words}" + (
                "" if contestant.available else " (not installed)"))  # fmt: skip
        return 0
    if options.repeats < 1:
        parser.error("--repeats must be at least 1")
    try:
        cases, contestants = select(options.cases), find(options.solvers)
    except ValueError as error:
        parser.error(str(error))
    path, repeats, limit = options.file, options.repeats, options.time_limit
    if options.smoke:
        cases, repeats, limit = (SMOKE,), 1, min(limit, WARM_UP_S)
        if path == RESULTS / "compare.csv":
            path = RESULTS / "compare-smoke.csv"
    file = RowFile(path, COLUMNS, KEY, fresh=options.smoke)
    try:
        with Worker() as worker:
            compare(
                cases, contestants, file, repeats=repeats, time_limit_s=limit,
                run=_isolated(worker),
            )  # fmt: skip
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    from benchmarks.summary import summarise, table

    summary: dict[str, Any] = summarise(file.rows)
    text = json.dumps(summary, indent=1) + "\n"
    path.with_suffix(".json").write_text(text, encoding="utf-8")
    print(table(summary))
    return 0 if all(number(r, "total_s") > 0.0 for r in file.rows) or not options.smoke else 1


if __name__ == "__main__":
    sys.exit(main())
