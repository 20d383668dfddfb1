"""Owns what is done against proofs over stages, which bound all plans of a trip at once.

A proof is begun below and above the best plan known, with too few steps to end as a rule,
and its dual vectors are spoilt. No bound may pass the cheapest plan; every plan
that costs less than the closing cost must be left a path, and at every stage of it the
bounds may not exceed what it still costs from there. Knows nothing of subsets' own proofs.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from math import inf
from time import perf_counter

import numpy as np

from benchmarks.contradiction import BOX_TOLERANCE, ROUNDING, Audit, Effort, outside
from benchmarks.rivals import Known, attacked
from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import Arc, StageStep, State, Vertex
from enumerate.stage_search import StageSearch
from relax.box import Cell
from relax.instance import Drive, make_instance
from relax.plan import Trajectory
from relax.simulate import stop_cost
from relax.stage import START
from relax.trip import Trip

__all__ = ["audit_stages"]

Random = np.random.Generator

BELOW = 0.99
"""Cost that is asked for where the proof may end, as a share of the best plan's."""
SPOILT_STEPS = 2
"""Steps of a proof that are spoilt in every way."""
HIGH = 0.2
"""Distance from the best plan's cost to that with which some proofs begin, as a share of it."""


def audit_stages(
    audit: Audit, trip: Trip, drive: Drive, nodes: Iterable[Known], rng: Random, effort: Effort
) -> None:
    """Begin proofs over stages and hold what they claim against all plans known.

    Stages leave out the limit of all stops' time together, so their bounds hold with it too.

    Parameters
    ----------
    audit : Audit
        Where counts and contradictions go.
    trip : Trip
        The trip.
    drive : Drive
        Its drive on the trip's grid.
    nodes : iterable of Known
        What is known of its subsets.
    rng : Generator
        For closing costs and spoilt vectors.
    effort : Effort
        How much is tried.

    Examples
    --------
    >>> from benchmarks.random_trips import random_trip
    >>> from benchmarks.rivals import drive_at_random
    >>> from relax.instance import make_drive
    >>> trip, rng, audit = random_trip(34), np.random.default_rng(0), Audit()
    >>> drive = make_drive(trip, trip.grid.step_km)
    >>> known = Known(make_instance(trip, (0,), trip.grid, drive))
    >>> drive_at_random(known, rng, Effort(drives=20))
    >>> audit_stages(audit, trip, drive, [known], rng, Effort())
    >>> audit.counts["stage_proofs"], audit.findings
    (2, [])
    """
    nodes = list(nodes)
    best = min((known.cost for known in nodes), default=inf)
    if best == inf:
        return
    unit = max(abs(best), 1.0)
    family = make_instance(trip, (), trip.grid, drive, tuple(range(len(trip.chargers))))
    place = {stop.charger: i for i, stop in enumerate(family.stops)}
    plans = [
        _Passage(known, trajectory, [place[s.charger] for s in known.instance.stops])
        for known in nodes
        for trajectory in known.strict
    ]
    above = best + unit * float(10.0 ** rng.uniform(-3.5, -1.0))
    closings = [("below", best - (1.0 - BELOW) * unit), ("above", above)]
    for i in rng.permutation(len(closings))[: effort.closings]:
        where, closing = closings[i]
        graph = StageGraph(family, closing + float(rng.integers(2)) * HIGH * unit)
        search = StageSearch(graph, perf_counter() + effort.stages_s)
        search.prepare()
        for turn in range(effort.advances):
            if turn == effort.advances // 3 and graph.closing > closing:
                graph.apply(StageStep("closing", value=closing))
            if search.done:
                break
            search.advance()
        graph.apply(StageStep("closing", value=closing))
        audit.counts["stage_proofs"] += 1
        audit.counts["stage_steps"] += len(graph.steps)
        audit.counts["stage_closed"] += graph.bound >= closing
        _judge(audit, graph, f"stages {where}", best, plans)
        _spoil(audit, graph, rng)
        _judge(audit, graph, f"spoilt stages {where}", best, plans)


class _Passage:
    """A plan as a chain of stages.

    Parameters
    ----------
    known : Known
        Its subset.
    trajectory : Trajectory
        What happens.
    stops : list of int
        Places of its stops among those of the family.
    """

    def __init__(self, known: Known, trajectory: Trajectory, stops: list[int]) -> None:
        self.trajectory, self.stops = trajectory, stops
        self.subset = known.instance.subset
        used = list(zip(known.instance.stops, trajectory.stops, strict=True))
        costs = [stop_cost(s, float(t.dwell_h.sum()), float(t.grid_kwh.sum())) for s, t in used]
        self.remaining = [sum(costs[i:]) for i in range(len(costs) + 1)]
        """What it still costs from the start and from each stop on."""
        self.states: list[State] = [
            (float(t.energy_kwh[-1]) - s.detour_out_kwh, float(t.temperature_c[-1]))
            for s, t in used
        ]
        """Those with which it drives on from its stops."""

    def piece(self, graph: StageGraph, leg: int, arc: Arc) -> Trajectory:
        """Return the part of the trajectory that one stage covers."""
        a, b = (self._node(graph, v) for v in (arc.source, arc.target))
        energy, temperature = self.states[leg - 1] if leg else graph.origin
        t = self.trajectory
        return replace(
            t,
            energy_kwh=np.append(energy, t.energy_kwh[a + 1 : b + 1]),
            temperature_c=np.append(temperature, t.temperature_c[a + 1 : b + 1]),
            power_kw=t.power_kw[a:b],
            stops=t.stops[leg : leg + 1],
        )

    @staticmethod
    def _node(graph: StageGraph, vertex: Vertex) -> int:
        if vertex.stop == START:
            return 0
        stops = graph.instance.stops
        return stops[vertex.stop].node if vertex is not graph.end else graph.instance.drive.n_steps


def _judge(audit: Audit, graph: StageGraph, name: str, best: float, plans: list[_Passage]) -> None:
    """Hold the bounds of a graph against the cheapest plan, its paths against all below it."""
    unit = max(abs(best), 1.0)
    audit.bound(name, None, graph.lower_bound, best)
    if graph.lower_bound == inf:
        audit.found(f"{name}: infeasible with a plan", None, f"cost {best!r}")
    if graph.closing > best:  # then it claims that no plan costs less than its bound
        audit.bound(f"{name}, reached", None, graph.bound, best)
        if graph.bound >= graph.closing > best + ROUNDING * unit:
            audit.found(
                f"{name}: closed with a plan below", None, f"{graph.closing!r}, cost {best!r}"
            )
    for plan in plans:
        if not graph.shrunk or plan.trajectory.cost < graph.closing - ROUNDING * unit:
            audit.counts["stage_paths"] += 1
            _pass(audit, graph, name, plan)


def _pass(audit: Audit, graph: StageGraph, name: str, plan: _Passage) -> None:
    """Look for a path that a plan may take, and hold the bounds on it against its costs."""
    at = [graph.start]
    stops = [*plan.stops, graph.end.stop]
    for leg, stop in enumerate(stops):
        state = plan.states[leg - 1] if leg else graph.origin
        end = plan.states[leg] if leg < len(plan.states) else None
        taken: list[Arc] = []
        for arc in (a for vertex in at for a in vertex.out):
            if arc.target.stop != stop or (end is not None and _beyond(arc.target.cell, end)):
                continue
            box = arc.parent_box if arc.box is None else arc.box
            piece = plan.piece(graph, leg, arc)
            if box is None or not outside(box, graph.stage(arc), piece):
                taken.append(arc)
        if not taken:
            text = f"leg {leg} to stop {stop}, cost {plan.trajectory.cost!r}"
            audit.found(f"{name}: plan without a path", plan.subset, text)
            return
        left = plan.remaining[leg]
        value = min(arc.value(state) for arc in taken)
        if value > left + ROUNDING * max(abs(left), 1.0):
            text = f"leg {leg} bound {value!r}, costs {left!r}"
            audit.found(f"{name}: bound of a stage above a cost", plan.subset, text)
        at = list({arc.target.number: arc.target for arc in taken}.values())
        if end is not None:
            value = min(vertex.value(end) for vertex in at)
            left = plan.remaining[leg + 1]
            if value > left + ROUNDING * max(abs(left), 1.0):
                text = f"after leg {leg} bound {value!r}, costs {left!r}"
                audit.found(f"{name}: bound of a vertex above a cost", plan.subset, text)


def _beyond(cell: Cell, state: State) -> bool:
    """Return whether a state lies outside of a cell."""
    for (lo, hi), value in zip((cell.energy, cell.temperature), state, strict=True):
        slack = BOX_TOLERANCE * (1.0 + abs(value))
        if value < lo - slack or value > hi + slack:
            return True
    return False


def _spoil(audit: Audit, graph: StageGraph, rng: Random) -> None:
    """Repeat steps with spoilt dual vectors, and pass on to the start what they claim."""
    steps = [s for s in graph.steps if s.dual.size and graph.arcs[s.at].alive]
    for i in rng.permutation(len(steps))[:SPOILT_STEPS]:
        step = steps[i]
        for _, dual in attacked(step.dual, rng):
            audit.counts["attacks"] += 1
            spoilt = replace(step, dual=dual)
            if step.kind == "cost" and rng.random() < 0.3:
                spoilt = replace(spoilt, kind="empty", ray=True)
            with suppress(ValueError):  # it may refuse
                graph.apply(spoilt)
    for vertex in sorted(graph.vertices.values(), key=lambda v: -v.stop):
        if vertex is graph.end or vertex is graph.start:
            continue
        for slope in {(p.energy, p.temperature) for a in vertex.out for p in a.planes[-3:]}:
            graph.apply(StageStep("plane", vertex.number, slope=slope))
