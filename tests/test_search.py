"""The search gives one answer, whoever computes it, and keeps what it knows when it is stopped."""

from __future__ import annotations

import math
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise
from math import inf

import pytest
from trips import small_trip

from benchmarks.cases import select
from benchmarks.random_trips import random_trip
from enumerate import Outcome, Progress, Result, Status, plan, road
from enumerate.ledger import Row
from enumerate.show import format_result
from enumerate.tasks import Node, Setting, refine_from, refine_node, relax_node
from relax import load_trip, make_drive, make_instance, refine
from relax.refinement import RefineSettings
from relax.starts import even_start
from relax.trip import Grid, Trip

PAPER = load_trip("paper-400km", {"route.ambient_c": 10.0})


@pytest.fixture(scope="module")
def serial() -> Result:
    return plan(PAPER)


def same(a: Result, b: Result) -> None:
    assert a.cost == b.cost and a.lower_bound == b.lower_bound
    assert [s.charger for s in a.plan.stops] == [s.charger for s in b.plan.stops]  # type: ignore[union-attr]
    rows = [[(r.subset, r.outcome, r.cost, r.lower_bound) for r in x.ledger.rows] for x in (a, b)]
    assert rows[0] == rows[1]


def test_threads_and_processes_give_the_serial_result(serial: Result) -> None:
    same(plan(PAPER, workers=2), serial)
    with ProcessPoolExecutor(2) as pool:
        same(plan(PAPER, executor=pool), serial)


def test_every_subset_is_accounted_for_and_the_best_plan_is_the_least(serial: Result) -> None:
    full = plan(PAPER, prune=False)
    assert full.ledger.counts()["bounded"] == 0
    assert sum(v for k, v in serial.ledger.counts().items() if k != "total") == 8
    best = min(row.cost for row in full.ledger.rows)
    assert full.transcribed_cost == best
    assert serial.transcribed_cost == pytest.approx(best, rel=1e-4)
    for row, same_row in zip(full.ledger.rows, serial.ledger.rows, strict=True):
        assert row.subset == same_row.subset
        if same_row.outcome is Outcome.BOUNDED:
            assert same_row.lower_bound <= row.cost * (1.0 + 1e-9)
        if row.outcome is Outcome.PLANNED:
            assert row.lower_bound <= row.cost * (1.0 + 1e-9)


def test_the_reported_cost_is_the_replayed_one(serial: Result) -> None:
    assert serial.replay is not None and serial.plan is not None
    assert serial.cost == serial.replay.cost
    assert serial.cost == pytest.approx(sum(s.cost for s in serial.plan.stops), rel=1e-12)
    assert serial.replay.feasible
    assert serial.lower_bound <= serial.cost


def test_the_order_of_the_chargers_changes_nothing(serial: Result) -> None:
    shuffled = replace(PAPER, chargers=PAPER.chargers[::-1])
    other = plan(shuffled)
    assert other.cost == pytest.approx(serial.cost, rel=1e-5)
    assert [s.charger for s in other.plan.stops] == [s.charger for s in serial.plan.stops]  # type: ignore[union-attr]


def test_one_more_charger_is_never_worse(serial: Result) -> None:
    spec = PAPER.chargers[2]
    more = replace(spec, name="extra", position_km=352.0)
    assert plan(replace(PAPER, chargers=(*PAPER.chargers, more))).cost <= serial.cost * (1 + 1e-4)


def test_a_larger_heat_pump_is_never_worse() -> None:
    costs = [plan(load_trip("paper-400km", {"vehicle.heat_pump_kw": p})).cost for p in (0, 1, 3)]
    assert costs[0] >= costs[1] * (1 - 1e-4) >= costs[2] * (1 - 2e-4)


def test_an_asked_gap_is_proved() -> None:
    result = plan(PAPER, gap=0.002)
    assert result.status is Status.OPTIMAL
    assert result.gap <= 0.002 * (1 + 1e-9)
    assert result.lower_bound <= result.transcribed_cost


def test_a_gap_below_the_error_of_the_grid_is_not_called_proved() -> None:
    """Three cells for a charge are 0.4 % off: more than a gap of 0.3 % can say of the drive."""
    name, chosen = "goteborg-stockholm-winter", slice(4, 5)
    coarse = load_trip(name, {"grid.cells": 3})
    result = plan(replace(coarse, chargers=coarse.chargers[chosen]), gap=0.003)
    apart = abs(result.cost - result.transcribed_cost) / result.cost
    assert result.gap <= 0.003 * (1 + 1e-9) and apart > 0.003
    assert result.status is Status.FEASIBLE
    assert "finer grid" in " ".join(format_result(result).split())
    fine = load_trip(name)
    assert plan(replace(fine, chargers=fine.chargers[chosen]), gap=0.003).status is Status.OPTIMAL


def test_a_plan_that_repairs_made_dearer_than_the_grid_says_why_it_is_not_proved() -> None:
    """The cheapest plan on a coarse grid passes a limit between its nodes; mended it costs more."""
    result = plan(random_trip(2), gap=0.01)
    cheapest = min(row.cost for row in result.ledger.rows)
    assert result.status is Status.FEASIBLE and cheapest < 0.995 * result.transcribed_cost
    text = " ".join(format_result(result).split())
    assert "the proof on the grid is complete" in text
    apart = 100.0 * (1.0 - cheapest / result.cost)
    assert f"differ by {apart:.2f} %: a finer grid brings them nearer" in text


def test_a_gap_that_the_grid_puts_out_of_reach_is_not_chased() -> None:
    """The drive costs 1.01 % more than the grid says: no bound comes within 1 % of it."""
    (case,) = select(["random/05"])
    result = plan(case.load(), gap=0.01, time_limit_s=60.0)
    assert result.status is Status.FEASIBLE and not result.interrupted
    assert result.cost > 1.01 * result.transcribed_cost
    assert result.lower_bound >= (1.0 - 0.0100001) * result.transcribed_cost
    text = " ".join(format_result(result).split())
    assert "a finer grid brings them nearer (--set grid.step_km=2 --set grid.cells=24)" in text
    fine = plan(case.load(), gap=0.01, time_limit_s=60.0, grid=Grid(2.0, 24))
    assert fine.status is Status.OPTIMAL


def test_with_a_gap_asked_for_the_search_goes_on_without_a_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is left of boxes after cutting tells where to start, if other starts lead nowhere."""
    tasks = sys.modules["enumerate.tasks"]
    calls, lead_nowhere = 0, 10**9

    def spoil(honest):  # type: ignore[no-untyped-def]
        def spoilt(*given):  # type: ignore[no-untyped-def]
            nonlocal calls
            calls += 1
            found = honest(*given)
            return replace(found, feasible=found.feasible and calls > lead_nowhere)

        return spoilt

    for name in ("refine", "refine_best"):
        monkeypatch.setattr(tasks, name, spoil(getattr(tasks, name)))
    assert plan(small_trip()).status is Status.UNKNOWN
    calls, lead_nowhere = 0, calls
    found = plan(small_trip(), gap=0.05)
    assert found.status is Status.OPTIMAL and found.gap <= 0.05 * (1 + 1e-9)
    assert calls > lead_nowhere and found.ledger.counts()["total"] == 4


def test_no_time_at_all_still_gives_a_valid_answer() -> None:
    result = plan(PAPER, time_limit_s=0.0)
    assert result.interrupted == "time limit reached"
    assert result.ledger.counts()["total"] == 8
    assert result.status in (Status.UNKNOWN, Status.FEASIBLE)
    assert result.lower_bound <= plan(PAPER).cost


def test_ctrl_c_keeps_what_is_known() -> None:
    calls: list[Progress] = []

    def stop(step: Progress) -> None:
        calls.append(step)
        if math.isfinite(step.cost):
            raise KeyboardInterrupt

    result = plan(PAPER, progress=stop)
    assert result.interrupted == "interrupted"
    assert result.plan is not None and result.replay is not None and result.replay.feasible
    assert result.lower_bound <= result.cost


def test_progress_never_loses_a_plan() -> None:
    costs: list[float] = []
    plan(PAPER, progress=lambda step: costs.append(step.cost))
    assert costs == sorted(costs, reverse=True) and math.isfinite(costs[-1])


def infeasible(trip: Trip) -> Result:
    result = plan(trip)
    assert result.status is Status.INFEASIBLE and result.plan is None
    assert result.ledger.counts()["infeasible"] == result.ledger.counts()["total"]
    assert result.diagnosis is not None
    return result


def test_a_trip_out_of_reach_says_how_far_the_car_gets() -> None:
    trip = small_trip()
    found = infeasible(replace(trip, chargers=(), start_soc=0.25)).diagnosis
    assert found is not None
    assert 0.0 < found.reach_km < trip.route.length_km
    assert found.missing_kwh > 0.0
    assert any(remedy.startswith("a charger between") or "start.soc" in remedy
               for remedy in found.remedies)  # fmt: skip


def test_the_remedy_that_is_named_helps() -> None:
    trip = replace(small_trip(), chargers=(), start_soc=0.25)
    found = infeasible(trip).diagnosis
    assert found is not None
    wanted = [float(r.rsplit(" ", 1)[1]) for r in found.remedies if r.startswith("start.soc")]
    assert wanted
    assert plan(replace(trip, start_soc=min(wanted[0] + 0.02, 1.0))).plan is not None


def test_a_start_above_the_largest_charge_is_legal() -> None:
    """Charged full at home, at most 80 % on the way."""
    trip = replace(small_trip(), soc_max=0.8, start_soc=0.9)
    result = plan(trip)
    assert result.plan is not None
    assert all(stop.depart_soc <= 0.8 + 1e-6 for stop in result.plan.stops)


@pytest.mark.parametrize("pump_kw", [0.0, 2.0])
def test_without_a_stop_nothing_is_heated_for_nothing(pump_kw: float) -> None:
    """Whatever the car does costs nothing then; the heat pump saves energy all the same."""
    trip = replace(small_trip(vehicle__heat_pump_kw=pump_kw), chargers=(), start_soc=0.9)
    result = plan(trip, gap=0.01)
    assert result.status is Status.OPTIMAL and result.replay is not None
    used = result.replay.totals_kwh
    assert used["battery_heater"] == 0.0 and used["battery_cooling"] == 0.0
    assert (used["heat_pump"] > 0.0) == (pump_kw > 0.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"gap": 0.0},
        {"gap": -1.0},
        {"gap": math.nan},
        {"time_limit_s": -1.0},
        {"time_limit_s": math.nan},
        {"workers": 0},
    ],
)
def test_settings_of_no_sense_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(changes))} must "):
        plan(PAPER, **changes)


def test_too_many_chargers_are_refused_at_once() -> None:
    chargers = tuple(replace(PAPER.chargers[0], name=f"c{i}") for i in range(65))
    with pytest.raises(ValueError, match="at most 64 chargers"):
        plan(replace(PAPER, chargers=chargers))


def test_a_refused_plan_reopens_what_was_closed_against_it(
    serial: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The best subset's plan does not hold: the next best counts, though its bound was above."""
    full = plan(PAPER, prune=False)
    assert serial.plan is not None
    best = min(full.ledger.rows, key=lambda r: r.cost)
    others = sorted(r.cost for r in full.ledger.rows if r.subset != best.subset)
    honest = road.execute

    def refuse(trip, instance, *rest):  # type: ignore[no-untyped-def]
        done = honest(trip, instance, *rest)
        return replace(done, reason="made up") if instance.subset == best.subset else done

    monkeypatch.setattr(road, "execute", refuse)
    result = plan(PAPER)
    assert result.transcribed_cost <= others[0] * (1.0 + 3e-3)
    row = next(r for r in result.ledger.rows if r.subset == best.subset)
    assert row.outcome is Outcome.UNPROVED and "made up" in row.reason
    assert result.lower_bound <= best.cost


def test_a_refused_plan_is_planned_again_only_by_another(serial: Result) -> None:
    """Else a subset whose plan was refused would end as planned, without a plan to show."""
    trip = PAPER
    setting = Setting(trip, make_drive(trip, 4.0), trip.grid, RefineSettings())
    node = refine_node(setting, relax_node(setting, Node(Row((1,), Outcome.UNPROVED))))
    assert node.row.outcome is Outcome.PLANNED and node.refined is not None
    refused = replace(node, row=replace(node.row, outcome=Outcome.UNPROVED, cost=inf, reason="no"))
    assert refine_from(setting, refused, []).row is refused.row
    other = refine_from(setting, refused, [even_start(setting.instance((1,)))])
    assert other.row.outcome is Outcome.PLANNED and other.refined is not node.refined


def test_refinements_end_at_the_deadline() -> None:
    instance = make_instance(PAPER, (1,))
    start = even_start(instance)
    done = refine(instance, start, RefineSettings(deadline=time.perf_counter()))
    assert done.programs == 0


def test_the_bound_shown_never_falls_and_never_exceeds_what_is_proved() -> None:
    """Leaves that are being examined count until they are entered."""
    shown: list[float] = []
    trip = load_trip("goteborg-stockholm-summer")
    result = plan(trip, gap=0.01, progress=lambda p: shown.append(p.lower_bound))
    assert len(shown) > 10
    assert max(shown) <= result.lower_bound * (1.0 + 1e-9)
    assert all(later >= earlier - 1e-9 for earlier, later in pairwise(shown))
