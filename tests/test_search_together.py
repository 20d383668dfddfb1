"""Choices of two stops or more are bounded as one family where that closes them all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from enumerate import Outcome, Progress, Result, audit, explore, plan, road, save_proofs
from relax import load_trip
from relax.trip import Trip

WARM = load_trip("paper-400km", {"route.ambient_c": 10.0})  # best with one stop, by far
MILD = load_trip("paper-400km", {"route.ambient_c": 0.0})  # a second stop might pay


@pytest.fixture(scope="module")
def warm() -> Result:
    return plan(WARM, keep_proofs=True)


def families(result: Result) -> list[tuple[int, int]]:
    return [node.count for node in result.proofs if node.undecided]


def test_one_bound_closes_them_and_lies_below_each_of_theirs(warm: Result) -> None:
    full = {row.subset: row for row in plan(WARM, prune=False).ledger.rows}
    assert families(warm) == [(2, 3)]
    more = [row for row in warm.ledger.rows if len(row.subset) > 1]
    assert len({row.lower_bound for row in more if row.programs == 0}) == 1
    for row in more:
        assert row.outcome is Outcome.BOUNDED and row.lower_bound >= warm.transcribed_cost
        alone = full[row.subset]
        assert row.lower_bound <= alone.lower_bound * (1.0 + 1e-4)
        assert alone.lower_bound <= alone.cost
    assert warm.transcribed_cost == pytest.approx(min(row.cost for row in full.values()), rel=1e-4)


@pytest.mark.parametrize("gap", [None, 0.01, 0.002])
def test_the_audit_follows(gap: float | None, tmp_path: Path) -> None:
    result = plan(WARM, gap=gap, keep_proofs=True)
    assert families(result)
    save_proofs(tmp_path / "a.proofs", WARM, result)
    found = audit(tmp_path / "a.proofs", WARM)
    assert found.holds, found.failures
    assert found.lower_bound == pytest.approx(result.lower_bound, rel=1e-9)


@pytest.mark.parametrize("gap", [None, 0.002])
def test_the_bound_shown_is_that_of_all_choices(gap: float | None) -> None:
    shown: list[Progress] = []
    result = plan(WARM, gap=gap, progress=shown.append)
    bounds = [progress.lower_bound for progress in shown]
    assert max(bounds) <= result.lower_bound and bounds == sorted(bounds)


def test_where_a_pair_may_be_better_each_has_its_own_bound() -> None:
    result = plan(MILD, keep_proofs=True)
    more = [row for row in result.ledger.rows if len(row.subset) > 1]
    assert not families(result)
    assert len({row.lower_bound for row in more}) == 4
    assert min(row.lower_bound for row in more) < result.transcribed_cost


def test_far_from_its_own_bound_a_plan_asks_for_the_best_pair_first(
    warm: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(explore, "SURE", 0.0)
    result = plan(WARM, keep_proofs=True)
    assert families(result) == [(2, 3)]
    assert [row.subset for row in result.ledger.rows if row.programs and len(row.subset) > 1] == [
        (1, 2)  # both are better alone than charger 0
    ]
    assert result.cost == warm.cost and result.programs == warm.programs + 1


def test_a_pair_out_of_reach_asks_for_no_family() -> None:
    far = tuple(replace(c, detour_in_h=0.25, detour_out_h=0.25) for c in WARM.chargers)
    result = plan(replace(WARM, chargers=far, stop_time_h=1.0), keep_proofs=True)
    more = [row for row in result.ledger.rows if len(row.subset) > 1]
    assert all(row.outcome is Outcome.INFEASIBLE for row in more)
    assert not families(result) and len(result.plan.stops) == 1  # type: ignore[union-attr]


def test_a_family_that_does_not_close_leaves_only_its_cost(
    warm: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    examine = explore.examine_leaf
    monkeypatch.setattr(
        explore, "examine_leaf", lambda *a, **k: replace(examine(*a, **k), bound=0.0)
    )
    result = plan(WARM, keep_proofs=True)
    assert not families(result)
    assert result.cost == warm.cost and result.programs == warm.programs + 4
    assert all(row.programs == 1 for row in result.ledger.rows if len(row.subset) > 1)


def test_an_interrupt_within_the_family_loses_nothing(
    warm: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(explore, "examine_leaf", stop)
    result = plan(WARM, keep_proofs=True)
    assert result.interrupted == "interrupted" and result.ledger.counts()["total"] == 8
    assert result.cost == pytest.approx(warm.cost, rel=1e-3)
    assert result.lower_bound == -np.inf


def test_a_refused_plan_opens_what_the_family_closed(
    warm: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    execute, refused = road.execute, []

    def refuse(trip: Trip, instance: object, *rest: object) -> object:
        done = execute(trip, instance, *rest)  # type: ignore[arg-type]
        if not refused:
            refused.append(instance)
            return replace(done, reason="for the test")
        return done

    monkeypatch.setattr(road, "execute", refuse)
    result = plan(WARM, gap=0.01, keep_proofs=True)
    assert refused and result.plan is not None
    assert result.ledger.counts()["total"] == 8 and result.lower_bound <= result.cost
    planned = [row for row in result.ledger.rows if len(row.subset) > 1]
    assert any(row.outcome is Outcome.PLANNED for row in planned)
