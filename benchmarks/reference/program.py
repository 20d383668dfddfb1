"""Owns the form of a nonlinear program: its variables by name, stage by stage, and their sizes.

``Model`` is the finished program, ``Writer`` appends stages to one. The only
coupling of stages is ``x_{k+1} = f(x_k, u_k)``. Knows no equation of the car.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from benchmarks.reference.stages import Stages
from relax.instance import Instance
from relax.plan import Controls, StopControls

__all__ = ["BALANCE_SCALE_KW", "COST_SCALE", "LIMIT_SCALE_KW", "SCALES", "Model", "Row", "Writer"]

Array = npt.NDArray[np.float64]

SCALES = {
    "energy": 10.0,
    "temperature": 10.0,
    "charge": 10.0,
    "dwell": 0.1,
    "stopped": 0.1,
    "power": 10.0,
    "rise": 10.0,
    "heater": 10.0,
    "cooling": 10.0,
    "pump": 10.0,
    "brake": 10.0,
    "charge_power": 100.0,
    "over": 0.1,
    "use": 1.0,
}
"""Size of every variable by its name [kWh, K, kW, h]; those of the program are of order one."""
BALANCE_SCALE_KW = 10.0
"""Size of power balances and actuator limits."""
LIMIT_SCALE_KW = 100.0
"""Size of the battery's and the charger's power limits."""
COST_SCALE = 100.0
"""Size of the objective [currency]."""
Row = dict[str, int]


@dataclass(frozen=True)
class Model:
    """The program min f(x), g_lo <= g(x) <= g_hi, x_lo <= x <= x_hi, in stage order.

    Parameters
    ----------
    instance : Instance
        What it transcribes.
    integrator : str
        By which rule.
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
    discharge, dwell : tuple of int
        Positions of the limits of discharging and of dwells among the constraints.
    """

    instance: Instance
    integrator: str
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
    dwell: tuple[int, ...]

    def used(self, x: Array) -> tuple[int, ...]:
        """Return the positions of the stops that a point uses, shape (n,)."""
        first = [rows[0] for rows in self.cells]
        return tuple(i for i, row in enumerate(first) if "use" not in row or x[row["use"]] > 0.5)

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


class Writer:
    """Appends stages; remembers the state that the next stage starts from."""

    def __init__(
        self, instance: Instance, stages: Stages, with_discharge_limit: bool, optional: bool
    ) -> None:
        self.instance, self.stages = instance, stages
        self.with_discharge_limit, self.optional = with_discharge_limit, optional
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
        self.marked: dict[str, list[int]] = {"discharge": [], "dwell": []}
        self.paths: list[tuple[Any, float, float, str]] = []
        self.stopped: Any = None
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

    def path(
        self, expression: Any, scale: float, lo: float = -inf, hi: float = inf, mark: str = ""
    ) -> None:
        """Add a constraint lo <= expression <= hi of the present stage, to be found by a mark."""
        self.paths.append((expression / scale, lo / scale, hi / scale, mark))

    def begin(self, **bounds: tuple[float, float]) -> dict[str, Any]:
        """Open a stage: its states, the gap to the stage before, and that stage's paths."""
        self.row = {}
        if not self.nx:  # the states of the first stage are given: constants, no variables
            self.nx.append(0)
            return self.state
        states = {name: self.variable(name, *bounds[name]) for name in self.state}
        for name, value in self.state.items():
            self.constraint((states[name] - value) / SCALES[name], 0.0, 0.0)
        self.stopped = states.get("stopped")
        for *path, mark in self.paths:
            if mark:
                self.marked[mark].append(len(self.g))
            self.constraint(*path)
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
        if self.stopped is not None:  # the time at stops so far, where the trip limits it
            state["stopped"] = self.stopped
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

    def model(self, steps: tuple[Row, ...], cells: tuple[tuple[Row, ...], ...], last: Row) -> Model:
        """Return the finished program."""
        cost = ca.sum1(ca.vertcat(*self.costs)) if self.costs else ca.SX(0.0)
        return Model(
            instance=self.instance,
            integrator=self.stages.integrator,
            program={"x": ca.vertcat(*self.x), "f": cost / COST_SCALE, "g": ca.vertcat(*self.g)},
            x_lo=np.array(self.x_lo),
            x_hi=np.array(self.x_hi),
            scale=np.array(self.scale),
            g_lo=np.array(self.g_lo),
            g_hi=np.array(self.g_hi),
            nx=tuple(self.nx),
            nu=tuple(self.nu),
            ng=tuple(self.ng),
            steps=steps,
            cells=cells,
            last=last,
            discharge=tuple(self.marked["discharge"]),
            dwell=tuple(self.marked["dwell"]),
        )
