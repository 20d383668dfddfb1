"""Owns the measurement of tightness: how far each relaxed term is from the exact one at a point.

Not assumed, measured: at the optimum of a relaxation every relaxed term is
compared with the exact term at the same state and controls, and the dual says
what a kWh of electricity and a kWh of pack heat are worth there. Equation labels
are those of ``docs/relaxation.md``. Knows no solver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.instance import Instance
from relax.maps import Table1, Table2
from relax.physics import heat_pump_heat
from relax.program import ConeProgram
from relax.reach_heat import cooling_floor_c

__all__ = ["LossWorth", "TermTightness", "measure_loss_worth", "measure_tightness"]

Array = npt.NDArray[np.float64]

LEAST_DWELL_H = 1e-9
"""Cells shorter than this count as this long where energies are turned into powers [h]."""


@dataclass(frozen=True)
class TermTightness:
    """Distance between relaxed and exact of one term over the trip.

    Parameters
    ----------
    term : str
        Which term, and whether while driving or at the stops.
    label : str
        Equation of ``docs/relaxation.md``.
    largest_kw, largest_kwh : float
        Largest distance in one step or cell, as power and as energy [kW, kWh].
    where_km : float
        Position of the largest distance in energy [km].
    above_kwh, below_kwh : float
        Sum over the trip of what the relaxation has too much and too little [kWh].
        Limits count only where they are exceeded, as above.

    Examples
    --------
    >>> TermTightness("loss", "(R6)", 0.5, 0.02, 8.0, 0.25, 0.75).net_kwh
    -0.5
    """

    term: str
    label: str
    largest_kw: float
    largest_kwh: float
    where_km: float
    above_kwh: float
    below_kwh: float

    @property
    def net_kwh(self) -> float:
        """Signed sum over the trip [kWh]."""
        return self.above_kwh - self.below_kwh


@dataclass(frozen=True)
class LossWorth:
    """What a kWh of electricity and a kWh of pack heat are worth where a Joule loss arises.

    A loss costs the one and brings the other. Where heat is worth less, the
    optimum wants the loss small and the side from below is the one that binds; where it
    is worth more, only the side from above keeps the loss honest.

    Parameters
    ----------
    drive_electricity, drive_heat : ndarray, shape (n,)
        Per driving step [currency/kWh].
    stop_electricity, stop_heat : ndarray, shape (S, K)
        Per charging cell [currency/kWh].
    """

    drive_electricity: Array
    drive_heat: Array
    stop_electricity: Array
    stop_heat: Array


def _row(term: str, label: str, gap_kwh: Array, hours: Array, km: Array) -> TermTightness:
    gap, size = gap_kwh.ravel(), np.abs(gap_kwh).ravel()
    time = np.maximum(hours.ravel(), LEAST_DWELL_H)
    return TermTightness(
        term=term,
        label=label,
        largest_kw=float((size / time).max(initial=0.0)),
        largest_kwh=float(size.max(initial=0.0)),
        where_km=float(km.ravel()[int(size.argmax())]) if size.size else 0.0,
        above_kwh=float(np.maximum(gap, 0.0).sum()),
        below_kwh=float(np.maximum(-gap, 0.0).sum()),
    )


def _at1(table: Table1, x: Array) -> Array:
    return table(np.clip(x, table.lo, table.hi))


def _at2(table: Table2, x: Array, y: Array) -> Array:
    """Table at points; a point that is off by rounding is moved to the domain."""
    return table(np.clip(x, table.x[0], table.x[-1]), np.clip(y, table.y[0], table.y[-1]))


class _Point:
    """A point of the relaxation, read by name."""

    def __init__(self, instance: Instance, program: ConeProgram, x: Array) -> None:
        self.instance, self.program, self.x = instance, program, x
        self.floor = cooling_floor_c(instance.vehicle)

    def value(self, name: str) -> Array:
        return self.program.value(name, self.x)

    def ratio(self, energy: Array, temp: Array) -> Array:
        """Resistance over squared voltage, R(T) / U^2(E) (P1)."""
        pack = self.instance.vehicle.pack
        return _at1(pack.resistance_ohm, temp) / _at1(pack.voltage_squared, energy)

    def pump_heat(self, power: Array, temp: Array) -> Array:
        vehicle = self.instance.vehicle
        cop = _at1(vehicle.heat_pump_cop, temp)
        return heat_pump_heat(power, cop, vehicle.heat_pump_droop_per_kw)

    def undue_cooling(self, cooling_kwh: Array, end: Array) -> Array:
        """Cooling energy that took a step or cell to an end below where cooling stops."""
        vehicle = self.instance.vehicle
        if vehicle.cooling_cop <= 0.0:
            return np.zeros_like(cooling_kwh)
        below = np.maximum(self.floor - end, 0.0) * vehicle.pack.heat_capacity_kwh_per_k
        return np.clip(cooling_kwh, 0.0, below / vehicle.cooling_cop)

    def drive(self) -> list[TermTightness]:
        """Terms of the driving steps."""
        instance, pack, drive = self.instance, self.instance.vehicle.pack, self.instance.drive
        d, km = drive.duration_h, drive.node_km[:-1]
        temp, power = self.value("temperature"), self.value("power")
        energy = self.value("energy")[1:] + 0.5 * d * power
        start = temp[:-1].copy()
        for i, stop in enumerate(instance.stops):
            if stop.node < start.size:
                start[stop.node] = self.value("stop_temperature")[i, -1]
        middle = 0.5 * (start + temp[1:])
        loss = self.ratio(energy, middle) * (power**2 + drive.ripple_kw2)
        heat = self.pump_heat(self.value("pump"), middle)
        taken = _at2(pack.charge_limit_kw, energy, middle)
        given = _at2(pack.discharge_limit_kw, energy, middle)
        # the car brakes only where the battery takes no more: too fast, or full
        room = np.maximum(instance.ceiling_kwh - self.value("energy")[1:], 0.0) / d
        brake = np.minimum(self.value("brake"), np.maximum(power + taken, 0.0))
        brake = np.minimum(brake, room)
        gaps = (
            ("Joule loss, driving", "(R6)", d * (self.value("loss") - loss)),
            ("heat-pump heat, driving", "(R4)", d * (self.value("pump_heat") - heat)),
            ("discharge limit, driving", "(R5)", d * np.maximum(power - given, 0.0)),
            ("charge limit, driving", "(R5)", d * np.maximum(-power - taken, 0.0)),
            ("needless braking, driving", "(R2)", d * brake),
            ("undue cooling, driving", "(R3)",
             self.undue_cooling(d * self.value("cooling"), temp[1:])),
        )  # fmt: skip
        return [_row(term, label, gap, d, km) for term, label, gap in gaps]

    def stops(self) -> list[TermTightness]:
        """Terms of the charging cells."""
        instance, K = self.instance, self.instance.cells
        pack, eta_c = instance.vehicle.pack, instance.vehicle.heater_cabin_efficiency
        border, charge = self.value("border"), self.value("charge")
        temp = 0.5 * (border[:, 1:] + border[:, :-1])
        y = np.maximum(self.value("dwell"), LEAST_DWELL_H)

        def each(name: str) -> Array:
            column = np.array([getattr(s, name) for s in instance.stops], dtype=np.float64)
            return np.broadcast_to(column[:, None], y.shape)

        before = self.value("leave")[:, None] + each("detour_out_kwh") - charge[:, None]
        e = np.broadcast_to(charge[:, None] / K, y.shape)
        energy = before + (np.arange(K) + 0.5) * e
        limit = _at2(pack.charge_limit_kw, energy, temp)
        grid_limit = np.stack(
            [_at1(s.grid_limit_kw, energy[i]) for i, s in enumerate(instance.stops)]
        )
        loss, pump, heat = (self.value(n) for n in ("cell_loss", "cell_pump", "cell_pump_heat"))
        grid = e + loss + each("base_kw") * y + (each("cabin_heat_kw") * y - heat) / eta_c
        grid = grid + self.value("cell_heater") + self.value("cell_cooling") + pump
        exchange = each("heat_loss_kw_per_k") * (temp * y - self.value("temp_dwell"))
        gaps = (
            ("Joule loss, stops", "(R6)", loss - self.ratio(energy, temp) * e**2 / y),
            ("heat-pump heat, stops", "(R8)", heat - y * self.pump_heat(pump / y, temp)),
            ("heat from ambient, stops", "(R8)", exchange),
            ("charge limit, stops", "(R9)", np.maximum(e - limit * y, 0.0)),
            ("grid limit, stops", "(R7)", np.maximum(grid - grid_limit * y, 0.0)),
            ("undue cooling, stops", "(R7)",
             self.undue_cooling(self.value("cell_cooling"), border[:, 1:])),
        )  # fmt: skip
        km = np.repeat([instance.drive.node_km[s.node] for s in instance.stops], K)
        return [_row(term, label, gap, y, km) for term, label, gap in gaps]


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
        Six terms of the driving steps and, with stops, six of the charging cells:
        relaxed minus exact at the point's own states and controls. All vanish at
        the lift of a simulated trajectory.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> from relax.solve import solve_cone
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> found = measure_tightness(instance, program, solve_cone(program).x)
    >>> found[0].term, found[0].largest_kw > 0.0
    ('Joule loss, driving', True)
    """
    point = _Point(instance, program, x)
    return tuple([*point.drive(), *(point.stops() if instance.stops else [])])


def measure_loss_worth(instance: Instance, program: ConeProgram, z: Array) -> LossWorth:
    """Return what the two effects of a Joule loss are worth, from the dual solution.

    Electricity: what one more kWh of load would cost. Heat: what one more kWh into the
    pack would save. Their difference is the multiplier that the rows of the loss
    itself carry: from below where it is > 0, from above where it is < 0.

    Parameters
    ----------
    instance : Instance
        What was relaxed.
    program : ConeProgram
        From ``build_relaxation``, or the same with rows taken out.
    z : ndarray
        The solver's dual vector (scaled), of an optimal solution.

    Returns
    -------
    LossWorth
        As good as the dual solution: evidence, not a proof.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> from relax.relaxation import build_relaxation
    >>> from relax.solve import solve_cone
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> program = build_relaxation(instance, make_box(instance))
    >>> worth = measure_loss_worth(instance, program, solve_cone(program).z)
    >>> worth.drive_heat.shape, worth.stop_heat.shape
    ((100,), (1, 12))
    """

    def through(columns: npt.NDArray[np.int64], *names: str) -> Array:
        """Reduced cost of columns [currency per unit] that comes from some rows alone."""
        part = np.zeros_like(z)
        for name, rows in program.rows.items():
            if name.startswith(names):
                part[rows] = z[rows]
        return np.asarray((program.A.T @ part / program.scale)[columns])

    d, loss = instance.drive.duration_h, program.variables["loss"]
    none = np.zeros((len(instance.stops), instance.cells))
    stop_electricity, stop_heat = none, none
    if instance.stops:
        cell = program.variables["cell_loss"]
        price = (program.q / program.scale)[cell]
        stop_electricity = price + through(cell, "grid limit")
        stop_heat = -through(cell, "cell heat")
    return LossWorth(
        drive_electricity=through(loss, "drive balance") / d,
        drive_heat=-through(loss, "drive heat") / d,
        stop_electricity=stop_electricity,
        stop_heat=stop_heat,
    )
