"""What did the benchmarks give? The page ``docs/benchmark.md``, made of the result files alone.

    python -m benchmarks.report [--smoke]

Reads ``compare.csv``, ``scale.csv`` and ``floor.csv`` in ``benchmarks/results``; what is not
there has no section. The first paragraph says where evrelax loses, found in the rows like every
other figure.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable
from pathlib import Path

from benchmarks import scale
from benchmarks.asked import asked, asked_section, missed
from benchmarks.charts import draw_all
from benchmarks.contestants import FAST, OURS
from benchmarks.rows import RESULTS, Row, read_rows
from benchmarks.sections import (
    case_section,
    claims_section,
    contestants_section,
    floor_section,
    growth_section,
    head,
    percent,
    plain,
    savings_section,
    some,
    time_section,
)
from benchmarks.summary import summarise

__all__ = ["losses", "main", "page"]

ROOT = Path(__file__).parent.parent


def _times(summary: Row, ours: str) -> list[str]:
    """Return sentences on who is faster than one of ours."""
    ways: dict[str, list[str]] = {"with": [], "without": []}
    rules = []
    for a in summary["against"]:
        if a["ours"] != ours:
            continue
        name, n = a["peer"], a["timed"]
        if a["kind"] == "rule":
            if a["faster_with_build"]:
                rules.append(f"`{name}` in {len(a['faster_with_build'])} of {n}")
            continue
        for way, found in ways.items():
            faster = a[f"faster_{way}_build"]
            if faster and (way == "with" or set(faster) > set(a["faster_with_build"])):
                found.append(
                    f"`{name}` in {len(faster)} of {n} (down to "
                    f"{plain(a[f'least_ratio_{way}_build'], 3)} of our time)"
                )
    said = []
    if ways["with"]:
        said.append(f"**Time** of `{ours}`, their model building included: "
                    + "; ".join(ways["with"]) + ".")  # fmt: skip
    if ways["without"]:
        said.append(f"**Time** of `{ours}`, if their model is built before: "
                    + "; ".join(ways["without"]) + ".")  # fmt: skip
    if rules:
        said.append("Rules that optimise nothing are faster, too: " + "; ".join(rules) + ".")
    return said


def losses(summary: Row, entries: Iterable[Row] = (), scale_rows: Iterable[Row] = ()) -> str:
    """Return the paragraph that says where evrelax is beaten.

    Parameters
    ----------
    summary : dict
        From ``summarise``.
    entries : iterable of dict
        From ``asked``: what is not reached is said, too.
    scale_rows : iterable of dict
        Of ``benchmarks.scale``: where no plan came is said, too.

    Returns
    -------
    str
        One paragraph: time, cost, plans, bounds, asked gaps, own claims, what was asked for.
    """
    said = [*_times(summary, OURS), *_times(summary, FAST)]
    cheaper: list[str] = []
    alone: list[str] = []
    tighter: list[str] = []
    for name in dict.fromkeys(a["peer"] for a in summary["against"]):
        own = [a for a in summary["against"] if a["peer"] == name]
        at = max(own, key=lambda a: float(a["cheaper_by"]))
        if at["cheaper"]:
            cheaper.append(
                f"`{name}` in {len(at['cheaper'])} of {at['cases']} (by up to "
                f"{percent(at['cheaper_by'], 3)}, `{at['cheapest_case']}`"
                + (", once our refinement has repaired it)" if at["cheapest_repaired"] else ")")
            )
        for found, key in ((alone, "plan_only_there"), (tighter, "tighter")):
            cases = sorted({case for a in own for case in a[key]})
            if cases:
                found.append(f"`{name}` in {some(cases)}")
    if cheaper:
        said.append("**Cost**, as judged: cheaper plans have " + "; ".join(cheaper) + ".")
    if alone:
        said.append("**Plans** that we do not find: " + "; ".join(alone) + ".")
    if tighter:
        said.append("**Bounds**: tighter ones has " + "; ".join(tighter) + ".")
    if summary["gap_missed"]:
        said.append(
            f"**Proof**: the asked gap of {percent(summary['asked_gap'], 0)} is not reached in "
            f"{len(summary['gap_missed'])} cases: {some(summary['gap_missed'])}."
        )
    if summary["open"]:
        said.append(
            f"**Open**: neither a plan nor a proof that there is none in {some(summary['open'])}."
        )
    for name, s in summary["solvers"].items():
        if s["kind"] != "ours":
            continue
        refused = s["possible"] - s["correct"]
        if refused:
            said.append(
                f"**Claims**: {refused} of {s['possible']} answers of `{name}` are not confirmed."
            )
        if s["bounds_undercut"]:
            said.append(
                f"**Wrong bounds**: {s['bounds_undercut']} of `{name}` are above a known plan."
            )
        if s["wrongly_infeasible"]:
            said.append(
                f"**Wrong proofs**: `{name}` calls {s['wrongly_infeasible']} cases infeasible that"
                " have a plan."
            )
    broken = [
        f"{row['sweep']} {float(row['value']):g} ({row['ended']}: {row['message']})"
        for own in scale.curves(scale_rows).values()
        for row in own
        if row["ended"] not in ("done", "limit")
    ]
    if broken:
        said.append("**No plan** in the sweeps below: " + "; ".join(broken) + ".")
    short = missed(entries)
    if short:
        said.append("**Asked for and not reached**: " + "; ".join(short) + ".")
    if not said:
        return (
            f"**Where evrelax loses:** in none of the {summary['cases']} cases of these rows is a"
            " peer faster, cheaper or tighter, and every gap asked for is proved."
        )
    return "**Where evrelax loses.** " + " ".join(said)


def page(
    rows: list[Row],
    scale_rows: list[Row],
    floor_rows: list[Row],
    pictures: dict[str, str],
    command: str = "python -m benchmarks.report",
) -> str:
    """Return the page in Markdown.

    Parameters
    ----------
    rows, scale_rows, floor_rows : list of dict
        Of the three result files; the last two may be empty.
    pictures : dict of str to str
        Links to pictures by what they show.
    command : str
        What wrote it.

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
        losses(summary, entries),
        "",
        *head(summary, command),
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
    rows, scale_rows, floor_rows = (
        read_rows(options.results / f"{name}{tail}.csv") for name in ("compare", "scale", "floor")
    )
    if not rows:
        print(f"no rows in {options.results / f'compare{tail}.csv'}", file=sys.stderr)
        return 1
    files = draw_all(rows, summarise(rows), scale_rows, folder, tail)
    links = {
        name: Path(os.path.relpath(file, target.parent)).as_posix() for name, file in files.items()
    }
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page(rows, scale_rows, floor_rows, links), encoding="utf-8")
    summary = summarise(rows)
    print(losses(summary, asked(summary, rows, floor_rows), scale_rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
