"""Owns a result as text for people: stops, time and cost, energy, what is proved, and why.

Reads a ``Result`` and turns it into aligned plain text; decides nothing and
computes no cost. What is not known is shown as ``-``, never as 0.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from enumerate.gap import is_proved, relative_gap
from enumerate.ledger import REFUSED
from enumerate.result import Result, Status
from enumerate.show_choices import format_choices, format_unused
from enumerate.table import MISSING, clock, minutes, number, paragraph, percent, table, unbroken

if TYPE_CHECKING:
    from relax.report import PlanReport
    from relax.trip import Charger, Trip

__all__ = ["format_result"]

USES = {
    "propulsion_and_auxiliaries": "propulsion and auxiliaries",
    "refused_recuperation": "recuperation the battery could not take",
    "cabin_heater": "cabin heating by heater",
    "heat_pump": "cabin heating by heat pump",
    "cabin_cooling": "cabin cooling",
    "battery_heater": "battery heating",
    "battery_cooling": "battery cooling",
    "loss": "losses in the battery",
    "detours": "detours",
}
"""Energies that add up to what grid and battery gave, and how to call them."""
ALONE = (("refused_recuperation",), ("cabin_heater", "heat_pump"), ("cabin_cooling",))
"""Uses listed only if one of their group took any: weather and road decide whether."""
LEAST_KWH = 0.005
"""Less is printed as 0.00 [kWh]."""


def format_result(result: Result, trip: Trip | None = None) -> str:
    """Return a result as text: the plan, what it costs, what is proved, and why.

    Parameters
    ----------
    result : Result
        From ``plan``.
    trip : Trip, optional
        The trip it was made from; with it, costs are split by cause.

    Returns
    -------
    str
        Lines of at most 80 characters, without a newline at the end.

    Examples
    --------
    >>> from enumerate import format_result, plan
    >>> from relax import load_trip
    >>> trip = load_trip("paper-400km", overrides={"route.ambient_c": 10})
    >>> text = format_result(plan(trip), trip)
    >>> "start" in text and "destination" in text
    True
    """
    parts = [_title(result), _status(result)]
    if result.plan is not None:
        parts += [
            _waypoints(result.plan),
            _charging(result.plan, result.currency),
            _sums(result.plan, result.currency, trip),
            _energy(result.plan),
        ]
    elif result.status is Status.INFEASIBLE or not result.interrupted:
        parts.append(_no_plan(result))
    parts += [format_choices(result), format_unused(result), _bound(result), _timing(result)]
    return "\n\n".join(part for part in parts if part)


# ---------------------------------------------------------------------------- parts


def _title(result: Result) -> str:
    if result.plan is None:
        return paragraph("", f"{result.trip}: no plan", 0)
    names = ", ".join(unbroken(s.charger) for s in result.plan.stops) or "none needed"
    cost = f"{number(result.cost, 2)} {result.currency}"
    return paragraph("", f"{result.trip}: {cost}; stops: {names}", 0)


def _status(result: Result) -> str:
    within = f"{percent(result.optimal_gap, 2)} %"
    asked = "" if result.asked_gap else "; --gap asks for a proof"
    text = {
        Status.OPTIMAL: f"optimal: proved to be within {within} of the best; the plan keeps every "
        "limit when driven on the continuous model",
        Status.FEASIBLE: "feasible: the plan keeps every limit when driven on the continuous "
        f"model; it is not proved to be within {within} of the best{asked}",
        Status.INFEASIBLE: "infeasible: for each choice of stops it is proved that no plan exists",
        Status.UNKNOWN: "unknown: no plan was found, and none is ruled out",
    }[result.status]
    grid = result.grid
    finer = f"--set grid.step_km={0.5 * grid.step_km:g} --set grid.cells={2 * grid.cells}"
    refused = any(row.reason.startswith(REFUSED) for row in result.ledger.rows)
    if result.status is Status.UNKNOWN and refused:
        text = (
            "unknown: of the plans found none keeps every limit when driven on the continuous "
            f"model, and none is ruled out; a finer grid may give one ({finer})"
        )
    on_grid = min([result.transcribed_cost, *(row.cost for row in result.ledger.rows)])
    least = min(result.cost, on_grid)
    complete = is_proved(least, least, result.lower_bound, result.optimal_gap)
    if result.status is Status.FEASIBLE and complete:
        apart = percent(relative_gap(max(result.cost, on_grid), least), 2)
        text = (
            "feasible: the plan keeps every limit when driven on the continuous model; the proof "
            "on the grid is complete, but this drive and the cheapest plan there differ by "
            f"{apart} %: a finer grid brings them nearer ({finer})"
        )
    if result.interrupted:
        text += f" ({result.interrupted}: this is what was known by then)"
    return paragraph("status", text + ".")


def _waypoints(plan: PlanReport) -> str:
    """Return clock, charge and battery temperature at start, stops and destination."""
    head = (
        "waypoint", "km", "drive\nh:mm", "arrive\nh:mm", "depart\nh:mm", "SoC\nin\n%", "\nout\n%",
        "battery\nin\n°C", "\nout\n°C",
    )  # fmt: skip
    drive = plan.drive
    hours = np.concatenate([[0.0], np.cumsum(drive.duration_h)])
    none = MISSING
    start = [
        "start", number(float(drive.node_km[0])), none, none, clock(0.0), none,
        percent(float(drive.soc[0])), none, number(float(drive.temperature_c[0])),
    ]  # fmt: skip
    rows, before = [start], 0.0
    for stop in plan.stops:
        driven = float(np.interp(stop.position_km, drive.node_km, hours))
        rows.append(
            [
                stop.charger, number(stop.position_km), clock(driven - before),
                clock(stop.arrive_h), clock(stop.depart_h),
                percent(stop.arrive_soc), percent(stop.depart_soc),
                number(stop.arrive_temperature_c), number(stop.depart_temperature_c),
            ]
        )  # fmt: skip
        before = driven
    end = [
        "destination", number(float(drive.node_km[-1])), clock(float(hours[-1]) - before),
        clock(plan.total_h), none, percent(plan.final_soc), none,
        number(plan.final_temperature_c), none,
    ]  # fmt: skip
    return table(head, [*rows, end])


def _charging(plan: PlanReport, currency: str) -> str:
    """Return time, energy and cost of every stop, and their sums."""
    if not plan.stops:
        return ""
    head = (
        "stop", "charge\nmin", "detour\nmin", "grid\nkWh", "average\nkW", f"energy\n{currency}",
        f"cost\n{currency}",
    )  # fmt: skip
    rows = [
        [
            s.charger, minutes(s.dwell_h), minutes(s.detour_h), number(s.grid_kwh, 2),
            number(s.average_kw), number(s.energy_cost, 2), number(s.cost, 2),
        ]
        for s in plan.stops
    ]  # fmt: skip
    if len(rows) > 1:
        mean = plan.grid_kwh / plan.charging_h if plan.charging_h else None
        rows.append(
            [
                "in all", minutes(plan.charging_h), minutes(plan.detour_h),
                number(plan.grid_kwh, 2), number(mean),
                number(sum(s.energy_cost for s in plan.stops), 2),
                number(sum(s.cost for s in plan.stops), 2),
            ]
        )  # fmt: skip
    return table(head, rows)


def _sums(plan: PlanReport, currency: str, trip: Trip | None) -> str:
    """Return the sums of time and of cost, by cause."""
    time = (
        f"{clock(plan.total_h)} h in all: driving {clock(plan.driving_h)} h, charging "
        f"{minutes(plan.charging_h)} min, detours {minutes(plan.detour_h)} min"
    )
    split = ", ".join(f"{name} {number(cost, 2)}" for name, cost in _cost_split(plan, trip))
    total = sum(s.cost for s in plan.stops)
    cost = f"{number(total, 2)} {currency}" + (f": {split}" if plan.stops else ": no stop")
    return paragraph("time", time) + "\n" + paragraph("cost", cost)


def _cost_split(plan: PlanReport, trip: Trip | None) -> list[tuple[str, float]]:
    """Costs by cause; they add up to the cost of the plan."""
    energy = sum(s.energy_cost for s in plan.stops)
    if trip is None:
        rest = sum(s.cost for s in plan.stops) - energy
        return [("energy", energy), ("time, occupancy and penalties", rest)]
    known: dict[str, Charger] = {c.name: c for c in trip.chargers}
    used = [(s, known[s.charger]) for s in plan.stops]
    return [
        ("energy", energy),
        ("charging time", trip.time_value_per_h * plan.charging_h),
        ("detour time", trip.time_value_per_h * plan.detour_h),
        (
            "occupancy",
            sum(
                c.occupancy_price_per_h * max(0.0, s.dwell_h - c.occupancy_free_h) for s, c in used
            ),
        ),
        ("penalties", sum(c.stop_penalty for _, c in used)),
    ]


def _energy(plan: PlanReport) -> str:
    """Return where the energy came from and where it went."""
    totals = plan.totals_kwh
    cooling = totals.get("cabin_cooling", 0.0)  # plans kept from before do not say
    rest = totals["propulsion_and_auxiliaries"] - cooling
    uses = {**totals, "propulsion_and_auxiliaries": rest, "cabin_cooling": cooling}
    used = sum(uses[use] for use in USES)
    idle = {u for group in ALONE if all(uses[u] < LEAST_KWH for u in group) for u in group}
    rows = [
        [name, number(uses[use], 2), percent(uses[use] / used if used else None)]
        for use, name in USES.items()
        if use not in idle
    ]
    rows.append(["in all", number(used, 2), percent(1.0)])
    rows.append(["  of it from the grid", number(totals["grid"], 2), ""])
    rows.append(["  of it from the battery", number(used - totals["grid"], 2), ""])
    text = table(("energy", "kWh", "%"), rows)
    if totals["heat_pump"] >= LEAST_KWH:
        heat, cop = totals["heat_pump_heat"], totals["heat_pump_heat"] / totals["heat_pump"]
        text += "\n" + (
            f"The heat pump gave the cabin {number(heat, 2)} kWh of heat, "
            f"{number(cop, 2)} times what it used."
        )
    return text


def _no_plan(result: Result) -> str:
    """Return why there is no plan, how far the car gets and what would help."""
    diagnosis = result.diagnosis
    if diagnosis is None:
        return ""
    lines = [paragraph("reason", diagnosis.reason + ".")]
    if diagnosis.remedies:
        lines.append(paragraph("remedy", "each by itself would help, by estimate:"))
        lines += [paragraph("        -", remedy, 10) for remedy in diagnosis.remedies]
    return "\n".join(lines)


def _bound(result: Result) -> str:
    """Return what is proved, for what, and how far the transcription is from the drive."""
    if not isfinite(result.lower_bound):
        if result.status is Status.INFEASIBLE:
            return ""
        return paragraph("bound", "none is known.")
    text = (
        f"no plan costs less than {number(result.lower_bound, 2)} {result.currency}, whatever its "
        "stops and controls: proved on the transcription"
    )
    if result.plan is None:
        return paragraph("bound", text + ".")
    text += f" ({result.plan.drive.duration_h.size} driving steps"
    text += f", {result.plan.charge[0].grid_kw.size} cells per stop)" if result.plan.charge else ")"
    lines = [paragraph("bound", text + ".")]
    change = result.plan.deviation
    lines.append(
        paragraph(
            "gap",
            f"{percent(result.gap, 2)} % between this bound and the cost, which is that of the "
            f"drive on the continuous model. Drive and transcription differ by "
            f"{percent(abs(change.cost), 3)} % of the cost and by at most "
            f"{percent(change.soc, 3)} % SoC and {number(change.temperature_k, 2)} K.",
        )
    )
    return "\n".join(lines)


def _timing(result: Result) -> str:
    phases = {k: v for k, v in result.timings_s.items() if k != "total"}
    total = result.timings_s.get("total")
    text = ", ".join(f"{name} {number(seconds, 2)}" for name, seconds in phases.items())
    return paragraph("solve", f"{number(total, 2)} s" + (f": {text}" if text else ""))
