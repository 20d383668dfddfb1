"""Owns the box: an interval for every quantity of the trajectories of a subset or family.

A value: ``reach`` derives and shrinks boxes, the relaxation is built on one.
Knows nothing of dynamics, programs and solvers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from relax.intervals import EMPTY_MARGIN, Interval

__all__ = ["Box", "Cell"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """Intervals of the state at one place.

    Parameters
    ----------
    energy : tuple of float
        Least and largest internal energy [kWh].
    temperature : tuple of float
        Least and largest battery temperature [degrees C].
    """

    energy: tuple[float, float]
    temperature: tuple[float, float]


@dataclass(frozen=True)
class Box:
    """Intervals of the quantities of a subset or family; n steps, S stops, K cells.

    Parameters
    ----------
    energy : Interval, shape (n + 1,)
        Internal energy on arrival at every node [kWh].
    temperature : Interval, shape (n + 1,)
        Battery temperature on arrival at every node [degrees C].
    power : Interval, shape (n,)
        Internal battery power of every step, > 0 discharging [kW].
    charge : Interval, shape (S,)
        Internal energy W charged at every stop [kWh].
    arrive, leave : Interval, shape (S,)
        Internal energy after the detour in and after the detour out [kWh].
    stop_temperature : Interval, shape (S, K + 1)
        Battery temperature at the cell borders [degrees C].
    dwell : Interval, shape (S, K)
        Dwell of every cell [h].
    stay : Interval, shape (S,)
        Dwell of every stop [h].
    after, after_temperature : Interval, shape (S,)
        Energy and temperature with which the car drives on: those of a used stop's end,
        or, past an optional stop, those before it [kWh, degrees C].
    optional : ndarray of bool, shape (S,)
        Stops that may be left out; their other intervals hold if they are used.
    node : ndarray of int, shape (S,)
        Node of every stop, ascending.
    count : tuple of int
        Least and largest number of used stops.
    """

    energy: Interval
    temperature: Interval
    power: Interval
    charge: Interval
    arrive: Interval
    leave: Interval
    stop_temperature: Interval
    dwell: Interval
    stay: Interval
    after: Interval
    after_temperature: Interval
    optional: npt.NDArray[np.bool_]
    node: npt.NDArray[np.int64]
    count: tuple[int, int]

    @cached_property
    def step_stop(self) -> npt.NDArray[np.int64]:
        """The stop right before each step, -1 if there is none, shape (n,)."""
        out = np.full(self.power.lo.size, -1, dtype=np.int64)
        inner = self.node < out.size
        out[self.node[inner]] = np.flatnonzero(inner)  # of several at a node the last counts
        return out

    def _start(self, node: Array, stop: Array) -> Array:
        out = node[:-1].copy()
        after = self.step_stop >= 0
        out[after] = stop[self.step_stop[after]]
        return out

    @cached_property
    def start_energy(self) -> Interval:
        """Energy at the start of every step, after a stop there, shape (n,) [kWh]."""
        return Interval(
            self._start(self.energy.lo, self.after.lo), self._start(self.energy.hi, self.after.hi)
        )

    @cached_property
    def start_temperature(self) -> Interval:
        """Temperature at the start of every step, shape (n,) [degrees C]."""
        after = self.after_temperature
        return Interval(
            self._start(self.temperature.lo, after.lo), self._start(self.temperature.hi, after.hi)
        )

    @cached_property
    def middle_energy(self) -> Interval:
        """Midpoint energy of every step, shape (n,) [kWh]."""
        start = self.start_energy
        return Interval(
            0.5 * (start.lo + self.energy.lo[1:]), 0.5 * (start.hi + self.energy.hi[1:])
        )

    @cached_property
    def middle_temperature(self) -> Interval:
        """Midpoint temperature of every step, shape (n,) [degrees C]."""
        start = self.start_temperature
        return Interval(
            0.5 * (start.lo + self.temperature.lo[1:]), 0.5 * (start.hi + self.temperature.hi[1:])
        )

    @cached_property
    def cell_temperature(self) -> Interval:
        """Midpoint temperature of every cell, shape (S, K) [degrees C]."""
        lo, hi = self.stop_temperature.lo, self.stop_temperature.hi
        return Interval(0.5 * (lo[:, 1:] + lo[:, :-1]), 0.5 * (hi[:, 1:] + hi[:, :-1]))

    def full(self, detour_out_kwh: Array) -> Interval:
        """Energy after charging, shape (S,) [kWh].

        Parameters
        ----------
        detour_out_kwh : ndarray, shape (S,)
            Energy lost between that and ``leave``.
        """
        lo, hi = self.arrive.lo + self.charge.lo, self.arrive.hi + self.charge.hi
        return self._charged(detour_out_kwh).meet(lo, hi).outward()

    def _charged(self, detour_out_kwh: Array) -> Interval:
        """Energy after charging by what is left after the detour."""
        return Interval(self.leave.lo + detour_out_kwh, self.leave.hi + detour_out_kwh)

    def cell_energy(self, detour_out_kwh: Array) -> Interval:
        """Midpoint energy E_a + (j + 1/2) W / K of every cell, shape (S, K) [kWh].

        Parameters
        ----------
        detour_out_kwh : ndarray, shape (S,)
            Energy lost after charging: ties the last cell to ``leave``.
        """
        cells = self.dwell.lo.shape[1]
        c = (np.arange(cells) + 0.5) / cells
        full = self._charged(detour_out_kwh)
        lo = self.arrive.lo[:, None] + c * self.charge.lo[:, None]
        hi = self.arrive.hi[:, None] + c * self.charge.hi[:, None]
        return (
            Interval(lo, hi)
            .meet(
                full.lo[:, None] - (1.0 - c) * self.charge.hi[:, None],
                full.hi[:, None] - (1.0 - c) * self.charge.lo[:, None],
            )
            .outward()
        )

    @cached_property
    def empty(self) -> str | None:
        """Name of a quantity whose interval is empty: proof that nothing is feasible; or None."""
        for name in ("energy", "temperature", "power", "after", "after_temperature"):
            interval: Interval = getattr(self, name)
            if np.any(interval.lo > interval.hi + EMPTY_MARGIN):
                return name
        for name, unusable in self._unusable.items():
            if np.any(unusable & ~self.optional):
                return name
        return None

    @cached_property
    def _unusable(self) -> dict[str, npt.NDArray[np.bool_]]:
        """Stops with an empty interval, by its name; shape (S,) each."""
        out: dict[str, npt.NDArray[np.bool_]] = {}
        for name in ("charge", "arrive", "leave", "stop_temperature", "dwell", "stay"):
            interval: Interval = getattr(self, name)
            empty = interval.lo > interval.hi + EMPTY_MARGIN
            out[name] = np.asarray(empty.any(axis=1) if empty.ndim == 2 else empty)
        return out

    @cached_property
    def unusable(self) -> npt.NDArray[np.bool_]:
        """Optional stops that no feasible plan uses, shape (S,): an interval of theirs is empty."""
        return np.asarray(np.any([self.optional & x for x in self._unusable.values()], axis=0))

    def with_start(self, cell: Cell) -> Box:
        """Return the box met with a cell before its first step."""
        first = np.arange(self.energy.lo.size) == 0
        return replace(
            self,
            energy=_met(self.energy, first, cell.energy),
            temperature=_met(self.temperature, first, cell.temperature),
        )

    def with_end(self, cell: Cell) -> Box:
        """Return the box met with a cell after its last stop, or after its last step."""
        if self.optional.size == 0:
            last = np.arange(self.energy.lo.size) == self.energy.lo.size - 1
            return replace(
                self,
                energy=_met(self.energy, last, cell.energy),
                temperature=_met(self.temperature, last, cell.temperature),
            )
        stop = np.arange(self.optional.size) == self.optional.size - 1
        border = np.zeros(self.stop_temperature.lo.shape, dtype=np.bool_)
        border[-1, -1] = True
        return replace(
            self,
            leave=_met(self.leave, stop, cell.energy),
            stop_temperature=_met(self.stop_temperature, border, cell.temperature),
        )


def _met(x: Interval, at: npt.NDArray[np.bool_], limits: tuple[float, float]) -> Interval:
    """Return the intervals, those of a mask met with limits."""
    return Interval(
        np.where(at, np.maximum(x.lo, limits[0]), x.lo),
        np.where(at, np.minimum(x.hi, limits[1]), x.hi),
    )
