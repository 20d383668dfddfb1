"""The exact equations (P1) .. (P7): roots, inverses, closed forms, identities."""

from __future__ import annotations

from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from relax import load_trip
from relax.errors import DomainError
from relax.exact import ExactCar
from relax.physics import battery_power, heat_pump_heat, heat_pump_power
from relax.replay import BASE, COOLING, ENERGY, LOSS, TEMPERATURE

CAR = ExactCar(load_trip("paper-400km", {"vehicle.heater_cabin_efficiency": 0.9}).vehicle)
IDLE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FAST = settings(max_examples=150, deadline=None, derandomize=True)

load = st.floats(-200.0, 200.0)
ratio = st.floats(0.0, 1e-3)


@FAST
@given(st.floats(1.0, 70.0), st.floats(-20.0, 40.0), st.floats(-150.0, 250.0))
def test_loss_is_resistance_times_current_squared(energy: float, temp: float, power: float) -> None:
    """(P1), (P2) against I = P / U and R * I^2 in watts."""
    pack = CAR.vehicle.pack
    volt = float(pack.ocv_v(pack.soc(energy)))
    ampere = 1000.0 * power / volt
    r = CAR.resistance(temp) / CAR.voltage_squared(energy)
    rates = CAR.rates(power, r, IDLE, (temp, 0.0, 0.0), 0.0, temp)
    assert rates[ENERGY] == -power
    assert rates[LOSS] == pytest.approx(
        CAR.resistance(temp) * ampere**2 / 1000.0, rel=1e-9, abs=1e-12
    )
    assert rates[TEMPERATURE] * CAR.capacity == pytest.approx(rates[LOSS], abs=1e-12)


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


@FAST
@given(st.floats(-20.0, 40.0), st.floats(0.0, 8.0), st.floats(0.0, 8.0), st.floats(0.0, 6.0))
def test_the_cabin_gets_its_demand(temp: float, demand: float, heater: float, pump: float) -> None:
    """(P4), (P5): what the heat pump leaves comes from the heater, which the battery shares."""
    vehicle = CAR.vehicle
    hb, hp, heat, cabin = CAR.heating(temp, demand, heater, pump)
    assert vehicle.heater_cabin_efficiency * cabin + heat == pytest.approx(demand, abs=1e-12)
    assert heat <= demand + 1e-12 and 0.0 <= hp <= vehicle.heat_pump_kw
    droop = vehicle.heat_pump_droop_per_kw
    given = heat_pump_heat(np.array(hp), np.array(CAR.cop(temp)), droop)
    assert heat == pytest.approx(float(given), abs=1e-9)
    assert hb == pytest.approx(max(min(heater, vehicle.heater_kw - cabin), 0.0))


@FAST
@given(st.lists(st.floats(0.0, 20.0), min_size=6, max_size=6), st.floats(0.0, 0.1))
def test_heat_flow_is_the_signed_sum(flows: list[float], conductance: float) -> None:
    """(P7): every other use of power has no heat of its own in the pack."""
    drivetrain, heater, cooling, pump, heat, temp = flows
    v = CAR.vehicle
    use = (3.0, heater, cooling, pump, heat, 2.0)
    rates = CAR.rates(10.0, 1e-4, use, (5.0, conductance, drivetrain), 0.0, temp)
    expected = (
        1e-4 * 10.0**2 + drivetrain + v.heater_battery_efficiency * heater
        - v.cooling_cop * cooling - (heat - pump) + conductance * (5.0 - temp)
    )  # fmt: skip
    assert rates[TEMPERATURE] * CAR.capacity == pytest.approx(expected, abs=1e-12)
    assert (rates[BASE], rates[COOLING]) == (3.0, cooling)


@FAST
@given(st.floats(1.0, 150.0), st.floats(1e-6, 5e-4), st.floats(0.0, 3.0), st.floats(-20.0, 40.0))
def test_electrical_and_thermal_energies_close(
    base: float, r: float, pump: float, temp: float
) -> None:
    """Chemical power = consumers + loss; the heat pump moves heat and makes none of its own."""
    demand = 8.0
    _, hp, heat, cabin = CAR.heating(temp, demand, 0.0, pump)
    power = float(battery_power(np.array(base + hp + cabin), np.array(r)))
    use = (base, 0.0, 0.0, hp, heat, cabin)
    rates = CAR.rates(power, r, use, (temp, 0.0, 0.0), 0.0, temp)
    # first law over pack and cabin: what is neither traction nor lost in the cabin's heater
    lost = (1.0 - CAR.vehicle.heater_cabin_efficiency) * cabin
    into_pack = rates[TEMPERATURE] * CAR.capacity
    assert into_pack + demand + lost == pytest.approx(power - base, abs=1e-9)
