"""Owns what a refinement minimises, and the charged energies that meet the energy limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, Trajectory
from relax.simulate import Simulation

__all__ = ["complete", "merit", "penalty_prices"]

Array = npt.NDArray[np.float64]

END_TOLERANCE_KWH = 2e-5
"""How exactly the energy at the end of the trip meets its limit [kWh]."""
MAX_PASSES = 6
"""Bound on the simulations that meet the energy limits; each gains a factor of about 50."""


def penalty_prices(instance: Instance) -> Array:
    """Return the prices of violated limits, shape (4,) [currency per kWh, K, kW, h].

    Far above what a kWh can be worth on the trip: its energy price, and its share of
    the dwell at a slow, cold charger; so the penalty is exact. The others weigh
    10 K, 10 kW and 6 minutes like 1 kWh; under a limit of the time in all 36 seconds:
    near the least time of a trip a minute is worth several kWh.
    """
    prices = [abs(s.price_per_kwh) for s in instance.stops]
    hours = [s.time_price_per_h + s.occupancy_price_per_h for s in instance.stops]
    price = 20.0 * max([0.1, *prices]) + 2.0 * max([0.0, *hours])
    hour = 10.0 if np.isinf(instance.total_dwell_h) else 100.0
    return price * np.array([1.0, 0.1, 0.1, hour])


def merit(instance: Instance, trajectory: Trajectory, weight: float = 1.0) -> float:
    """Return cost plus penalty of a trajectory, its prices times a weight [currency]."""
    return trajectory.cost + weight * float(penalty_prices(instance) @ trajectory.violation)


def complete(
    simulation: Simulation, controls: Controls, tight: frozenset[int] = frozenset()
) -> tuple[Controls, Trajectory]:
    """Simulate, with charged energies such that binding energy limits are met exactly.

    Parameters
    ----------
    simulation : Simulation
        Of the instance.
    controls : Controls
        Any controls; only charged energies change.
    tight : frozenset of int
        Stops at which the car is to arrive with the least energy: the stop before
        each gives or takes what is missing. The largest stop after the last of them
        makes the trip end at its least energy.

    Returns
    -------
    tuple of Controls and Trajectory
        The limits are met to 2e-5 kWh unless a full or an empty battery prevents it.
    """
    trajectory = simulation.run(controls)
    for _ in range(MAX_PASSES if controls.stops else 0):
        shift = _shortage(simulation.instance, controls, trajectory, tight, simulation.worth)
        shift[np.abs(shift) <= END_TOLERANCE_KWH] = 0.0  # what is kept was simulated without
        changed = np.flatnonzero(shift)
        if not changed.size:
            break
        stops = tuple(
            replace(s, energy_kwh=s.energy_kwh + w)
            for s, w in zip(controls.stops, shift.tolist(), strict=True)
        )
        controls = replace(controls, stops=stops)
        before = trajectory.final_energy_kwh
        trajectory = simulation.run(controls, keep=int(changed[0]))
        gained, added = trajectory.final_energy_kwh - before, float(shift.sum())
        if gained * added > 0.0 and 0.5 < added / gained < 2.0:
            simulation.worth = added / gained
    return controls, trajectory


def _shortage(
    instance: Instance,
    controls: Controls,
    trajectory: Trajectory,
    tight: frozenset[int],
    rate: float,
) -> Array:
    """Return the changes of the charged energies that meet the energy limits to first order."""
    charged = [s.energy_kwh for s in controls.stops]
    arrive = [float(s.energy_kwh[0]) for s in trajectory.stops]
    shifts = np.zeros(len(charged))
    first = 0

    def give(i: int, amount: float) -> float:
        full = instance.energy_max_kwh - arrive[i] - float(shifts[:i].sum())
        target = max(min(charged[i] + rate * amount, full), MIN_CHARGE_KWH)
        shifts[i] = target - charged[i]
        return float(shifts[i]) / rate

    for m in range(1, len(charged)):
        missing = instance.stops[m].arrive_min_kwh - arrive[m] - float(shifts.sum())
        if m in tight or missing > END_TOLERANCE_KWH:
            give(m - 1, missing)
            first = m
    missing = instance.end_energy_min_kwh - trajectory.final_energy_kwh - float(shifts.sum()) / rate
    for i in sorted(range(first, len(charged)), key=lambda i: (-charged[i], i)):
        if abs(missing) <= END_TOLERANCE_KWH:
            break
        missing -= give(i, missing)
    return shifts
