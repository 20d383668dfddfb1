"""Owns the measurement of tightness: how far each relaxed term is from the exact one at a point.

Not assumed, measured: at the optimum of a relaxation every relaxed term is
compared with the exact term at the same state and controls. Knows no solver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.instance import Instance
from relax.physics import heat_pump_heat
from relax.program import ConeProgram

__all__ = ["TermTightness", "measure_tightness"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TermTightness:
    """Distance between relaxed and exact of one term over the trip.

    Parameters
    ----------
    term : str
        Which term.
    largest : float
        Largest distance, in ``unit``.
    unit : str
        kW for driving steps, kWh or h for cells.
    where_km : float
        Position of the largest distance [km].
    above_kwh, below_kwh : float
        Sum over the trip of what the relaxation has too much and too little [kWh;
        for the dwell h].
    """

    term: str
    largest: float
    unit: str
    where_km: float
    above_kwh: float
    below_kwh: float


def _row(term: str, gap: Array, weight: Array, km: Array, unit: str) -> TermTightness:
    worst = int(np.argmax(np.abs(gap))) if gap.size else 0
    total = gap * weight
    return TermTightness(
        term=term,
        largest=float(np.abs(gap).max(initial=0.0)),
        unit=unit,
        where_km=float(km[worst]) if gap.size else 0.0,
        above_kwh=float(np.maximum(total, 0.0).sum()),
        below_kwh=float(np.maximum(-total, 0.0).sum()),
    )


def measure_tightness(
    instance: Instance, program: ConeProgram, x: Array
) -> tuple[TermTightness, ...]:
    """Return the tightness of every relaxed term at a point of the relaxation.

    Parameters
    ----------
    instance : Instance
        What was relaxed.
    program : ConeProgram
        From ``build_relaxation``.
    x : ndarray
        Scaled point, for example the solver's.

    Returns
    -------
    tuple of TermTightness
        Joule loss and heat-pump heat while driving; Joule loss, charging time, heat
        exchange and heat-pump heat at the stops.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> from relax.solve import solve_cone
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> found = measure_tightness(instance, program, solve_cone(program).x)
    >>> found[0].term, found[0].largest > 0.0
    ('Joule loss, driving', True)
    """
    pack, vehicle, drive = instance.vehicle.pack, instance.vehicle, instance.drive

    def value(name: str) -> Array:
        return program.value(name, x)

    km, d = drive.node_km[:-1], drive.duration_h
    energy, temp = value("energy"), value("temperature")
    power = value("power")
    e_mid = energy[1:] + 0.5 * d * power
    start = temp[:-1].copy()
    for i, stop in enumerate(instance.stops):
        if stop.node < start.size:
            start[stop.node] = value("stop_temperature")[i, -1]
    t_mid = 0.5 * (start + temp[1:])

    def ratio(e: Array, t: Array) -> Array:
        square, resistance = pack.voltage_squared, pack.resistance_ohm
        e, t = np.clip(e, square.lo, square.hi), np.clip(t, resistance.lo, resistance.hi)
        return resistance(t) / square(e)

    def cop(t: Array) -> Array:
        table = vehicle.heat_pump_cop
        return table(np.clip(t, table.lo, table.hi))

    exact = ratio(e_mid, t_mid) * (power**2 + drive.ripple_kw2)
    pump = value("pump")
    heat = heat_pump_heat(pump, cop(t_mid), vehicle.heat_pump_droop_per_kw)
    rows = [
        _row("Joule loss, driving", value("loss") - exact, d, km, "kW"),
        _row("heat-pump heat, driving", value("pump_heat") - heat, d, km, "kW"),
    ]
    if not instance.stops:
        return tuple(rows)
    K = instance.cells
    border = value("border")
    t_cell = 0.5 * (border[:, 1:] + border[:, :-1])
    y, charge = np.maximum(value("dwell"), 1e-9), value("charge")
    before = value("leave") + np.array([s.detour_out_kwh for s in instance.stops]) - charge
    e = np.broadcast_to(charge[:, None] / K, y.shape)
    e_cell = before[:, None] + (np.arange(K) + 0.5) * e
    table = pack.charge_limit_kw
    limit = table(
        np.clip(e_cell, table.x[0], table.x[-1]), np.clip(t_cell, table.y[0], table.y[-1])
    )
    pump = value("cell_pump")
    heat = y * heat_pump_heat(pump / y, cop(t_cell), vehicle.heat_pump_droop_per_kw)
    one = np.ones(y.size)
    where = np.repeat([drive.node_km[s.node] for s in instance.stops], K)
    g = np.repeat([s.heat_loss_kw_per_k for s in instance.stops], K)
    short = np.minimum(y - e / np.maximum(limit, 1e-6), 0.0)
    rows += [
        _row(
            "Joule loss, stops",
            (value("cell_loss") - ratio(e_cell, t_cell) * e**2 / y).ravel(), one, where, "kWh",
        ),
        _row("charging time", short.ravel(), one, where, "h"),
        _row("heat exchange, stops", (value("temp_dwell") - t_cell * y).ravel(), g, where, "K*h"),
        _row("heat-pump heat, stops", (value("cell_pump_heat") - heat).ravel(), one, where, "kWh"),
    ]  # fmt: skip
    return tuple(rows)
