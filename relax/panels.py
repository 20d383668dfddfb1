"""Owns the panels of a picture: one quantity of a plan over distance, or over charging time.

Each draws the arrays of a trace as they are on given axes, and computes nothing but what the
weather asks of the cabin's heating and cooling. Knows nothing of figures and of files.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from relax.report import ChargeTrace, PlanReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from relax.maps import Table1
    from relax.trip import Trip

__all__ = [
    "COLOUR",
    "edges_of",
    "plot_battery_heat",
    "plot_cabin_cooling",
    "plot_cabin_heat",
    "plot_power",
    "plot_soc",
    "plot_temperature",
]

Array = npt.NDArray[np.float64]

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
LIMIT_WIDTH = 3.0
"""Limits are broad and pale, so that a power at its limit shows on top [points]."""
HEADROOM = 1.6
"""Scale of the power while driving, as a multiple of the largest power: limits far beyond
it are named, not drawn, or the powers would be a flat line."""


def edges_of(trace: PlanReport | ChargeTrace) -> Array:
    """Return the abscissas between which a panel's values hold.

    Parameters
    ----------
    trace : PlanReport or ChargeTrace
        A plan with n driving steps, or a stop with K cells.

    Returns
    -------
    ndarray, shape (n + 1,) or (K + 1,)
        Borders of the steps [km], or of the cells [min].

    Examples
    --------
    >>> from relax.report import ChargeTrace
    >>> hours, none = np.array([0.0, 0.5]), np.zeros(1)
    >>> trace = ChargeTrace("A", hours, hours, hours, *[none] * 9)
    >>> edges_of(trace).tolist()
    [0.0, 30.0]
    """
    return trace.drive.node_km if isinstance(trace, PlanReport) else 60.0 * trace.time_h


def _stairs(ax: Axes, edges: Array, values: Array, name: str, label: str, style: str = "-") -> None:
    width = LIMIT_WIDTH if name == "limit" else 1.2
    colour = COLOUR[name]
    ax.stairs(
        values, edges, baseline=None, color=colour, label=label, linestyle=style, linewidth=width
    )


def _curve(trace: PlanReport | ChargeTrace, name: str) -> tuple[Array, Array]:
    """Return a state over the time at a stop, or over distance, where it jumps at every stop."""
    if isinstance(trace, ChargeTrace):
        return edges_of(trace), getattr(trace, name)
    km, values = trace.drive.node_km, getattr(trace.drive, name)
    if not trace.stops:
        return km, values
    place = np.repeat([s.position_km for s in trace.stops], 2)
    at = np.argmin(np.abs(km[:, None] - place), axis=0) + 1
    jumps = [getattr(s, f"{end}_{name}") for s in trace.stops for end in ("arrive", "depart")]
    return np.insert(km, at, place), np.insert(values, at, jumps)


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
    >>> from relax.panels import plot_soc
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> trace = ChargeTrace("A", two, np.array([0.2, 0.6]), two, *[one] * 9)
    >>> plot_soc(Figure().subplots(), trace).get_lines()[0].get_ydata().tolist()
    [20.0, 60.0]
    """
    x, y = _curve(trace, "soc")
    ax.plot(x, 100.0 * y, color=COLOUR["soc"], label="state of charge")
    ax.set_ylim(0.0, 100.0)
    ax.set_ylabel("SoC [%]")
    return ax


def plot_temperature(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the battery temperature; parameters as for ``plot_soc``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.panels import plot_temperature
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> trace = ChargeTrace("A", two, two, np.array([10.0, 20.0]), *[one] * 9)
    >>> plot_temperature(Figure().subplots(), trace).get_lines()[0].get_ydata().tolist()
    [10.0, 20.0]
    """
    x, y = _curve(trace, "temperature_c")
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
    >>> from relax.panels import plot_power
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([50.0])
    >>> ax = plot_power(Figure().subplots(), ChargeTrace("A", two, two, two, *[one] * 9))
    >>> len(ax.patches)
    3
    """
    edges = edges_of(trace)
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
    >>> from relax.panels import plot_cabin_heat
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([2.0])
    >>> trace = ChargeTrace("km 200", two, two, two, *[one] * 9)
    >>> ax = plot_cabin_heat(Figure().subplots(), trace, load_trip("paper-400km"))
    >>> [patch.get_label() for patch in ax.patches]
    ['heat pump', 'heater', 'demand']
    """
    edges, vehicle = edges_of(trace), trip.vehicle
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
    >>> from relax.panels import plot_cabin_cooling
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
    return np.array([curve.at(charger.ambient_c)]), edges_of(trace)[[0, -1]]


def plot_battery_heat(ax: Axes, trace: PlanReport | ChargeTrace) -> Axes:
    """Draw the electrical powers of battery heating and cooling; parameters as for ``plot_soc``.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from relax.panels import plot_battery_heat
    >>> from relax.report import ChargeTrace
    >>> two, one = np.array([0.0, 0.5]), np.array([2.0])
    >>> ax = plot_battery_heat(Figure().subplots(), ChargeTrace("A", two, two, two, *[one] * 9))
    >>> [patch.get_label() for patch in ax.patches]
    ['battery heating', 'battery cooling']
    """
    edges = edges_of(trace)
    powers = trace.drive if isinstance(trace, PlanReport) else trace
    _stairs(ax, edges, powers.battery_heater_kw, "heater", "battery heating")
    _stairs(ax, edges, powers.battery_cooling_kw, "cooling", "battery cooling", "--")
    ax.set_ylim(top=max(1.0, ax.get_ylim()[1]))  # or rounding would fill the panel
    ax.set_ylim(bottom=-0.03 * ax.get_ylim()[1])
    ax.set_ylabel("battery heating,\ncooling [kW]")
    return ax
