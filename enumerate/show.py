"""Owns a result as text for people: stop table, sums, comparison of subsets, bound, reasons.

Reads a ``Result`` and turns it into aligned plain text; decides nothing and
computes no cost. What is not known is shown as ``-``, never as 0.
"""

from __future__ import annotations

import textwrap
from itertools import combinations
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from enumerate.gap import relative_gap
from enumerate.ledger import Outcome, Row
from enumerate.result import Result, Status
from enumerate.subset import Subset
from enumerate.table import MISSING, WIDTH, clock, minutes, number, paragraph, percent, table

if TYPE_CHECKING:
    from relax.report import PlanReport, StopReport
    from relax.trip import Charger, Trip

__all__ = ["format_result"]

MAX_ROWS = 16
"""Rows listed one by one; of more, the best ones and a line per outcome for the others."""
FEW_NAMES = 2
"""Up to this many undecided chargers are named."""
FEW_MEMBERS = 64
"""Up to this many subsets of a family are looked through, to name a single one that is left."""

USES = {
    "propulsion_and_auxiliaries": "propulsion and auxiliaries",
    "refused_recuperation": "recuperation the battery could not take",
    "cabin_heater": "cabin heating by heater",
    "heat_pump": "cabin heating by heat pump",
    "battery_heater": "battery heating",
    "battery_cooling": "battery cooling",
    "loss": "losses in the battery",
    "detours": "detours",
}
"""Energies that add up to what grid and battery gave, and how to call them."""


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
        Lines of at most 100 characters, without a newline at the end.

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
            _stops(result.plan, result.currency),
            _sums(result.plan, result.currency, trip),
            _energy(result.plan),
        ]
    elif result.status is Status.INFEASIBLE or not result.interrupted:
        parts.append(_no_plan(result))
    parts += [_subsets(result), _unused(result), _bound(result), _timing(result)]
    return "\n\n".join(part for part in parts if part)


# ---------------------------------------------------------------------------- parts


def _title(result: Result) -> str:
    if result.plan is None:
        return f"{result.trip}: no plan"
    names = ", ".join(s.charger for s in result.plan.stops) or "none needed"
    return paragraph(
        "", f"{result.trip}: {number(result.cost, 2)} {result.currency}; stops: {names}"
    ).lstrip()


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
    apart = 0.0 if result.plan is None else abs(result.plan.deviation.cost)
    enough = result.optimal_gap
    if result.status is Status.FEASIBLE and enough < apart and result.gap < enough + apart:
        text = (
            "feasible: the plan keeps every limit when driven on the continuous model; what is "
            f"proved on the grid says nothing finer than the {percent(apart, 2)} % by which drive "
            "and grid differ: a finer grid brings them together (--set grid.cells=..., "
            "--set grid.step_km=...)"
        )
    if result.interrupted:
        text += f" ({result.interrupted}: this is what was known by then)"
    return paragraph("status", text + ".")


def _stops(plan: PlanReport, currency: str) -> str:
    """Return the stop table, with start and destination."""
    head = (
        "waypoint", "km", "drive\nh:mm", "arrive\nh:mm", "depart\nh:mm", "SoC\nin\n%", "\nout\n%",
        "charge\nmin", "grid\nkWh", "avg\nkW", "batt\nin\n°C", "\nout\n°C", f"cost\n{currency}",
    )  # fmt: skip
    drive = plan.drive
    hours = np.concatenate([[0.0], np.cumsum(drive.duration_h)])
    none = MISSING
    start = [
        "start", number(float(drive.node_km[0])), none, none, clock(0.0), none,
        percent(float(drive.soc[0])), none, none, none, none,
        number(float(drive.temperature_c[0])), none,
    ]  # fmt: skip
    rows, before = [start], 0.0
    for stop in plan.stops:
        driven = float(np.interp(stop.position_km, drive.node_km, hours))
        rows.append(_stop_row(stop, driven - before))
        before = driven
    end = [
        "destination", number(float(drive.node_km[-1])), clock(float(hours[-1]) - before),
        clock(plan.total_h), none, percent(plan.final_soc), none, none, none, none,
        number(plan.final_temperature_c), none, none,
    ]  # fmt: skip
    return table(head, [*rows, end])


def _stop_row(stop: StopReport, drive_h: float) -> list[str]:
    return [
        stop.charger,
        number(stop.position_km),
        clock(drive_h),
        clock(stop.arrive_h),
        clock(stop.depart_h),
        percent(stop.arrive_soc),
        percent(stop.depart_soc),
        minutes(stop.dwell_h),
        number(stop.grid_kwh, 2),
        number(stop.average_kw),
        number(stop.arrive_temperature_c),
        number(stop.depart_temperature_c),
        number(stop.cost, 2),
    ]


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
    used = sum(totals[use] for use in USES)
    rows = [
        [name, number(totals[use], 2), percent(totals[use] / used if used else None)]
        for use, name in USES.items()
        if use != "refused_recuperation" or totals[use] >= 0.005
    ]
    rows.append(["in all", number(used, 2), percent(1.0)])
    rows.append(["  of it from the grid", number(totals["grid"], 2), ""])
    rows.append(["  of it from the battery", number(used - totals["grid"], 2), ""])
    text = table(("energy", "kWh", "%"), rows)
    if totals["heat_pump"] >= 0.005:
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
        lines += [paragraph("", f"- {remedy}") for remedy in diagnosis.remedies]
    return "\n".join(lines)


# ---------------------------------------------------------------------------- evidence


def _name(result: Result, row: Row) -> str:
    """Return the stops a row speaks of: one choice, or a family of them with its size."""
    names = result.chargers
    if not row.undecided:
        return " + ".join(names[i] for i in row.subset) or "no stop"
    members = _members(row)
    if members is not None and len(members) == 1:
        return " + ".join(names[i] for i in members[0]) or "no stop"
    free, used = len(row.undecided), len(row.subset)
    least, most = row.count or (0, used + free)
    least, most = max(least - used, 0), min(most - used, free)
    if least == most:
        many = "all" if least == free else f"{least} of"
    elif least == 0:
        many = "any of" if most == free else f"up to {most} of"
    else:
        many = f"at least {least} of" if most == free else f"{least} to {most} of"
    others = ", ".join(names[i] for i in row.undecided) if free <= FEW_NAMES else (
        f"{free} {'others' if used else 'chargers'}"
    )  # fmt: skip
    subsets = "1 subset" if row.size == 1 else f"{row.size} subsets"
    apart = ", those listed apart left out" if row.without else ""
    return " + ".join([*(names[i] for i in row.subset), f"{many} {others} ({subsets}{apart})"])


def _members(row: Row) -> list[Subset] | None:
    """Return the subsets a row speaks of, if they are few enough to look through."""
    if row.size + len(row.without) > FEW_MEMBERS:
        return None
    used = len(row.subset)
    least, most = row.count or (0, used + len(row.undecided))
    return [
        subset
        for size in range(max(least - used, 0), min(most - used, len(row.undecided)) + 1)
        for more in combinations(row.undecided, size)
        if (subset := tuple(sorted((*row.subset, *more)))) not in row.without
    ]


def _best_row(result: Result) -> Row | None:
    """Return the row of the reported plan."""
    if result.plan is None:
        return None
    stops = sorted(s.charger for s in result.plan.stops)
    for row in result.ledger.rows:
        if not row.undecided and sorted(result.chargers[i] for i in row.subset) == stops:
            return row
    return None


def _why(result: Result, row: Row, best: Row | None) -> str:
    """Return how a subset or family ended, beside the best plan."""
    if best is not None and row is best:
        return "the plan"
    if best is not None and row.outcome in (Outcome.PLANNED, Outcome.BOUNDED):
        planned = row.outcome is Outcome.PLANNED
        text = f"costs {number(row.cost - best.cost, 2)} more" if planned else ""
        if row.lower_bound >= best.cost:
            more = number(row.lower_bound - best.cost, 2)
            return text or f"cannot be better: costs at least {more} more"
        if not isfinite(row.lower_bound):
            return f"{text}; a better one is not ruled out"
        share = percent(relative_gap(result.cost, row.lower_bound), 2)
        if planned:
            return f"{text}; none is better by more than {share} %"
        return f"cannot be better by more than {share} %"
    notes = [] if row.undecided and row.outcome is Outcome.UNPROVED else [row.reason]
    if row.outcome is Outcome.UNPROVED and best is not None and isfinite(row.lower_bound):
        share = percent(relative_gap(result.cost, row.lower_bound), 2)
        notes.append(f"up to {share} % better is not ruled out")
    text = "; ".join(note for note in notes if note)
    return f"{row.outcome.value}: {text}" if text else row.outcome.value


def _subsets(result: Result) -> str:
    """Return the comparison of the subsets: cost or bound of each, and how it ended."""
    best = _best_row(result)
    rows = sorted(
        result.ledger.rows,
        key=lambda r: (
            r is not best,
            r.cost,
            r.outcome is Outcome.INFEASIBLE,
            r.lower_bound if isfinite(r.lower_bound) else inf,
            len(r.subset),
        ),
    )
    shown = rows if len(rows) <= MAX_ROWS else rows[: MAX_ROWS - len(Outcome)]
    lines = [
        (_name(result, r), number(r.cost, 2), number(r.lower_bound, 2), _why(result, r, best))
        for r in shown
    ]
    listed = table(
        ("stops", f"plan\n{result.currency}", f"bound\n{result.currency}", "outcome"),
        [*lines, *_rest(rows[len(shown) :])],
        words_last=True,
    )
    counts = result.ledger.counts()
    words = {
        "planned": "planned",
        "bounded": "cannot be better",
        "infeasible": "proved infeasible",
        "unproved": "not settled",
    }
    said = ", ".join(f"{counts[k]} {word}" for k, word in words.items() if counts[k])
    text = f"{listed}\n{counts['total']} choices of stops: {said}."
    if result.programs:
        programs = "1 program" if result.programs == 1 else f"{result.programs} programs"
        text += f"\nSolved for it: {programs} for {counts['total']} subsets."
    if any(isfinite(r.cost) or isfinite(r.lower_bound) for r in rows):
        text += "\nCosts and bounds here are those of the transcription."
    return text


def _rest(rows: list[Row]) -> list[tuple[str, str, str, str]]:
    """Return one line per outcome for rows that are not listed: their number and least bound."""
    lines = []
    for outcome in Outcome:
        alike = [row for row in rows if row.outcome is outcome]
        size = sum(row.size for row in alike)
        if alike:
            subsets = "1 other subset" if size == 1 else f"{size} other subsets"
            cost = min(row.cost for row in alike)
            bound = min(row.lower_bound for row in alike)
            lines.append((subsets, number(cost, 2), number(bound, 2), outcome.value))
    return lines


def _unused(result: Result) -> str:
    """Return a line per charger that the plan does not use: what using it would cost."""
    best = _best_row(result)
    if best is None:
        return ""
    unused = [i for i in range(len(result.chargers)) if i not in best.subset]
    if len(unused) > MAX_ROWS:
        return ""  # a line each would bury the rest
    lines = []
    for i in unused:
        rows = [r for r in result.ledger.rows if i in r.subset or i in r.undecided]
        text = f"{result.chargers[i]}: {_unused_reason(result, rows, best)}"
        lines.append(textwrap.fill(text, WIDTH - 2))
    if not lines:
        return ""
    body = "\n".join(textwrap.indent(line, "  ") for line in lines)
    return f"chargers not used\n{body}"


def _unused_reason(result: Result, rows: list[Row], best: Row) -> str:
    """Return what is known of all choices with a charger; families may hold others besides."""
    planned = min((r for r in rows if r.cost < inf), key=lambda r: r.cost, default=None)
    if planned is not None:
        more = number(planned.cost - best.cost, 2)
        where = _name(result, planned)
        return f"best plan found with it costs {more} {result.currency} more ({where})"
    if all(r.outcome is Outcome.INFEASIBLE for r in rows):
        return "every choice of stops with it is proved infeasible"
    least = min((r.lower_bound for r in rows if r.outcome is not Outcome.INFEASIBLE), default=-inf)
    if least >= best.cost:
        more = number(least - best.cost, 2)
        return f"every plan with it costs at least {more} {result.currency} more"
    if all(r.outcome in (Outcome.BOUNDED, Outcome.INFEASIBLE) for r in rows):
        share = percent(relative_gap(result.cost, least), 2)
        return f"no plan with it is better by more than {share} %"
    if isfinite(least):
        share = percent(relative_gap(result.cost, least), 2)
        return f"no plan with it was found; up to {share} % better is not ruled out"
    return "no plan with it was found, and none is ruled out"


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
