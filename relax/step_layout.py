"""Owns the columns and rows of one refinement step: which there are, and their sparsity.

All columns are *changes* against the current trajectory. Knows the structure of
the transcription, no values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.instance import Instance
from relax.plan import Trajectory
from relax.sparse import Pattern, RowBlocks

__all__ = ["StepLayout", "Watch"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

COOLING_NEAR_K = 10.0
"""Cooling becomes a control once the battery comes this near to its upper limit [K]."""
ROUGH = 0.1
"""Roughness of the charge limit's table beyond which its kinks get rows of their own."""
DISCHARGE_NEAR = 0.5
"""The discharge limit is watched once the power exceeds this share of it."""


@dataclass(frozen=True)
class Watch:
    """Parts of the program that most trips never need; left out, they cost no time.

    Parameters
    ----------
    cooling : bool
        Battery cooling is a control: the battery comes near its upper limit.
    discharge : bool
        The discharge limit may bind.
    """

    cooling: bool = False
    discharge: bool = False

    def extended(self, instance: Instance, trajectory: Trajectory) -> Watch:
        """Return what is needed beside this at a trajectory."""
        peak = max(
            [trajectory.temperature_c.max(), *(s.temperature_c.max() for s in trajectory.stops)]
        )
        used = [trajectory.cooling_kw, *(s.cooling_kw for s in trajectory.stops)]
        energy = np.clip(trajectory.energy_start_kwh, instance.energy_min_kwh.min(), None)
        limit = instance.vehicle.pack.discharge_limit_kw
        room = limit(
            np.clip(energy, limit.x[0], limit.x[-1]),
            np.clip(trajectory.temperature_start_c, limit.y[0], limit.y[-1]),
        )
        return Watch(
            cooling=self.cooling
            or peak > instance.temperature_max_c - COOLING_NEAR_K
            or any(float(c.max()) > 0.0 for c in used),
            discharge=self.discharge
            or bool(trajectory.violation[2] > 0.0)
            or bool(np.any(trajectory.power_kw > DISCHARGE_NEAR * room)),
        )


class StepLayout:
    """Columns, rows and sparsity of the step program of one instance.

    Parameters
    ----------
    instance : Instance
        Subset and grid; the structure is made once and reused for every step.
    watch : Watch, optional
        Which rarely needed parts to include.
    """

    def __init__(self, instance: Instance, watch: Watch | None = None) -> None:
        self.instance, self.watch = instance, watch or Watch()
        n, cells, stops = instance.drive.n_steps, instance.cells, instance.stops
        rough = instance.vehicle.pack.charge_limit_kw.roughness > ROUGH
        self.kinks = range(4) if rough else range(0)
        size = 0

        def take(count: int) -> Index:
            nonlocal size
            size += count
            return np.arange(size - count, size)

        self.energy, self.temperature = take(n + 1), take(n + 1)
        self.heater, self.cooling = take(n), take(n if self.watch.cooling else 0)
        self.has_pump = instance.vehicle.heat_pump_kw > 0.0
        self.pump = take(n if self.has_pump else 0)
        self.regen = np.flatnonzero(instance.drive.base_kw < 0.0)
        self.brake = take(self.regen.size)
        m = len(stops)
        self.charged, self.leave = take(m), take(m)
        self.cell_temperature = take(m * cells).reshape(m, cells)
        self.dwell, self.cell_heater = take(m * cells), take(m * cells)
        self.cell_cooling = take(m * cells if self.watch.cooling else 0)
        self.cell_pump = take(m * cells if self.has_pump else 0)
        self.occupancy = take(m)
        self.slack = take(4)
        self.n_columns = size
        self._link(n, cells)
        self.rows = RowBlocks.make(self._blocks(), size)
        self.n_eq = self.rows.slices["cell_heat" if m else "heat"].stop
        self._quadratic_pattern()

    def _link(self, n: int, cells: int) -> None:
        """Work out which column holds the state before every step, stop and cell."""
        stops = self.instance.stops
        self.step_energy, self.step_temperature = (
            self.energy[:n].copy(),
            self.temperature[:n].copy(),
        )
        self.arrive_energy = np.zeros(len(stops), dtype=np.intp)
        first_temperature = np.zeros(len(stops), dtype=np.intp)
        for i, stop in enumerate(stops):
            again = i > 0 and stops[i - 1].node == stop.node
            self.arrive_energy[i] = self.leave[i - 1] if again else self.energy[stop.node]
            first_temperature[i] = (
                self.cell_temperature[i - 1, -1] if again else self.temperature[stop.node]
            )
            if stop.node < n:
                self.step_energy[stop.node] = self.leave[i]
                self.step_temperature[stop.node] = self.cell_temperature[i, -1]
        before = np.concatenate([first_temperature[:, None], self.cell_temperature[:, :-1]], axis=1)
        self.cell_before, self.cell_after = before.ravel(), self.cell_temperature.ravel()
        self.cell_charged = np.repeat(self.charged, cells)
        self.cell_arrive = np.repeat(self.arrive_energy, cells)
        self.all_temperatures = np.concatenate([self.temperature[1:], self.cell_after])

    def _blocks(self) -> list[tuple[str, tuple[Index, ...]]]:
        n = self.instance.drive.n_steps
        e0, e1 = self.step_energy, self.energy[1:]
        t0, t1 = self.step_temperature, self.temperature[1:]
        cools = (self.cooling,) if self.watch.cooling else ()
        drive = (e0, e1, t0, t1, self.heater, *cools, *self._pump_columns())
        state = (e0, e1, t0, t1)
        cell_state = (self.cell_charged, self.dwell, self.cell_before, self.cell_after)
        cell = (*cell_state, self.cell_arrive, *self._cell_pump_columns())
        cools = (self.cell_cooling,) if self.watch.cooling else ()
        thermal = (*cell, self.cell_heater, *cools)
        m = len(self.instance.stops)
        s_n, s_m = np.repeat(self.slack[0], n), np.repeat(self.slack[0], m)
        s_t = np.repeat(self.slack[1], self.all_temperatures.size)
        s_p, s_h = np.repeat(self.slack[2], n), np.repeat(self.slack[3], m)
        blocks: list[tuple[str, tuple[Index, ...]]] = [
            ("origin", (np.array([self.energy[0], self.temperature[0]]),)),
            ("balance", (*drive, self._brake_columns(n))),
            ("heat", drive),
        ]
        if m:
            blocks += [
                ("leave", (self.leave, self.arrive_energy, self.charged)),
                ("cell_heat", thermal),
            ]
        blocks += [
            ("heater_min", (self.heater,)),
            ("heater_max", (self.heater, t0, t1, *self._pump_columns())),
            ("energy_min", (e1, s_n)),
            ("temperature_max", (self.all_temperatures, s_t)),
            ("temperature_min", (self.all_temperatures, s_t)),
            ("slack_min", (self.slack,)),
            ("slack_max", (self.slack,)),
        ]
        if self.watch.discharge:
            blocks += [("discharge", (*state, s_p))]
        if self.watch.cooling:
            blocks += [("cooling_min", (self.cooling,)), ("cooling_max", (self.cooling,))]
        if self.has_pump:
            blocks += [
                ("pump_min", (self.pump,)),
                ("pump_max", (self.pump,)),
                ("cabin", (t0, t1, self.pump)),
            ]
        if self.regen.size:
            blocks += [
                ("regen", tuple(c[self.regen] for c in state)),
                ("energy_max", (e1[self.regen], s_n[self.regen])),
                ("brake_min", (self.brake,)),
                ("brake_max", (self.brake,)),
            ]
        if m:
            dwell = tuple(self.dwell.reshape(m, -1).T)
            total = self.instance.total_dwell_h
            everything = (*self.dwell[:, None], self.slack[3:])
            blocks += [
                ("least_dwell", cell),
                *((f"other_dwell_{k}", cell) for k in self.kinks),
                ("grid_limit", thermal),
                ("cell_heater_min", (self.cell_heater,)),
                ("cell_heater_max", (*cell, self.cell_heater)),
                ("arrive_min", (self.arrive_energy, s_m)),
                ("leave_min", (self.leave, s_m)),
                ("charged_full", (self.arrive_energy, self.charged, s_m)),
                ("charged_min", (self.charged,)),
                ("charged_trust_max", (self.charged,)),
                ("charged_trust_min", (self.charged,)),
                ("dwell_max", (*dwell, s_h)),
                *((("stop_time_max", everything),) if np.isfinite(total) else ()),
                ("occupancy_min", (self.occupancy,)),
                ("occupancy", (*dwell, self.occupancy)),
            ]
            if self.watch.cooling:
                blocks += [
                    ("cell_cooling_min", (self.cell_cooling,)),
                    ("cell_cooling_max", (self.cell_cooling, self.dwell)),
                ]
            if self.has_pump:
                blocks += [
                    ("cell_pump_min", (self.cell_pump,)),
                    ("cell_pump_max", (self.cell_pump, self.dwell)),
                    ("cell_cabin", cell),
                ]
        return blocks

    def _pump_columns(self) -> tuple[Index, ...]:
        return (self.pump,) if self.has_pump else ()

    def _cell_pump_columns(self) -> tuple[Index, ...]:
        return (self.cell_pump,) if self.has_pump else ()

    def _brake_columns(self, n: int) -> Index:
        """Return one column per step; steps that cannot recuperate point at the slack with 0."""
        columns = np.repeat(self.slack[0], n)
        columns[self.regen] = self.brake
        return columns

    def _quadratic_pattern(self) -> None:
        drive = np.stack(
            [
                self.step_energy,
                self.energy[1:],
                self.step_temperature,
                self.temperature[1:],
                *self._pump_columns(),
            ]
        ).T
        cell = np.stack(
            [
                self.cell_charged,
                self.dwell,
                self.cell_before,
                self.cell_after,
                self.cell_arrive,
                *self._cell_pump_columns(),
            ]
        ).T
        rows, cols, self._upper = [], [], []
        for block in (drive, cell):
            a, b = np.triu_indices(block.shape[1])
            self._upper.append((a, b))
            first, second = block[:, a].ravel(), block[:, b].ravel()
            rows.append(np.minimum(first, second))
            cols.append(np.maximum(first, second))
        shape = (self.n_columns, self.n_columns)
        self._pattern = Pattern(np.concatenate(rows), np.concatenate(cols), shape)
        v = 5 if self.has_pump else 4
        duration = self.instance.drive.duration_h
        # (P, T, E, P_hp) of a step as linear maps of (E+, E', T+, T', P_hp)
        change = np.zeros((duration.size, 4, v))
        change[:, 0, 0], change[:, 0, 1] = 1.0 / duration, -1.0 / duration
        change[:, 1, 2:4], change[:, 2, 0:2] = 0.5, 0.5
        # (W, y, T, E_arrive, H_p) of a cell as linear maps of (W, y, T_j, T_j+1, E_arrive, H_p)
        local = np.zeros((5, v + 1))
        local[0, 0] = local[1, 1] = local[3, 4] = 1.0
        local[2, 2:4] = 0.5
        if self.has_pump:
            change[:, 3, 4] = local[4, 5] = 1.0
        self._drive_change, self._cell_change = change, local
