"""Owns the values of a front: its points, the curves per choice of stops, and what is proved of it.

A front is the least value (energy or cost) over the time allowed for charging and
detours. What is proved are cuts, one or more per choice of stops; every bound of
the front follows from them by arithmetic. Knows nothing of how either was found.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from math import inf, isfinite
from typing import Any

from enumerate.subset import Subset
from relax.report import PlanReport

__all__ = ["CurvePoint", "Cut", "Front", "FrontPoint", "earliest_h", "front_gap", "least_value"]

GAP_TOLERANCE = 1e-7
"""How exactly a gap is found."""
LATE_H = 5e-4
"""How much later than asked a plan may be for ``Front.at``: 1.8 s, the drive's deviation [h]."""


@dataclass(frozen=True)
class Cut:
    """A theorem about one choice of stops: value_weight * v + time_weight * t >= bound.

    It holds for every plan of the choice with t <= ``budget_h``, where v is its value
    and t its charging and detour time.

    Parameters
    ----------
    subset : tuple of int
        Chargers of the choice.
    value_weight, time_weight : float
        Weights, >= 0, of value and time [1, value per h].
    budget_h : float
        Time within which it holds [h].
    bound : float
        Right-hand side; ``inf``: there is no plan within the budget.

    Examples
    --------
    >>> cut = Cut((1,), 1.0, 20.0, 0.6, 40.0)
    >>> cut.value_at(0.5), cut.value_at(0.7), cut.time_at(36.0)
    (30.0, -inf, 0.2)
    """

    subset: Subset
    value_weight: float
    time_weight: float
    budget_h: float
    bound: float

    def value_at(self, time_h: float) -> float:
        """Return what no plan of the choice within this time undercuts."""
        if time_h > self.budget_h:
            return -inf
        left = self.bound - self.time_weight * time_h
        if self.value_weight == 0.0:
            return inf if left > 0.0 else -inf
        return left / self.value_weight

    def time_at(self, value: float) -> float:
        """Return a time [h] before which no plan of the choice has this value or less."""
        left = self.bound - self.value_weight * value
        if left <= 0.0:
            return 0.0
        return (
            self.budget_h
            if self.time_weight == 0.0
            else min(self.budget_h, left / self.time_weight)
        )


def _by_subset(cuts: Iterable[Cut]) -> dict[Subset, list[Cut]]:
    groups: dict[Subset, list[Cut]] = {}
    for cut in cuts:
        groups.setdefault(cut.subset, []).append(cut)
    return groups


def least_value(cuts: Iterable[Cut], time_h: float) -> float:
    """Return what no plan within a time undercuts: least over choices, best cut of each.

    Examples
    --------
    >>> cuts = [Cut((0,), 1.0, 0.0, inf, 3.0), Cut((1,), 1.0, 0.0, inf, 2.0)]
    >>> least_value([*cuts, Cut((1,), 0.0, 1.0, inf, 0.5)], 0.4)
    3.0
    """
    groups = _by_subset(cuts).values()
    return min((max(c.value_at(time_h) for c in group) for group in groups), default=-inf)


def earliest_h(cuts: Iterable[Cut], value: float) -> float:
    """Return a time [h] before which no plan has a value or less.

    Examples
    --------
    >>> earliest_h([Cut((0,), 1.0, 10.0, inf, 8.0)], 3.0)
    0.5
    """
    groups = _by_subset(cuts).values()
    return min((max(c.time_at(value) for c in group) for group in groups), default=0.0)


def front_gap(cuts: Iterable[Cut], time_h: float, value: float) -> float:
    """Return the least share by which no plan is better in both value and time.

    Examples
    --------
    >>> round(front_gap([Cut((0,), 1.0, 10.0, inf, 7.92)], 0.5, 3.0), 6)
    0.01
    """
    cuts = list(cuts)
    size = max(abs(value), 1.0)

    def holds(share: float) -> bool:
        return least_value(cuts, (1.0 - share) * time_h) >= value - share * size

    lo, hi = 0.0, 1.0
    if holds(lo):
        return lo
    if not holds(hi):
        return inf
    while hi - lo > GAP_TOLERANCE:
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if holds(middle) else (middle, hi)
    return hi


@dataclass(frozen=True)
class CurvePoint:
    """A plan of one choice of stops on the transcription.

    Parameters
    ----------
    time_h : float
        Charging and detours [h].
    value : float
        Energy [kWh] or cost [currency].
    """

    time_h: float
    value: float


@dataclass(frozen=True)
class FrontPoint:
    """A plan on the front, as driven on the continuous model.

    Parameters
    ----------
    budget_h : float
        Time the plan was asked to keep [h]; ``inf`` at the end of least value.
    time_h, charging_h, detour_h : float
        Time it takes for charging and detours, and the two parts [h].
    value : float
        Energy [kWh] or cost without the value of time [currency].
    energy_kwh : float
        Energy from the chargers [kWh].
    stops : tuple of str
        Chargers used.
    subset : tuple of int
        Their indices.
    lower_bound : float
        No plan within the budget (and ``time_h``) has a smaller value.
    gap : float
        Relative distance of ``value`` to it.
    least_time_h : float
        No plan of this value or less takes less time [h].
    time_gap : float
        Relative distance of ``time_h`` to it.
    front_gap : float
        No plan is better by more than this share in value *and* in time; at most the
        lesser of the other two. Where the front is upright or flat, it says how near
        the front is.
    proved : bool
        ``front_gap`` is within the gap asked for.
    plan : PlanReport
        The plan.
    """

    budget_h: float
    time_h: float
    charging_h: float
    detour_h: float
    value: float
    energy_kwh: float
    stops: tuple[str, ...]
    subset: Subset
    lower_bound: float
    gap: float
    least_time_h: float
    time_gap: float
    front_gap: float
    proved: bool
    plan: PlanReport


@dataclass(frozen=True)
class Front:
    """The trade between energy (or cost) and time of one trip.

    Parameters
    ----------
    trip, measure, unit : str
        What it is a front of; the unit of its values.
    points : tuple of FrontPoint
        Time ascending, value descending; none is dominated by another.
    curves : mapping of tuple of int to tuple of CurvePoint
        What was found per choice of stops, by time: shows where one takes over from
        another.
    chargers : tuple of str
        Names, by index.
    cuts : tuple of Cut
        What is proved; at least one of every choice of stops.
    asked_gap : float or None
        Gap asked for.
    interrupted : str
        Why the work ended early; empty if it did not.
    timings_s : mapping of str to float
        Seconds per phase.
    """

    trip: str
    measure: str
    unit: str
    points: tuple[FrontPoint, ...]
    curves: Mapping[Subset, tuple[CurvePoint, ...]]
    chargers: tuple[str, ...]
    cuts: tuple[Cut, ...]
    asked_gap: float | None
    interrupted: str
    timings_s: Mapping[str, float]

    @property
    def gap(self) -> float:
        """Largest ``front_gap`` of the points; ``inf`` without points."""
        return max((p.front_gap for p in self.points), default=inf)

    def at(self, time_h: float) -> FrontPoint:
        """Return the point of least value within a time.

        Raises
        ------
        ValueError
            There is none: see ``points[0]`` for the least time.
        """
        within = [p for p in self.points if p.time_h <= time_h + LATE_H]
        if not within:
            raise ValueError(f"no point of the front within {60.0 * time_h:.2f} min")
        return within[-1]

    def lower_bound(self, time_h: float) -> float:
        """Return what no plan with this charging and detour time or less undercuts."""
        return least_value(self.cuts, time_h)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; infinities become None. Plans are given by their stops."""
        points = []
        for point in self.points:
            entry = {k: v for k, v in vars(point).items() if k != "plan"}
            entry["plan"] = {
                "stops": [asdict(s) for s in point.plan.stops],
                "final_soc": point.plan.final_soc,
                "final_temperature_c": point.plan.final_temperature_c,
                "totals_kwh": point.plan.totals_kwh,
            }
            points.append(entry)
        names = self.chargers
        value = {
            "trip": self.trip,
            "measure": self.measure,
            "unit": self.unit,
            "gap": self.gap,
            "asked_gap": self.asked_gap,
            "points": points,
            "curves": [
                {"stops": [names[i] for i in subset], "points": [asdict(p) for p in curve]}
                for subset, curve in self.curves.items()
            ],
            "cuts": [asdict(c) for c in self.cuts],
            "interrupted": self.interrupted,
            "timings_s": dict(self.timings_s),
        }
        plain = _plain(value)
        assert isinstance(plain, dict)
        return plain


def _plain(value: Any) -> Any:
    """Return a value of JSON types; infinities and NaN become None."""
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    return value
