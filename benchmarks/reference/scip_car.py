"""Owns the maps of one trip as SCIP gets them, and the ranges that bound its variables.

Knows no program.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from benchmarks.reference.scip_maps import FIT_TOLERANCE, Band, SurfaceCap, fit_band, fit_cap
from relax.instance import Instance
from relax.maps import Table1

__all__ = ["Maps", "fit_maps", "largest_power", "table_range"]


@dataclass(frozen=True)
class Maps:
    """The maps of a trip as forms.

    Parameters
    ----------
    resistance, voltage_squared : Band
        Over temperature and internal energy.
    cop : Band or None
        Over temperature; None without a heat pump.
    inverse_cop : bool
        Whether ``cop`` is of one over the coefficient: nearly affine for a Carnot cycle.
    charge_limit : SurfaceCap
        Upper bound over internal energy and temperature.
    grid_limit : tuple of Band
        Per stop, over internal energy.
    """

    resistance: Band
    voltage_squared: Band
    cop: Band | None
    inverse_cop: bool
    charge_limit: SurfaceCap
    grid_limit: tuple[Band, ...]

    @property
    def deviation(self) -> dict[str, float]:
        """Largest relative distance between form and table, by map."""
        found = {
            "resistance": self.resistance.deviation,
            "voltage_squared": self.voltage_squared.deviation,
            "charge_limit": self.charge_limit.deviation,
        }
        if self.cop is not None:
            found["cop"] = self.cop.deviation
        if self.grid_limit:
            found["grid_limit"] = max(band.deviation for band in self.grid_limit)
        return found


def fit_maps(instance: Instance, tolerance: float = FIT_TOLERANCE) -> Maps:
    """Return the forms of a trip's maps.

    Parameters
    ----------
    instance : Instance
        Any subset of the trip.
    tolerance : float
        Error up to which a map may be a short form; 0: the tables themselves.

    Raises
    ------
    ValueError
        A map is not positive.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> maps = fit_maps(make_instance(load_trip("paper-400km"), (1,)))
    >>> maps.inverse_cop, max(maps.deviation.values()) < 0.01
    (True, True)
    """
    car, pack = instance.vehicle, instance.vehicle.pack
    t = instance.temperature_min_c, instance.temperature_max_c
    e = (
        min(float(instance.energy_min_kwh.min()), instance.end_energy_min_kwh),
        instance.ceiling_kwh,
    )
    cop, inverse = None, False
    if car.heat_pump_kw > 0.0:
        cop = fit_band(car.heat_pump_cop, *t, tolerance=tolerance)
        other = fit_band(car.heat_pump_cop, *t, inverse=True, tolerance=tolerance)
        if tolerance > 0.0 and other.form.is_affine and other.deviation <= tolerance:
            cop, inverse = other, True
    return Maps(
        resistance=fit_band(pack.resistance_ohm, *t, tolerance=tolerance),
        voltage_squared=fit_band(pack.voltage_squared, *e, tolerance=tolerance),
        cop=cop,
        inverse_cop=inverse,
        charge_limit=fit_cap(pack.charge_limit_kw, *e, *t, tolerance),
        grid_limit=tuple(
            fit_band(s.grid_limit_kw, *e, tolerance=tolerance) for s in instance.stops
        ),
    )


def table_range(table: Table1, lo: float, hi: float) -> tuple[float, float]:
    """Return least and largest value of a table on an interval.

    Examples
    --------
    >>> table_range(Table1([0.0, 1.0, 2.0], [1.0, 5.0, 2.0]), 0.5, 2.0)
    (2.0, 5.0)
    """
    inside = table.f[(table.x > lo) & (table.x < hi)].tolist()
    values = [table.at(lo), table.at(hi), *inside]
    return min(values), max(values)


def largest_power(load: float, r: float, ripple: float) -> float:
    """Return a bound of the battery power that serves a load [kW].

    Parameters
    ----------
    load : float
        The load, at most [kW].
    r : float
        Resistance over squared voltage, at most [1/kW].
    ripple : float
        Variance of the power [kW^2].

    Examples
    --------
    >>> round(largest_power(19.9, 0.00025, 0.0), 9)
    20.0
    """
    root = 1.0 - 4.0 * r * (load + r * ripple)
    if r == 0.0:
        return load
    return 2.0 * (load + r * ripple) / (1.0 + sqrt(root)) if root > 0.0 else 0.5 / r
