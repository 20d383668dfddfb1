"""Owns plans cut into stages: feasible trajectories of many kinds, and their path through a graph.

``make_plans`` refines every subset that has a plan and disturbs what it finds: other settings
of heater and heat pump, other splits of energy. ``cut`` writes a trajectory as a chain of
stages, each with the state at both ends; ``legs_of`` finds them among a graph's arcs, and
``check`` asserts that whatever the graph claims of them is true.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from hard_trips import hard_trip

from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import Arc, Vertex
from relax.bound import relax_subset
from relax.box import Box
from relax.instance import MIN_CHARGE_KWH, Instance, make_instance
from relax.intervals import Interval
from relax.plan import Controls, StopTrajectory, Trajectory
from relax.refinement import refine
from relax.simulate import simulate, stop_cost
from relax.stage import START, make_stage
from relax.starts import best_start, split_starts
from relax.trip import Trip

__all__ = [
    "KINDS",
    "Piece",
    "Planned",
    "check",
    "cut",
    "disturb",
    "family_of",
    "legs_of",
    "make_plans",
    "outside",
    "plans_of",
    "replay",
    "trip_of",
]

KINDS = ("winter", "same node", "ends", "two at the end", "one step", "free", "limits", "summer")
"""Short trips, hard in the named way."""

SPARE = 1e-7
"""Share of the cost by which claims may miss a plan whose simulation is exact to 1e-9."""
ROUNDING = 1e-6
"""What the simulation's own tolerances may put a quantity outside of its interval [kWh, K, kW]."""


@dataclass(frozen=True)
class Planned:
    """A feasible trajectory and its subset."""

    subset: tuple[int, ...]
    trajectory: Trajectory

    @property
    def cost(self) -> float:
        """Its cost."""
        return self.trajectory.cost


@dataclass(frozen=True)
class Piece:
    """A stage of a trajectory, its first and last stop numbered as in the family."""

    first: int
    last: int
    instance: Instance
    trajectory: Trajectory
    start: tuple[float, float]
    end: tuple[float, float]
    cost: float


@cache
def trip_of(kind: str) -> Trip:
    """Return the trip of a kind: 120 km, up to four chargers, coarse steps and cells."""
    trip = hard_trip(kind, 500.0 if kind == "one step" else 12.0)
    chargers = trip.chargers
    if kind in ("ends", "two at the end", "one step"):
        return replace(trip, end_soc_min=0.4)
    if kind == "free":
        free = tuple(replace(c, price_per_kwh=0.0, occupancy_price_per_h=0.0) for c in chargers)
        return replace(trip, chargers=free, time_value_per_h=0.0)
    if kind == "limits":
        short = tuple(replace(c, max_dwell_h=0.4, detour_in_kwh=0.6) for c in chargers)
        return replace(trip, chargers=short, soc_max=0.6, start_soc=0.4, end_soc_min=0.25)
    return trip


@cache
def plans_of(kind: str) -> tuple[Planned, ...]:
    """Return feasible trajectories of all subsets of the trip of a kind."""
    return tuple(make_plans(trip_of(kind), KINDS.index(kind), each=5))


def family_of(trip: Trip) -> Instance:
    """Return the family of all subsets."""
    return make_instance(trip, (), undecided=tuple(range(len(trip.chargers))))


def make_plans(
    trip: Trip, seed: int, each: int = 3, sizes: tuple[int, ...] = (0, 1, 2, 3, 4)
) -> list[Planned]:
    """Return a refined plan of every subset that has one, and up to ``each`` disturbed ones."""
    rng = np.random.default_rng(seed)
    out = []
    for size in sizes:
        for subset in combinations(range(len(trip.chargers)), size):
            instance = make_instance(trip, subset)
            relaxed = relax_subset(instance)
            if relaxed.infeasible:
                continue
            bound = -1e9 if relaxed.lower_bound is None else relaxed.lower_bound
            found = refine(instance, best_start(instance, relaxed.point, bound))
            more = [refine(instance, s) for s in split_starts(instance, found.controls)]
            made = [found.controls, *(r.controls for r in more)]
            least = min([found, *more], key=lambda r: (not r.feasible, r.trajectory.cost)).controls
            for _ in range(each):
                made.append(disturb(rng, instance, least))
            for controls in made:
                trajectory = settled(instance, controls)
                if trajectory is not None:
                    out.append(Planned(subset, trajectory))
    return out


def settled(instance: Instance, controls: Controls) -> Trajectory | None:
    """Return the trajectory without any violation: refined plans lack a hair, charged here."""
    for more in (0.0, 1e-6, 1e-5, 1e-4):
        stops = tuple(replace(s, energy_kwh=s.energy_kwh + more) for s in controls.stops)
        trajectory = simulate(instance, replace(controls, stops=stops))
        if float(trajectory.violation.max()) <= 1e-9:
            return trajectory
    return None


def disturb(rng: np.random.Generator, instance: Instance, controls: Controls) -> Controls:
    """Return other settings of the actuators and another split of the energy."""
    car = instance.vehicle

    def other(values: Any, most: float) -> Any:
        kind = rng.integers(4)
        if kind == 0:
            return values
        if kind == 1:
            return np.zeros_like(values)
        if kind == 2:
            return np.where(rng.random(values.size) < 0.5, most * rng.random(), values)
        return np.full_like(values, most)

    more = np.exp(rng.normal(0.05, 0.15, len(controls.stops)))
    stops = tuple(
        replace(
            stop,
            energy_kwh=max(float(stop.energy_kwh * f), MIN_CHARGE_KWH),
            power_kw=np.where(rng.random(instance.cells) < 0.1, 40.0, stop.power_kw),
            heater_kw=other(stop.heater_kw, car.heater_kw),
            heat_pump_kw=other(stop.heat_pump_kw, car.heat_pump_kw),
        )
        for stop, f in zip(controls.stops, more, strict=True)
    )
    return Controls(
        other(controls.heater_kw, car.heater_kw),
        other(controls.cooling_kw, car.cooling_kw),
        other(controls.heat_pump_kw, car.heat_pump_kw),
        stops,
    )


def cut(family: Instance, planned: Planned) -> list[Piece]:
    """Return the stages of a trajectory."""
    used = [i for i, stop in enumerate(family.stops) if stop.charger in planned.subset]
    whole = planned.trajectory
    places = [START, *used, len(family.stops)]
    state = float(whole.energy_kwh[0]), float(whole.temperature_c[0])
    out = []
    for j, (first, last) in enumerate(pairwise(places)):
        a = 0 if first == START else family.stops[first].node
        b = family.drive.n_steps if last == len(family.stops) else family.stops[last].node
        energy, temperature = (
            whole.energy_kwh[a : b + 1].copy(),
            whole.temperature_c[a : b + 1].copy(),
        )
        energy[0], temperature[0] = state
        steps = {
            name: getattr(whole, name)[a:b]
            for name in (
                "energy_start_kwh", "temperature_start_c", "power_kw", "loss_kw", "brake_kw",
                "heater_kw", "cooling_kw", "heat_pump_kw", "pump_heat_kw", "cabin_heater_kw",
            )
        }  # fmt: skip
        stops: tuple[StopTrajectory, ...] = ()
        cost = 0.0
        end = float(energy[-1]), float(temperature[-1])
        if last < len(family.stops):
            stop, ran = family.stops[last], whole.stops[j]
            stops = (ran,)
            end = float(ran.energy_kwh[-1]) - stop.detour_out_kwh, float(ran.temperature_c[-1])
            cost = stop_cost(stop, float(ran.dwell_h.sum()), float(ran.grid_kwh.sum()))
        part = replace(
            whole, energy_kwh=energy, temperature_c=temperature, stops=stops, cost=cost,
            final_energy_kwh=end[0], final_temperature_c=end[1], **steps,
        )  # fmt: skip
        stage = make_stage(family, first, last)
        out.append(Piece(first, last, stage, part, state, end, cost))
        state = end
    return out


def quantities(piece: Piece) -> Iterator[tuple[str, Any]]:
    """Yield the name of every interval of a box, and what it should hold."""
    t, stage = piece.trajectory, piece.instance
    yield "energy", t.energy_kwh
    yield "temperature", t.temperature_c
    yield "power", t.power_kw
    for ran, stop in zip(t.stops, stage.stops, strict=True):
        leave = ran.energy_kwh[-1] - stop.detour_out_kwh
        yield "charge", np.array([ran.energy_kwh[-1] - ran.energy_kwh[0]])
        yield "arrive", np.array([ran.energy_kwh[0]])
        yield "leave", np.array([leave])
        yield "after", np.array([leave])
        yield "after_temperature", ran.temperature_c[-1:]
        yield "stop_temperature", ran.temperature_c[None]
        yield "dwell", ran.dwell_h[None]
        yield "stay", np.array([ran.dwell_h.sum()])


def outside(box: Box, piece: Piece) -> list[str]:
    """Return the quantities of a stage that do not lie in a box."""
    out = []
    for name, value in quantities(piece):
        interval: Interval = getattr(box, name)
        if np.any(value < interval.lo - ROUNDING) or np.any(value > interval.hi + ROUNDING):
            out.append(name)
    return out


def legs_of(graph: StageGraph, pieces: list[Piece]) -> list[tuple[Vertex, Arc]] | None:
    """Return vertices and arcs that a trajectory may take: those with the highest planes.

    Its states choose among cells and boxes that meet at a border; every choice must hold, and
    this one is the strictest. None: no chain of alive arcs holds it.
    """
    choices: dict[Vertex, list[tuple[Vertex, Arc]]] = {graph.start: []}
    for piece in pieces:
        following: dict[Vertex, list[tuple[Vertex, Arc]]] = {}
        for vertex, chain in choices.items():
            for arc in vertex.out:
                if arc.target.stop != piece.last or not _near(arc.target, piece.end):
                    continue
                box = arc.box if arc.box is not None else arc.parent_box
                if box is not None and outside(box, piece):
                    continue
                best = following.get(arc.target)
                if best is None or best[-1][1].value(piece.start) < arc.value(piece.start):
                    following[arc.target] = [*chain, (vertex, arc)]
        choices = following
    return choices.get(graph.end)


def _near(vertex: Vertex, state: tuple[float, float]) -> bool:
    (e0, e1), (t0, t1) = vertex.cell.energy, vertex.cell.temperature
    e, t = state
    return e0 - ROUNDING <= e <= e1 + ROUNDING and t0 - ROUNDING <= t <= t1 + ROUNDING


def check(graph: StageGraph, family: Instance, plans: Iterable[Planned]) -> int:
    """Assert that what a graph claims is true of plans; return how many cost less than closing."""
    below = 0
    for planned in plans:
        spare = SPARE * (1.0 + abs(planned.cost))
        assert graph.lower_bound <= planned.cost + spare, planned.subset
        if planned.cost >= graph.closing - spare:
            continue
        below += 1
        assert graph.bound <= planned.cost + spare, planned.subset
        pieces = cut(family, planned)
        legs = legs_of(graph, pieces)
        assert legs is not None, f"{planned.subset} is left out"
        remaining = planned.cost
        for (vertex, arc), piece in zip(legs, pieces, strict=True):
            assert vertex.value(piece.start) <= remaining + spare, planned.subset
            assert arc.value(piece.start) <= remaining + spare, planned.subset
            remaining -= piece.cost
    return below


def replay(graph: StageGraph) -> StageGraph:
    """Return a new graph on which all steps of a graph have been done again."""
    again = StageGraph(graph.instance, graph.given)
    for step in graph.steps:
        again.apply(step)
    return again
