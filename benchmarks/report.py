"""What did the benchmarks give? The page ``docs/benchmark.md``, made of the result files alone.

    python -m benchmarks.report [--smoke]

Reads ``compare.csv``, ``scale.csv``, ``floor.csv``, ``proofs.csv`` and ``judges.csv`` in
``benchmarks/results``; what is not there has no section or sentence. The list at its head says
where evrelax loses, found in the rows like every other figure.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable
from pathlib import Path

from benchmarks.asked import asked, asked_section
from benchmarks.charts import draw_all
from benchmarks.heading import head
from benchmarks.losses import losses
from benchmarks.rows import RESULTS, Row, read_rows
from benchmarks.sections import (
    case_section,
    claims_section,
    contestants_section,
    floor_section,
    growth_section,
    savings_section,
    time_section,
)
from benchmarks.summary import summarise

__all__ = ["main", "page"]

ROOT = Path(__file__).parent.parent


def page(
    rows: list[Row],
    scale_rows: list[Row],
    floor_rows: list[Row],
    pictures: dict[str, str],
    proof_rows: Iterable[Row] = (),
    judge_rows: Iterable[Row] = (),
) -> str:
    """Return the page in Markdown.

    Parameters
    ----------
    rows, scale_rows, floor_rows : list of dict
        Of ``compare``, ``scale`` and ``floor``; the last two may be empty.
    pictures : dict of str to str
        Links to pictures by what they show.
    proof_rows : iterable of dict
        Of ``proofs``: the same plans, timed at another hour.
    judge_rows : iterable of dict
        Of ``judges``: plans judged again.

    Raises
    ------
    ValueError
        There are no rows of the comparison.
    """
    if not rows:
        raise ValueError("no rows of the comparison: run python -m benchmarks.compare first")
    summary = summarise(rows)
    entries = asked(summary, rows, floor_rows)
    sections: list[tuple[list[str], tuple[tuple[str, str], ...]]] = [
        (asked_section(entries), ()),
        (contestants_section(summary), ()),
        (
            claims_section(summary),
            (("correct", "Claims confirmed by the judge"), ("cost-time", "Cost against time")),
        ),
        (
            time_section(summary),
            (
                ("ratios", "Times as multiples of ours"),
                ("gap-time", "Proved gap against time"),
            ),
        ),
        (savings_section(summary), ()),
    ]
    if scale_rows:
        growth = ("growth", "Time and memory over what is varied")
        sections.append((growth_section(scale_rows), (growth, ("parts", "Where the time goes"))))
    if floor_rows:
        sections.append((floor_section(floor_rows), ()))
    sections.append((case_section(rows), ()))
    lines = [
        "# Benchmark: evrelax and others",
        "",
        losses(summary, entries, scale_rows),
        "",
        *head(summary, rows, proof_rows, judge_rows),
    ]
    for text, shown in sections:
        if text:
            lines += ["", *text]
        for name, words in shown:
            if name in pictures:
                lines += ["", f"![{words}]({pictures[name]})"]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Write the page and its pictures; returns the exit code."""
    parser = argparse.ArgumentParser(prog="benchmarks.report", description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="of the smoke runs, beside their rows")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the result files")
    parser.add_argument("--page", type=Path, default=None)
    parser.add_argument("--figures", type=Path, default=None)
    options = parser.parse_args(arguments)
    tail = "-smoke" if options.smoke else ""
    target = options.page or (
        options.results / "benchmark-smoke.md" if options.smoke else ROOT / "docs" / "benchmark.md"
    )
    folder = options.figures or (options.results if options.smoke else target.parent / "figures")
    rows, scale_rows, floor_rows, proof_rows, judge_rows = (
        read_rows(options.results / f"{name}{tail}.csv")
        for name in ("compare", "scale", "floor", "proofs", "judges")
    )
    if not rows:
        print(f"no rows in {options.results / f'compare{tail}.csv'}", file=sys.stderr)
        return 1
    files = draw_all(rows, summarise(rows), scale_rows, folder, tail)
    links = {
        name: Path(os.path.relpath(file, target.parent)).as_posix() for name, file in files.items()
    }
    target.parent.mkdir(parents=True, exist_ok=True)
    text = page(rows, scale_rows, floor_rows, links, proof_rows, judge_rows)
    target.write_text(text, encoding="utf-8")
    summary = summarise(rows)
    print(losses(summary, asked(summary, rows, floor_rows), scale_rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
