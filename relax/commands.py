"""Owns what becomes of commands that a car cannot follow, before they are simulated or driven.

Commands that mean nothing are refused by name; powers beyond an actuator's rating are taken
back to it, as the car's own controller would, and listed. Knows neither the battery's state
nor how commands are found.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from relax.driven import Clipped
from relax.errors import InputError
from relax.instance import Instance
from relax.plan import Controls, StopControls

__all__ = ["check_controls", "within_ratings"]

ROUNDING_KW = 1e-6
"""Excess over a rating that is rounding, taken back without a word [kW]."""
ACTUATORS = ("heater_kw", "cooling_kw", "heat_pump_kw")
"""Controls with a rating of the vehicle, which has its name."""


def _refuse(field: str, value: object, allowed: str) -> None:
    raise InputError("controls", field, value, allowed)


def check_controls(instance: Instance, controls: Controls) -> None:
    """Refuse controls that mean nothing: wrong numbers of values, no numbers, no charging power.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        What is commanded.

    Raises
    ------
    InputError
        Names the command, its value and what is allowed.

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> controls = idle_controls(instance, (20.0,))
    >>> check_controls(instance, controls)
    >>> controls.stops[0].power_kw[3] = 0.0
    >>> check_controls(instance, controls)
    Traceback (most recent call last):
    relax.errors.InputError: controls: stops[0].power_kw[3]: 0.0; allowed: more than 0 kW
    """
    if len(controls.stops) != len(instance.stops):
        _refuse("stops", len(controls.stops), f"one for each of {len(instance.stops)} stops")
    for name in ACTUATORS:
        _check_numbers(getattr(controls, name), name, instance.drive.n_steps, "driving steps")
    for i, stop in enumerate(controls.stops):
        where, cells = f"stops[{i}]", max(np.size(stop.power_kw), 1)
        for name in ("power_kw", *ACTUATORS):
            _check_numbers(getattr(stop, name), f"{where}.{name}", cells, "cells")
        if not 0.0 < stop.energy_kwh < np.inf:
            _refuse(f"{where}.energy_kwh", stop.energy_kwh, "more than 0 kWh")
        for j in np.flatnonzero(stop.power_kw <= 0.0)[:1].tolist():
            _refuse(f"{where}.power_kw[{j}]", float(stop.power_kw[j]), "more than 0 kW")


def _check_numbers(values: npt.NDArray[np.float64], name: str, count: int, of: str) -> None:
    """Refuse an array of another length or with values that are no numbers."""
    if np.shape(values) != (count,):
        _refuse(name, f"shape {np.shape(values)}", f"one value for each of {count} {of}")
    for k in np.flatnonzero(np.isnan(values))[:1].tolist():
        _refuse(f"{name}[{k}]", float(values[k]), "a number of kW")


def within_ratings(instance: Instance, controls: Controls) -> tuple[Controls, tuple[Clipped, ...]]:
    """Return the controls as the actuators can follow them, and what that took back.

    Heater, cooling and heat pump are kept within 0 and their ratings. Room that the cabin
    takes from the heater, or a charging power beyond what battery and charger allow, depends
    on the state and is not listed: commands may say "as much as possible" there.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        What is commanded.

    Returns
    -------
    tuple of Controls and tuple of Clipped
        The same object and nothing if all commands are within the ratings. The largest
        excess of every actuator is listed, with its place.

    Examples
    --------
    >>> import numpy as np
    >>> from dataclasses import replace
    >>> from relax import idle_controls, load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> cold = replace(idle_controls(instance, (20.0,)), cooling_kw=np.full(100, 4.5))
    >>> clipped, taken_back = within_ratings(instance, cold)
    >>> float(clipped.cooling_kw.max()), str(taken_back[0])
    (3.0, 'cooling_kw of 4.5 at 0.0 km: the car gives 3')
    """
    worst: dict[str, tuple[float, Clipped]] = {}

    def clip(part: Controls | StopControls, km: npt.NDArray[np.float64]) -> dict[str, Any]:
        changed: dict[str, Any] = {}
        for name in ACTUATORS:
            asked = getattr(part, name)
            given = np.clip(asked, 0.0, getattr(instance.vehicle, name))
            excess = np.abs(asked - given)
            k = int(np.argmax(excess))
            if excess[k] == 0.0:
                continue
            changed[name] = given
            if excess[k] > max(ROUNDING_KW, worst[name][0] if name in worst else 0.0):
                found = Clipped(name, float(km[k]), float(asked[k]), float(given[k]))
                worst[name] = float(excess[k]), found
        return changed

    node_km = instance.drive.node_km
    driving = clip(controls, node_km)
    stops = []
    for stop, commands in zip(instance.stops, controls.stops, strict=True):
        changes = clip(commands, np.full(commands.power_kw.size, node_km[stop.node]))
        stops.append(replace(commands, **changes) if changes else commands)
    if driving or any(a is not b for a, b in zip(stops, controls.stops, strict=True)):
        controls = replace(controls, stops=tuple(stops), **driving)
    return controls, tuple(found for _, found in worst.values())
