"""Owns the pictures of a plan: states and powers over distance and over charging time.

Draws the arrays of a ``PlanReport`` as they are and computes nothing but what the
weather asks of the cabin's heating and cooling. Imports matplotlib on first use and
never touches pyplot, so it needs no display. Knows nothing of how a plan was found.
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

from relax.report import ChargeTrace, PlanReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from relax.maps import Table1
    from relax.trip import Trip

__all__ = [
    "plot_battery_heat",
    "plot_cabin_cooling",
    "plot_cabin_heat",
    "plot_case",
    "plot_power",
    "plot_soc",
    "plot_temperature",
    "save_plots",
]

Array = npt.NDArray[np.float64]
Panel = Callable[["Axes", PlanReport | ChargeTrace], "Axes"]
"""Draws one panel of a column."""

BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#C4C4C4",
)  # fmt: skip
"""Colours that remain apart for the colour-blind (Okabe and Ito, 2008)."""
COLOUR = {
    "soc": BLUE,
    "temperature": RED,
    "battery": "#000000",
    "limit": GREY,
    "propulsion": SKY,
    "grid": PURPLE,
    "heater": ORANGE,
    "heat_pump": GREEN,
    "cooling": BLUE,
    "stop": "#D9D9D9",
}
"""One colour per quantity, in every panel."""
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
LIMIT_WIDTH = 3.0
"""Limits are broad and pale, so that a power at its limit shows on top [points]."""
HEADROOM = 1.6
"""Scale of the power while driving, as a multiple of the largest power: limits far beyond
it are named, not drawn, or the powers would be a flat line."""
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


# ---------------------------------------------------------------------------- panels


def _edges(trace: PlanReport | ChargeTrace) -> Array:
    """Borders of steps [km] or cells [min]."""
    return trace.drive.node_km if isinstance(trace, PlanReport) else 60.0 * trace.time_h


def _stairs(ax: Axes, edges: Array, values: Array, name: str, label: str, style: str = "-") -> None:
    width = LIMIT_WIDTH if name == "limit" else 1.2
    colour = COLOUR[name]
    ax.stairs(
        values, edges, baseline=None, color=colour, label=label, linestyle=style, linewidth=width
    )


def _with_stops(
    report: PlanReport, values: Array, before: Array, after: Array
) -> tuple[Array, Array]:
    """Curve over distance that jumps at every stop."""
    km = report.drive.node_km
    if not report.stops:
        return km, values
    place = np.repeat([s.position_km for s in report.stops], 2)
    at = np.argmin(np.abs(km[:, None] - place), axis=0) + 1
    jump = np.column_stack([before, after]).ravel()
    return np.insert(km, at, place), np.insert(values, at, jump)


def plot_soc(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the state of charge.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    trace : PlanReport or ChargeTrace
        Over distance, or over the time at one stop.

    Returns
    -------
    Axes
        The same axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.plot import plot_soc
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> trace = ChargeTrace("A", two, np.array([0.2, 0.6]), two, *[one] * 9)
    >>> plot_soc(Figure().subplots(), trace).get_lines()[0].get_ydata().tolist()
    [20.0, 60.0]
    """
    if isinstance(trace, PlanReport):
        arrive = np.array([s.arrive_soc for s in trace.stops])
        depart = np.array([s.depart_soc for s in trace.stops])
        x, y = _with_stops(trace, trace.drive.soc, arrive, depart)
    else:
        x, y = _edges(trace), trace.soc
    ax.plot(x, 100.0 * y, color=COLOUR["soc"], label="state of charge")
    ax.set_ylim(0.0, 100.0)
    ax.set_ylabel("SoC [%]")
    return ax


def plot_temperature(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the battery temperature; parameters as for ``plot_soc``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.plot import plot_temperature
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> trace = ChargeTrace("A", two, two, np.array([10.0, 20.0]), *[one] * 9)
    >>> plot_temperature(Figure().subplots(), trace).get_lines()[0].get_ydata().tolist()
    [10.0, 20.0]
    """
    if isinstance(trace, PlanReport):
        arrive = np.array([s.arrive_temperature_c for s in trace.stops])
        depart = np.array([s.depart_temperature_c for s in trace.stops])
        x, y = _with_stops(trace, trace.drive.temperature_c, arrive, depart)
    else:
        x, y = _edges(trace), trace.temperature_c
    ax.plot(x, y, color=COLOUR["temperature"], label="battery temperature")
    ax.set_ylabel("battery [°C]")
    return ax


def plot_power(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the battery power between its limits, with propulsion or grid power.

    Over distance a positive power discharges; at a stop it charges, as the axes'
    labels say. Parameters as for ``plot_soc``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.plot import plot_power
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> ax = plot_power(Figure().subplots(), ChargeTrace("A", two, two, two, *[one] * 9))
    >>> len(ax.patches)
    3
    """
    edges = _edges(trace)
    if isinstance(trace, PlanReport):
        drive = trace.drive
        _stairs(ax, edges, drive.discharge_limit_kw, "limit", "battery limits")
        _stairs(ax, edges, -drive.charge_limit_kw, "limit", "")
        _stairs(ax, edges, drive.propulsion_kw, "propulsion", "propulsion")
        _stairs(ax, edges, drive.battery_kw, "battery", "battery")
        ax.axhline(0.0, color="black", linewidth=0.4)
        _scale_power(ax, trace)
        ax.set_ylabel("discharging [kW]")
    else:
        _stairs(ax, edges, trace.limit_kw, "limit", "battery limits")
        _stairs(ax, edges, trace.grid_kw, "grid", "grid")
        _stairs(ax, edges, trace.battery_kw, "battery", "battery")
        ax.set_ylabel("charging [kW]")
        ax.set_ylim(bottom=0.0)
    return ax


def _scale_power(ax: Axes, report: PlanReport) -> None:
    """Scale to the powers, and name the limits that lie beyond."""
    drive = report.drive
    powers = np.concatenate([drive.battery_kw, drive.propulsion_kw])
    top = HEADROOM * max(float(powers.max()), 1.0)
    bottom = min(HEADROOM * float(powers.min()), -0.4 * top)
    ax.set_ylim(bottom, top)
    for name, limit, edge, place in (
        ("discharge", drive.discharge_limit_kw, top, "top"),
        ("charge", drive.charge_limit_kw, -bottom, "bottom"),
    ):
        if float(limit.min()) > edge:
            text = f"{name} limit at least {limit.min():.0f} kW"
            y = 0.97 if place == "top" else 0.03
            ax.text(0.99, y, text, transform=ax.transAxes, ha="right", va=place, fontsize=7)


def plot_cabin_heat(ax: Axes, trace: PlanReport | ChargeTrace, trip: Trip) -> Axes:
    """Draw the cabin's heat by heater (HVCH) and heat pump, stacked, against its demand.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    trace : PlanReport or ChargeTrace
        Over distance, or over the time at one stop.
    trip : Trip
        For the demand and the heater's efficiency.

    Returns
    -------
    Axes
        The same axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax import load_trip
    >>> from relax.plot import plot_cabin_heat
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([2.0])
    >>> trace = ChargeTrace("km 200", two, two, two, *[one] * 9)
    >>> ax = plot_cabin_heat(Figure().subplots(), trace, load_trip("paper-400km"))
    >>> [patch.get_label() for patch in ax.patches]
    ['heat pump', 'heater', 'demand']
    """
    edges, vehicle = _edges(trace), trip.vehicle
    powers = trace.drive if isinstance(trace, PlanReport) else trace
    pump = powers.heat_pump_heat_kw
    both = pump + vehicle.heater_cabin_efficiency * powers.cabin_heater_kw
    for top, base, name, label in (
        (pump, np.zeros_like(pump), "heat_pump", "heat pump"),
        (both, pump, "heater", "heater"),
    ):
        ax.stairs(top, edges, baseline=base, fill=True, color=COLOUR[name], label=label, alpha=0.75)
    demand, x = _by_weather(vehicle.cabin_heating_kw, trace, trip)
    ax.stairs(demand, x, baseline=None, color="black", linestyle=":", linewidth=1.0, label="demand")
    ax.set_ylabel("cabin heat [kW]")
    ax.set_ylim(0.0, max(1.0, 1.05 * float(max(both.max(), demand.max()))))
    return ax


def plot_cabin_cooling(ax: Axes, trace: PlanReport | ChargeTrace, trip: Trip) -> Axes:
    """Draw the electrical power of cabin cooling; parameters as for ``plot_cabin_heat``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax import load_trip
    >>> from relax.plot import plot_cabin_cooling
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([2.0])
    >>> trace = ChargeTrace("km 200", two, two, two, *[one] * 9)
    >>> hot = load_trip("paper-400km", overrides={"route.ambient_c": 32.0})
    >>> ax = plot_cabin_cooling(Figure().subplots(), trace, hot)
    >>> round(float(ax.patches[0].get_data().values[0]), 6)
    1.0
    """
    power, x = _by_weather(trip.vehicle.cabin_cooling_kw, trace, trip)
    _stairs(ax, x, power, "cooling", "cabin cooling")
    ax.set_ylabel("cabin cooling [kW]")
    ax.set_ylim(0.0, max(1.0, 1.05 * float(power.max())))
    return ax


def _by_weather(curve: Table1, trace: PlanReport | ChargeTrace, trip: Trip) -> tuple[Array, Array]:
    """Return a power over the ambient temperature, and the borders between which it holds."""
    if isinstance(trace, PlanReport):
        return curve(trip.route.ambient_c), trip.route.node_km
    charger = next(c for c in trip.chargers if c.name == trace.charger)
    return np.array([curve.at(charger.ambient_c)]), _edges(trace)[[0, -1]]


def plot_battery_heat(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the electrical powers of battery heating and cooling; parameters as for ``plot_soc``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.plot import plot_battery_heat
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([2.0])
    >>> ax = plot_battery_heat(Figure().subplots(), ChargeTrace("A", two, two, two, *[one] * 9))
    >>> [patch.get_label() for patch in ax.patches]
    ['battery heating', 'battery cooling']
    """
    edges = _edges(trace)
    powers = trace.drive if isinstance(trace, PlanReport) else trace
    _stairs(ax, edges, powers.battery_heater_kw, "heater", "battery heating")
    _stairs(ax, edges, powers.battery_cooling_kw, "cooling", "battery cooling", "--")
    ax.set_ylim(top=max(1.0, ax.get_ylim()[1]))  # or rounding would fill the panel
    ax.set_ylim(bottom=-0.03 * ax.get_ylim()[1])
    ax.set_ylabel("battery heating,\ncooling [kW]")
    return ax


# ---------------------------------------------------------------------------- figures


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
    edges = _edges(trace)
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
