"""Owns the answer for a trip that cannot be planned: how far the car gets, and what would help.

Drives as far as possible (every charger in reach, charged full, no battery
heating). If that gets there, another limit is in the way: which one is found by
planning without it, and only what led to a plan is named. An estimate to act on,
not a proof: proofs stand in the ledger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np

from relax.instance import MIN_CHARGE_KWH, Drive, Instance, make_instance
from relax.plan import Trajectory
from relax.refinement import RefineSettings, refine
from relax.simulate import Simulation
from relax.starts import best_start, even_start
from relax.trip import Trip

__all__ = ["Diagnosis", "diagnose"]

SPARE = 1.01
"""Factor on the time that a plan without a limit takes: for the drive, which may take longer."""
ALL_TIME, ONE_DWELL = "the time for charging and detours", "the longest dwell"
TOGETHER = " together with "
MAX_TRIED = 8
"""Up to this many chargers in reach each is tried alone; of more those that a plan used."""


@dataclass(frozen=True)
class Diagnosis:
    """Why a trip has no plan.

    Parameters
    ----------
    reach_km : float
        How far the car gets above its least energy [km].
    missing_kwh : float
        Energy missing at the next charger in reach or at the destination [kWh].
    reason : str
        One sentence.
    remedies : tuple of str
        Changes that would help, each by itself, as estimates. Those of time limits were
        tried: there is a plan with them. Two limits that only help together are one remedy.
    """

    reach_km: float
    missing_kwh: float
    reason: str
    remedies: tuple[str, ...]


def _drive_full(trip: Trip, drive: Drive) -> tuple[Instance, np.ndarray]:
    """Drive with every charger in reach charged full; return the energies."""
    order = sorted(range(len(trip.chargers)), key=lambda i: trip.chargers[i].position_km)
    used: list[int] = []
    for charger in [*order, -1]:
        instance = make_instance(trip, tuple(used), drive=drive)
        simulation = Simulation(instance)
        controls = even_start(instance)
        for i in range(len(used)):
            trajectory = simulation.run(controls)
            room = instance.energy_max_kwh - float(trajectory.stops[i].energy_kwh[0])
            stops = list(controls.stops)
            stops[i] = replace(stops[i], energy_kwh=max(room, MIN_CHARGE_KWH))
            controls = replace(controls, stops=tuple(stops))
        trajectory = simulation.run(controls)
        if charger < 0:
            break
        node = int(np.argmin(np.abs(drive.node_km - trip.chargers[charger].position_km)))
        spec = trip.chargers[charger]
        least = float(trip.vehicle.pack.energy_kwh(trip.soc_min.at(spec.position_km)))
        on_the_way = np.all(trajectory.energy_kwh[:node] >= instance.energy_min_kwh[:node])
        if on_the_way and trajectory.energy_kwh[node] - spec.detour_in_kwh >= least:
            used.append(charger)
    return instance, trajectory.energy_kwh


def diagnose(trip: Trip, drive: Drive, deadline: float = inf) -> Diagnosis:
    """Return how far the car gets and what would make the trip possible.

    Parameters
    ----------
    trip : Trip
        The trip.
    drive : Drive
        Its driving steps.
    deadline : float
        ``time.perf_counter()`` from which on no limit is tried [s].
    """
    instance, energy = _drive_full(trip, drive)
    least = instance.energy_min_kwh
    pack = trip.vehicle.pack
    short = np.flatnonzero(energy < least - 1e-6)
    length = trip.route.length_km
    if short.size == 0:
        return _other_limit(trip, instance, RefineSettings(deadline=deadline))
    end_only = short[0] == drive.n_steps and energy[-1] >= pack.energy_kwh(trip.soc_min.at(length))
    k = int(short[0])
    above, below = energy[k - 1] - least[k - 1], energy[k] - least[k]
    share = float(above / (above - below)) if above > below else 0.0
    reach = float(drive.node_km[k - 1] + share * (drive.node_km[k] - drive.node_km[k - 1]))
    last = max((trip.chargers[s.charger].position_km for s in instance.stops), default=0.0)
    ahead = [c for c in trip.chargers if c.position_km > reach]
    goal = min(ahead, key=lambda c: c.position_km, default=None)
    target_km = goal.position_km if goal is not None else length
    node = int(np.argmin(np.abs(drive.node_km - target_km)))
    missing = float(least[node] - energy[node]) + (goal.detour_in_kwh if goal else 0.0)
    name = f"charger {goal.name}" if goal is not None else "the destination"
    reason = (
        f"the car gets to {reach:.1f} km; {missing:.1f} kWh are missing to reach {name} "
        f"at {target_km:.1f} km with the least energy allowed"
    )
    remedies = []
    if end_only:
        soc = float(pack.soc(energy[-1]))
        reason = (
            f"the car arrives with a SoC of {soc:.2f}; {missing:.1f} kWh are missing to the "
            f"{trip.end_soc_min:.2f} that it is to arrive with at least"
        )
        remedies.append(f"end.soc_min of at most {np.floor(soc * 100) / 100:.2f}")
    if not instance.stops:
        wanted = instance.start_energy_kwh + 1.02 * missing
        if wanted <= float(pack.energy_kwh(pack.ocv_v.hi)):
            soc = float(pack.soc(wanted))
            remedies.append(f"start.soc of about {np.ceil(soc * 100) / 100:.2f}")
    if not end_only or instance.stops:
        wanted = float(least[node]) + (goal.detour_in_kwh if goal else 0.0)
        left = instance.energy_max_kwh - (energy - energy[node])  # there, charged full on the way
        near = (drive.node_km >= last) & (drive.node_km <= reach) & (left >= wanted)
        if near.any():
            first = max(last, float(drive.node_km[int(np.argmax(near))]))
            remedies.append(f"a charger between {np.ceil(first):.0f} km and {reach:.0f} km")
        else:
            remedies.append(f"several chargers between {last:.0f} km and {target_km:.0f} km")
    return Diagnosis(reach, missing, reason, tuple(remedies))


def _needed(
    trip: Trip,
    everywhere: Instance,
    dwells: frozenset[int],
    time: bool,
    settings: RefineSettings,
) -> dict[int, str] | None:
    """Plan without the longest dwell at some chargers, or without the limit of all time.

    Begins with every charger in reach and leaves out those that charge least.

    Returns
    -------
    dict of int to str, or None
        By charger (-1: of all time) the values of the limits left out that the plan needs;
        None if no plan is found.
    """
    subset = everywhere.subset
    while True:
        own = make_instance(trip, subset, drive=everywhere.drive)
        stops = tuple(replace(s, max_dwell_h=inf) if s.charger in dwells else s for s in own.stops)
        free = replace(own, stops=stops, total_dwell_h=inf if time else own.total_dwell_h)
        if settings.late:
            return None
        found = refine(free, best_start(free, None, 0.0), settings)
        if found.feasible:
            return _exceeded(trip, own, found.trajectory)
        if not subset:
            return None
        charged = {
            s.charger: float(t.energy_kwh[-1] - t.energy_kwh[0])
            for s, t in zip(own.stops, found.trajectory.stops, strict=True)
        }
        # those that may stay as long as they like go last; a quarter at once: few tries
        order = sorted(subset, key=lambda c: (c in dwells, charged[c]))
        gone = set(order[: (len(order) + 3) // 4])
        subset = tuple(c for c in subset if c not in gone)


def _exceeded(trip: Trip, instance: Instance, plan: Trajectory) -> dict[int, str]:
    """Return the limits of time that a plan exceeds, each as a value that it would keep."""
    hours = [float(s.dwell_h.sum()) for s in plan.stops]
    needed: dict[int, str] = {}
    if sum(hours) > instance.total_dwell_h:
        spent = sum(hours) + sum(s.detour_h for s in instance.stops)
        needed[-1] = f"limits.stop_time_h of about {ceil(SPARE * spent * 100.0) / 100.0:g}"
    for stop, dwell in zip(instance.stops, hours, strict=True):
        if dwell > stop.max_dwell_h:
            field = f"charger.{trip.chargers[stop.charger].name}.max_dwell_min"
            needed[stop.charger] = f"{field} of about {ceil(SPARE * dwell * 60.0)}"
    return needed


def _other_limit(trip: Trip, everywhere: Instance, settings: RefineSettings) -> Diagnosis:
    """Return the diagnosis when energy suffices but another limit stands in the way."""
    every, none = frozenset(everywhere.subset), frozenset[int]()
    limited = everywhere.total_dwell_h < inf
    remedies: list[str] = []
    reasons: list[str] = []
    if limited:
        needed = _needed(trip, everywhere, none, time=True, settings=settings)
        if needed:
            remedies += needed.values()
            reasons.append(ALL_TIME)
    needed = _needed(trip, everywhere, every, time=False, settings=settings)
    if needed:
        tried = sorted(every) if len(every) <= MAX_TRIED else [*needed]
        single = [
            _needed(trip, everywhere, frozenset([c]), time=False, settings=settings) for c in tried
        ]
        alone = [text for one in single if one for text in one.values()]
        remedies += alone or [TOGETHER.join(needed.values())]
        reasons.append(ONE_DWELL)
    if limited and not remedies:
        needed = _needed(trip, everywhere, every, time=True, settings=settings)
        if needed:
            remedies.append(TOGETHER.join(needed.values()))
            reasons.append(f"{ALL_TIME} and {ONE_DWELL}")
    reason = "the energy of the chargers would suffice, but another limit stands in the way: "
    unknown = "temperature, discharge power or the least energy"
    if settings.late:
        unknown = "there was no time to find out which"
    reason += " or ".join(reasons) or unknown
    return Diagnosis(trip.route.length_km, 0.0, reason, tuple(remedies))
