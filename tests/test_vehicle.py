"""The pack's maps over internal energy: equation (E1) against direct quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from trips import small_trip

from relax.errors import DomainError, InputError
from relax.load import load_vehicle, shipped_vehicles
from relax.maps import Table1
from relax.physics import heat_pump_heat
from relax.vehicle import Pack

Array = npt.NDArray[np.float64]
FAST = settings(max_examples=40, deadline=None, derandomize=True)


@st.composite
def packs(draw: st.DrawFn) -> Pack:
    """The small car's pack with a random rising voltage curve."""
    rises = draw(st.lists(st.floats(0.5, 80.0), min_size=1, max_size=6))
    widths = draw(st.lists(st.floats(0.1, 1.0), min_size=len(rises), max_size=len(rises)))
    soc = np.concatenate([[0.0], np.cumsum(widths) / sum(widths)])
    soc[-1] = 1.0
    volt = draw(st.floats(150.0, 700.0)) + np.concatenate([[0.0], np.cumsum(rises)])
    pack = small_trip().vehicle.pack
    return replace(pack, ocv_v=Table1(soc, volt, "ocv"), capacity_ah=draw(st.floats(40.0, 300.0)))


def quadrature(pack: Pack, soc: float) -> float:
    """E = C * integral of U d soc in kWh, by adaptive quadrature between the nodes."""
    nodes = [float(x) for x in pack.ocv_v.x if x < soc]
    volt = pack.ocv_v
    ends = [*nodes[1:], soc]
    parts = [
        quad(lambda s: float(np.interp(s, volt.x, volt.f)), a, b)[0]
        for a, b in zip(nodes, ends, strict=True)
    ]
    return pack.capacity_ah * sum(parts) / 1000.0


@FAST
@given(packs(), st.floats(0.001, 1.0))
def test_energy_is_the_integral_of_voltage_over_charge(pack: Pack, soc: float) -> None:
    assert float(pack.energy_kwh(soc)) == pytest.approx(quadrature(pack, soc), rel=1e-12)
    assert float(pack.energy_kwh(0.0)) == 0.0


@FAST
@given(packs(), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9))
def test_soc_and_energy_are_inverse(pack: Pack, soc: list[float]) -> None:
    energy = pack.energy_kwh(soc)
    np.testing.assert_allclose(pack.soc(energy), soc, rtol=0.0, atol=1e-12)
    order = np.argsort(soc)
    assert np.all(np.diff(energy[order]) >= 0.0)
    ends = pack.soc([0.0, float(pack.voltage_squared.hi)])
    np.testing.assert_allclose(ends, [0.0, 1.0], atol=1e-12)


@FAST
@given(packs(), st.floats(0.0, 1.0))
def test_squared_voltage_is_exactly_affine_in_energy_between_nodes(pack: Pack, soc: float) -> None:
    """The lossless part of the model: no interpolation error at all, at any SoC."""
    volt = float(np.interp(soc, pack.ocv_v.x, pack.ocv_v.f))
    energy = quadrature(pack, soc) if soc > 0.0 else 0.0
    assert pack.voltage_squared.at(energy) == pytest.approx(volt * volt / 1000.0, rel=1e-12)


@pytest.mark.parametrize("name", shipped_vehicles())
def test_power_limits_over_energy_meet_the_table_at_its_nodes(name: str) -> None:
    pack = load_vehicle(name).pack
    for over_soc, over_energy in (
        (pack.charge_limit_soc_kw, pack.charge_limit_kw),
        (pack.discharge_limit_soc_kw, pack.discharge_limit_kw),
    ):
        energy, temp = np.meshgrid(pack.energy_kwh(over_soc.x), over_soc.y, indexing="ij")
        np.testing.assert_allclose(over_energy(energy, temp), over_soc.f, rtol=1e-12, atol=1e-12)
        # bilinear in energy between them: the middle of a cell is the mean of its corners
        middle_e, middle_t = (
            0.5 * (energy[1:, 1:] + energy[:-1, :-1]),
            0.5 * (temp[1:, 1:] + temp[:-1, :-1]),
        )
        corners = over_soc.f[1:, 1:] + over_soc.f[:-1, 1:] + over_soc.f[1:, :-1]
        corners = corners + over_soc.f[:-1, :-1]
        np.testing.assert_allclose(over_energy(middle_e, middle_t), 0.25 * corners, rtol=1e-10)


@pytest.mark.parametrize("name", shipped_vehicles())
def test_between_nodes_limits_over_energy_and_over_soc_nearly_agree(name: str) -> None:
    """Bilinear in energy is a choice: it differs from bilinear in SoC by the bend of U(soc)."""
    pack = load_vehicle(name).pack
    table = pack.charge_limit_soc_kw
    soc = np.linspace(float(table.x[0]), float(table.x[-1]), 301)
    temp = np.full(soc.size, 20.0)
    difference = np.abs(table(soc, temp) - pack.charge_limit_kw(pack.energy_kwh(soc), temp))
    assert difference.max() < 0.01 * table.f.max()


def test_the_maps_end_where_the_tables_end() -> None:
    pack = small_trip().vehicle.pack
    full = float(pack.energy_kwh(1.0))
    assert pack.voltage_squared.hi == pytest.approx(full, rel=1e-14)
    assert pack.charge_limit_kw.x[-1] == pytest.approx(full, rel=1e-14)
    with pytest.raises(DomainError):
        pack.energy_kwh(1.01)
    with pytest.raises(DomainError):
        pack.soc(-2e-4)
    with pytest.raises(DomainError):
        pack.soc(full + 2e-4)
    beyond = pack.soc([-5e-5, full + 5e-5])  # rounding of a drive
    assert beyond.tolist() == pack.soc([0.0, full]).tolist()
    with pytest.raises(DomainError):
        pack.charge_limit_kw.at(0.5 * full, 61.0)


def test_energy_by_hand() -> None:
    """160 Ah from 330 V to 365 V over half the charge: 160 * 0.5 * 347.5 V = 27.8 kWh."""
    pack = small_trip().vehicle.pack
    assert float(pack.energy_kwh(0.5)) == pytest.approx(27.8, rel=1e-14)
    assert float(pack.energy_kwh(1.0)) == pytest.approx(27.8 + 31.0, rel=1e-14)
    assert pack.voltage_squared.at(27.8) == pytest.approx(133.225, rel=1e-14)


def test_a_heat_pump_gives_more_heat_the_more_power_it_takes() -> None:
    """Else one heat had two powers; cars that no file describes are held to it too."""
    steepest = small_trip(vehicle__heat_pump_kw=4.0, vehicle__heat_pump_droop_per_kw=0.125).vehicle
    power = np.linspace(0.0, 4.0, 50)
    assert np.all(np.diff(heat_pump_heat(power, np.ones(50), 0.125)) > 0.0)
    with pytest.raises(InputError, match=r"heat_pump_droop_per_kw: 0\.13; allowed: at most 0\.125"):
        replace(steepest, heat_pump_droop_per_kw=0.13)
