"""Every envelope: on its side of the term on random boxes and tables, exact on points, never worse
on a smaller box. Tables are random and kinked on purpose: monotone ones would hide errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from relax import envelopes_charge
from relax.envelopes import (
    affine_over,
    envelope_conductance_over,
    envelope_loss_over,
    envelope_loss_under,
    envelope_product,
    envelope_pump_heat_over,
    envelope_pump_heat_under,
    envelope_pump_power_under,
    nodes,
)
from relax.envelopes_charge import (
    ChargeGrid,
    envelope_charge_time_under,
    envelope_grid_limit_over,
    envelope_limit_over,
    envelope_stop_loss_over,
    envelope_stop_loss_under,
    envelope_table_over,
    make_charge_grid,
    range_of_planes,
)
from relax.intervals import Interval, grid_values, range1, range2
from relax.maps import Table1, Table2
from relax.physics import heat_pump_heat, heat_pump_power

Array = npt.NDArray[np.float64]
BOXES = 40
POINTS = 400


@dataclass
class Case:
    """Random tables and boxes; width 0 gives points."""

    seed: int
    width: float = 1.0

    def __post_init__(self) -> None:
        self.rng = rng = np.random.default_rng(self.seed)
        t = np.sort(rng.uniform(-30.0, 40.0, 9))
        t[[0, -1]] = -32.0, 45.0
        e = np.sort(rng.uniform(0.0, 80.0, 6))
        e[[0, -1]] = 0.0, 82.0
        self.resistance = Table1(t, rng.uniform(0.02, 0.5, 9))
        self.square = Table1(e, rng.uniform(110.0, 200.0, 6))
        self.cop = Table1(t, rng.uniform(0.6, 5.0, 9))
        self.limit = Table2(e, t, rng.uniform(1.0, 180.0, (6, 9)))
        self.charger = Table1([0.0, 30.0, 82.0], rng.uniform(5.0, 150.0, 3))
        self.droop = float(rng.choice([0.0, 0.06, 0.2]))

    def box(self, lo: float, hi: float, n: int = BOXES) -> Interval:
        a, b = self.rng.uniform(lo, hi, (2, n))
        a, b = np.minimum(a, b), np.maximum(a, b)
        middle = 0.5 * (a + b)
        half = 0.5 * self.width * (b - a)
        return Interval(middle - half, middle + half)

    def inside(self, x: Interval) -> Array:
        """Points of every box, shape (POINTS, n): uniform, and many on its faces."""
        u = self.rng.uniform(-0.3, 1.3, (POINTS, x.lo.size)).clip(0.0, 1.0)
        return x.lo + u * x.width


def plane_values(planes: Array, *x: Array) -> Array:
    """Values (m, POINTS, n) of planes (m, d + 1, n)."""
    return sum(planes[:, None, i] * v for i, v in enumerate(x)) + planes[:, None, -1]


Built = tuple[str, Array, Array, tuple[Array, ...]]


def loss_over(case: Case) -> Built:
    p, e, t = case.box(-60.0, 90.0), case.box(0.0, 82.0), case.box(-30.0, 40.0)
    ripple = case.rng.choice([0.0, 150.0], BOXES)
    planes = envelope_loss_over(case.resistance, case.square, p, e, t, ripple)
    x = case.inside(p), case.inside(e), case.inside(t)
    term = np.interp(x[2], case.resistance.x, case.resistance.f)
    term = term / np.interp(x[1], case.square.x, case.square.f) * (x[0] ** 2 + ripple)
    return "over", term, planes, x


def loss_under(case: Case) -> Built:
    p, e, t = case.box(-60.0, 90.0), case.box(0.0, 82.0), case.box(-30.0, 40.0)
    ripple = case.rng.choice([0.0, 150.0], BOXES)
    planes = envelope_loss_under(case.resistance, case.square, p, e, t, ripple)
    x = case.inside(p), case.inside(e), case.inside(t)
    term = np.interp(x[2], case.resistance.x, case.resistance.f)
    term = term / np.interp(x[1], case.square.x, case.square.f) * (x[0] ** 2 + ripple)
    return "under", term, planes, x


def conductance(case: Case) -> Built:
    e, t = case.box(0.0, 82.0), case.box(-30.0, 40.0)
    planes = envelope_conductance_over(case.resistance, case.square, e, t)
    x = case.inside(e), case.inside(t)
    term = np.interp(x[0], case.square.x, case.square.f)
    return "over", term / np.interp(x[1], case.resistance.x, case.resistance.f), planes, x


def pump_heat(case: Case, side: str) -> Built:
    t, top = case.box(-30.0, 40.0), case.rng.uniform(0.1, 4.0, BOXES)
    hp = Interval(top * (1.0 - case.width), top)
    build = envelope_pump_heat_over if side == "over" else envelope_pump_heat_under
    x = case.inside(hp), case.inside(t)
    cop = np.interp(x[1], case.cop.x, case.cop.f)
    return side, heat_pump_heat(x[0], cop, case.droop), build(case.cop, case.droop, hp, t), x


def pump_power(case: Case) -> Built:
    t, demand = case.box(-30.0, 40.0), case.rng.uniform(0.2, 6.0, BOXES)
    top = case.rng.uniform(0.1, 2.4, BOXES)
    planes = envelope_pump_power_under(
        case.cop, case.droop, Interval(np.zeros(BOXES), top), demand, t
    )
    temp = case.inside(t)
    cop = np.interp(temp, case.cop.x, case.cop.f)
    cap = np.minimum(demand, heat_pump_heat(np.broadcast_to(top, temp.shape), cop, case.droop))
    heat = case.rng.uniform(-0.2, 1.2, temp.shape).clip(0.0, 1.0) * cap
    if case.width == 0.0:
        heat = cap
    return "under", heat_pump_power(heat, cop, case.droop), planes, (heat, temp)


def product(case: Case, side: str) -> Built:
    t, y = case.box(-30.0, 40.0), case.box(0.0, 2.0)
    below, above = envelope_product(t, y)
    x = case.inside(t), case.inside(y)
    return side, x[0] * x[1], below if side == "under" else above, x


def charging(case: Case, term: str) -> Built:
    cells = BOXES // 2
    e, t = case.box(0.0, 82.0), case.box(-30.0, 40.0)
    shaped = [Interval(b.lo.reshape(2, cells), b.hi.reshape(2, cells)) for b in (e, t)]
    tables = make_charge_grid(
        case.limit, case.resistance, case.square, [case.charger, case.charger], *shaped
    )
    x = case.inside(e), case.inside(t)
    power = case.limit(*x)
    if term == "limit":
        return "over", power, envelope_limit_over(tables.power, tables.energy, tables.temp), x
    if term == "table":
        return "over", power, envelope_table_over(case.limit, e, t), x
    if term == "time":
        planes = envelope_charge_time_under(tables)
        check_ranges(planes, tables, (e, t), x)
        return "under", 1.0 / power, planes, x
    if term == "grid":
        y = case.box(0.0, 1.5)
        x = x[0], case.inside(y)
        value = np.interp(x[0], case.charger.x, case.charger.f) * x[1]
        return "over", value, envelope_grid_limit_over(tables, y), x
    planes, bounds = envelope_stop_loss_over(tables)
    r = np.interp(x[1], case.resistance.x, case.resistance.f)
    r = r / np.interp(x[0], case.square.x, case.square.f)
    rho = r * np.minimum(power, np.interp(x[0], case.charger.x, case.charger.f))
    assert (rho <= bounds.hi).all() and (rho >= bounds.lo).all()
    if planes.size:  # none on wide boxes
        check_ranges(planes, tables, (e, t), x)
    return "over", rho, planes, x


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("width", [1.0, 0.1, 0.0])
def test_wide_boxes_get_the_range_of_the_loss_alone(
    width: float, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(envelopes_charge, "WIDE_NODES", 0)
    _, rho, planes, _ = charging(Case(seed, width), "loss")  # asserts the range
    assert planes.shape == (0, 3, BOXES)
    monkeypatch.setattr(envelopes_charge, "WIDE_NODES", 1000)
    assert charging(Case(seed, width), "loss")[2].shape == (2, 3, BOXES)
    assert rho.shape == (POINTS, BOXES)


def check_ranges(
    planes: Array, tables: ChargeGrid, box: tuple[Interval, Interval], x: tuple[Array, Array]
) -> None:
    """The range of a plane holds its values on the box and is attained at corners."""
    found = range_of_planes(planes, tables)

    def at(e: Array, t: Array) -> Array:
        return planes[:, :1] * e + planes[:, 1:2] * t + planes[:, 2:3]

    values = at(*x)
    assert (values <= found.hi[:, None]).all() and (values >= found.lo[:, None]).all()
    e, t = ([b.lo, b.hi] for b in box)
    corners = at(np.stack([e[0], e[0], e[1], e[1]]), np.stack([t[0], t[1], t[0], t[1]]))
    size = np.abs(corners).max() + np.abs(planes[:, 2]).max()
    assert corners.max(axis=1) == pytest.approx(found.hi, abs=1e-8 * size)
    assert corners.min(axis=1) == pytest.approx(found.lo, abs=1e-8 * size)


def stop_loss_under(case: Case) -> Built:
    e, t = case.box(0.01, 6.0), case.box(-30.0, 40.0)
    square = case.rng.uniform(120.0, 180.0, BOXES)
    speed = case.rng.uniform(2.0, 150.0, (4, BOXES))
    planes = envelope_stop_loss_under(case.resistance, square, e, t, speed)
    energy, temp = case.inside(e), case.inside(t)
    # no box for the power: it strays from the slopes' reference by a factor
    power = speed[0] * np.exp(case.width * case.rng.uniform(-2.0, 2.0, energy.shape))
    dwell = energy / power
    loss = np.interp(temp, case.resistance.x, case.resistance.f) / square * energy * power
    return "under", loss, planes, (energy, dwell, temp)


ENVELOPES: dict[str, Callable[[Case], Built]] = {
    "loss over": loss_over,
    "loss under": loss_under,
    "conductance over": conductance,
    "pump heat over": lambda c: pump_heat(c, "over"),
    "pump heat under": lambda c: pump_heat(c, "under"),
    "pump power under": pump_power,
    "product over": lambda c: product(c, "over"),
    "product under": lambda c: product(c, "under"),
    "charge limit over": lambda c: charging(c, "limit"),
    "table over": lambda c: charging(c, "table"),
    "charge time under": lambda c: charging(c, "time"),
    "grid limit over": lambda c: charging(c, "grid"),
    "stop loss over": lambda c: charging(c, "loss"),
    "stop loss under": stop_loss_under,
}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("width", [1.0, 0.3, 1e-3, 1e-7])
@pytest.mark.parametrize("name", ENVELOPES)
def test_lies_on_its_side(name: str, width: float, seed: int) -> None:
    side, term, planes, x = ENVELOPES[name](Case(seed, width))
    gap = plane_values(planes, *x) - term
    assert np.isfinite(planes).all()
    assert gap.min() >= 0.0 if side == "over" else gap.max() <= 0.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ENVELOPES)
def test_is_exact_on_a_point(name: str, seed: int) -> None:
    side, term, planes, x = ENVELOPES[name](Case(seed, 0.0))
    values = plane_values(planes, *x)
    best = values.min(axis=0) if side == "over" else values.max(axis=0)
    if name == "pump power under":  # two slopes in T meet the point, up to the tangent's cell
        assert np.abs(best - term).max() < 1e-6
    else:
        assert (np.abs(best - term) <= 2e-8 * (1.0 + np.abs(term).max())).all()


@pytest.mark.parametrize("name", ENVELOPES)
def test_shrinks_with_the_box(name: str) -> None:
    def error(width: float) -> float:
        side, term, planes, x = ENVELOPES[name](Case(11, width))
        values = plane_values(planes, *x)
        best = values.min(axis=0) - term if side == "over" else term - values.max(axis=0)
        return float(best.mean())

    errors = [error(w) for w in (1.0, 0.5, 0.25, 0.05)]
    assert errors == sorted(errors, reverse=True)
    # the power of a given heat always starts at heat 0: only its temperature box shrinks
    assert errors[-1] < (0.5 if name == "pump power under" else 0.15) * errors[0]


def test_a_plane_moved_by_a_thousandth_is_caught() -> None:
    for name, build in ENVELOPES.items():
        side, term, planes, x = build(Case(3))
        planes = planes.copy()
        closest = np.abs(term - plane_values(planes, *x)).min(axis=(0, 1))
        shift = 1e-3 * np.abs(term).max(axis=0) + 1.02 * closest
        planes[:, -1] += -shift if side == "over" else shift
        gap = plane_values(planes, *x) - term
        bad = gap.min() < 0.0 if side == "over" else gap.max() > 0.0
        assert bad, name


def test_loss_over_is_the_chord_of_the_square_for_a_known_temperature() -> None:
    flat = Table1([-40.0, 60.0], [0.1, 0.1]), Table1([0.0, 90.0], [160.0, 160.0])
    one = np.ones(1)
    planes = envelope_loss_over(
        *flat, Interval(10.0 * one, 30.0 * one), Interval(0.0 * one, 90.0 * one),
        Interval(-10.0 * one, 20.0 * one), 0.0 * one,
    )  # fmt: skip
    # by hand: P^2 on [10, 30] lies below 40 P - 300
    assert planes[0, :, 0] == pytest.approx([0.1 / 160 * 40, 0.0, 0.0, -0.1 / 160 * 300], abs=1e-8)


def test_charge_time_of_a_constant_limit_is_constant() -> None:
    limit = Table2([0.0, 80.0], [-40.0, 60.0], np.full((2, 2), 50.0))
    e, t = np.array([[10.0]]), np.array([[-20.0]])
    tables = make_charge_grid(
        limit, Table1([-40.0, 60.0], [0.1, 0.1]), Table1([0.0, 90.0], [160.0, 160.0]),
        [Table1([0.0, 90.0], [200.0, 200.0])], Interval(e, e + 20.0), Interval(t, t + 40.0),
    )  # fmt: skip
    planes = envelope_charge_time_under(tables)
    assert planes[:, :2].max() == pytest.approx(0.0, abs=1e-12)
    assert planes[:, 2] == pytest.approx(np.full((planes.shape[0], 1), 0.02), rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_ranges_are_exact(seed: int) -> None:
    case = Case(seed)
    e, t = case.box(0.0, 82.0), case.box(-30.0, 40.0)
    found = range2(case.limit, e, t)
    values = case.limit(case.inside(e), case.inside(t))
    assert (values <= found.hi + 1e-12).all() and (values >= found.lo - 1e-12).all()
    inner = range1(case.resistance, t)
    r = case.resistance(case.inside(t))
    assert (r <= inner.hi + 1e-12).all() and (r >= inner.lo - 1e-12).all()
    # attained: at table nodes inside the box or at its ends
    points = nodes(case.resistance, t)
    assert np.interp(points, case.resistance.x, case.resistance.f).max(axis=1) == pytest.approx(
        inner.hi
    )
    chord = affine_over(case.square, e)
    x = case.inside(e)
    assert (chord[0] * x + chord[1] >= case.square(x)).all()


def test_grid_values_are_the_table() -> None:
    case = Case(1)
    x, y = case.rng.uniform(0.0, 82.0, (3, 4)), case.rng.uniform(-30.0, 40.0, (3, 5))
    expected = case.limit(*np.broadcast_arrays(x[:, :, None], y[:, None, :]))
    assert grid_values(case.limit, x, y) == pytest.approx(expected)
