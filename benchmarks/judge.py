"""Owns the verdict on a claimed plan: driven on the continuous model, whoever made it.

The same for all: the controls are simulated on the transcription, then driven
(``relax.execute``: charging targets are moved until the energies meet their limits, as a car
would). If a limit is still missed, one repair by our refinement is tried and said so. Knows
nothing of how a plan was found, and claims are not looked at.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

from relax.driven import Replay
from relax.errors import EvrelaxError
from relax.execute import execute
from relax.instance import Instance, make_instance
from relax.plan import Controls, Trajectory
from relax.refinement import Refined
from relax.replay import replay
from relax.simulate import is_feasible, simulate
from relax.trip import Trip

__all__ = ["Verdict", "judge"]


@dataclass(frozen=True)
class Verdict:
    """What our judge says of a plan.

    Parameters
    ----------
    outcome : str
        ``holds``, ``repaired`` (only after our refinement moved it inside its limits), ``fails``
        or ``none`` (there is no plan).
    reason : str
        Which limit was missed at first.
    transcribed_cost : float
        Cost of the controls on the transcription, ``inf`` if they miss a limit there [currency].
    replayed_cost : float
        Cost of the drive, ``inf`` if it does not hold [currency].
    charging_h, detour_h, grid_kwh : float
        Of the drive; NaN without.
    paid : float
        Cost of the drive less the value of charging and detour time: money for energy,
        occupancy and stops [currency].
    """

    outcome: str = "none"
    reason: str = ""
    transcribed_cost: float = inf
    replayed_cost: float = inf
    charging_h: float = nan
    detour_h: float = nan
    grid_kwh: float = nan
    paid: float = nan


def _verdict(trip: Trip, outcome: str, reason: str, transcribed: float, driven: Replay) -> Verdict:
    charging = sum(stop.dwell_h for stop in driven.stops)
    detour = sum(trip.chargers[stop.charger].detour_h for stop in driven.stops)
    return Verdict(
        outcome,
        reason,
        transcribed,
        driven.cost,
        charging,
        detour,
        sum(stop.grid_kwh for stop in driven.stops),
        driven.cost - trip.time_value_per_h * (charging + detour),
    )


def judge(
    trip: Trip,
    subset: tuple[int, ...],
    controls: Controls | None,
    targets_kwh: tuple[float, ...] | None = None,
) -> Verdict:
    """Drive a plan and say whether it holds and what it costs.

    Parameters
    ----------
    trip : Trip
        The trip.
    subset : tuple of int
        Chargers used.
    controls : Controls or None
        The plan.
    targets_kwh : tuple of float, optional
        Where charging ends, if the plan says so; it is driven exactly like that then.

    Examples
    --------
    >>> from benchmarks.cases import SMOKE
    >>> from relax import idle_controls
    >>> trip = SMOKE.load()
    >>> controls = idle_controls(make_instance(trip, (0, 1)), (25.0, 10.0))
    >>> verdict = judge(trip, (0, 1), controls)
    >>> verdict.outcome, round(verdict.detour_h, 3)
    ('holds', 0.167)
    >>> judge(trip, (), None).outcome
    'none'
    """
    if controls is None:
        return Verdict()
    instance = make_instance(trip, subset)
    try:
        trajectory = simulate(instance, controls)
        transcribed = trajectory.cost if is_feasible(trajectory) else inf
        if targets_kwh is not None:
            driven = replay(trip, instance, controls, targets_kwh)
            if driven.feasible:
                return _verdict(trip, "holds", "", transcribed, driven)
        # the drive decides, not the grid: so the plan is taken for feasible on the grid
        done = execute(trip, instance, Refined(controls, trajectory, True, 0))
    except EvrelaxError as error:
        return Verdict("fails", str(error))
    if done.reason or done.replay is None:
        return Verdict("fails", done.reason, transcribed)
    if done.controls is controls and targets_kwh is None:
        return _verdict(trip, "holds", "", transcribed, done.replay)
    reason = "repaired: " + _missed(trip, instance, controls, trajectory)
    return _verdict(trip, "repaired", reason, transcribed, done.replay)


def _missed(trip: Trip, instance: Instance, controls: Controls, trajectory: Trajectory) -> str:
    """Return what a plan misses when driven to the targets of the transcription."""
    targets = tuple(float(stop.energy_kwh[-1]) for stop in trajectory.stops)
    driven = replay(trip, instance, controls, targets)
    return ", ".join(map(str, driven.violations))
