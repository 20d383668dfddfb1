"""Owns what is proved of all plans at once, stage by stage: a graph of cells, and its steps.

A vertex is a cell: all states with which a car drives on after some stop. An arc is a stage
between two cells. Every plan is a path, so every subset of chargers is covered. Planes
bound from below what a plan still costs from a vertex, or through an arc; those at the start
bound all plans. Steps change the graph and are certified from dual vectors alone; the
same code runs while a proof is found and while it is audited. Knows no solver.

Every claim speaks of the plans that cost less than ``closing``: there the sum of what
the stages cost more than the planes account for is less than ``closing`` minus the bound.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import replace
from math import inf, isfinite

from enumerate.stage_check import refusal
from enumerate.stage_parts import EPS, Arc, StageStep, State, Vertex
from relax.box import Box, Cell
from relax.branch import with_interval
from relax.instance import Instance
from relax.intervals import Interval
from relax.reach import make_box, propagate
from relax.stage import START, make_stage, stop_cells
from relax.stage_program import Plane, StageProgram

__all__ = ["StageGraph"]

SWEEPS = 2
"""Propagations of a box that was cut or shrunk."""
LARGEST = 1e12
"""Planes with larger numbers are not kept: their rounding would show [currency]."""
KEPT_PROGRAMS = 300
"""Programs that are kept, the last used; each takes about a quarter of a megabyte."""


class StageGraph:
    """All plans of a trip as paths of stages, and what is proved of them.

    Parameters
    ----------
    instance : Instance
        The family of all subsets: every stop optional.
    closing : float
        Cost below which plans matter [currency].

    Raises
    ------
    ValueError
        The cost is not finite.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> graph = StageGraph(family, closing=400.0)
    >>> len(graph.vertices), graph.bound  # start, three stops, destination; nothing proved
    (5, -inf)
    """

    def __init__(self, instance: Instance, closing: float) -> None:
        if not isfinite(closing):
            raise ValueError(f"closing must be finite, not {closing}")
        self.instance, self.given, self.closing = instance, closing, closing
        self.steps: list[StageStep] = []
        self.shrunk = False
        """Whether anything was left out because of its cost."""
        self.vertices: dict[int, Vertex] = {}
        self.arcs: dict[int, Arc] = {}
        self._stages: dict[tuple[int, int], Instance] = {}
        self._numbers = [0, 0]
        self._kept: OrderedDict[int, Arc] = OrderedDict()
        energy, temperature = instance.start_energy_kwh, instance.start_temperature_c
        self.start = self._vertex(START, Cell((energy, energy), (temperature, temperature)))
        self.origin: State = energy, temperature
        for stop, cell in enumerate(stop_cells(instance)):
            if cell is not None:
                self._vertex(stop, cell)
        enough = Cell((instance.end_energy_min_kwh, inf), (-inf, inf))
        self.end = self._vertex(len(instance.stops), enough)
        self.end.planes.append(Plane(0.0, 0.0, 0.0))
        order = list(self.vertices.values())
        for i, source in enumerate(order):
            for target in order[i + 1 :]:
                self._arc(source, target)

    @property
    def bound(self) -> float:
        """No plan costs less than this, or than ``closing`` [currency]; ``inf``: there is none."""
        return min((arc.value(self.origin) for arc in self.start.out), default=inf)

    @property
    def lower_bound(self) -> float:
        """No plan costs less than this [currency]; ``inf``: there is none."""
        return min(self.bound, self.closing) if self.shrunk else self.bound

    def stage(self, arc: Arc) -> Instance:
        """Return the instance of an arc's stage."""
        key = arc.source.stop, arc.target.stop
        if key not in self._stages:
            self._stages[key] = make_stage(self.instance, *key)
        return self._stages[key]

    def program(self, arc: Arc) -> StageProgram:
        """Return the program of an arc that is open, with its target's planes."""
        if arc.program is None:
            if arc.program_box is None:
                assert arc.box is not None, "open it first"
                arc.program_box = arc.box
            arc.program = StageProgram(self.stage(arc), arc.program_box)
        self._kept[arc.number] = arc
        self._kept.move_to_end(arc.number)
        if len(self._kept) > KEPT_PROGRAMS:
            self._kept.popitem(last=False)[1].program = None
        arc.program.set_planes(arc.target.planes)
        return arc.program

    def budget(self, arc: Arc, state: State) -> Plane:
        """Return what an arc and all after it may cost: a plane over its source's states.

        Planes of the source bound what a plan still costs; the arc may exceed them by
        what the whole plan may exceed the bound. Their maximum is raised to a plane.
        """
        slack = max(self.closing - self.bound, 0.0)
        if arc.source is self.start:
            return Plane(self.closing + EPS * abs(self.closing), 0.0, 0.0)
        planes, cell = arc.source.planes, arc.source.cell
        best = max(planes, key=lambda plane: plane.at(state))
        (e0, e1), (t0, t1) = cell.energy, cell.temperature
        rise = 0.0
        for plane in planes:
            e, t = plane.energy - best.energy, plane.temperature - best.temperature
            over = plane.constant - best.constant + max(e * e0, e * e1) + max(t * t0, t * t1)
            rise = max(rise, over)
        size = abs(self.closing) + abs(self.bound) + 2.0 * max(_size(p, cell) for p in planes)
        return best._replace(constant=best.constant + rise + slack + EPS * size)

    def apply(self, step: StageStep) -> None:
        """Do a step: certify what it claims, change the graph, and keep it.

        Raises
        ------
        ValueError
            It is no step of this graph; nothing is changed.
        """
        reason = refusal(self, step)
        if reason:
            raise ValueError(reason)
        self.steps.append(step)
        if step.kind == "split":
            self._split(self.vertices[step.at], step.sign, step.value)
        elif step.kind == "plane":
            self._take_plane(self.vertices[step.at], step.slope)
        elif step.kind == "narrow":
            self._narrow(self.vertices[step.at])
        elif step.kind == "closing":  # what holds for all plans below holds for fewer
            self.closing = step.value
        elif (arc := self.arcs[step.at]).alive:
            self._change(arc, step)

    def _change(self, arc: Arc, step: StageStep) -> None:
        """Do a step that speaks of an arc."""
        if step.kind == "open":
            self._open(arc)
        elif step.kind == "cost":
            constant = self.program(arc).claim_cost(step.slope, step.dual)
            plane = Plane(constant, *step.slope)
            size = _size(plane, arc.source.cell)
            if size <= LARGEST:  # not if nothing is proved
                arc.planes.append(plane._replace(constant=constant - EPS * size))
        elif step.kind == "empty":
            if self.program(arc).claim_empty(step.dual):
                self._drop(arc)
        elif step.kind == "propagate":
            assert arc.box is not None
            self._set_box(arc, arc.box)
        elif step.kind == "halve":
            self._halve(arc, step)
        else:
            self._shrink(arc, step)

    def _vertex(self, stop: int, cell: Cell) -> Vertex:
        vertex = Vertex(self._numbers[0], stop, cell)
        self._numbers[0] += 1
        self.vertices[vertex.number] = vertex
        return vertex

    def _arc(self, source: Vertex, target: Vertex, part_of: Arc | None = None) -> Arc:
        arc = Arc(self._numbers[1], source, target)
        self._numbers[1] += 1
        if part_of is not None:
            arc.planes = part_of.planes[:]
            arc.parent_box = part_of.parent_box if part_of.box is None else part_of.box
        self.arcs[arc.number] = arc
        source.out.append(arc)
        target.into.append(arc)
        return arc

    def _drop(self, arc: Arc) -> None:
        """Leave out an arc that no plan below ``closing`` takes."""
        if arc.alive:
            arc.alive = False
            self._forget(arc)
            arc.box = arc.parent_box = None
            arc.source.out.remove(arc)
            arc.target.into.remove(arc)

    def _forget(self, arc: Arc) -> None:
        """Give up an arc's program."""
        arc.program = arc.program_box = None
        self._kept.pop(arc.number, None)

    def _open(self, arc: Arc) -> None:
        if arc.box is not None:
            return
        end = arc.target.cell
        if arc.parent_box is None:
            box = make_box(self.stage(arc), arc.source.cell, end)
            if box.empty:
                self._drop(arc)
            else:
                arc.box = box
            return
        box = arc.parent_box.with_start(arc.source.cell)
        self._set_box(arc, box.with_end(end))

    def _set_box(self, arc: Arc, box: Box) -> None:
        """Propagate a box; drop the arc if it is empty."""
        for _ in range(SWEEPS):
            if box.empty:
                break
            box = propagate(self.stage(arc), box)
        arc.box = box
        self._forget(arc)
        if box.empty:
            self._drop(arc)

    def _shrink(self, arc: Arc, step: StageStep) -> None:
        assert step.target is not None and arc.box is not None
        self.shrunk = True
        program, budget = self.program(arc), self.budget(arc, step.state)
        if step.ray:
            if program.claim_empty(step.dual, budget):
                self._drop(arc)
            return
        value = program.claim_quantity(step.target, step.sign, budget, step.dual)
        interval: Interval = getattr(arc.box, step.target.name)
        lo, hi = interval.lo.copy(), interval.hi.copy()
        if step.sign > 0:
            lo[step.target.index] = max(lo[step.target.index], value)
        else:
            hi[step.target.index] = min(hi[step.target.index], -value)
        # the program stays on the larger box until all is propagated
        arc.box = with_interval(arc.box, step.target.name, Interval(lo, hi))

    def _halve(self, arc: Arc, step: StageStep) -> None:
        """Two arcs in place of one: below and above a value of a quantity of its box."""
        assert step.target is not None and arc.box is not None
        interval: Interval = getattr(arc.box, step.target.name)
        for upper in (False, True):
            lo, hi = interval.lo.copy(), interval.hi.copy()
            (lo if upper else hi)[step.target.index] = step.value
            part = self._arc(arc.source, arc.target, arc)
            part.parent_box = with_interval(arc.box, step.target.name, Interval(lo, hi))
        self._drop(arc)  # last: an interrupt on the way loses no plan

    def _narrow(self, vertex: Vertex) -> None:
        """Leave out states where none of the arcs on one side begins or ends."""
        energy, temperature = vertex.cell.energy, vertex.cell.temperature
        for arcs, side in ((vertex.out, 0), (vertex.into, -1)):
            boxes = [arc.box for arc in arcs if arc.box is not None]
            if not arcs or len(boxes) < len(arcs):
                continue
            ends = [_end(box, side) for box in boxes]
            energy = _hull(energy, [end.energy for end in ends])
            temperature = _hull(temperature, [end.temperature for end in ends])
        vertex.cell = Cell(energy, temperature)

    def _split(self, vertex: Vertex, axis: int, value: float) -> None:
        """Two vertices in place of one, and twice its arcs."""
        cell, parts = vertex.cell, []
        for upper in (False, True):
            name = ("energy", "temperature")[axis]
            lo, hi = getattr(cell, name)
            limits = (value, hi) if upper else (lo, value)
            part = self._vertex(vertex.stop, replace(cell, **{name: limits}))
            part.planes = vertex.planes[:]
            parts.append(part)
        # old arcs go last: an interrupt on the way loses no plan
        for arc in vertex.out[:]:
            for part in parts:
                self._arc(part, arc.target, arc)
            self._drop(arc)
        for arc in vertex.into[:]:
            for part in parts:
                self._arc(arc.source, part, arc)
            self._drop(arc)
        del self.vertices[vertex.number]

    def _take_plane(self, vertex: Vertex, slope: tuple[float, float]) -> None:
        """Bound a vertex by the least of its arcs; without arcs no plan passes it."""
        if not vertex.out:
            for arc in vertex.into[:]:
                self._drop(arc)
            return
        plane = Plane(min(arc.constant(slope) for arc in vertex.out), *slope)
        if _size(plane, vertex.cell) <= LARGEST:  # not if an arc has no bound
            vertex.planes.append(plane)

    def alive(self) -> Iterable[Arc]:
        """Return the arcs that some plan may take."""
        return [arc for vertex in self.vertices.values() for arc in vertex.out]


def _end(box: Box, side: int) -> Cell:
    """Return the states in which a stage begins (0) or ends (-1)."""
    energy, temperature = box.energy, box.temperature
    e, t = (energy.lo[side], energy.hi[side]), (temperature.lo[side], temperature.hi[side])
    if side and box.optional.size:
        last = box.stop_temperature
        e, t = (box.leave.lo[-1], box.leave.hi[-1]), (last.lo[-1, -1], last.hi[-1, -1])
    return Cell((float(e[0]), float(e[1])), (float(t[0]), float(t[1])))


def _hull(cell: tuple[float, float], parts: list[tuple[float, float]]) -> tuple[float, float]:
    """Return what of an interval the hull of others covers."""
    lo, hi = max(cell[0], min(p[0] for p in parts)), min(cell[1], max(p[1] for p in parts))
    return (lo, hi) if lo <= hi else (hi, lo)  # crossed by rounding, or nothing passes


def _size(plane: Plane, cell: Cell) -> float:
    """Return the size of the numbers that a plane's values in a cell are made of."""
    (e0, e1), (t0, t1) = cell.energy, cell.temperature
    size = abs(plane.constant) + abs(plane.energy) * max(abs(e0), abs(e1))
    return size + abs(plane.temperature) * max(abs(t0), abs(t1))
