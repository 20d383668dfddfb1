"""The time of a whole stop from its energies at begin and end: below every charge, and near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from relax.envelopes_stay import envelope_stay_under
from relax.intervals import Interval
from relax.maps import Table1, Table2

Array = npt.NDArray[np.float64]
STOPS, CHARGES = 30, 200


@dataclass
class Charges:
    """Charges in equal cells from E_a to E_b, each cell at a temperature of its own."""

    begin: Array
    end: Array
    temp: Array

    def time(self, limit: Table2, charger: Table1) -> Array:
        """Time with the limits read in the middle of every cell [h]."""
        cells = self.temp.shape[-1]
        share = (np.arange(cells) + 0.5) / cells
        energy = self.begin[..., None] + share * (self.end - self.begin)[..., None]
        power = np.minimum(limit(energy, self.temp), np.interp(energy, charger.x, charger.f))
        return ((self.end - self.begin)[..., None] / cells / power).sum(axis=-1)


def planes_at(planes: Array, charges: Charges) -> Array:
    """Values of planes (m, 3, S) at charges (n, S), shape (m, n, S)."""
    s_a, s_b, s_0 = planes.swapaxes(0, 1)[:, :, None]
    return np.asarray(s_a * charges.begin + s_b * charges.end + s_0)


@pytest.mark.parametrize("cells", [1, 3, 16])
@pytest.mark.parametrize("width", [1.0, 0.2, 0.0])
@pytest.mark.parametrize("seed", range(6))
def test_no_charge_is_faster(seed: int, width: float, cells: int) -> None:
    """Random tables, neither monotone nor smooth; boxes from wide to points."""
    rng = np.random.default_rng(seed)
    e, t = np.linspace(0.0, 82.0, 9), np.linspace(-30.0, 45.0, 7)
    limit = Table2(e, t, rng.uniform(1.0, 180.0, (9, 7)))
    charger = Table1([0.0, 30.0, 82.0], rng.uniform(5.0, 150.0, 3))

    def box(lo: Array, hi: Array) -> Interval:
        a, b = np.sort(rng.uniform(lo, hi, (2, STOPS)), axis=0)
        half = 0.5 * width * (b - a)
        return Interval(0.5 * (a + b) - half, 0.5 * (a + b) + half)

    def inside(x: Interval, *shape: int) -> Array:
        u = rng.uniform(-0.3, 1.3, (CHARGES, *shape)).clip(0.0, 1.0)
        lo, run = x.lo.reshape(-1, *[1] * (len(shape) - 1)), x.width
        return np.asarray(lo + u * run.reshape(lo.shape))

    begin = box(np.zeros(STOPS), np.full(STOPS, 60.0))
    end = box(begin.hi + 0.1, np.full(STOPS, 82.0))
    temp = box(np.full(STOPS, -30.0), np.full(STOPS, 45.0))
    planes = envelope_stay_under(
        limit, [charger] * STOPS, begin, end, temp, (end.hi - begin.lo) / cells
    )
    charges = Charges(inside(begin, STOPS), inside(end, STOPS), inside(temp, STOPS, cells))
    assert np.all(planes_at(planes, charges) <= charges.time(limit, charger))


def test_a_constant_limit_takes_energy_over_power() -> None:
    limit = Table2([0.0, 80.0], [-30.0, 40.0], np.full((2, 2), 50.0))
    begin, end = Interval(np.array([5.0]), np.array([20.0])), Interval(*np.array([[30.0], [70.0]]))
    temp = Interval(np.array([-10.0]), np.array([30.0]))
    charger = Table1.constant(90.0, 0.0, 80.0)
    planes = envelope_stay_under(limit, [charger], begin, end, temp, np.array([4.0]))
    charges = Charges(np.array([[5.0], [12.0]]), np.array([[70.0], [33.0]]), np.zeros((2, 1, 5)))
    exact = charges.time(limit, charger)
    np.testing.assert_allclose(planes_at(planes, charges), [exact] * len(planes), atol=1e-6)


def test_a_curve_that_falls_is_followed_over_its_whole_length() -> None:
    """From 10 kWh to anywhere between 20 and 70, 150 kW falling to 20: at most 5 % is lost.

    The range of the power alone, which is what the cells have by themselves, loses half.
    """
    limit = Table2([0.0, 10.0, 70.0, 80.0], [0.0, 40.0], np.repeat([[150, 150, 20, 20]], 2, 0).T)
    begin, end = Interval(*np.full((2, 1), 10.0)), Interval(*np.array([[20.0], [70.0]]))
    temp, charger = Interval(*np.full((2, 1), 20.0)), Table1.constant(400.0, 0.0, 80.0)
    planes = envelope_stay_under(limit, [charger], begin, end, temp, np.array([60.0 / 48]))
    to = np.linspace(20.0, 70.0, 26)[:, None]
    charges = Charges(np.full_like(to, 10.0), to, np.full((26, 1, 48), 20.0))
    exact = charges.time(limit, charger)
    assert np.all(planes_at(planes, charges).max(axis=0) >= 0.95 * exact)
    assert float(exact[-1, 0]) > 2.0 * (70.0 - 10.0) / 150.0
