"""Tables interpolate (multi)linearly, refuse to extrapolate, and have usable slopes at kinks."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relax.errors import DomainError
from relax.maps import WINDOW, Table1, Table2

Array = npt.NDArray[np.float64]
FAST = settings(max_examples=60, deadline=None, derandomize=True)

share = st.floats(0.0, 1.0)
value = st.floats(-100.0, 100.0)


@st.composite
def axes(draw: st.DrawFn, least: int = 2) -> Array:
    """Nodes with unequal spacing between 0.05 and 10."""
    steps = draw(st.lists(st.floats(0.05, 10.0), min_size=least - 1, max_size=7))
    return draw(value) + np.concatenate([[0.0], np.cumsum(steps)])


@st.composite
def tables1(draw: st.DrawFn) -> Table1:
    x = draw(axes())
    return Table1(x, draw(st.lists(value, min_size=x.size, max_size=x.size)))


@st.composite
def tables2(draw: st.DrawFn) -> Table2:
    x, y = draw(axes()), draw(axes())
    size = x.size * y.size
    f = np.array(draw(st.lists(value, min_size=size, max_size=size))).reshape(x.size, y.size)
    return Table2(x, y, f)


def inside(grid: Array, w: float) -> float:
    return float(min(max(grid[0] + w * (grid[-1] - grid[0]), grid[0]), grid[-1]))


def bilinear(table: Table2, x: float, y: float) -> float:
    """Interpolate along y in every row, then along x: written apart from the code."""
    column = [np.interp(y, table.y, row) for row in table.f]
    return float(np.interp(x, table.x, column))


@FAST
@given(tables1(), share)
def test_table1_is_the_linear_interpolant_in_every_reading(table: Table1, w: float) -> None:
    x = inside(table.x, w)
    expected = float(np.interp(x, table.x, table.f))
    for got in (table.at(x), float(table(x)), table.clamped()(x), float(table.jet(x)[0])):
        assert got == pytest.approx(expected, rel=1e-11, abs=1e-10)
    np.testing.assert_allclose(table(table.x), table.f, rtol=1e-13, atol=1e-13)
    nodes = [table.at(float(node)) for node in table.x]
    np.testing.assert_allclose(nodes, table.f, rtol=1e-11, atol=1e-11)


@FAST
@given(tables2(), share, share)
def test_table2_is_the_bilinear_interpolant_in_every_reading(
    table: Table2, w: float, z: float
) -> None:
    x, y = inside(table.x, w), inside(table.y, z)
    expected = bilinear(table, x, y)
    for got in (table.at(x, y), float(table(x, y)), table.clamped()(x, y)):
        assert got == pytest.approx(expected, rel=1e-10, abs=1e-9)
    grid_x, grid_y = np.meshgrid(table.x, table.y, indexing="ij")
    np.testing.assert_allclose(table(grid_x, grid_y), table.f, rtol=1e-12, atol=1e-12)


@FAST
@given(tables2(), share, share, share)
def test_table2_is_linear_along_each_variable_inside_a_cell(
    table: Table2, w: float, z: float, s: float
) -> None:
    x0, x1 = float(table.x[0]), float(table.x[1])
    y = inside(table.y, z)
    x = x0 + w * (x1 - x0)
    chord = (1.0 - w) * table.at(x0, y) + w * table.at(x1, y)
    assert table.at(x, y) == pytest.approx(chord, rel=1e-10, abs=1e-9)
    y0, y1 = float(table.y[-2]), float(table.y[-1])
    chord = (1.0 - s) * table.at(x, y0) + s * table.at(x, y1)
    assert table.at(x, y0 + s * (y1 - y0)) == pytest.approx(chord, rel=1e-10, abs=1e-9)


@FAST
@given(tables1(), st.floats(1e-6, 1e3))
def test_no_table_extrapolates(table: Table1, beyond: float) -> None:
    width = table.hi - table.lo
    surface = Table2(table.x, table.x, np.outer(table.f, np.ones(table.x.size)))
    middle = 0.5 * (table.lo + table.hi)
    for x, end in (
        (table.hi + beyond * width, float(table.f[-1])),
        (table.lo - beyond * width, float(table.f[0])),
    ):
        with pytest.raises(DomainError, match="outside the table"):
            table.at(x)
        with pytest.raises(DomainError, match="outside the table"):
            table(np.array([middle, x]))
        with pytest.raises(DomainError, match="outside the table"):
            surface.at(x, middle)
        with pytest.raises(DomainError, match="outside the table"):
            surface.at(middle, x)
        with pytest.raises(DomainError, match="outside the table"):
            surface([middle, middle], [middle, x])
        assert table.clamped()(x) == end
        assert surface.clamped()(x, middle) == pytest.approx(end, rel=1e-12, abs=1e-12)


def test_rounding_at_the_ends_is_not_extrapolation() -> None:
    table = Table1([0.0, 10.0], [1.0, 3.0])
    assert table.at(10.0 + 5e-9) == pytest.approx(3.0, abs=1e-8)
    assert float(table(-5e-9)) == 1.0
    with pytest.raises(DomainError):
        table.at(10.0 + 2e-8)


def test_a_number_that_is_none_is_refused() -> None:
    table = Table1([0.0, 10.0], [1.0, 3.0])
    surface = Table2([0.0, 1.0], [0.0, 1.0], [[0.0, 1.0], [2.0, 3.0]])
    for read in (table, table.at, lambda x: surface.at(x, 0.5), lambda x: surface.at(0.5, x)):
        with pytest.raises(DomainError):
            read(math.nan)


@FAST
@given(value, value, axes(), share)
def test_jet_of_an_affine_table_is_exact(a: float, b: float, x: Array, w: float) -> None:
    at = inside(x, w)
    jet = Table1(x, a + b * x).jet(at)
    np.testing.assert_allclose(jet, [a + b * at, b, 0.0], rtol=1e-8, atol=1e-8)


@FAST
@given(st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=4), axes(), axes(), share, share)
def test_jet_of_a_bilinear_table_is_exact(
    c: list[float], x: Array, y: Array, w: float, z: float
) -> None:
    a, b, d, e = c
    u, v = inside(x, w), inside(y, z)
    f = a + b * x[:, None] + d * y + e * x[:, None] * y
    jet = Table2(x, y, f).jet(u, v)
    scale = 1.0 + float(np.abs(f).max())
    expected = [a + b * u + d * v + e * u * v, b + e * v, d + e * u, 0.0, e, 0.0]
    np.testing.assert_allclose(jet, expected, rtol=0.0, atol=1e-9 * scale)


@FAST
@given(tables1(), share)
def test_the_slope_is_the_mean_over_a_narrow_window(table: Table1, w: float) -> None:
    """Mean of the table's own slopes, weighted by their part of the window around the point."""
    at = inside(table.x, w)
    reach = WINDOW * float(np.diff(table.x).min())
    lo, hi = max(at - reach, table.lo), min(at + reach, table.hi)
    slopes = np.diff(table.f) / np.diff(table.x)
    part = np.minimum(table.x[1:], hi) - np.maximum(table.x[:-1], lo)
    expected = float(np.maximum(part, 0.0) @ slopes) / (hi - lo)
    scale = float(np.abs(slopes).max()) + 1.0
    assert table.jet(at)[1] == pytest.approx(expected, abs=1e-8 * scale)


@FAST
@given(st.floats(-3.0, 3.0), st.floats(0.1, 2.0), st.integers(6, 12), share)
def test_curvature_is_that_of_the_function_behind_the_table(
    bend: float, step: float, n: int, w: float
) -> None:
    x = step * np.arange(n)
    surface = Table2(x, x, 0.5 * bend * (x[:, None] ** 2 + 3.0 * x**2) + x[:, None] * x)
    at = float(x[2] + w * (x[-3] - x[2]))
    assert Table1(x, 0.5 * bend * x**2).jet(at)[2] == pytest.approx(bend, abs=1e-8)
    np.testing.assert_allclose(surface.jet(at, at)[3:], [bend, 1.0, 3.0 * bend], atol=1e-7)


@FAST
@given(tables2(), share, share)
def test_neighbours_are_the_adjoining_cells_continued(table: Table2, w: float, z: float) -> None:
    """Against the four-point formula of each adjoining cell; at the edge, of the own cell."""
    x, y = inside(table.x, w), inside(table.y, z)
    i = min(int(np.searchsorted(table.x, x, side="right")) - 1, table.x.size - 2)
    j = min(int(np.searchsorted(table.y, y, side="right")) - 1, table.y.size - 2)
    got = table.neighbours(x, y)
    for row, (di, dj) in zip(got, ((-1, 0), (1, 0), (0, -1), (0, 1)), strict=True):
        a = min(max(i + di, 0), table.x.size - 2)
        b = min(max(j + dj, 0), table.y.size - 2)
        (x0, x1), (y0, y1) = table.x[a : a + 2], table.y[b : b + 2]
        corner = table.f[a : a + 2, b : b + 2]
        matrix = [[1.0, p, q, p * q] for p in (0.0, 1.0) for q in (0.0, 1.0)]
        c = np.linalg.solve(matrix, corner.ravel())
        u, v = (x - x0) / (x1 - x0), (y - y0) / (y1 - y0)
        expected = [
            c[0] + c[1] * u + c[2] * v + c[3] * u * v,
            (c[1] + c[3] * v) / (x1 - x0),
            (c[2] + c[3] * u) / (y1 - y0),
        ]
        size = np.abs(c).max() * (1.0 + abs(u) + abs(v) + abs(u * v)) * 20.0 + 1.0
        np.testing.assert_allclose(row, expected, atol=1e-11 * size)


def test_roughness_is_the_largest_second_difference() -> None:
    assert Table2([0.0, 1.0], [0.0, 1.0], [[0.0, 1.0], [2.0, 7.0]]).roughness == 0.0
    ridge = Table2([0.0, 1.0, 2.0], [0.0, 1.0], [[1.0, 1.0], [4.0, 2.0], [1.0, 1.0]])
    assert ridge.roughness == 1.5
    assert Table2([0.0, 1.0, 2.0], [0.0, 1.0], np.zeros((3, 2))).roughness == 0.0


@FAST
@given(tables1())
def test_jets_are_continuous_at_the_nodes(table: Table1) -> None:
    gap = 1e-10 * float(np.diff(table.x).min())
    left, right = table.jet(table.x[1:-1] - gap), table.jet(table.x[1:-1] + gap)
    scale = 200.0 / float(np.diff(table.x).min())
    np.testing.assert_allclose(left, right, atol=1e-5 * max(scale, 1.0) ** 2)


def test_jets_of_a_surface_at_a_kink_are_means_of_both_sides() -> None:
    table = Table2([0.0, 1.0, 3.0], [0.0, 1.0], [[0.0, 0.0], [2.0, 4.0], [8.0, 2.0]])
    f, f_x, f_y, _, f_xy, f_yy = table.jet(1.0, 0.0)
    assert (f, f_y, f_yy) == pytest.approx((2.0, 2.0, 0.0), abs=1e-12)
    assert f_x == pytest.approx(0.5 * (2.0 + 3.0))
    assert f_xy == pytest.approx(0.5 * (4.0 - 1.0) - 0.5 * (2.0 + 3.0))


@pytest.mark.parametrize(
    ("x", "f"),
    [
        ([0.0], [1.0]),
        ([0.0, 0.0], [1.0, 2.0]),
        ([1.0, 0.0], [1.0, 2.0]),
        ([0.0, math.inf], [1.0, 2.0]),
        ([0.0, 1.0], [1.0, math.nan]),
        ([0.0, 1.0], [1.0, 2.0, 3.0]),
    ],
)
def test_bad_tables_are_refused(x: list[float], f: list[float]) -> None:
    with pytest.raises(ValueError, match="a table"):
        Table1(x, f, "a table")
    with pytest.raises(ValueError, match="a table"):
        Table2(x, [0.0, 1.0], [[v, v] for v in f], "a table")
    with pytest.raises(ValueError, match="a table"):
        Table2([0.0, 1.0], x, [f, f], "a table")


def test_tables_are_values() -> None:
    x = np.array([0.0, 1.0])
    table = Table1(x, [1.0, 2.0])
    x[0] = -5.0
    assert table.lo == 0.0
    with pytest.raises(ValueError, match="read-only"):
        table.f[0] = 7.0
    constant = Table1.constant(3.0, -1.0, 1.0)
    assert (constant.at(-1.0), constant.at(0.3), constant.lo, constant.hi) == (3.0, 3.0, -1.0, 1.0)
