"""Owns the rows of the driving steps: balances, actuators, battery limits, losses.

Equation labels (R1) .. (R10) are those of ``docs/relaxation.md``. Knows nothing
of charging and of solvers.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from relax.envelopes import (
    envelope_conductance_over,
    envelope_loss_over,
    envelope_loss_under,
)
from relax.envelopes_charge import envelope_table_over
from relax.intervals import pick, range1, range2
from relax.program import Term
from relax.reach import may_fill
from relax.reach_heat import cooling_floor_c
from relax.relaxation_model import Array, Model, middle

__all__ = ["FLOOR_WIDTH_K", "LEAST_RESISTANCE_OHM", "NEAR_KW", "add_drive"]

FLOOR_WIDTH_K = 0.5
"""Boxes that reach less than this below the cooling temperature get no chord: too steep [K]."""
LEAST_RESISTANCE_OHM = 1e-6
"""Below this the cone of the loss from below is left out: its conductance is unbounded."""
NEAR_KW = 0.05
"""Where planes below a loss miss at most this of its curvature, a lean relaxation has no cone. So
it is on nearly all propagated boxes, with the power known to 5 to 15 kW; ``benchmarks.bounds``
says what that costs and saves."""


def add_drive(model: Model) -> None:
    """Driving steps: balance of power and heat, actuators, battery limits."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    drive, vehicle, pack = instance.drive, instance.vehicle, instance.vehicle.pack
    n, d, q, eta_c = (
        drive.n_steps, drive.duration_h, drive.cabin_heat_kw, vehicle.heater_cabin_efficiency,
    )  # fmt: skip
    energy, temp = box.middle_energy, box.middle_temperature
    every = np.ones(n, dtype=bool)
    pump = model.pumps[0]
    resistance = range1(pack.resistance_ohm, temp)
    r_hi = resistance.hi / range1(pack.voltage_squared, energy).lo
    square_hi = np.maximum(box.power.lo**2, box.power.hi**2) + drive.ripple_kw2
    refused, on = np.full(n, np.inf), (drive.base_kw < 0.0) | (box.power.lo < 0.0)
    refused[on] = range2(pack.charge_limit_kw, pick(energy, on), pick(temp, on)).lo
    braking = (drive.base_kw < 0.0) & (box.power.lo <= 1e-6 - refused)
    braking |= may_fill(instance, box)
    cools = box.temperature.hi[1:] >= cooling_floor_c(vehicle)
    cools &= vehicle.cooling_kw > 0.0
    heater_hi = np.maximum(vehicle.heater_kw - (q - pump.heat) / eta_c, 0.0)
    for name, exists, scale, lo, hi in (
        ("power", every, 10.0, box.power.lo, box.power.hi),
        ("loss", every, 1.0, 0.0, r_hi * square_hi * (1.0 + 1e-9)),
        ("heater", every & (vehicle.heater_kw > 0.0), 2.0, 0.0, heater_hi),
        ("cooling", cools, 2.0, 0.0, vehicle.cooling_kw),
        ("pump", pump.power > 0.0, 1.0, 0.0, pump.power),
        ("pump_heat", pump.power > 0.0, 1.0, 0.0, pump.heat + 1e-9),
        ("brake", braking, 1.0, 0.0, np.maximum(-drive.base_kw, 0.0)),
    ):
        v[name] = rows.variable(name, exists, scale=scale, lo=lo, hi=hi)
    P, L, hb, ac, hp, h, br = (
        v[x] for x in ("power", "loss", "heater", "cooling", "pump", "pump_heat", "brake")
    )
    rows.equal("drive energy", np.zeros(n), (v["start"], 1.0), (v["energy"][1:], -1.0), (P, -d))
    rows.equal(
        "drive balance", drive.base_kw + q / eta_c,
        (P, 1.0), (L, -1.0), (hb, -1.0), (ac, -1.0), (hp, -1.0), (h, 1.0 / eta_c), (br, -1.0),
    )  # (R2)  # fmt: skip
    rate, g = pack.heat_capacity_kwh_per_k / d, drive.heat_loss_kw_per_k
    t0, t1 = v["start_temperature"], v["temperature"][1:]
    rows.equal(
        "drive heat", drive.drivetrain_heat_kw + g * drive.ambient_c,
        (t1, rate + 0.5 * g), (t0, 0.5 * g - rate), (L, -1.0),
        (hb, -vehicle.heater_battery_efficiency), (ac, vehicle.cooling_cop), (h, 1.0), (hp, -1.0),
    )  # (R3)  # fmt: skip
    for name, column, most in (
        ("heater", hb, None), ("cooling", ac, vehicle.cooling_kw), ("pump", hp, pump.power),
        ("pump heat", h, q), ("brake", br, -drive.base_kw),
    ):  # fmt: skip
        on = column >= 0
        rows.less(f"{name} at least", np.zeros(int(on.sum())), (column[on], -1.0))
        if most is not None:
            most = np.broadcast_to(np.asarray(most, dtype=np.float64), on.shape)[on]
            rows.less(f"{name} at most", most, (column[on], 1.0))
    _add_cooling(model, ac, t1)
    rows.less("heater share", vehicle.heater_kw - q / eta_c, (hb, 1.0), (h, -1.0 / eta_c))
    _add_limits(model, refused)
    _add_loss(model, resistance.lo, r_hi)
    on = hp >= 0
    for name, planes, sign in pump.planes:
        slope_t = middle(t0[on], t1[on], -sign * planes[:, 1])
        first, second = (h[on], hp[on]) if name.startswith("heat") else (hp[on], h[on])
        rows.less(
            f"drive pump {name}", sign * planes[:, 2],
            (first, sign), (second, -sign * planes[:, 0]), *slope_t,
        )  # (R4)  # fmt: skip


def _add_cooling(model: Model, cooling: npt.NDArray[np.int64], end: npt.NDArray[np.int64]) -> None:
    """Cooling ends no step below its temperature: the chord over the end temperature (R3)."""
    vehicle, lo = model.instance.vehicle, model.box.temperature.lo[1:]
    floor = cooling_floor_c(vehicle)
    on = (cooling >= 0) & (lo < floor - FLOOR_WIDTH_K)
    slope = vehicle.cooling_kw / (floor - lo[on])
    model.rows.less("cooling floor", -slope * lo[on], (cooling[on], 1.0), (end[on], -slope))


def _add_limits(model: Model, refused: Array) -> None:
    """Battery limits while driving, only where the box lets them bind (R5)."""
    rows, box, v, pack = model.rows, model.box, model.v, model.instance.vehicle.pack
    energy, temp = box.middle_energy, box.middle_temperature
    for name, table, bound, sign in (
        ("discharge limit", pack.discharge_limit_kw, box.power.hi, 1.0),
        ("charge limit", pack.charge_limit_kw, -box.power.lo, -1.0),
    ):
        on = bound > 0.0
        if not on.any():
            continue
        least = refused if sign < 0.0 else np.full(on.shape, np.inf)
        if sign > 0.0:
            least[on] = range2(table, pick(energy, on), pick(temp, on)).lo
        on &= bound > least
        if not on.any():
            continue
        planes = envelope_table_over(table, pick(energy, on), pick(temp, on))
        rows.less(
            name, planes[:, 2], (v["power"][on], sign),
            *middle(v["start"][on], v["energy"][1:][on], -planes[:, 0]),
            *middle(v["start_temperature"][on], v["temperature"][1:][on], -planes[:, 1]),
        )  # fmt: skip


def _add_loss(model: Model, resistance_lo: Array, r_hi: Array) -> None:
    """Joule loss of the driving steps from both sides (R6)."""
    rows, box, instance, v = model.rows, model.box, model.instance, model.v
    pack, ripple = instance.vehicle.pack, instance.drive.ripple_kw2
    R, square, P, L = pack.resistance_ohm, pack.voltage_squared, v["power"], v["loss"]
    energy, temp = box.middle_energy, box.middle_temperature
    e0, e1, t0, t1 = (
        v["start"], v["energy"][1:], v["start_temperature"], v["temperature"][1:],
    )  # fmt: skip
    for name, planes, sign in (
        ("loss above", envelope_loss_over(R, square, box.power, energy, temp, ripple), 1.0),
        ("loss below", envelope_loss_under(R, square, box.power, energy, temp, ripple), -1.0),
    ):
        rows.less(
            name, sign * planes[:, 3], (L, sign), (P, -sign * planes[:, 0]),
            *middle(e0, e1, -sign * planes[:, 1]), *middle(t0, t1, -sign * planes[:, 2]),
        )  # fmt: skip
    coned = resistance_lo > LEAST_RESISTANCE_OHM
    rows.less("loss at least", np.zeros(int((~coned).sum())), (L[~coned], -1.0))
    if model.lean:  # planes touch at the middle of the powers, at least
        coned &= r_hi * (0.5 * box.power.width) ** 2 > NEAR_KW
    for name, on in (("loss cone", coned & (ripple == 0.0)), ("ripple cone", coned & (ripple > 0))):
        if not on.any():
            continue
        s_e, s_t, s_0 = envelope_conductance_over(R, square, pick(energy, on), pick(temp, on))[0]
        typical = s_e * energy.mid[on] + s_t * temp.mid[on] + s_0
        p_0 = np.maximum(np.sqrt(box.power.mid[on] ** 2 + ripple[on]), 5.0)
        l_0 = p_0**2 / typical
        gamma: list[Term] = [
            *middle(e0[on], e1[on], s_e / typical), *middle(t0[on], t1[on], s_t / typical),
        ]  # fmt: skip
        minus: list[Term] = [(c, -np.asarray(x)) for c, x in gamma]
        parts = [
            (s_0 / typical, [(L[on], 1.0 / l_0), *gamma]),
            (-s_0 / typical, [(L[on], 1.0 / l_0), *minus]),
            (np.zeros(p_0.shape), [(P[on], 2.0 / p_0)]),
        ]
        if name == "ripple cone":
            parts.append((2.0 * np.sqrt(ripple[on]) / p_0, []))
        rows.cone(name, *parts)
