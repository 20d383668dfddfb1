"""The audit confirms what is proved, names what is not, and never confirms what is false."""

from __future__ import annotations

import dataclasses
import functools
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import chain, combinations
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trips import small_trip

from enumerate import Result, Status, audit, plan, save_proofs
from enumerate.audit import audit_evidence
from enumerate.audit_tree import Family, Recheck, exceeds
from enumerate.evidence import Evidence, ProofNode
from enumerate.evidence_file import load_proofs, save_evidence
from enumerate.ledger import Outcome
from enumerate.quantity import COLUMNS
from relax import Grid, InputError, Trip, make_instance
from relax.branch import Branch, Target, branch
from relax.proof import BoxProof, Step
from relax.reach import make_box
from relax.solve import solve_cone

ROOT = Path(__file__).resolve().parents[1]


def many_chargers(n: int) -> Trip:
    """The small trip with chargers of both kinds all along, so that families are bounded."""
    trip = small_trip(time_value_per_h=30.0, start_soc=0.35)
    chargers = tuple(
        dataclasses.replace(
            trip.chargers[i % 2], name=f"c{i}", position_km=20.0 + 80.0 * i / (n - 1)
        )
        for i in range(n)
    )
    return dataclasses.replace(trip, chargers=chargers)


TRIP = dataclasses.replace(many_chargers(6), grid=Grid(step_km=8.0, cells=6))
TWO = small_trip(start_soc=0.45, time_value_per_h=60.0)


@pytest.fixture(scope="module")
def result() -> Result:
    found = plan(TRIP, gap=0.01, keep_proofs=True)
    assert found.status is Status.OPTIMAL
    return found


@pytest.fixture(scope="module")
def file(result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("proofs") / "six.proofs"
    save_proofs(path, TRIP, result)
    return path


@pytest.fixture(scope="module")
def evidence(file: Path) -> Evidence:
    return load_proofs(file)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    """Evidence of two chargers: quick to audit."""
    path = tmp_path_factory.mktemp("proofs") / "two.proofs"
    save_proofs(path, TWO, plan(TWO, gap=0.02, keep_proofs=True))
    found = load_proofs(path)
    assert audit_evidence(found, TWO).holds
    return found


def check(evidence: Evidence) -> tuple[bool, str]:
    found = audit_evidence(evidence, TRIP if evidence.n_chargers == 6 else TWO)
    return found.holds, "\n".join(found.failures)


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


CHARGE = Target("charge", 0, "charge")
ONE = Family((0,), (), (1, 1))


def recheck_two(nodes: list[ProofNode]) -> Recheck:
    proofs = Recheck(lambda used, maybe: make_instance(TWO, used, None, None, maybe), 2)
    proofs.run(nodes)
    return proofs


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


def test_no_solver_is_loaded(file: Path) -> None:
    code = (
        "import sys\nfrom test_audit_trip import TRIP\nfrom enumerate import audit\n"
        "found = audit(sys.argv[1], TRIP)\nassert found.holds, found.failures\n"
        "print(' '.join(sorted(sys.modules)))"
    )
    code = code.replace("from test_audit_trip import TRIP", _TRIP_ONLY)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(file)],
        capture_output=True, text=True, cwd=ROOT, check=False,
        env={"PYTHONPATH": ":".join(p for p in sys.path if p)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert "relax.proof" in loaded
    assert not {m.split(".")[0] for m in loaded} & {"clarabel", "osqp", "cvxpy", "casadi"}
    suggests = {"relax.solve", "relax.tighten", "relax.refinement", "relax.starts", "relax.execute"}
    searches = {f"enumerate.{name}" for name in ("search", "tasks", "tree", "account")}
    assert not loaded & (suggests | searches)


_TRIP_ONLY = """
import dataclasses
from relax.trip import Grid
from trips import small_trip
TRIP = small_trip(time_value_per_h=30.0, start_soc=0.35)
TRIP = dataclasses.replace(TRIP, grid=Grid(step_km=8.0, cells=6), chargers=tuple(
    dataclasses.replace(TRIP.chargers[i % 2], name=f"c{i}", position_km=20.0 + 80.0 * i / 5)
    for i in range(6)))
"""


# ---------------------------------------------------------------------------- what is false


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
    proofs = recheck(changed)
    assert f"node {bad.number}: claims" in "\n".join(proofs.failures)


def recheck(evidence: Evidence) -> Recheck:
    proofs = Recheck(lambda used, maybe: make_instance(TRIP, used, evidence.grid, None, maybe), 6)
    proofs.run(evidence.nodes)
    return proofs


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


def test_a_bound_by_a_cutoff_is_not_infeasibility() -> None:
    tree, roots, cutoff = hand_made()
    proofs = recheck_two([dataclasses.replace(tree[0], bound=inf), *tree[1:]])
    assert proofs.failures == [
        f"node 0: claims that no plan costs less than inf; what is proved is {roots!r}"
    ]
    late = dataclasses.replace(tree[1], cutoff=cutoff, bound=inf)
    (failure,) = recheck_two([tree[0], late, tree[2]]).failures
    assert failure.startswith("node 1: claims that no plan costs less than inf")


def test_a_missing_part_counts_with_its_parents_bound() -> None:
    tree, roots, cutoff = hand_made()
    assert roots < cutoff
    assert recheck_two(tree).bound(ONE) > roots
    for gone in (1, 2):
        proofs = recheck_two([n for n in tree if n.number != gone])
        assert not proofs.failures and proofs.bound(ONE) == roots


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


def test_what_a_cutoff_cut_away_is_not_forgotten() -> None:
    """A box shrunk below 10 says nothing of plans that cost 11, whatever is proved inside."""
    tree, _, cutoff = hand_made()
    inside = min(n.bound for n in tree[1:])
    assert inside > cutoff, "the parts are bounded without a cutoff of their own"
    proofs = recheck_two(tree)
    assert not proofs.failures and proofs.bound(ONE) == cutoff
    unshrunk = [dataclasses.replace(tree[0], cutoff=inf), *tree[1:]]
    assert recheck_two(unshrunk).bound(ONE) != cutoff


@pytest.mark.parametrize("share", [0.999, 1.05])
def test_a_changed_cutoff_is_noticed(evidence: Evidence, share: float) -> None:
    """Claims at the cutoff: a lower one proves less, with a higher one nothing is closed."""
    bad = node(evidence, lambda n: closed_late(n) and not n.undecided)
    own = [n for n in evidence.nodes if n.number in (bad.number, bad.parent)]
    changed = with_node(evidence, bad.number, cutoff=share * bad.cutoff, bound=1.05 * bad.cutoff)
    holds, text = check(changed)
    assert len(own) == 2 and not holds and f"node {bad.number}: claims" in text


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
        (dataclasses.replace(driven, targets_kwh=less), "energy below the least"),
        (dataclasses.replace(driven, targets_kwh=tuple(inf for _ in less)), "does not charge"),
        (dataclasses.replace(driven, stops=(7, *driven.stops[1:])), "does not have"),
        (None, "cost: "),
    ):
        holds, text = check(dataclasses.replace(two, driven=changed))
        assert not holds and named in text, (named, text)


def test_a_file_of_another_trip_is_refused(file: Path) -> None:
    pack = dataclasses.replace(TRIP.vehicle.pack, heat_capacity_kwh_per_k=0.0901)
    other = dataclasses.replace(TRIP, vehicle=dataclasses.replace(TRIP.vehicle, pack=pack))
    for trip in (other, many_chargers(5), dataclasses.replace(TRIP, time_value_per_h=30.1)):
        with pytest.raises(InputError, match="with the same numbers"):
            audit(file, trip)
    renamed = dataclasses.replace(TRIP, name="another name")
    assert audit(file, renamed).holds


# ---------------------------------------------------------------------------- unsound steps


def first_steps(*steps: Step, how: Branch | None = None, bound: float = -inf) -> Recheck:
    """Re-check one root with these steps."""
    proofs = Recheck(lambda used, maybe: make_instance(TRIP, used, None, None, maybe), 6)
    proofs.run([ProofNode(0, -1, 0, (1,), (), (1, 1), 100.0, steps, how, bound)])
    return proofs


def relaxed() -> Step:
    instance = make_instance(TRIP, (1,))
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
    instance = make_instance(TRIP, (1,))
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


def test_an_empty_family_speaks_for_no_other() -> None:
    """Five stops of one charger do not exist; that says nothing of one stop."""
    proofs = Recheck(lambda used, maybe: make_instance(TRIP, used, None, None, maybe), 6)
    proofs.run([ProofNode(0, -1, 0, (1,), (), (5, 5), inf, (), None, inf)])
    assert not proofs.failures
    assert proofs.bound(Family((1,), (), (1, 1))) == -inf


@pytest.mark.parametrize(
    "changes",
    [{"part": 2}, {"subset": (9,)}, {"subset": (1, 1)}, {"number": -4}, {"cutoff": -inf}],
)
def test_a_node_must_be_one(changes: dict[str, Any]) -> None:
    root = ProofNode(0, -1, 0, (1,), (), (1, 1), inf, (), None, -inf)
    proofs = Recheck(lambda used, maybe: make_instance(TRIP, used, None, None, maybe), 6)
    proofs.run([dataclasses.replace(root, **changes)])
    assert len(proofs.failures) == 1 and proofs.bound(Family((1,), (), (1, 1))) == -inf


def test_numbers_and_parts_are_taken_once_and_circles_prove_nothing() -> None:
    root = ProofNode(0, -1, 0, (1,), (), (1, 1), inf, (relaxed(),), None, -inf)
    middle = float(make_box(make_instance(TRIP, (1,))).charge.mid[0])
    cut = dataclasses.replace(root, how=Branch("halve", CHARGE, middle))
    part = dataclasses.replace(root, number=1, parent=0, steps=())
    make = lambda used, maybe: make_instance(TRIP, used, None, None, maybe)  # noqa: E731
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
        proofs = Recheck(make, 6)
        proofs.run(nodes)
        assert any(text.startswith(named) for text in proofs.failures), (named, proofs.failures)
        assert proofs.bound(Family((1,), (), (1, 1))) < inf


# ---------------------------------------------------------------------------- in general


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
        proofs = Recheck(
            lambda used, maybe: make_instance(TRIP, used, evidence.grid, None, maybe), 6
        )
        proofs.run([node])
        assert proofs.bound(family) <= row.cost * (1.0 + 1e-9)
        confirmed += [] if proofs.failures else [node]
    assert not confirmed


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


def test_a_written_lie_is_found_in_the_file_too(two: Evidence, tmp_path: Path) -> None:
    save_evidence(tmp_path / "lie", dataclasses.replace(two, lower_bound=two.cost))
    found = audit(tmp_path / "lie", TWO)
    assert not found.holds and "FAILS   bound: " in str(found)
