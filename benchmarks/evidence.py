"""What does an audit cost? Plans with proofs kept, saved, and audited without a solver.

    python -m benchmarks.evidence [--trips PATTERN ...] [--repeats 3] [--smoke]

Every trip of the table in ``docs/audit.md`` is planned to its gap, once without and once with
proofs kept, taking turns; the proofs are saved and audited in a process of their own, whose peak
memory is noted. Rows are appended to ``benchmarks/results/evidence.csv``, one per round; the same
command resumes. Prints the table: medians over the rounds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from tqdm import tqdm

from benchmarks.cases import SMOKE, digest
from benchmarks.floor import where
from benchmarks.measured import peak_memory_mb
from benchmarks.rows import RESULTS, Row, RowFile, is_true, number
from benchmarks.sources import code_digest
from benchmarks.words import counted
from benchmarks.worker import Worker, WorkerError
from enumerate import audit, plan, save_proofs
from relax import load_trip
from relax.trip import Trip

__all__ = ["COLUMNS", "TASKS", "Task", "main", "measure_audit", "measure_plans", "table"]

KEY = ("trip", "trip_digest", "asked_gap", "version", "round")
COLUMNS = (
    *KEY, "chargers", "status", "cost", "lower_bound", "holds", "failures", "boxes",
    "stage_steps", "programs", "plain_s", "plan_s", "save_s", "audit_s", "file_mb", "duals_mb",
    "memory_mb", "date", "processor", "versions",
)  # fmt: skip
"""Columns of the result file. ``plain_s``: planned without keeping proofs; ``memory_mb``: peak of
the audit's process."""
LIMIT_S = 600.0
"""Time for one plan [s]."""
AGAIN_BELOW_S = 5.0
"""An audit that takes less is done twice, and the second counts: the first imports [s]."""
PACKAGES = ("relax", "enumerate")
"""Whose code the version is a digest of."""
MEDIANS = (
    "boxes", "stage_steps", "programs", "plan_s", "audit_s", "file_mb", "duals_mb", "memory_mb",
)  # fmt: skip
"""Columns whose medians the table shows."""


@dataclass(frozen=True)
class Task:
    """A trip whose proofs are audited.

    Parameters
    ----------
    name : str
        In the table.
    load : callable
        Returns the trip; can be pickled.
    gap : float
        Relative gap asked for.
    """

    name: str
    load: Callable[[], Trip]
    gap: float = 0.01


def _shipped(name: str, words: str = "", gap: float = 0.01, **overrides: float) -> Task:
    settings = {key.replace("__", "."): value for key, value in overrides.items()}
    return Task(name + words, partial(load_trip, name, overrides=settings), gap)


TASKS = (
    _shipped("paper-400km"),
    _shipped("paper-400km", ", 400 SEK/h", objective__time_value_per_h=400.0),
    _shipped("paper-400km", ", 10 C", route__ambient_c=10.0),
    _shipped("goteborg-stockholm-summer"),
    _shipped("long-1000km-winter", gap=0.03),
)
"""The rows of the table; only the last has stages."""


def measure_plans(task: Task, path: Path, kept_first: bool = False) -> Row:
    """Plan a trip without and with proofs kept, and save them.

    Parameters
    ----------
    task : Task
        The trip and the gap.
    path : Path
        Where the proofs go.
    kept_first : bool
        Which of both comes first; rounds should take turns.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "smoke.proofs"
    ...     row = measure_plans(Task("smoke", SMOKE.load, 0.05), path)
    ...     found = measure_audit(Task("smoke", SMOKE.load, 0.05), path)
    >>> row["status"], found["holds"], found["audit_s"] < row["plan_s"]
    ('optimal', True, True)
    """
    trip, spent, result = task.load(), {}, None
    plan(SMOKE.load())  # imports and first calls are not what is measured
    for keep in (kept_first, not kept_first):
        begin = perf_counter()
        done = plan(trip, gap=task.gap, time_limit_s=LIMIT_S, keep_proofs=keep)
        spent[keep] = perf_counter() - begin
        result = done if keep else result
    assert result is not None
    begin = perf_counter()
    save_proofs(path, trip, result)
    return {
        "chargers": len(trip.chargers),
        "status": result.status.value,
        "cost": result.cost,
        "lower_bound": result.lower_bound,
        "plain_s": spent[False],
        "plan_s": spent[True],
        "save_s": perf_counter() - begin,
    }


def measure_audit(task: Task, path: Path) -> Row:
    """Audit saved proofs; for a peak of memory that means something, in a fresh process."""
    trip = task.load()
    begin = perf_counter()
    found = audit(path, trip)
    spent = perf_counter() - begin
    if spent < AGAIN_BELOW_S:
        begin = perf_counter()
        found = audit(path, trip)
        spent = perf_counter() - begin
    memory_mb = peak_memory_mb()
    with np.load(path, allow_pickle=False) as members:
        duals_mb = members["duals"].nbytes / 1e6
    return {
        "holds": found.holds,
        "failures": "; ".join(found.failures),
        "boxes": found.nodes,
        "stage_steps": found.stage_steps,
        "programs": found.programs,
        "audit_s": spent,
        "file_mb": path.stat().st_size / 1e6,
        "duals_mb": duals_mb,
        "memory_mb": memory_mb,
    }


def _round(task: Task, path: Path, kept_first: bool) -> Row:
    """Plan and audit, each in a process of its own."""
    row: Row = {}
    for function, more in (("measure_plans", (kept_first,)), ("measure_audit", ())):
        with Worker() as worker:
            row |= worker.run("benchmarks.evidence", function, (task, path, *more), 4.0 * LIMIT_S)
    return row


def table(rows: Iterable[Row]) -> str:
    """Return the table of docs/audit.md and two sentences on it: medians over the rounds.

    Of a trip only the rounds with its newest code count.

    Examples
    --------
    >>> row = {"trip": "a", "asked_gap": "0.01", "version": "1", "chargers": "3", "holds": "True",
    ...     "boxes": "37", "stage_steps": "0", "programs": "182", "plain_s": "4.0",
    ...     "plan_s": "4.2", "audit_s": "0.84", "file_mb": "6.1", "duals_mb": "6.4",
    ...     "memory_mb": "99.6"}
    >>> print(table([row]))  # doctest: +ELLIPSIS
    | trip | gap asked for | boxes | steps over stages | programs certified | planning | ...
    |---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|
    | `a` (N = 3) | 1 % | 37 | 0 | 182 | 4.20 s | 0.84 s | 0.20 | 6.1 MB | 6.4 MB | 100 MB |
    <BLANKLINE>
    Medians of 1 round. Planning with proofs kept takes 1.05 times as long as without.
    """
    found: dict[str, list[Row]] = {}
    for row in rows:
        own = found.setdefault(row["trip"], [])
        if own and own[-1]["version"] != row["version"]:
            own.clear()
        own.append(row)
    lines = [
        "| trip | gap asked for | boxes | steps over stages | programs certified | planning "
        "| audit | share | file | dual vectors | audit's peak memory |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    kept, counts, broken = [], set(), []
    for name, own in found.items():
        m = {c: median(number(row, c) for row in own) for c in MEDIANS}
        share = median(number(row, "audit_s") / number(row, "plan_s") for row in own)
        kept.append(median(number(row, "plan_s") / number(row, "plain_s") for row in own))
        counts.add(len(own))
        broken += [name] if not all(is_true(row, "holds") for row in own) else []
        words, _, more = name.partition(",")
        lines.append(
            f"| `{words}`{',' if more else ''}{more} (N = {own[0]['chargers']}) "
            f"| {100.0 * number(own[0], 'asked_gap'):g} % | {m['boxes']:.0f} "
            f"| {m['stage_steps']:.0f} | {m['programs']:.0f} | {m['plan_s']:.2f} s "
            f"| {m['audit_s']:.2f} s | {share:.2f} | {m['file_mb']:.3g} MB "
            f"| {m['duals_mb']:.3g} MB | {m['memory_mb']:.0f} MB |"
        )
    if kept:
        most = f"{min(kept):.2f} to {max(kept):.2f}" if len(kept) > 1 else f"{kept[0]:.2f}"
        fewest = f"{min(counts)} to {max(counts)} rounds" if len(counts) > 1 else ""
        lines += [
            "",
            f"Medians of {fewest or counted(min(counts), 'round')}. Planning with proofs kept takes"
            f" {most} times as long as without.",
        ]
    if broken:
        lines.append(f"Audits that do not hold: {', '.join(broken)}.")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure what is missing, write the rows, print the table; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.evidence", description=__doc__)
    parser.add_argument("--trips", nargs="*", default=["*"], metavar="PATTERN")
    parser.add_argument("--repeats", type=int, default=3, help="rounds")
    parser.add_argument("--file", type=Path, default=RESULTS / "evidence.csv")
    parser.add_argument("--smoke", action="store_true", help="one small trip, once, anew")
    options = parser.parse_args(arguments)
    if options.repeats < 1:
        parser.error("--repeats must be at least 1")
    tasks = [t for t in TASKS if any(fnmatchcase(t.name, p) for p in options.trips)]
    if not tasks:
        parser.error(f"no trip matches; names: {'; '.join(t.name for t in TASKS)}")
    path, repeats = options.file, options.repeats
    if options.smoke:
        tasks, repeats = [Task(SMOKE.name, SMOKE.load, 0.05)], 1
        if path == RESULTS / "evidence.csv":
            path = RESULTS / "evidence-smoke.csv"
    file = RowFile(path, COLUMNS, KEY, fresh=options.smoke)
    codes = (code_digest(f"enumerate.{root}", PACKAGES) for root in ("search", "audit"))
    common = where() | {"version": " ".join(codes)}
    todo: list[tuple[Task, Row, int]] = []
    for task in tasks:
        row = common | {
            "trip": task.name, "trip_digest": digest(task.load()), "asked_gap": task.gap,
        }  # fmt: skip
        todo += [(task, row | {"round": at}, at) for at in range(1, repeats + 1)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            for task, row, at in tqdm(todo, file=sys.stderr, desc="evidence", disable=None):
                if not file.has(row):
                    file.append(row | _round(task, Path(folder) / "proofs", at % 2 == 0))
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    except WorkerError as error:
        print(f"{error}; the same command resumes", file=sys.stderr)
        return 1
    print(table(file.rows))
    return 0 if all(is_true(row, "holds") for row in file.rows) else 1


if __name__ == "__main__":
    sys.exit(main())
