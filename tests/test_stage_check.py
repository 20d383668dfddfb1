"""A step that cannot be done on a graph of stages is refused; one that can loses no plan."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from trips import small_trip

from enumerate import plan
from enumerate.stage_graph import StageGraph, _hull
from enumerate.stage_parts import Arc, StageStep
from enumerate.stage_search import StageSearch
from relax import Grid, make_instance
from relax.branch import Target, with_interval
from relax.instance import Instance
from relax.intervals import Interval
from relax.stage_program import Plane

TRIP = dataclasses.replace(
    small_trip(start_soc=0.45, time_value_per_h=60.0), grid=Grid(step_km=10.0, cells=4)
)


@pytest.fixture(scope="module")
def family() -> Instance:
    return make_instance(TRIP, (), undecided=(0, 1))


@pytest.fixture(scope="module")
def done(family: Instance) -> StageGraph:
    """The graph at the end of a proof: of a gap of 2 %."""
    graph = StageGraph(family, 0.98 * plan(TRIP).cost)
    for _ in StageSearch(graph).run():
        pass
    assert graph.bound >= graph.closing and graph.shrunk
    return graph


def state_of(graph: StageGraph) -> Any:
    return (
        graph.bound, graph.shrunk, len(graph.steps), graph.end.planes[:],
        {n: (v.cell, len(v.planes)) for n, v in graph.vertices.items()},
        {n: (a.alive, id(a.box), a.planes[:]) for n, a in graph.arcs.items()},
    )  # fmt: skip


def an_arc(graph: StageGraph, wanted: Callable[[Arc], bool]) -> Arc:
    return next(a for a in graph.arcs.values() if a.alive and wanted(a))


CHARGE = Target("charge", 0, "charge")


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda g, a: StageStep("guess", a.number), "'guess' is no step"),
        *(
            (lambda g, a, v=v: StageStep("closing", value=v), "can only fall")
            for v in (1e6, nan, inf, -inf)
        ),
        (lambda g, a: StageStep("open", -1), "there is no arc -1"),
        (lambda g, a: StageStep("cost", 10**9), "there is no arc 1000000000"),
        (lambda g, a: StageStep("plane", -1), "there is no vertex -1"),
        (lambda g, a: StageStep("plane", g.end.number), "at the destination"),
        (lambda g, a: StageStep("split", g.end.number), "at the destination"),
        (lambda g, a: StageStep("narrow", g.end.number), "at the destination"),
        (lambda g, a: StageStep("split", g.start.number, value=g.origin[0]), "one state"),
        (lambda g, a: StageStep("narrow", g.start.number), "one state"),
        (lambda g, a: StageStep("plane", a.source.number, slope=(nan, 0.0)), "slope"),
        (lambda g, a: StageStep("plane", a.source.number, slope=(0.0, inf)), "slope"),
        (lambda g, a: StageStep("cost", a.number, slope=(inf, 0.0)), "slope"),
        (lambda g, a: StageStep("cost", a.number, slope=(0.0, nan)), "slope"),
        *(
            (lambda g, a, v=v: StageStep("split", a.source.number, value=v), "outside of its cell")
            for v in (-1.0, 1e9, nan, inf, -inf)
        ),
        (lambda g, a: StageStep("split", a.source.number, sign=1, value=-99.0), "outside"),
        (lambda g, a: StageStep("split", a.source.number, sign=2, value=20.0), "no axis 2"),
        (lambda g, a: StageStep("split", a.source.number, sign=-1, value=20.0), "no axis -1"),
        *(
            (lambda g, a, v=v: StageStep("halve", a.number, target=CHARGE, value=v), "of its box")
            for v in (-1.0, 1e9, nan, inf, -inf)
        ),
        *(
            (lambda g, a, t=t: StageStep("halve", a.number, target=t, value=20.0), "no such quan")
            for t in (
                None, Target("charge", 1, "charge"), Target("charge", -1, "charge"),
                Target("charge", (0, 0), "charge"), Target("charge", 0, "dwell"),
                Target("optional", 0, "used"), Target("temperature", 999, "temperature"),
                Target("stop_temperature", (0, -1), "border"), Target("count", 0, "charge"),
            )
        ),
        *(
            (lambda g, a, t=t: StageStep("shrink", a.number, target=t, sign=1), "no such quantity")
            for t in (None, Target("charge", -1, "charge"), Target("energy", 0, "energy"))
        ),
        (lambda g, a: StageStep("shrink", a.number, target=CHARGE, sign=0), "no side 0"),
        (lambda g, a: StageStep("shrink", a.number, target=CHARGE, sign=2), "no side 2"),
        (
            lambda g, a: StageStep("shrink", a.number, target=CHARGE, sign=1, state=(nan, 0.0)),
            "a state is not finite",
        ),
    ],
)  # fmt: skip
def test_a_step_that_is_none_is_refused_and_changes_nothing(
    done: StageGraph, make: Callable[[StageGraph, Arc], StageStep], named: str
) -> None:
    """Into the graph at the end of a proof; the arc leads from a stop to another one."""
    arc = an_arc(done, lambda a: a.source is not done.start and a.box is not None and
                 a.box.charge.lo.size > 0)  # fmt: skip
    before = state_of(done)
    with pytest.raises(ValueError, match=named):
        done.apply(make(done, arc))
    assert state_of(done) == before


def test_steps_must_come_in_an_order_that_can_be_done(family: Instance) -> None:
    graph = StageGraph(family, 100.0)
    inner = next(a for a in graph.arcs.values()
                 if a.source is not graph.start and a.target is not graph.end)  # fmt: skip
    last = next(a for a in graph.arcs.values()
                if a.source is not graph.start and a.target is graph.end)  # fmt: skip
    first = graph.start.out[0]
    for kind in ("cost", "empty", "shrink", "propagate", "halve"):
        with pytest.raises(ValueError, match="is not open"):
            graph.apply(StageStep(kind, inner.number))  # type: ignore[arg-type]
    for arc in (inner, last, first):
        graph.apply(StageStep("open", arc.number))
    end = Target("temperature", 1, "temperature")
    for arc, named in (
        (inner, "leads to a vertex without planes"),
        (last, "leaves a vertex without planes: it has no budget"),
    ):
        with pytest.raises(ValueError, match=named):
            graph.apply(StageStep("shrink", arc.number, target=end, sign=1))
    first.target.planes.append(Plane(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="while no cost is bounded"):
        graph.apply(StageStep("shrink", first.number, target=end, sign=1))
    assert graph.bound == -inf and not graph.shrunk


def test_both_parts_of_a_split_cover_the_cell(done: StageGraph, family: Instance) -> None:
    for value in (0.0, 0.3, 1.0):
        graph = StageGraph(family, 100.0)
        number = next(n for n, v in graph.vertices.items() if v not in (graph.start, graph.end))
        cell = graph.vertices[number].cell
        lo, hi = cell.energy
        into, out = len(graph.vertices[number].into), len(graph.vertices[number].out)
        graph.apply(StageStep("split", number, sign=0, value=min(lo + value * (hi - lo), hi)))
        first, second = [*graph.vertices.values()][-2:]
        assert (first.cell.energy[0], second.cell.energy[1]) == (lo, hi)
        assert first.cell.energy[1] == second.cell.energy[0]
        assert first.cell.temperature == second.cell.temperature == cell.temperature
        assert [(len(v.into), len(v.out)) for v in (first, second)] == [(into, out)] * 2


def test_both_parts_of_a_halved_arc_cover_its_box(done: StageGraph) -> None:
    graph = StageGraph(done.instance, done.closing)
    number = next(a.number for a in graph.start.out if a.target is not graph.end)
    graph.apply(StageStep("open", number))
    whole = graph.arcs[number]
    box = whole.box
    assert box is not None
    lo, hi = float(box.charge.lo[0]), float(box.charge.hi[0])
    graph.apply(StageStep("halve", number, target=CHARGE, value=0.3 * lo + 0.7 * hi))
    parts = [a for a in graph.start.out if a.target is whole.target]
    assert len(parts) == 2 and not whole.alive
    limits = []
    for part in parts:
        assert part.parent_box is not None and part.box is None
        charge = part.parent_box.charge
        limits += [(float(charge.lo[0]), float(charge.hi[0]))]
        assert part.parent_box.temperature is box.temperature
    assert whole.box is None  # what is left out takes no memory
    assert limits == [(lo, 0.3 * lo + 0.7 * hi), (0.3 * lo + 0.7 * hi, hi)]


@pytest.mark.parametrize("kind", ["split", "halve"])
@pytest.mark.parametrize("most", [1, 2, 3])
def test_an_interrupted_cut_loses_no_plan(
    family: Instance, monkeypatch: pytest.MonkeyPatch, kind: str, most: int
) -> None:
    graph = StageGraph(family, 100.0)
    arc = next(a for a in graph.start.out if a.target is not graph.end)
    graph.apply(StageStep("open", arc.number))
    assert arc.box is not None

    def pairs() -> set[tuple[int, int]]:
        return {(a.source.stop, a.target.stop) for a in graph.alive()}

    before, drop, count = pairs(), StageGraph._drop, [0]

    def interrupted(self: StageGraph, arc: Arc) -> None:
        drop(self, arc)
        count[0] += 1
        if count[0] == most:
            raise KeyboardInterrupt

    monkeypatch.setattr(StageGraph, "_drop", interrupted)
    middle = float(arc.box.charge.mid[0]), float(np.mean(arc.target.cell.energy))
    step = (
        StageStep("halve", arc.number, target=CHARGE, value=middle[0])
        if kind == "halve" else StageStep("split", arc.target.number, sign=0, value=middle[1])
    )  # fmt: skip
    try:
        graph.apply(step)
    except KeyboardInterrupt:
        assert count[0] == most
    assert count[0] and pairs() == before


def test_a_program_comes_back_on_the_box_that_it_was_built_on(done: StageGraph) -> None:
    """What was shrunk since is in the box, but not in the program until all is propagated."""
    arc = an_arc(done, lambda a: a.box is not None and a.box.charge.lo.size > 0)
    before = arc.box
    assert before is not None
    done._forget(arc)
    program = done.program(arc)
    charge = Interval(before.charge.lo.copy(), before.charge.hi - 0.5)
    arc.box = with_interval(before, "charge", charge)
    arc.program = None
    again = done.program(arc)
    assert again is not program and again.box is program.box is before
    arc.box = before


def test_ends_that_crossed_by_rounding_lose_no_state() -> None:
    assert _hull((0.0, 9.0), [(1.0, 2.0), (3.0, 4.0)]) == (1.0, 4.0)
    assert _hull((4.0 + 1e-9, 9.0), [(1.0, 4.0)]) == (4.0, 4.0 + 1e-9)


def test_a_steep_plane_is_not_kept(done: StageGraph) -> None:
    """Its value would be a small difference of large numbers."""
    arc = an_arc(done, lambda a: a.target is done.end and a.box is not None)
    assert arc.box is not None
    zero = np.zeros(done.program(arc).cone.b.size)
    count = len(arc.planes)
    done.apply(StageStep("cost", arc.number, zero, (1e14, 0.0)))
    done.apply(StageStep("plane", arc.source.number, slope=(1e14, 0.0)))
    assert len(arc.planes) == count
    assert all(abs(p.energy) < 1e9 for p in arc.source.planes)
    done.apply(StageStep("cost", arc.number, zero, (1.0, 0.0)))
    assert len(arc.planes) == count + 1
    del arc.planes[-1]
