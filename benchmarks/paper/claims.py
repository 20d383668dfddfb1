"""Owns the verdicts: statement by statement, what of the paper came out, computed from the rows.

A statement is *confirmed* if our certified plans show it, *not confirmed* if they show otherwise,
*open* if two plans are too close to tell or a needed row is missing. Words here, figures computed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.paper.cases import OFF_KW, TIE, Behaviour, Found, behaviour, case_trip
from benchmarks.paper.published import (
    AMBIENT_C,
    ENERGY_AT_MIN,
    ENERGY_KWH,
    HEAT_PUMP_KW,
    LEAST_TIME_MIN,
    PRINTED_SAVING,
    saving,
)
from benchmarks.paper.tables import GOALS, Cell

__all__ = ["Verdict", "markdown", "verdicts"]

CONFIRMED, REFUTED, OPEN = "confirmed", "not confirmed", "open"
HEATS_KWH = 0.05
"""Battery heating above this counts as heating."""
SAME = 0.05
"""Difference below which two heat pumps count as equal: half the last digit of the tables."""
ROUNDING = 0.5
"""What rounding of the table's values can change of a saving [percentage points]."""


@dataclass(frozen=True)
class Verdict:
    """One statement.

    Parameters
    ----------
    statement : str
        What the paper says, in our words.
    verdict : str
        Confirmed, not confirmed, or open.
    why : str
        The figures.
    """

    statement: str
    verdict: str
    why: str


def _yes(truth: bool) -> str:
    return CONFIRMED if truth else REFUTED


def _stops(stops: Sequence[int]) -> str:
    return "{" + ", ".join(str(i + 1) for i in stops) + "}"


def _numbers(values: Sequence[float], unit: str, digits: int = 1) -> str:
    return " and ".join(f"{v:.{digits}f}" for v in values) + f" {unit}"


def _tables(cells: Sequence[Cell]) -> list[Verdict]:
    found = []
    for table, unit, word in (("energy", "%", "charged energies"), ("time", "min", "least times")):
        own = [c for c in cells if c.table == table]
        if len(own) < len(AMBIENT_C) * len(HEAT_PUMP_KW):
            continue
        off = [c.percent if table == "energy" else c.off for c in own]
        worst = max(off, key=abs)
        found.append(
            Verdict(
                f"the nine {word} of the table",
                _yes(abs(worst) <= GOALS[table]),
                f"largest deviation {worst:+.2f} {unit}; the car was fitted to them, so this says "
                "that model and figures are compatible, no more",
            )
        )
        by = {(c.ambient_c, c.heat_pump_kw): c.found.value for c in own}
        cold = by[-10.0, 1.0] - by[-10.0, 3.0]
        mild = max(abs(by[t, 1.0] - by[t, 3.0]) for t in (0.0, 10.0))
        unit = "kWh" if table == "energy" else "min"
        found.append(
            Verdict(
                f"{word}: the larger heat pump gains at -10 °C and nothing at 0 and 10 °C",
                _yes(cold > SAME >= mild),
                f"{cold:.2f} {unit} at -10 °C, at most {mild:.2f} {unit} at 0 and 10 °C",
            )
        )
        printed = PRINTED_SAVING[table]
        top = max(printed, key=lambda key: printed[key])
        ours = {(c.ambient_c, c.heat_pump_kw): c.saving for c in own}
        best = max(ours, key=lambda key: ours[key])
        near = abs(ours[best] - printed[top]) <= GOALS["saving"] and best[0] == top[0]
        found.append(
            Verdict(
                f"{word}: a heat pump saves up to {printed[top]:.1f} %, at {top[0]:.0f} °C",
                _yes(near),
                f"there {ours[top]:.1f} %; most {ours[best]:.1f} % at {best[0]:.0f} °C",
            )
        )
        for key, said in printed.items():
            follows = saving(ENERGY_KWH if table == "energy" else LEAST_TIME_MIN, *key)
            if abs(follows - said) > ROUNDING:
                found.append(
                    Verdict(
                        f"{word}: {said:.1f} % saved at {key[0]:.0f} °C, {key[1]:.0f} kW",
                        REFUTED,
                        f"the paper's own values give {follows:.1f} %, ours {ours[key]:.1f} %",
                    )
                )
    cell = next((c for c in cells if (c.table, c.ambient_c, c.heat_pump_kw) == ("time", 0.0, 0.0)),
                None)  # fmt: skip
    if cell is not None:
        limit = ENERGY_AT_MIN[0.0]
        found.append(
            Verdict(
                f"{ENERGY_KWH[0.0, 0.0]} kWh at {limit:.0f} min, 0 °C, no heat pump",
                _yes(cell.found.lower_bound <= limit),
                f"the paper's own least time there is {LEAST_TIME_MIN[0.0, 0.0]} min; our bound: "
                f"no plan takes less than {cell.found.lower_bound:.2f} min",
            )
        )
    return found


def _stop_sets(cases: Sequence[Found]) -> list[Verdict]:
    found = []
    for f in cases:
        verdict = {"as published": CONFIRMED, "tie": OPEN}.get(f.verdict, REFUTED)
        side = "better" if f.margin < 0.0 else "worse"
        tie = ", a tie" if f.verdict == "tie" else ""
        found.append(
            Verdict(
                f"case {f.case.name}: stops {_stops(f.case.stops)}",
                verdict,
                f"{abs(f.margin):.2f} {f.unit} {side} than {_stops(f.other)}{tie}; certified gap "
                f"of the best plan {100.0 * f.at.gap:.1f} %",
            )
        )
    return found


def _case_a(b: Behaviour) -> list[Verdict]:
    return [
        Verdict("case A: the battery ends at 25 to 30 °C", _yes(25.0 <= b.final_c <= 30.0),
                f"{b.final_c:.1f} °C"),
    ]  # fmt: skip


def _heats_not(name: str, b: Behaviour, unheated_kwh: float) -> Verdict:
    """No battery heating, or so little that the plan without it ties."""
    statement = f"case {name}: no battery heating"
    if b.heating_kwh < HEATS_KWH:
        return Verdict(statement, CONFIRMED, f"{b.heating_kwh:.2f} kWh")
    why = f"{b.heating_kwh:.2f} kWh; without it {unheated_kwh:.2f} kWh more are charged"
    if unheated_kwh < TIE["energy"]:
        return Verdict(statement, OPEN, why + ", a tie")
    return Verdict(statement, REFUTED, why)


def _case_b(b: Behaviour) -> list[Verdict]:
    off = all(p < OFF_KW for p in b.pump_before_kw)
    before = _numbers(b.pump_before_kw, "kW", 2)
    return [
        Verdict("case B: heat pump off just before each stop", _yes(off),
                f"mean of the last 12 km before the stops {before}, earlier on the leg "
                f"{_numbers(b.pump_else_kw, 'kW', 2)}"),
        Verdict("case B: heat pump off in the first part of each stop",
                _yes(all(p < OFF_KW for p in b.pump_first_kw)),
                f"mean over the first quarter of the energy {_numbers(b.pump_first_kw, 'kW', 2)}"),
    ]  # fmt: skip


def _case_c(b: Behaviour) -> list[Verdict]:
    return [
        Verdict("case C: the heater warms the battery before the stop",
                _yes(b.heating_before_kwh > HEATS_KWH), f"{b.heating_before_kwh:.2f} kWh before"),
        Verdict("case C: and in the first minutes of the stop",
                _yes(b.heating_at_stops_kwh > HEATS_KWH), f"{b.heating_at_stops_kwh:.2f} kWh"),
        Verdict("case C: the battery falls below 0 °C towards the end", _yes(b.final_c < 0.0),
                f"{b.final_c:.1f} °C at the destination"),
        Verdict("preheating appears only where time is minimised",
                _yes(b.heating_before_kwh <= HEATS_KWH),
                "case C minimises energy and preheats, in the paper as here: the heat is taken "
                "back by the heat pump"),
    ]  # fmt: skip


def _case_e(b: Behaviour) -> list[Verdict]:
    return [
        Verdict("case E: the battery is heated to about 25 °C before the stops",
                _yes(all(abs(t - 25.0) <= 5.0 for t in b.arrive_c) and b.heating_before_kwh > 0.5),
                f"arrives with {_numbers(b.arrive_c, '°C')}, {b.heating_before_kwh:.1f} kWh of "
                "battery heating before"),
        Verdict("case E: heater at full power while charging",
                _yes(min(b.heater_full) > 0.5),
                "share of the dwell at full power "
                + _numbers([100.0 * s for s in b.heater_full], "%", 0)),
        Verdict("case E: heat pump for the cabin while charging",
                _yes(b.pump_at_stops_kwh > HEATS_KWH), f"{b.pump_at_stops_kwh:.2f} kWh"),
    ]  # fmt: skip


BEHAVIOURS: Mapping[str, Callable[[Behaviour], list[Verdict]]] = {
    "A": _case_a,
    "B": _case_b,
    "C": _case_c,
    "E": _case_e,
}


def verdicts(cells: Sequence[Cell], cases: Sequence[Found]) -> list[Verdict]:
    """Return all verdicts that the rows allow.

    Parameters
    ----------
    cells : sequence of Cell
        The tables.
    cases : sequence of Found
        The cases.
    """
    found = [*_tables(cells), *_stop_sets(cases)]
    for f in cases:
        heater = case_trip(f.case).vehicle.heater_kw
        did = behaviour(f.report, heater)
        if f.case.name in "AB":
            found.append(_heats_not(f.case.name, did, f.unheated_kwh))
        if f.case.name in BEHAVIOURS:
            found += BEHAVIOURS[f.case.name](did)
    return found


def markdown(found: Sequence[Verdict]) -> str:
    """Return the verdicts as a table."""
    lines = ["| the paper says | verdict | what came out |", "|---|---|---|"]
    lines += [f"| {v.statement} | {v.verdict} | {v.why} |" for v in found]
    return "\n".join(lines)
