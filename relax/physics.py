"""Owns the two equations of the exact model that must be solved, as functions of arrays.

Labels (P3) and (P4) are those of ``docs/maths.md``; the others are sums and products, which
``exact`` has for the drive. All powers in kW, battery power positive when discharging. Knows
nothing of trips, grids or solvers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.errors import DomainError

__all__ = ["battery_power", "heat_pump_heat", "heat_pump_power"]

Array = npt.NDArray[np.float64]


def battery_power(load_kw: Array, r: Array, ripple_kw2: Array | float = 0.0) -> Array:
    """Return the internal power P that serves an electrical load: P - L(P) = load (P3) [kW].

    The smaller root of the quadratic; negative loads charge.

    Raises
    ------
    DomainError
        The load exceeds what the pack can deliver at all, 1 / (4 r).

    Examples
    --------
    >>> float(battery_power(np.array(19.9), np.array(0.00025)))
    20.0
    """
    demand = load_kw + r * ripple_kw2
    root = 1.0 - 4.0 * r * demand
    if np.any(root < 0.0):
        raise DomainError("the electrical load exceeds the largest power of the pack, 1/(4r)")
    # 2d / (1 + sqrt(1 - 4rd)) is the same root without cancellation, and right for r = 0
    return np.asarray(2.0 * demand / (1.0 + np.sqrt(root)))


def heat_pump_heat(power_kw: Array, cop: Array, droop_per_kw: float) -> Array:
    """Return the heat to the cabin h = cop(T) * (1 - droop * P) * P (P4) [kW].

    Examples
    --------
    >>> float(heat_pump_heat(np.array(1.0), np.array(2.0), 0.05))
    1.9
    """
    return np.asarray(cop * power_kw * (1.0 - droop_per_kw * power_kw))


def heat_pump_power(heat_kw: Array, cop: Array, droop_per_kw: float) -> Array:
    """Return the compressor power that gives a heat: the inverse of (P4) [kW].

    Infinite where no power gives that much heat.

    Examples
    --------
    >>> round(float(heat_pump_power(np.array(1.9), np.array(2.0), 0.05)), 12)
    1.0
    """
    ratio = np.asarray(heat_kw / cop)
    root = 1.0 - 4.0 * droop_per_kw * ratio
    with np.errstate(invalid="ignore"):
        return np.where(root >= 0.0, 2.0 * ratio / (1.0 + np.sqrt(np.maximum(root, 0.0))), np.inf)
