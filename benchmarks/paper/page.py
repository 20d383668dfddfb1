"""Owns the page ``docs/paper.md``: everything on it is made of the kept rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from benchmarks.paper.cases import Found
from benchmarks.paper.claims import markdown as claims_markdown
from benchmarks.paper.claims import verdicts
from benchmarks.paper.published import SWEEP_TIME_VALUE_PER_H
from benchmarks.paper.sweep import Point, switches
from benchmarks.paper.sweep import markdown as sweep_markdown
from benchmarks.paper.tables import GOALS, Cell, goals_met, note
from benchmarks.paper.tables import markdown as table_markdown

__all__ = ["Made", "page"]

COMMAND = "python -m benchmarks.paper"
LETTERS = {0.0: "no heat pump", 1.0: "1 kW", 3.0: "3 kW"}


@dataclass(frozen=True)
class Made:
    """Where and how the rows were made.

    Parameters
    ----------
    date : str
        Day of the page.
    machine : str
        Processor.
    versions : mapping of str to str
        Python and packages.
    count : int
        Certified optimisations.
    seconds : float
        Their times added up [s].
    wall_s : float or None
        Wall-clock time, if all were made in one run [s].
    workers : int
        Processes of that run.
    """

    date: str
    machine: str
    versions: Mapping[str, str]
    count: int
    seconds: float
    wall_s: float | None
    workers: int


def _cases(found: Sequence[Found]) -> str:
    lines = [
        "| case | heat pump | stops: paper | best other | difference | verdict | best plan of all "
        "| no plan below | gap |",
        "|---|---|---|---|---:|---|---:|---:|---:|",
    ]
    for f in found:
        stops = " + ".join(str(i + 1) for i in f.case.stops)
        other = " + ".join(str(i + 1) for i in f.other)
        aim = {"energy": "least energy", "time": "least time", "cost": "40 SEK/h"}[f.case.aim]
        lines.append(
            f"| {f.case.name}, {aim} | {LETTERS[f.case.heat_pump_kw]} | {stops} | {other} "
            f"| {f.margin:+.2f} {f.unit} | {f.verdict} | {f.at.value:.2f} {f.unit} "
            f"| {f.at.lower_bound:.2f} {f.unit} | {100.0 * f.at.gap:.1f} % |"
        )
    return "\n".join(lines)


def _switches(points: Sequence[Point]) -> str:
    lines = []
    for pump, name in LETTERS.items():
        found = switches(points, pump)
        told = "; ".join(f"{a} to {b} at {t:.1f} °C" for t, a, b in found)
        lines.append(f"- {name}: {told or 'the same stops everywhere'}")
    return "\n".join(lines)


def page(cells: Sequence[Cell], cases: Sequence[Found], points: Sequence[Point], made: Made) -> str:
    """Return the page.

    Parameters
    ----------
    cells : sequence of Cell
        The two tables.
    cases : sequence of Found
        Cases A to E.
    points : sequence of Point
        The sweep.
    made : Made
        Where it comes from.
    """
    versions = ", ".join(f"{k} {v}" for k, v in made.versions.items())
    wall = (
        f"{made.wall_s:.0f} s on {made.workers} processes"
        if made.wall_s is not None
        else f"made in several runs, {made.seconds:.0f} s of work in all"
    )
    met = "All 18 are" if goals_met(list(cells)) else "Not all of them are"
    missed = [c for c in cells if not c.met]
    missing = "".join(
        f" Outside: {c.table}, {c.ambient_c:.0f} °C, {LETTERS[c.heat_pump_kw]}." for c in missed
    )
    gaps = [p.gap for p in points]
    figures = "\n\n".join(
        f"![Case {f.case.name}](figures/paper-case-{f.case.name}.png)" for f in cases
    )
    parts = [
        "# The paper's experiments, repeated",
        f"Written by `{COMMAND}` on {made.date}; do not edit. {made.count} certified values, "
        f"{wall}. {made.machine}; {versions}.",
        'The paper: A. Hamednia et al., "Optimal Thermal Management and Charging of Battery '
        'Electric Vehicles over Long Trips" (2022). Its maps are unpublished: the car is a '
        "calibration to the two tables below ([how, and what they determine](paper-calibration.md)"
        "). Agreement with the tables is therefore no evidence for single maps; the sweep was not "
        'fitted. Every value is that of a plan driven on the continuous model; "no plan below" '
        "is proved, for every choice of stops and every control, on the transcription.",
        "## Charged energy within a time",
        table_markdown(list(cells), "energy"),
        note(list(cells)),
        "## Least charging and detour time",
        table_markdown(list(cells), "time"),
        "*Of its values*: the saving that follows from the paper's rounded values; at 10 °C the "
        "energy's is not the one printed beside them.",
        f"Goals: energies within {GOALS['energy']:.0f} %, times within {GOALS['time']} min, "
        f"savings within {GOALS['saving']:.0f} percentage point. {met} within them.{missing}",
        "## Energy against time",
        "![Fronts](figures/paper-front.png)",
        "Lines: plans found. Shade: down to the proved bound. Circles and dotted lines: the "
        "paper's energies and least times. A point is certified if no plan is better by more than "
        "1 % in energy *and* time, so that near the upright left end the bound of the energy alone "
        "lies further below.",
        "## Cases A to E, -10 °C",
        "Stops are numbered 1 to 3, at km 100, 200 and 300. *Difference*: the best plan with the "
        "paper's stops less the best with any others, so negative means that the paper's are "
        "better; below 0.1 kWh or 0.1 min it is called a tie. The figures show the best plan with "
        "the paper's stops.",
        _cases(cases),
        figures,
        f"## Ambient temperature, {SWEEP_TIME_VALUE_PER_H:.0f} SEK/h",
        "Not fitted: what comes out is a prediction of the calibrated car. The paper shows its "
        "curves only as a picture. Kinks at -10, 0, 10 and 20 °C are those of the cabin's demand, "
        "which was fitted at the first three and assumed in between and beyond. "
        + (
            f"{len(gaps)} plans, largest certified gap {100.0 * max(gaps):.1f} % of the cost."
            if gaps
            else "No plans yet."
        ),
        "![Sweep](figures/paper-sweep.png)",
        sweep_markdown(points),
        "Changes of the stops, from cold to warm:",
        _switches(points),
        "## What of the paper is confirmed",
        claims_markdown(verdicts(cells, cases)),
    ]
    return "\n\n".join(p for p in parts if p) + "\n"
