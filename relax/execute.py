"""Owns the step from an optimised plan to one that holds on the continuous model.

Drives the plan; where the transcription's error leaves a limit missed by a hair,
moves the charging targets or refines once more inside tightened limits. A plan
that still misses a limit is refused, with the reason. Judges nothing itself:
the verdict is ``replay``'s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from relax.driven import Replay
from relax.errors import DomainError
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, Trajectory
from relax.refinement import Refined, RefineSettings, refine
from relax.replay import RULE_STOP_TIME, replay
from relax.simulate import is_feasible, simulate

if TYPE_CHECKING:
    from relax.trip import Trip

__all__ = ["Execution", "execute"]

TARGET_TOLERANCE_KWH = 5e-6
"""How exactly the driven trip ends at its least energy [kWh]."""
MAX_DRIVES = 8
"""Bound on the replays that move the charging targets; 2 or 3 are usual."""
REPAIR_MARGINS = (1.05, 1.5, 1.5, 2.0, 3.0)
"""Each refinement inside tightened limits moves them by this multiple of what was missed. The
first is nearly exact: 1.5 cost a plan at the limit of its temperature 0.3 % more. A temperature
that peaks within a long step follows its nodes only in part: of 3.3 K three repairs left 0.03."""
REPAIRED = 0.98
"""A repair that leaves more than this share of everything that was missed is the last."""


@dataclass(frozen=True)
class Execution:
    """A plan as executed.

    Parameters
    ----------
    controls : Controls
        What the car is told.
    targets_kwh : tuple of float
        Internal energy at which each stop ends [kWh].
    trajectory : Trajectory
        The transcription's view of the plan: what ``simulate`` says of ``controls`` on the
        trip's own limits, also after repairs.
    replay : Replay or None
        The drive on the continuous model; None if the car could not finish it.
    reason : str
        Why the plan is refused; empty if it holds.
    """

    controls: Controls
    targets_kwh: tuple[float, ...]
    trajectory: Trajectory
    replay: Replay | None
    reason: str


def _drive(
    trip: Trip, instance: Instance, controls: Controls, trajectory: Trajectory
) -> tuple[tuple[float, ...], Replay]:
    """Replay, with charging targets moved until the driven energies meet their limits."""
    targets = [float(s.energy_kwh[-1]) for s in trajectory.stops]
    driven = replay(trip, instance, controls, tuple(targets))
    full = instance.energy_max_kwh
    for _ in range(MAX_DRIVES if targets else 0):
        before = list(targets)
        for m, (stop, done) in enumerate(zip(instance.stops, driven.stops, strict=True)):
            raised = targets[m - 1] - before[m - 1] if m else 0.0
            arrive = done.arrive_energy_kwh + raised
            if m and stop.arrive_min_kwh - arrive > TARGET_TOLERANCE_KWH:
                shift = min(stop.arrive_min_kwh - arrive, full - targets[m - 1])
                targets[m - 1], arrive = targets[m - 1] + shift, arrive + shift
            if arrive + MIN_CHARGE_KWH - targets[m] > TARGET_TOLERANCE_KWH:
                targets[m] = min(arrive + MIN_CHARGE_KWH, full)
        missing = instance.end_energy_min_kwh - driven.final_energy_kwh
        least = min(driven.stops[-1].arrive_energy_kwh + MIN_CHARGE_KWH, full)
        targets[-1] = max(min(before[-1] + missing, full), least)
        if max(abs(a - b) for a, b in zip(before, targets, strict=True)) <= TARGET_TOLERANCE_KWH:
            targets = before  # those that were driven
            break
        driven = replay(trip, instance, controls, tuple(targets), driven)
    return tuple(targets), driven


def _tightened(instance: Instance, driven: Replay, margin: float) -> Instance:
    """Return the instance with limits moved inwards by a multiple of what the drive missed."""
    for violation in driven.violations:
        amount = margin * violation.amount
        if violation.unit == "K" and "above" in violation.rule:
            instance = replace(instance, temperature_max_c=instance.temperature_max_c - amount)
        elif violation.unit == "K":
            instance = replace(instance, temperature_min_c=instance.temperature_min_c + amount)
        elif violation.unit == "kWh" and ("above" in violation.rule or "charged" in violation.rule):
            instance = replace(instance, energy_max_kwh=instance.energy_max_kwh - amount)
        elif violation.unit == "kWh":
            instance = replace(
                instance,
                energy_min_kwh=instance.energy_min_kwh + amount,
                end_energy_min_kwh=instance.end_energy_min_kwh + amount,
                stops=tuple(
                    replace(
                        s,
                        arrive_min_kwh=s.arrive_min_kwh + amount,
                        leave_min_kwh=s.leave_min_kwh + amount,
                    )
                    for s in instance.stops
                ),
            )
        elif violation.rule == RULE_STOP_TIME:
            instance = replace(instance, total_dwell_h=instance.total_dwell_h - amount)
        elif violation.unit == "h":
            stops = tuple(replace(s, max_dwell_h=s.max_dwell_h - amount) for s in instance.stops)
            instance = replace(instance, stops=stops)
    return instance


def execute(
    trip: Trip, instance: Instance, refined: Refined, settings: RefineSettings | None = None
) -> Execution:
    """Drive a refined plan and repair what the transcription's error leaves.

    Parameters
    ----------
    trip : Trip
        The trip.
    instance : Instance
        Its transcription for the plan's subset.
    refined : Refined
        The plan.
    settings : RefineSettings, optional
        For refinements inside tightened limits.

    Returns
    -------
    Execution
        ``reason`` is empty exactly if the replay broke no limit.

    Examples
    --------
    >>> from relax import execute, idle_controls, load_trip, make_instance, refine
    >>> trip = load_trip("paper-400km")
    >>> instance = make_instance(trip, (1,))
    >>> done = execute(trip, instance, refine(instance, idle_controls(instance, (20.0,))))
    >>> done.reason, done.replay.feasible
    ('', True)
    """
    inner = instance
    missed: dict[str, float] = {}
    controls, trajectory = refined.controls, refined.trajectory
    driven: Replay | None = None
    targets: tuple[float, ...] = ()
    if not refined.feasible:
        reason = "it violates a limit already on the grid"
        return Execution(controls, targets, trajectory, driven, reason)
    for margin in (*REPAIR_MARGINS, None):
        try:
            targets, driven = _drive(trip, instance, controls, trajectory)
        except DomainError as error:
            reason = f"the car cannot drive it: {error}"
            return Execution(controls, (), trajectory, None, reason)
        reason = "; ".join(str(v) for v in driven.violations)
        if driven.feasible:
            break
        before, missed = missed, {v.rule: v.amount for v in driven.violations}
        if before and all(missed.get(r, 0.0) > REPAIRED * most for r, most in before.items()):
            break
        if margin is None:
            break
        inner = _tightened(inner, driven, margin)
        found = refine(inner, controls, settings)
        repaired = found.controls.heated_as(found.trajectory)  # tightened limits held it back
        now = simulate(instance, repaired)
        if not is_feasible(now):  # the tightened limits may be missed, the trip's own not
            break
        controls, trajectory = repaired, now
    return Execution(controls, targets, trajectory, driven, reason)
