"""Owns the sections of the benchmark page: lines of Markdown from figures.

Every function takes a summary (``summary.summarise``) or rows and returns lines; nothing is
computed here that a test of ``summary`` would have to know.
"""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks import floor, scale
from benchmarks.cases import GROUPS, SEEDS
from benchmarks.compare import REPEAT_BELOW_S
from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.rows import Row, is_true, number
from benchmarks.verdicts import latest
from benchmarks.words import counted, percent, plain, some
from enumerate.gap import relative_gap

__all__ = [
    "case_section",
    "claims_section",
    "contestants_section",
    "floor_section",
    "growth_section",
    "savings_section",
    "time_section",
]

WORDS = {
    "paper": (
        "variant", " of `paper-400km` (-10, 0, 10 C; heat pump 0, 1, 3 kW; 0, 40, 400 SEK/h)"
    ),
    "corridor": ("other shipped trip", ""),
    "random": ("random trip", f" (of the seeds {SEEDS[0]} to {SEEDS[-1]}, none left out)"),
}  # fmt: skip
"""Kinds of case: a noun and what follows it."""


def _groups(summary: Row) -> str:
    named = {group: WORDS.get(group, (f"{group} case", "")) for group in summary["groups"]}
    return ", ".join(
        counted(n, named[group][0]) + named[group][1] for group, n in summary["groups"].items()
    )


def contestants_section(summary: Row) -> list[str]:
    """Return cases and solvers."""
    settings = "; ".join(summary["settings"])
    lines = [
        "## Who and what",
        "",
        f"{counted(summary['cases'], 'case')}: {_groups(summary)}. Settings: {settings}."
        f" Nobody has a plan in {len(summary['without_plan'])}"
        + (f" ({some(summary['without_plan'])})" if summary["without_plan"] else "")
        + ".",
        "",
        "`code=` is a fingerprint of the code that decides a solver's result: the first ten digits"
        " of a SHA-256 over the syntax trees of its module and of all modules of ours that this"
        " one imports, comments and docstrings left out (`benchmarks/sources.py`). Equal digits:"
        " equal code. Several in a cell: each kind of case was measured with the code named, and"
        " kinds with different digits show two states of that solver. `python -m"
        " benchmarks.compare` measures again what has other digits than the checkout.",
        "",
        "| solver | what it is | version |",
        "|---|---|---|",
    ]
    for name, s in summary["solvers"].items():
        lines.append(f"| `{name}` | {s['words']} | {'<br>'.join(s['versions'])} |")
    missing = [c.name for c in CONTESTANTS if c.name not in summary["solvers"]]
    if missing:
        lines += ["", "Without rows here: " + ", ".join(f"`{name}`" for name in missing) + "."]
    return lines


def claims_section(summary: Row) -> list[str]:
    """Return what the judge says of the claims."""
    lines = [
        "## Claims and what the judge says",
        "",
        "Every plan, ours too, is driven on the continuous model by the same judge"
        " (`benchmarks/judge.py`). *Cases for which anyone has a plan*: of"
        " those that the solver was run on; the columns to *correct* count among them. *Holds*:"
        " drives, perhaps after one repair by our refinement"
        " (*repaired*). *Correct*: holds as it is, at a cost within "
        f"{percent(summary['claim_tolerance'], 1)} of the claim. *Above best*: judged cost over"
        " the best judged cost of any solver, less 1. *Gap*: judged cost against the solver's own"
        " bound; *undercut*: bounds above the cost of a known plan on the transcription.",
        "",
        "| solver | cases for which anyone has a plan | holds | repaired | correct"
        " | above best: mean | worst | bounds | undercut | gap: median | largest |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, s in summary["solvers"].items():
        rate = f" ({100.0 * s['correct'] / s['possible']:.0f} %)" if s["possible"] else ""
        lines.append(
            f"| `{name}` | {s['possible']} | {s['held']} | {s['repaired']} | {s['correct']}{rate} "
            f"| {percent(s['mean_excess'], 4)} | {percent(s['worst_excess'], 3)} "
            f"| {s['bounds']} | {s['bounds_undercut']} | {percent(s['median_gap'])} "
            f"| {percent(s['largest_gap'])} |"
        )
    return lines


def time_section(summary: Row) -> list[str]:
    """Return times, and those of the peers as multiples of ours."""
    lines = [
        "## Time",
        "",
        f"Geometric means of time + {summary['shift_s']:g} s, less {summary['shift_s']:g} s, over"
        " all cases that gave an answer; *slowest* and *sum* over the same. Of the peers this"
        " counts all they do, correcting their plan on the tables included. *Cut*: the time limit"
        " came before the end; *stopped*: no answer at all. A run is repeated twice if it takes"
        f" less than {REPEAT_BELOW_S:g} s, in turns with all others on that case; then the median"
        " counts.",
        "",
        "| solver | answers | mean s | slowest s | sum s | programs, median | cut | stopped |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, s in summary["solvers"].items():
        lines.append(
            f"| `{name}` | {s['cases'] - s['stopped']} | {plain(s['time_s'], 3)} "
            f"| {plain(s['slowest_s'])} | {plain(s['sum_s'], 1)} "
            f"| {plain(s['median_programs'], 0)} | {s['cut']} | {s['stopped']} |"
        )
    if summary["against"]:
        lines += [
            "",
            "Their time as a multiple of ours where both have a plan (above 1: we are faster)."
            " Theirs is building and solving, or solving alone; ours is everything: bounds, plan"
            f" and drive. Compared with `{OURS}` are the cases in which its proof is complete, and"
            f" the peer's too if it gives bounds; who proves nothing is compared with `{FAST}` as"
            " well. *In one run*: both were measured by one command, taking turns; the times of the"
            " other cases come from different hours. Enumerations that were cut count with their"
            " time until then, which is less than they need. A peer builds its model anew for every"
            " trip: its building is what a user waits for, solving alone is what were left if it"
            " could be kept.",
            "",
            "| peer | against | cases | in one run | with building: geometric mean"
            " (least to largest) | solving alone | peer cheaper | evrelax cheaper"
            " | only the peer has a plan | only evrelax has one |",
            "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
        ]
    for a in summary["against"]:
        ratio = [
            f"{plain(a[f'ratio_{way}_build'])} ({plain(a[f'least_ratio_{way}_build'], 3)} to "
            f"{plain(a[f'largest_ratio_{way}_build'])})"
            for way in ("with", "without")
        ]
        lines.append(
            f"| `{a['peer']}` | `{a['ours']}` | {a['timed']} | {len(a['together'])} "
            f"| {ratio[0]} | {ratio[1]} | {len(a['cheaper'])} | {len(a['dearer'])} "
            f"| {len(a['plan_only_there'])} | {len(a['plan_only_here'])} |"
        )
    lines += [
        "",
        "In the picture of gaps below, one that grows again means that a plan was refused when it"
        " was driven, that a part of a box has a looser bound than the box, or that a phase of the"
        " search reports its own bound only.",
    ]
    return lines


def _bin_words(entry: Row) -> str:
    lo, hi = entry["from_c"], entry["to_c"]
    if lo is None:
        return f"below {hi:g}"
    return f"{lo:g} and above" if hi is None else f"{lo:g} to {hi:g}"


def savings_section(summary: Row) -> list[str]:
    """Return what is saved against drivers with rules."""
    if not summary["savings"]:
        return []
    lines = [
        "## Against drivers with rules",
        "",
        f"What the plan of `{FAST}` saves on average, by mean ambient temperature: charging and"
        " detour time; money paid (energy, occupancy, stops); the whole cost, time included."
        " Shares of the driver's own.",
        "",
        "| driver | ambient C | cases | driver does not arrive | minutes | money | cost |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    for name, entries in summary["savings"].items():
        lines += [
            f"| `{name}` | {_bin_words(e)} | {e['cases']} | {e['driver_fails']} "
            f"| {plain(e['saved_min'], 1)} | {percent(e['saved_paid'], 1)} "
            f"| {percent(e['saved_cost'], 1)} |"
            for e in entries
        ]
    return lines


def case_section(rows: Iterable[Row]) -> list[str]:
    """Return one line per case."""
    lines = [
        "## Case by case",
        "",
        f"Cost as judged; the gap and the time of `{FAST}` and of `{OURS}`; the best peer that"
        " optimises.",
        "",
        f"| case | `{FAST}` cost | gap | s | `{OURS}` cost | gap | s | best peer | cost | s |",
        "|---|---:|---:|---:|---:|---:|---:|---|---:|---:|",
    ]
    cases = latest(rows)
    order = [*GROUPS, *sorted({row["group"] for by in cases.values() for row in by.values()})]
    for case in sorted(cases, key=lambda c: order.index(c.split("/", 1)[0])):
        by = cases[case]
        cells = []
        for name in (FAST, OURS):
            row = by.get(name)
            if row is None:
                cells.append(" | | ")
            elif not is_true(row, "feasible"):
                said = "infeasible" if is_true(row, "claims_infeasible") else row["outcome"]
                cells.append(f"{said} | - | {number(row, 'total_s'):.2f}")
            else:
                gap = relative_gap(number(row, "replayed_cost"), number(row, "lower_bound"))
                cells.append(
                    f"{number(row, 'replayed_cost'):.3f} | {100.0 * gap:.2f} % "
                    f"| {number(row, 'total_s'):.2f}"
                )
        peers = [r for r in by.values() if r["kind"] == "peer" and is_true(r, "feasible")]
        best = min(peers, key=lambda r: number(r, "replayed_cost"), default=None)
        other = "- | - | -"
        if best is not None:
            other = (
                f"`{best['solver']}` | {number(best, 'replayed_cost'):.3f} "
                f"| {number(best, 'build_s') + number(best, 'solve_s'):.2f}"
            )
        lines.append(f"| {case} | {' | '.join(cells)} | {other} |")
    return lines


def _code(rows: list[Row]) -> str:
    """Return which code rows were measured with."""
    return " Versions: " + "; ".join(dict.fromkeys(row["version"] for row in rows)) + "."


def growth_section(rows: list[Row]) -> list[str]:
    """Return how time and memory grow."""
    return [
        "## How it grows",
        "",
        f"`python -m benchmarks.scale`: one trip of `paper-400km` ({scale.BASE[0]:g} C, heat pump"
        f" {scale.BASE[1]:g} kW, {scale.BASE[2]:g} SEK/h), one thing varied at a time. Each"
        " point in a process of its own; memory is its peak. Fits are straight lines through"
        " logarithms, with their standard errors; what the time limit stopped counts in none, so"
        " a line through few of the points flatters. *Scatter*: the slope differs from zero by"
        f" less than {scale.TOLD_FROM_SCATTER:g} standard errors. *Of its runs*: those of a point"
        " follow one another; a load that changes between points is not in their spread."
        + _code(rows),
        "",
        scale.fits_table(scale.fits(rows)),
        "",
        scale.table(rows),
        "",
        "### Where the time goes",
        "",
        "First and last point of each sweep, shares of the sum of all parts; each part is the"
        " median of its runs. *Reach*: boxes; *certify*: safe bounds; *refine*:"
        " everything of it but its quadratic programs, which are under *solve*.",
        "",
        scale.parts_table(rows),
    ]


def floor_section(rows: list[Row]) -> list[str]:
    """Return how near we are to the solver's own time."""
    return [
        "## The floor",
        "",
        "`python -m benchmarks.floor`: with the programs we solve, the time that Clarabel itself"
        " reports for them (its setup included) cannot be avoided. *In its calls* adds handing the"
        " data over; *all* is the whole plan." + _code(rows),
        "",
        floor.table(floor.summarise(rows)),
    ]
