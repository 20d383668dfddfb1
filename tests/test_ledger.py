"""Every subset is accounted for once; tolerances are what they say."""

from __future__ import annotations

from itertools import chain, combinations
from math import inf

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from enumerate.gap import is_close, is_closed, relative_gap
from enumerate.ledger import Ledger, Outcome, Row
from enumerate.subset import Subset, all_subsets

FAST = settings(max_examples=60, deadline=None, derandomize=True)


@pytest.mark.parametrize("n", range(9))
def test_every_subset_comes_once_fewest_stops_first(n: int) -> None:
    got = list(all_subsets(n))
    power_set = {frozenset(i for i in range(n) if mask >> i & 1) for mask in range(2**n)}
    assert len(got) == 2**n
    assert {frozenset(s) for s in got} == power_set
    assert [len(s) for s in got] == sorted(len(s) for s in got)
    assert all(list(s) == sorted(s) for s in got)
    chained = chain.from_iterable(combinations(range(n), k) for k in range(n + 1))
    assert got == list(chained)


def full(n: int) -> tuple[Row, ...]:
    return tuple(Row(s, Outcome.UNPROVED, lower_bound=float(len(s))) for s in all_subsets(n))


def test_a_complete_ledger_is_accepted_in_any_order() -> None:
    rows = full(3)
    assert Ledger(3, rows).lower_bound == 0.0
    assert Ledger(3, rows[::-1]).counts()["total"] == 8


@pytest.mark.parametrize(
    "rows",
    [
        full(2)[:-1],
        (*full(2), full(2)[0]),
        (*full(2)[:-1], full(2)[0]),
        (*full(2)[:-1], Row((1, 0), Outcome.UNPROVED)),
        (*full(2)[:-1], Row((0, 0), Outcome.UNPROVED)),
        (*full(2)[:-1], Row((0, 2), Outcome.UNPROVED)),
        (*full(2)[:-1], Row((-1, 0), Outcome.UNPROVED)),
        (),
        full(3),
    ],
)
def test_a_ledger_with_a_subset_missing_twice_or_foreign_is_refused(rows: tuple[Row, ...]) -> None:
    with pytest.raises(ValueError, match="accounts for"):
        Ledger(2, rows)


def test_the_bound_is_the_least_of_all_rows_but_the_infeasible() -> None:
    rows = [
        Row((), Outcome.INFEASIBLE, lower_bound=-5.0),
        Row((0,), Outcome.PLANNED, 7.0, 6.5),
        Row((1,), Outcome.BOUNDED, inf, 7.2),
        Row((0, 1), Outcome.UNPROVED, inf, 6.0),
    ]
    assert Ledger(2, tuple(rows)).lower_bound == 6.0
    rows[3] = Row((0, 1), Outcome.UNPROVED)
    assert Ledger(2, tuple(rows)).lower_bound == -inf
    rows[3] = Row((0, 1), Outcome.BOUNDED, inf, 9.0)
    assert Ledger(2, tuple(rows)).lower_bound == 6.5
    counts = Ledger(2, tuple(rows)).counts()
    assert counts == {"total": 4, "planned": 1, "bounded": 2, "infeasible": 1, "unproved": 0}
    nothing = Ledger(0, (Row((), Outcome.INFEASIBLE),))
    assert nothing.lower_bound == inf


@FAST
@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_gaps_are_relative_and_never_negative(cost: float, bound: float) -> None:
    gap = relative_gap(cost, bound)
    assert gap >= 0.0
    if bound >= cost:
        assert gap == 0.0
    else:
        assert gap * max(abs(cost), 1.0) == pytest.approx(cost - bound)
    assert is_closed(bound, cost) == (gap == 0.0)


def test_gaps_without_a_plan_or_a_bound_are_infinite() -> None:
    assert relative_gap(inf, 3.0) == inf
    assert relative_gap(3.0, -inf) == inf
    assert relative_gap(inf, inf) == inf
    assert relative_gap(0.5, 0.25) == 0.25  # near zero the gap is absolute
    assert is_closed(inf, 3.0)
    assert not is_closed(-inf, 3.0)


def test_close_is_one_percent() -> None:
    assert is_close(100.9, 100.0)
    assert not is_close(101.2, 100.0)
    assert is_close(-100.0, -99.5)


def test_subsets_are_tuples_of_indices() -> None:
    subset: Subset = (0, 2)
    assert subset in set(all_subsets(3))
