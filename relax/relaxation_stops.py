"""Owns the rows of the charging cells: heat, grid energy, dwell, losses, and the cost.

Equation labels (R1) .. (R10) are those of ``docs/relaxation.md``. Knows nothing
of driving and of solvers.
"""

from __future__ import annotations

import numpy as np

from relax.envelopes import envelope_product
from relax.envelopes_charge import (
    ChargeGrid,
    envelope_charge_time_under,
    envelope_grid_limit_over,
    envelope_limit_over,
    envelope_stop_loss_over,
    envelope_stop_loss_under,
    make_charge_grid,
    range_of_planes,
)
from relax.envelopes_stay import envelope_stay_under
from relax.intervals import Interval
from relax.program import Term
from relax.reach_heat import cooling_floor_c
from relax.relaxation_drive import LEAST_RESISTANCE_OHM
from relax.relaxation_model import Array, Index, Model, middle, stack

__all__ = ["STOP_TEMPERATURES", "add_stops"]

STOP_TEMPERATURES = (0.15, 0.4, 0.65, 0.9)
"""Shares of the temperature interval at which planes of the stop loss take their slope."""


def add_stops(model: Model) -> None:
    """Charging cells: heat, energy from the grid, actuators, dwell; and the cost."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    vehicle, pack = instance.vehicle, instance.vehicle.pack
    S, K = len(instance.stops), instance.cells
    eta_c, temp, y_hi = vehicle.heater_cabin_efficiency, box.cell_temperature, box.dwell.hi
    column = {name: stack(instance, name)[:, None] for name in (
        "base_kw", "cabin_heat_kw", "ambient_c", "heat_loss_kw_per_k", "price_per_kwh",
        "time_price_per_h",
    )}  # fmt: skip
    q, g = np.broadcast_to(column["cabin_heat_kw"], (S, K)), column["heat_loss_kw_per_k"]
    pump = model.pumps[1]
    into = stack(instance, "detour_in_kwh")[:, None]
    cell_energy = box.cell_energy(stack(instance, "detour_out_kwh"))
    tables = make_charge_grid(
        pack.charge_limit_kw, pack.resistance_ohm, pack.voltage_squared,
        [s.grid_limit_kw for s in instance.stops], cell_energy, temp,
    )  # fmt: skip
    rho, rho_range = envelope_stop_loss_over(tables)
    every = np.ones((S, K), dtype=bool)
    loss_hi = box.charge.hi[:, None] / K * rho_range.hi.reshape(S, K)
    y_lo = box.dwell.lo
    corners = np.stack([temp.lo * y_lo, temp.lo * y_hi, temp.hi * y_lo, temp.hi * y_hi])
    occupied = np.array([s.occupancy_price_per_h > 0.0 for s in instance.stops], dtype=bool)
    longest = box.stay.hi
    # crossed where a stop cannot be used: its rows say so, its variables keep a box
    some = np.maximum(y_hi, 0.0)
    cools = box.stop_temperature.hi[:, 1:] >= cooling_floor_c(vehicle)
    cools &= vehicle.cooling_kw > 0.0
    maybe = box.optional[:, None]
    for name, exists, scale, lo, hi in (
        ("dwell", every, 0.03, box.dwell.lo, y_hi),
        ("cell_loss", every, 0.05, 0.0, np.maximum(loss_hi, 0.0) * (1.0 + 1e-9) + 1e-9),
        ("temp_dwell", every, 0.5, corners.min(axis=0) - 1e-9, corners.max(axis=0) + 1e-9),
        ("cell_heater", every & (vehicle.heater_kw > 0.0), 0.1, 0.0, vehicle.heater_kw * some),
        ("cell_cooling", cools, 0.1, 0.0, vehicle.cooling_kw * some),
        ("cell_pump", pump.power > 0.0, 0.05, 0.0, pump.power * some),
        ("cell_pump_heat", pump.power > 0.0, 0.05, 0.0, (pump.heat + 1e-9) * some),
        ("cell_limit", every, 50.0, 0.0, tables.power_range.hi.reshape(S, K) * (1.0 + 1e-9)),
        ("occupied", occupied, 0.5, 0.0, np.maximum(longest, 0.0)),
    ):
        if name in ("dwell", "temp_dwell"):  # the others' lower ends are 0
            lo, hi = (
                np.where(maybe, np.minimum(lo, 0.0), lo),
                np.where(maybe, np.maximum(hi, 0.0), hi),
            )
        v[name] = rows.variable(name, exists, scale=scale, lo=lo, hi=hi)
    y, loss, X, hb, ac, hp, h = (
        v[x] for x in ("dwell", "cell_loss", "temp_dwell", "cell_heater", "cell_cooling",
                       "cell_pump", "cell_pump_heat")
    )  # fmt: skip
    W, t0, t1 = v["charge"][:, None], v["border"][:, :-1], v["border"][:, 1:]
    used = np.broadcast_to(v["used"][:, None], (S, K))
    capacity, zero = pack.heat_capacity_kwh_per_k, np.zeros((S, K))
    rows.equal(
        "cell heat", zero, (t1, capacity), (t0, -capacity), (loss, -1.0), (X, g),
        (y, -g * column["ambient_c"]), (hb, -vehicle.heater_battery_efficiency),
        (ac, vehicle.cooling_cop), (h, 1.0), (hp, -1.0),
    )  # (R7)  # fmt: skip
    one = np.ones((S, 1))
    power: list[tuple[Index, Array]] = [
        (loss, one), (y, column["base_kw"] + column["cabin_heat_kw"] / eta_c), (hb, one), (ac, one),
        (hp, one), (h, -one / eta_c),
    ]  # fmt: skip
    planes = envelope_grid_limit_over(tables, Interval(box.dwell.lo.ravel(), y_hi.ravel()))
    c = (np.arange(K) + 0.5) / K
    # planes in E only where the limit depends on it
    varies = np.array([np.ptp(s.grid_limit_kw.f) > 0.0 for s in instance.stops], dtype=bool)
    for k, (s_e, s_y, s_0) in enumerate(planes.reshape(3, 3, S, K)):
        on = varies if k else np.ones(S, dtype=bool)
        terms: list[Term] = [(i[on], a[on]) for i, a in power]
        rows.less(
            f"grid limit {k}", (s_0 - s_e * into)[on], (W[on], (1.0 / K - s_e * c)[on]), *terms,
            (y[on], -s_y[on]), (v["before"][:, None][on], -s_e[on]), unit=used[on],
        )  # fmt: skip
    for name, columns, most in (
        ("dwell", y, None), ("cell heater", hb, None),
        ("cell cooling", ac, vehicle.cooling_kw), ("cell pump", hp, pump.power),
        ("cell pump heat", h, q),
    ):  # fmt: skip
        on_ = columns >= 0
        count = int(on_.sum())
        low = np.zeros(count) if columns is not y else -box.dwell.lo.ravel()
        rows.less(f"{name} at least", low, (columns[on_], -1.0), unit=used[on_])
        if most is not None:
            most = np.broadcast_to(np.asarray(most, dtype=np.float64), on_.shape)[on_]
            rows.less(f"{name} at most", np.zeros(count), (columns[on_], 1.0), (y[on_], -most))
    rows.less("dwell at most", y_hi, (y, 1.0), unit=used)
    rows.less(
        "cell heater share", zero, (hb, 1.0), (h, -1.0 / eta_c), (y, q / eta_c - vehicle.heater_kw)
    )
    whole = [(y[:, j], 1.0) for j in range(K)]
    rows.less("stay at most", longest, *whole, unit=v["used"])
    rows.less("stay at least", -box.stay.lo, *((i, -1.0) for i, _ in whole), unit=v["used"])
    if np.isfinite(instance.total_dwell_h):
        total, detour = np.array([instance.total_dwell_h]), stack(instance, "detour_h")
        dwells: list[Term] = [(y.ravel()[j : j + 1], 1.0) for j in range(y.size)]
        detours: list[Term] = [(v["used"][i : i + 1], detour[i]) for i in range(S)]
        rows.less("stop time at most", total, *dwells, *detours)
    free = stack(instance, "occupancy_free_h")[occupied]
    rows.less(
        "occupied", free, (v["occupied"][occupied], -1.0),
        *((y[occupied, j], 1.0) for j in range(K)), unit=v["used"][occupied],
    )  # fmt: skip
    rows.less("occupied at least", np.zeros(free.size), (v["occupied"][occupied], -1.0))
    _add_charge_time(model, tables)
    _add_stay(model)
    _add_stop_loss(model, tables, rho, rho_range)
    _add_products(model)
    price = column["price_per_kwh"]
    names = ("cell_loss", "dwell", "cell_heater", "cell_cooling", "cell_pump", "cell_pump_heat")
    for cost_name, (_, a) in zip(names, power, strict=True):
        model.cost[cost_name] = price * a
    model.cost["dwell"] = np.asarray(model.cost["dwell"]) + column["time_price_per_h"]
    model.cost["charge"] = price[:, 0]
    model.cost["occupied"] = stack(instance, "occupancy_price_per_h")


def _add_products(model: Model) -> None:
    """X = T * y and, through it, the heat pump in the cells: planes times dwell (R8)."""
    rows, box, v = model.rows, model.box, model.v
    y, X, hp, h = (v[x] for x in ("dwell", "temp_dwell", "cell_pump", "cell_pump_heat"))
    t0, t1, temp = v["border"][:, :-1], v["border"][:, 1:], box.cell_temperature
    shape = y.shape
    used = np.broadcast_to(v["used"][:, None], shape)
    flat = Interval(temp.lo.ravel(), temp.hi.ravel())
    below, above = envelope_product(flat, Interval(box.dwell.lo.ravel(), box.dwell.hi.ravel()))
    for name, planes, sign in (("product above", above, 1.0), ("product below", below, -1.0)):
        a = planes.reshape(2, 3, *shape)
        rows.less(
            name, sign * a[:, 2], (X, sign), (y, -sign * a[:, 1]), *middle(t0, t1, -sign * a[:, 0]),
            unit=used,
        )  # fmt: skip
    on = hp >= 0
    for name, planes, sign in model.pumps[1].planes:
        first, second = (h[on], hp[on]) if name.startswith("heat") else (hp[on], h[on])
        rows.less(
            f"cell pump {name}", np.zeros(planes[:, 2].shape), (first, sign),
            (second, -sign * planes[:, 0]), (X[on], -sign * planes[:, 1]),
            (y[on], -sign * planes[:, 2]),
        )  # fmt: skip


def _add_charge_time(model: Model, tables: ChargeGrid) -> None:
    """Dwell y >= (W/K) / Pchg(E, T): planes under the product, and a rotated cone (R9)."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    K, shape = instance.cells, v["dwell"].shape
    into = stack(instance, "detour_in_kwh")[:, None]
    W, y, p, before = v["charge"][:, None], v["dwell"], v["cell_limit"], v["before"][:, None]
    used = np.broadcast_to(v["used"][:, None], shape)
    t0, t1, c = v["border"][:, :-1], v["border"][:, 1:], (np.arange(K) + 0.5) / K
    w_lo = box.charge.lo[:, None]
    w_hi = np.maximum(box.charge.hi[:, None], w_lo)  # crossed where a stop cannot be used
    power = tables.power_range
    planes = envelope_charge_time_under(tables)
    s_e, s_t, s_0 = planes.reshape(-1, 3, *shape).swapaxes(0, 1)
    least = 1.0 / np.maximum(power.hi.reshape(shape), 1e-6) * (1.0 - 1e-9)
    # the limit is at least e / y, so 1 / limit is at most y / e
    most = np.minimum(1.0 / np.maximum(power.lo.reshape(shape), 1e-6), K * box.dwell.hi / w_lo)
    # a plane below 1 / limit may also stand for it: it is at most its own largest value
    most = np.minimum(most * (1.0 + 1e-9), range_of_planes(planes, tables).hi.reshape(-1, *shape))
    for name, at, slope in (("time from below", w_lo, least), ("time from above", w_hi, most)):
        a, b = at / K * s_e, at / K * s_t
        rows.less(
            name, -at / K * s_0 + a * into + at / K * slope, (y, -1.0), (W, slope / K + a * c),
            (before, a), *middle(t0, t1, b), unit=used,
        )  # fmt: skip
    a = envelope_limit_over(tables.power, tables.energy, tables.temp).reshape(-1, 3, *shape)
    rows.less(
        "cell limit", a[:, 2] - a[:, 0] * into, (p, 1.0), (W, -a[:, 0] * c), (before, -a[:, 0]),
        *middle(t0, t1, -a[:, 1]), unit=used,
    )  # fmt: skip
    w_0 = np.broadcast_to(0.5 * (w_lo + w_hi), shape).ravel()
    p_0 = np.maximum(0.5 * power.hi, 1.0)
    y_0 = w_0 / (K * p_0)
    chord = (np.sqrt(w_hi) - np.sqrt(w_lo)) / np.maximum(w_hi - w_lo, 1e-9)
    zero = np.broadcast_to((np.sqrt(w_lo) - chord * w_lo) * (1.0 - 1e-9) - 1e-9, shape).ravel()
    chord = np.broadcast_to(chord, shape).ravel()
    yf, pf, Wf = y.ravel(), p.ravel(), np.broadcast_to(W, shape).ravel()
    none = np.zeros(w_0.shape)
    rows.cone(
        "time cone",
        (none, [(yf, 1.0 / y_0), (pf, 1.0 / p_0)]),
        (none, [(yf, 1.0 / y_0), (pf, -1.0 / p_0)]),
        (2.0 * zero / np.sqrt(w_0), [(Wf, 2.0 * chord / np.sqrt(w_0))]),
        unit=used.ravel(),
    )


def _add_stay(model: Model) -> None:
    """All cells together take what the charge curve takes from begin to end (R9)."""
    instance, box, v = model.instance, model.box, model.v
    into, out = stack(instance, "detour_in_kwh"), stack(instance, "detour_out_kwh")
    temp, w = box.cell_temperature, box.charge
    planes = envelope_stay_under(
        instance.vehicle.pack.charge_limit_kw,
        [s.grid_limit_kw for s in instance.stops],
        box.arrive, box.full(out), Interval(temp.lo.min(axis=1), temp.hi.max(axis=1)),
        w.hi / instance.cells,
    )  # fmt: skip
    s_a, s_b, s_0 = planes.swapaxes(0, 1)
    model.rows.less(
        "stay from below", (s_a + s_b) * into - s_0, *((y, -1.0) for y in v["dwell"].T),
        (v["charge"], s_b), (v["before"], s_a + s_b), unit=v["used"],
    )  # fmt: skip


def _add_stop_loss(model: Model, tables: ChargeGrid, rho: Array, rho_range: Interval) -> None:
    """Joule loss of the cells from both sides (R6)."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    pack, K, shape = instance.vehicle.pack, instance.cells, v["dwell"].shape
    into = stack(instance, "detour_in_kwh")[:, None]
    W, y, loss, before = v["charge"][:, None], v["dwell"], v["cell_loss"], v["before"][:, None]
    used = np.broadcast_to(v["used"][:, None], shape)
    t0, t1, c = v["border"][:, :-1], v["border"][:, 1:], (np.arange(K) + 0.5) / K
    w_lo, w_hi = box.charge.lo[:, None], box.charge.hi[:, None]
    s_e, s_t, s_0 = rho.reshape(-1, 3, *shape).swapaxes(0, 1)
    # likewise a plane above rho is at least its own least value
    lo = np.maximum(rho_range.lo, range_of_planes(rho, tables).lo).reshape(-1, *shape)
    hi = rho_range.hi.reshape(shape)
    if not rho.size:  # the constant is the plane
        rows.less("stop loss high", np.zeros(shape), (loss, 1.0), (W, -hi / K))
    for name, at, slope in (("stop loss low", w_lo, hi), ("stop loss high", w_hi, lo)):
        a = at / K * s_e
        rows.less(
            name, at / K * (s_0 - slope) - a * into, (loss, 1.0), (W, -slope / K - a * c),
            (before, -a), *middle(t0, t1, -at / K * s_t), unit=used,
        )  # fmt: skip
    square_hi = 1.0 / tables.inverse_square.min(axis=1)
    temp = Interval(box.cell_temperature.lo.ravel(), box.cell_temperature.hi.ravel())
    cell = Interval(*(np.broadcast_to(w / K, shape).ravel() for w in (w_lo, w_hi)))
    m = tables.energy.shape[1] // 2
    charge = np.minimum(tables.power[:, m], tables.grid_power[:, m, None])
    wanted = temp.lo + np.array(STOP_TEMPERATURES)[:, None] * temp.width
    nearest = np.abs(tables.temp[None] - wanted[..., None]).argmin(axis=2)
    speed = np.maximum(charge[np.arange(charge.shape[0]), nearest], 1.0)
    planes = envelope_stop_loss_under(
        pack.resistance_ohm, square_hi, cell, temp, speed, STOP_TEMPERATURES
    ).reshape(-1, 4, *shape)
    rows.less(
        "stop loss below", -planes[:, 3], (loss, -1.0), (W, planes[:, 0] / K), (y, planes[:, 1]),
        *middle(t0, t1, planes[:, 2]), unit=used,
    )  # fmt: skip
    resistance_lo = tables.resistance.min(axis=1)
    r_lo = resistance_lo / square_hi * (1.0 - 1e-9)
    on = resistance_lo > LEAST_RESISTANCE_OHM
    rows.less("stop loss at least", np.zeros(int((~on).sum())), (loss.ravel()[~on], -1.0))
    e_0, p_0 = cell.mid, np.maximum(0.5 * tables.power_range.hi, 1.0)
    y_0 = e_0 / p_0
    l_0 = np.where(on, r_lo, 1.0) * e_0 * p_0
    yf, lf = y.ravel()[on], loss.ravel()[on]
    Wf, none = np.broadcast_to(W, shape).ravel()[on], np.zeros(int(on.sum()))
    rows.cone(
        "stop loss cone",
        (none, [(lf, 1.0 / l_0[on]), (yf, 1.0 / y_0[on])]),
        (none, [(lf, 1.0 / l_0[on]), (yf, -1.0 / y_0[on])]),
        (none, [(Wf, 2.0 / (K * e_0[on]))]),
    )
