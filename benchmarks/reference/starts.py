"""Owns the starting points of the nonlinear reference: deterministic, spread over what may differ.

A track of constant battery temperature and a split of the energy over the
stops; powers and states follow from these. Knows nothing of solvers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.reference.nlp import MIN_CHARGE_KW
from benchmarks.reference.program import Model
from relax.instance import MIN_CHARGE_KWH, Instance, Stop

__all__ = ["Start", "make_start", "single_start", "starts"]

Array = npt.NDArray[np.float64]

LEVELS_C = (15.0, 25.0, 35.0)
"""Temperature tracks beside the one that stays at the start temperature."""
FRONT_SHARE = 0.7
"""Share of the first (last) stop in an uneven split."""
HEATING_GUESS_KW = 0.5
"""Guess of heater, cooling and heat pump: off their bounds."""
MARGIN = 0.02
"""Relative distance kept from bounds of states."""


@dataclass(frozen=True)
class Start:
    """A starting point in words.

    Parameters
    ----------
    temperature_c : float
        Battery temperature after the first step.
    shares : tuple of float
        Split of the charged energy over the stops; sums to one.
    """

    temperature_c: float
    shares: tuple[float, ...]


def single_start(instance: Instance) -> Start:
    """Return the one start to use when only one is allowed: 25 degrees C, even split.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> single_start(make_instance(load_trip("paper-400km"), (0, 2)))
    Start(temperature_c=25.0, shares=(0.5, 0.5))
    """
    count = len(instance.stops)
    return Start(25.0, (1.0 / count,) * count if count else ())


def starts(instance: Instance) -> tuple[Start, ...]:
    """Return all starts: four temperature tracks times up to three splits.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> trip = load_trip("paper-400km")
    >>> [len(starts(make_instance(trip, s))) for s in ((), (0,), (0, 2))]
    [4, 4, 12]
    """
    count = len(instance.stops)
    splits = [single_start(instance).shares]
    if count > 1:
        rest = (1.0 - FRONT_SHARE) / (count - 1)
        splits.append((FRONT_SHARE,) + (rest,) * (count - 1))
        splits.append((rest,) * (count - 1) + (FRONT_SHARE,))
    levels = (instance.start_temperature_c, *LEVELS_C)
    return tuple(Start(level, split) for split in splits for level in levels)


def _charging_powers(instance: Instance, stop: Stop, energy: Array, temp: float) -> Array:
    limit = instance.vehicle.pack.charge_limit_kw(energy, np.full(energy.shape, temp))
    free = stop.grid_limit_kw(energy) - stop.base_kw - stop.cabin_heat_kw
    return np.maximum(0.9 * np.minimum(limit, free), 2.0 * MIN_CHARGE_KW)


def make_start(model: Model, start: Start) -> Array:
    """Return the point of a model's program that a start describes, shape (n,).

    Parameters
    ----------
    model : Model
        The program.
    start : Start
        Track and split.

    Raises
    ------
    ValueError
        The split has not one share per stop.
    """
    instance = model.instance
    if len(start.shares) != len(instance.stops):
        raise ValueError(f"a split needs one share per stop, {len(instance.stops)}")
    drive, cells, top = instance.drive, instance.cells, instance.energy_max_kwh
    low = float(instance.energy_min_kwh.min())
    keep = MARGIN * (top - low)
    level = float(
        np.clip(start.temperature_c, instance.temperature_min_c, instance.temperature_max_c)
    )
    power = drive.base_kw + drive.cabin_heat_kw / instance.vehicle.heater_cabin_efficiency
    power = power + drive.drivetrain_heat_kw * 0.2 + 2.0 * HEATING_GUESS_KW
    need = float(power @ drive.duration_h) + instance.end_energy_min_kwh
    need += sum(s.detour_in_kwh + s.detour_out_kwh for s in instance.stops)
    need = max(need - instance.start_energy_kwh, MIN_CHARGE_KWH)
    value = np.zeros(model.scale.size)

    def put(row: dict[str, int], **entries: float) -> None:
        for name, entry in entries.items():
            if name in row:
                value[row[name]] = entry

    def inside(energy: float) -> float:
        return min(max(energy, low + keep), top - keep)

    energy, temp = instance.start_energy_kwh, instance.start_temperature_c
    guesses = dict.fromkeys(("heater", "cooling", "pump"), HEATING_GUESS_KW)
    stop_index = 0
    for k in range(drive.n_steps + 1):
        while stop_index < len(instance.stops) and instance.stops[stop_index].node == k:
            stop = instance.stops[stop_index]
            charge = max(need * start.shares[stop_index], 2.0 * MIN_CHARGE_KWH)
            charge = max(min(charge, top - energy + stop.detour_in_kwh), MIN_CHARGE_KWH)
            middle = energy - stop.detour_in_kwh + (np.arange(cells) + 0.5) * charge / cells
            rates = _charging_powers(instance, stop, np.clip(middle, low, top), temp)
            spent = 0.0
            for j, row in enumerate(model.cells[stop_index]):
                put(row, energy=inside(float(middle[j]) - 0.5 * charge / cells), temperature=temp)
                put(row, use=1.0, charge=charge, dwell=spent)
                put(row, charge_power=float(rates[j]), **guesses)
                spent += charge / cells / float(rates[j])
                put(row, over=max(spent - stop.occupancy_free_h, 0.0) + 0.01)
            energy = inside(energy - stop.detour_in_kwh + charge - stop.detour_out_kwh)
            stop_index += 1
        row = model.steps[k] if k < drive.n_steps else model.last
        put(row, energy=energy, temperature=temp)
        if k < drive.n_steps:
            put(row, power=float(power[k]), rise=level - temp, brake=HEATING_GUESS_KW, **guesses)
            energy, temp = inside(energy - float(drive.duration_h[k] * power[k])), level
    return np.clip(value / model.scale, model.x_lo, model.x_hi)
