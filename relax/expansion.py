"""Owns the second-order expansion of the transcription along a trajectory.

Values and derivatives of every nonlinear term, vectorised over all driving
steps and over all cells, for the quadratic programs of ``refinement``. The
values are those of the tables, the derivatives those of the tables averaged
over one cell. Knows nothing of programs and solvers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.instance import LEAST_ROOM_KW, Instance
from relax.plan import Trajectory

__all__ = ["CellExpansion", "DriveExpansion", "convex_part", "expand_cells", "expand_drive"]

Array = npt.NDArray[np.float64]


KINK = 1e-6
"""Relative difference beyond which an adjoining cell's limit counts as another one."""


@dataclass(frozen=True)
class Term:
    """A nonlinear term: value (m,), gradient (m, v), Hessian (m, v, v) in the block's variables."""

    value: Array
    gradient: Array
    hessian: Array


@dataclass(frozen=True)
class DriveExpansion:
    """Terms of every driving step in (P, T, E, P_hp), all at the midpoint.

    Parameters
    ----------
    loss : Term
        Joule loss [kW].
    pump_heat : Term
        Heat of the heat pump to the cabin [kW].
    discharge_limit, charge_limit : ndarray, shape (3, n)
        Value and derivatives by E and T [kW].
    """

    loss: Term
    pump_heat: Term
    discharge_limit: Array
    charge_limit: Array


@dataclass(frozen=True)
class CellExpansion:
    """Terms of every cell in (W, y, T, E_arrive, H_p); cells of all stops in one row.

    Parameters
    ----------
    loss : Term
        Joule loss [kWh].
    least_dwell : Term
        (W/K) / P_chg(E, T) [h].
    pump_heat : Term
        Heat of the heat pump to the cabin [kWh].
    exchange : Term
        T * y [degrees C * h].
    grid_limit : Term
        P_grid_max(E) * y [kWh].
    other_dwell : tuple of Term
        (W/K) / P with P the charge limit of an adjoining table cell; infinite where
        that does not continue the limit concavely [h].
    """

    loss: Term
    least_dwell: Term
    pump_heat: Term
    exchange: Term
    grid_limit: Term
    other_dwell: tuple[Term, ...]


def _term(
    value: Array, gradient: dict[int, Array], hessian: dict[tuple[int, int], Array], v: int
) -> Term:
    m = value.size
    grad, hess = np.zeros((m, v)), np.zeros((m, v, v))
    for a, g in gradient.items():
        grad[:, a] = g
    for (a, b), h in hessian.items():
        hess[:, a, b] = h
        hess[:, b, a] = h
    return Term(value, grad, hess)


def _resistance_ratio(instance: Instance, energy: Array, temp: Array) -> tuple[Array, ...]:
    """Return r = R(T)/u(E) and r_E, r_T, r_EE, r_ET, r_TT."""
    pack = instance.vehicle.pack
    res, res_t, res_tt = pack.resistance_ohm.jet(temp)
    u, u_e, u_ee = pack.voltage_squared.jet(energy)
    inv = 1.0 / u
    inv_e = -u_e * inv * inv
    inv_ee = (2.0 * u_e * u_e * inv - u_ee) * inv * inv
    return res * inv, res * inv_e, res_t * inv, res * inv_ee, res_t * inv_e, res_tt * inv


def _inside(instance: Instance, energy: Array, temp: Array) -> tuple[Array, Array]:
    """Clip to the tables, as the simulation does for trajectories that break a limit."""
    pack = instance.vehicle.pack
    limit = pack.charge_limit_kw
    e_lo = max(limit.x[0], pack.voltage_squared.lo, pack.discharge_limit_kw.x[0])
    e_hi = min(limit.x[-1], pack.voltage_squared.hi, pack.discharge_limit_kw.x[-1])
    cop = instance.vehicle.heat_pump_cop
    t_lo = max(limit.y[0], pack.resistance_ohm.lo, pack.discharge_limit_kw.y[0], cop.lo)
    t_hi = min(limit.y[-1], pack.resistance_ohm.hi, pack.discharge_limit_kw.y[-1], cop.hi)
    return (
        np.minimum(np.maximum(energy, e_lo), e_hi),
        np.minimum(np.maximum(temp, t_lo), t_hi),
    )


def expand_drive(instance: Instance, trajectory: Trajectory) -> DriveExpansion:
    """Expand the terms of all driving steps at a trajectory, in (P, T, E, P_hp)."""
    vehicle = instance.vehicle
    power, pump = trajectory.power_kw, trajectory.heat_pump_kw
    energy, temp = _inside(
        instance,
        0.5 * (trajectory.energy_start_kwh + _end(trajectory, trajectory.energy_kwh)),
        0.5 * (trajectory.temperature_start_c + _end(trajectory, trajectory.temperature_c)),
    )
    r, r_e, r_t, r_ee, r_et, r_tt = _resistance_ratio(instance, energy, temp)
    square = power * power + instance.drive.ripple_kw2
    loss = _term(
        r * square,
        {0: 2.0 * r * power, 1: r_t * square, 2: r_e * square},
        {
            (0, 0): 2.0 * r,
            (0, 1): 2.0 * r_t * power,
            (0, 2): 2.0 * r_e * power,
            (1, 1): r_tt * square,
            (1, 2): r_et * square,
            (2, 2): r_ee * square,
        },
        4,
    )
    cop, cop_t, cop_tt = vehicle.heat_pump_cop.jet(temp)
    a = vehicle.heat_pump_droop_per_kw
    shape, slope = pump * (1.0 - a * pump), 1.0 - 2.0 * a * pump
    heat = _term(
        cop * shape,
        {1: cop_t * shape, 3: cop * slope},
        {(1, 1): cop_tt * shape, (1, 3): cop_t * slope, (3, 3): -2.0 * a * cop},
        4,
    )
    return DriveExpansion(
        loss,
        heat,
        vehicle.pack.discharge_limit_kw.tangent(energy, temp),
        vehicle.pack.charge_limit_kw.tangent(energy, temp),
    )


def _end(trajectory: Trajectory, nodes: Array) -> Array:
    """Return the arrival values at the ends of the driving steps, shape (n,)."""
    return nodes[1 : trajectory.power_kw.size + 1]


def expand_cells(
    instance: Instance, trajectory: Trajectory, *, kinks: bool = True
) -> CellExpansion:
    """Expand the terms of all cells at a trajectory, in (W, y, T, E_arrive, H_p).

    Needs at least one stop. Without ``kinks``, ``other_dwell`` stays empty.
    """
    vehicle, cells = instance.vehicle, instance.cells
    stops = trajectory.stops
    y = np.concatenate([s.dwell_h for s in stops])
    pump = np.concatenate([s.heat_pump_kw for s in stops]) * y
    middle, temp = _inside(
        instance,
        np.concatenate([0.5 * (s.energy_kwh[1:] + s.energy_kwh[:-1]) for s in stops]),
        np.concatenate([0.5 * (s.temperature_c[1:] + s.temperature_c[:-1]) for s in stops]),
    )
    e = np.concatenate([np.diff(s.energy_kwh) for s in stops])
    r, r_e, r_t, r_ee, r_et, r_tt = _resistance_ratio(instance, middle, temp)
    w = e * e / y
    # local variables: 0 e, 1 y, 2 T, 3 E, 4 Hp
    loss = _term(
        r * w,
        {0: 2.0 * r * e / y, 1: -r * w / y, 2: r_t * w, 3: r_e * w},
        {
            (0, 0): 2.0 * r / y,
            (0, 1): -2.0 * r * e / y**2,
            (0, 2): 2.0 * r_t * e / y,
            (0, 3): 2.0 * r_e * e / y,
            (1, 1): 2.0 * r * w / y**2,
            (1, 2): -r_t * w / y,
            (1, 3): -r_e * w / y,
            (2, 2): r_tt * w,
            (2, 3): r_et * w,
            (3, 3): r_ee * w,
        },
        5,
    )
    table = vehicle.pack.charge_limit_kw
    p, p_e, p_t, p_ee, p_et, p_tt = table.jet(middle, temp)
    inv = 1.0 / np.maximum(p, LEAST_ROOM_KW)  # a battery that takes no charge: as simulated
    tau_e, tau_t = -p_e * inv**2, -p_t * inv**2
    least = _term(
        e * inv,
        {0: inv, 2: e * tau_t, 3: e * tau_e},
        {
            (0, 2): tau_t,
            (0, 3): tau_e,
            (2, 2): e * (2.0 * p_t * p_t * inv - p_tt) * inv**2,
            (2, 3): e * (2.0 * p_e * p_t * inv - p_et) * inv**2,
            (3, 3): e * (2.0 * p_e * p_e * inv - p_ee) * inv**2,
        },
        5,
    )
    cop, cop_t, cop_tt = vehicle.heat_pump_cop.jet(temp)
    a = vehicle.heat_pump_droop_per_kw
    share = pump / y
    shape = pump * (1.0 - a * share)
    heat = _term(
        cop * shape,
        {1: cop * a * share**2, 2: cop_t * shape, 4: cop * (1.0 - 2.0 * a * share)},
        {
            (1, 1): -2.0 * a * cop * share**2 / y,
            (1, 2): cop_t * a * share**2,
            (1, 4): 2.0 * a * cop * share / y,
            (2, 2): cop_tt * shape,
            (2, 4): cop_t * (1.0 - 2.0 * a * share),
            (4, 4): -2.0 * a * cop / y,
        },
        5,
    )
    exchange = _term(temp * y, {1: temp, 2: y}, {(1, 2): np.ones_like(y)}, 5)
    tables = [s.grid_limit_kw for s in instance.stops]
    split = np.split(middle, len(stops))
    limit, limit_e = np.concatenate(
        [t.jet(np.clip(m, t.lo, t.hi))[:2] for t, m in zip(tables, split, strict=True)], axis=1
    )
    grid = _term(limit * y, {1: limit, 3: limit_e * y}, {(1, 3): limit_e}, 5)
    others = tuple(
        _to_stop_variables(_kink(e, p, near), cells)
        for near in (table.neighbours(middle, temp) if kinks else ())
    )
    return CellExpansion(
        loss=_to_stop_variables(loss, cells),
        least_dwell=_to_stop_variables(least, cells),
        pump_heat=_to_stop_variables(heat, cells),
        exchange=_to_stop_variables(exchange, cells),
        grid_limit=_to_stop_variables(grid, cells),
        other_dwell=others,
    )


def _kink(e: Array, limit: Array, near: Array) -> Term:
    """Return the least dwell by an adjoining cell's limit, where that lies above the limit."""
    above = near[0] > limit * (1.0 + KINK)
    p = np.where(above, near[0], 1.0)
    inv = np.where(above, 1.0 / p, 0.0)
    value = np.where(above, e * inv, -np.inf)
    gradient = {0: inv, 2: -e * near[2] * inv**2, 3: -e * near[1] * inv**2}
    return _term(value, gradient, {}, 5)


def _to_stop_variables(term: Term, cells: int) -> Term:
    """Change variables from (e, E) of a cell to (W, E_arrive) of its stop.

    e = W / K and E = E_arrive + (j + 1/2) W / K: only what W changes differs.
    """
    share = (np.arange(term.value.size) % cells + 0.5)[:, None] / cells
    gradient, hessian = term.gradient.copy(), term.hessian.copy()
    gradient[:, 0] = gradient[:, 0] / cells + share[:, 0] * gradient[:, 3]
    hessian[:, 0] = hessian[:, 0] / cells + share * hessian[:, 3]
    hessian[:, :, 0] = hessian[:, :, 0] / cells + share * hessian[:, :, 3]
    return Term(term.value, gradient, hessian)


def convex_part(hessian: Array, scale: Array) -> Array:
    """Return the blocks with negative eigenvalues clipped, in variables of typical step size.

    Parameters
    ----------
    hessian : ndarray, shape (m, v, v)
        Symmetric blocks.
    scale : ndarray, shape (v,)
        Typical step of every variable: clipping depends on the units, and steps
        of similar weight are what the quadratic model has to rank.

    Examples
    --------
    >>> convex_part(np.diag([2.0, -1.0])[None], np.ones(2)).tolist()
    [[[2.0, 0.0], [0.0, 0.0]]]
    """
    scaled = hessian * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(scaled)
    clipped = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(clipped / scale[:, None] / scale[None, :])
