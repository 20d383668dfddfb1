"""A slice of the validity campaign: on random trips no claim contradicts a plan, and the audit
that says so notices planted faults."""

from __future__ import annotations

import csv
import doctest
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import adversaries, random_trips, rivals, stage_claims, validity
from benchmarks.adversaries import audit_trip
from benchmarks.contradiction import Audit, Effort
from benchmarks.random_trips import describe, random_trip
from benchmarks.rivals import attacked
from benchmarks.validity import CHECKS, main
from enumerate.stage_graph import StageGraph
from relax import make_instance
from relax.box import Box
from relax.certify import LowerBound
from relax.instance import Instance, make_drive
from relax.intervals import Interval
from relax.load import shipped_vehicles
from relax.reach import make_box
from relax.stage_program import StageProgram

SLICE = (6, 8, 14, 34, 43)
"""Seeds of trips that have plans; together they see every check in a few seconds."""
LONG_SLICE = (*range(100, 160), 1779)
"""The last has families of subsets in its ledger."""
SMALL = Effort(subsets=2, starts=1, drives=3, plan_s=2.0, prove_s=0.5, closings=1, advances=6)
FAULTY = 34
"""A seed with plans, on which faults are planted."""


def facts(audit: Audit) -> list[str]:
    return [f"{f.kind} {f.subset}: {f.detail}" for f in audit.findings]


def audit_all(seeds: Any, effort: Effort) -> Counter[str]:
    total: Counter[str] = Counter()
    for seed in seeds:
        audit = audit_trip(seed, effort)
        assert facts(audit) == [], f"python -m benchmarks.validity --seed {seed}"
        total.update(audit.counts)
    return total


def test_no_claim_contradicts_a_plan() -> None:
    total = audit_all(SLICE, SMALL)
    for check in CHECKS:
        if check not in ("driven_below_bound", "closed", "stage_closed"):
            assert total[check] > 0, f"the slice never sees {check}"
    assert total["attacks"] > 100 and total["tightened"] > 20


@pytest.mark.long
def test_no_claim_contradicts_a_plan_on_more_trips() -> None:
    total = audit_all(LONG_SLICE, Effort())
    assert total["attacks"] > 1000 and total["tightened"] > 1000 and total["closed"] > 50
    assert total["stage_paths"] > 1000 and total["stage_closed"] > 5


def test_a_trip_is_determined_by_its_seed() -> None:
    for seed in (0, 5, 91):
        one, two, other = random_trip(seed), random_trip(seed), random_trip(seed + 1)
        assert describe(one) == describe(two) != describe(other)
        assert one.chargers[0].position_km == two.chargers[0].position_km
        np.testing.assert_array_equal(one.route.propulsion_kw, two.route.propulsion_kw)
        np.testing.assert_array_equal(
            one.vehicle.pack.resistance_ohm.f, two.vehicle.pack.resistance_ohm.f
        )


def test_random_trips_are_valid_and_cover_what_they_promise() -> None:
    seen: Counter[str] = Counter()
    ambient: list[float] = []
    for seed in range(250):
        trip = random_trip(seed)
        car, length = trip.vehicle, trip.route.length_km
        make_instance(trip, tuple(range(len(trip.chargers))))  # every map covers what is needed
        demand = car.cabin_heating_kw(trip.route.ambient_c).max()
        assert demand <= car.heater_kw * car.heater_cabin_efficiency, seed
        assert car.heat_pump_droop_per_kw * car.heat_pump_kw <= 0.5, seed
        assert car.heat_pump_cop.f.min() >= 1.0, seed
        assert trip.soc_min(0.0) <= trip.start_soc <= 1.0, seed
        assert trip.end_soc_min <= trip.soc_max, seed
        assert all(0.0 <= c.position_km <= length for c in trip.chargers), seed
        where = [c.position_km for c in trip.chargers]
        ambient += [float(trip.route.ambient_c.min()), float(trip.route.ambient_c.max())]
        seen.update(
            {
                f"car {car.name}": 1,
                f"chargers {len(where)}": 1,
                f"road {trip.route.name}": 1,
                f"pump {car.heat_pump_kw > 0.0}": 1,
                f"droop {car.heat_pump_droop_per_kw > 0.0}": 1,
                f"cooling {car.cooling_kw > 0.0}": 1,
                f"recuperation {bool((trip.route.propulsion_kw < -5.0).any())}": 1,
                f"varying weather {bool(np.ptp(trip.route.ambient_c) > 1.0)}": 1,
                f"free time {trip.time_value_per_h == 0.0}": 1,
                f"shared place {len(set(where)) < len(where)}": 1,
                f"at the start {0.0 in where}": 1,
                f"at the destination {length in where}": 1,
                f"curve {any(c.curve_kw is not None for c in trip.chargers)}": 1,
                f"current {any(c.current_a is not None for c in trip.chargers)}": 1,
                f"occupancy {any(c.occupancy_price_per_h > 0.0 for c in trip.chargers)}": 1,
                f"penalty {any(c.stop_penalty > 0.0 for c in trip.chargers)}": 1,
                f"paid to charge {any(c.price_per_kwh < 0.0 for c in trip.chargers)}": 1,
                f"flat voltage {bool(np.ptp(car.pack.ocv_v(np.array([0.2, 0.9]))) < 12.0)}": 1,
                f"limited time {trip.stop_time_h < 9.0}": 1,
                f"no resistance {car.pack.resistance_ohm.f.max() == 0.0}": 1,
            }
        )
    assert min(ambient) < -20.0 and max(ambient) > 35.0
    for name in shipped_vehicles():
        assert seen[f"car {name}"] > 10
    for count in range(1, 6):
        assert seen[f"chargers {count}"] > 3
    for road in random_trips.ROADS:
        assert seen[f"road {road}"] > 10
    for either in {k.rsplit(" ", 1)[0] for k in seen if k.endswith(("True", "False"))}:
        assert seen[f"{either} True"] > 0 and seen[f"{either} False"] > 0, either


def test_every_attack_spoils_the_vector() -> None:
    z = np.linspace(-3.0, 3.0, 9) + 0.123456789
    for name, spoilt in attacked(z, np.random.default_rng(0)):
        assert spoilt.shape != z.shape or not np.array_equal(spoilt, z), name


# ---------------------------------------------------------------- the audit bites


def kinds(seed: int = FAULTY) -> set[str]:
    return {f.kind for f in audit_trip(seed, SMALL).findings}


def test_a_root_bound_that_is_too_high_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    true = adversaries.relax_subset

    def wrong(instance: Instance, *more: Any) -> Any:
        found = true(instance, *more)
        if found.lower_bound is None:
            return found
        return replace(found, lower_bound=found.lower_bound + 0.3 * abs(found.lower_bound))

    assert kinds() == set()
    monkeypatch.setattr(adversaries, "relax_subset", wrong)
    assert "root bound above a cost" in kinds()


def test_a_false_proof_of_infeasibility_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    true = adversaries.relax_subset
    monkeypatch.setattr(adversaries, "relax_subset", lambda i: replace(true(i), infeasible=True))
    assert "root infeasible with a plan" in kinds()


def test_a_box_that_leaves_out_a_plan_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def narrow(instance: Instance) -> Box:
        box = make_box(instance)
        middle = box.temperature.lo + 0.2 * box.temperature.width
        return replace(box, temperature=Interval(box.temperature.lo, middle))

    monkeypatch.setattr(adversaries, "make_box", narrow)
    assert "plan outside the root box" in kinds()


def test_a_wrong_row_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    true = adversaries.build_relaxation

    def wrong(instance: Instance, box: Box) -> Any:
        program = true(instance, box)
        b = program.b.copy()
        if "heat balance" in program.rows:
            b[program.rows["heat balance"]] += 1e-3
        else:
            b[: program.n_zero] += 1e-3
        return replace(program, b=b)

    monkeypatch.setattr(adversaries, "build_relaxation", wrong)
    assert "plan breaks a row" in kinds()


def test_a_wrong_tightening_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reachability that forgets part of what is reachable: the boxes lose the plans."""
    true = adversaries.proof_steps.build_relaxation

    def wrong(instance: Instance, box: Box, *more: Any, **named: Any) -> Any:
        middle = box.temperature.hi - 0.5 * box.temperature.width
        lost = replace(box, temperature=Interval(box.temperature.lo, middle))
        adversaries.proof_steps.propagate(instance, lost)
        return true(instance, box, *more, **named)

    monkeypatch.setattr(adversaries.proof_steps, "build_relaxation", wrong)
    assert "plan outside a tightened box" in kinds()


def test_a_false_proof_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    true = adversaries.tighten.prove

    def wrong(instance: Instance, cutoff: float, **named: Any) -> Any:
        proof = true(instance, cutoff, **named)
        return replace(proof, closed=True, lower_bound=max(proof.lower_bound, cutoff))

    monkeypatch.setattr(adversaries.tighten, "prove", wrong)
    assert {"closed with a plan below", "proof above above a cost"} <= kinds()


def test_a_certifier_that_trusts_its_vector_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(program: Any, z: Any) -> LowerBound:
        """The dual objective as it stands: right only if the vector is a dual point."""
        size = min(z.size, program.b.size)
        return LowerBound(program.constant - float(program.b[:size] @ z[:size]))

    monkeypatch.setattr(adversaries, "certify_lower_bound", wrong)
    found = kinds()
    assert "unusable vector accepted" in found and "bound is not a number" in found
    assert any(k.startswith("attack") and k.endswith("above a cost") for k in found)


STAGES = Effort(drives=6, closings=2, advances=12, stages_s=20.0)
"""Enough for boxes of stages to be shrunk, on a trip with one charger."""


def stage_kinds(seed: int) -> set[str]:
    """Return what is found by proofs over stages alone, held against random drives."""
    trip, rng, audit = random_trip(seed), np.random.default_rng(seed), Audit()
    drive = make_drive(trip, trip.grid.step_km)
    nodes = []
    for subset in ((), (0,)):
        known = rivals.Known(make_instance(trip, subset, trip.grid, drive))
        rivals.drive_at_random(known, rng, STAGES)
        rivals.refine_at_random(known, rng, STAGES)
        nodes.append(known)
    stage_claims.audit_stages(audit, trip, drive, nodes, rng, STAGES)
    assert audit.counts["stage_paths"] > 0
    return {f.kind for f in audit.findings}


STAGE_SEED = 8
"""A trip with one charger that has plans, none of them without it, and whose proof shrinks."""


def raised_cost(true: Any) -> Any:
    def wrong(self: StageProgram, slope: Any, z: Any) -> float:
        value = float(true(self, slope, z))
        return value + 0.05 * abs(value)

    return wrong


def always_empty(_: Any) -> Any:
    return lambda self, z, budget=None: True


def raised_quantity(true: Any) -> Any:
    return lambda self, *claimed: true(self, *claimed) + 8.0


def lowered_budget(true: Any) -> Any:
    def wrong(self: StageGraph, *place: Any) -> Any:
        plane = true(self, *place)
        return plane._replace(constant=plane.constant - 0.05 * abs(self.closing))

    return wrong


@pytest.mark.parametrize(
    ("owner", "name", "fault", "kind"),
    [
        (StageProgram, "claim_cost", raised_cost, "bound of a stage above a cost"),
        (StageProgram, "claim_cost", raised_cost, "bound of a vertex above a cost"),
        (StageProgram, "claim_empty", always_empty, "plan without a path"),
        (StageProgram, "claim_quantity", raised_quantity, "closed with a plan below"),
        (StageGraph, "budget", lowered_budget, "plan without a path"),
    ],
)
def test_a_false_claim_over_stages_is_found(
    monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, fault: Any, kind: str
) -> None:
    monkeypatch.setattr(owner, name, fault(getattr(owner, name)))
    assert any(found.endswith(kind) for found in stage_kinds(STAGE_SEED))


def test_true_claims_over_stages_are_not_found() -> None:
    assert stage_kinds(STAGE_SEED) == set()


def test_an_exception_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(adversaries, "plan", broken)
    (finding,) = audit_trip(FAULTY, SMALL).findings
    assert finding.kind == "exception" and "on purpose" in finding.detail


# ---------------------------------------------------------------- the campaign


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validity, "Effort", lambda: SMALL)


def read(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_the_campaign_resumes_and_sums_up(tmp_path: Path, quick: None) -> None:
    file = tmp_path / "validity.csv"
    begin = ["--first", "45", "--file", str(file)]
    assert main([*begin, "--trips", "2"]) == 0
    first = read(file)
    assert [r["seed"] for r in first] == ["45", "46"]
    with file.open("a", encoding="utf-8") as stream:
        stream.write("47,3,4")  # killed while writing
    assert main([*begin, "--trips", "3", "--resume"]) == 0
    again = read(file)
    assert again[:2] == first and [r["seed"] for r in again] == ["45", "46", "47"]
    total = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    assert total["trips"] == 3 and total["findings"] == 0
    assert total["checks"]["bounds"] == sum(int(r["bounds"]) for r in again)
    assert total["worst_margin"] == min(float(r["worst_margin"]) for r in again)


def test_the_campaign_fails_on_a_finding_and_names_the_seed(
    tmp_path: Path, quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(adversaries, "plan", broken)
    file = tmp_path / "validity.csv"
    assert main(["--trips", "1", "--first", "9", "--file", str(file)]) == 1
    assert "python -m benchmarks.validity --seed 9" in capsys.readouterr().err
    total = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    assert total["seeds_with_findings"] == [9] and "on purpose" in total["first_findings"][0]
    assert main(["--seed", "9"]) == 1


@pytest.mark.parametrize("module", [random_trips, validity, adversaries, rivals, stage_claims])
def test_examples_in_the_docstrings(module: Any) -> None:
    outcome = doctest.testmod(module, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    assert outcome.attempted > 0 and outcome.failed == 0
