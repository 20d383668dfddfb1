"""Owns the figures of the paper's tables as a function of the car: fast, local, without proofs.

Least energy and least time per choice of stops, refined from the plans of a
similar car, so that a fit can ask for hundreds of cars. On the transcription.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

from benchmarks.data.paper import Fit
from benchmarks.paper.published import AMBIENT_C, ENERGY_AT_MIN, HEAT_PUMP_KW
from benchmarks.paper.trips import FAST_PER_H, paper_trip
from relax.bound import relax_subset
from relax.instance import Drive, Instance, make_drive, make_instance
from relax.plan import Controls
from relax.refinement import Refined, RefineSettings, best_of, refine
from relax.starts import best_start, split_starts
from relax.trip import Trip

__all__ = ["ABOVE_MIN", "SETS", "Car", "Key", "Plans", "Value", "values"]

SETTINGS = RefineSettings(tolerance=2e-6)
"""Tighter than a plan needs: small differences are taken."""
ABOVE_MIN = 0.1
"""Energy "at 22 min" is taken so far above the least time where that lies beyond it [min]."""
SETS: dict[float, tuple[tuple[int, ...], ...]] = {
    -10.0: ((1,), (1, 2)),
    0.0: ((1,), (2,), (1, 2)),
    10.0: ((2,),),
}
"""Choices of stops that come near the best, by ambient temperature (checked with ``plan``)."""

Key = tuple[str, float, float]
"""("time" | "energy" | "free", ambient temperature, heat pump); "free": energy without a limit
of time."""
Plans = dict[tuple[Key, tuple[int, ...]], Controls | None]
"""Controls to start from; None: this choice of stops has no plan."""


@dataclass(frozen=True)
class Value:
    """One figure.

    Parameters
    ----------
    by_set : dict
        Charged energy [kWh] or charging and detour time [min] by choice of stops.
    """

    by_set: dict[tuple[int, ...], float]

    @property
    def best(self) -> float:
        """The least; ``inf`` without a plan."""
        return min(self.by_set.values(), default=inf)

    @property
    def stops(self) -> tuple[int, ...]:
        """The choice of stops that has it."""
        return min(self.by_set, key=lambda s: self.by_set[s])


@dataclass
class Car:
    """A fit and what is made of it once."""

    fit: Fit | None
    made: dict[float, tuple[Trip, Drive]] = field(default_factory=dict)

    def instance(
        self, ambient_c: float, heat_pump_kw: float, time_value: float, stops: tuple[int, ...]
    ) -> Instance:
        """Return the transcription of one choice of stops."""
        if ambient_c not in self.made:
            trip = paper_trip(ambient_c, 1.0, fit=self.fit)
            self.made[ambient_c] = trip, make_drive(trip, trip.grid.step_km)
        trip, drive = self.made[ambient_c]
        car = replace(trip.vehicle, heat_pump_kw=heat_pump_kw)
        trip = replace(trip, vehicle=car, time_value_per_h=time_value)
        return make_instance(trip, stops, None, drive)


def _from_scratch(instance: Instance) -> Refined | None:
    relaxed = relax_subset(instance)
    if relaxed.infeasible:
        return None
    bound = -inf if relaxed.lower_bound is None else relaxed.lower_bound
    best = refine(instance, best_start(instance, relaxed.point, bound), SETTINGS)
    if len(instance.stops) > 1:
        starts = split_starts(instance, best.controls)
        best = best_of([best, *(refine(instance, s, SETTINGS) for s in starts)], instance)
    return best if best.feasible else None


def _solve(instance: Instance, start: Controls | None) -> Refined | None:
    if start is not None:
        found = refine(instance, start, SETTINGS)
        if found.feasible:
            return found
    return _from_scratch(instance)


def _minutes(instance: Instance, found: Refined) -> float:
    dwell = sum(float(s.dwell_h.sum()) for s in found.trajectory.stops)
    return 60.0 * (dwell + sum(s.detour_h for s in instance.stops))


def _energy_kwh(found: Refined) -> float:
    return sum(float(s.grid_kwh.sum()) for s in found.trajectory.stops)


def values(car: Car, plans: Plans, free: bool = True) -> tuple[dict[Key, Value], Plans]:
    """Return all figures of a car.

    Parameters
    ----------
    car : Car
        The car.
    plans : Plans
        Of a similar car; empty: from scratch.
    free : bool
        Also the least energy without a limit of time at -10 C, for cases A, B and C.

    Returns
    -------
    values : dict of Key to Value
        Nine times, nine energies at the paper's times, three free energies.
    plans : Plans
        For the next car.
    """
    found: dict[Key, Value] = {}
    kept: Plans = {}

    def solve(key: Key, time_value: float, limit_min: float, stops: tuple[int, ...]) -> float:
        instance = car.instance(key[1], key[2], time_value, stops)
        detours = sum(s.detour_h for s in instance.stops)
        instance = replace(instance, total_dwell_h=limit_min / 60.0 - detours)
        start = plans.get((key, stops))
        if start is None and (key, stops) in plans:
            kept[key, stops] = None
            return inf
        if start is None and key[0] == "energy":
            start = kept.get((("free", *key[1:]), stops))
        done = _solve(instance, start)
        kept[key, stops] = None if done is None else done.controls
        if done is None:
            return inf
        return _minutes(instance, done) if key[0] == "time" else _energy_kwh(done)

    for ambient in AMBIENT_C:
        for pump in HEAT_PUMP_KW:
            sets = SETS[ambient]
            time: Key = ("time", ambient, pump)
            by_set = {s: solve(time, FAST_PER_H, inf, s) for s in sets}
            found[time] = Value({s: v for s, v in by_set.items() if v < inf})
            least = found[time].best
            limit = max(ENERGY_AT_MIN[ambient], least + ABOVE_MIN)
            for key, minutes in (
                (("free", ambient, pump), inf),
                (("energy", ambient, pump), limit),
            ):
                if key[0] == "free" and not (free and ambient == -10.0):
                    continue
                usable = [s for s, v in by_set.items() if v <= minutes]
                found[key] = Value({s: solve(key, 0.0, minutes, s) for s in usable})
    return found, kept
