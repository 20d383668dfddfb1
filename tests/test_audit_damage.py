"""Whatever is damaged in a true proof, what is proved falls and the audit names a claim."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from math import inf
from typing import Any

import numpy as np
import pytest
from audited import SIX, check, plan_of_six, recheck

from enumerate import Result
from enumerate.audit import audit_evidence
from enumerate.audit_tree import Family
from enumerate.evidence import Evidence, ProofNode
from enumerate.ledger import Outcome

TRIP = SIX


@pytest.fixture(scope="module")
def result() -> Result:
    return plan_of_six()


def with_node(evidence: Evidence, number: int, **changes: Any) -> Evidence:
    nodes = tuple(
        dataclasses.replace(n, **changes) if n.number == number else n for n in evidence.nodes
    )
    assert any(n.number == number for n in nodes)
    return dataclasses.replace(evidence, nodes=nodes)


def node(evidence: Evidence, wanted: Callable[[ProofNode], bool]) -> ProofNode:
    return next(n for n in evidence.nodes if wanted(n))


def closed_late(n: ProofNode) -> bool:
    """Closed against a cutoff, in a part of a box."""
    return n.how is None and n.parent >= 0 and n.cutoff < inf and n.bound == n.cutoff


def test_a_flipped_dual_is_noticed(evidence: Evidence) -> None:
    bad = node(evidence, lambda n: n.parent < 0 and len(n.steps) == 1 and 0.0 < n.bound < inf)
    step = dataclasses.replace(bad.steps[0], dual=-bad.steps[0].dual)
    holds, text = check(with_node(evidence, bad.number, steps=(step,)))
    assert not holds and f"node {bad.number}: claims" in text


def test_one_flipped_entry_never_raises_a_bound(evidence: Evidence) -> None:
    """Any vector gives a true bound; the flipped one gives a worse one."""
    bad = node(evidence, lambda n: n.parent < 0 and len(n.steps) == 1 and 0.0 < n.bound < inf)
    dual = bad.steps[0].dual.copy()
    dual[int(np.abs(dual).argmax())] *= -1.0
    changed = with_node(evidence, bad.number, steps=(dataclasses.replace(bad.steps[0], dual=dual),))
    proofs = recheck(SIX, changed.nodes, changed.grid)
    assert f"node {bad.number}: claims" in "\n".join(proofs.failures)


def test_swapped_steps_are_noticed(evidence: Evidence) -> None:
    parts = [n for n in evidence.nodes if closed_late(n)]
    first = parts[0]
    second = next(n for n in parts if n.subset != first.subset or n.undecided != first.undecided)
    swapped = with_node(evidence, first.number, steps=second.steps)
    swapped = with_node(swapped, second.number, steps=first.steps)
    holds, text = check(swapped)
    assert not holds
    assert f"node {first.number}: claims" in text or f"node {second.number}: claims" in text


def test_a_raised_bound_is_noticed_in_any_node(evidence: Evidence) -> None:
    finite = [n for n in evidence.nodes if 0.0 < n.bound < inf]
    assert len(finite) > 12
    raised = {n.number: n.bound * 1.001 for n in finite}
    nodes = tuple(
        dataclasses.replace(n, bound=raised.get(n.number, n.bound)) for n in evidence.nodes
    )
    _, text = check(dataclasses.replace(evidence, nodes=nodes))
    # closed against a cutoff by emptiness, a box may prove more than it claims
    named = [number for number in raised if f"node {number}: claims" in text]
    assert len(named) >= 0.5 * len(finite)
    one = with_node(evidence, named[-1], bound=raised[named[-1]])
    assert check(one) == (False, next(t for t in text.split("\n") if f"node {named[-1]}:" in t))


def test_a_missing_node_is_missed(evidence: Evidence) -> None:
    gone = node(evidence, closed_late)
    nodes = tuple(n for n in evidence.nodes if n.number != gone.number)
    found = audit_evidence(dataclasses.replace(evidence, nodes=nodes), TRIP)
    assert not found.holds and any("is claimed" in text for text in found.failures)
    assert found.lower_bound < evidence.lower_bound


def test_parts_of_a_missing_node_are_named(evidence: Evidence) -> None:
    gone = node(evidence, lambda n: n.how is not None)
    nodes = tuple(n for n in evidence.nodes if n.number != gone.number)
    holds, text = check(dataclasses.replace(evidence, nodes=nodes))
    assert not holds and f"is a part of node {gone.number}, which is not there" in text


@pytest.mark.parametrize("share", [0.999, 1.05])
def test_a_changed_cutoff_is_noticed(evidence: Evidence, share: float) -> None:
    """Claims at the cutoff: a lower one proves less, with a higher one nothing is closed."""
    bad = node(evidence, lambda n: closed_late(n) and not n.undecided)
    own = [n for n in evidence.nodes if n.number in (bad.number, bad.parent)]
    changed = with_node(evidence, bad.number, cutoff=share * bad.cutoff, bound=1.05 * bad.cutoff)
    holds, text = check(changed)
    assert len(own) == 2 and not holds and f"node {bad.number}: claims" in text


def test_no_damage_of_the_numbers_confirms_a_false_bound(evidence: Evidence) -> None:
    """Claims above a known plan's cost are never confirmed, however the proof is stirred."""
    rng = np.random.default_rng(7)
    keep = [n for n in evidence.nodes if n.parent < 0 and not n.undecided]
    row = next(r for r in evidence.rows if r.outcome is Outcome.PLANNED)
    family = Family(row.subset, (), (len(row.subset),) * 2)
    steps = [s for n in evidence.nodes for s in n.steps]
    confirmed = []
    for _ in range(40):
        root = next(n for n in keep if n.subset == row.subset)
        picked = tuple(steps[i] for i in rng.integers(0, len(steps), rng.integers(1, 5)))
        stirred = tuple(
            dataclasses.replace(s, dual=s.dual * rng.choice([1.0, -1.0, 1e3], s.dual.size))
            for s in picked
        )
        cutoff = float(rng.choice([inf, row.cost, 1.5 * row.cost]))
        node = dataclasses.replace(
            root, steps=(*root.steps, *stirred), cutoff=cutoff, bound=1.001 * row.cost
        )
        proofs = recheck(SIX, [node], evidence.grid)
        assert proofs.bound(family) <= row.cost * (1.0 + 1e-9)
        confirmed += [] if proofs.failures else [node]
    assert not confirmed
