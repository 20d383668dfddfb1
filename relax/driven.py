"""Owns the values a replay returns: the drive as it went, and what it broke.

Knows nothing of how it was driven.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

__all__ = ["Arrival", "Clipped", "Replay", "ReplayStop", "Violation"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Violation:
    """A broken rule.

    Parameters
    ----------
    rule : str
        Which limit.
    position_km : float
        Where.
    amount : float
        By how much, > 0.
    unit : str
        Unit of ``amount``.
    """

    rule: str
    position_km: float
    amount: float
    unit: str

    def __str__(self) -> str:
        """Return one line for people."""
        return f"{self.rule} at {self.position_km:.1f} km by {self.amount:.4g} {self.unit}"


@dataclass(frozen=True)
class Clipped:
    """A command beyond its actuator's rating, taken back to it.

    Parameters
    ----------
    command : str
        ``heater_kw``, ``cooling_kw`` or ``heat_pump_kw``.
    position_km : float
        Where the command begins, or the stop.
    asked_kw, given_kw : float
        What was commanded, and the rating (or 0) that was driven with [kW].
    """

    command: str
    position_km: float
    asked_kw: float
    given_kw: float

    def __str__(self) -> str:
        """Return one line for people."""
        place = f"{self.position_km:.1f} km"
        return (
            f"{self.command} of {self.asked_kw:.4g} at {place}: the car gives {self.given_kw:.4g}"
        )


@dataclass(frozen=True)
class ReplayStop:
    """One stop as driven.

    Parameters
    ----------
    charger : int
        Index into ``trip.chargers``.
    arrive_energy_kwh, depart_energy_kwh : float
        After the detour in and before the detour out [kWh].
    arrive_temperature_c, depart_temperature_c : float
        Battery temperature [degrees C].
    dwell_h, grid_kwh, cost : float
        Outcome [h, kWh, currency].
    energy_kwh, temperature_c, clock_h : ndarray, shape (K + 1,)
        State at the cell borders; the clock counts from plugging in.
    """

    charger: int
    arrive_energy_kwh: float
    depart_energy_kwh: float
    arrive_temperature_c: float
    depart_temperature_c: float
    dwell_h: float
    grid_kwh: float
    cost: float
    energy_kwh: Array
    temperature_c: Array
    clock_h: Array


@dataclass(frozen=True)
class Arrival:
    """Where a drive stands on arrival at a stop, before the detour in.

    Parameters
    ----------
    state : tuple of float
        Integrated state.
    violations : tuple of Violation
        Limits broken by then.
    """

    state: tuple[float, ...]
    violations: tuple[Violation, ...]


@dataclass(frozen=True)
class Replay:
    """A driven plan.

    Parameters
    ----------
    cost : float
        What the trip costs [currency]: the reported cost.
    stops : tuple of ReplayStop
        The stops.
    position_km, energy_kwh, temperature_c : ndarray, shape (m + 1,)
        State at the borders of the route's samples, on arrival.
    node_energy_kwh, node_temperature_c : ndarray, shape (n + 1,)
        State at the nodes of the transcription, on arrival.
    final_energy_kwh, final_temperature_c : float
        State at the end.
    totals_kwh : dict of str to float
        Energies of the whole trip by use.
    balance_kwh, heat_balance_kwh : float
        What the sums of electrical and of thermal energies miss; rounding only.
    violations : tuple of Violation
        Broken limits; empty: the plan is feasible.
    targets_kwh : tuple of float
        Internal energy at which charging was to end, one per stop [kWh].
    arrivals : tuple of Arrival
        One per stop.
    clipped : tuple of Clipped
        Commands beyond an actuator's rating, the largest excess of each: driven at the
        rating. They break no limit, but what was driven is not what was commanded.
    """

    cost: float
    stops: tuple[ReplayStop, ...]
    position_km: Array
    energy_kwh: Array
    temperature_c: Array
    node_energy_kwh: Array
    node_temperature_c: Array
    final_energy_kwh: float
    final_temperature_c: float
    totals_kwh: dict[str, float]
    balance_kwh: float
    heat_balance_kwh: float
    violations: tuple[Violation, ...]
    targets_kwh: tuple[float, ...] = ()
    arrivals: tuple[Arrival, ...] = field(default=(), repr=False)
    clipped: tuple[Clipped, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether no limit is broken."""
        return not self.violations
