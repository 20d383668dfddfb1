"""Owns the exact model as pure functions of arrays: one equation, one function.

Labels (P1) .. (P8) are those of ``docs/maths.md``. All powers in kW, battery
power positive when discharging. Knows nothing of trips, grids or solvers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.errors import DomainError

__all__ = [
    "battery_heat",
    "battery_power",
    "cabin_heater_power",
    "electrical_load",
    "heat_pump_heat",
    "heat_pump_power",
    "joule_loss",
    "resistance_over_voltage_squared",
]

Array = npt.NDArray[np.float64]


def resistance_over_voltage_squared(resistance_ohm: Array, voltage_squared: Array) -> Array:
    """Return r = R(T) / U_oc(E)^2 (P1) [1/kW].

    Parameters
    ----------
    resistance_ohm : ndarray
        Pack resistance [ohm].
    voltage_squared : ndarray, same shape
        U_oc^2 / 1000 [kW*ohm].

    Examples
    --------
    >>> float(resistance_over_voltage_squared(np.array(0.04), np.array(160.0)))
    0.00025
    """
    return np.asarray(resistance_ohm / voltage_squared)


def joule_loss(power_kw: Array, r: Array, ripple_kw2: Array | float = 0.0) -> Array:
    """Return the Joule loss L = r * (P^2 + ripple) (P2) [kW].

    Parameters
    ----------
    power_kw : ndarray
        Internal battery power P, mean over the step [kW].
    r : ndarray
        Resistance over squared voltage [1/kW].
    ripple_kw2 : ndarray or float
        Variance of the power within the step [kW^2]: the mean of a square is
        the square of the mean plus the variance.

    Examples
    --------
    >>> float(joule_loss(np.array(20.0), np.array(0.00025)))
    0.1
    """
    return np.asarray(r * (np.square(power_kw) + ripple_kw2))


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


def cabin_heater_power(demand_kw: Array, pump_heat_kw: Array, efficiency: float) -> Array:
    """Return the heater power for the cabin (q - h) / eta_c (P5) [kW].

    Examples
    --------
    >>> float(cabin_heater_power(np.array(3.0), np.array(1.0), 1.0))
    2.0
    """
    return np.asarray((demand_kw - pump_heat_kw) / efficiency)


def electrical_load(
    base_kw: Array,
    cabin_heater_kw: Array,
    battery_heater_kw: Array,
    cooling_kw: Array,
    heat_pump_kw: Array,
) -> Array:
    """Return all consumers behind the battery terminals (P6) [kW].

    ``base_kw`` is propulsion (with friction braking added), auxiliaries and cabin cooling.

    Examples
    --------
    >>> float(electrical_load(*(np.array(x) for x in (15.0, 2.0, 1.0, 0.0, 0.5))))
    18.5
    """
    return np.asarray(base_kw + cabin_heater_kw + battery_heater_kw + cooling_kw + heat_pump_kw)


def battery_heat(
    loss_kw: Array,
    drivetrain_heat_kw: Array,
    heater_heat_kw: Array,
    cooling_heat_kw: Array,
    pump_source_kw: Array,
    conductance_kw_per_k: Array,
    ambient_c: Array,
    temperature_c: Array,
) -> Array:
    """Return the heat flow into the pack (P7) [kW].

    Joule loss + drivetrain heat + heater - cooling - heat drawn by the heat pump
    + conductance * (ambient - battery temperature).

    Examples
    --------
    >>> one = np.array(1.0)
    >>> float(battery_heat(one, one, one, one, one, 0.1 * one, 0.0 * one, 10.0 * one))
    0.0
    """
    return np.asarray(
        loss_kw
        + drivetrain_heat_kw
        + heater_heat_kw
        - cooling_heat_kw
        - pump_source_kw
        + conductance_kw_per_k * (ambient_c - temperature_c)
    )
