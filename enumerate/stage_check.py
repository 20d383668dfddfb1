"""Owns the question whether a step can be done on a graph of stages at all.

Steps may come from a file, so anything may stand in them. What passes here can be
done, and whatever it then proves is true; what a step leaves undone is never lost. Knows
nothing of how steps are done.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite
from typing import Protocol

from enumerate.quantity import is_quantity
from enumerate.stage_parts import Arc, StageStep, Vertex
from relax.intervals import Interval

__all__ = ["Graph", "refusal"]

AXES = ("energy", "temperature")


class Graph(Protocol):
    """What is asked of a graph of stages."""

    start: Vertex
    end: Vertex
    closing: float

    @property
    def vertices(self) -> Mapping[int, Vertex]: ...  # noqa: D102
    @property
    def arcs(self) -> Mapping[int, Arc]: ...  # noqa: D102
    @property
    def bound(self) -> float: ...  # noqa: D102


def refusal(graph: Graph, step: StageStep) -> str:
    """Return why a step cannot be done, empty if it can; nothing is changed.

    Parameters
    ----------
    graph : StageGraph
        As it is before the step.
    step : StageStep
        Anything.

    Examples
    --------
    >>> from enumerate.stage_graph import StageGraph
    >>> from enumerate.stage_parts import StageStep
    >>> from relax import load_trip, make_instance
    >>> family = make_instance(load_trip("paper-400km"), (), undecided=(0, 1, 2))
    >>> graph = StageGraph(family, closing=400.0)
    >>> refusal(graph, StageStep("open", 3)), refusal(graph, StageStep("cost", 3))
    ('', 'arc 3 is not open')
    >>> refusal(graph, StageStep("split", 1, sign=0, value=-5.0))
    'vertex 1 is split outside of its cell'
    """
    if step.kind == "closing":
        return "" if -inf < step.value <= graph.closing else "a closing cost can only fall"
    if step.kind in ("split", "plane", "narrow"):
        vertex = graph.vertices.get(step.at)
        return f"there is no vertex {step.at}" if vertex is None else _vertex(graph, vertex, step)
    if step.kind not in ("open", "cost", "empty", "shrink", "propagate", "halve"):
        return f"{step.kind!r:.40} is no step"
    arc = graph.arcs.get(step.at)
    if arc is None:
        return f"there is no arc {step.at}"
    if not arc.alive or step.kind == "open":
        return ""
    return _arc(graph, arc, step)


def _vertex(graph: Graph, vertex: Vertex, step: StageStep) -> str:
    """Return why a step cannot be done at a vertex."""
    if vertex is graph.end:
        return "nothing can be done at the destination"
    if step.kind == "plane":
        return "" if _finite(step.slope) else "a slope is not finite"
    if vertex is graph.start:
        return "the start is one state"
    if step.kind == "split":
        if step.sign not in (0, 1):
            return f"a cell has no axis {step.sign}"
        lo, hi = getattr(vertex.cell, AXES[step.sign])
        if not lo <= step.value <= hi:
            return f"vertex {vertex.number} is split outside of its cell"
    return ""


def _arc(graph: Graph, arc: Arc, step: StageStep) -> str:
    """Return why a step cannot be done at an arc."""
    if arc.box is None:
        return f"arc {arc.number} is not open"
    if step.kind in ("cost", "empty", "shrink") and not arc.target.planes:
        return f"arc {arc.number} leads to a vertex without planes"
    if step.kind == "cost":
        return "" if _finite(step.slope) else "a slope is not finite"
    if step.kind in ("halve", "shrink") and not is_quantity(step.target, arc.box):
        return f"arc {arc.number} has no such quantity"
    if step.kind == "halve":
        assert step.target is not None
        interval: Interval = getattr(arc.box, step.target.name)
        lo, hi = interval.lo[step.target.index], interval.hi[step.target.index]
        if not min(lo, hi) <= step.value <= max(lo, hi):  # crossed: what was shrunk has no state
            return f"arc {arc.number} is halved outside of its box"
    if step.kind == "shrink":
        if step.sign not in (1, -1):
            return f"an interval has no side {step.sign}"
        if not _finite(step.state):
            return "a state is not finite"
        if not (arc.source is graph.start or arc.source.planes):
            return f"arc {arc.number} leaves a vertex without planes: it has no budget"
        if graph.bound == -inf:
            return "a box is shrunk while no cost is bounded"
    return ""


def _finite(values: tuple[float, float]) -> bool:
    return all(isfinite(value) for value in values)
