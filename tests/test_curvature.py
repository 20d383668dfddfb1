"""Curvature verdicts against hand-made tables with known answers, against brute force on random
ones (chords between random points, envelopes by linear programming), and on the shipped cars."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from trips import small_trip

from relax.curvature import Shape, Verdict, judge_table1, judge_table2, judge_vehicle
from relax.load import load_vehicle, shipped_vehicles
from relax.maps import Table1, Table2

Array = npt.NDArray[np.float64]
AFFINE, CONVEX, CONCAVE, NEITHER = Shape.AFFINE, Shape.CONVEX, Shape.CONCAVE, Shape.NEITHER


def joint(table: Table2, reciprocal: bool = False) -> Verdict:
    """The verdict in both variables on the whole domain."""
    found = judge_table2(table, axes=("x", "y"), reciprocal=reciprocal)
    return next(v for v in found if v.along == "x and y" and v.whole)


@pytest.mark.parametrize(
    ("f", "shape", "violation", "where"),
    [
        ([0, 1, 2, 3], AFFINE, 0.0, None),
        ([5, 5, 5, 5], AFFINE, 0.0, None),
        ([0, 0, 1, 3], CONVEX, 0.0, None),
        ([0, 2, 3, 3], CONCAVE, 0.0, None),
        ([0, 1, 0, 1], NEITHER, 1.0, (1.0,)),  # the chord from 0 to 2 passes 1 below node 1
        ([0, 0, 0, 1, 0.5, 0], NEITHER, 2 / 3, (2.0,)),  # the chord from 0 to 3 passes 2/3 above
    ],
)
def test_one_variable(
    f: list[float], shape: Shape, violation: float, where: tuple[float, ...] | None
) -> None:
    verdict = judge_table1(Table1(np.arange(len(f)), f))[0]
    assert verdict.shape is shape and verdict.whole
    assert verdict.violation == pytest.approx(violation, abs=1e-12)
    if where is not None:
        assert verdict.where == where


def test_an_uneven_grid_is_judged_by_slopes_not_by_differences() -> None:
    assert judge_table1(Table1([0, 1, 4], [0, 1, 3.5]))[0].shape is CONCAVE
    assert judge_table1(Table1([0, 1, 4], [0, 1, 4.0]))[0].shape is AFFINE
    assert judge_table1(Table1([0, 1, 4], [0, 1, 4.5]))[0].shape is CONVEX


def test_the_largest_part_with_a_shape() -> None:
    whole, part = judge_table1(Table1([0, 1, 2, 3, 10], [0, 1, 0, 1, 10]), axis="T [C]")
    assert whole.shape is NEITHER and not part.whole
    assert part.shape is CONVEX and (part.domain[0].lo, part.domain[0].hi) == (1.0, 10.0)
    assert str(part) == "table in T: convex on T [C] 1 .. 10"


@pytest.mark.parametrize(
    ("f", "shape"),
    [
        ([[0, 1], [1, 2]], AFFINE),
        ([[0, 0], [0, 1]], NEITHER),  # x * y
        ([[0, 1, 2], [1, 2, 3], [3, 4, 5]], CONVEX),  # convex in x, affine in y
        ([[2, 2, 0], [3, 3, 1], [3, 3, 1]], CONCAVE),  # concave + concave
        ([[0, 1, 0], [1, 2, 1], [3, 4, 3]], NEITHER),  # convex + concave
        ([[0, 1, 3], [0, 1, 3], [0, 1, 3.001]], NEITHER),  # one cell with a small cross term
    ],
)
def test_two_variables_jointly(f: list[list[float]], shape: Shape) -> None:
    table = Table2(np.arange(len(f)), np.arange(len(f[0])), f)
    assert joint(table).shape is shape
    assert joint(Table2(table.x, table.y, -table.f)).shape is {
        CONVEX: CONCAVE, CONCAVE: CONVEX,
    }.get(shape, shape)  # fmt: skip


def test_a_product_is_affine_by_axis_and_neither_jointly() -> None:
    found = judge_table2(Table2([0, 2], [0, 3], [[0, 0], [0, 6]]))
    assert [v.shape for v in found[:2]] == [AFFINE, AFFINE]
    assert found[2].shape is NEITHER
    assert found[2].violation == pytest.approx(1.5)  # a quarter of the cross term, in the middle
    assert found[2].where == (1.0, 1.5)


def test_convex_by_axis_is_not_convex_jointly() -> None:
    """f = x^2 + y^2 + 4xy on a grid: convex in each variable, a saddle along x = -y."""
    x = np.linspace(-1.0, 1.0, 5)
    f = x[:, None] ** 2 + x**2 + 4.0 * np.outer(x, x)
    by_x, by_y, both = judge_table2(Table2(x, x, f))[:3]
    assert (by_x.shape, by_y.shape, both.shape) == (CONVEX, CONVEX, NEITHER)


def test_reciprocals() -> None:
    line = Table1([0, 1], [1, 2])
    assert judge_table1(line, reciprocal=True)[0].shape is CONVEX
    assert judge_table1(Table1([0, 1, 2], [1, 2, 2.5]), reciprocal=True)[0].shape is CONVEX
    # a convex kink of the map is a concave one of its reciprocal
    kinked = judge_table1(Table1([0, 1, 2], [2, 2.01, 4]), reciprocal=True)[0]
    assert kinked.shape is NEITHER
    assert judge_table1(Table1([0, 1], [3, 3]), reciprocal=True)[0].shape is AFFINE
    # defined where positive only
    (part,) = judge_table1(Table1([0, 1, 2], [0, 1, 2]), reciprocal=True)
    assert (part.domain[0].lo, part.shape) == (1.0, CONVEX)
    assert judge_table1(Table1([0, 1], [0, 0]), reciprocal=True) == ()
    # 1/(u v) is convex for affine u, v > 0; not so for every bilinear function
    product = Table2([0, 1], [0, 1], np.outer([1, 2], [3, 1]))
    assert joint(product, reciprocal=True).shape is CONVEX
    saddle = Table2([0, 1], [0, 1], [[2.0, 1.0], [2.1, 1.6]])
    assert joint(saddle, reciprocal=True).shape is NEITHER


def break_by_chords(table: Table2, reciprocal: bool, rng: np.random.Generator) -> tuple[float, ...]:
    """Largest violation of convexity and of concavity along random short and long chords."""
    lo, hi = np.array([table.x[0], table.y[0]]), np.array([table.x[-1], table.y[-1]])
    a = rng.uniform(lo, hi, (4000, 2))
    near = np.clip(a + rng.normal(0.0, 0.05, a.shape) * (hi - lo), lo, hi)
    b = np.where(rng.random((4000, 1)) < 0.5, near, rng.uniform(lo, hi, a.shape))
    values = [table(*p.T) for p in (a, 0.5 * (a + b), b)]
    f, g, h = (1.0 / v if reciprocal else v for v in values)
    bend = g - 0.5 * (f + h)
    return float(bend.max()), float(-bend.min())


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), kind=st.integers(0, 4), reciprocal=st.booleans())
def test_verdicts_agree_with_chords(seed: int, kind: int, reciprocal: bool) -> None:
    """Convex: no chord contradicts. Not convex by a clear margin: some chord does."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.5, 1.5, 4))
    y = np.cumsum(rng.uniform(0.5, 1.5, 3))
    g, h = np.square(x - x.mean()), np.square(y - y.mean())
    f = {
        0: 2.0 + g[:, None] + h,
        1: 20.0 - g[:, None] - h,
        2: 1.0 + np.outer(x, y),
        3: rng.uniform(1.0, 3.0, (4, 3)),
        4: 1.0 + g[:, None] + 2.0 * y,
    }[kind]
    table = Table2(x, y, f)
    verdict = joint(table, reciprocal)
    shape = verdict.shape
    above, below = break_by_chords(table, reciprocal, rng)
    if shape in (CONVEX, AFFINE):
        assert above < 1e-9
    if shape in (CONCAVE, AFFINE):
        assert below < 1e-9
    # chords may miss a violation in a corner of one cell: only a clear one must be found
    clear = (
        shape is NEITHER and verdict.violation > 1e-2 * np.abs(1.0 / f if reciprocal else f).max()
    )
    if shape is CONCAVE or clear:
        assert above > 1e-9
    if shape is CONVEX or clear:
        assert below > 1e-9


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_the_violation_is_the_distance_to_the_envelope(seed: int) -> None:
    """Oracle: the envelope of a bilinear table is that of its nodes, a linear program."""
    rng = np.random.default_rng(seed)
    x, y = np.cumsum(rng.uniform(0.5, 1.5, 4)), np.cumsum(rng.uniform(0.5, 1.5, 3))
    table = Table2(x, y, rng.uniform(0.0, 3.0, (4, 3)))
    verdict = joint(table)
    assert verdict.shape is NEITHER
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    sign = 1.0 if verdict.nearest is CONVEX else -1.0

    def gap(point: tuple[float, ...], sign: float) -> float:
        rows = np.vstack([grid.T, np.ones(len(grid))])
        found = linprog(sign * table.f.ravel(), A_eq=rows, b_eq=[*point, 1.0])
        return float(sign * table.at(*point) - found.fun)

    assert gap(verdict.where, sign) == pytest.approx(verdict.violation, abs=1e-8)
    # no node is farther, and the other envelope has a point at least as far away
    assert max(gap(tuple(p), sign) for p in grid) <= verdict.violation + 1e-8
    fine_x, fine_y = (np.sort([*v, *(0.5 * (a + b) for a, b in pairwise(v))]) for v in (x, y))
    other = [gap((a, b), -sign) for a in fine_x for b in fine_y]
    assert max(other) >= verdict.violation - 1e-8


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_one_variable_violation_is_the_largest_chord_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, f = np.cumsum(rng.uniform(0.2, 2.0, 6)), rng.normal(size=6)

    def worst(sign: float) -> float:
        gaps = [
            sign * (f[j] - np.interp(x[j], x[[i, k]], f[[i, k]]))
            for i in range(6) for k in range(i + 2, 6) for j in range(i + 1, k)
        ]  # fmt: skip
        return max(*gaps, 0.0)

    verdict = judge_table1(Table1(x, f))[0]
    assert verdict.violation == pytest.approx(min(worst(1.0), worst(-1.0)), abs=1e-12)
    assert (verdict.shape is NEITHER) == (min(worst(1.0), worst(-1.0)) > 1e-9)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_parts_have_their_shape_and_are_largest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, f = np.arange(8.0), rng.integers(0, 4, 8).astype(float)
    found = judge_table1(Table1(x, f))
    if found[0].shape is not NEITHER:
        assert len(found) == 1
        return
    part = found[1].domain[0]
    lengths = [
        k - i for i in range(8) for k in range(i + 1, 8)
        if judge_table1(Table1(x[i : k + 1], f[i : k + 1]))[0].shape is not NEITHER
    ]  # fmt: skip
    inside = (x >= part.lo) & (x <= part.hi)
    assert judge_table1(Table1(x[inside], f[inside]))[0].shape is found[1].shape
    assert part.hi - part.lo == max(lengths)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_parts_of_tables_in_two_variables_are_largest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, f = np.arange(4.0), rng.integers(0, 3, (4, 4)).astype(float)
    spans = [slice(i, k + 1) for i in range(4) for k in range(i + 1, 4)]
    parts = {v.along: v for v in judge_table2(Table2(x, x, f)) if not v.whole}
    best = dict.fromkeys(parts, 0.0)
    for a in spans:
        for b in spans:
            size = (x[a][-1] - x[a][0]) * (x[b][-1] - x[b][0])
            for v in judge_table2(Table2(x[a], x[b], f[a, b])):
                if v.whole and v.shape is not NEITHER and v.along in best:
                    best[v.along] = max(best[v.along], size)
    for along, v in parts.items():
        on_x, on_y = v.domain
        assert (on_x.hi - on_x.lo) * (on_y.hi - on_y.lo) == best[along]


MAPS = {"U^2", "R", "charge limit", "discharge limit", "cop", "1/cop", "1/charge limit"}


@pytest.mark.parametrize("name", shipped_vehicles())
def test_every_map_of_a_shipped_vehicle_is_judged(name: str) -> None:
    vehicle = load_vehicle(name, {"heat_pump_kw": 1.0})
    found = judge_vehicle(vehicle)
    assert {v.map for v in found} == MAPS
    for map_ in MAPS:
        along = [v.along for v in found if v.map == map_ and v.whole]
        assert along in ([["E", "T", "E and T"]] if "limit" in map_ else [["E"], ["T"]])
    for v in found:
        assert (v.violation > 1e-8) == (v.shape is NEITHER), str(v)
        assert all(a.lo <= w <= a.hi for a, w in zip(v.domain, v.where, strict=True))
        assert len(str(v)) < 97
    # the reason for envelopes: no shipped car has a jointly concave charge limit
    joint = [v for v in found if v.map == "charge limit" and v.along == "E and T" and v.whole]
    assert joint[0].shape is NEITHER and joint[0].violation > 1.0
    without = judge_vehicle(load_vehicle(name, {"heat_pump_kw": 0.0}))
    assert {v.map for v in without} == MAPS - {"cop", "1/cop"}


def test_known_shapes_of_the_paper_car_and_of_the_small_car() -> None:
    found = {(v.map, v.along): v for v in judge_vehicle(load_vehicle("paper-2022")) if v.whole}
    assert found["U^2", "E"].shape is AFFINE  # its OCV is affine in SoC: lossless in E
    assert found["R", "T"].shape is CONVEX
    assert found["cop", "T"].shape is CONVEX
    small = {(v.map, v.along): v for v in judge_vehicle(small_trip().vehicle) if v.whole}
    assert small["U^2", "E"].shape is CONVEX  # 330, 365, 410 V: the second half is steeper
    assert small["R", "T"].shape is CONVEX
    assert small["charge limit", "E"].shape is CONCAVE
    assert small["charge limit", "E and T"].shape is NEITHER
