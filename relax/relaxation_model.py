"""Owns what the parts of the relaxation share: the rows so far and the columns of the states.

Knows nothing of which rows there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.envelopes import (
    envelope_pump_heat_over,
    envelope_pump_heat_under,
    envelope_pump_power_under,
)
from relax.instance import Instance
from relax.intervals import Interval, range1
from relax.program import Assembly, Term
from relax.reach_heat import pump_limits

__all__ = ["Array", "Index", "Model", "Pump", "make_pumps", "middle", "stack"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


@dataclass
class Model:
    """What the parts share: the rows so far, the columns of the chain of states, whether lean."""

    rows: Assembly
    instance: Instance
    box: Box
    v: dict[str, Index]
    cost: dict[str, npt.ArrayLike]
    pumps: tuple[Pump, Pump]
    lean: bool


def stack(instance: Instance, name: str) -> Array:
    """Return one attribute of all stops, shape (S,)."""
    return np.array([getattr(stop, name) for stop in instance.stops], dtype=np.float64)


def middle(start: Index, end: Index, coefficient: npt.ArrayLike) -> list[Term]:
    """Return the terms of coefficient * midpoint of two states."""
    half = 0.5 * np.asarray(coefficient, dtype=np.float64)
    return [(start, half), (end, half)]


@dataclass(frozen=True)
class Pump:
    """The heat pump in the driving steps, or in the cells: limits and planes.

    Parameters
    ----------
    power, heat : ndarray, shape (n,) or (S, K)
        Largest compressor power and largest heat [kW].
    planes : list of (name, ndarray, float)
        Planes where it may run, m at a time, with their sign (+1: from above).
    """

    power: Array
    heat: Array
    planes: list[tuple[str, Array, float]]


def make_pumps(instance: Instance, box: Box) -> tuple[Pump, Pump]:
    """Return the heat pump in the driving steps and in the cells; one pass over both."""
    n, shape = instance.drive.n_steps, box.dwell.lo.shape
    temp = [box.middle_temperature, box.cell_temperature]
    lo, hi = (np.concatenate([getattr(x, end).ravel() for x in temp]) for end in ("lo", "hi"))
    at_stops = np.repeat(stack(instance, "cabin_heat_kw"), shape[1])
    demand = np.concatenate([instance.drive.cabin_heat_kw, at_stops])
    power, heat, _ = pump_limits(
        instance, demand, range1(instance.vehicle.heat_pump_cop, Interval(lo, hi))
    )
    on = power > 0.0
    planes = []
    if on.any():
        planes = _planes(
            instance, Interval(np.zeros(int(on.sum())), power[on]), demand[on],
            Interval(lo[on], hi[on]),
        )  # fmt: skip
    first = int(on[:n].sum())
    return (
        Pump(power[:n], heat[:n], [(name, x[..., :first], sign) for name, x, sign in planes]),
        Pump(
            power[n:].reshape(shape), heat[n:].reshape(shape),
            [(name, x[..., first:], sign) for name, x, sign in planes],
        ),
    )  # fmt: skip


def _planes(
    instance: Instance, power: Interval, demand: Array, temp: Interval
) -> list[tuple[str, Array, float]]:
    cop, droop = instance.vehicle.heat_pump_cop, instance.vehicle.heat_pump_droop_per_kw
    above = envelope_pump_heat_over(cop, droop, power, temp)
    below = [("heat below", envelope_pump_heat_under(cop, droop, power, temp), -1.0)]
    invertible = droop * instance.vehicle.heat_pump_kw < 0.499
    if invertible and np.all(range1(cop, temp).lo > 0.0):
        planes = envelope_pump_power_under(cop, droop, power, demand, temp)
        below.append(("power below", planes, -1.0))
        above = above[1:]  # without its slope in T the first adds nothing to these
    return [("heat above", above, 1.0), *below]
