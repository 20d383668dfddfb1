"""Owns the pictures of the benchmark page: draws what the result files say, computes nothing new.

Imports matplotlib on first use and never touches pyplot, so it needs no display.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.contestants import CONTESTANTS, FAST, OURS
from benchmarks.probe import PARTS
from benchmarks.rows import Row, is_true, number
from benchmarks.scale import curves, shares, spread
from benchmarks.verdicts import best_costs, excess, latest, peer_s
from enumerate.gap import relative_gap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_all"]

COLOURS = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#999999", "#000000",
)  # fmt: skip
"""Colours that remain apart for the colour-blind (Okabe and Ito, 2008)."""
MARKERS = "os^DvP"
"""Of the members of a family, and of kinds of case, in order."""
STYLE: Any = {
    "font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "legend.fontsize": 7,
    "xtick.labelsize": 7, "ytick.labelsize": 7, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": False, "axes.linewidth": 0.6,
}  # fmt: skip
VERDICTS = {
    "claim confirmed": "#009E73",
    "holds, but not as claimed": "#E69F00",
    "no plan that holds": "#D55E00",
}
"""What the judge may say, and its colour."""
DPI = 150
LEAST_EXCESS = 1e-3
"""Costs nearer to the best than this are drawn here [%]."""
LEAST_GAP = 1e-2
"""Smaller gaps are drawn here [%]."""
SLOW_S = 30.0
"""Proofs that take longer are named in the picture [s]."""


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _plain_ticks(ax: Axes) -> None:
    """Write 0.1 rather than a power of ten."""
    from matplotlib.ticker import FormatStrFormatter, LogFormatter

    class Plain(LogFormatter):
        """Labels only where a decade is not spanned."""

        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(FormatStrFormatter("%g"))
            axis.set_minor_formatter(Plain())


def _family(name: str) -> str:
    return name.split("-", 1)[0]


def _look(name: str) -> dict[str, Any]:
    """Return colour and marker: one colour per family of solvers, only its first filled."""
    names = [c.name for c in CONTESTANTS]
    family = list(dict.fromkeys(map(_family, names))).index(_family(name))
    member = [n for n in names if _family(n) == _family(name)].index(name)
    colour = COLOURS[family]
    return {
        "marker": MARKERS[(family + member) % len(MARKERS)],
        "edgecolors": colour,
        "facecolors": "none" if member else colour,
        "linewidths": 0.8,
    }


def _names(summary: Row, *kinds: str) -> Iterator[str]:
    yield from (n for n, s in summary["solvers"].items() if not kinds or s["kind"] in kinds)


def _times(row: Row) -> float:
    """Return the whole time of us, building and solving of a peer [s]."""
    return number(row, "total_s") if row["kind"] == "ours" else peer_s(row)[0]


def cost_against_time(rows: list[Row], summary: Row) -> Figure:
    """Draw every plan that holds: its cost above the best known, over its time."""
    cases = latest(rows)
    best = best_costs(cases)
    figure = _figure(6.3, 3.6)
    ax = figure.subplots()
    for name in _names(summary):
        own = [(c, r[name]) for c, r in cases.items() if name in r and is_true(r[name], "feasible")]
        points = [(_times(r), 100.0 * excess(number(r, "replayed_cost"), best[c])) for c, r in own]
        points = [(t, max(e, LEAST_EXCESS)) for t, e in points if t > 0.0]
        if points:
            x, y = zip(*points, strict=True)
            ax.scatter(x, y, s=14, alpha=0.7, label=name, **_look(name))
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="time [s]: ours everything, peers building and solving",
        ylabel=f"cost above the best known [%]\n({LEAST_EXCESS:g} or less at the bottom)",
    )
    _plain_ticks(ax)
    figure.legend(loc="outside right upper")
    return figure


def _trace(row: Row) -> list[tuple[float, float]]:
    """Return how the gap of a run shrank: elapsed time [s] and gap [%]."""
    points = json.loads(row["trace"]) if row.get("trace") else []
    found = [(t, 100.0 * relative_gap(float(cost), float(bound))) for t, cost, bound in points]
    return [(t, max(gap, LEAST_GAP)) for t, gap in found if isfinite(gap) and t > 0.0]


def gap_against_time(rows: list[Row], summary: Row) -> Figure:
    """Draw the proved gap over the time, for who gives bounds; a colour per kind of case."""
    cases = latest(rows)
    groups = list(dict.fromkeys(row["group"] for by in cases.values() for row in by.values()))
    figure = _figure(6.3, 3.4)
    ax = figure.subplots()
    shown: set[str] = set()
    slow: list[tuple[float, float, str]] = []
    for at, name in enumerate(n for n in _names(summary) if n != FAST):
        if not summary["solvers"][name]["bounds"]:
            continue
        for case, by in cases.items():
            points = _trace(by[name]) if name in by else []
            if name in by and not points and is_true(by[name], "feasible"):
                row = by[name]
                gap = relative_gap(number(row, "replayed_cost"), number(row, "lower_bound"))
                points = [(_times(row), 100.0 * gap)] if isfinite(gap) else []
            if not points:
                continue
            x, y = zip(*points, strict=True)
            group = groups.index(by[name]["group"])
            label = f"{name}, {groups[group]}"
            look: Any = {"color": COLOURS[group], "label": "" if label in shown else label}
            if name == OURS:
                ax.step(x, y, where="post", color=look["color"], linewidth=0.7, alpha=0.6)
                ax.scatter(x[-1], y[-1], s=14, marker=MARKERS[group], **look)
            else:  # its end only
                ax.scatter(x[-1], y[-1], s=22, marker="x+1"[at % 3], linewidths=1.2, **look)
            shown.add(label)
            if name == OURS and x[-1] >= SLOW_S:
                slow.append((x[-1], y[-1], case))
    reached = sorted(
        (point for point in slow if point[1] <= 100.0 * (summary["asked_gap"] or 0.0)), reverse=True
    )
    for seconds, gap, case in slow:  # labels of proofs that end at the gap asked for are stacked
        below = (seconds, gap, case) in reached
        drop = -12.0 - 8.0 * reached.index((seconds, gap, case)) if below else 5.0
        note = ax.annotate(
            case.split("/", 1)[1] if case.startswith("corridor/") else case,
            (seconds, gap), (-4.0, drop), textcoords="offset points", fontsize=6, ha="right",
        )  # fmt: skip
        note.set_in_layout(False)
    asked = summary["asked_gap"]
    if asked:
        ax.axhline(100.0 * asked, color="#999999", linewidth=0.7, linestyle="--")
    ax.set(xscale="log", yscale="log", xlabel="time [s]", ylabel="proved gap [%]")
    _plain_ticks(ax)
    if ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right upper")
    return figure


def correct_rate(summary: Row) -> Figure:
    """Draw how many claims the judge confirms."""
    names = [n for n in _names(summary) if summary["solvers"][n]["possible"]]
    figure = _figure(6.3, 0.8 + 0.24 * len(names))
    ax = figure.subplots()
    for at, name in enumerate(names):
        s = summary["solvers"][name]
        part = [s["correct"], s["held"] - s["correct"], s["possible"] - s["held"]]
        left = 0.0
        for count, (words, colour) in zip(part, VERDICTS.items(), strict=True):
            label = words if at == 0 else None
            width = 100.0 * count / s["possible"]
            ax.barh(at, width, left=left, color=colour, height=0.7, label=label)
            left += 100.0 * count / s["possible"]
    ax.set(xlim=(0.0, 100.0), xlabel="cases for which anyone has a plan [%]")
    figure.legend(loc="outside upper center", ncols=3)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    return figure


def time_ratios(summary: Row) -> Figure:
    """Draw every peer's time as a multiple of ours, with and without its model building."""
    against = [a for a in summary["against"] if a["timed"]]
    names = [f"{a['peer']} / {a['ours']}" for a in against]
    figure = _figure(6.3, 0.7 + 0.24 * max(len(names), 1))
    ax = figure.subplots()
    for at, entry in enumerate(against):
        for way, shift, colour in (("with", -0.15, "#0072B2"), ("without", 0.15, "#E69F00")):
            values = list(entry[f"ratios_{way}_build"].values())
            label = f"{way} building" if at == 0 else None
            ax.scatter(
                values, [at + shift] * len(values), s=9, alpha=0.6, color=colour, label=label
            )
    ax.axvline(1.0, color="#999999", linewidth=0.7)
    ax.set(xscale="log", xlabel="time as a multiple of ours")
    _plain_ticks(ax)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def growth(rows: list[Row]) -> Figure:
    """Draw time and memory over what is varied."""
    found = curves(rows)
    sweeps = list(dict.fromkeys(sweep for sweep, _ in found))
    figure = _figure(6.3, 4.0)
    grid = figure.subplots(2, len(sweeps), squeeze=False)
    known: set[str] = set()
    for column, sweep in enumerate(sweeps):
        time, memory = grid[0][column], grid[1][column]
        for (name, gap), own in found.items():
            if name != sweep:
                continue
            words = f"{100.0 * float(gap):g} % asked for" if gap else "no gap asked for"
            look = {"color": COLOURS[0 if gap or sweep == "gap" else 1], "linewidth": 1.0}
            for ended, marker in (("done", "o"), ("limit", "x")):
                points = [row for row in own if row["ended"] == ended]
                x = [float(row["value"]) for row in points]
                line = "-" if ended == "done" else ""
                new = ended == "done" and sweep != "gap" and words not in known
                label = words if new else None
                known |= {words} if new else set()
                seconds = [number(r, "total_s") for r in points]
                time.plot(x, seconds, line, marker=marker, markersize=3, label=label, **look)
                peak = [number(r, "memory_mb") for r in points]
                memory.plot(x, peak, line, marker=marker, markersize=3, **look)
                ends = [spread(r) for r in points]
                time.vlines(x, *(zip(*ends, strict=True) if ends else ([], [])), lw=3, alpha=0.35,
                            color=look["color"])  # fmt: skip
        _scales(time, sweep)
        _scales(memory, sweep)
        time.set_yscale("log")
        _plain_ticks(time)
        _plain_ticks(memory)
        memory.set_xlabel("gap asked for" if sweep == "gap" else sweep)
    if known:
        figure.legend(loc="outside upper center", ncols=len(known))
    grid[0][0].set_ylabel("time [s]\nx: time limit; bar: its runs")
    grid[1][0].set_ylabel("peak memory [MB]")
    return figure


def _scales(ax: Axes, sweep: str) -> None:
    if sweep != "chargers":
        ax.set_xscale("log")


def where_it_goes(rows: list[Row]) -> Figure:
    """Draw the shares of the parts of the work, per point of the sweeps."""
    points = [row for own in curves(rows).values() for row in own if number(row, "total_s") > 0.0]
    figure = _figure(6.3, 0.9 + 0.16 * len(points))
    ax = figure.subplots()
    left = [0.0] * len(points)
    found = [shares(row) for row in points]
    for part, colour in zip((*PARTS, "rest"), COLOURS, strict=False):
        share = [100.0 * each[part] for each in found]
        ax.barh(range(len(points)), share, left=left, color=colour, label=part, height=0.8)
        left = [a + b for a, b in zip(left, share, strict=True)]
    words = [
        f"{r['sweep']} {float(r['value']):g}"
        + ("" if r["sweep"] == "gap" or not number(r, "asked_gap") > 0.0 else ", gap")
        for r in points
    ]
    ax.margins(y=0.01)
    ax.set_yticks(range(len(points)), words)
    ax.tick_params(axis="y", labelsize=5)
    ax.invert_yaxis()
    ax.set(xlim=(0.0, 100.0), xlabel="share of the parts' sum [%]")
    figure.legend(loc="outside upper center", ncols=len(PARTS) + 1)
    return figure


def draw_all(
    rows: list[Row], summary: Row, scale_rows: list[Row], folder: Path, tail: str = ""
) -> dict[str, Path]:
    """Draw every picture there are rows for.

    Parameters
    ----------
    rows, scale_rows : list of dict
        Of the comparison and of the sweeps; either may be empty.
    summary : dict
        Of ``rows``.
    folder : Path
        Where files go; made if missing.
    tail : str
        Last part of their names.

    Returns
    -------
    dict of str to Path
        The PNG files by what they show.
    """
    import matplotlib as mpl

    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, Path] = {}
    with mpl.rc_context(STYLE):
        figures: dict[str, Figure] = {}
        if rows:
            figures |= {
                "cost-time": cost_against_time(rows, summary),
                "correct": correct_rate(summary),
            }
            if any(a["timed"] for a in summary["against"]):
                figures["ratios"] = time_ratios(summary)
            if OURS in summary["solvers"]:
                figures["gap-time"] = gap_against_time(rows, summary)
        if any(number(row, "total_s") > 0.0 for row in scale_rows):
            figures |= {"growth": growth(scale_rows), "parts": where_it_goes(scale_rows)}
        for name, figure in figures.items():
            files[name] = folder / f"benchmark-{name}{tail}.png"
            figure.savefig(files[name], dpi=DPI, metadata={"Software": None})
    return files
