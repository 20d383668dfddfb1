"""Gradients and Hessians against finite differences of formulas written out here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_simulate import random_controls
from trips import small_trip

from relax import Instance, Table1, Table2, Trajectory, make_instance, simulate
from relax.expansion import convex_part, expand_cells, expand_drive

Array = npt.NDArray[np.float64]
Formula = Callable[[npt.NDArray[Any]], Any]

FAST = settings(max_examples=80, deadline=None, derandomize=True)

OHM, OHM_PER_K = 0.15, -0.001
COP, COP_PER_K = 2.4, 0.03
LIMIT = (70.0, -40.0, 0.4, -0.2)
"""1, soc, T and soc*T: charge limit of the smooth car [kW]."""
DISCHARGE = (90.0, 60.0, 0.7, 0.1)


def smooth_instance() -> Instance:
    """A car whose tables are affine or bilinear: their jets are exact, kinks do not exist."""
    temps, socs = np.array([-40.0, 60.0]), np.array([0.0, 1.0])

    def surface(c: tuple[float, ...]) -> Table2:
        s, t = socs[:, None], temps[None, :]
        return Table2(socs, temps, c[0] + c[1] * s + c[2] * t + c[3] * s * t)

    trip = small_trip(
        ambient_c=-5.0,
        pack__ocv_v=Table1([0.0, 1.0], [330.0, 410.0]),
        pack__resistance_ohm=Table1(temps, OHM + OHM_PER_K * temps),
        pack__charge_limit_soc_kw=surface(LIMIT),
        pack__discharge_limit_soc_kw=surface(DISCHARGE),
        vehicle__heat_pump_cop=Table1(temps, COP + COP_PER_K * temps),
        grid__cells=5,
        grid__step_km=12.0,
    )
    return make_instance(trip, (0, 1))


INSTANCE = smooth_instance()
FULL = 160.0 * 370.0 / 1000.0
"""Energy at SoC 1: 160 Ah at 370 V mean [kWh]."""


def squared_voltage(energy: Any) -> Any:
    return (330.0**2 + (410.0**2 - 330.0**2) * energy / FULL) / 1000.0


def resistance_ratio(energy: Any, temp: Any) -> Any:
    return (OHM + OHM_PER_K * temp) / squared_voltage(energy)


def plane(c: tuple[float, ...], energy: Any, temp: Any) -> Any:
    """Bilinear in (E, T): with two nodes of SoC, energy runs from 0 to FULL linearly."""
    share = energy / FULL
    return c[0] + c[1] * share + c[2] * temp + c[3] * share * temp


def differences(f: Formula, at: Array) -> tuple[float, Array, Array]:
    """Value, gradient by complex steps, Hessian by central differences of that gradient."""
    v = at.size

    def gradient(x: Array) -> Array:
        out = np.empty(v)
        for a in range(v):
            z = x.astype(complex)
            z[a] += 1e-30j
            out[a] = f(z).imag / 1e-30
        return out

    hessian = np.empty((v, v))
    for a in range(v):
        step = 1e-5 * max(1.0, abs(at[a]))
        if at[a] > 0.0:
            step = min(step, 1e-3 * at[a])
        unit = step * np.eye(v)[a]
        hessian[a] = (gradient(at + unit) - gradient(at - unit)) / (2.0 * step)
    return float(f(at.astype(complex)).real), gradient(at), hessian


def check(term: Any, row: int, f: Formula, at: Array) -> None:
    value, gradient, hessian = differences(f, at)
    assert term.value[row] == pytest.approx(value, rel=1e-9, abs=1e-11)
    scale = np.abs(gradient).max() + 1e-9
    np.testing.assert_allclose(term.gradient[row], gradient, rtol=1e-8, atol=1e-9 * scale)
    scale = np.abs(hessian).max() + 1e-9
    np.testing.assert_allclose(term.hessian[row], hessian, rtol=1e-5, atol=1e-6 * scale)


def trajectories() -> list[Trajectory]:
    rng = np.random.default_rng(2)
    return [simulate(INSTANCE, random_controls(INSTANCE, rng)) for _ in range(4)]


RUNS = trajectories()


@pytest.mark.parametrize("t", RUNS)
def test_driving_terms(t: Trajectory) -> None:
    got = expand_drive(INSTANCE, t)
    d = INSTANCE.drive
    em = 0.5 * (t.energy_start_kwh + t.energy_kwh[1:])
    tm = 0.5 * (t.temperature_start_c + t.temperature_c[1:])
    a = INSTANCE.vehicle.heat_pump_droop_per_kw
    for k in range(d.n_steps):
        at = np.array([t.power_kw[k], tm[k], em[k], t.heat_pump_kw[k]])
        ripple = d.ripple_kw2[k]
        check(got.loss, k, lambda x, w=ripple: resistance_ratio(x[2], x[1]) * (x[0] ** 2 + w), at)
        check(got.pump_heat, k, lambda x: (COP + COP_PER_K * x[1]) * x[3] * (1.0 - a * x[3]), at)
        for limit, c in ((got.discharge_limit, DISCHARGE), (got.charge_limit, LIMIT)):
            value, gradient, _ = differences(lambda x, c=c: plane(c, x[0], x[1]), at[[2, 1]])
            np.testing.assert_allclose(limit[:, k], [value, *gradient], rtol=1e-9)


@pytest.mark.parametrize("t", RUNS)
def test_cell_terms_in_the_variables_of_their_stop(t: Trajectory) -> None:
    """Independent formulas of (W, y, T, E_arrive, H_p): the change of variables is tested too."""
    got = expand_cells(INSTANCE, t)
    count, a = INSTANCE.cells, INSTANCE.vehicle.heat_pump_droop_per_kw
    for i, (stop, s) in enumerate(zip(INSTANCE.stops, t.stops, strict=True)):
        grid_kw = stop.grid_limit_kw.f[0]
        for j in range(count):
            y = s.dwell_h[j]
            tm = 0.5 * (s.temperature_c[j] + s.temperature_c[j + 1])
            charged = s.energy_kwh[-1] - s.energy_kwh[0]
            at = np.array([charged, y, tm, s.energy_kwh[0], s.heat_pump_kw[j] * y])

            def middle(x: Any, j: int = j) -> Any:
                return x[3] + (j + 0.5) * x[0] / count

            formulas: dict[str, Formula] = {
                "loss": lambda x: resistance_ratio(middle(x), x[2]) * (x[0] / count) ** 2 / x[1],
                "least_dwell": lambda x: (x[0] / count) / plane(LIMIT, middle(x), x[2]),
                "pump_heat": lambda x: (COP + COP_PER_K * x[2]) * x[4] * (1.0 - a * x[4] / x[1]),
                "exchange": lambda x: x[2] * x[1],
                "grid_limit": lambda x, p=grid_kw: p * x[1],
            }
            for name, f in formulas.items():
                check(getattr(got, name), i * count + j, f, at)


def test_a_charging_curve_of_the_charger_enters_the_grid_limit() -> None:
    """Grid limit falling with energy: its slope reaches W and E_arrive."""
    from dataclasses import replace

    falling = Table1([0.0, FULL], [60.0, 20.0])
    stops = tuple(replace(s, grid_limit_kw=falling) for s in INSTANCE.stops)
    instance = replace(INSTANCE, stops=stops)
    t = simulate(instance, random_controls(instance, np.random.default_rng(4)))
    got = expand_cells(instance, t).grid_limit
    count = instance.cells
    for i, s in enumerate(t.stops):
        for j in range(count):
            at = np.array([s.energy_kwh[-1] - s.energy_kwh[0], s.dwell_h[j], s.energy_kwh[0]])
            value, g, h = differences(
                lambda x, j=j: (60.0 - 40.0 * (x[2] + (j + 0.5) * x[0] / count) / FULL) * x[1], at
            )
            row = i * count + j
            keep = [0, 1, 3]
            assert got.value[row] == pytest.approx(value, rel=1e-10)
            np.testing.assert_allclose(got.gradient[row, keep], g, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(
                got.hessian[row][np.ix_(keep, keep)], h, rtol=1e-6, atol=1e-9
            )
            assert np.all(got.gradient[row, [2, 4]] == 0.0)


def test_values_are_those_of_the_simulation_even_at_kinks() -> None:
    instance = make_instance(small_trip(), (0, 1))
    rng = np.random.default_rng(9)
    for _ in range(4):
        t = simulate(instance, random_controls(instance, rng, excess=0.9))
        drive, cells = expand_drive(instance, t), expand_cells(instance, t)
        np.testing.assert_allclose(drive.loss.value, t.loss_kw, atol=1e-8)
        np.testing.assert_allclose(drive.pump_heat.value, t.pump_heat_kw, atol=1e-8)
        loss = np.concatenate([s.loss_kwh for s in t.stops])
        least = np.concatenate([s.power_kw * s.dwell_h / s.limit_kw for s in t.stops])
        np.testing.assert_allclose(cells.loss.value, loss, rtol=1e-7)
        np.testing.assert_allclose(cells.least_dwell.value, least, rtol=1e-7)


@st.composite
def symmetric(draw: st.DrawFn) -> tuple[Array, Array]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    v = draw(st.integers(1, 5))
    block = rng.normal(size=(3, v, v)) * 10.0 ** rng.uniform(-3.0, 3.0, (3, 1, 1))
    return 0.5 * (block + np.swapaxes(block, 1, 2)), 10.0 ** rng.uniform(-2.0, 1.0, v)


@FAST
@given(symmetric())
def test_the_convex_part_is_convex_and_never_below(given_: tuple[Array, Array]) -> None:
    """Clipping adds a positive semidefinite matrix: it majorises, and the rest is unchanged."""
    block, scale = given_
    got = convex_part(block, scale)
    weight = scale[:, None] * scale[None, :]
    size = np.abs(block * weight).max() + 1e-30
    np.testing.assert_allclose(got, np.swapaxes(got, 1, 2), atol=1e-12 * np.abs(got).max() + 1e-30)
    assert np.linalg.eigvalsh(got * weight).min() >= -1e-10 * size
    assert np.linalg.eigvalsh((got - block) * weight).min() >= -1e-10 * size
    again = convex_part(got, scale)
    np.testing.assert_allclose(again * weight, got * weight, atol=1e-10 * size)


@FAST
@given(symmetric())
def test_the_convex_part_of_a_convex_block_is_itself(given_: tuple[Array, Array]) -> None:
    root, scale = given_
    block = root @ np.swapaxes(root, 1, 2)
    got = convex_part(block, scale)
    weight = scale[:, None] * scale[None, :]
    np.testing.assert_allclose(got * weight, block * weight, atol=1e-10 * (block * weight).max())
    np.testing.assert_allclose(convex_part(-block, scale) * weight, 0.0, atol=1e-10 * (
        np.abs(block * weight).max()
    ))  # fmt: skip


def test_clipping_depends_on_the_units_as_documented() -> None:
    """The indefinite block [[0, 1], [1, 0]]: what is kept follows the scales."""
    block = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    even = convex_part(block, np.ones(2))[0]
    np.testing.assert_allclose(even, 0.5 * np.ones((2, 2)), atol=1e-14)
    uneven = convex_part(block, np.array([1.0, 10.0]))[0]
    np.testing.assert_allclose(uneven, [[5.0, 0.5], [0.5, 0.05]], atol=1e-13)
