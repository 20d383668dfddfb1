"""The graph of stages: after any steps in any order, what it claims is true of every trajectory."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from staged import KINDS, check, cut, family_of, legs_of, plans_of, replay, trip_of

from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import Arc, StageStep, Vertex
from enumerate.stage_search import StageSearch
from relax.bound import relax_subset
from relax.branch import Target
from relax.solve import ConeSolver, SolveSettings, SolveStatus, solve_objective
from relax.stage_program import Penalty

SETTINGS = SolveSettings(tolerance=1e-5)
PENALTY = Penalty(5.0, 1.0)


class Walk:
    """Random steps: what no policy would do must be as true as what one does."""

    def __init__(self, kind: str, closing: float, seed: int) -> None:
        self.graph = StageGraph(family_of(trip_of(kind)), closing)
        self.rng = np.random.default_rng(seed)
        self.count = 0

    def prepare(self) -> None:
        """Open everything, and give every vertex a plane."""
        graph = self.graph
        for vertex in sorted(graph.vertices.values(), key=lambda v: -v.stop):
            for arc in vertex.out[:]:
                if arc.target is graph.end or arc.target.planes:
                    graph.apply(StageStep("open", arc.number))
                self.bound(arc, slope=(0.0, 0.0), wrong=0.0)
            if vertex is not graph.end:
                graph.apply(StageStep("plane", vertex.number))

    def bound(
        self, arc: Arc, slope: tuple[float, float] | None = None, wrong: float = 0.15
    ) -> None:
        """Bound an arc where it is asked or with a slope; at times with a wrong dual vector."""
        graph, rng = self.graph, self.rng
        if not arc.alive or arc.box is None or not arc.target.planes:
            return
        program = graph.program(arc)
        if slope is None:
            q = program.ask_start(self.state(arc.source), PENALTY)
        else:
            q = program.ask_slope(slope)
        found = solve_objective(ConeSolver(program.cone, SETTINGS), q, changed=True)
        z = found.z
        if rng.random() < wrong:
            z = rng.permutation(z) if rng.random() < 0.5 else -z
        if found.status is SolveStatus.INFEASIBLE:
            graph.apply(StageStep("empty", arc.number, z, ray=True))
            return
        graph.apply(StageStep("cost", arc.number, z, slope or program.slope_at(found.z)))

    def shrink(self, arc: Arc) -> None:
        """Bound a quantity of an arc within the budget."""
        graph, rng = self.graph, self.rng
        graph.apply(StageStep("open", arc.number))
        if not arc.alive:
            return
        starts = arc.source is not graph.start and not arc.source.planes
        if arc.box is None or starts or not arc.target.planes or not -inf < graph.bound < inf:
            return
        targets = [Target("temperature", arc.box.power.lo.size, "temperature")]
        if arc.box.optional.size:
            cells = arc.box.dwell.lo.shape[1]
            targets += [
                Target("charge", 0, "charge"), Target("stay", 0, "dwell"),
                Target("stop_temperature", (0, cells), "border"),
            ]  # fmt: skip
        target, sign = targets[rng.integers(len(targets))], int(rng.choice([-1, 1]))
        state = self.state(arc.source)
        program = graph.program(arc)
        q = program.ask_quantity(target, sign, graph.budget(arc, state))
        found = solve_objective(ConeSolver(program.cone, SETTINGS), q, changed=True)
        ray = found.status is SolveStatus.INFEASIBLE
        graph.apply(
            StageStep("shrink", arc.number, found.z, state=state, target=target, sign=sign, ray=ray)
        )
        if rng.random() < 0.6 and arc.alive:
            graph.apply(StageStep("propagate", arc.number))

    def state(self, vertex: Vertex) -> tuple[float, float]:
        """A state in a vertex's cell."""
        cell = vertex.cell
        return float(self.rng.uniform(*cell.energy)), float(self.rng.uniform(*cell.temperature))

    def advance(self) -> None:
        """Do one random step, or a few that belong together."""
        graph, rng = self.graph, self.rng
        arcs = list(graph.alive())
        inner = [v for v in graph.vertices.values() if v not in (graph.start, graph.end)]
        if not arcs or not inner:
            return
        arc, vertex = arcs[rng.integers(len(arcs))], inner[rng.integers(len(inner))]
        self.count += 1
        draw = 0.618034 * self.count % 1.0  # every kind has its turn
        if draw >= 0.92:
            arc = next((a for a in arcs if a.box is not None and a.box.optional.size), arc)
        if draw < 0.5:
            graph.apply(StageStep("open", arc.number))
            self.bound(arc, None if rng.random() < 0.7 else tuple(rng.normal(0.0, (0.5, 0.05))))
        elif draw < 0.65:
            slopes = [(p.energy, p.temperature) for a in vertex.out for p in a.planes]
            slope = slopes[rng.integers(len(slopes))] if slopes else (0.0, 0.0)
            graph.apply(StageStep("plane", vertex.number, slope=slope))
        elif draw < 0.8:
            self.shrink(arc)
        elif draw < 0.86:
            axis = int(rng.integers(2))
            limits = vertex.cell.energy if axis == 0 else vertex.cell.temperature
            value = float(rng.uniform(*limits))
            graph.apply(StageStep("split", vertex.number, sign=axis, value=value))
        elif draw < 0.92:
            graph.apply(StageStep("narrow", vertex.number))
        elif arc.box is not None and arc.box.optional.size:
            interval = arc.box.charge
            value = float(rng.uniform(interval.lo[0], interval.hi[0]))
            target = Target("charge", 0, "charge")
            graph.apply(StageStep("halve", arc.number, target=target, value=value))


@pytest.mark.parametrize("kind", KINDS)
def test_random_steps_claim_nothing_that_is_false(kind: str) -> None:
    plans = sorted(plans_of(kind), key=lambda p: p.cost)
    best, most = plans[0].cost, plans[-1].cost
    share = (0.01, 0.5, 1.1)[KINDS.index(kind) % 3]
    walk = Walk(kind, best + share * (most - best), KINDS.index(kind))
    walk.prepare()
    seen = 0
    for index in range(40):
        walk.advance()
        if index % 20 == 19:
            seen += check(walk.graph, walk.graph.instance, plans[::3])
    kinds = {step.kind for step in walk.graph.steps}
    assert kinds >= {"open", "cost", "plane", "shrink", "split", "halve", "narrow"}, kinds
    assert replay(walk.graph).bound == pytest.approx(walk.graph.bound, rel=1e-9)
    assert seen > 1


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_many_random_steps_claim_nothing_that_is_false(kind: str) -> None:
    plans = plans_of(kind)
    best, most = min(p.cost for p in plans), max(p.cost for p in plans)
    for seed in range(8):
        closing = float(np.random.default_rng(seed).uniform(best, most + 1.0))
        walk = Walk(kind, closing, 100 + seed)
        walk.prepare()
        for index in range(600):
            walk.advance()
            if index % 100 == 99:
                check(walk.graph, walk.graph.instance, plans)
        assert replay(walk.graph).bound == pytest.approx(walk.graph.bound, rel=1e-9)


def opened(kind: str, closing: float) -> StageGraph:
    walk = Walk(kind, closing, 0)
    walk.prepare()
    return walk.graph


def test_a_plan_is_bounded_before_anything_is_cut() -> None:
    """The planes of the first pass bound every plan, whatever closing is: nothing is left out."""
    for kind in KINDS:
        plans = plans_of(kind)
        best = min(p.cost for p in plans)
        graph = opened(kind, 0.1 * best)
        assert not graph.shrunk and -inf < graph.bound <= best + 1e-9
        assert graph.lower_bound == graph.bound


@pytest.mark.parametrize("kind", ["ends", "two at the end", "one step"])
def test_a_charger_at_the_destination_does_not_waive_the_energy_there(kind: str) -> None:
    """Stages that end the trip end it with enough, also those without a step."""
    graph = opened(kind, 1e3)
    least = graph.instance.end_energy_min_kwh
    assert {arc.source.stop for arc in graph.end.into} >= {1, 2}
    for arc in graph.end.into:
        assert arc.box is not None and arc.box.energy.lo[-1] >= least - 1e-6


def test_a_closing_cost_falls_but_never_rises() -> None:
    """What holds of all plans below the higher one holds of fewer; the bound keeps to the lower."""
    plans = sorted(plans_of("winter"), key=lambda p: p.cost)
    walk = Walk("winter", plans[-1].cost, 6)
    walk.prepare()
    for planned in (plans[len(plans) // 2], plans[1], plans[0]):
        for _ in range(15):
            walk.advance()
        walk.graph.apply(StageStep("closing", value=planned.cost))
        check(walk.graph, walk.graph.instance, plans)
    for higher in (plans[1].cost, inf, np.nan):
        with pytest.raises(ValueError, match="only fall"):
            walk.graph.apply(StageStep("closing", value=float(higher)))
    assert walk.graph.shrunk and walk.graph.lower_bound <= plans[0].cost
    assert replay(walk.graph).bound == pytest.approx(walk.graph.bound, rel=1e-9)


def test_leaving_plans_out_limits_the_bound_to_closing() -> None:
    """Below closing there is no plan: no stage from the start is left; no more is proved."""
    first = opened("winter", 1e3)
    walk = Walk("winter", 0.5 * first.bound, 1)
    for step in first.steps:
        walk.graph.apply(step)
    graph = walk.graph
    assert not graph.shrunk and graph.lower_bound == graph.bound == first.bound
    for arc in graph.start.out[:]:
        assert arc.box is not None
        target = Target("temperature", arc.box.power.lo.size, "temperature")
        program = graph.program(arc)
        q = program.ask_quantity(target, -1, graph.budget(arc, graph.origin))
        found = solve_objective(ConeSolver(program.cone, SETTINGS), q, changed=True)
        assert found.status is SolveStatus.INFEASIBLE
        graph.apply(StageStep("shrink", arc.number, found.z, target=target, sign=-1, ray=True))
    assert graph.shrunk and graph.bound == inf
    assert graph.lower_bound == graph.closing < min(p.cost for p in plans_of("winter"))


def test_splits_and_halves_lose_no_plan_and_keep_every_bound() -> None:
    for kind in ("winter", "two at the end", "one step"):
        plans = plans_of(kind)
        walk = Walk(kind, max(p.cost for p in plans) + 1.0, 2)
        walk.prepare()
        graph, before = walk.graph, walk.graph.bound
        for _ in range(12):
            inner = [v for v in graph.vertices.values() if v not in (graph.start, graph.end)]
            vertex = inner[walk.rng.integers(len(inner))]
            lo, hi = vertex.cell.energy
            graph.apply(StageStep("split", vertex.number, sign=0, value=0.5 * (lo + hi)))
        assert graph.bound == before
        for arc in list(graph.alive()):
            graph.apply(StageStep("open", arc.number))
            if arc.alive and arc.box is not None and arc.box.optional.size:
                target = Target("stay", 0, "dwell")
                value = float(arc.box.stay.mid[0])
                graph.apply(StageStep("halve", arc.number, target=target, value=value))
        assert graph.bound >= before
        for planned in plans:
            assert legs_of(graph, cut(graph.instance, planned)) is not None, (kind, planned.subset)


def test_the_budget_of_an_arc_covers_what_every_plan_still_costs() -> None:
    """Reduced costs, where they are sharp: closing is the plan's own cost, planes are high."""
    nearest = inf
    for kind in ("winter", "same node", "limits"):
        plans = plans_of(kind)
        search = StageSearch(StageGraph(family_of(trip_of(kind)), 2.0 * max(p.cost for p in plans)))
        search.prepare()
        while search.programs < 90:
            search.advance()
        graph, rng = search.graph, np.random.default_rng(9)
        assert not graph.shrunk
        for planned in plans:
            graph.closing = planned.cost + 1e-9  # enters nothing but the budgets
            pieces = cut(graph.instance, planned)
            legs = legs_of(graph, pieces)
            assert legs is not None
            remaining = planned.cost
            for (vertex, arc), piece in zip(legs, pieces, strict=True):
                for _ in range(4):
                    asked = rng.uniform(*vertex.cell.energy), rng.uniform(*vertex.cell.temperature)
                    spare = graph.budget(arc, asked).at(piece.start) - remaining
                    assert spare >= -1e-7, (kind, planned.subset, piece.first)
                if vertex is not graph.start:
                    own = graph.budget(arc, piece.start).at(piece.start) - remaining
                    nearest = min(nearest, own / (graph.closing - graph.bound))
                remaining -= piece.cost
    assert nearest < 0.5  # of the slack, some stage of some plan uses half


def test_planes_of_a_vertex_stay_below_those_of_its_arcs() -> None:
    walk = Walk("limits", 1e3, 4)
    walk.prepare()
    for _ in range(80):
        walk.advance()
    for vertex in walk.graph.vertices.values():
        if not vertex.out:
            continue
        for _ in range(20):
            state = walk.state(vertex)
            for plane in vertex.planes:
                for arc in vertex.out:
                    box = arc.box
                    if box is not None and not (
                        box.energy.lo[0] <= state[0] <= box.energy.hi[0]
                        and box.temperature.lo[0] <= state[1] <= box.temperature.hi[0]
                    ):
                        continue
                    assert plane.at(state) <= arc.value(state) + 1e-7


def test_no_plan_at_all_is_a_bound_of_infinity() -> None:
    hopeless = family_of(replace(trip_of("winter"), start_soc=0.07, end_soc_min=0.3))
    assert relax_subset(hopeless).infeasible
    graph = StageGraph(hopeless, 100.0)
    walk = Walk("winter", 100.0, 5)
    walk.graph = graph
    walk.prepare()
    assert graph.bound == graph.lower_bound == inf
