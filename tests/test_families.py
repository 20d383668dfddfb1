"""Families of subsets: one relaxation holds the plans of all its members, parts cover a whole."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import chain, combinations
from math import comb, inf

import numpy as np
import pytest
from hard_trips import hard_trip

from benchmarks.random_trips import random_trip
from enumerate.account import Account
from enumerate.explore import Progress
from enumerate.ledger import Ledger, Outcome, Row
from enumerate.result import Status
from enumerate.search import plan
from enumerate.tree import FEW_SUBSETS, Examined, Leaf, cut_unbounded, examine, make_roots
from relax.bound import relax_subset
from relax.branch import Branch, Target, branch, decide, limit_count
from relax.certify import LowerBound, certify_lower_bound
from relax.instance import Instance, make_instance
from relax.intervals import Interval
from relax.load import load_trip
from relax.plan import Trajectory
from relax.reach import make_box, propagate
from relax.refinement import refine
from relax.relaxation import build_relaxation
from relax.relaxed_point import lift
from relax.solve import solve_cone
from relax.starts import best_start, even_start, further_starts
from relax.tighten import tighten
from relax.trip import Trip

KINDS = ("winter", "same node", "ends", "summer", "stop time")


@cache
def trip(kind: str) -> Trip:
    """A short trip with three chargers, hard in the named way."""
    out = hard_trip(kind, step_km=10.0)
    return replace(out, stop_time_h=0.9) if kind == "stop time" else out


@cache
def plans(kind: str) -> dict[tuple[int, ...], Trajectory]:
    """One feasible trajectory of every subset that has one."""
    out = {}
    for size in range(4):
        for subset in combinations(range(3), size):
            instance = make_instance(trip(kind), subset)
            relaxed = relax_subset(instance)
            if relaxed.infeasible:
                continue
            bound = -1e9 if relaxed.lower_bound is None else relaxed.lower_bound
            starts = chain([best_start(instance, relaxed.point, bound)], further_starts(instance))
            for found in (refine(instance, start) for start in starts):
                if found.feasible and float(found.trajectory.violation.max()) <= 1e-9:
                    out[subset] = found.trajectory
                    break
    return out


def family(kind: str, used: tuple[int, ...], maybe: tuple[int, ...]) -> Instance:
    return make_instance(trip(kind), used, undecided=maybe)


FAMILIES = [((), (0, 1, 2)), ((1,), (0, 2)), ((0,), (2,)), ((0, 2), (1,)), ((), (1,))]


@pytest.mark.parametrize("kind", KINDS)
def test_every_plan_lies_in_the_relaxation_of_its_families_at_its_cost(kind: str) -> None:
    seen = 0
    for used, maybe in FAMILIES:
        instance = family(kind, used, maybe)
        box = make_box(instance)
        members = [s for s in plans(kind) if set(used) <= set(s) <= {*used, *maybe}]
        if not members:
            continue
        assert not box.empty
        for subset in members:
            trajectory = plans(kind)[subset]
            within = limit_count(box, len(subset), len(subset))
            for narrow in (box, within, propagate(instance, box)):
                program = build_relaxation(instance, narrow)
                x = lift(instance, program, trajectory, subset)
                cost = float(program.q @ x) + program.constant
                assert cost == pytest.approx(trajectory.cost, rel=1e-9)
                assert program.slack(x).min() > -1e-6, (used, maybe, subset)
                assert np.all(x >= program.l - 1e-6) and np.all(x <= program.u + 1e-6)
                seen += 1
    assert seen > 6


@pytest.mark.parametrize("kind", KINDS)
def test_a_family_is_bounded_below_its_members_and_a_part_above_the_whole(kind: str) -> None:
    for used, maybe in FAMILIES:
        whole = relax_subset(family(kind, used, maybe))
        members = [s for s in plans(kind) if set(used) <= set(s) <= {*used, *maybe}]
        best = min((plans(kind)[s].cost for s in members), default=inf)
        if whole.infeasible:
            assert not members
            continue
        assert whole.lower_bound is not None and whole.lower_bound <= best + 1e-6
        for subset in members:
            one = relax_subset(make_instance(trip(kind), subset))
            assert one.lower_bound is not None
            assert one.lower_bound >= whole.lower_bound - 1e-3 * abs(whole.lower_bound)


def test_an_optional_stop_that_cannot_be_used_is_named() -> None:
    """A charger that gives nothing in the time allowed: the family drives past it."""
    base = trip("winter")
    slow = replace(base.chargers[1], power_kw=2.0, max_dwell_h=1e-3)
    instance = make_instance(
        replace(base, chargers=(base.chargers[0], slow, base.chargers[2])), (0,), undecided=(1,)
    )
    box = make_box(instance)
    for _ in range(3):
        box = propagate(instance, box)
    assert not box.empty
    assert box.unusable.tolist() == [False, True]
    assert box.dwell.hi[1].max() < 0.0, "what the other cells need is longer than the stay"
    program = build_relaxation(instance, box)
    assert np.all(program.l <= program.u)
    assert isinstance(certify_lower_bound(program, solve_cone(program).z), LowerBound)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "how",
    [
        Branch("use", stop=1),
        Branch("count", at=1),
        Branch("halve", Target("energy", 6, "energy"), 30.0),
        Branch("halve", Target("temperature", 6, "temperature"), -5.0),
    ],
    ids=["use", "count", "energy", "temperature"],
)
def test_the_parts_of_a_box_hold_every_plan_of_the_whole(kind: str, how: Branch) -> None:
    whole = make_box(family(kind, (), (0, 1, 2)))
    parts = branch(whole, how)
    for subset, trajectory in plans(kind).items():
        held = 0
        for first, part in zip((True, False), parts, strict=True):
            used: tuple[int, ...] = ()
            maybe: tuple[int, ...] = (0, 1, 2)
            if how.kind == "use":
                stop = family(kind, (), (0, 1, 2)).stops[how.stop].charger
                used, maybe = ((stop,) if first else ()), tuple(c for c in maybe if c != stop)
            if not set(used) <= set(subset) <= {*used, *maybe}:
                continue
            instance = family(kind, used, maybe)
            if part.empty or not part.count[0] <= len(subset) <= part.count[1]:
                continue
            x_in = [
                bool(np.all(i.lo - 1e-6 <= v) and np.all(v <= i.hi + 1e-6))
                for i, v in (
                    (part.energy, trajectory.energy_kwh),
                    (part.temperature, trajectory.temperature_c),
                )
            ]
            if all(x_in):
                program = build_relaxation(instance, part)
                held += bool(
                    program.slack(lift(instance, program, trajectory, subset)).min() > -1e-6
                )
        assert held >= 1, (subset, how.kind)


def test_leaving_a_stop_out_gives_the_box_of_the_smaller_family() -> None:
    whole = make_box(family("winter", (1,), (0, 2)))
    left = decide(whole, 0, False)
    small = make_box(family("winter", (1,), (2,)))
    assert left.optional.tolist() == small.optional.tolist()
    assert left.step_stop.tolist() == small.step_stop.tolist()
    for name in ("charge", "leave", "stop_temperature", "after"):
        wide, tight = getattr(left, name), getattr(small, name)
        assert np.all(wide.lo <= tight.lo + 1e-6) and np.all(wide.hi >= tight.hi - 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_closed_family_holds_no_plan_below_its_cutoff(kind: str) -> None:
    best = min(t.cost for t in plans(kind).values())
    instance = family(kind, (), (0, 1, 2))
    for share in (0.5, 0.9, 1.1):
        done = tighten(instance, make_box(instance), share * best)
        assert done.bound <= best + 1e-6
        assert not (done.closed and share > 1.0)


@pytest.mark.parametrize("unbounded", [False, True])
def test_a_tree_cut_to_the_end_covers_every_subset_once_and_bounds_the_best_plan(
    unbounded: bool,
) -> None:
    made = trip("winter")
    best = min(t.cost for t in plans("winter").values())
    account = Account(3, keep_proofs=True)
    account.plant(make_roots(3))
    cutoff = 0.98 * best

    def make(used: tuple[int, ...], maybe: tuple[int, ...]) -> Instance:
        return make_instance(made, used, undecided=maybe)

    without = 0
    for _ in range(300):
        leaves = account.take(1, cutoff)
        if not leaves:
            break
        done = cut_unbounded(make, leaves[0], cutoff) if unbounded else None
        without += done is not None
        account.enter(done or examine(make, leaves[0], cutoff), cutoff)
    assert bool(without) == unbounded
    assert account.open_bound == pytest.approx(cutoff)
    ledger = Ledger(3, tuple(account.rows({}, cutoff)))  # raises if a subset is missing or twice
    assert sum(row.size for row in ledger.rows) == 8
    for subset in plans("winter"):
        row = next(r for r in ledger.rows if r.holds(subset))
        assert row.outcome is Outcome.BOUNDED
    assert len({node.number for node in account.proofs}) == len(account.proofs)


def test_a_small_family_far_from_the_cutoff_is_cut_without_a_program() -> None:
    def make(used: tuple[int, ...], maybe: tuple[int, ...]) -> Instance:
        return make_instance(trip("winter"), used, undecided=maybe)

    leaf = Leaf((1,), (0, 2), 90.0, None, (2, 3), number=7)
    assert leaf.n_subsets == 3 == Row((1,), Outcome.BOUNDED, undecided=(0, 2), count=(2, 3)).size
    done = cut_unbounded(make, leaf, 100.0)
    assert done is not None and done.programs == 0 and not done.steps and not done.closed
    assert sum(part.n_subsets for part in done.parts) == leaf.n_subsets
    assert {part.bound for part in done.parts} == {90.0}
    # wanted: a bound that may close it, that suggests stops, of one subset, or of many
    assert cut_unbounded(make, replace(leaf, bound=99.5), 100.0) is None
    assert cut_unbounded(make, leaf, inf) is None
    assert cut_unbounded(make, Leaf((0, 1), (), 90.0, None, (2, 2)), 100.0) is None
    # holds nothing: the audit would close it and look for no parts
    assert cut_unbounded(make, replace(leaf, undecided=(0,), count=(3, 3)), 100.0) is None
    box = make_box(make((1,), (0, 2)))
    empty = replace(box, charge=Interval(box.charge.hi + 1.0, box.charge.lo))
    assert empty.empty and cut_unbounded(make, replace(leaf, box=box), 100.0) is not None
    assert cut_unbounded(make, replace(leaf, box=empty), 100.0) is None
    many_more = Leaf((), tuple(range(6)), 90.0, None, (0, 6))
    assert many_more.n_subsets == 64 > FEW_SUBSETS
    assert cut_unbounded(make, many_more, 100.0) is None


def test_a_row_counts_the_members_of_its_family() -> None:
    row = Row((3,), Outcome.BOUNDED, undecided=(0, 1, 2, 5), count=(2, 3))
    members = [
        tuple(sorted((3, *more))) for size in range(5) for more in combinations((0, 1, 2, 5), size)
    ]
    assert row.size == comb(4, 1) + comb(4, 2) == sum(row.holds(s) for s in members)
    smaller = replace(row, without=((1, 3),))
    assert smaller.size == row.size - 1 and not smaller.holds((1, 3))


@pytest.mark.parametrize(
    "rows",
    [
        (Row((), Outcome.BOUNDED, undecided=(0, 1)), Row((0,), Outcome.BOUNDED)),
        (
            Row((), Outcome.BOUNDED, undecided=(1,)),
            Row((0,), Outcome.BOUNDED, undecided=(1,), count=(0, 1)),
        ),
        (
            Row((), Outcome.BOUNDED, undecided=(0, 1), count=(0, 1)),
            Row((0,), Outcome.BOUNDED, undecided=(1,), count=(1, 2), without=((0, 1),)),
        ),
    ],
    ids=["twice", "missing", "crossing"],
)
def test_families_that_overlap_or_leave_a_gap_are_refused(rows: tuple[Row, ...]) -> None:
    with pytest.raises(ValueError, match="accounts for"):
        Ledger(2, rows)


def test_many_chargers_give_the_plan_that_brute_force_gives() -> None:
    wide = many()
    brute = plan(wide, prune=False)
    tree = plan(wide, gap=0.02)
    assert brute.plan is not None and tree.plan is not None
    assert tree.cost <= brute.cost * 1.005
    assert tree.lower_bound <= min(tree.transcribed_cost, brute.transcribed_cost) + 1e-6
    assert tree.gap <= 0.0201 and tree.ledger.counts()["total"] == 64
    assert len(tree.ledger.rows) < 64
    assert plan(wide, gap=0.02, workers=2).ledger.counts() == tree.ledger.counts()


def many() -> Trip:
    """A trip with more chargers than are handled one subset at a time."""
    base = trip("winter")
    more = tuple(
        replace(base.chargers[i % 3], name=f"m{i}", position_km=20.0 + 15.0 * i,
                price_per_kwh=0.35 + 0.05 * ((7 * i) % 5))
        for i in range(6)
    )  # fmt: skip
    return replace(base, chargers=more)


@pytest.mark.parametrize("calls", [1, 3, 6, 14, 20])
@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_leaves_every_subset_accounted_for(calls: int, workers: int) -> None:
    seen = 0

    def stop(progress: Progress) -> None:
        nonlocal seen
        seen += 1
        if seen == calls:
            raise KeyboardInterrupt

    result = plan(many(), gap=0.001, progress=stop, workers=workers)
    assert result.interrupted == "interrupted"
    assert result.ledger.counts()["total"] == 64
    assert result.lower_bound <= result.transcribed_cost


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.5])
def test_a_time_limit_leaves_a_valid_bound(seconds: float) -> None:
    result = plan(many(), gap=1e-5, time_limit_s=seconds)
    assert result.interrupted == "time limit reached"
    assert result.ledger.counts()["total"] == 64
    assert result.lower_bound <= result.transcribed_cost


def test_no_plan_for_many_chargers_is_a_proof() -> None:
    result = plan(replace(many(), start_soc=0.08))
    assert result.status is Status.INFEASIBLE
    assert result.ledger.counts()["infeasible"] == 64 and result.diagnosis is not None


def test_leaves_carry_their_bound_to_their_parts() -> None:
    root = make_roots(3)[0]
    done = examine(lambda a, b: make_instance(trip("winter"), a, undecided=b), root, 1e6)
    assert all(part.bound == done.bound for part in done.parts)
    assert isinstance(done.leaf, Leaf) and done.leaf.number == -1


def test_a_stop_that_cannot_be_used_stays_out_of_the_way() -> None:
    """Its intervals have crossed: further sweeps leave them, and the relaxation is built."""
    trip = random_trip(1137)  # two chargers at the start, where the battery is too full
    for used in ((), (0,)):
        maybe = tuple(i for i in range(len(trip.chargers)) if i not in used)
        instance = make_instance(trip, used, undecided=maybe)
        box = make_box(instance)
        never = box.unusable
        assert never.any() and not box.empty
        before = box.charge
        for _ in range(30):
            box = propagate(instance, box)
        assert box.charge.hi[never] == pytest.approx(before.hi[never], abs=1e-4)
        program = build_relaxation(instance, box)
        assert np.all(program.l <= program.u)
        bound = certify_lower_bound(program, solve_cone(program).z)
        assert isinstance(bound, LowerBound)


def test_a_part_without_members_says_nothing_of_the_subset_it_is_left_with() -> None:
    """Two chargers used, none undecided, three stops asked for: not the subset of those two."""
    account = Account(3, keep_proofs=False)
    leaf = Leaf((0, 1), (), 10.0, None, (3, 3), number=7)
    done = Examined(leaf, inf, True, True, None, (), (), (), None, 0)
    account.enter(done, cutoff=100.0)
    assert account.rows({}, cutoff=100.0) == []
    known = Row((0, 1), Outcome.PLANNED, 50.0, 40.0)
    assert account.rows({(0, 1): known}, cutoff=100.0) == [known]


def test_a_battery_too_weak_for_the_road_has_a_box() -> None:
    """Steps whose power varies more than the pack can serve at all: largest load below zero."""
    trip = random_trip(783)
    instance = make_instance(trip, ())
    box = make_box(instance)
    assert box.empty or np.isfinite(box.power.hi).all()


def test_stays_and_charges_of_a_family_are_bounded_and_hold_every_cheaper_plan() -> None:
    made = load_trip("paper-400km")
    instance = make_instance(made, (), undecided=(0, 1, 2))
    cutoff = 320.0
    done = tighten(instance, make_box(instance), cutoff)
    assert not done.closed
    assert {s.target.name for s in done.steps if s.target} == {"stay", "charge"}
    assert done.box.stay.hi.max() < 1.0 < make_box(instance).stay.hi.min()
    assert np.all(done.box.charge.hi < make_box(instance).charge.hi - 10.0)
    found = 0
    for subset in ((1,), (0, 1), (1, 2), (0, 2)):
        fixed = make_instance(made, subset)
        refined = refine(fixed, even_start(fixed))
        if not refined.feasible or refined.trajectory.cost > cutoff:
            continue
        found += 1
        for charger, stop in zip(subset, refined.trajectory.stops, strict=True):
            assert float(stop.dwell_h.sum()) <= done.box.stay.hi[charger] + 1e-6
            assert stop.energy_kwh[-1] - stop.energy_kwh[0] <= done.box.charge.hi[charger] + 1e-6
    assert found >= 1
    free = tighten(instance, make_box(instance), np.inf)  # without a plan there is no cutoff
    assert not any(s.kind == "shrink" for s in free.steps)
