"""Owns the figures of the experiments: fronts, cases, sweep. Draws what the rows hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from benchmarks.paper.cases import Found, case_trip
from benchmarks.paper.published import (
    AMBIENT_C,
    ENERGY_AT_MIN,
    ENERGY_KWH,
    HEAT_PUMP_KW,
    LEAST_TIME_MIN,
)
from benchmarks.paper.sweep import Point
from relax.plot import STYLE, plot_case
from relax.report import PlanReport

__all__ = ["case_figure", "front_figure", "save", "sweep_figure"]

COLOUR = {0.0: "#000000", 1.0: "#E69F00", 3.0: "#0072B2"}
"""By heat pump; apart for the colour-blind."""
LABEL = {0.0: "no heat pump", 1.0: "1 kW", 3.0: "3 kW"}
DASH = {0.0: "-", 1.0: "-", 3.0: (0, (4, 2))}
"""The larger heat pump often covers the smaller one: both remain visible."""
DPI = 160
CABIN_ROW = 3
"""Row of ``plot_case`` that holds the cabin's heat."""
ROOM_MIN = 16.0
"""Widest axis of time [min]: what lies beyond is flat."""
Row = Mapping[str, Any]


def front_figure(fronts: Mapping[tuple[float, float], Row]) -> Figure:
    """Return charged energy over charging and detour time, one panel per ambient temperature.

    Parameters
    ----------
    fronts : mapping
        Rows by ambient temperature and heat pump.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.2), layout="constrained")
        panels = figure.subplots(1, len(AMBIENT_C))
        for ax, ambient in zip(panels, AMBIENT_C, strict=True):
            first = min(
                (60.0 * r["points"][0]["time_h"] for (t, _), r in fronts.items() if t == ambient),
                default=0.0,
            )
            for pump in HEAT_PUMP_KW:
                row = fronts.get((ambient, pump))
                if row is None:
                    continue
                x = [60.0 * p["time_h"] for p in row["points"]]
                y = [p["value"] for p in row["points"]]
                low = [p["lower_bound"] for p in row["points"]]
                colour = COLOUR[pump]
                ax.plot(x, y, color=colour, linestyle=DASH[pump], marker=".", markersize=3,
                        label=LABEL[pump])  # fmt: skip
                ax.fill_between(x, low, y, color=colour, alpha=0.12, linewidth=0.0)
                ax.plot(ENERGY_AT_MIN[ambient], ENERGY_KWH[ambient, pump], "o", color=colour,
                        markerfacecolor="none", markersize=6)  # fmt: skip
                ax.axvline(LEAST_TIME_MIN[ambient, pump], color=colour, linestyle=":",
                           linewidth=0.8)  # fmt: skip
            ax.set_title(f"{ambient:.0f} °C")
            ax.set_xlim(first - 0.7, min(ax.get_xlim()[1], first + ROOM_MIN))
            ax.set_xlabel("charging and detour time [min]")
        panels[0].set_ylabel("charged energy [kWh]")
        panels[-1].legend(loc="upper right")
    return figure


def case_figure(found: Found) -> Figure:
    """Return the trajectories of a case over distance and over charging time."""
    case = found.case
    aim = {"energy": "least energy", "time": "least time", "cost": "40 SEK/h"}[case.aim]
    pump = "no heat pump" if case.heat_pump_kw == 0.0 else f"heat pump {case.heat_pump_kw:.0f} kW"
    trip = replace(case_trip(case), name=f"Case {case.name}, {aim}, {pump}, -10 °C")
    figure = plot_case(found.report, trip)
    with rc_context(STYLE):
        _add_pump_power(figure, found.report)
    return figure


def _add_pump_power(figure: Figure, report: PlanReport) -> None:
    """Draw the heat pump's own power over its heat, as the paper does."""
    columns = 1 + len(report.charge)
    row = figure.axes[CABIN_ROW * columns : (CABIN_ROW + 1) * columns]
    for ax, edges, power in zip(
        row,
        [report.drive.node_km, *(60.0 * c.time_h for c in report.charge)],
        [report.drive.heat_pump_kw, *(c.heat_pump_kw for c in report.charge)],
        strict=True,
    ):
        ax.stairs(
            power,
            edges,
            baseline=None,
            color="black",
            linewidth=1.0,
            label="power of the heat pump",
        )
    handles, labels = row[0].get_legend_handles_labels()
    row[0].legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0),
                  borderaxespad=0.2, ncols=len(labels))  # fmt: skip


def sweep_figure(found: Iterable[Point]) -> Figure:
    """Return charged energy, number of stops and saving over ambient temperature."""
    every = list(found)
    with rc_context(STYLE):
        figure = Figure(figsize=(6.5, 6.0), layout="constrained")
        top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1.2, 2))
        for pump in HEAT_PUMP_KW:
            own = [p for p in every if p.heat_pump_kw == pump]
            x = [p.ambient_c for p in own]
            look: dict[str, Any] = {"color": COLOUR[pump], "linestyle": DASH[pump]}
            top.plot(x, [p.grid_kwh for p in own], label=LABEL[pump], **look)
            middle.step(x, [len(p.stops) for p in own], where="mid", **look)
            saved = [(p.ambient_c, p.saving) for p in own if p.saving is not None]
            if saved:
                bottom.plot(*zip(*saved, strict=True), **look)
        top.set_ylabel("charged energy [kWh]")
        top.legend()
        middle.set_ylabel("stops")
        middle.yaxis.set_major_locator(MaxNLocator(integer=True))
        middle.set_ylim(0.0, 3.0)
        bottom.set_ylabel("saving [%]")
        bottom.set_xlabel("ambient temperature [°C]")
    return figure


def save(figure: Figure, folder: Path, stem: str) -> list[Path]:
    """Write a figure as PNG and SVG; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{stem}.png", folder / f"{stem}.svg"]
    with rc_context(STYLE):
        figure.savefig(paths[0], dpi=DPI)
        figure.savefig(paths[1], metadata={"Date": None})
    return paths
