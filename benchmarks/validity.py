"""Does any proof ever contradict a plan? Thousands of random trips, every claim attacked.

    python -m benchmarks.validity [--trips 2000] [--seconds S] [--resume]
    python -m benchmarks.validity --seed 123        one trip, its findings in full

Per trip the search itself with a random gap, and for its subsets: the root bound, proofs with
cutoffs below, at and above the best plan known, refinements from random starts, random drives;
for all subsets at once proofs over stages, begun below and above the best plan. Nothing may
contradict anything: a bound above a cost, an infeasible subset with a plan, a box (also a
tightened one) that leaves out a plan that costs less than its cutoff, a closed proof with a plan
below its cutoff, stages that leave such a plan no path, a certificate from a spoilt dual vector,
a status that does not fit. One row per trip is appended as it comes, by seed; the exit code is 1
if there was any finding.

Bounds hold for the transcription and are compared with costs of the transcription. The driven
cost of the same plan differs by the transcription's error, which is reported.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections import Counter
from collections.abc import Iterable
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.machine import make_single_threaded, processor, versions

if __name__ == "__main__":
    make_single_threaded()

from benchmarks.adversaries import audit_trip
from benchmarks.contradiction import LIGHT, Audit, Effort
from benchmarks.random_trips import describe, random_trip

__all__ = ["main", "summary"]

RESULTS = Path(__file__).parent / "results"
"""Where result files go."""
CHECKS = (
    "subsets", "plans", "trajectories", "infeasible", "bounds", "boxes", "rows", "tightened",
    "proofs", "closed", "programs", "attacks", "driven_below_bound",
    "stage_proofs", "stage_closed", "stage_steps", "stage_paths",
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
    parser.add_argument("--trips", type=int, default=2000, help="how many, one per seed")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
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
        stream.flush()  # a kill loses no row
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
