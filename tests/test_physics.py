"""The exact equations (P1) .. (P7): roots, inverses, closed forms, identities."""

from __future__ import annotations

from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from relax.errors import DomainError
from relax.physics import (
    battery_heat,
    battery_power,
    cabin_heater_power,
    electrical_load,
    heat_pump_heat,
    heat_pump_power,
    joule_loss,
    resistance_over_voltage_squared,
)

FAST = settings(max_examples=150, deadline=None, derandomize=True)

load = st.floats(-200.0, 200.0)
ratio = st.floats(0.0, 1e-3)


@FAST
@given(st.floats(0.0, 1.0), st.floats(200.0, 900.0), st.floats(-300.0, 300.0))
def test_loss_is_resistance_times_current_squared(ohm: float, volt: float, power: float) -> None:
    """(P1), (P2) against I = P / U and R * I^2 in watts."""
    ampere = 1000.0 * power / volt
    r = resistance_over_voltage_squared(np.array(ohm), np.array(volt**2 / 1000.0))
    assert float(joule_loss(np.array(power), r)) == pytest.approx(
        ohm * ampere**2 / 1000.0, rel=1e-12, abs=1e-300
    )


@FAST
@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=20), ratio)
def test_loss_of_the_mean_with_ripple_is_the_mean_loss(powers: list[float], r: float) -> None:
    p = np.array(powers)
    mean_loss = float(np.mean(r * p**2))
    got = float(joule_loss(np.array(p.mean()), np.array(r), float(p.var())))
    assert got == pytest.approx(mean_loss, rel=1e-9, abs=1e-12)


@FAST
@given(load, ratio, st.floats(0.0, 400.0))
def test_battery_power_solves_the_balance(demand: float, r: float, ripple: float) -> None:
    assume(4.0 * r * (demand + r * ripple) < 1.0)
    power = float(battery_power(np.array(demand), np.array(r), ripple))
    assert power - r * (power**2 + ripple) == pytest.approx(demand, abs=1e-10)
    # the smaller root: the pack's largest power 1/(2r) lies above it
    assert 2.0 * r * power <= 1.0 + 1e-9


@FAST
@given(load)
def test_without_resistance_the_battery_delivers_the_load_exactly(demand: float) -> None:
    assert float(battery_power(np.array(demand), np.array(0.0))) == demand
    assert float(joule_loss(np.array(demand), np.array(0.0), 100.0)) == 0.0


@FAST
@given(st.floats(1e-14, 1e-3), st.sampled_from([-1.0, 1.0]), st.floats(1e-6, 1e-3))
def test_tiny_loads_lose_no_digits(size: float, sign: float, r: float) -> None:
    """Against the textbook root in 60 digits; in floats that one cancels completely."""
    getcontext().prec = 60
    demand, x = Decimal(sign * size), Decimal(r)
    exact = (1 - (1 - 4 * x * demand).sqrt()) / (2 * x)
    got = float(battery_power(np.array(sign * size), np.array(r)))
    assert got == pytest.approx(float(exact), rel=4e-16, abs=0.0)


def test_the_largest_power_of_the_pack_is_the_end() -> None:
    r = np.array(0.001)
    assert float(battery_power(np.array(250.0), r)) == 500.0
    with pytest.raises(DomainError, match="largest power"):
        battery_power(np.array([10.0, 250.1]), r)


@FAST
@given(st.floats(0.0, 8.0), st.floats(1.0, 12.0), st.floats(0.0, 0.06))
def test_heat_pump_power_inverts_heat(power: float, cop: float, droop: float) -> None:
    assume(2.0 * droop * power < 0.98)  # beyond the top of the parabola there are two powers
    heat = heat_pump_heat(np.array(power), np.array(cop), droop)
    assert float(heat_pump_power(heat, np.array(cop), droop)) == pytest.approx(
        power, rel=1e-10, abs=1e-12
    )


@FAST
@given(st.floats(0.0, 50.0), st.floats(1.0, 12.0))
def test_without_droop_heat_is_cop_times_power(power: float, cop: float) -> None:
    heat = heat_pump_heat(np.array(power), np.array(cop), 0.0)
    assert float(heat) == pytest.approx(cop * power, rel=1e-14)
    assert float(heat_pump_power(heat, np.array(cop), 0.0)) == pytest.approx(power, rel=1e-14)


def test_heat_that_no_power_gives_is_infinite_power() -> None:
    top = 2.0 / (4.0 * 0.05)  # cop / (4 droop), reached at 1 / (2 droop) = 10 kW
    got = heat_pump_power(np.array([top, 1.001 * top, 0.0]), np.array(2.0), 0.05)
    assert got[0] == pytest.approx(10.0, rel=1e-6)
    assert got[1] == np.inf
    assert got[2] == 0.0


def test_loads_add_up_and_the_cabin_gets_its_demand() -> None:
    parts = [np.array(x) for x in (10.0, 2.0, 0.7, 0.3, 0.1)]
    assert float(electrical_load(*parts)) == pytest.approx(13.1)
    for part in range(5):
        more = [x + (1.0 if i == part else 0.0) for i, x in enumerate(parts)]
        assert float(electrical_load(*more)) == pytest.approx(14.1)
    power = cabin_heater_power(np.array(3.0), np.array(1.2), 0.9)
    assert 0.9 * float(power) + 1.2 == pytest.approx(3.0)


@FAST
@given(st.lists(st.floats(-20.0, 20.0), min_size=6, max_size=6), st.floats(0.0, 0.1))
def test_heat_flow_is_the_signed_sum(flows: list[float], conductance: float) -> None:
    loss, drivetrain, heater, cooling, pump, temp = flows
    arrays = [np.array(x) for x in (loss, drivetrain, heater, cooling, pump, conductance, 5.0)]
    expected = loss + drivetrain + heater - cooling - pump + conductance * (5.0 - temp)
    assert float(battery_heat(*arrays, np.array(temp))) == pytest.approx(expected, abs=1e-12)


def test_no_heat_no_flow_at_ambient_temperature() -> None:
    zero, one = np.array(0.0), np.array(1.0)
    assert float(battery_heat(zero, zero, zero, zero, zero, one, 7.0 * one, 7.0 * one)) == 0.0
    assert float(battery_heat(zero, zero, zero, zero, zero, zero, one, -one)) == 0.0


@FAST
@given(st.floats(1.0, 150.0), st.floats(1e-6, 5e-4), st.floats(0.0, 3.0), st.floats(1.0, 6.0))
def test_electrical_and_thermal_energies_close(
    base: float, r: float, pump: float, cop: float
) -> None:
    """Chemical power = consumers + loss; the heat pump moves heat and makes none of its own."""
    demand = 8.0
    heat = heat_pump_heat(np.array(pump), np.array(cop), 0.05)
    cabin = cabin_heater_power(np.array(demand), heat, 1.0)
    zero = np.array(0.0)
    consumers = electrical_load(np.array(base), cabin, zero, zero, np.array(pump))
    power = battery_power(consumers, np.array(r))
    loss = joule_loss(power, np.array(r))
    into_pack = battery_heat(loss, zero, zero, zero, heat - pump, zero, zero, zero)
    # first law over pack and cabin: all electricity that is not traction ends as heat
    assert float(into_pack) + demand == pytest.approx(float(power) - base, abs=1e-9)
