"""Owns the starting controls of a refinement. Suggests, never proves."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from relax.completion import complete, merit
from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, StopControls
from relax.simulate import Simulation, Thermostat, idle_controls, is_feasible

if TYPE_CHECKING:
    from collections.abc import Iterator

    from relax.relaxed_point import RelaxedPoint

__all__ = [
    "best_start",
    "colder_start",
    "even_start",
    "further_starts",
    "relaxed_start",
    "split_starts",
    "thinned_starts",
    "warm_start",
    "warmer_start",
]

Array = npt.NDArray[np.float64]

NEAR = 0.5
"""Relative distance to its bound within which the relaxed start is taken as it is."""
WARM_LEVELS = ((10.0, 0.0), (20.0, 0.5), (30.0, 0.5), (30.0, 1.0))
"""Temperature and time ahead of the stop of the warm starts [degrees C, h]."""
WARMER = (20.0, 0.5)
"""The same of the start that heats more than a plan does."""
SMALL_SHARE = 0.1
"""Share of the energy that stays with each other stop when one carries most."""


def even_start(instance: Instance) -> Controls:
    """Return controls with the heat pump as the cabin asks, no battery heating, equal stops."""
    need = float(np.sum(instance.drive.base_kw * instance.drive.duration_h))
    need += instance.end_energy_min_kwh - instance.start_energy_kwh
    count = max(len(instance.stops), 1)
    each = max(need / count, 1.0)
    controls = idle_controls(instance, (each,) * len(instance.stops))
    pump = instance.vehicle.heat_pump_kw
    return replace(
        controls,
        heat_pump_kw=np.full(instance.drive.n_steps, pump),
        stops=tuple(replace(s, heat_pump_kw=np.full(instance.cells, pump)) for s in controls.stops),
    )


def relaxed_start(instance: Instance, point: RelaxedPoint) -> Controls:
    """Return controls that follow a relaxed optimum: its stops, its battery temperature.

    The relaxation warms the battery partly by losses that do not exist; the
    heater, as far as it can, makes up for them.
    """
    stops: list[StopControls] = []
    for stop in point.stops:
        hours = np.maximum(stop.dwell_h, 1e-9)
        stops.append(
            StopControls(
                energy_kwh=max(float(stop.energy_kwh), MIN_CHARGE_KWH),
                power_kw=np.full(instance.cells, inf),
                heater_kw=np.full(instance.cells, instance.vehicle.heater_kw),
                cooling_kw=np.maximum(stop.cooling_kwh / hours, 0.0),
                heat_pump_kw=np.maximum(stop.heat_pump_kwh / hours, 0.0),
            )
        )
    wanted = Controls(
        heater_kw=np.full(instance.drive.n_steps, instance.vehicle.heater_kw),
        cooling_kw=np.maximum(point.cooling_kw, 0.0),
        heat_pump_kw=np.maximum(point.heat_pump_kw, 0.0),
        stops=tuple(stops),
    )
    thermostat = Thermostat(
        point.temperature_c[1 : instance.drive.n_steps + 1].tolist(),
        [stop.temperature_c[1:].tolist() for stop in point.stops],
    )
    return _followed(instance, wanted, thermostat)


def warm_start(
    instance: Instance, controls: Controls, temperature_c: float, ahead_h: float
) -> Controls:
    """Return controls that heat the battery up to a temperature before and during every stop.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        Everything but the heater.
    temperature_c : float
        Where the heater stops [degrees C].
    ahead_h : float
        Driving time before each stop from which it heats [h].
    """
    clock = np.cumsum(instance.drive.duration_h)
    heater = np.zeros(instance.drive.n_steps)
    for stop in instance.stops:
        arrival = clock[stop.node - 1] if stop.node else 0.0
        heater[: stop.node][clock[: stop.node] > arrival - ahead_h] = instance.vehicle.heater_kw
    full = np.full(instance.cells, instance.vehicle.heater_kw)
    wanted = replace(
        controls,
        heater_kw=heater,
        stops=tuple(replace(s, heater_kw=full) for s in controls.stops),
    )
    top = min(temperature_c, instance.temperature_max_c)
    caps = [top] * instance.cells
    return _followed(
        instance, wanted, Thermostat([top] * heater.size, [caps] * len(instance.stops))
    )


def best_start(
    instance: Instance,
    point: RelaxedPoint | None,
    bound: float,
    simulation: Simulation | None = None,
) -> Controls:
    """Return the most promising start: the relaxed one if near its bound, else the best of a few.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    point : RelaxedPoint or None
        Relaxed optimum.
    bound : float
        Lower bound of the subset [currency].
    simulation : Simulation, optional
        Of the instance; keeps the start's trajectory for ``refine``.
    """
    simulation = simulation or Simulation(instance)

    def completed(controls: Controls) -> tuple[float, Controls]:
        controls, trajectory = complete(simulation, controls)
        return merit(instance, trajectory), controls

    even = even_start(instance)
    if not instance.stops and is_feasible(simulation.run(even)):
        return even  # nothing costs anything: the relaxed optimum would heat and cool at random
    first = completed(even if point is None else relaxed_start(instance, point))
    if first[0] <= bound + NEAR * abs(bound) or not instance.stops:
        return first[1]
    cold = replace(even, stops=first[1].stops)
    others = [warm_start(instance, cold, *level) for level in WARM_LEVELS]
    found = [first, *(completed(c) for c in [*others, even])]
    return min(found, key=lambda pair: pair[0])[1]


def further_starts(instance: Instance) -> Iterator[Controls]:
    """Yield starts for a subset whose plans break a limit: even, warm, and split between stops.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    """
    even = even_start(instance)
    yield even
    for level in WARM_LEVELS if instance.stops else ():
        yield warm_start(instance, even, *level)
    yield from split_starts(instance, even)


def _followed(instance: Instance, wanted: Controls, thermostat: Thermostat) -> Controls:
    """Return the heater powers that a thermostat leads to, everything else as wanted."""
    ran = Simulation(instance).run(wanted, thermostat=thermostat)
    return wanted.heated_as(ran)


def split_starts(instance: Instance, controls: Controls) -> list[Controls]:
    """Return one start per stop, in which that stop carries most of the energy.

    Local optima of trips with several stops differ in which stop carries the energy.
    """
    total = sum(s.energy_kwh for s in controls.stops)
    count = len(controls.stops)
    if count < 2:
        return []
    small = max(SMALL_SHARE * total / count, MIN_CHARGE_KWH)
    return [
        replace(
            controls,
            stops=tuple(
                replace(s, energy_kwh=total - (count - 1) * small if i == most else small)
                for i, s in enumerate(controls.stops)
            ),
        )
        for most in range(count)
    ]


def thinned_starts(controls: Controls, stop: int) -> list[Controls]:
    """Return starts without one stop: those before and after it carry its energy, one at a time.

    Parameters
    ----------
    controls : Controls
        Of a plan that uses the stop.
    stop : int
        Its place among the plan's stops.
    """
    rest = [s for i, s in enumerate(controls.stops) if i != stop]
    energy = controls.stops[stop].energy_kwh
    heirs = {max(stop - 1, 0), min(stop, len(rest) - 1)} if rest else set()
    return [
        replace(
            controls,
            stops=tuple(
                replace(s, energy_kwh=s.energy_kwh + energy) if i == heir else s
                for i, s in enumerate(rest)
            ),
        )
        for heir in sorted(heirs)
    ]


def warmer_start(instance: Instance, controls: Controls) -> Controls:
    """Return a plan's controls, but heating the battery before and during every stop.

    Where a table has a kink a plan that heats too little may gain nothing from a little more.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        The plan's.
    """
    return warm_start(instance, controls, *WARMER)


def colder_start(controls: Controls) -> Controls:
    """Return a plan's controls without any heating of the battery.

    Parameters
    ----------
    controls : Controls
        The plan's.
    """
    stops = tuple(replace(s, heater_kw=np.zeros_like(s.heater_kw)) for s in controls.stops)
    return replace(controls, heater_kw=np.zeros_like(controls.heater_kw), stops=stops)
