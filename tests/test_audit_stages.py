"""A proof over stages is replayed by the audit; whatever its file says, no bound is too high."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from audited import STAGED, audit_apart

from enumerate import Result, audit, load_proofs, plan, save_proofs
from enumerate.audit import audit_evidence
from enumerate.audit_stages import StageRecheck, recheck_stages
from enumerate.evidence import Evidence, StageProof
from enumerate.evidence_file import save_evidence
from enumerate.evidence_stages import COLUMNS, KINDS, from_table, to_table
from enumerate.ledger import Outcome
from enumerate.stage_graph import StageGraph
from enumerate.stage_parts import Arc, StageStep
from relax import InputError, make_instance
from relax.instance import Instance

TRIP = STAGED
Steps = tuple[StageStep, ...]


@pytest.fixture(scope="module")
def result() -> Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("enumerate.proving.by_stages", lambda search: True)
        return plan(TRIP, gap=0.02, keep_proofs=True)


@pytest.fixture(scope="module")
def proof(evidence: Evidence) -> StageProof:
    assert evidence.stages is not None
    return evidence.stages


@pytest.fixture(scope="module")
def family() -> Instance:
    return make_instance(TRIP, (), undecided=(0, 1))


@pytest.fixture(scope="module")
def done(family: Instance, proof: StageProof) -> StageGraph:
    """The graph at the end of the proof."""
    graph = StageGraph(family, proof.closing)
    for step in proof.steps:
        graph.apply(step)
    return graph


def with_steps(evidence: Evidence, change: Callable[[Steps], Steps], **others: Any) -> Evidence:
    assert evidence.stages is not None
    stages = dataclasses.replace(evidence.stages, steps=change(evidence.stages.steps), **others)
    return dataclasses.replace(evidence, stages=stages)


# ---------------------------------------------------------------------------- what is true


def test_what_stages_bound_is_confirmed(file: Path, result: Result, proof: StageProof) -> None:
    assert result.stages is not None and {s.kind for s in proof.steps} >= {
        "open", "cost", "shrink", "propagate", "narrow", "split", "plane"
    }  # fmt: skip
    seen: list[tuple[int, int]] = []
    found = audit(file, TRIP, lambda done, total: seen.append((done, total)))
    assert found.holds, found.failures
    assert found.lower_bound == pytest.approx(result.lower_bound, rel=1e-9)
    assert found.stage_steps == len(proof.steps)
    total = found.nodes + found.stage_steps
    assert seen == [(i + 1, total) for i in range(total)]
    certified = sum(s.kind in ("cost", "empty", "shrink") for s in proof.steps)
    certified += sum(s.kind != "propagate" for n in result.proofs for s in n.steps)
    assert found.programs == certified
    assert f"{len(proof.steps)} steps over stages" in " ".join(str(found).split())
    assert max(len(line) for line in str(found).split("\n")) <= 100


def test_the_rows_rest_on_stages(evidence: Evidence, proof: StageProof) -> None:
    raised = [r for r in evidence.rows if r.lower_bound == proof.bound]
    assert raised and proof.bound <= evidence.lower_bound
    found = audit_evidence(dataclasses.replace(evidence, stages=None), TRIP)
    assert not found.holds and found.lower_bound < evidence.lower_bound
    text = "\n".join(found.failures)
    assert f"row of the chargers {raised[0].subset}: claims" in text and "bound: " in text
    rows = tuple(
        dataclasses.replace(r, lower_bound=1.01 * r.lower_bound) if r is raised[0] else r
        for r in evidence.rows
    )
    failures = audit_evidence(dataclasses.replace(evidence, rows=rows), TRIP).failures
    assert any(text.startswith(f"row of the chargers {raised[0].subset}: ") for text in failures)


def test_a_kept_proof_gives_the_searchs_bound_to_the_last_bit(
    family: Instance, proof: StageProof, done: StageGraph
) -> None:
    assert done.lower_bound == proof.bound == recheck_stages(family, proof).bound


@pytest.mark.parametrize("kept", [1, 3])
def test_programs_that_were_given_up_come_back_the_same(
    family: Instance,
    proof: StageProof,
    done: StageGraph,
    monkeypatch: pytest.MonkeyPatch,
    kept: int,
) -> None:
    monkeypatch.setattr("enumerate.stage_graph.KEPT_PROGRAMS", kept)
    graph = StageGraph(family, proof.closing)
    for step in proof.steps:
        graph.apply(step)
        assert sum(arc.program is not None for arc in graph.arcs.values()) <= kept
    assert graph.bound == done.bound
    assert [a.planes for a in graph.arcs.values()] == [a.planes for a in done.arcs.values()]


def test_no_solver_is_loaded_for_stages(file: Path) -> None:
    steps, loaded = audit_apart(file, "STAGED")
    assert steps
    assert "enumerate.stage_graph" in loaded
    assert not {m.split(".")[0] for m in loaded} & {"clarabel", "osqp", "cvxpy", "casadi"}
    searches = {f"enumerate.{name}" for name in ("search", "stage_search", "tree", "account")}
    assert not loaded & (searches | {"relax.solve", "relax.tighten", "relax.refinement"})


@pytest.mark.parametrize("most", [5, 40, 75])
def test_what_an_interrupted_search_says_is_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    """Ctrl-C in the middle of a step, when an arc has just gone: its parts are there."""
    monkeypatch.setattr("enumerate.proving.by_stages", lambda search: True)
    drop, count = StageGraph._drop, [0]

    def interrupted(self: StageGraph, arc: Arc) -> None:
        count[0] += 1
        drop(self, arc)
        if len(self.steps) >= most:
            raise KeyboardInterrupt

    monkeypatch.setattr(StageGraph, "_drop", interrupted)
    result = plan(TRIP, gap=0.005, keep_proofs=True)
    monkeypatch.undo()
    assert result.interrupted and result.stages is not None and count[0]
    assert len(result.stages.steps) >= most
    save_proofs(tmp_path / "part", TRIP, result)
    found = audit(tmp_path / "part", TRIP)
    assert found.holds, found.failures


# ---------------------------------------------------------------------------- what is false


def scaled(steps: Steps) -> Steps:
    return tuple(dataclasses.replace(s, dual=0.7 * s.dual) for s in steps)


def permuted(steps: Steps) -> Steps:
    rng = np.random.default_rng(2)
    return tuple(dataclasses.replace(s, dual=rng.permutation(s.dual)) for s in steps)


def truncated(steps: Steps) -> Steps:
    return tuple(dataclasses.replace(s, dual=s.dual[:-1]) for s in steps)


def sloped(steps: Steps) -> Steps:
    return tuple(
        dataclasses.replace(s, slope=(s.slope[0] + 0.4, s.slope[1] - 0.1))
        if s.kind in ("cost", "plane") else s
        for s in steps
    )  # fmt: skip


def without_costs(steps: Steps) -> Steps:
    costs = [i for i, s in enumerate(steps) if s.kind == "cost"]
    gone = {*costs[len(costs) // 2 :]}
    return tuple(s for i, s in enumerate(steps) if i not in gone)


def without_opening(steps: Steps) -> Steps:
    return tuple(s for s in steps if s.kind != "open")


def without_the_end(steps: Steps) -> Steps:
    return steps[: 2 * len(steps) // 3]


def without_planes(steps: Steps) -> Steps:
    return tuple(s for s in steps if s.kind != "plane")


def reordered(steps: Steps) -> Steps:
    order = sorted(range(len(steps)), key=lambda i: (steps[i].kind == "plane", i))
    return tuple(steps[i] for i in order)


def backwards(steps: Steps) -> Steps:
    return steps[::-1]


@pytest.mark.parametrize(
    "change",
    [
        scaled, permuted, truncated, sloped, without_costs, without_opening, without_the_end,
        without_planes, reordered, backwards,
    ],
)  # fmt: skip
def test_a_stirred_proof_is_refused(
    evidence: Evidence, family: Instance, change: Callable[[Steps], Steps]
) -> None:
    stirred = with_steps(evidence, change)
    assert stirred.stages is not None
    found = recheck_stages(family, stirred.stages)
    assert found.bound < stirred.stages.bound
    assert len(found.failures) == 1 and found.failures[0].startswith("stages: ")


def test_a_proof_without_one_of_its_steps_is_none_or_a_true_one(
    evidence: Evidence, family: Instance, proof: StageProof
) -> None:
    """Some steps are not needed; without the others the bound is lower or a step impossible."""
    missed = 0
    for gone in range(1, len(proof.steps), 13):
        steps = (*proof.steps[:gone], *proof.steps[gone + 1 :])
        found = recheck_stages(family, dataclasses.replace(proof, steps=steps))
        assert bool(found.failures) == (found.bound < proof.bound)
        assert found.bound <= evidence.transcribed
        missed += bool(found.failures)
    assert missed


def test_the_audit_names_a_stirred_proof(evidence: Evidence) -> None:
    found = audit_evidence(with_steps(evidence, without_planes), TRIP)
    text = "\n".join(found.failures)
    assert not found.holds and "stages: step " in text and "bound: " in text
    assert found.lower_bound < evidence.lower_bound


def test_a_raised_closing_proves_no_more(
    evidence: Evidence, family: Instance, proof: StageProof
) -> None:
    """What was shrunk below a cost says nothing above it; below another cost it shrinks less."""
    for closing in (1.05 * proof.closing, 2.0 * proof.closing):
        raised = dataclasses.replace(proof, closing=closing, bound=closing)
        found = recheck_stages(family, raised)
        assert found.bound <= evidence.transcribed and found.failures
    for closing in (nan, inf, -inf):
        found = recheck_stages(family, dataclasses.replace(proof, closing=closing))
        assert found.bound == -inf and "closing must be finite" in found.failures[0]


def test_a_lowered_closing_bounds_up_to_itself(family: Instance, proof: StageProof) -> None:
    closing = 0.9 * proof.closing
    found = recheck_stages(family, dataclasses.replace(proof, closing=closing))
    assert found.bound <= closing and found.failures


@pytest.mark.parametrize("bound", [1.001, inf])
def test_a_raised_claim_is_refused(
    evidence: Evidence, family: Instance, proof: StageProof, bound: float
) -> None:
    raised = dataclasses.replace(proof, bound=bound * proof.bound)
    found = recheck_stages(family, raised)
    assert found.bound == proof.bound
    assert found.failures == (
        f"stages: no plan costs less than {raised.bound!r}, they claim; what is proved is "
        f"{proof.bound!r}",
    )
    lie = dataclasses.replace(evidence, stages=raised, lower_bound=raised.bound)
    failures = audit_evidence(lie, TRIP).failures
    assert any(text.startswith("bound: ") for text in failures)


def test_stages_that_were_shrunk_prove_no_infeasibility(evidence: Evidence) -> None:
    rows = tuple(
        dataclasses.replace(r, outcome=Outcome.INFEASIBLE) if r.outcome is Outcome.BOUNDED else r
        for r in evidence.rows
    )
    assert rows != evidence.rows
    found = audit_evidence(dataclasses.replace(evidence, rows=rows), TRIP)
    assert any("proved infeasible, it says" in text for text in found.failures)


def draw(rng: np.random.Generator, steps: Steps, graph: StageGraph) -> StageStep:
    """Return a step made of parts of others, with odd numbers among them."""
    like = steps[rng.integers(len(steps))]
    kind = like.kind if rng.random() < 0.7 else steps[rng.integers(len(steps))].kind
    vertices, arcs = [*graph.vertices], [a.number for a in graph.alive()]
    at = int(rng.choice(vertices if kind in ("split", "narrow", "plane") else arcs or [0]))
    other = steps[rng.integers(len(steps))]
    dual = like.dual * rng.choice([1.0, 1.0, -1.0, 1e-3, 1e3, 1e12], like.dual.shape)
    return dataclasses.replace(
        like,
        kind=kind,
        at=at if rng.random() < 0.9 else int(rng.integers(-2, 90)),
        dual=like.dual if rng.random() < 0.6 else dual,
        slope=other.slope if rng.random() < 0.9 else (float(rng.normal(0.0, 1e9)), nan),
        state=other.state,
        target=other.target if rng.random() < 0.5 else like.target,
        value=float(rng.uniform(-20.0, 60.0)),
        sign=int(rng.choice([like.sign, -1, 0, 1, 2])),
        ray=bool(rng.random() < 0.4),
    )


@pytest.mark.parametrize("seed", range(4))
def test_no_steps_at_all_bound_above_a_plan(
    evidence: Evidence, family: Instance, proof: StageProof, seed: int
) -> None:
    """Odd steps between true ones: some are refused, the others lose no plan."""
    rng = np.random.default_rng(seed)
    closing = float(rng.choice([proof.closing, 1.02 * evidence.transcribed]))
    graph = StageGraph(family, closing)
    refused = did = 0
    for step in proof.steps:
        tried = [draw(rng, proof.steps, graph)] if rng.random() < 0.3 else []
        for one in (*tried, step):
            try:
                with np.errstate(over="raise", invalid="raise", divide="raise"):
                    graph.apply(one)
                did += one is not step
            except ValueError:
                refused += 1
        assert graph.lower_bound <= evidence.transcribed
    assert refused and did


def test_a_fallen_closing_bounds_up_to_itself(family: Instance, proof: StageProof) -> None:
    for early in (True, False):
        fall = StageStep("closing", value=0.95 * proof.closing)
        steps = (fall, *proof.steps) if early else (*proof.steps, fall)
        found = recheck_stages(family, dataclasses.replace(proof, steps=steps))
        assert found.bound <= fall.value and found.failures


# ---------------------------------------------------------------------------- the file


def test_every_bit_of_a_step_comes_back(result: Result, evidence: Evidence, tmp_path: Path) -> None:
    assert result.stages is not None
    save_evidence(tmp_path / "again", evidence)
    for stages in (evidence.stages, load_proofs(tmp_path / "again").stages):
        assert stages is not None
        assert stages.closing == result.stages.closing and stages.bound == result.stages.bound
        for step, same in zip(stages.steps, result.stages.steps, strict=True):
            for field in dataclasses.fields(StageStep):
                one, other = getattr(step, field.name), getattr(same, field.name)
                if field.name == "dual":
                    one, other = one.tobytes(), np.asarray(other, dtype=np.float64).tobytes()
                assert one == other


def table_with(proof: StageProof, column: str, value: float) -> Any:
    table, targets = to_table(proof.steps)
    table[3, COLUMNS.index(column)] = value
    return table, targets, np.concatenate([s.dual for s in proof.steps])


@pytest.mark.parametrize(
    ("column", "value", "named"),
    [
        ("kind", float(len(KINDS)), "kinds that there are not"),
        ("kind", -1.0, "kinds that there are not"),
        ("kind", 0.5, "fractions"),
        ("at", nan, "fractions"),
        ("at", inf, "fractions"),
        ("at", 1e300, "fractions"),
        ("dual entries", -1.0, "sizes that there are not"),
        ("dual entries", 1e12, "sizes that there are not"),
        ("dual entries", 7.0, "sizes stated"),
        ("target", 99.0, "targets that there are not"),
        ("target", -2.0, "targets that there are not"),
        ("ray", 2.0, "flags that there are not"),
        ("sign", 0.1, "fractions"),
    ],
)
def test_a_damaged_table_is_refused(
    proof: StageProof, column: str, value: float, named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        from_table(*table_with(proof, column, value))


def test_a_damaged_file_is_refused(evidence: Evidence, tmp_path: Path) -> None:
    save_evidence(tmp_path / "good", evidence)
    with np.load(tmp_path / "good", allow_pickle=False) as arrays:
        members = {name: arrays[name] for name in arrays.files}
    header = members["header"].tobytes().decode()
    assert '"stages":{"closing":' in header
    start = header.index('"stages":') + len('"stages":')
    for name, change in {
        "no stages": {"header": header[:start] + "null}"},
        "no number": {"header": header[:start] + '{"closing":"nan","bound":1,"targets":[]}}'},
        "columns": {"stages": members["stages"][:, 1:]},
        "flat": {"stages": members["stages"].ravel()},
        "short": {"stages": members["stages"][:-5]},
        "integers": {"stages": members["stages"].astype(np.int64)},
    }.items():
        changed: dict[str, Any] = {
            key: np.frombuffer(value.encode(), dtype=np.uint8) if isinstance(value, str) else value
            for key, value in (members | change).items()
        }
        with (tmp_path / name).open("wb") as stream:
            np.savez(stream, **changed)
        with pytest.raises(InputError, match="undamaged"):
            load_proofs(tmp_path / name)


def test_nothing_is_proved_without_steps(family: Instance) -> None:
    found = recheck_stages(family, StageProof(100.0, (), -inf))
    assert found == StageRecheck(-inf, 0, 0, ())
