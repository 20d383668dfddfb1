"""Owns the two tables beside the published values: 18 values with their deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.paper.fronts import ABOVE_LEAST_MIN, At, energy_at, least_time
from benchmarks.paper.published import (
    AMBIENT_C,
    ENERGY_AT_MIN,
    ENERGY_KWH,
    HEAT_PUMP_KW,
    LEAST_TIME_MIN,
    PRINTED_SAVING,
    saving,
)

__all__ = ["GOALS", "Cell", "cells", "goals_met", "markdown"]

Row = Mapping[str, Any]
Fronts = Mapping[tuple[float, float], Row]
GOALS = {"energy": 1.0, "time": 0.2, "saving": 1.0}
"""Largest deviations wanted: % of an energy, minutes, percentage points of a saving."""
UNIT = {"energy": "kWh", "time": "min"}


@dataclass(frozen=True)
class Cell:
    """One value of a table.

    Parameters
    ----------
    table : {"energy", "time"}
        Which.
    ambient_c, heat_pump_kw : float
        Where in it.
    published : float
        The paper's value [kWh, min].
    found : At
        Ours.
    published_saving, saving : float
        Against no heat pump, of the published values and of ours [%]; 0 without one.
    """

    table: str
    ambient_c: float
    heat_pump_kw: float
    published: float
    found: At
    published_saving: float
    saving: float

    @property
    def off(self) -> float:
        """Ours less theirs [kWh, min]."""
        return self.found.value - self.published

    @property
    def percent(self) -> float:
        """The same in % of theirs."""
        return 100.0 * self.off / self.published

    @property
    def met(self) -> bool:
        """Whether value and saving are within the goals."""
        size = abs(self.percent) if self.table == "energy" else abs(self.off)
        points = abs(self.saving - self.published_saving)
        return size <= GOALS[self.table] and points <= GOALS["saving"]


def cells(fronts: Fronts) -> list[Cell]:
    """Return the values of the fronts that are there, energies first."""
    found: list[Cell] = []
    for table, published in (("energy", ENERGY_KWH), ("time", LEAST_TIME_MIN)):
        ours = {
            (t, p): energy_at(row, t) if table == "energy" else least_time(row)
            for (t, p), row in fronts.items()
        }
        plain = {key: at.value for key, at in ours.items()}
        for t in AMBIENT_C:
            for p in HEAT_PUMP_KW:
                if (t, p) not in ours or (t, 0.0) not in ours:
                    continue
                theirs = saving(published, t, p)
                found.append(
                    Cell(table, t, p, published[t, p], ours[t, p], theirs, saving(plain, t, p))
                )
    return found


def goals_met(found: list[Cell]) -> bool:
    """Return whether all 18 values are there and within the goals."""
    return len(found) == 18 and all(cell.met for cell in found)


def markdown(found: list[Cell], table: str) -> str:
    """Return one table: published, ours, deviation, bound, saving.

    Parameters
    ----------
    found : list of Cell
        Of ``cells``.
    table : {"energy", "time"}
        Which.
    """
    unit, energy = UNIT[table], table == "energy"
    names = {0.0: "off", 1.0: "1 kW", 3.0: "3 kW"}
    lines = [
        f"| ambient | heat pump |{' within |' if energy else ''} paper | ours | deviation "
        "| no plan below | gap | saving: printed | of its values | ours |",
        f"|---:|---|{'---:|' if energy else ''}---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for cell in found:
        if cell.table != table:
            continue
        at = f" {cell.found.at_min:.1f} min |" if energy else ""
        off = f"{cell.off:+.2f} {unit}" + (f" ({cell.percent:+.1f} %)" if energy else "")
        savings = "- | - | -"
        if cell.heat_pump_kw > 0.0:
            printed = PRINTED_SAVING[table][cell.ambient_c, cell.heat_pump_kw]
            savings = f"{printed:.1f} % | {cell.published_saving:.1f} % | {cell.saving:.1f} %"
        lines.append(
            f"| {cell.ambient_c:.0f} °C | {names[cell.heat_pump_kw]} |{at} "
            f"{cell.published:.1f} {unit} | {cell.found.value:.2f} {unit} | {off} "
            f"| {cell.found.lower_bound:.2f} {unit} | {100.0 * cell.found.gap:.1f} % | {savings} |"
        )
    return "\n".join(lines)


def note(found: list[Cell]) -> str:
    """Return where an energy is not read at the published time, for the page."""
    late = [
        f'{c.ambient_c:.0f} °C without heat pump: the paper gives {c.published} kWh "at '
        f'{ENERGY_AT_MIN[c.ambient_c]:.0f} min", which is less than its own least time of '
        f"{LEAST_TIME_MIN[c.ambient_c, c.heat_pump_kw]} min; ours is read at {c.found.at_min:.1f} "
        f"min, at most {ABOVE_LEAST_MIN} min above our least time."
        for c in found
        if c.table == "energy" and c.found.at_min > ENERGY_AT_MIN[c.ambient_c] + 0.05
    ]
    return "\n".join(late)
