"""Owns the readable twin: the same relaxation written in cvxpy, with prices as parameters.

For reading, for extending (take the ``Spec``, add constraints) and as the test
oracle of the assembled matrices: same envelopes, same box, same optimum. Slow to
compile and never imported by the planner. Knows nothing of sparse matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cvxpy
import numpy as np
import numpy.typing as npt

from relax.box import Box
from relax.envelopes import (
    envelope_conductance_over,
    envelope_loss_over,
    envelope_loss_under,
    envelope_product,
    envelope_pump_heat_over,
    envelope_pump_heat_under,
    envelope_pump_power_under,
)
from relax.envelopes_charge import (
    envelope_charge_time_under,
    envelope_grid_limit_over,
    envelope_limit_over,
    envelope_stop_loss_over,
    envelope_stop_loss_under,
    envelope_table_over,
    make_charge_grid,
    range_of_planes,
)
from relax.envelopes_stay import envelope_stay_under
from relax.instance import Instance, Stop
from relax.intervals import Interval, range1, range2
from relax.reach import FULL_SLACK_KWH
from relax.reach_heat import COOLING_SLACK_K, pump_limits
from relax.relaxation_drive import FLOOR_WIDTH_K
from relax.relaxation_stops import STOP_TEMPERATURES

__all__ = ["Spec", "make_spec"]

cp: Any = cvxpy
"""cvxpy exports its atoms by star imports, which type checkers do not see."""

Array = npt.NDArray[np.float64]
Expression = Any


@dataclass(frozen=True)
class Spec:
    """The cvxpy problem and handles to extend it.

    Parameters
    ----------
    problem : cvxpy.Problem
        Minimise the cost, fixed cost included.
    energy_price, time_price : cvxpy.Parameter, shape (S,)
        Prices of every stop [currency/kWh, currency/h]; set them and solve again.
    variables : dict of str to cvxpy expression
        By the names of the assembled program.
    """

    problem: cvxpy.Problem
    energy_price: cvxpy.Parameter
    time_price: cvxpy.Parameter
    variables: dict[str, Expression]


def _pick(x: Interval, on: npt.NDArray[Any] | slice | int) -> Interval:
    return Interval(x.lo[on], x.hi[on])


def _plane(p: Array, x: tuple[Expression, ...], times: Expression) -> Expression:
    slopes = zip(p[:-1], x, strict=True)
    return sum(cp.multiply(a, v) for a, v in slopes) + cp.multiply(p[-1], times)


def _above(term: Expression, planes: Array, *x: Expression, times: Expression = 1.0) -> list[Any]:
    """Term <= every plane; ``times`` multiplies the offset (planes of a perspective)."""
    return [term <= _plane(p, x, times) for p in planes]


def _below(term: Expression, planes: Array, *x: Expression, times: Expression = 1.0) -> list[Any]:
    """Term >= every plane."""
    return [term >= _plane(p, x, times) for p in planes]


def _rotated(a: Expression, b: Expression, *c: Expression) -> list[Any]:
    """Rotated cone a * b >= |c|^2, elementwise, a and b >= 0."""
    left = cp.vstack([cp.reshape(a - b, (1, a.size), "C")] + [
        cp.reshape(2.0 * x, (1, a.size), "C") for x in c
    ])  # fmt: skip
    return [cp.SOC(a + b, left, axis=0)]


def _pump(
    instance: Instance, hp: Expression, h: Expression, q: Array, T: Expression, temp: Interval,
    most: Array, time: Expression = 1.0,
) -> list[Any]:  # fmt: skip
    """Heat pump from both sides; with a dwell as ``time``, hp, h and T are products with it."""
    cop, droop = instance.vehicle.heat_pump_cop, instance.vehicle.heat_pump_droop_per_kw
    power = Interval(np.zeros_like(most), most)
    above = envelope_pump_heat_over(cop, droop, power, temp)
    rows = _below(h, envelope_pump_heat_under(cop, droop, power, temp), hp, T, times=time)
    if droop * instance.vehicle.heat_pump_kw < 0.499 and np.all(range1(cop, temp).lo > 0.0):
        planes = envelope_pump_power_under(cop, droop, power, q, temp)
        rows += _below(hp, planes, h, T, times=time)
        above = above[1:]
    rows += _above(h, above, hp, T, times=time)
    return [*rows, hp >= 0.0, h >= 0.0, hp <= cp.multiply(most, time), h <= cp.multiply(q, time)]


def _drive_rows(
    instance: Instance, box: Box, v: dict[str, Expression], start: Expression, warm: Expression
) -> list[Any]:
    """Driving steps: (R2) .. (R6)."""
    drive, car, pack = instance.drive, instance.vehicle, instance.vehicle.pack
    n, d, q = drive.n_steps, drive.duration_h, drive.cabin_heat_kw
    eta_c = car.heater_cabin_efficiency
    energy, temp = box.middle_energy, box.middle_temperature
    names = ("power", "loss", "heater", "cooling", "pump", "pump_heat", "brake")
    P, L, hb, ac, hp, h, br = (cp.Variable(n, name=name) for name in names)
    v |= dict(zip(names, (P, L, hb, ac, hp, h, br), strict=True))
    E = 0.5 * (start + v["energy"][1:])
    T = 0.5 * (warm + v["temperature"][1:])
    cabin = (q - h) / eta_c
    flow = (
        L + drive.drivetrain_heat_kw + car.heater_battery_efficiency * hb - car.cooling_cop * ac
        - (h - hp) + cp.multiply(drive.heat_loss_kw_per_k, drive.ambient_c - T)
    )  # fmt: skip
    rate = pack.heat_capacity_kwh_per_k / d
    floor = car.cooling_from_c - COOLING_SLACK_K
    rows: list[Any] = [
        start - v["energy"][1:] == cp.multiply(d, P),
        P == L + drive.base_kw + hb + ac + hp + cabin + br,
        cp.multiply(rate, v["temperature"][1:] - warm) == flow,
        hb >= 0.0, hb + cabin <= car.heater_kw, ac >= 0.0,
        ac <= np.where(box.temperature.hi[1:] >= floor, car.cooling_kw, 0.0),
    ]  # fmt: skip
    cold = np.flatnonzero((box.temperature.lo[1:] < floor - FLOOR_WIDTH_K) & (car.cooling_kw > 0.0))
    if cold.size:
        lo = box.temperature.lo[1:][cold]
        slope = car.cooling_kw / (floor - lo)
        rows.append(ac[cold] <= cp.multiply(slope, v["temperature"][1:][cold] - lo))
    if car.heater_kw == 0.0:
        rows.append(hb == 0.0)
    most, _, _ = pump_limits(instance, q, range1(car.heat_pump_cop, temp))
    on, off = np.flatnonzero(most > 0.0), np.flatnonzero(most <= 0.0)
    if on.size:
        rows += _pump(instance, hp[on], h[on], q[on], T[on], _pick(temp, on), most[on])
    rows += [hp[off] == 0.0, h[off] == 0.0] if off.size else []
    refused = range2(pack.charge_limit_kw, energy, temp).lo
    braking = (drive.base_kw < 0.0) & (box.power.lo <= 1e-6 - refused)
    full = box.energy.hi[1:] >= instance.ceiling_kwh - FULL_SLACK_KWH
    braking |= full & (drive.base_kw < 0.0)
    rows += [br >= 0.0, br <= np.where(braking, np.maximum(-drive.base_kw, 0.0), 0.0)]
    least = range2(pack.discharge_limit_kw, energy, temp).lo
    for table, tight, sign in (
        (pack.discharge_limit_kw, box.power.hi > np.maximum(least, 0.0), 1.0),
        (pack.charge_limit_kw, -box.power.lo > np.maximum(refused, 0.0), -1.0),
    ):
        k = np.flatnonzero(tight)
        if k.size:
            planes = envelope_table_over(table, _pick(energy, k), _pick(temp, k))
            rows += _above(sign * P[k], planes, E[k], T[k])
    R, square, ripple = pack.resistance_ohm, pack.voltage_squared, drive.ripple_kw2
    rows += _above(L, envelope_loss_over(R, square, box.power, energy, temp, ripple), P, E, T)
    rows += _below(L, envelope_loss_under(R, square, box.power, energy, temp, ripple), P, E, T)
    gamma = envelope_conductance_over(R, square, energy, temp)[0]
    conductance = cp.multiply(gamma[0], E) + cp.multiply(gamma[1], T) + gamma[2]
    typical = gamma[0] * energy.mid + gamma[1] * temp.mid + gamma[2]
    root = np.sqrt(typical)
    return rows + _rotated(
        L, cp.multiply(1.0 / typical, conductance), cp.multiply(1.0 / root, P),
        cp.Constant(np.sqrt(ripple) / root),
    )  # fmt: skip


def _stop_rows(
    instance: Instance, box: Box, i: int, stop: Stop, v: dict[str, Expression], before: Expression,
    border: Expression,
) -> tuple[list[Any], Expression, Expression]:  # fmt: skip
    """One stop: (R6) .. (R9). Returns rows, grid energy and dwell."""
    car, pack, K = instance.vehicle, instance.vehicle.pack, instance.cells
    q, eta_c = np.full(K, stop.cabin_heat_kw), car.heater_cabin_efficiency
    names = ("dwell", "cell_loss", "temp_dwell", "cell_heater", "cell_cooling", "cell_pump",
             "cell_pump_heat", "cell_limit")  # fmt: skip
    y, loss, X, hb, ac, hp, h, p = (cp.Variable(K, name=f"{name}[{i}]") for name in names)
    v |= {f"{name}[{i}]": x for name, x in zip(names, (y, loss, X, hb, ac, hp, h, p), strict=True)}
    W, c = v["charge"][i], (np.arange(K) + 0.5) / K
    out = np.array([s.detour_out_kwh for s in instance.stops])
    here = np.s_[i : i + 1]
    energy, temp = _pick(box.cell_energy(out), here), _pick(box.cell_temperature, i)
    dwell, w = _pick(box.dwell, i), (float(box.charge.lo[i]), float(box.charge.hi[i]))
    tables = make_charge_grid(
        pack.charge_limit_kw, pack.resistance_ohm, pack.voltage_squared, [stop.grid_limit_kw],
        energy, Interval(temp.lo[None], temp.hi[None]),
    )  # fmt: skip
    arrive = before - stop.detour_in_kwh
    E, T, e = arrive + c * W, 0.5 * (border[:-1] + border[1:]), W / K
    cabin = (cp.multiply(q, y) - h) / eta_c
    grid = e + loss + stop.base_kw * y + hb + ac + hp + cabin
    heat = (
        loss + car.heater_battery_efficiency * hb - car.cooling_cop * ac - (h - hp)
        + stop.heat_loss_kw_per_k * (stop.ambient_c * y - X)
    )  # fmt: skip
    floor = car.cooling_from_c - COOLING_SLACK_K
    cooled = np.where(box.stop_temperature.hi[i, 1:] >= floor, car.cooling_kw, 0.0)
    rows: list[Any] = [
        pack.heat_capacity_kwh_per_k * (border[1:] - border[:-1]) == heat,
        arrive >= box.arrive.lo[i], arrive <= box.arrive.hi[i],
        arrive + W <= instance.energy_max_kwh,
        v["leave"][i] == arrive + W - stop.detour_out_kwh,
        hb >= 0.0, hb + cabin <= car.heater_kw * y, ac >= 0.0, ac <= cp.multiply(cooled, y),
        y >= dwell.lo, y <= dwell.hi, cp.sum(y) <= box.stay.hi[i], cp.sum(y) >= box.stay.lo[i],
    ]  # fmt: skip
    if car.heater_kw == 0.0:
        rows.append(hb == 0.0)
    varies = float(np.ptp(stop.grid_limit_kw.f)) > 0.0
    rows += _above(grid, envelope_grid_limit_over(tables, dwell)[: 3 if varies else 1], E, y)
    below, above = envelope_product(temp, dwell)
    rows += _below(X, below, T, y) + _above(X, above, T, y)
    most, _, _ = pump_limits(instance, q, range1(car.heat_pump_cop, temp))
    if np.all(most > 0.0):
        rows += _pump(instance, hp, h, q, X, temp, most, y)
    else:
        rows += [hp == 0.0, h == 0.0]
    # dwell: y >= e * tau(E, T), e between its ends
    power = tables.power_range
    least = 1.0 / np.maximum(power.hi, 1e-6) * (1.0 - 1e-9)
    longest = np.minimum(1.0 / np.maximum(power.lo, 1e-6), K * dwell.hi / w[0]) * (1.0 + 1e-9)
    rho, rho_range = envelope_stop_loss_over(tables)
    planes = envelope_charge_time_under(tables)
    for tau, most_tau in zip(planes, range_of_planes(planes, tables).hi, strict=True):
        value = cp.multiply(tau[0], E) + cp.multiply(tau[1], T) + tau[2]
        rows += [y >= (w[0] * value + (W - w[0]) * least) / K]
        rows += [y >= (w[1] * value + (W - w[1]) * np.minimum(longest, most_tau)) / K]
    stay = envelope_stay_under(
        pack.charge_limit_kw, [stop.grid_limit_kw], _pick(box.arrive, here),
        _pick(box.full(out), here), Interval(temp.lo.min()[None], temp.hi.max()[None]),
        box.charge.hi[here] / K,
    )  # fmt: skip
    rows += [cp.sum(y) >= a * arrive + b * (arrive + W) + c_0 for a, b, c_0 in stay[:, :, 0]]
    rows += _above(p, envelope_limit_over(tables.power, tables.energy, tables.temp), E, T)
    slope = (np.sqrt(w[1]) - np.sqrt(w[0])) / max(w[1] - w[0], 1e-9)
    chord = slope * W + ((np.sqrt(w[0]) - slope * w[0]) * (1.0 - 1e-9) - 1e-9)
    one = np.ones(K)
    p_0 = np.maximum(0.5 * power.hi, 1.0)
    rows += _rotated(cp.multiply(K * p_0, y), cp.multiply(1.0 / p_0, p), chord * one)
    # loss: l <= e * rho(E, T) from above, cone and planes from below
    if not rho.size:
        rows += [loss <= cp.multiply(rho_range.hi, e * one)]
    for u, least_u in zip(rho, range_of_planes(rho, tables).lo, strict=True):
        value = cp.multiply(u[0], E) + cp.multiply(u[1], T) + u[2]
        rows += [loss <= (w[0] * value + (W - w[0]) * rho_range.hi) / K]
        rows += [loss <= (w[1] * value + (W - w[1]) * np.maximum(rho_range.lo, least_u)) / K]
    square_hi = 1.0 / tables.inverse_square.min(axis=1)
    middle = np.minimum(tables.power, tables.grid_power[:, :, None])[:, tables.energy.shape[1] // 2]
    wanted = temp.lo + np.array(STOP_TEMPERATURES)[:, None] * temp.width
    nearest = np.abs(tables.temp[None] - wanted[..., None]).argmin(axis=2)
    speed = np.maximum(middle[np.arange(K), nearest], 1.0)
    cell = Interval(one * w[0] / K, one * w[1] / K)
    planes = envelope_stop_loss_under(
        pack.resistance_ohm, square_hi, cell, temp, speed, STOP_TEMPERATURES
    )
    rows += _below(loss, planes, e * one, y, T)
    r_lo = tables.resistance.min(axis=1) / square_hi * (1.0 - 1e-9)
    size = w[1] / K * p_0  # typical e^2 / y
    rows += _rotated(
        cp.multiply(1.0 / (r_lo * size), loss), cp.multiply(K * p_0 / w[1], y), e * one * (K / w[1])
    )
    return rows, cp.sum(grid), cp.sum(y)


def make_spec(instance: Instance, box: Box) -> Spec:
    """Return the relaxation of a fixed subset on a box as a cvxpy problem.

    Parameters
    ----------
    instance : Instance
        Subset and grid; the pack's resistance must be positive on the box.
    box : Box
        Not empty.

    Returns
    -------
    Spec
        DCP and DPP; the same optimum as ``build_relaxation``.

    Examples
    --------
    >>> from relax import load_trip, make_instance
    >>> from relax.reach import make_box
    >>> instance = make_instance(load_trip("paper-400km"), (1,))
    >>> make_spec(instance, make_box(instance)).problem.is_dcp(dpp=True)
    True
    """
    n, S, K = instance.drive.n_steps, len(instance.stops), instance.cells
    v: dict[str, Expression] = {
        "energy": cp.Variable(n + 1, name="energy"),
        "temperature": cp.Variable(n + 1, name="temperature"),
    }
    stop_temp = Interval(box.stop_temperature.lo[:, 1:], box.stop_temperature.hi[:, 1:])
    rows: list[Any] = []
    if S:
        v["charge"], v["leave"] = cp.Variable(S, name="charge"), cp.Variable(S, name="leave")
        v["stop_temperature"] = cp.Variable((S, K), name="stop_temperature")
        rows += [
            v[name] >= x.lo for name, x in (
                ("charge", box.charge), ("leave", box.leave), ("stop_temperature", stop_temp))
        ]  # fmt: skip
        rows += [
            v[name] <= x.hi for name, x in (
                ("charge", box.charge), ("leave", box.leave), ("stop_temperature", stop_temp))
        ]  # fmt: skip
    E, T = v["energy"], v["temperature"]
    rows += [
        E[0] == instance.start_energy_kwh, T[0] == instance.start_temperature_c,
        E[1:] >= box.energy.lo[1:], E[1:] <= box.energy.hi[1:],
        T[1:] >= box.temperature.lo[1:], T[1:] <= box.temperature.hi[1:],
    ]  # fmt: skip
    start = [E[k] for k in range(n)]
    warm = [T[k] for k in range(n)]
    price, time = cp.Parameter(max(S, 1), nonneg=True), cp.Parameter(max(S, 1), nonneg=True)
    price.value = np.array([s.price_per_kwh for s in instance.stops] or [0.0])
    time.value = np.array([s.time_price_per_h for s in instance.stops] or [0.0])
    cost: Expression = instance.fixed_cost
    stopped: Expression = 0.0
    here: tuple[int, Expression, Expression] = (-1, None, None)
    for i, stop in enumerate(instance.stops):
        state = here[1:] if here[0] == stop.node else (E[stop.node], T[stop.node])
        border = cp.hstack([state[1], v["stop_temperature"][i]])
        part, grid, dwell = _stop_rows(instance, box, i, stop, v, state[0], border)
        rows += part
        here = (stop.node, v["leave"][i], v["stop_temperature"][i, K - 1])
        if stop.node < n:
            start[stop.node], warm[stop.node] = here[1:]
        stopped += dwell
        cost += price[i] * grid + time[i] * dwell
        cost += stop.occupancy_price_per_h * cp.pos(dwell - stop.occupancy_free_h)
    if S and np.isfinite(instance.total_dwell_h):
        rows.append(stopped <= instance.total_dwell_h)
    rows += _drive_rows(instance, box, v, cp.hstack(start), cp.hstack(warm))
    return Spec(cp.Problem(cp.Minimize(cost), rows), price, time, v)
