"""Owns which steps a proof over stages takes: where to bound, to shrink and to cut.

Follows the cheapest path by what is known so far from the start, stage by stage, and
then takes planes backwards along it, as in dual dynamic programming; where planes
no longer rise, boxes are shrunk, and then cells and boxes are cut. Choices live here,
proofs in ``stage_graph``.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import Arc, StageStep, State, Vertex
from relax.branch import Target
from relax.instance import Instance
from relax.intervals import Interval
from relax.solve import ConeSolver, RawSolution, SolveSettings, SolveStatus, solve_objective
from relax.stage_program import Penalty, StageProgram

__all__ = ["StageSearch", "make_penalty"]

Array = npt.NDArray[np.float64]

SETTINGS = SolveSettings(tolerance=1e-4)
"""Planes are safe whatever the tolerance; 1e-5 took a third longer to the same bound."""
FIRST_CELL_KWH = 15.0
"""Cells wider than this are halved before the first planes are taken [kWh]."""
TRIAL_C = 22.0
"""Temperature at which first planes touch: that of a battery which has just been charged."""
RISE = 1.5e-3
"""Share of the cost by which a target's planes must rise for a stage to be solved again, and
below which a path gains too little."""
NONCONVEX = 5e-4
"""Share of the cost by which planes may miss the least of a vertex's arcs, which no plane reaches,
before the vertex is cut."""
NEAR = 0.04
"""Share of the cost that is missing at most where boxes are shrunk: before, that gains little."""
AGAIN = 0.5
"""Boxes are shrunk again when this share is left of what was missing."""
WORTH = {"charge": 1.0, "stay": 0.05, "temperature": 3.0, "stop_temperature": 3.0}
"""Intervals narrower than this are not bounded [kWh, h, K]."""
CELL_UNIT = (3.0, 20.0)
"""Widths of cells that count alike when the quantity to cut is chosen [kWh, K]."""
BOX_UNIT = {"charge": 6.0, "stay": 0.3, "arrival": 16.0, "middle": 20.0}
"""The same for quantities inside a stage [kWh, h, K, K]."""
SHORT_LEG = 4
"""Legs of up to this many steps have no middle."""
MOST_SLOPES = 12
"""Arcs bounded with the slope of one plane: then the plane takes what is known."""
MOST_TRIES = 300
"""Arcs solved for one state."""
STALL = 100
"""Paths without a gain of ``STALL_SHARE`` after which a search ends."""
STALL_SHARE = 0.05
"""Share of what is missing that counts as a gain."""
KEPT_SOLVERS = 150
"""Solvers that are kept set up; each takes about half a megabyte."""


def make_penalty(instance: Instance) -> Penalty:
    """Return prices at which no stage gains from leaving its asked start.

    Twice the dearest energy at a slow charge of 20 kW, with its heat for the temperature.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> make_penalty(family).energy > 17.0
    True
    """
    dearest = max(
        (s.price_per_kwh + (s.time_price_per_h + s.occupancy_price_per_h) / 20.0
         for s in instance.stops),
        default=0.0,
    )  # fmt: skip
    energy = max(2.0 * dearest, 1e-3)
    return Penalty(energy, 2.5 * energy * instance.vehicle.pack.heat_capacity_kwh_per_k)


@dataclass(frozen=True)
class _Known:
    """The last solve of an arc from a state."""

    state: State
    end: State | None
    value_there: float


class _Leg(NamedTuple):
    """One stage of a path: where it starts, and which arc it takes."""

    vertex: Vertex
    state: State
    arc: Arc


class _Cut(NamedTuple):
    """A possible cut, by its width in units of its kind."""

    share: float
    step: StageStep


class StageSearch:
    """A proof over stages in the making.

    Parameters
    ----------
    graph : StageGraph
        What is proved; it grows.
    deadline : float
        ``time.perf_counter()`` from which on no program is solved [s].

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> search = StageSearch(StageGraph(family, closing=200.0))
    >>> search.prepare()
    >>> while search.graph.bound < 200.0:
    ...     search.advance()
    >>> search.programs > 0
    True
    """

    def __init__(self, graph: StageGraph, deadline: float = inf) -> None:
        self.graph, self.deadline = graph, deadline
        self.penalty = make_penalty(graph.instance)
        self.programs = 0
        self.path: tuple[int, ...] = ()
        """Stops of the last path."""
        self._known: dict[int, _Known] = {}
        self._level: dict[int, float] = {}
        self._solvers: OrderedDict[int, tuple[StageProgram, ConeSolver]] = OrderedDict()
        self._size = abs(graph.closing)

    @property
    def late(self) -> bool:
        """Whether time is up."""
        return time.perf_counter() > self.deadline

    @property
    def done(self) -> bool:
        """Whether all is closed, or time is up."""
        return self.graph.bound >= self.graph.closing or self.late

    def run(self) -> Iterator[float]:
        """Prepare, then follow paths; yield after each which share of the gap is closed.

        Ends when all is closed, time is up, or many paths have gained next to nothing.
        """
        graph = self.graph
        self.prepare()
        first, best, idle = -inf, -inf, 0
        while not self.done and idle < STALL:
            self.advance()
            first = graph.bound if first == -inf else first
            missing = graph.closing - graph.bound
            gained = graph.bound > best + STALL_SHARE * missing or best == -inf
            best, idle = (graph.bound, 0) if gained else (best, idle + 1)
            share = 1.0 - missing / max(graph.closing - first, 1e-9) if first > -inf else 0.0
            yield min(max(share, 0.0), 1.0)

    def prepare(self) -> None:
        """Open all stages, cut cells that are very wide, and take first planes, from the end."""
        graph = self.graph
        for vertex in self._backwards():
            for arc in vertex.out[:]:
                if arc.target is not graph.end and not arc.target.out:
                    graph.apply(StageStep("plane", arc.target.number))
                else:
                    graph.apply(StageStep("open", arc.number))
                if self.late:
                    return
            if vertex is not graph.start:
                graph.apply(StageStep("narrow", vertex.number))
        for vertex in self._backwards():
            lo, hi = vertex.cell.energy
            if vertex is not graph.start and hi - lo > FIRST_CELL_KWH:
                graph.apply(StageStep("split", vertex.number, sign=0, value=0.5 * (lo + hi)))
        for vertex in self._backwards():
            if vertex is not graph.start and not self.late:
                (e0, e1), (t0, t1) = vertex.cell.energy, vertex.cell.temperature
                self._take_planes(vertex, (0.5 * (e0 + e1), min(max(TRIAL_C, t0), t1)))

    def _backwards(self) -> list[Vertex]:
        """Return all vertices but the destination, last stops first."""
        graph = self.graph
        inner = [v for v in graph.vertices.values() if v is not graph.end]
        return sorted(inner, key=lambda v: (-v.stop, v.number))

    def advance(self) -> None:
        """Follow one path, take planes along it, and shrink or cut where they do not rise."""
        graph = self.graph
        path = self._follow()
        if path is None or self.done:
            return
        self.path = tuple(leg.arc.target.stop for leg in path[:-1])
        before = [leg.vertex.value(leg.state) for leg in path]
        missed: list[tuple[float, _Leg]] = []
        rise = 0.0
        for leg, known in zip(path[:0:-1], before[:0:-1], strict=True):
            taken = self._take_planes(leg.vertex, leg.state)
            if taken is None:
                continue
            least, plane = taken
            missed.append((least - plane, leg))
            rise = max(rise, least - known)
        most = max((gap for gap, _ in missed), default=0.0)
        if self.late or rise > max(RISE * self._size, 2.0 * most):
            return
        if self._shrink_along(path):
            return
        if most > NONCONVEX * self._size:
            leg = max(missed, key=lambda pair: pair[0])[1]
            cuts = self._cell_cuts(leg.vertex)
        else:
            cuts = [c for leg in path for c in (*self._cell_cuts(leg.vertex), *_box_cuts(leg.arc))]
        if cuts:
            graph.apply(max(cuts, key=lambda cut: cut.share).step)

    def _follow(self) -> list[_Leg] | None:
        """Return the cheapest path by what is known; None if there is none."""
        graph = self.graph
        vertex, state = graph.start, graph.origin
        path: list[_Leg] = []
        while vertex is not graph.end:
            arc, end = self._least(vertex, state)
            if arc is None:
                graph.apply(StageStep("plane", vertex.number))
                return None
            path.append(_Leg(vertex, state, arc))
            vertex = arc.target
            if end is None:
                break
            state = end
        return path

    def _least(self, vertex: Vertex, state: State) -> tuple[Arc | None, State | None]:
        """Solve arcs from a state until the one of least bound has been solved."""
        best = None
        for _ in range(MOST_TRIES):
            best = min(vertex.out, key=lambda arc: arc.value(state), default=None)
            if best is None:
                return None, None
            known = self._known.get(best.number)
            if known is not None and known.state == state:
                there = -inf if known.end is None else best.target.value(known.end)
                if there <= known.value_there + RISE * self._size:
                    return best, known.end
            if self.late:
                return best, None
            self._solve_from(best, state)
        return best, None

    def _take_planes(self, vertex: Vertex, state: State) -> tuple[float, float] | None:
        """Give a vertex a plane that touches the least of its arcs at a state, if it can.

        Returns the least of the arcs and the plane's value there; None without an arc.
        """
        best, _ = self._least(vertex, state)
        if best is None or not best.planes:
            self.graph.apply(StageStep("plane", vertex.number))
            return None
        touching = max(best.planes, key=lambda plane: plane.at(state))
        slope = touching.energy, touching.temperature
        tried = {best.number}
        for _ in range(MOST_SLOPES):
            low = min(vertex.out, key=lambda arc: arc.constant(slope), default=None)
            if low is None or low.number in tried or self.late:
                break
            tried.add(low.number)
            self._solve_slope(low, slope)
        least = min((arc.value(state) for arc in vertex.out), default=inf)
        constant = min((arc.constant(slope) for arc in vertex.out), default=inf)
        value = constant + slope[0] * state[0] + slope[1] * state[1]
        if not vertex.out or value > vertex.value(state):
            self.graph.apply(StageStep("plane", vertex.number, slope=slope))
        return (least, value) if vertex.out else None

    def _ready(self, arc: Arc) -> StageProgram | None:
        """Open an arc; return its program, None if no plan takes it or nothing follows yet."""
        if arc.box is None:
            self.graph.apply(StageStep("open", arc.number))
        return self.graph.program(arc) if arc.alive and arc.target.planes else None

    def _solve(self, arc: Arc, program: StageProgram, q: Array) -> RawSolution:
        kept = self._solvers.get(arc.number)
        if kept is None or kept[0] is not program:
            kept = program, ConeSolver(program.cone, SETTINGS)
            self._solvers[arc.number] = kept
            if len(self._solvers) > KEPT_SOLVERS:
                self._solvers.popitem(last=False)
        self._solvers.move_to_end(arc.number)
        found = solve_objective(kept[1], q, changed=True)
        self.programs += 1
        return found

    def _solve_from(self, arc: Arc, state: State) -> None:
        """Take a plane that touches the cost of an arc at a state."""
        program = self._ready(arc)
        if program is None:
            self._known[arc.number] = _Known(state, None, -inf)
            return
        found = self._solve(arc, program, program.ask_start(state, self.penalty))
        if found.status is SolveStatus.INFEASIBLE:
            self.graph.apply(StageStep("empty", arc.number, found.z, ray=True))
        elif np.isfinite(found.z).all():
            slope = program.slope_at(found.z)
            self.graph.apply(StageStep("cost", arc.number, found.z, slope))
        end = program.end_state(found.x) if program.ends and np.isfinite(found.x).all() else None
        there = -inf if end is None else arc.target.value(end)
        self._known[arc.number] = _Known(state, end, there)

    def _solve_slope(self, arc: Arc, slope: tuple[float, float]) -> None:
        """Take the highest plane of a slope below the cost of an arc."""
        program = self._ready(arc)
        if program is None:
            return
        found = self._solve(arc, program, program.ask_slope(slope))
        ray = found.status is SolveStatus.INFEASIBLE
        kind = StageStep("empty" if ray else "cost", arc.number, found.z, slope, ray=ray)
        self.graph.apply(kind)

    def _shrink_along(self, path: list[_Leg]) -> bool:
        """Shrink the boxes of a path that have not been shrunk at this distance to the end."""
        missing = self.graph.closing - self.graph.bound
        if missing > NEAR * self._size:
            return False
        did = False
        for leg in path:
            level = self._level.get(leg.arc.number, inf)
            if leg.arc.alive and leg.arc.box is not None and missing < AGAIN * level:
                self._level[leg.arc.number] = missing
                self._shrink(leg)
                did = True
        return did

    def _shrink(self, leg: _Leg) -> None:
        """Bound what is uncertain in a stage, over plans that may still matter."""
        graph, arc = self.graph, leg.arc
        if not arc.target.planes:
            return
        for target, signs in _quantities(arc):
            if not arc.alive:
                return
            interval: Interval = getattr(arc.box, target.name)
            if interval.width[target.index] < WORTH[target.name]:
                continue
            for sign in signs:
                if self.late or not arc.alive:
                    return
                program = graph.program(arc)
                q = program.ask_quantity(target, sign, graph.budget(arc, leg.state))
                found = self._solve(arc, program, q)
                ray = found.status is SolveStatus.INFEASIBLE
                graph.apply(
                    StageStep(
                        "shrink", arc.number, found.z, state=leg.state, target=target,
                        sign=sign, ray=ray,
                    )
                )  # fmt: skip
        if arc.alive:
            graph.apply(StageStep("propagate", arc.number))

    def _cell_cuts(self, vertex: Vertex) -> list[_Cut]:
        if vertex is self.graph.start or vertex.number not in self.graph.vertices:
            return []
        out = []
        for axis, limits in enumerate((vertex.cell.energy, vertex.cell.temperature)):
            lo, hi = limits
            step = StageStep("split", vertex.number, sign=axis, value=0.5 * (lo + hi))
            out.append(_Cut((hi - lo) / CELL_UNIT[axis], step))
        return out


def _middle(arc: Arc) -> Target | None:
    assert arc.box is not None
    steps = arc.box.power.lo.size
    return Target("temperature", steps // 2, "temperature") if steps > SHORT_LEG else None


def _quantities(arc: Arc) -> list[tuple[Target, tuple[int, ...]]]:
    """Return what is bounded in a stage, and from which sides."""
    assert arc.box is not None
    out: list[tuple[Target, tuple[int, ...]]] = []
    if arc.box.optional.size:
        out.append((Target("stay", 0, "dwell"), (-1,)))
    middle = _middle(arc)
    if middle is not None:
        out.append((middle, (-1,)))
    out.append((Target("temperature", arc.box.power.lo.size, "temperature"), (-1, 1)))
    if arc.box.optional.size:
        end = 0, arc.box.stop_temperature.lo.shape[1] - 1
        out.append((Target("charge", 0, "charge"), (1, -1)))
        out.append((Target("stop_temperature", end, "border"), (-1, 1)))
    return out


def _box_cuts(arc: Arc) -> list[_Cut]:
    """Return where a stage's box may be cut."""
    if not arc.alive or arc.box is None:
        return []
    targets = []
    middle = _middle(arc)
    if middle is not None:
        targets.append(("middle", middle))
    if arc.box.optional.size:
        last = arc.box.power.lo.size
        targets.append(("charge", Target("charge", 0, "charge")))
        targets.append(("arrival", Target("temperature", last, "temperature")))
        targets.append(("stay", Target("stay", 0, "dwell")))
    out = []
    for kind, target in targets:
        interval: Interval = getattr(arc.box, target.name)
        share = float(interval.width[target.index]) / BOX_UNIT[kind]
        value = float(interval.mid[target.index])
        out.append(_Cut(share, StageStep("halve", arc.number, target=target, value=value)))
    return out
