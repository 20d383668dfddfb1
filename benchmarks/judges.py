"""Does it matter that the judge's code changed? Plans of the comparison made and judged again.

    python -m benchmarks.judges [--each 4] [--file FILE]

Rows of ``compare.csv`` hold no plans, but most solvers give the same plan again. So for every
version of the judge that rows name, a few cases of every solver whose code is still what it was
then are run once more and judged by the judge of now. A plan counts as the same if its claimed
cost is. Rows are appended to ``benchmarks/results/judges.csv``; the same command resumes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from math import inf, isfinite
from pathlib import Path

from tqdm import tqdm

from benchmarks.cases import digest, select
from benchmarks.compare import measure
from benchmarks.contestants import CONTESTANTS
from benchmarks.floor import where
from benchmarks.rows import RESULTS, Row, RowFile, number, read_rows
from benchmarks.runs import Limits
from benchmarks.sources import code_digest
from benchmarks.verdicts import excess, latest

__all__ = ["SAME_COST", "chosen", "is_same_plan", "main", "moved"]

KEY = ("case", "trip_digest", "solver", "version", "judge", "judge_now")
COLUMNS = (
    *KEY, "outcome", "outcome_now", "claimed_cost", "claimed_now", "replayed_cost",
    "replayed_now", "date", "processor", "versions",
)  # fmt: skip
"""Columns of the result file; ``_now`` is what was found again."""
LONGEST_S = 5.0
"""Runs that took longer are not made again [s]."""
SAME_CLAIM = 1e-9
"""Relative difference of claimed costs that is rounding."""
SAME_COST = 1e-6
"""Relative difference of judged costs that is rounding of the integrator, as in the audit."""


def is_same_plan(row: Row) -> bool:
    """Return whether the solver gave the same plan again, by the cost that it claims.

    Examples
    --------
    >>> is_same_plan({"claimed_cost": "100.0", "claimed_now": "100.00000001"})
    True
    >>> is_same_plan({"claimed_cost": "inf", "claimed_now": "inf"})
    False
    """
    then, now = number(row, "claimed_cost"), number(row, "claimed_now")
    return isfinite(then) and isfinite(now) and abs(excess(now, then)) <= SAME_CLAIM


def moved(row: Row) -> float:
    """Return by how much the judged cost changed, relative; ``inf`` if the verdict did.

    Examples
    --------
    >>> row = {"outcome": "holds", "outcome_now": "holds", "replayed_cost": 100.0}
    >>> moved(row | {"replayed_now": 101.0}), moved(row | {"outcome_now": "fails"})
    (0.01, inf)
    """
    if row["outcome"] != row["outcome_now"]:
        return inf
    then, now = number(row, "replayed_cost"), number(row, "replayed_now")
    return 0.0 if then == now else abs(excess(now, then))


def chosen(rows: Iterable[Row], versions: dict[str, str], each: int) -> Iterator[Row]:
    """Yield rows to make again: for every judge and solver a few, spread over its cases.

    Parameters
    ----------
    rows : iterable of dict
        Of the comparison.
    versions : dict of str to str
        Version now, by solver.
    each : int
        Rows per judge and solver at most.
    """
    found: dict[tuple[str, str], list[Row]] = {}
    for by in latest(rows).values():
        for row in by.values():
            again = versions.get(row["solver"]) == row["version"]
            plan = isfinite(number(row, "claimed_cost"))
            if again and plan and number(row, "total_s") <= LONGEST_S:
                found.setdefault((row["judge"], row["solver"]), []).append(row)
    for own in found.values():
        yield from own[:: -(-len(own) // each)]


def main(arguments: list[str] | None = None) -> int:
    """Run what is missing, write the rows, print what moved; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.judges", description=__doc__)
    parser.add_argument("--each", type=int, default=4, help="cases per judge and solver")
    parser.add_argument("--rows", type=Path, default=RESULTS / "compare.csv")
    parser.add_argument("--file", type=Path, default=RESULTS / "judges.csv")
    options = parser.parse_args(arguments)
    if options.each < 1:
        parser.error("--each must be at least 1")
    versions = {c.name: c.version for c in CONTESTANTS if c.available and not c.needs_our_time}
    now = where() | {"judge_now": code_digest("benchmarks.judge", ("benchmarks", "relax"))}
    file = RowFile(options.file, COLUMNS, KEY)
    todo = list(chosen(read_rows(options.rows), versions, options.each))
    try:
        for old in tqdm(todo, file=sys.stderr, desc="judges", disable=None):
            row = {name: old[name] for name in COLUMNS if name in old} | now
            (case,) = select([old["case"]])
            if file.has(row) or digest(case.load()) != old["trip_digest"]:
                continue
            new = measure(old["case"], old["solver"], Limits(20.0 * LONGEST_S))
            file.append(
                row | {
                    f"{name.split('_')[0]}_now": new[name]
                    for name in ("outcome", "claimed_cost", "replayed_cost")
                }
            )  # fmt: skip
    except KeyboardInterrupt:
        print("interrupted; the same command resumes", file=sys.stderr)
        return 130
    same = [row for row in file.rows if is_same_plan(row)]
    print(f"{len(same)} of {len(file.rows)} rows have the same plan again")
    for judge in sorted({row["judge"] for row in same}):
        own = [row for row in same if row["judge"] == judge]
        print(f"judge {judge}: {len(own)} rows, moved by at most {max(map(moved, own)):.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
