"""What does each rule of the tightening save? Proofs with one of them left out, in programs.

    python -m benchmarks.tightening [--gap G] [--time-limit S] [CASE ...]

Prints the tables of ``docs/relaxation.md``, section 6: cone programs until the whole problem is
proved. A rule is left out by replacing it from outside, for one proof at a time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.cases import select
from benchmarks.machine import make_single_threaded

if __name__ == "__main__":
    make_single_threaded()

from enumerate import plan, tree
from relax import envelopes_charge, reach_heat, relaxation_drive, relaxation_stops, tighten
from relax.intervals import Interval

__all__ = ["RULES", "main", "without"]

CASES = (
    "paper/-10C-pump1-time0",
    "paper/-10C-pump3-time0",
    "paper/-10C-pump1-time400",
    "paper/0C-pump1-time40",
    "corridor/goteborg-stockholm-winter",
)
"""Where proofs are long, and one where they are not."""
TIME_LIMIT_S = 180.0


def _worth(name: str, ends: tuple[float, float]) -> Any:
    return patch.dict(tighten.WORTH, {name: ends})


def _wide(planes: Any, grid: Any) -> Interval:
    size = planes.shape[0], planes.shape[2]
    return Interval(np.full(size, -inf), np.full(size, inf))


RULES: dict[str, Callable[[], Any]] = {
    "as it is": lambda: patch.dict(tighten.WORTH, {}),
    "coldest drive": lambda: patch.object(reach_heat._Colder, "end", lambda *_: -inf),
    "coldest stop": lambda: patch.object(reach_heat, "_fallen", lambda *_: -inf),
    "cell to cell": lambda: patch.multiple(
        reach_heat._Drifts, forward=lambda *_: None, backward=lambda *_: None
    ),
    "stays": lambda: _worth("stay", (inf, inf)),
    "families": lambda: patch.dict(
        tighten.FAMILY_WORTH, {"stay": (inf, inf), "charge": (inf, inf)}
    ),
    "small families": lambda: patch.object(tree, "FEW_SUBSETS", 0),
    "planes' own extremes": lambda: patch.object(relaxation_stops, "range_of_planes", _wide),
    "whole stops": lambda: patch.object(relaxation_stops, "_add_stay", lambda *_: None),
    "planes above stop losses": lambda: patch.object(envelopes_charge, "WIDE_NODES", 0),
    "(with all cones)": lambda: patch.object(relaxation_drive, "NEAR_KW", -1.0),
    "(with least charges too)": lambda: _worth("charge", (0.5, 0.5)),
}
"""What is left out, by the heading of its column."""


@contextmanager
def without(rule: str) -> Iterator[None]:
    """Leave one rule out for as long as the block lasts."""
    with RULES[rule]():
        yield


def main(arguments: list[str] | None = None) -> int:
    """Prove every case with every rule left out; print a row per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE")
    parser.add_argument("--gap", type=float, default=0.01, metavar="G")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, metavar="S")
    asked = parser.parse_args(arguments)
    print("| case | " + " | ".join(RULES) + " |")
    print("|---|" + "---:|" * len(RULES))
    for case in select(asked.cases):
        cells = []
        for rule in RULES:
            print(f"{case.name}: {rule}", file=sys.stderr)
            with without(rule):
                result = plan(case.load(), gap=asked.gap, time_limit_s=asked.time_limit)
            proved = result.gap <= asked.gap + 1e-9
            late = "" if proved else f" (gap {100.0 * result.gap:.2f} %)"
            cells.append(f"{result.programs}{late}")
        print(f"| `{case.name}` | " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
