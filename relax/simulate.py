"""Owns the exact solution of the transcription for given controls: what the car does on the grid.

Chains the steps and stops of ``step`` and notes what they violate. Knows
nothing of optimisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import inf

import numpy as np

from relax.commands import check_controls
from relax.errors import InputError
from relax.instance import LEAST_ROOM_KW, MIN_CHARGE_KWH, Instance, Stop
from relax.plan import Controls, StopControls, StopTrajectory, Trajectory
from relax.step import Car, StepResult, charge, drive_rows, drive_step

__all__ = [
    "FEASIBLE",
    "Simulation",
    "Thermostat",
    "idle_controls",
    "is_feasible",
    "simulate",
    "stop_cost",
]


FEASIBLE = 2e-5
"""Violation that counts as none [kWh, K, kW, h]."""


def is_feasible(trajectory: Trajectory) -> bool:
    """Return whether no limit is violated by more than rounding."""
    return float(trajectory.violation.max()) <= FEASIBLE


def stop_cost(stop: Stop, dwell_h: float, grid_kwh: float) -> float:
    """Return the cost of one stop: energy, time, occupancy, detour and penalty [currency]."""
    occupied = max(0.0, dwell_h - stop.occupancy_free_h)
    return (
        stop.price_per_kwh * grid_kwh
        + stop.time_price_per_h * dwell_h
        + stop.occupancy_price_per_h * occupied
        + stop.fixed_cost
    )


@dataclass
class _Walk:
    """What has been simulated so far: the state, and the rows of the trajectory."""

    energy: float
    temp: float
    arrival: list[tuple[float, float]] = field(default_factory=list)
    start: list[tuple[float, float]] = field(default_factory=list)
    rows: list[StepResult] = field(default_factory=list)
    stops: list[StopTrajectory] = field(default_factory=list)
    cost: float = 0.0
    short: float = 0.0
    excess_kw: float = 0.0
    excess_h: float = 0.0

    def copy(self) -> _Walk:
        """Return an independent copy; the rows themselves are immutable."""
        return replace(
            self,
            arrival=self.arrival.copy(),
            start=self.start.copy(),
            rows=self.rows.copy(),
            stops=self.stops.copy(),
        )


@dataclass(frozen=True)
class Thermostat:
    """Battery temperatures beyond which the heater does not heat.

    Parameters
    ----------
    drive_c : sequence of float, length n
        At the end of every driving step [degrees C].
    stops_c : sequence of sequences of float
        At the end of every cell, per stop [degrees C].
    """

    drive_c: Sequence[float]
    stops_c: Sequence[Sequence[float]]


class _Trickle(Car):
    """The car if its battery never refused charge altogether; by how much it does is an excess."""

    def __init__(self, instance: Instance) -> None:
        super().__init__(instance)
        self._limit = self.charge_limit
        self.charge_limit = lambda energy, temp: max(self._limit(energy, temp), LEAST_ROOM_KW)

    def excess_kw(self, done: StopTrajectory) -> float:
        """Return the largest excess over the battery's own limit at the middle of a cell [kW]."""
        energy, temp = (0.5 * (x[1:] + x[:-1]) for x in (done.energy_kwh, done.temperature_c))
        middles = zip(energy.tolist(), temp.tolist(), done.power_kw.tolist(), strict=True)
        return max(float(power - self._limit(e, t)) for e, t, power in middles)


class Simulation:
    """Simulates one instance again and again, keeping what a change leaves untouched.

    Parameters
    ----------
    instance : Instance
        Subset and grid.

    Notes
    -----
    ``worth`` is how much charged energy one kWh at the end takes, by the losses on
    the way: kept here for those who charge until an end energy is met.
    """

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self._car = Car(instance)
        self._trickle: _Trickle | None = None
        self.drive_rows = drive_rows(instance.drive)
        self._at_stop: list[_Walk] = []
        self.worth = 1.0
        n, cells = instance.drive.n_steps, instance.cells
        top = instance.temperature_max_c
        self._limit = Thermostat([top] * n, [[top] * cells] * len(instance.stops))
        self._thermostat = self._limit
        self._last: tuple[Controls, Trajectory] | None = None

    def run(
        self, controls: Controls, keep: int | None = None, thermostat: Thermostat | None = None
    ) -> Trajectory:
        """Return the trajectory of the controls.

        Parameters
        ----------
        controls : Controls
            Powers per step and cell.
        keep : int, optional
            The controls before stop ``keep`` are those of the last run: it goes on
            from the arrival there.
        thermostat : Thermostat, optional
            Temperatures beyond which the heaters do not heat; the battery's limit
            by default.
        """
        if keep is None and thermostat is None and self._last and self._last[0] is controls:
            return self._last[1]
        stops = self.instance.stops
        self._thermostat = thermostat or self._limit
        walk = _Walk(self.instance.start_energy_kwh, self.instance.start_temperature_c)
        node = 0
        if keep is not None and keep < len(self._at_stop):
            walk, node = self._at_stop[keep].copy(), stops[keep].node
            self._at_stop = self._at_stop[: keep + 1]
        else:
            keep = 0
            self._at_stop = []
            if stops:
                node = stops[0].node
                self._leg(walk, controls, 0, node)
                self._at_stop = [walk.copy()]
        for i in range(keep, len(stops)):
            self._stop(walk, controls, i)
            last = i + 1 == len(stops)
            end = self.instance.drive.n_steps if last else stops[i + 1].node
            self._leg(walk, controls, node, end)
            node = end
            if not last:
                self._at_stop.append(walk.copy())
        if not stops:
            self._leg(walk, controls, 0, self.instance.drive.n_steps)
        trajectory = self._trajectory(walk, controls)
        self._last = (controls, trajectory) if thermostat is None else None
        return trajectory

    def _leg(self, walk: _Walk, controls: Controls, begin: int, end: int) -> None:
        """Drive from node to node."""
        car, energy, temp = self._car, walk.energy, walk.temp
        rise = extra = slope = 0.0
        least = self.instance.energy_min_kwh
        if begin == 0 and not walk.arrival:
            walk.arrival.append((energy, temp))
        settings = zip(
            self.drive_rows[begin:end],
            controls.heater_kw[begin:end].tolist(),
            np.clip(controls.cooling_kw[begin:end], 0.0, car.cooling_kw).tolist(),
            controls.heat_pump_kw[begin:end].tolist(),
            least[begin + 1 : end + 1].tolist(),
            self._thermostat.drive_c[begin:end],
            strict=True,
        )
        short = walk.short
        for row, heater, cooling, pump, low, cap in settings:
            walk.start.append((energy, temp))
            guess = (rise, extra, slope)
            result, slope = drive_step(car, row, energy, temp, heater, cooling, pump, guess, cap)
            rise, extra = result[0] - temp, result[1] - row[1]
            energy, temp = energy - row[0] * result[1], result[0]
            if low - energy > short:
                short = low - energy
            walk.rows.append(result)
            walk.arrival.append((energy, temp))
        walk.energy, walk.temp, walk.short = energy, temp, short

    def _stop(self, walk: _Walk, controls: Controls, i: int) -> None:
        """Charge at stop i."""
        stop, wanted = self.instance.stops[i], controls.stops[i]
        if not (wanted.energy_kwh > 0.0 and wanted.power_kw.min() > 0.0):
            check_controls(self.instance, controls)
        if wanted.cooling_kw.min() < 0.0:
            wanted = replace(wanted, cooling_kw=np.maximum(wanted.cooling_kw, 0.0))
        arrive = walk.energy - stop.detour_in_kwh
        caps = self._thermostat.stops_c[i]
        try:
            done, excess = charge(self._car, stop, wanted, arrive, walk.temp, caps)
        except ZeroDivisionError:  # the battery's limit is 0 somewhere: that cell would never end
            if self._trickle is None:
                self._trickle = _Trickle(self.instance)
            done, excess = charge(self._trickle, stop, wanted, arrive, walk.temp, caps)
            excess = max(excess, self._trickle.excess_kw(done))
        first, last = float(done.energy_kwh[0]), float(done.energy_kwh[-1])
        dwell = float(done.dwell_h.sum())
        walk.cost += stop_cost(stop, dwell, float(done.grid_kwh.sum()))
        walk.short = max(
            walk.short,
            stop.arrive_min_kwh - first,
            stop.leave_min_kwh - last + stop.detour_out_kwh,
            last - self.instance.energy_max_kwh,
            MIN_CHARGE_KWH - wanted.energy_kwh,
        )
        walk.excess_kw = max(walk.excess_kw, excess)
        walk.excess_h = max(walk.excess_h, dwell - stop.max_dwell_h)
        walk.energy, walk.temp = last - stop.detour_out_kwh, float(done.temperature_c[-1])
        walk.stops.append(done)

    def _trajectory(self, walk: _Walk, controls: Controls) -> Trajectory:
        instance = self.instance
        arrive, begin = np.array(walk.arrival), np.array(walk.start)
        table = np.array(list(chain.from_iterable(walk.rows))).reshape(len(walk.rows), -1)
        pack = instance.vehicle.pack
        passed = np.concatenate([arrive[1:, 1], *(s.temperature_c[1:] for s in walk.stops)])
        # a repair tightens the instance's limits, which the given start need not meet
        hot = max(passed.max() - instance.temperature_max_c, arrive[0, 1] - pack.temperature_max_c)
        cold = max(instance.temperature_min_c - passed.min(), pack.temperature_min_c - arrive[0, 1])
        stopped = sum(float(s.dwell_h.sum()) for s in walk.stops)
        violation = np.array(
            [
                max(walk.short, float(arrive[:, 0].max()) - instance.ceiling_kwh),
                max(hot, cold),
                max(float(table[:, 9].max()), walk.excess_kw),
                max(walk.excess_h, stopped - instance.total_dwell_h) if walk.stops else 0.0,
            ]
        )
        return Trajectory(
            energy_kwh=arrive[:, 0],
            temperature_c=arrive[:, 1],
            energy_start_kwh=begin[:, 0],
            temperature_start_c=begin[:, 1],
            power_kw=table[:, 1],
            loss_kw=table[:, 2],
            brake_kw=table[:, 3],
            heater_kw=table[:, 4],
            cooling_kw=table[:, 8],
            heat_pump_kw=table[:, 5],
            pump_heat_kw=table[:, 6],
            cabin_heater_kw=table[:, 7],
            stops=tuple(walk.stops),
            final_energy_kwh=walk.energy,
            final_temperature_c=walk.temp,
            cost=walk.cost,
            violation=np.maximum(violation, 0.0),
        )


def simulate(instance: Instance, controls: Controls) -> Trajectory:
    """Return the trajectory that the controls cause on the transcription.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        Powers per step and cell; clipped to the actuators, the cabin's demand,
        the charge limits and a full battery where they exceed them. The battery heater never
        heats beyond the battery's temperature limit. Every stop charges: its
        energy and its planned powers are above 0.

    Returns
    -------
    Trajectory
        Exact for the transcription (equations (T1) .. (T10) of ``docs/maths.md``),
        feasible in the dynamics; limits of energy, temperature, discharge power
        and dwell may be violated, by the amounts it states. A battery that takes no charge
        at all is charged with 0.02 kW: its excess is a violation, and so is that dwell.

    Raises
    ------
    InputError
        Controls mean nothing: another number of values than steps or cells, no number, a stop
        without energy or with a charging power that is not above 0. Names the command.

    Examples
    --------
    >>> from relax import load_trip, make_instance, simulate, idle_controls
    >>> instance = make_instance(load_trip("paper-400km"), (0, 2))
    >>> trajectory = simulate(instance, idle_controls(instance, energy_kwh=(20.0, 20.0)))
    >>> len(trajectory.stops), trajectory.power_kw.shape
    (2, (100,))
    """
    check_controls(instance, controls)
    for i, stop in enumerate(controls.stops):
        if stop.power_kw.size != instance.cells:
            name, count = f"stops[{i}].power_kw", f"{stop.power_kw.size} values"
            raise InputError("controls", name, count, f"one for each of {instance.cells} cells")
    return Simulation(instance).run(controls)


def idle_controls(instance: Instance, energy_kwh: tuple[float, ...]) -> Controls:
    """Return controls that heat nothing, pump nothing and charge as fast as the limits allow.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    energy_kwh : tuple of float
        Internal energy charged at every stop [kWh].
    """
    n, cells = instance.drive.n_steps, instance.cells
    zero, none = np.zeros(n), np.zeros(cells)
    full = np.full(cells, inf)
    return Controls(
        zero, zero, zero, tuple(StopControls(w, full, none, none, none) for w in energy_kwh)
    )
