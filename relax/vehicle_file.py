"""Owns the way from a checked vehicle document to a :class:`~relax.vehicle.Vehicle`.

Maps become tables; what the schema cannot say (signs, coverage, increasing axes)
is checked here. Knows nothing of trips: the ranges that must be covered are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from relax.document import Origin
from relax.errors import InputError
from relax.maps import DOMAIN_SLACK, Table1, Table2
from relax.schema import LimitProduct, LimitTable, VehicleFile
from relax.vehicle import Pack, RoadLoad, Vehicle

__all__ = [
    "AMBIENT_C",
    "LEAST_STEP",
    "SOC",
    "SPEED",
    "Axis",
    "check_covers",
    "make_points_table",
    "make_vehicle",
]

Array = npt.NDArray[np.float64]

LIMIT_TOLERANCE_KW = 0.1
"""Largest deviation [kW] between a power limit bilinear in (SoC, T), as given, and
bilinear in (energy, T), as the model reads it. SoC nodes are added until it holds."""

LEAST_STEP = 1e-6
"""Least distance between the nodes of an axis, in its unit: slopes stay finite."""

HALVINGS = 6
"""Most times a SoC segment is halved for it."""


@dataclass(frozen=True)
class Axis:
    """Axis of a map: its name and unit, and its range when the map is a plain number.

    Examples
    --------
    >>> Axis("speed", "km/h", 0.0, 300.0).unit
    'km/h'
    """

    name: str
    unit: str
    lo: float
    hi: float


LARGEST_OHM = 10.0
"""Pack resistance that only milliohms exceed [ohm]."""

SOC = Axis("SoC", "", 0.0, 1.0)
PACK_C = Axis("battery temperature", "degrees C", -60.0, 100.0)
AMBIENT_C = Axis("ambient temperature", "degrees C", -60.0, 100.0)
SPEED = Axis("speed", "km/h", 0.0, 300.0)


def make_points_table(
    points: float | list[tuple[float, float]],
    name: str,
    origin: Origin,
    axis: Axis = SOC,
    least: float = 0.0,
    positive: bool = False,
) -> Table1:
    """Return the table of a map given as points or as a number.

    Parameters
    ----------
    points : float or list of (float, float)
        The map.
    name : str
        Its field.
    origin : Origin
        For errors.
    axis : Axis
        What it is over.
    least : float
        Least value allowed.
    positive : bool
        Whether values must exceed ``least``.

    Raises
    ------
    InputError
        The axis does not increase or leaves its range, or a value is too small.

    Examples
    --------
    >>> make_points_table([(0.0, 150.0), (1.0, 50.0)], "curve", Origin("a.toml")).at(0.5)
    100.0
    """
    word = "more than" if positive else "at least"
    if isinstance(points, int | float):
        if points < least or (positive and points == least):
            raise origin.error(name, points, f"{word} {least:g}")
        return Table1.constant(float(points), axis.lo, axis.hi, name)
    for k, (before, point) in enumerate(pairwise(points), start=2):
        if not point[0] - before[0] > LEAST_STEP:
            allowed = f"{axis.name} more than in the point before, {before[0]:g}"
            raise origin.error(f"{name}.{k}", list(point), allowed)
    for k, point in enumerate(points, start=1):
        if not axis.lo <= point[0] <= axis.hi:
            allowed = f"{axis.name} from {axis.lo:g} to {axis.hi:g}"
            raise origin.error(f"{name}.{k}", list(point), f"{allowed} {axis.unit}".rstrip())
        if point[1] < least or (positive and point[1] == least):
            raise origin.error(f"{name}.{k}", list(point), f"values {word} {least:g}")
    x, f = zip(*points, strict=True)
    return Table1(x, f, name)


def check_covers(
    table: Table1 | Table2, axis: Axis, lo: float, hi: float, origin: Origin, why: str
) -> None:
    """Raise unless an axis of a table reaches from lo to hi.

    Raises
    ------
    InputError
        It does not: maps never extrapolate.

    Examples
    --------
    >>> curve = Table1([0.1, 1.0], [5.0, 5.0], "curve")
    >>> check_covers(curve, SOC, 0.05, 1.0, Origin("a.toml"), "limits.soc_min")
    Traceback (most recent call last):
        ...
    relax.errors.InputError: a.toml: curve: 'SoC 0.1 to 1'; allowed: a map that covers SoC 0.05 ...
    """
    grid = table.y if isinstance(table, Table2) and axis is not SOC else table.x
    slack = DOMAIN_SLACK * (grid[-1] - grid[0])  # a mean of equal values may miss them by rounding
    if grid[0] - slack > lo or grid[-1] + slack < hi:
        unit = f" {axis.unit}" if axis.unit else ""
        shown = f"{axis.name} {grid[0]:g} to {grid[-1]:g}{unit}"
        allowed = f"a map that covers {axis.name} {lo:g} to {hi:g}{unit} ({why})"
        raise origin.error(table.name, shown, allowed)


def make_vehicle(
    spec: VehicleFile,
    origin: Origin,
    temperature_min_c: float | None = None,
    temperature_max_c: float | None = None,
) -> Vehicle:
    """Return the vehicle of a document.

    Parameters
    ----------
    spec : VehicleFile
        The document.
    origin : Origin
        For errors.
    temperature_min_c, temperature_max_c : float, optional
        Tighter limits of the battery temperature [degrees C].

    Returns
    -------
    Vehicle

    Raises
    ------
    InputError
        A map has a wrong sign, does not increase along its axis, or does not
        cover the battery's temperature limits.

    Examples
    --------
    >>> from relax.load import load_vehicle, shipped_vehicles
    >>> load_vehicle(shipped_vehicles()[0]).pack.capacity_ah > 0
    True
    """

    def table(field: str, axis: Axis, least: float = 0.0, positive: bool = False) -> Table1:
        return make_points_table(getattr(spec, field), field, origin, axis, least, positive)

    lo = spec.temperature_min_c if temperature_min_c is None else temperature_min_c
    hi = spec.temperature_max_c if temperature_max_c is None else temperature_max_c
    if not spec.temperature_min_c < spec.temperature_max_c:
        allowed = f"more than temperature_min_c, {spec.temperature_min_c:g} degrees C"
        raise origin.error("temperature_max_c", spec.temperature_max_c, allowed)
    ocv = table("ocv_v", SOC, positive=True)
    pack = Pack(
        capacity_ah=spec.capacity_ah,
        ocv_v=ocv,
        resistance_ohm=table("resistance_ohm", PACK_C),
        charge_limit_soc_kw=_limit(spec.charge_limit, "charge_limit", origin, ocv),
        discharge_limit_soc_kw=_limit(spec.discharge_limit, "discharge_limit", origin, ocv),
        heat_capacity_kwh_per_k=spec.heat_capacity_kwh_per_k,
        temperature_min_c=lo,
        temperature_max_c=hi,
    )
    if (most := float(pack.resistance_ohm.f.max())) > LARGEST_OHM:
        raise origin.error("resistance_ohm", most, f"values at most {LARGEST_OHM:g} ohm")
    cop = _heat_pump_cop(spec, origin)
    for map_ in (pack.resistance_ohm, pack.charge_limit_soc_kw, pack.discharge_limit_soc_kw, cop):
        check_covers(map_, PACK_C, lo, hi, origin, "the battery's temperature limits")
    heat_loss = table("heat_loss_kw_per_k", SPEED)
    check_covers(heat_loss, SPEED, 0.0, 0.0, origin, "parked")
    heating, cooling = (table(f"cabin_{x}_kw", AMBIENT_C) for x in ("heating", "cooling"))
    try:
        return Vehicle(
            name=spec.name,
            pack=pack,
            road_load=RoadLoad(
                mass_kg=spec.mass_kg,
                a_n=spec.road_load_a_n,
                b_n_per_kmh=spec.road_load_b_n_per_kmh,
                c_n_per_kmh2=spec.road_load_c_n_per_kmh2,
                drive_efficiency=spec.drive_efficiency,
                regen_efficiency=spec.regen_efficiency,
                regen_max_kw=spec.regen_max_kw,
                factor=spec.propulsion_factor,
                heat_share=spec.drivetrain_heat_share,
            ),
            heat_loss_kw_per_k=heat_loss,
            heater_kw=spec.heater_kw,
            heater_battery_efficiency=spec.heater_battery_efficiency,
            heater_cabin_efficiency=spec.heater_cabin_efficiency,
            cooling_kw=spec.cooling_kw,
            cooling_cop=spec.cooling_cop,
            cooling_from_c=spec.cooling_from_c,
            heat_pump_kw=spec.heat_pump_kw,
            heat_pump_cop=cop,
            heat_pump_droop_per_kw=spec.heat_pump_droop_per_kw,
            cabin_heating_kw=heating,
            cabin_cooling_kw=cooling,
            auxiliary_kw=spec.auxiliary_kw,
        )
    except InputError as error:  # what cars of the library are held to as well
        raise origin.error(error.field, error.value, error.allowed) from None


def _heat_pump_cop(spec: VehicleFile, origin: Origin) -> Table1:
    """CoP table; 1 everywhere when there is no heat pump and no map."""
    points = spec.heat_pump_cop
    if points is None:
        if spec.heat_pump_kw > 0.0:
            allowed = "required when heat_pump_kw is above 0: points [degrees C, CoP] or a number"
            raise origin.error("heat_pump_cop", None, allowed)
        points = 1.0
    return make_points_table(points, "heat_pump_cop", origin, PACK_C, least=1.0)


def _limit(spec: LimitTable | LimitProduct, name: str, origin: Origin, ocv: Table1) -> Table2:
    """Power limit as a table over (SoC, T), cut to the SoC range of the voltage.

    A product of two piecewise linear factors *is* bilinear on the union of their
    nodes, so tabulating it loses nothing.
    """
    if isinstance(spec, LimitProduct):
        curve = make_points_table(spec.curve_kw, f"{name}.curve_kw", origin, SOC)
        factor_name = f"{name}.temperature_factor"
        factor = make_points_table(spec.temperature_factor, factor_name, origin, PACK_C)
        soc, temperature, power = curve.x, factor.x, np.outer(curve.f, factor.f)
    else:
        for axis_name, axis in (("soc", spec.soc), ("temperature_c", spec.temperature_c)):
            if any(b - a <= LEAST_STEP for a, b in pairwise(axis)):
                raise origin.error(f"{name}.{axis_name}", axis, "strictly increasing numbers")
        shape = (len(spec.soc), len(spec.temperature_c))
        rows = [len(row) for row in spec.power_kw]
        if rows != [shape[1]] * shape[0]:
            shown = f"{len(rows)} rows of {sorted(set(rows))} numbers"
            allowed = f"{shape[0]} rows (soc) of {shape[1]} numbers (temperature_c)"
            raise origin.error(f"{name}.power_kw", shown, allowed)
        soc, temperature = np.array(spec.soc), np.array(spec.temperature_c)
        power = np.array(spec.power_kw)
    lo, hi = max(soc[0], ocv.lo), min(soc[-1], ocv.hi)
    if not lo < hi:
        shown = f"SoC {soc[0]:g} to {soc[-1]:g}"
        raise origin.error(name, shown, f"SoC that ocv_v covers, {ocv.lo:g} to {ocv.hi:g}")
    table = Table2(soc, temperature, power, name)
    inner = soc[(soc > lo) & (soc < hi)]
    nodes = _refine(table, np.concatenate([[lo], inner, [hi]]), ocv)
    return Table2(nodes, temperature, table(nodes[:, None], temperature[None, :]), name)


def _refine(table: Table2, nodes: Array, ocv: Table1) -> Array:
    """Halve SoC segments until bilinear in energy is bilinear in SoC to the tolerance."""
    charge = np.concatenate([[0.0], np.cumsum(0.5 * (ocv.f[1:] + ocv.f[:-1]) * np.diff(ocv.x))])
    for _ in range(HALVINGS):
        added = []
        for a, b in pairwise(nodes):
            probe = np.union1d(np.linspace(a, b, 9), ocv.x[(ocv.x > a) & (ocv.x < b)])
            i = np.clip(np.searchsorted(ocv.x, probe, side="right") - 1, 0, ocv.x.size - 2)
            width = probe - ocv.x[i]
            energy = charge[i] + 0.5 * (ocv.f[i] + ocv(probe)) * width
            share = (energy - energy[0]) / (energy[-1] - energy[0])
            bend = np.abs(share - (probe - a) / (b - a)).max()
            step = np.abs(table(b, table.y) - table(a, table.y)).max()
            if bend * step > LIMIT_TOLERANCE_KW:
                added.append(0.5 * (a + b))
        if not added:
            break
        nodes = np.union1d(nodes, added)
    return nodes
