"""The search over stages: its bound is below every plan whenever it stops, and it gets there."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from staged import KINDS, Planned, check, family_of, make_plans, plans_of, replay, trip_of

from benchmarks.random_trips import random_trip
from enumerate.search import plan
from enumerate.stage_graph import StageGraph
from enumerate.stage_search import StageSearch, make_penalty
from relax.instance import Instance
from relax.load import load_trip
from relax.trip import Trip


def search(
    family: Instance, closing: float, programs: int, plans: tuple[Planned, ...] = (), each: int = 10
) -> StageSearch:
    """Search until so many programs are solved, checking what is claimed now and then."""
    made = StageSearch(StageGraph(family, closing))
    made.prepare()
    check(made.graph, family, plans)
    for count in range(programs):
        if made.done or made.programs >= programs:
            break
        made.advance()
        if count % each == each - 1:
            check(made.graph, family, plans)
    check(made.graph, family, plans)
    return made


@pytest.mark.parametrize("kind", ["winter", "two at the end", "one step", "free"])
def test_planes_are_below_every_plan_whenever_it_stops(kind: str) -> None:
    """Closing lies just above the best plan: where boxes are shrunk and cut most."""
    plans = tuple(sorted(plans_of(kind), key=lambda p: p.cost)[:6])
    best = plans[0].cost
    done = search(family_of(trip_of(kind)), best + 0.01 + 0.002 * best, 60, plans, 12)
    assert -inf < done.graph.bound <= best + 1e-7


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_planes_are_below_every_plan_after_thousands_of_programs(kind: str) -> None:
    plans = plans_of(kind)
    best, most = min(p.cost for p in plans), max(p.cost for p in plans)
    for closing in (0.97 * best, best + 1e-3, 1.003 * best + 0.01, 1.2 * best + 0.1, most + 1.0):
        search(family_of(trip_of(kind)), closing, 1500, plans, 25)


@pytest.mark.parametrize("kind", ["winter", "ends", "limits"])
def test_what_is_below_the_optimum_is_reached_and_what_is_above_is_not(kind: str) -> None:
    family = family_of(trip_of(kind))
    best = min(p.cost for p in plans_of(kind))
    low = search(family, 0.95 * best, 400)
    assert low.graph.bound >= low.graph.closing
    assert low.graph.lower_bound <= best
    if low.graph.shrunk:
        assert low.graph.lower_bound == low.graph.closing
    high = search(family, 1.05 * best, 30)
    assert high.graph.bound < high.graph.closing
    assert high.graph.bound <= best + 1e-7


def test_the_same_trip_gives_the_same_steps_and_a_replay_the_same_bound() -> None:
    family = family_of(trip_of("two at the end"))
    best = min(p.cost for p in plans_of("two at the end"))
    one, two = (search(family, 0.98 * best, 100) for _ in range(2))
    assert len(one.graph.steps) == len(two.graph.steps)
    for a, b in zip(one.graph.steps, two.graph.steps, strict=True):
        assert (a.kind, a.at, a.slope, a.value) == (b.kind, b.at, b.slope, b.value)
        assert np.array_equal(a.dual, b.dual)
    assert {s.kind for s in one.graph.steps} >= {"shrink", "propagate", "plane", "cost"}
    again = replay(one.graph)
    assert again.bound == pytest.approx(one.graph.bound, rel=1e-9)
    assert again.lower_bound == pytest.approx(one.graph.lower_bound, rel=1e-9)
    assert [v.cell for v in again.vertices.values()] == [
        v.cell for v in one.graph.vertices.values()
    ]


def against_brute_force(trip: Trip, programs: int, shares: tuple[float, ...]) -> float | None:
    """Compare with the best plan of all subsets; returns its cost, None if there is none."""
    trip = replace(trip, stop_time_h=inf)
    best = plan(trip, prune=False)
    family = family_of(trip)
    cost = best.transcribed_cost if best.plan is not None else None
    at = 10.0 if cost is None else cost
    for share in shares:
        closing = at + (share - 1.0) * max(abs(at), 0.1)
        done = search(family, closing, programs)
        if cost is not None:
            spare = 1e-6 * (1.0 + abs(cost))
            assert done.graph.lower_bound <= cost + spare, (trip.name, share)
            if share > 1.0:
                assert done.graph.bound <= cost + spare, (trip.name, share)
    return cost


def test_the_bound_is_below_the_best_of_all_subsets_of_random_trips() -> None:
    shares = (0.9, 1.0001, 1.02, 1.3)
    found = 0
    for k, seed in enumerate(range(30)):
        trip = random_trip(seed)
        if len(trip.chargers) < 3:
            found += against_brute_force(trip, 12, shares[k % 4 :][:1]) is not None
    assert found >= 8  # the others have no plan


@pytest.mark.long
def test_the_bound_is_below_the_best_of_all_subsets_of_two_hundred_trips() -> None:
    found = 0
    for seed in range(1000, 1200):
        trip = random_trip(seed)
        if len(trip.chargers) <= 4:
            cost = against_brute_force(trip, 250, (0.95, 1.0001, 1.01, 1.3))
            found += cost is not None
    assert found > 80


@pytest.mark.long
def test_planes_are_below_every_plan_of_random_trips() -> None:
    seen = 0
    for seed in range(2000, 2060):
        trip = replace(random_trip(seed), stop_time_h=inf)
        if len(trip.chargers) > 4:
            continue
        plans = tuple(make_plans(trip, seed, each=5))
        if plans:
            best = min(p.cost for p in plans)
            for share in (0.9, 1.0001, 1.02, 1.3):
                closing = best + (share - 1.0) * max(abs(best), 0.1)
                search(family_of(trip), closing, 300, plans)
                seen += 1
    assert seen > 60


@pytest.mark.long
@pytest.mark.parametrize("name", ["paper-400km", "goteborg-stockholm-winter"])
def test_planes_are_below_every_plan_of_a_shipped_trip(name: str) -> None:
    trip = load_trip(name)
    plans = tuple(make_plans(trip, 1, each=3, sizes=(1, 2)))
    best = min(p.cost for p in plans)
    for closing in (0.99 * best, 1.01 * best, 1.2 * best):
        search(family_of(trip), closing, 600, plans, 20)


def test_no_time_leaves_what_is_known() -> None:
    family = family_of(trip_of("winter"))
    late = StageSearch(StageGraph(family, 10.0), deadline=0.0)
    assert late.late and late.done
    late.prepare()
    late.advance()
    assert late.programs == 0 and late.graph.bound == -inf


def test_leaving_the_asked_start_costs_more_than_a_charge() -> None:
    for kind in KINDS:
        family = family_of(trip_of(kind))
        penalty = make_penalty(family)
        assert penalty.energy > max(stop.price_per_kwh for stop in family.stops)
        assert penalty.temperature > 0.0


def test_a_step_that_proves_nothing_is_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time may be up within a step, before there is any bound: a share all the same."""
    made = StageSearch(StageGraph(family_of(trip_of("winter")), 10.0))
    monkeypatch.setattr(made, "prepare", lambda: None)
    monkeypatch.setattr(made, "advance", lambda: None)
    assert made.graph.bound == -inf
    assert next(made.run()) == 0.0
