"""The audit confirms what is proved, and no claim of a file that does not follow from it.

Damage to the proofs themselves: test_audit_damage.py; nodes made by hand: test_audit_tree.py.
"""

from __future__ import annotations

import dataclasses
import sys
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from audited import SIX, TWO, audit_apart, check, many_chargers, plan_of_six, plan_of_two
from trips import small_trip

from enumerate import Result, Status, audit, plan, save_proofs
from enumerate.audit import audit_evidence
from enumerate.evidence import Evidence
from enumerate.evidence_file import load_proofs, save_evidence
from enumerate.ledger import Outcome
from enumerate.table import counted
from relax import (
    Controls,
    InputError,
    Instance,
    Trajectory,
    load_trip,
    make_instance,
    simulate,
)

TRIP = SIX


@pytest.fixture(scope="module")
def result() -> Result:
    return plan_of_six()


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    """Evidence of two chargers: quick to audit."""
    path = tmp_path_factory.mktemp("proofs") / "two.proofs"
    save_proofs(path, TWO, plan_of_two())
    found = load_proofs(path)
    assert audit_evidence(found, TWO).holds
    return found


# ---------------------------------------------------------------------------- what is true


def test_what_the_search_proves_is_confirmed(file: Path, result: Result) -> None:
    seen: list[tuple[int, int]] = []
    found = audit(file, TRIP, lambda done, total: seen.append((done, total)))
    assert found.holds, found.failures
    assert found.lower_bound == pytest.approx(result.lower_bound, rel=1e-9)
    assert found.cost == pytest.approx(result.cost, rel=1e-9)
    assert found.gap == pytest.approx(result.gap, abs=1e-8)
    assert found.subsets == 64 and found.rows == len(result.ledger.rows)
    assert found.nodes == len(result.proofs) and seen[-1] == (found.nodes, found.nodes)
    assert found.programs == sum(s.kind != "propagate" for n in result.proofs for s in n.steps)
    kinds = {n.how.kind for n in result.proofs if n.how is not None}
    assert kinds >= {"count", "use"}, "the trip must show families being cut"
    text = str(found)
    assert "status  optimal; " in text
    steps = counted(make_instance(TRIP, ()).drive.n_steps, "driving step")
    assert f"grid of {steps}, {TRIP.grid.cells} cells per stop." in " ".join(text.split())
    assert "every claim holds" in text and max(len(line) for line in text.split("\n")) <= 100


def test_quick_bounds_of_single_subsets_are_confirmed(tmp_path: Path) -> None:
    trip = small_trip(start_soc=0.45)
    for name, options in {
        "quick": {},
        "all": {"prune": False},
        "late": {"time_limit_s": 0.0},
    }.items():
        result = plan(trip, keep_proofs=True, **options)  # type: ignore[arg-type]
        if result.proofs:
            save_proofs(tmp_path / name, trip, result)
            found = audit(tmp_path / name, trip)
            assert found.holds, (name, found.failures)
            assert found.lower_bound >= result.lower_bound * (1.0 - 1e-9)


def test_an_infeasible_trip_is_confirmed_infeasible(tmp_path: Path) -> None:
    trip = small_trip(start_soc=0.06)
    result = plan(trip, keep_proofs=True)
    assert result.status is Status.INFEASIBLE
    save_proofs(tmp_path / "none", trip, result)
    found = audit(tmp_path / "none", trip)
    assert found.holds and found.lower_bound == inf and found.cost == inf
    assert "there is no plan: proved" in str(found)


def test_an_infeasibility_that_takes_cuts_is_confirmed(tmp_path: Path) -> None:
    """Just beyond what can be had at the end: no root excludes it, parts of its box do."""
    trip = load_trip("paper-400km")
    trip = dataclasses.replace(trip, chargers=trip.chargers[1:2], end_soc_min=0.467)
    assert plan(trip).status is Status.UNKNOWN
    result = plan(trip, gap=0.05, keep_proofs=True)
    assert result.status is Status.INFEASIBLE and len(result.proofs) > 2
    save_proofs(tmp_path / "file", trip, result)
    found = audit(tmp_path / "file", trip)
    assert found.holds and found.lower_bound == inf


def test_no_solver_is_loaded(file: Path) -> None:
    _, loaded = audit_apart(file, "SIX")
    assert "relax.proof" in loaded
    assert not {m.split(".")[0] for m in loaded} & {"clarabel", "osqp", "cvxpy", "casadi"}
    suggests = {"relax.solve", "relax.tighten", "relax.refinement", "relax.starts", "relax.execute"}
    searches = {f"enumerate.{name}" for name in ("search", "tasks", "tree", "account")}
    assert not loaded & (suggests | searches)


# ---------------------------------------------------------------------------- what is false


def test_a_missing_root_leaves_its_row_unproved(two: Evidence) -> None:
    infeasible = {r.subset for r in two.rows if r.outcome is Outcome.INFEASIBLE}
    assert infeasible
    nodes = tuple(n for n in two.nodes if n.subset not in infeasible)
    holds, text = check(dataclasses.replace(two, nodes=nodes))
    assert not holds and "proved infeasible, it says" in text


def test_rows_must_account_for_every_subset_once(evidence: Evidence) -> None:
    for rows in (evidence.rows[1:], (*evidence.rows, evidence.rows[0])):
        stripped = dataclasses.replace(evidence, rows=rows, nodes=(), driven=None)
        found = audit_evidence(stripped, TRIP)
        assert "not for each of the 64 once" in found.failures[0]
        assert found.lower_bound == -inf
    family = next(r for r in evidence.rows if r.undecided and r.size > 1)
    rows = tuple(
        dataclasses.replace(r, undecided=r.undecided[1:]) if r is family else r
        for r in evidence.rows
    )
    holds, text = check(dataclasses.replace(evidence, rows=rows))
    assert not holds and "rows: " in text


@pytest.mark.parametrize("charger", [-1, 7, 2**53])
def test_a_row_of_a_charger_that_there_is_not_is_named(two: Evidence, charger: int) -> None:
    odd = dataclasses.replace(two.rows[0], subset=(charger,))
    holds, text = check(dataclasses.replace(two, rows=(odd, *two.rows[1:])))
    assert not holds and "rows: " in text


def test_rows_must_follow(two: Evidence) -> None:
    for row in two.rows:
        if row.outcome is Outcome.INFEASIBLE:
            continue
        higher = dataclasses.replace(row, lower_bound=row.lower_bound * 1.2 + 1.0)
        rows = tuple(higher if r is row else r for r in two.rows)
        holds, text = check(dataclasses.replace(two, rows=rows))
        assert not holds and f"row of the chargers {row.subset}: claims" in text
    rows = tuple(
        dataclasses.replace(r, outcome=Outcome.INFEASIBLE) if r.outcome is Outcome.BOUNDED else r
        for r in two.rows
    )
    holds, text = check(dataclasses.replace(two, rows=rows))
    assert not holds and "proved infeasible, it says" in text
    rows = tuple(
        dataclasses.replace(r, outcome=Outcome.BOUNDED) if r.outcome is Outcome.PLANNED else r
        for r in two.rows
    )
    assert check(dataclasses.replace(two, rows=rows))[0], "within the gap that was asked for"
    holds, text = check(dataclasses.replace(two, rows=rows, asked_gap=1e-4, status="feasible"))
    assert not holds and "cannot be better, it says; that is not proved" in text


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"bound": 0.02}, "bound: "),
        ({"cost": -0.02}, "cost: "),
        ({"gap": -0.5}, "gap: "),
        ({"transcribed": 0.01}, "on the grid"),
        ({"asked_gap": -0.5}, "status: optimal"),
    ],
)
def test_printed_numbers_must_follow(two: Evidence, changes: dict[str, float], named: str) -> None:
    ((key, share),) = changes.items()
    field = {"bound": "lower_bound"}.get(key, key)
    value = getattr(two, field) * (1.0 + share)
    holds, text = check(dataclasses.replace(two, **{field: value}))
    assert not holds and named in text


def test_the_plan_is_driven_again(two: Evidence) -> None:
    driven = two.driven
    assert driven is not None
    stop, *others = driven.controls.stops
    slower = dataclasses.replace(stop, power_kw=0.9 * np.minimum(stop.power_kw, 60.0))
    cold = dataclasses.replace(stop, cooling_kw=stop.cooling_kw - 1.0)
    still = dataclasses.replace(stop, power_kw=0.0 * np.minimum(stop.power_kw, 60.0))

    def told(new: Any) -> Any:
        controls = dataclasses.replace(driven.controls, stops=(new, *others))
        return dataclasses.replace(driven, controls=controls)

    less = tuple(0.97 * t for t in driven.targets_kwh)
    for changed, named in (
        (told(slower), "cost: "),
        (told(cold), "cooling_kw outside"),
        (told(still), "does not charge"),
        (told(dataclasses.replace(stop, energy_kwh=0.2)), "on the grid it breaks a limit"),
        (dataclasses.replace(driven, targets_kwh=less), "energy below the least"),
        (dataclasses.replace(driven, targets_kwh=tuple(inf for _ in less)), "does not charge"),
        (dataclasses.replace(driven, stops=(7, *driven.stops[1:])), "does not have"),
        (None, "cost: "),
    ):
        holds, text = check(dataclasses.replace(two, driven=changed))
        assert not holds and named in text, (named, text)


@pytest.mark.parametrize("status", ["optimal", "feasible", "infeasible", "unknown", "best"])
def test_a_status_needs_a_plan_or_none(two: Evidence, status: str) -> None:
    nothing = {"driven": None, "cost": inf, "transcribed": inf, "gap": inf}
    rows = tuple(
        r if r.outcome is Outcome.INFEASIBLE else dataclasses.replace(r, outcome=Outcome.UNPROVED)
        for r in two.rows
    )
    for changes, names in (({}, ("optimal", "feasible")), (nothing, ("unknown",))):
        claimed = dataclasses.replace(two, rows=rows, status=status, **changes)
        assert check(claimed)[0] == (status in names)
    closed = tuple(
        dataclasses.replace(r, outcome=Outcome.BOUNDED) if r.outcome is Outcome.UNPROVED else r
        for r in rows
    )
    without = dataclasses.replace(two, status="unknown", **nothing)
    holds, text = check(dataclasses.replace(without, rows=closed))
    assert not holds and "cannot be better, it says; that is not proved" in text
    holds, text = check(dataclasses.replace(without, rows=rows, transcribed=0.0))
    assert not holds and "it has a cost on the grid, but there is none" in text


def test_a_plan_below_what_is_proved_of_its_stops_is_named(
    two: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says that proof or model is wrong, so here the model is made to be."""

    def cheaper(instance: Instance, controls: Controls) -> Trajectory:
        found = simulate(instance, controls)
        return dataclasses.replace(found, cost=0.9 * found.cost)

    monkeypatch.setattr(sys.modules["enumerate.audit"], "simulate", cheaper)
    found = audit_evidence(dataclasses.replace(two, transcribed=0.9 * two.transcribed), TWO)
    assert any("but no plan with its stops costs less than" in text for text in found.failures)


def test_a_file_of_another_trip_is_refused(file: Path) -> None:
    pack = dataclasses.replace(TRIP.vehicle.pack, heat_capacity_kwh_per_k=0.0901)
    other = dataclasses.replace(TRIP, vehicle=dataclasses.replace(TRIP.vehicle, pack=pack))
    for trip in (other, many_chargers(5), dataclasses.replace(TRIP, time_value_per_h=30.1)):
        with pytest.raises(InputError, match="with the same numbers"):
            audit(file, trip)
    renamed = dataclasses.replace(TRIP, name="another name")
    assert audit(file, renamed).holds


def test_a_written_lie_is_found_in_the_file_too(two: Evidence, tmp_path: Path) -> None:
    save_evidence(tmp_path / "lie", dataclasses.replace(two, lower_bound=two.cost))
    found = audit(tmp_path / "lie", TWO)
    assert not found.holds and "FAILS   bound: " in str(found)
