"""Owns the quadratic program of one refinement step: the values of its named rows.

Rows with a slack are elastic, so the program is always feasible. Knows the
transcription, not the loop around it and not the solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse

from relax.expansion import CellExpansion, DriveExpansion, convex_part
from relax.instance import MIN_CHARGE_KWH
from relax.plan import Trajectory
from relax.step_layout import StepLayout

__all__ = ["QuadraticStep", "StepProgram", "TrustRegion"]

Array = npt.NDArray[np.float64]
Coefficients = tuple[Array | float, ...]
Values = dict[str, tuple[Coefficients, Array | float]]

SLACK_ROOM = np.array([0.2, 2.0, 2.0, 0.02])
"""How far a step may violate limits of energy, temperature, discharge power and dwell beyond
what its trajectory already does [kWh, K, kW, h]; keeps the linear model where it is good."""
COOLS_KW = 1e-3
"""Cooling from which a step counts as cooled [kW]."""
MARGIN_K = 1e-3
"""How far inside the temperature limits programs aim: what their linear model may miss [K]."""
MARGIN_H = 1e-5
"""Likewise for the longest dwell [h]."""
MARGIN_KW = 1e-3
"""Likewise for the discharge limit [kW]."""
DRIVE_SCALE = np.array([0.5, 3.0, 0.5, 0.5])
"""Typical changes of (P, T, E, P_hp) between two iterates [kW, K, kWh, kW]."""
CELL_SCALE = np.array([0.3, 0.003, 3.0, 0.5, 0.01])
"""Typical changes of (W, y, T, E_arrive, H_p) between two iterates [kWh, h, K, kWh, kWh]."""


@dataclass(frozen=True)
class TrustRegion:
    """Largest change of every temperature and every stop's energy in one step [K, kWh]."""

    temperature_k: float = 8.0
    energy_kwh: float = 8.0

    def scaled(self, factor: float) -> TrustRegion:
        """Return the region times a factor."""
        return TrustRegion(self.temperature_k * factor, self.energy_kwh * factor)


@dataclass(frozen=True)
class StepProgram:
    """min 1/2 x'Px + q'x, first ``n_eq`` rows A x = b, the rest A x <= b."""

    P: sparse.csc_array
    q: Array
    A: sparse.csc_array
    b: Array
    n_eq: int

    def change(self, x: Array) -> float:
        """Return the predicted change of the penalised cost by a step x [currency]."""
        upper = self.P @ x
        return float(self.q @ x + x @ upper - 0.5 * (self.P.diagonal() @ (x * x)))


class QuadraticStep(StepLayout):
    """The step program of one instance: made once, filled at every iterate."""

    def _hessian(
        self, drive: DriveExpansion, cells: CellExpansion | None, z: Array | None, price: Array
    ) -> sparse.csc_array:
        """Return the convexified Hessian of the Lagrangian with the multipliers z."""
        vehicle, duration = self.instance.vehicle, self.instance.drive.duration_h
        n = duration.size

        def dual(name: str, size: int) -> Array:
            block = self.rows.slices.get(name)
            return np.zeros(size) if z is None or block is None else z[block]

        balance, heat = dual("balance", n) * duration, dual("heat", n) * duration
        pump_weight = heat + (balance - dual("heater_max", n)) / vehicle.heater_cabin_efficiency
        pump_weight = pump_weight + dual("cabin", n)
        # without demand the pump is pinned at zero and its multipliers are arbitrary
        pump_weight = np.where(self.instance.drive.cabin_heat_kw > 0.0, pump_weight, 0.0)
        blocks = -(balance + heat)[:, None, None] * drive.loss.hessian
        blocks += pump_weight[:, None, None] * drive.pump_heat.hessian
        blocks = convex_part(blocks, DRIVE_SCALE)
        full = np.swapaxes(self._drive_change, 1, 2) @ blocks @ self._drive_change
        a, b = self._upper[0]
        values = [full[:, a, b].ravel()]
        if cells is not None:
            m = cells.loss.value.size
            heat, grid = dual("cell_heat", m), dual("grid_limit", m) + price
            relief = grid + dual("cell_heater_max", m)
            pump = heat + dual("cell_cabin", m) - relief / vehicle.heater_cabin_efficiency
            demand = [s.cabin_heat_kw for s in self.instance.stops]
            pump = np.where(np.repeat(demand, self.instance.cells) > 0.0, pump, 0.0)
            conductance = np.repeat(
                [s.heat_loss_kw_per_k for s in self.instance.stops], self.instance.cells
            )
            blocks = (grid - heat)[:, None, None] * cells.loss.hessian
            blocks += dual("least_dwell", m)[:, None, None] * cells.least_dwell.hessian
            blocks += pump[:, None, None] * cells.pump_heat.hessian
            blocks += (heat * conductance)[:, None, None] * cells.exchange.hessian
            blocks -= dual("grid_limit", m)[:, None, None] * cells.grid_limit.hessian
            blocks = convex_part(blocks, CELL_SCALE)
            full = self._cell_change.T @ blocks @ self._cell_change
            a, b = self._upper[1]
            values.append(full[:, a, b].ravel())
        return self._pattern.matrix(np.concatenate(values))

    def build(
        self,
        trajectory: Trajectory,
        drive: DriveExpansion,
        cells: CellExpansion | None,
        multipliers: Array | None,
        penalty: Array,
        trust: TrustRegion,
    ) -> StepProgram:
        """Return the program at a trajectory.

        Parameters
        ----------
        trajectory : Trajectory
            The current iterate.
        drive, cells : DriveExpansion, CellExpansion or None
            Its expansions; no cells without stops.
        multipliers : ndarray or None
            Dual solution of the program before, shape (rows,).
        penalty : ndarray, shape (4,)
            Price of violated limits of energy, temperature, discharge power and dwell
            [currency per kWh, K, kW, h].
        trust : TrustRegion
            Bounds of the step.
        """
        values: Values = {
            "origin": ((1.0,), 0.0),
            "slack_min": ((-1.0,), 0.0),
            "slack_max": ((1.0,), trajectory.violation + SLACK_ROOM),
        }
        self._drive_values(values, trajectory, drive, trust)
        q = np.zeros(self.n_columns)
        q[self.slack] = penalty
        price = np.zeros(0)
        if cells is not None:
            price = self._cell_values(values, trajectory, cells, trust, q)
        A, b = self.rows.assemble(values)
        P = self._hessian(drive, cells, multipliers, price)
        return StepProgram(P, q, A, b, self.n_eq)

    def _drive_values(
        self,
        values: Values,
        now: Trajectory,
        terms: DriveExpansion,
        trust: TrustRegion,
    ) -> None:
        instance, vehicle, drive = self.instance, self.instance.vehicle, self.instance.drive
        d, cabin = drive.duration_h, vehicle.heater_cabin_efficiency
        loss, pump = terms.loss.gradient, terms.pump_heat.gradient
        pumps, cools = self.has_pump, self.watch.cooling

        def spread(by_p: Array, by_t: Array, by_e: Array) -> tuple[Array, Array, Array, Array]:
            """Chain rule from (P, T, E) of the step to (E+, E', T+, T')."""
            return by_p / d + 0.5 * by_e, -by_p / d + 0.5 * by_e, 0.5 * by_t, 0.5 * by_t

        # balance and heat are stated in kWh: times the duration
        rows = spread(
            d * (1.0 - loss[:, 0]), d * (pump[:, 1] / cabin - loss[:, 1]), -d * loss[:, 2]
        )
        tail: Coefficients = (d * (pump[:, 3] / cabin - 1.0),) if pumps else ()
        brake = np.zeros(d.size)
        brake[self.regen] = -d[self.regen]
        values["balance"] = ((*rows, -d, *((-d,) if cools else ()), *tail, brake), 0.0)
        rows = spread(
            -d * loss[:, 0],
            d * (pump[:, 1] - loss[:, 1] + drive.heat_loss_kw_per_k),
            -d * loss[:, 2],
        )
        storage = vehicle.pack.heat_capacity_kwh_per_k
        tail = (d * (pump[:, 3] - 1.0),) if pumps else ()
        values["heat"] = (
            (
                rows[0],
                rows[1],
                rows[2] - storage,
                rows[3] + storage,
                -d * vehicle.heater_battery_efficiency,
                *((d * vehicle.cooling_cop,) if cools else ()),
                *tail,
            ),
            0.0,
        )
        relief = -0.5 * pump[:, 1] / cabin
        tail = (-pump[:, 3] / cabin,) if pumps else ()
        free = vehicle.heater_kw - now.cabin_heater_kw - now.heater_kw
        values["heater_min"] = ((-1.0,), now.heater_kw)
        values["heater_max"] = ((1.0, relief, relief, *tail), np.maximum(free, 0.0))
        more = self._more_cooling_kwh(now) if cools else np.zeros(0)
        if cools:
            values["cooling_min"] = ((-1.0,), now.cooling_kw)
            spare = vehicle.cooling_kw - now.cooling_kw
            values["cooling_max"] = ((1.0,), np.minimum(spare, more[: d.size] / d))
        end = now.energy_kwh[1 : d.size + 1]
        values["energy_min"] = ((-1.0, -1.0), end - instance.energy_min_kwh[1:])
        temp = np.concatenate([now.temperature_c[1:], *(s.temperature_c[1:] for s in now.stops)])
        reach = trust.temperature_k
        above = instance.temperature_max_c - MARGIN_K - temp
        below = temp - MARGIN_K - instance.temperature_min_c
        # one row for limit and trust region: whichever is nearer; only the limit is elastic
        values["temperature_max"] = (
            (1.0, np.where(above < reach, -1.0, 0.0)),
            np.minimum(reach, above),
        )
        down = np.full(temp.size, reach)
        if cools:
            cooling = np.concatenate([now.cooling_kw, *(s.cooling_kw for s in now.stops)])
            fall = more * vehicle.cooling_cop / storage
            down = np.where(cooling > COOLS_KW, np.minimum(fall, reach), reach)
        values["temperature_min"] = (
            (-1.0, np.where(below < down, -1.0, 0.0)),
            np.minimum(down, below),
        )
        if self.watch.discharge:
            limit, by_e, by_t = terms.discharge_limit
            values["discharge"] = (
                (*spread(np.ones(d.size), -by_t, -by_e), -1.0),
                limit - MARGIN_KW - now.power_kw,
            )
        if pumps:
            values["pump_min"] = ((-1.0,), now.heat_pump_kw)
            values["pump_max"] = ((1.0,), vehicle.heat_pump_kw - now.heat_pump_kw)
            room = np.maximum(drive.cabin_heat_kw - now.pump_heat_kw, 0.0)
            values["cabin"] = ((0.5 * pump[:, 1], 0.5 * pump[:, 1], pump[:, 3]), room)
        if self.regen.size:
            limit, by_e, by_t = terms.charge_limit
            rows = spread(-np.ones(d.size), -by_t, -by_e)
            slack = np.maximum(limit + now.power_kw, 0.0)
            values["regen"] = (tuple(c[self.regen] for c in rows), slack[self.regen])
            room = instance.ceiling_kwh - end
            values["energy_max"] = ((1.0, -1.0), room[self.regen])
            values["brake_min"] = ((-1.0,), now.brake_kw[self.regen])
            most = -drive.base_kw[self.regen]
            values["brake_max"] = ((1.0,), np.maximum(most - now.brake_kw[self.regen], 0.0))

    def _more_cooling_kwh(self, now: Trajectory) -> Array:
        """Return how much more steps and cells may cool until they end where cooling stops.

        Steps first, then the cells of all stops, as the simulation clips them (``drive_step``).
        """
        vehicle, drive = self.instance.vehicle, self.instance.drive
        storage = vehicle.pack.heat_capacity_kwh_per_k
        ends = np.concatenate([now.temperature_c[1:], *(s.temperature_c[1:] for s in now.stops)])
        warm = storage * (ends - vehicle.cooling_from_c)
        load = drive.base_kw + now.heater_kw + now.heat_pump_kw + now.cabin_heater_kw
        squared = now.power_kw**2 + drive.ripple_kw2
        uncooled = np.maximum(load, 0.0) ** 2 + drive.ripple_kw2
        ratio = uncooled / np.maximum(squared, 1e-12)
        warm[: load.size] -= drive.duration_h * now.loss_kw * (1.0 - ratio)
        return np.asarray(np.maximum(warm, 0.0) / max(vehicle.cooling_cop, 1e-6))

    def _cell_values(
        self,
        values: Values,
        now: Trajectory,
        terms: CellExpansion,
        trust: TrustRegion,
        q: Array,
    ) -> Array:
        """Fill the rows of the stops and the objective; return the energy price per cell."""
        instance, vehicle, pumps = self.instance, self.instance.vehicle, self.has_pump
        cools = self.watch.cooling
        cells, stops = instance.cells, instance.stops

        def per_cell(values: list[float]) -> Array:
            return np.repeat(np.array(values), cells)

        def joined(name: str) -> Array:
            return np.concatenate([getattr(s, name) for s in now.stops])

        def spread(g: Array) -> Coefficients:
            """Gradient by (W, y, T, E_arrive, H_p) to the columns of a cell."""
            half = 0.5 * g[:, 2]
            return (g[:, 0], g[:, 1], half, half, g[:, 3], *((g[:, 4],) if pumps else ()))

        y = joined("dwell_h")
        heater, cooling, pump = (
            y * joined(name) for name in ("heater_kw", "cooling_kw", "heat_pump_kw")
        )
        demand = per_cell([s.cabin_heat_kw for s in stops])
        base = per_cell([s.base_kw for s in stops])
        conductance = per_cell([s.heat_loss_kw_per_k for s in stops])
        ambient = per_cell([s.ambient_c for s in stops])
        cabin = vehicle.heater_cabin_efficiency
        unit = np.eye(5)
        loss, heat = terms.loss.gradient, terms.pump_heat.gradient

        rate = (
            heat
            - loss
            + conductance[:, None] * (terms.exchange.gradient - ambient[:, None] * unit[1])
        )
        rate = rate - unit[4]
        rows = list(spread(rate))
        storage = vehicle.pack.heat_capacity_kwh_per_k
        rows[2], rows[3] = rows[2] - storage, rows[3] + storage
        values["cell_heat"] = (
            (*rows, -vehicle.heater_battery_efficiency, *((vehicle.cooling_cop,) if cools else ())),
            0.0,
        )
        values["leave"] = ((1.0, -1.0, -1.0), 0.0)

        grid = loss + unit[0] / cells + unit[4] - heat / cabin
        grid = grid + (base + demand / cabin)[:, None] * unit[1]
        limit = grid - terms.grid_limit.gradient
        used = joined("grid_kwh")
        values["grid_limit"] = (
            (*spread(limit), 1.0, *((1.0,) if cools else ())),
            np.maximum(terms.grid_limit.value - used, 0.0),
        )
        values["least_dwell"] = (
            spread(terms.least_dwell.gradient - unit[1]),
            np.maximum(y - terms.least_dwell.value, 0.0),
        )
        for k in self.kinks:
            term = terms.other_dwell[k]
            matters = np.isfinite(term.value)
            row = np.where(matters[:, None], term.gradient - unit[1], 0.0)
            spare = np.where(matters, y - np.where(matters, term.value, 0.0), 1.0)
            values[f"other_dwell_{k}"] = (spread(row), np.maximum(spare, 0.0))
        room = vehicle.heater_kw * y - heater - y * joined("cabin_heater_kw")
        values["cell_heater_min"] = ((-1.0,), heater)
        values["cell_heater_max"] = (
            (
                *spread((demand / cabin - vehicle.heater_kw)[:, None] * unit[1] - heat / cabin),
                1.0,
            ),
            np.maximum(room, 0.0),
        )
        if cools:
            more = self._more_cooling_kwh(now)[now.power_kw.size :]
            values["cell_cooling_min"] = ((-1.0,), cooling)
            spare = vehicle.cooling_kw * y - cooling
            # where the temperature ends it a cell may be left sooner without cooling less
            by_power = np.where(spare <= more, -vehicle.cooling_kw, 0.0)
            values["cell_cooling_max"] = ((1.0, by_power), np.clip(spare, 0.0, more))
        if pumps:
            values["cell_pump_min"] = ((-1.0,), pump)
            values["cell_pump_max"] = (
                (1.0, -vehicle.heat_pump_kw),
                np.maximum(vehicle.heat_pump_kw * y - pump, 0.0),
            )
            spare = demand * y - y * joined("pump_heat_kw")
            values["cell_cabin"] = (
                spread(heat - demand[:, None] * unit[1]),
                np.maximum(spare, 0.0),
            )
        self._stop_values(values, now, trust)

        price = per_cell([s.price_per_kwh for s in stops])
        money = spread(
            price[:, None] * grid + per_cell([s.time_price_per_h for s in stops])[:, None] * unit[1]
        )
        columns = self.rows.columns["least_dwell"]
        for column, value in zip(columns, money, strict=True):
            np.add.at(q, column, value)
        q[self.cell_heater] += price
        q[self.cell_cooling] += price if cools else 0.0
        q[self.occupancy] = [s.occupancy_price_per_h for s in stops]
        return price

    def _stop_values(
        self,
        values: Values,
        now: Trajectory,
        trust: TrustRegion,
    ) -> None:
        instance, stops = self.instance, self.instance.stops
        arrive = np.array([s.energy_kwh[0] for s in now.stops])
        full = np.array([s.energy_kwh[-1] for s in now.stops])
        dwell = np.array([float(s.dwell_h.sum()) for s in now.stops])
        first = np.array([s.arrive_min_kwh for s in stops])
        last = np.array([s.leave_min_kwh for s in stops])
        out = np.array([s.detour_out_kwh for s in stops])
        free = np.array([s.occupancy_free_h for s in stops])
        longest = np.array([s.max_dwell_h for s in stops])
        charged = full - arrive
        values["arrive_min"] = ((-1.0, -1.0), arrive - first)
        values["leave_min"] = ((-1.0, -1.0), full - out - last)
        values["charged_full"] = ((1.0, 1.0, -1.0), instance.energy_max_kwh - full)
        values["charged_min"] = ((-1.0,), np.maximum(charged - MIN_CHARGE_KWH, 0.0))
        values["charged_trust_max"] = ((1.0,), trust.energy_kwh)
        values["charged_trust_min"] = ((-1.0,), trust.energy_kwh)
        ones = (1.0,) * instance.cells
        values["dwell_max"] = ((*ones, -1.0), longest - MARGIN_H - dwell)
        if np.isfinite(instance.total_dwell_h):
            every = (1.0,) * (instance.cells * len(stops))
            spare = instance.total_dwell_h - MARGIN_H - float(dwell.sum())
            values["stop_time_max"] = ((*every, -1.0), spare)
        # the occupancy column is the occupied time itself, not a change
        values["occupancy_min"] = ((-1.0,), 0.0)
        values["occupancy"] = ((*ones, -1.0), free - dwell)

    def corrected(
        self, program: StepProgram, x: Array, now: Trajectory, then: Trajectory
    ) -> StepProgram:
        """Return the program with its limits shifted by what the linear model missed.

        Second-order correction: the step ``x`` was predicted to reach a state and
        reached another one; the limits of energy, temperature and dwell are moved by
        the difference, so the next step lands on them.

        Parameters
        ----------
        program : StepProgram
            The program whose step was simulated.
        x : ndarray, shape (columns,)
            Its solution.
        now, then : Trajectory
            Before and after the step.
        """
        b = program.b.copy()
        n = self.instance.drive.n_steps

        def temperatures(t: Trajectory) -> Array:
            return np.concatenate([t.temperature_c[1:], *(s.temperature_c[1:] for s in t.stops)])

        missed = temperatures(then) - temperatures(now) - x[self.all_temperatures]
        b[self.rows.slices["temperature_max"]] -= missed
        b[self.rows.slices["temperature_min"]] += missed
        missed = (then.energy_kwh - now.energy_kwh - x[self.energy])[1 : n + 1]
        b[self.rows.slices["energy_min"]] += missed
        if self.instance.stops:
            arrive = np.array([s.energy_kwh[0] for s in then.stops])
            arrive -= np.array([s.energy_kwh[0] for s in now.stops])
            b[self.rows.slices["arrive_min"]] += arrive - x[self.arrive_energy]
            dwell = np.concatenate([s.dwell_h for s in then.stops])
            dwell -= np.concatenate([s.dwell_h for s in now.stops]) + x[self.dwell]
            b[self.rows.slices["dwell_max"]] -= dwell.reshape(arrive.size, -1).sum(axis=1)
            if "stop_time_max" in self.rows.slices:
                b[self.rows.slices["stop_time_max"]] -= dwell.sum()
        return replace(program, b=b)
