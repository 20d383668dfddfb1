"""Owns the transcription as a smooth nonlinear program, ordered stage by stage.

Reads the same ``Instance`` arrays as the relaxation. Every driving step and
every charging cell is one stage with states first and controls after; the
only coupling is ``x_{k+1} = f(x_k, u_k)``, which is what FATROP exploits and
what costs IPOPT nothing. The implicit midpoint stays implicit: temperature
rise and battery power are controls, heat and power balance path constraints.
The energy of a stop is a state that its first cell chooses and its other
cells carry along. Knows nothing of solvers and starts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from benchmarks.reference.splines import fit_curve
from benchmarks.reference.stages import Stages, make_stages
from relax.instance import MIN_CHARGE_KWH, Instance, Stop
from relax.plan import Controls, StopControls

__all__ = ["SCALES", "Model", "make_model"]

Array = npt.NDArray[np.float64]

SCALES = {
    "energy": 10.0,
    "temperature": 10.0,
    "charge": 10.0,
    "dwell": 0.1,
    "power": 10.0,
    "rise": 10.0,
    "heater": 10.0,
    "cooling": 10.0,
    "pump": 10.0,
    "brake": 10.0,
    "charge_power": 100.0,
    "over": 0.1,
}
"""Size of every variable by its name [kWh, K, kW, h]; those of the program are of order one."""
BALANCE_SCALE_KW = 10.0
"""Size of power balances and actuator limits."""
LIMIT_SCALE_KW = 100.0
"""Size of the battery's and the charger's power limits."""
COST_SCALE = 100.0
"""Size of the objective [currency]."""
MIN_CHARGE_KW = 1.0
"""Least charging power of a cell [kW]: bounds the dwell, far below any use."""

Row = dict[str, int]


@dataclass(frozen=True)
class Model:
    """The program min f(x), g_lo <= g(x) <= g_hi, x_lo <= x <= x_hi, in stage order.

    Parameters
    ----------
    instance : Instance
        What it transcribes.
    program : dict
        Symbolic x, f, g as CasADi's ``nlpsol`` takes them; f without the fixed cost,
        over ``COST_SCALE``.
    x_lo, x_hi, scale : ndarray, shape (n,)
        Bounds of the scaled variables and their sizes.
    g_lo, g_hi : ndarray, shape (m,)
        Bounds of the constraints.
    nx, nu, ng : tuple of int
        States, controls and path constraints of every stage.
    steps, cells : tuple
        Position of every variable by name: per driving step; per stop and cell.
    last : dict
        The same for the final state.
    discharge : tuple of int
        Positions of the discharge limits among the constraints; empty without them.
    """

    instance: Instance
    program: dict[str, Any]
    x_lo: Array
    x_hi: Array
    scale: Array
    g_lo: Array
    g_hi: Array
    nx: tuple[int, ...]
    nu: tuple[int, ...]
    ng: tuple[int, ...]
    steps: tuple[Row, ...]
    cells: tuple[tuple[Row, ...], ...]
    last: Row
    discharge: tuple[int, ...]

    def controls(self, x: Array) -> Controls:
        """Return the controls at a point of the program, shape (n,)."""
        value = np.asarray(x, dtype=np.float64) * self.scale

        def column(rows: tuple[Row, ...], name: str) -> Array:
            return np.array([max(0.0, value[row[name]]) if name in row else 0.0 for row in rows])

        return Controls(
            column(self.steps, "heater"),
            column(self.steps, "cooling"),
            column(self.steps, "pump"),
            tuple(
                StopControls(
                    float(value[rows[0]["charge"]]),
                    column(rows, "charge_power"),
                    column(rows, "heater"),
                    column(rows, "cooling"),
                    column(rows, "pump"),
                )
                for rows in self.cells
            ),
        )


class _Writer:
    """Appends stages; remembers the state that the next stage starts from."""

    def __init__(self, instance: Instance, stages: Stages, with_discharge_limit: bool) -> None:
        self.instance, self.stages = instance, stages
        self.with_discharge_limit = with_discharge_limit
        self.x: list[Any] = []
        self.x_lo: list[float] = []
        self.x_hi: list[float] = []
        self.scale: list[float] = []
        self.g: list[Any] = []
        self.g_lo: list[float] = []
        self.g_hi: list[float] = []
        self.costs: list[Any] = []
        self.nx: list[int] = []
        self.nu: list[int] = []
        self.ng: list[int] = []
        self.row: Row = {}
        self.discharge: list[int] = []
        self.limited = False
        self.paths: list[tuple[Any, float, float]] = []
        self.state: dict[str, Any] = {
            "energy": instance.start_energy_kwh,
            "temperature": instance.start_temperature_c,
        }

    def variable(self, name: str, lo: float = -inf, hi: float = inf) -> Any:
        """Add a variable of the present stage; bounds and result in physical units."""
        scale = SCALES[name]
        symbol = ca.SX.sym(name)
        self.row[name] = len(self.x)
        self.x.append(symbol)
        self.x_lo.append(lo / scale)
        self.x_hi.append(hi / scale)
        self.scale.append(scale)
        return symbol * scale

    def path(self, expression: Any, scale: float, lo: float = -inf, hi: float = inf) -> None:
        """Add a constraint lo <= expression <= hi of the present stage."""
        self.paths.append((expression / scale, lo / scale, hi / scale))

    def begin(self, **bounds: tuple[float, float]) -> dict[str, Any]:
        """Open a stage: its states, the gap to the stage before, and that stage's paths."""
        self.row = {}
        if not self.nx:  # the states of the first stage are given: constants, no variables
            self.nx.append(0)
            return self.state
        states = {name: self.variable(name, *bounds[name]) for name in self.state}
        for name, value in self.state.items():
            self.constraint((states[name] - value) / SCALES[name], 0.0, 0.0)
        for path in self.paths:
            self.constraint(*path)
        if self.limited:  # the discharge limit is the last path of a driving step
            self.discharge.append(len(self.g) - 1)
            self.limited = False
        self.ng.append(len(self.paths))
        self.nx.append(len(states))
        self.paths = []
        return states

    def constraint(self, expression: Any, lo: float, hi: float) -> None:
        """Add a scaled constraint in its final place."""
        self.g.append(expression)
        self.g_lo.append(lo)
        self.g_hi.append(hi)

    def end(self, **state: Any) -> Row:
        """Close a stage with the state that follows; returns where its variables are."""
        self.nu.append(len(self.row) - self.nx[-1])
        self.state = state
        return self.row

    def actuators(self, demand: float) -> tuple[Any, Any, Any]:
        """Add heater, cooling and, where there is a demand, the heat pump."""
        car = self.instance.vehicle
        heater = self.variable("heater", 0.0, car.heater_kw)
        cooling = self.variable("cooling", 0.0, car.cooling_kw)
        has_pump = car.heat_pump_kw > 0.0 and demand > 0.0
        return heater, cooling, self.variable("pump", 0.0, car.heat_pump_kw) if has_pump else 0.0

    def cabin(self, demand: float, heater: Any, heat: Any, cabin_heater: Any) -> None:
        """Add the limits of the heat pump's heat and of the shared heater."""
        car = self.instance.vehicle
        if demand <= 0.0:
            return
        if "pump" in self.row:
            self.path(demand - heat, BALANCE_SCALE_KW, lo=0.0)
        self.path(heater + cabin_heater, BALANCE_SCALE_KW, hi=car.heater_kw)


def _write_step(w: _Writer, k: int, energy_bounds: tuple[float, float]) -> Row:
    """One driving step as a stage."""
    drive, instance = w.instance.drive, w.instance
    d, base, demand = (float(a[k]) for a in (drive.duration_h, drive.base_kw, drive.cabin_heat_kw))
    state = w.begin(
        energy=energy_bounds, temperature=(instance.temperature_min_c, instance.temperature_max_c)
    )
    power, rise = w.variable("power"), w.variable("rise")
    heater, cooling, pump = w.actuators(demand)
    brake = w.variable("brake", 0.0, -base) if base < 0.0 else 0.0
    known = (
        drive.ripple_kw2, drive.drivetrain_heat_kw, drive.heat_loss_kw_per_k, drive.ambient_c,
    )  # fmt: skip
    energy, temp = state["energy"], state["temperature"]
    balance, heat_balance, heat, cabin_heater, room = w.stages.step(
        energy, temp, power, rise, heater, cooling, pump, brake,
        d, base, *(float(a[k]) for a in known), demand,
    )  # fmt: skip
    w.path(balance, BALANCE_SCALE_KW, lo=0.0, hi=0.0)
    w.path(heat_balance, BALANCE_SCALE_KW, lo=0.0, hi=0.0)
    w.cabin(demand, heater, heat, cabin_heater)
    if base < 0.0:
        w.path(room, LIMIT_SCALE_KW, lo=0.0)
    if w.with_discharge_limit:
        mid = (energy - 0.5 * d * power, temp + 0.5 * rise)
        w.path(w.stages.discharge_room(*mid, power), LIMIT_SCALE_KW, lo=0.0)
        w.limited = True
    return w.end(energy=energy - d * power, temperature=temp + rise)


def _write_stop(w: _Writer, stop: Stop, arrive: tuple[float, float]) -> tuple[Row, ...]:
    """One stop, a stage per cell."""
    instance = w.instance
    cells, top = instance.cells, instance.energy_max_kwh
    heat_scale = instance.vehicle.pack.heat_capacity_kwh_per_k * SCALES["rise"]
    limit = fit_curve(stop.grid_limit_kw, 0.0, top)
    rows = []
    for j in range(cells):
        state = w.begin(
            energy=arrive if j == 0 else (stop.arrive_min_kwh, top),
            temperature=(instance.temperature_min_c, instance.temperature_max_c),
            charge=(MIN_CHARGE_KWH, top),
            dwell=(0.0, stop.max_dwell_h),
        )
        energy, temp = state["energy"], state["temperature"]
        if j == 0:
            energy = energy - stop.detour_in_kwh
            charge, spent = w.variable("charge", MIN_CHARGE_KWH, top), 0.0
        else:
            charge, spent = state["charge"], state["dwell"]
        portion = charge / cells
        power, rise = w.variable("charge_power", MIN_CHARGE_KW), w.variable("rise")
        heater, cooling, pump = w.actuators(stop.cabin_heat_kw)
        heat_balance, heat, cabin_heater, dwell, grid, room = w.stages.cell(
            energy, temp, portion, power, rise, heater, cooling, pump,
            stop.base_kw, stop.heat_loss_kw_per_k, stop.ambient_c, stop.cabin_heat_kw,
        )  # fmt: skip
        w.path(heat_balance, heat_scale, lo=0.0, hi=0.0)
        w.cabin(stop.cabin_heat_kw, heater, heat, cabin_heater)
        w.path(room, LIMIT_SCALE_KW, lo=0.0)
        w.path(limit(energy + 0.5 * portion) - grid, LIMIT_SCALE_KW, lo=0.0)
        w.costs.append((stop.price_per_kwh * grid + stop.time_price_per_h) * dwell)
        spent = spent + dwell
        energy, temp = energy + portion, temp + rise
        if j < cells - 1:
            rows.append(w.end(energy=energy, temperature=temp, charge=charge, dwell=spent))
            continue
        w.path(spent, SCALES["dwell"], hi=stop.max_dwell_h)
        if stop.occupancy_price_per_h > 0.0:
            over = w.variable("over", 0.0)
            w.path(over - spent, SCALES["over"], lo=-stop.occupancy_free_h)
            w.costs.append(stop.occupancy_price_per_h * over)
        rows.append(w.end(energy=energy - stop.detour_out_kwh, temperature=temp))
    return tuple(rows)


def make_model(
    instance: Instance, stages: Stages | None = None, with_discharge_limit: bool = True
) -> Model:
    """Write the nonlinear program of an instance.

    Parameters
    ----------
    instance : Instance
        Subset and grid.
    stages : Stages, optional
        Written before for the same trip: all subsets share them.
    with_discharge_limit : bool
        Whether to write the discharge limit. It rarely binds and is a third of the
        work of an iteration; without it, the caller checks the plan and comes back.

    Returns
    -------
    Model
        The program and where its variables are.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> model = make_model(make_instance(load_trip("paper-400km"), (0, 2)))
    >>> len(model.nx) == 100 + 2 * 12 + 1, model.nx[:2]
    (True, (0, 2))
    """
    w = _Writer(instance, stages or make_stages(instance), with_discharge_limit)
    n, top = instance.drive.n_steps, instance.energy_max_kwh
    steps, cells = [], []
    after = (0.0, top)
    for k in range(n + 1):
        bounds = (max(after[0], float(instance.energy_min_kwh[k])), after[1])
        for stop in (s for s in instance.stops if s.node == k):
            arrive = (max(bounds[0], stop.arrive_min_kwh + stop.detour_in_kwh), bounds[1])
            cells.append(_write_stop(w, stop, arrive))
            bounds = (stop.leave_min_kwh, top - stop.detour_out_kwh)
        if k < n:
            steps.append(_write_step(w, k, bounds))
            after = (0.0, top)
    w.begin(
        energy=(max(bounds[0], instance.end_energy_min_kwh), bounds[1]),
        temperature=(instance.temperature_min_c, instance.temperature_max_c),
    )
    w.ng.append(0)
    last = w.end()
    cost = ca.sum1(ca.vertcat(*w.costs)) if w.costs else ca.SX(0.0)
    return Model(
        instance=instance,
        program={"x": ca.vertcat(*w.x), "f": cost / COST_SCALE, "g": ca.vertcat(*w.g)},
        x_lo=np.array(w.x_lo),
        x_hi=np.array(w.x_hi),
        scale=np.array(w.scale),
        g_lo=np.array(w.g_lo),
        g_hi=np.array(w.g_hi),
        nx=tuple(w.nx),
        nu=tuple(w.nu),
        ng=tuple(w.ng),
        steps=tuple(steps),
        cells=tuple(cells),
        last=last,
        discharge=tuple(w.discharge),
    )
