"""Owns the answer for a trip that cannot be planned: how far the car gets, and what would help.

Drives as far as possible (every charger in reach, charged full, no battery
heating). An estimate to act on, not a proof: proofs stand in the ledger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relax.instance import MIN_CHARGE_KWH, Drive, Instance, make_instance
from relax.simulate import Simulation
from relax.starts import even_start
from relax.trip import Trip

__all__ = ["Diagnosis", "diagnose"]


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
        Changes that would help, each by itself, as estimates.
    """

    reach_km: float
    missing_kwh: float
    reason: str
    remedies: tuple[str, ...]


def _drive_full(trip: Trip, drive: Drive) -> tuple[Instance, Simulation, np.ndarray, list[float]]:
    """Drive with every charger in reach charged full; return the energies and the dwells."""
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
    return (
        instance,
        simulation,
        trajectory.energy_kwh,
        [float(s.dwell_h.sum()) for s in trajectory.stops],
    )


def diagnose(trip: Trip, drive: Drive) -> Diagnosis:
    """Return how far the car gets and what would make the trip possible.

    Parameters
    ----------
    trip : Trip
        The trip.
    drive : Drive
        Its driving steps.
    """
    instance, _, energy, dwell = _drive_full(trip, drive)
    least = instance.energy_min_kwh
    pack = trip.vehicle.pack
    short = np.flatnonzero(energy < least - 1e-6)
    length = trip.route.length_km
    if short.size == 0:
        return _other_limit(trip, instance, dwell)
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
        remedies.append(f"end.soc_min of at most {np.floor(soc * 100) / 100:.2f}")
    if not instance.stops:
        wanted = instance.start_energy_kwh + 1.02 * missing
        if wanted <= float(pack.energy_kwh(pack.ocv_v.hi)):
            soc = float(pack.soc(wanted))
            remedies.append(f"start.soc of about {np.ceil(soc * 100) / 100:.2f}")
    if not end_only or instance.stops:
        remedies.append(f"a charger between {last:.0f} km and {reach:.0f} km")
    return Diagnosis(reach, missing, reason, tuple(remedies))


def _other_limit(trip: Trip, instance: Instance, dwell: list[float]) -> Diagnosis:
    """Return the diagnosis when energy suffices but another limit stands in the way."""
    slow = [
        f"charger.{trip.chargers[s.charger].name}.max_dwell_min above {s.max_dwell_h * 60.0:.0f}"
        for s, hours in zip(instance.stops, dwell, strict=True)
        if hours > s.max_dwell_h
    ]
    late = sum(dwell) > instance.total_dwell_h
    if late:
        slow.append(f"limits.stop_time_h above {trip.stop_time_h:g}")
    reason = "the energy of the chargers would suffice, but another limit stands in the way: "
    if late:
        reason += "the time for charging and detours"
    elif slow:
        reason += "the longest dwell"
    else:
        reason += "temperature, discharge power or the least energy"
    return Diagnosis(trip.route.length_km, 0.0, reason, tuple(slow))
