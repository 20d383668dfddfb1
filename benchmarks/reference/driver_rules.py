"""Owns drivers who follow rules of thumb: what a plan has to beat, and by how much it does.

They know the car's range exactly, as good navigation does, but decide one leg at a time and
optimise nothing. Their trips are simulated and replayed like ours. Knows nothing of how
plans are found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from relax.completion import complete
from relax.errors import DomainError
from relax.execute import execute
from relax.instance import MIN_CHARGE_KWH, Instance, make_drive, make_instance
from relax.plan import Controls, StopControls, Trajectory
from relax.refinement import Refined
from relax.simulate import FEASIBLE, Simulation, Thermostat, idle_controls, is_feasible
from relax.trip import Trip

if TYPE_CHECKING:
    from relax.driven import Replay

Array = npt.NDArray[np.float64]

__all__ = [
    "PLAIN",
    "PREHEATING",
    "DriverRules",
    "DriverTrip",
    "drive_by_rules",
]

PASSES = 12
"""Bound on the rounds of charge, preheating and protection: each depends on the others."""
HOT_K = 2.0
"""Distance from the battery's upper limit from which the car cools and protects it [K]."""
CUT = 0.9
"""Factor on the charging power of a battery that would get too hot, per round."""
SETTLED_KWH = 1e-3
"""Change of the charges at which the rounds end [kWh]."""
ROUNDING_KWH = 1e-4
"""Missing energy that is rounding of the charges [kWh]."""


@dataclass(frozen=True)
class DriverRules:
    """How a driver decides.

    Parameters
    ----------
    name : str
        For reports.
    preheat_h : float
        Driving time before each stop during which the battery heater is on, at full power;
        0: never [h].
    preheat_c : float
        Battery temperature at which it is off again [degrees C].
    reserve_soc : float
        SoC kept on arrival at chargers above the trip's least; the destination is
        reached with the least SoC asked for there.
    full_soc : float
        SoC to which the driver is willing to charge; more only if nothing is in reach else.
    heat_pump_from_c : float
        Battery temperature above which the heat pump runs, as far as the cabin wants; below,
        the car does not let it cool the battery any further [degrees C].
    """

    name: str
    preheat_h: float = 0.0
    preheat_c: float = 25.0
    reserve_soc: float = 0.05
    full_soc: float = 0.8
    heat_pump_from_c: float = -15.0


PLAIN = DriverRules("no preheating")
"""What most cars do without a planner."""
PREHEATING = DriverRules("preheating", preheat_h=0.5)
"""What a car does whose navigation knows the next charger."""


@dataclass(frozen=True)
class DriverTrip:
    """A trip by rules.

    Parameters
    ----------
    rules : DriverRules
        The rules.
    subset : tuple of int
        Chargers used, as far as the driver got.
    controls : Controls or None
        What the car was told.
    trajectory : Trajectory or None
        The transcription's view.
    replay : Replay or None
        The drive on the continuous model.
    cost : float
        Its cost; ``inf`` if the driver does not get there [currency].
    reason : str
        Why not; empty if the driver gets there.
    """

    rules: DriverRules
    subset: tuple[int, ...]
    controls: Controls | None = None
    trajectory: Trajectory | None = None
    replay: Replay | None = None
    cost: float = inf
    reason: str = ""


def _with_charges(controls: Controls, charges: list[float]) -> Controls:
    """Return controls with other charged energies."""
    stops = zip(controls.stops, charges, strict=True)
    return replace(controls, stops=tuple(replace(s, energy_kwh=w) for s, w in stops))


def _as_applied(controls: Controls, now: Trajectory) -> Controls:
    """Return controls with cooling as the thermostat left it, not as it was allowed."""
    stops = zip(controls.stops, now.stops, strict=True)
    return replace(
        controls,
        cooling_kw=now.cooling_kw,
        stops=tuple(replace(s, cooling_kw=done.cooling_kw) for s, done in stops),
    )


class _Driver:
    """Tries legs on the transcription, as the car's range prediction would."""

    def __init__(self, trip: Trip, rules: DriverRules) -> None:
        self.trip, self.rules = trip, rules
        self.drive = make_drive(trip, trip.grid.step_km)
        pack = trip.vehicle.pack
        self.willing = float(pack.energy_kwh(min(rules.full_soc, trip.soc_max)))
        self.full = float(pack.energy_kwh(trip.soc_max))
        position = [c.position_km for c in trip.chargers]
        self.order = sorted(range(len(position)), key=lambda i: (position[i], i))

    def instance(self, subset: tuple[int, ...]) -> Instance:
        """Return the transcription, with the driver's reserve on arrival at chargers."""
        instance = make_instance(self.trip, subset, drive=self.drive)
        pack = self.trip.vehicle.pack
        stops = []
        for stop in instance.stops:
            soc = float(pack.soc(stop.arrive_min_kwh)) + self.rules.reserve_soc
            stops.append(replace(stop, arrive_min_kwh=float(pack.energy_kwh(min(soc, 1.0)))))
        return replace(instance, stops=tuple(stops))

    def controls(self, instance: Instance) -> Controls:
        """Return heat pump and battery heater as the rules have them, with the least charges."""
        rules, car = self.rules, self.trip.vehicle
        controls = idle_controls(instance, (MIN_CHARGE_KWH,) * len(instance.stops))
        pump = car.heat_pump_kw
        heater = np.zeros(self.drive.n_steps)
        clock = np.concatenate([[0.0], np.cumsum(self.drive.duration_h)])
        before = 0
        for stop in instance.stops:
            # whole steps, from the one in which the time before the stop begins
            first = int(np.searchsorted(clock, clock[stop.node] - rules.preheat_h, "right")) - 1
            if rules.preheat_h > 0.0:
                heater[max(first, before) : stop.node] = car.heater_kw
            before = stop.node
        return replace(
            controls,
            heater_kw=heater,
            heat_pump_kw=np.full(self.drive.n_steps, pump),
            stops=tuple(
                replace(s, heat_pump_kw=np.full(instance.cells, pump)) for s in controls.stops
            ),
        )

    def run(self, subset: tuple[int, ...]) -> tuple[Instance, Controls, Trajectory]:
        """Drive with the least charges that carry the car from stop to stop and to the end."""
        instance = self.instance(subset)
        wanted = self.controls(instance)
        simulation = Simulation(instance)
        warm = min(self.rules.preheat_c, instance.temperature_max_c)
        caps = [[instance.temperature_max_c] * instance.cells] * len(subset)
        thermostat = Thermostat([warm] * self.drive.n_steps, caps)
        tight = frozenset(range(1, len(subset)))
        controls = wanted
        for _ in range(PASSES):
            charges = [s.energy_kwh for s in controls.stops]
            wanted = _with_charges(wanted, charges)
            heated = simulation.run(wanted, thermostat=thermostat)
            controls = replace(wanted, heater_kw=heated.heater_kw)
            controls, trajectory = complete(simulation, controls, tight)
            safe = self.protected(instance, wanted, trajectory)
            moved = [abs(s.energy_kwh - w) for s, w in zip(controls.stops, charges, strict=True)]
            if safe is wanted and max(moved, default=0.0) <= SETTLED_KWH:
                break
            wanted = safe
        return instance, _as_applied(controls, trajectory), trajectory

    def protected(self, instance: Instance, wanted: Controls, now: Trajectory) -> Controls:
        """Return the controls as a car changes them whose battery is too cold or too hot.

        Too cold: no heat pump there. Hot: full cooling there. Too hot at a stop in spite of
        it: less power from where it gets hot. Unchanged (the same object) if nothing is.
        """
        car = self.trip.vehicle
        cold, hot = self.rules.heat_pump_from_c, instance.temperature_max_c - HOT_K

        def changed(c: Controls | StopControls, end: Array) -> tuple[Array, Array, bool]:
            pump = np.where(end < cold, 0.0, c.heat_pump_kw)
            cooling = np.where(end > hot, car.cooling_kw, c.cooling_kw)
            new = np.any(pump != c.heat_pump_kw) or np.any(cooling != c.cooling_kw)
            return pump, cooling, bool(new)

        pump, cooling, new = changed(wanted, now.temperature_c[1:])
        stops = []
        for s, done in zip(wanted.stops, now.stops, strict=True):
            cell_pump, cell_cooling, new_here = changed(s, done.temperature_c[1:])
            new |= new_here
            stops.append(replace(s, heat_pump_kw=cell_pump, cooling_kw=cell_cooling))
        if not new:  # only what cooling cannot prevent costs power
            for i, done in enumerate(now.stops):
                end = done.temperature_c[1:]
                if float(end.max()) > instance.temperature_max_c:
                    from_here = np.arange(end.size) >= int(np.argmax(end > hot))
                    power = np.where(from_here, CUT * done.power_kw, stops[i].power_kw)
                    stops[i], new = replace(stops[i], power_kw=power), True
        if not new:
            return wanted
        return replace(wanted, heat_pump_kw=pump, cooling_kw=cooling, stops=tuple(stops))

    def reaches(self, subset: tuple[int, ...], target: int | None, most_kwh: float) -> bool:
        """Return whether the car gets from its last stop to a charger, or to the end (None).

        It may leave that stop with at most ``most_kwh``.
        """
        try:
            instance, _, trajectory = self.run(subset if target is None else (*subset, target))
        except DomainError:
            return False
        last = len(subset) - 1
        if last >= 0 and float(trajectory.stops[last].energy_kwh[-1]) > most_kwh + ROUNDING_KWH:
            return False
        if last >= 0:
            dwell = float(trajectory.stops[last].dwell_h.sum())
            if dwell > instance.stops[last].max_dwell_h:
                return False
        begin = instance.stops[last].node + 1 if last >= 0 else 0
        if target is None:
            end, spare = self.drive.n_steps, trajectory.final_energy_kwh
            spare -= instance.end_energy_min_kwh
        else:
            end, arrival = instance.stops[-1].node, trajectory.stops[-1]
            spare = float(arrival.energy_kwh[0]) - instance.stops[-1].arrive_min_kwh
        way = (trajectory.energy_kwh - instance.energy_min_kwh)[begin : end + 1]
        return bool(min([spare, *way.tolist()]) >= -ROUNDING_KWH)

    def following(self, subset: tuple[int, ...]) -> tuple[int | None, str]:
        """Return the next charger after the last stop, None for the destination; or why none."""
        place = self.order.index(subset[-1]) + 1 if subset else 0
        targets = [None, *reversed(self.order[place:])]
        for most_kwh in (self.willing, self.full) if subset else (self.full,):
            for target in targets:
                if self.reaches(subset, target, most_kwh):
                    return target, ""
        where = self.trip.chargers[subset[-1]].name if subset else "the start"
        return None, f"nothing is in reach from {where}"


def drive_by_rules(trip: Trip, rules: DriverRules = PREHEATING) -> DriverTrip:
    """Drive a trip by rules.

    From every stop: on to the destination if it is in reach, else to the last charger in
    reach with the reserve; as much is charged as that takes.

    Parameters
    ----------
    trip : Trip
        The trip.
    rules : DriverRules
        The rules.

    Returns
    -------
    DriverTrip
        With a reason if the rules do not lead to the destination: nothing is repaired.

    Examples
    --------
    >>> from relax import load_trip
    >>> done = drive_by_rules(load_trip("paper-400km"))
    >>> done.reason, done.replay.feasible, len(done.subset)
    ('', True, 1)
    """
    driver = _Driver(trip, rules)
    subset: tuple[int, ...] = ()
    while True:
        target, reason = driver.following(subset)
        if reason:
            return DriverTrip(rules, subset, reason=reason)
        if target is None:
            return _judged(driver, subset)
        subset = (*subset, target)


def _judged(driver: _Driver, subset: tuple[int, ...]) -> DriverTrip:
    """Return the trip as replayed; one that only a repair would save is refused."""
    instance, controls, trajectory = driver.run(subset)
    refused = DriverTrip(driver.rules, subset, controls, trajectory)
    if not is_feasible(trajectory):
        units = zip(trajectory.violation.tolist(), ("kWh", "K", "kW", "h"), strict=True)
        broken = ", ".join(f"{amount:.3g} {unit}" for amount, unit in units if amount > FEASIBLE)
        return replace(refused, reason=f"breaks limits by {broken}")
    done = execute(driver.trip, instance, Refined(controls, trajectory, True, 0))
    if done.reason:
        return replace(refused, replay=done.replay, reason=done.reason)
    if done.replay is None or done.trajectory is not trajectory:
        return replace(refused, reason="breaks a limit on the continuous model")
    return replace(refused, replay=done.replay, cost=done.replay.cost)
