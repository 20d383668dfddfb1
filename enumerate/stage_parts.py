"""Owns the parts of a proof over stages as data: steps, vertices and arcs.

Knows nothing of what a step does and of what is true.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Literal

import numpy as np
import numpy.typing as npt

from relax.box import Box, Cell
from relax.branch import Target
from relax.stage_program import Plane, StageProgram

__all__ = ["EPS", "Arc", "StageStep", "State", "Vertex"]

Array = npt.NDArray[np.float64]
State = tuple[float, float]

EPS = 16.0 * float(np.finfo(np.float64).eps)
"""Relative rounding of the few operations on planes."""


@dataclass(frozen=True)
class StageStep:
    """One step of a proof over stages.

    Parameters
    ----------
    kind : str
        ``"open"`` an arc's box, bound its ``"cost"`` by a plane, show that it is ``"empty"``,
        ``"shrink"`` a quantity, ``"propagate"`` its box, ``"halve"`` an interval of it,
        ``"narrow"`` or ``"split"`` a vertex, or take a ``"plane"`` for it from its arcs;
        lower the ``"closing"`` cost.
    at : int
        Number of the arc; of the vertex for ``"narrow"``, ``"split"`` and ``"plane"``.
    dual : ndarray, shape (m,)
        Dual vector or ray of the arc's program.
    slope : tuple of float
        Of a plane [currency/kWh, currency/K].
    state : tuple of float
        For ``"shrink"``: the state for which the budget is chosen [kWh, degrees C].
    target : Target or None
        The quantity of ``"shrink"`` and ``"halve"``.
    sign : int
        1: its lower end, -1: its upper end. For ``"split"`` 0: energy, 1: temperature.
    value : float
        Where to halve or split; the closing cost [currency].
    ray : bool
        Whether the dual vector is to show that nothing is left.
    """

    kind: Literal[
        "open",
        "cost",
        "empty",
        "shrink",
        "propagate",
        "halve",
        "narrow",
        "split",
        "plane",
        "closing",
    ]
    at: int = -1
    dual: Array = field(default_factory=lambda: np.zeros(0))
    slope: tuple[float, float] = (0.0, 0.0)
    state: State = (0.0, 0.0)
    target: Target | None = None
    sign: int = 0
    value: float = 0.0
    ray: bool = False


@dataclass(eq=False)
class Vertex:
    """A cell after a stop, the start, or the destination.

    Parameters
    ----------
    number : int
        Its number.
    stop : int
        Place of the stop in driving order; ``START``, or the number of stops.
    cell : Cell
        States with which the car drives on.
    planes : list of Plane
        Lower bounds of what a plan still costs from here.
    out, into : list of Arc
        Stages that begin and end here.
    """

    number: int
    stop: int
    cell: Cell
    planes: list[Plane] = field(default_factory=list)
    out: list[Arc] = field(default_factory=list)
    into: list[Arc] = field(default_factory=list)

    def value(self, state: State) -> float:
        """Return the largest lower bound at a state."""
        return max((plane.at(state) for plane in self.planes), default=-inf)


@dataclass(eq=False)
class Arc:
    """A stage between two cells.

    Parameters
    ----------
    number : int
        Its number.
    source, target : Vertex
        Where it begins and ends.
    planes : list of Plane
        Lower bounds of what a plan that takes it still costs from its source.
    box : Box or None
        Its box, None until it is opened.
    parent_box : Box or None
        Box of the arc that it is a part of.
    program : StageProgram or None
        On ``program_box``; None until it is needed, and after it was not used for long.
    program_box : Box or None
        Its present box, or that before it was shrunk and not yet propagated.
    alive : bool
        False: no plan below ``closing`` takes it.
    """

    number: int
    source: Vertex
    target: Vertex
    planes: list[Plane] = field(default_factory=list)
    box: Box | None = None
    parent_box: Box | None = None
    program: StageProgram | None = None
    program_box: Box | None = None
    alive: bool = True

    def value(self, state: State) -> float:
        """Return the largest lower bound at a state."""
        return max((plane.at(state) for plane in self.planes), default=-inf)

    def constant(self, slope: tuple[float, float]) -> float:
        """Return the largest constant of a plane of this slope below its planes."""
        cell = self.source.cell
        (e0, e1), (t0, t1) = cell.energy, cell.temperature
        if self.box is not None:
            e0, e1 = max(e0, float(self.box.energy.lo[0])), min(e1, float(self.box.energy.hi[0]))
            first = self.box.temperature
            t0, t1 = max(t0, float(first.lo[0])), min(t1, float(first.hi[0]))
        best = -inf
        for plane in self.planes:
            e, t = plane.energy - slope[0], plane.temperature - slope[1]
            value = plane.constant + min(e * e0, e * e1) + min(t * t0, t * t1)
            size = abs(plane.constant) + (abs(plane.energy) + abs(slope[0])) * max(abs(e0), abs(e1))
            size += (abs(plane.temperature) + abs(slope[1])) * max(abs(t0), abs(t1))
            best = max(best, value - EPS * size)
        return best
