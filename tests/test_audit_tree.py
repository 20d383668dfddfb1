"""A tree of boxes proves what its nodes prove, and an unsound step or a false node is refused."""

from __future__ import annotations

import dataclasses
import functools
import re
from itertools import chain, combinations
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from audited import SIX, TWO, recheck

from enumerate.audit_tree import Family, Recheck, exceeds
from enumerate.evidence import ProofNode
from enumerate.quantity import COLUMNS
from relax import make_instance
from relax.branch import Branch, Target, branch
from relax.proof import BoxProof, Step
from relax.reach import make_box
from relax.solve import solve_cone

CHARGE = Target("charge", 0, "charge")
ONE = Family((0,), (), (1, 1))
ROOT = Path(__file__).resolve().parents[1]


# ---------------------------------------------------------------------------- cutoffs and parts


@functools.cache
def hand_made() -> tuple[list[ProofNode], float, float]:
    """A tree made here, its root's bound and cutoff: both ends of the charge shrunk, then halved.

    The cutoff is just above the bound of the cost, so that shrinking cuts much away; the parts
    are bounded without any.
    """
    instance = make_instance(TWO, (0,))

    def relax(proof: BoxProof) -> None:
        program = proof.build()
        proof.apply(Step("relax", solve_cone(program).z), program)

    rough = BoxProof(instance, make_box(instance), inf)
    relax(rough)
    cutoff = rough.bound + 0.02
    root = BoxProof(instance, make_box(instance), cutoff)
    relax(root)
    for sign in (1, -1):
        program = root.objective(CHARGE, sign)
        root.apply(Step("shrink", solve_cone(program).z, False, CHARGE, sign), program)
    assert float(root.box.charge.width[0]) < 0.8 * float(rough.box.charge.width[0])
    how = Branch("halve", CHARGE, float(root.box.charge.mid[0]))
    nodes = [ProofNode(0, -1, 0, (0,), (), (1, 1), cutoff, tuple(root.steps), how, root.bound)]
    for part, box in zip((0, 1), branch(root.box, how), strict=True):
        proof = BoxProof(instance, box, inf, root.bound)
        proof.apply(Step("propagate"))
        relax(proof)
        for sign in (1, -1):
            program = proof.objective(CHARGE, sign)
            proof.apply(Step("shrink", solve_cone(program).z, False, CHARGE, sign), program)
        relax(proof)
        nodes.append(
            ProofNode(
                1 + part, 0, part, (0,), (), (1, 1), inf, tuple(proof.steps), None, proof.bound
            )
        )
    return nodes, root.bound, cutoff


def test_a_bound_by_a_cutoff_is_not_infeasibility() -> None:
    tree, roots, cutoff = hand_made()
    proofs = recheck(TWO, [dataclasses.replace(tree[0], bound=inf), *tree[1:]])
    assert proofs.failures == [
        f"node 0: claims that no plan costs less than inf; what is proved is {roots!r}"
    ]
    late = dataclasses.replace(tree[1], cutoff=cutoff, bound=inf)
    (failure,) = recheck(TWO, [tree[0], late, tree[2]]).failures
    assert failure.startswith("node 1: claims that no plan costs less than inf")


def test_a_missing_part_counts_with_its_parents_bound() -> None:
    tree, roots, cutoff = hand_made()
    assert roots < cutoff
    assert recheck(TWO, tree).bound(ONE) > roots
    for gone in (1, 2):
        proofs = recheck(TWO, [n for n in tree if n.number != gone])
        assert not proofs.failures and proofs.bound(ONE) == roots


def test_what_a_cutoff_cut_away_is_not_forgotten() -> None:
    """A box shrunk below 10 says nothing of plans that cost 11, whatever is proved inside."""
    tree, _, cutoff = hand_made()
    inside = min(n.bound for n in tree[1:])
    assert inside > cutoff, "the parts are bounded without a cutoff of their own"
    proofs = recheck(TWO, tree)
    assert not proofs.failures and proofs.bound(ONE) == cutoff
    unshrunk = [dataclasses.replace(tree[0], cutoff=inf), *tree[1:]]
    assert recheck(TWO, unshrunk).bound(ONE) != cutoff


# ---------------------------------------------------------------------------- steps


def first_steps(*steps: Step, how: Branch | None = None, bound: float = -inf) -> Recheck:
    """Re-check one root with these steps."""
    return recheck(SIX, [ProofNode(0, -1, 0, (1,), (), (1, 1), 100.0, steps, how, bound)])


def relaxed() -> Step:
    instance = make_instance(SIX, (1,))
    return Step("relax", np.zeros(BoxProof(instance, make_box(instance), inf).build().b.size))


@pytest.mark.parametrize(
    ("target", "sign"),
    [
        (Target("charge", 0, "dwell"), 1),  # the bound of another quantity
        (Target("stay", 0, "charge"), -1),
        (Target("charge", 1, "charge"), 1),
        (Target("charge", -1, "charge"), 1),
        (Target("charge", (0, 0), "charge"), 1),
        (Target("stop_temperature", 0, "border"), 1),
        (Target("energy", 0, "energy"), 1),
        (Target("optional", 0, "used"), 1),
        (CHARGE, 0),
        (CHARGE, 2),
        (None, 1),
    ],
)
def test_a_step_must_bound_the_quantity_it_shrinks(target: Target | None, sign: int) -> None:
    root = relaxed()
    zero = np.zeros(root.dual.size + 1)
    proofs = first_steps(root, Step("shrink", zero, False, target, sign))
    assert proofs.failures == ["node 0: step 1 shrinks what is no quantity of its box"]


def test_the_audit_knows_every_quantity_that_the_search_bounds() -> None:
    source = (ROOT / "relax" / "tighten.py").read_text(encoding="utf-8")
    pairs = set(re.findall(r'Target\("(\w+)", .+?, "(\w+)"\)', source))
    assert len(pairs) >= 4
    assert pairs <= set(COLUMNS.items())
    instance = make_instance(SIX, (1,))
    box = make_box(instance)
    program = BoxProof(instance, box, inf).build()
    for name, variable in COLUMNS.items():  # as many columns, but for sums
        shape = getattr(box, name).lo.shape
        assert program.variables[variable].shape[: len(shape)] == shape, name


def test_a_step_must_have_a_program() -> None:
    proofs = first_steps(Step("shrink", np.zeros(3), False, CHARGE, 1))
    assert proofs.failures == ["node 0: step 0 shrinks before the cost is bounded"]


@pytest.mark.parametrize(
    "how",
    [
        Branch("halve", CHARGE, 1e6),
        Branch("halve", CHARGE, -1.0),
        Branch("halve", Target("charge", 3, "charge"), 5.0),
        Branch("halve", None, 5.0),
        Branch("use", stop=0),
        Branch("use", stop=-1),
        Branch("count", at=1),
        Branch("count", at=0.5),
        Branch("count", at=inf),
        Branch("neither"),
    ],
)
def test_a_box_is_cut_inside(how: Branch) -> None:
    proofs = first_steps(relaxed(), how=how)
    assert proofs.failures == ["node 0: it is cut where its box cannot be cut"]


@pytest.mark.parametrize(
    "dual",
    [np.zeros(0), np.full(9, np.nan), np.full(9, np.inf), np.full(9, 1e99), np.full(9, -1.0)],
)
def test_any_vector_is_harmless(dual: np.ndarray[Any, Any]) -> None:
    size = relaxed().dual.size
    whole = np.resize(dual, size) if dual.size else dual
    proofs = first_steps(Step("relax", whole, True), bound=1.0)
    assert proofs.bound(Family((1,), (), (1, 1))) < 1.0
    assert len(proofs.failures) == 1 and "node 0: claims" in proofs.failures[0]


# ---------------------------------------------------------------------------- nodes


def test_an_empty_family_speaks_for_no_other() -> None:
    """Five stops of one charger do not exist; that says nothing of one stop."""
    proofs = recheck(SIX, [ProofNode(0, -1, 0, (1,), (), (5, 5), inf, (), None, inf)])
    assert not proofs.failures
    assert proofs.bound(Family((1,), (), (1, 1))) == -inf


@pytest.mark.parametrize(
    "changes",
    [{"part": 2}, {"subset": (9,)}, {"subset": (1, 1)}, {"number": -4}, {"cutoff": -inf}],
)
def test_a_node_must_be_one(changes: dict[str, Any]) -> None:
    root = ProofNode(0, -1, 0, (1,), (), (1, 1), inf, (), None, -inf)
    proofs = recheck(SIX, [dataclasses.replace(root, **changes)])
    assert len(proofs.failures) == 1 and proofs.bound(Family((1,), (), (1, 1))) == -inf


def test_numbers_and_parts_are_taken_once_and_circles_prove_nothing() -> None:
    root = ProofNode(0, -1, 0, (1,), (), (1, 1), inf, (relaxed(),), None, -inf)
    middle = float(make_box(make_instance(SIX, (1,))).charge.mid[0])
    cut = dataclasses.replace(root, how=Branch("halve", CHARGE, middle))
    part = dataclasses.replace(root, number=1, parent=0, steps=())
    for nodes, named in (
        ((root, root), "node 0: its number is taken"),
        ((cut, part, dataclasses.replace(part, number=2)), "node 2: node 0 has that part"),
        ((root, part), "node 1: it is a part of node 0, which is not there or uncut"),
        (
            (
                dataclasses.replace(part, parent=2, bound=inf),
                dataclasses.replace(part, number=2, parent=1, bound=inf),
            ),
            "node 1: it is a part of node 2",
        ),
        ((cut, dataclasses.replace(part, subset=(2,))), "node 1: it is not part 0 of node 0"),
    ):
        proofs = recheck(SIX, nodes)
        assert any(text.startswith(named) for text in proofs.failures), (named, proofs.failures)
        assert proofs.bound(Family((1,), (), (1, 1))) < inf


# ---------------------------------------------------------------------------- families


def test_families_cover_and_meet_as_their_subsets_do() -> None:
    rng = np.random.default_rng(3)
    every = list(chain.from_iterable(combinations(range(4), k) for k in range(5)))

    def draw() -> Family:
        kind = rng.integers(0, 3, 4)
        used = tuple(int(i) for i in np.flatnonzero(kind == 0))
        maybe = tuple(int(i) for i in np.flatnonzero(kind == 1))
        return Family(used, maybe, (int(rng.integers(0, 4)), int(rng.integers(0, 5))))

    def members(f: Family) -> set[tuple[int, ...]]:
        return {
            s
            for s in every
            if {*f.subset} <= {*s} <= {*f.subset, *f.undecided}
            and f.count[0] <= len(s) <= f.count[1]
        }

    outcomes = set()
    for _ in range(600):
        a, b = draw(), draw()
        assert a.meets(b) == bool(members(a) & members(b)), (a, b)
        if a.covers(b):
            assert members(b) <= members(a), (a, b)
        elif members(b):
            assert not members(b) <= members(a), (a, b)
        outcomes.add((a.meets(b), a.covers(b)))
    assert len(outcomes) >= 3


def test_rounding_is_forgiven_and_nothing_else() -> None:
    assert not exceeds(100.0 * (1.0 + 5e-10), 100.0) and exceeds(100.0 * (1.0 + 5e-9), 100.0)
    assert not exceeds(inf, inf) and exceeds(inf, 1e300) and not exceeds(-inf, -inf)
    assert exceeds(0.0, -inf) and not exceeds(5.0, inf) and exceeds(float("nan"), 1.0)
