"""Owns the starting controls of a refinement. Suggests, never proves."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, StopControls
from relax.simulate import idle_controls

if TYPE_CHECKING:
    from relax.relaxed_point import RelaxedPoint

__all__ = ["even_start", "relaxed_start", "split_starts"]

Array = npt.NDArray[np.float64]

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
    """Return the controls of a relaxed optimum; the simulation makes a real trajectory of them."""
    stops: list[StopControls] = []
    for stop in point.stops:
        hours = np.maximum(stop.dwell_h, 1e-9)
        stops.append(
            StopControls(
                energy_kwh=max(float(stop.energy_kwh), MIN_CHARGE_KWH),
                power_kw=np.full(instance.cells, inf),
                heater_kw=np.maximum(stop.heater_kwh / hours, 0.0),
                cooling_kw=np.maximum(stop.cooling_kwh / hours, 0.0),
                heat_pump_kw=np.maximum(stop.heat_pump_kwh / hours, 0.0),
            )
        )
    return Controls(
        heater_kw=np.maximum(point.heater_kw, 0.0),
        cooling_kw=np.maximum(point.cooling_kw, 0.0),
        heat_pump_kw=np.maximum(point.heat_pump_kw, 0.0),
        stops=tuple(stops),
    )


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
