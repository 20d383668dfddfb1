"""Owns the pictures of a plan: its panels side by side, over distance and over charging time.

Imports matplotlib on first use and never touches pyplot, so it needs no display. Knows
nothing of how a plan was found.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from relax.panels import (
    COLOUR,
    edges_of,
    plot_battery_heat,
    plot_cabin_cooling,
    plot_cabin_heat,
    plot_power,
    plot_soc,
    plot_temperature,
)
from relax.report import ChargeTrace, PlanReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from relax.trip import Trip

__all__ = ["plot_case", "save_plots"]

Panel = Callable[["Axes", PlanReport | ChargeTrace], "Axes"]
"""Draws one panel of a column."""

STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "evrelax",
    "svg.fonttype": "none",
}
BAND = 0.004
"""Half width of a stop's band, as a share of the route; a stop itself has no length."""
TITLE_WIDTH = 22
"""Longest line of the title above a stop [characters]."""
LEAST_KW = 1e-3
"""Less than this is no demand of the cabin but rounding of its table."""
ROW_INCHES = 1.64
"""Height of a row of panels."""
DPI = 200


class HasPlan(Protocol):
    """A result of a search, as far as a picture needs it."""

    @property
    def plan(self) -> PlanReport | None:
        """The plan, if there is one."""


def plot_case(result: HasPlan | PlanReport, trip: Trip, max_stops: int = 6) -> Figure:
    """Draw a plan: over distance on the left, over charging time at each stop beside it.

    Parameters
    ----------
    result : Result or PlanReport
        With a plan.
    trip : Trip
        The trip it was made from.
    max_stops : int
        Stops drawn over charging time, the first ones of the plan.

    Returns
    -------
    Figure
        A row each: SoC, battery temperature, battery power, cabin heat and cabin
        cooling where the weather asks for them, battery heating and cooling. Not
        registered with pyplot.

    Raises
    ------
    ValueError
        There is no plan.

    Examples
    --------
    >>> from enumerate import plan
    >>> from relax import load_trip, plot_case
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> figure = plot_case(plan(trip), trip)
    >>> figure.axes[0].get_ylabel()
    'SoC [%]'
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    report = result if isinstance(result, PlanReport) else result.plan
    if report is None:
        raise ValueError("there is no plan to draw")
    stops = report.charge[:max_stops]
    panels = _panels(report, trip)
    with mpl.rc_context(STYLE):
        size = (6.0 + 1.6 * len(stops), ROW_INCHES * len(panels))
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(
            len(panels),
            1 + len(stops),
            squeeze=False,
            sharex="col",
            gridspec_kw={"width_ratios": [3.3] + [1.0] * len(stops)},
        )
        _column(grid[:, 0], report, panels)
        _mark_stops(grid[:, 0], report)
        grid[0, 0].set_title(f"{trip.name}: driving", parse_math=False)
        grid[-1, 0].set_xlabel("distance [km]")
        for column, trace in zip(grid.T[1:], stops, strict=True):
            _column(column, trace, panels)
            title = textwrap.fill(f"charging: {trace.charger}", TITLE_WIDTH)
            column[0].set_title(title, parse_math=False)
            column[-1].set_xlabel("charging time [min]")
        _align(grid)
        figure.align_ylabels(grid[:, 0])
    return figure


def _panels(report: PlanReport, trip: Trip) -> list[Panel]:
    """Return what to draw, from top to bottom: of the cabin only what the weather asks for."""
    used = {s.charger for s in report.stops}
    parked = [c.ambient_c for c in trip.chargers if c.name in used]
    ambient = np.concatenate([trip.route.ambient_c, parked])
    panels: list[Panel] = [plot_soc, plot_temperature, plot_power]
    if np.any(trip.vehicle.cabin_heating_kw(ambient) > LEAST_KW):
        panels.append(partial(plot_cabin_heat, trip=trip))
    if np.any(trip.vehicle.cabin_cooling_kw(ambient) > LEAST_KW):
        panels.append(partial(plot_cabin_cooling, trip=trip))
    return [*panels, plot_battery_heat]


def _column(axes: npt.NDArray[Any], trace: PlanReport | ChargeTrace, panels: list[Panel]) -> None:
    """Fill one column of panels."""
    for ax, draw in zip(axes, panels, strict=True):
        draw(ax, trace)
    edges = edges_of(trace)
    for ax in axes:
        ax.set_xlim(float(edges[0]), float(edges[-1]))


def _mark_stops(axes: npt.NDArray[Any], report: PlanReport) -> None:
    """Draw a band at every stop."""
    half = BAND * float(report.drive.node_km[-1])
    for ax in axes:
        for stop in report.stops:
            at = stop.position_km
            ax.axvspan(at - half, at + half, color=COLOUR["stop"], linewidth=0.0, zorder=0)


def _align(grid: npt.NDArray[Any]) -> None:
    """Give each row one scale and one legend; the power row keeps two, as its signs differ."""
    for row, axes in enumerate(grid):
        same = list(axes) if row != 2 else list(axes[1:])
        limits = np.array([ax.get_ylim() for ax in same])
        for ax in same:
            ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())
        for ax in axes[2 if row == 2 else 1 :]:
            ax.tick_params(labelleft=False)
            ax.set_ylabel("")
    for axes in grid[2:]:
        named: dict[str, Any] = {}
        for ax in axes:
            handles, labels = ax.get_legend_handles_labels()
            named |= {k: h for h, k in zip(handles, labels, strict=True) if k not in named}
        # below the panel above, which ends with its axis: room between the rows is the layout's
        axes[0].legend(
            list(named.values()),
            list(named),
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            borderaxespad=0.2,
            ncols=len(named),
        )


def save_plots(result: HasPlan | PlanReport, trip: Trip, directory: str | Path) -> list[Path]:
    """Draw a plan into files.

    Parameters
    ----------
    result : Result or PlanReport
        With a plan.
    trip : Trip
        The trip it was made from.
    directory : str or Path
        Folder, made if missing.

    Returns
    -------
    list of Path
        The files: PNG with 200 dots per inch, and SVG.

    Raises
    ------
    ValueError
        There is no plan.
    OSError
        The folder cannot be written to.

    Examples
    --------
    >>> import tempfile
    >>> from enumerate import plan
    >>> from relax import load_trip, save_plots
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.suffix for path in save_plots(plan(trip), trip, folder)]
    ['.png', '.svg']
    """
    import matplotlib as mpl

    figure = plot_case(result, trip)
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    stem = re.sub(r"[^\w.-]+", "-", trip.name).strip("-.") or "trip"
    paths = [folder / f"{stem}.png", folder / f"{stem}.svg"]
    with mpl.rc_context(STYLE):
        figure.savefig(paths[0], dpi=DPI)
        figure.savefig(paths[1], metadata={"Date": None})
    return paths
