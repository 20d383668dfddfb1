"""Owns the last correction of a reference plan: energies that fit the tables, not the splines.

The smooth program meets the energy limits on its own maps; on the tables the
same controls end a few Wh off, and charge a hair slower than the tables
allow. A stop charges that much more or less, and as fast as allowed where that
was meant. Knows nothing of programs and solvers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from relax.instance import MIN_CHARGE_KWH, Instance
from relax.plan import Controls, Trajectory
from relax.simulate import is_feasible, simulate

__all__ = ["polish", "release"]

Array = npt.NDArray[np.float64]

SLACK_TOLERANCE_KWH = 1e-6
"""Energy beyond the least one that is not worth another simulation [kWh]."""
FULL_POWER = 0.99
"""A planned power above this share of what the tables allow is meant as all they allow."""
LEAST_POWER_KW = 1e-3
"""Charging power at least; what charges more slowly misses every limit of time [kW]."""
MAX_ROUNDS = 12
"""Bound on simulations; each leaves about a twentieth of the error."""


def _slack(instance: Instance, trajectory: Trajectory) -> Array:
    """Return per stop the least energy to spare until the next stop or the end [kWh]."""
    spare = trajectory.energy_kwh - instance.energy_min_kwh
    stops, done = instance.stops, trajectory.stops
    slack = []
    for i, stop in enumerate(stops):
        leave = float(done[i].energy_kwh[-1]) - stop.detour_out_kwh
        values = [leave - stop.leave_min_kwh]
        if i + 1 < len(stops):
            node = stops[i + 1].node
            values.append(float(done[i + 1].energy_kwh[0]) - stops[i + 1].arrive_min_kwh)
        else:
            node = instance.drive.n_steps
            values.append(trajectory.final_energy_kwh - instance.end_energy_min_kwh)
        values.extend(spare[stop.node + 1 : node + 1].tolist())
        slack.append(min(values))
    return np.array(slack)


def _charge_more(controls: Controls, stop: int, energy_kwh: float) -> Controls:
    changed = list(controls.stops)
    changed[stop] = replace(changed[stop], energy_kwh=changed[stop].energy_kwh + energy_kwh)
    return replace(controls, stops=tuple(changed))


def _possible(controls: Controls) -> Controls:
    """Return controls whose stops charge something at some power.

    A solver that gives up leaves a point outside its bounds, with energies below zero and
    cells without power.
    """
    stops = tuple(
        replace(
            s,
            energy_kwh=max(s.energy_kwh, MIN_CHARGE_KWH),
            power_kw=np.maximum(s.power_kw, LEAST_POWER_KW),
        )
        for s in controls.stops
    )
    return replace(controls, stops=stops)


def release(instance: Instance, controls: Controls) -> Controls:
    """Replace charging powers that are at a limit by infinity: as fast as allowed.

    On the tables, and when driven, the limit is not quite the splines'; the plan means
    the limit, not the number. Stops of a solver that gave up are made such that they can be
    driven at all.

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> controls = idle_controls(instance, (40.0,))
    >>> bool(np.isinf(release(instance, controls).stops[0].power_kw).all())
    True
    """
    controls = _possible(controls)
    unlimited = tuple(replace(s, power_kw=np.full_like(s.power_kw, np.inf)) for s in controls.stops)
    free = simulate(instance, replace(controls, stops=unlimited)).stops
    return replace(
        controls,
        stops=tuple(
            replace(s, power_kw=np.where(s.power_kw >= FULL_POWER * f.power_kw, np.inf, s.power_kw))
            for s, f in zip(controls.stops, free, strict=True)
        ),
    )


def polish(instance: Instance, controls: Controls) -> tuple[Controls, Trajectory]:
    """Correct the energies of the stops until no limit is missed and nothing is left over.

    What is short before the next stop is charged at the stop before; what is left at the
    end is taken from the largest stop that can spare it. A kWh charged arrives as nearly a
    kWh, so the error itself is the step (the secant's slope is one up to losses).

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    controls : Controls
        Plan of the smooth program.

    Returns
    -------
    Controls, Trajectory
        The cheapest feasible plan met, else the last; and what it causes.

    Examples
    --------
    >>> from relax import idle_controls, load_trip, make_instance
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> _, trajectory = polish(instance, idle_controls(instance, (40.0,)))
    >>> abs(trajectory.final_energy_kwh - instance.end_energy_min_kwh) < 1e-5
    True
    """
    trajectory = simulate(instance, controls)
    best: tuple[Controls, Trajectory] | None = None
    for _ in range(MAX_ROUNDS):
        if is_feasible(trajectory) and (best is None or trajectory.cost < best[1].cost):
            best = controls, trajectory
        slack = _slack(instance, trajectory)
        short = np.flatnonzero(slack < -SLACK_TOLERANCE_KWH)
        if short.size:
            controls = _charge_more(controls, int(short[0]), -float(slack[short[0]]))
        else:
            spare = np.minimum.accumulate(slack[::-1])[::-1]  # until the end, not the next stop
            charged = np.array([s.energy_kwh for s in controls.stops])
            spare = np.minimum(spare, charged - MIN_CHARGE_KWH)
            able = np.flatnonzero(spare > SLACK_TOLERANCE_KWH)
            if not able.size:
                break
            stop = int(able[np.argmax(charged[able])])
            controls = _charge_more(controls, stop, -float(spare[stop]))
        trajectory = simulate(instance, controls)
    return best or (controls, trajectory)
