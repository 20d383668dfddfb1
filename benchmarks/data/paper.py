"""Owns the closed forms of the preset ``paper-2022`` and their tables. Reads no file.

The maps of Hamednia et al. (2022) are unpublished. These closed forms and
their fitted numbers reproduce the paper's two tables; they are a calibration,
not a measurement. Units inside: degrees C, m/s, kW, ohm.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmarks.data.emit import Field, points, rounded

__all__ = [
    "charge_limit_kw",
    "cop",
    "discharge_limit_kw",
    "interpolation_errors",
    "paper_2022",
    "resistance_ohm",
]

Array = npt.NDArray[np.float64]

NAME = "paper-2022"
SOURCE = (
    "Hamednia et al., Optimal Thermal Management and Charging of Battery Electric Vehicles over "
    "Long Trips (2022): published figures; unpublished maps calibrated here to its two tables"
)

SOC_KNEE, SHARE_AT_80, CHARGE_MAX_KW = 0.23, 0.21, 159.0
T_OPT_C, T_SLOPE = 21.3, 0.0525

TEMPERATURE_C = np.concatenate(
    [np.arange(-30.0, 14.0, 2.0), np.arange(14.0, 30.0, 1.0), np.arange(30.0, 51.0, 2.5)]
)
FINE_TEMPERATURE_C = np.concatenate([np.arange(-30.0, 20.0, 2.0), np.arange(20.0, 50.5, 1.0)])
CHARGE_SOC = np.concatenate(
    [[0.0, 0.05, 0.10], np.arange(0.12, 0.35, 0.02), [0.37, 0.40], np.arange(0.45, 1.01, 0.05)]
)
DISCHARGE_SOC = np.concatenate(
    [np.arange(0.0, 0.295, 0.0125), [0.3, 0.325, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0]]
)
DISCHARGE_T_C = np.concatenate([np.arange(-30.0, 31.0, 2.5), [35.0, 40.0, 45.0, 50.0]])


def _plus(x: Array, width: float) -> Array:
    """Return the smooth positive part."""
    return 0.5 * (x + np.sqrt(x * x + width * width))


def charge_limit_kw(soc: Array, temperature_c: Array) -> Array:
    """Return the limit of the charging power [kW]; 2 kW where the formula's share is below 0.

    Examples
    --------
    >>> float(charge_limit_kw(np.array(0.1), np.array(25.0)).round(1))
    152.9
    """
    share = 1 - (1 - SHARE_AT_80) / (0.8 - SOC_KNEE) * _plus(soc - SOC_KNEE, 0.05)
    factor = np.exp(-T_SLOPE * _plus(T_OPT_C - temperature_c, 4.0))
    return np.asarray(2.0 + CHARGE_MAX_KW * factor * np.maximum(share, 0.0))


def discharge_limit_kw(soc: Array, temperature_c: Array) -> Array:
    """Return the limit of the discharging power [kW].

    Examples
    --------
    >>> float(discharge_limit_kw(np.array(0.5), np.array(20.0)).round(0))
    317.0
    """
    warm = 1 / (1 + np.exp(-(temperature_c + 5.0) / 7.0))
    full = 1 / (1 + np.exp(-(soc - 0.10) / 0.05))
    return np.asarray(25.0 + 300.0 * warm * full)


def resistance_ohm(temperature_c: Array) -> Array:
    """Return the pack resistance [ohm].

    Examples
    --------
    >>> float(resistance_ohm(np.array(25.0)))
    0.027
    """
    return np.asarray(0.027 * np.exp(0.035 * (25.0 - temperature_c)))


def cop(temperature_c: Array) -> Array:
    """Return the heat pump's coefficient of performance at vanishing power.

    Examples
    --------
    >>> float(cop(np.array(-10.0)).round(3))
    2.158
    """
    return np.asarray(0.48 * 328.15 / (63.0 - temperature_c))


def interpolation_errors() -> dict[str, float]:
    """Return the largest relative error of every table against its closed form.

    Charge limit: SoC 0.05 .. 0.90, T -30 .. 40; discharge limit: SoC 0.05 .. 1, T -30 .. 40;
    resistance and CoP: T -30 .. 40. Evaluated on a fine grid, numbers rounded as written.

    Examples
    --------
    >>> all(error < 0.01 for error in interpolation_errors().values())
    True
    """
    t = np.linspace(-30.0, 40.0, 1401)
    out: dict[str, float] = {}
    for name, form, grid in (
        ("resistance", resistance_ohm, TEMPERATURE_C),
        ("cop", cop, FINE_TEMPERATURE_C),
    ):
        out[name] = float(np.max(np.abs(np.interp(t, grid, form(grid)) / form(t) - 1)))
    for name, limit, s_grid, t_grid, s_hi in (
        ("charge_limit", charge_limit_kw, CHARGE_SOC, TEMPERATURE_C, 0.90),
        ("discharge_limit", discharge_limit_kw, DISCHARGE_SOC, DISCHARGE_T_C, 1.0),
    ):
        s = np.linspace(0.05, s_hi, 601)
        table = limit(s_grid[:, None], t_grid[None, :])
        over_t = np.stack([np.interp(t, t_grid, row) for row in table])
        both = np.stack([np.interp(s, s_grid, column) for column in over_t.T], axis=1)
        out[name] = float(np.max(np.abs(both / limit(s[:, None], t[None, :]) - 1)))
    return out


def _limit(kind: str) -> dict[str, list[float] | list[list[float]]]:
    form, soc, temperature = (
        (charge_limit_kw, CHARGE_SOC, TEMPERATURE_C)
        if kind == "charge"
        else (discharge_limit_kw, DISCHARGE_SOC, DISCHARGE_T_C)
    )
    power = form(soc[:, None], temperature[None, :])
    return {
        "soc": [rounded(float(s)) for s in soc],
        "temperature_c": [rounded(float(t)) for t in temperature],
        "power_kw": [[rounded(float(p)) for p in row] for row in power],
    }


def paper_2022() -> tuple[str, list[Field]]:
    """Return header and fields of the preset.

    Examples
    --------
    >>> paper_2022()[1][0].value
    'paper-2022'
    """
    percent = {key: f"{100 * value:.2f} %" for key, value in interpolation_errors().items()}
    header = (
        f"{NAME}: the car of the paper, as far as it is published, and otherwise a calibration.\n"
        "Written by `python -m benchmarks.data.vehicles` (forms: benchmarks/data/paper.py).\n"
        "\n"
        f"Source: {SOURCE}.\n"
        "Published there: 195 Ah, 375 kJ/K, at most 40 C, 0.5 kW auxiliaries, heater 7 kW at 0.87, "
        "3 kW cooling, heat pump 0 / 1 / 3 kW.\n"
        "Calibrated: the maps marked so below. 14 numbers were fitted so that the paper's 18 table "
        "values are met; about 10 of their combinations are determined. A match with the tables is "
        "therefore no evidence for the maps. Licence: own numbers, project licence.\n"
        "\n"
        "Largest interpolation error of the tables against their closed forms: charge limit "
        f"{percent['charge_limit']} (SoC 0.05-0.90, -30..40 C), resistance "
        f"{percent['resistance']}, CoP {percent['cop']} (-30..40 C), discharge limit "
        f"{percent['discharge_limit']} (SoC 0.05-1; it never binds)."
    )
    t = TEMPERATURE_C
    fields = [
        Field("name", NAME),
        Field("source", SOURCE),
        Field("capacity_ah", 195.0, "Published."),
        Field(
            "ocv_v",
            [(0.0, rounded(108 * 3.42)), (1.0, rounded(108 * 4.14))],
            "Assumed: 108 cells in series, U = 108*(3.42 + 0.72*soc), exact. 79.6 kWh; the pack of "
            "this class is sold as 78 kWh.",
        ),
        Field(
            "resistance_ohm",
            points(t, resistance_ohm(t)),
            "Calibrated weakly: 27 mohm at 25 C (+- 15), slope assumed: 0.027*exp(0.035*(25 - T)).",
        ),
        Field("heat_capacity_kwh_per_k", 375.0 / 3600.0, "Published: 375 kJ/K."),
        Field(
            "temperature_min_c",
            -30.0,
            "40 C published; -30 C assumed (never reached in the cases).",
        ),
        Field("temperature_max_c", 40.0),
        Field(
            "heat_loss_kw_per_k",
            [(0.0, 0.010), (200.0, rounded(0.010 + 0.00112 * 200.0 / 3.6))],
            "Calibrated on one number (case A's final temperature): 10 + 1.12*v W/K, v in m/s.",
        ),
        Field(
            "heater_kw", 7.0, "Published: 7 kW, 0.87. The cabin path at 1 is a modelling choice."
        ),
        Field("heater_battery_efficiency", 0.87),
        Field("heater_cabin_efficiency", 1.0),
        Field("cooling_kw", 3.0, "3 kW published; the CoP is not: 2 assumed."),
        Field("cooling_cop", 2.0),
        Field("heat_pump_kw", 1.0, "Published: 0, 1 (here) or 3 kW."),
        Field(
            "heat_pump_cop",
            points(FINE_TEMPERATURE_C, cop(FINE_TEMPERATURE_C)),
            "Calibrated: 0.48*328.15/(63 - T_b)*(1 - 0.055*P), P in kW (condenser 55 C, evaporator "
            "8 K below the battery).",
        ),
        Field("heat_pump_droop_per_kw", 0.055),
        Field(
            "cabin_heating_kw",
            [(-30.0, 6.76), (-10.0, 3.92), (0.0, 2.50), (10.0, 1.86), (20.0, 0.0), (50.0, 0.0)],
            "Calibrated at -10 / 0 / 10 C. Assumed elsewhere: below -10 C the slope of -10..0 C, "
            "above 10 C a straight line to no demand at 20 C.",
        ),
        Field(
            "cabin_cooling_kw",
            [(-30.0, 0.0), (22.0, 0.0), (50.0, 2.8)],
            "Assumed: none below 22 C, then 0.1 kW/K.",
        ),
        Field("auxiliary_kw", 0.5, "Published."),
        Field(
            "mass_kg",
            2268.0,
            "Road load: EPA 2022 test car list, Volvo XC40 Recharge twin (US public domain): "
            "137.45 N, 4.7692 N/(m/s), 0.45073 N/(m/s)^2, converted. Measured by coast-down.",
        ),
        Field("road_load_a_n", 137.45),
        Field("road_load_b_n_per_kmh", 4.7692 / 3.6),
        Field("road_load_c_n_per_kmh2", 0.45073 / 3.6**2),
        Field(
            "drive_efficiency",
            0.88,
            "Assumed 0.88 both ways. Regeneration is not limited in the calibration: 150 kW never "
            "binds. Factor calibrated well (+- 1 %): the tables fix 79.77 kWh of propulsion on "
            "longhaul-400km; with kinetic energy counted the road load alone gives 78.14 kWh. (A "
            "model without kinetic energy, 77.6 kWh, needs 1.028.) Heat share calibrated.",
        ),
        Field("regen_efficiency", 0.88),
        Field("regen_max_kw", 150.0),
        Field("propulsion_factor", 1.0209),
        Field("drivetrain_heat_share", 0.68),
        Field(
            "charge_limit",
            dict(_limit("charge").items()),
            "Calibrated: 2 + 159*fT*fs kW, fs = 1 - 0.79/0.57*sp(soc - 0.23, 0.05) but at least 0, "
            "fT = exp(-0.0525*sp(21.3 - T, 4)), sp(x, w) = (x + sqrt(x^2 + w^2))/2. Rows: SoC.",
        ),
        Field(
            "discharge_limit",
            dict(_limit("discharge").items()),
            "Assumed, never binds: 25 + 300*sig((T + 5)/7)*sig((soc - 0.10)/0.05) kW. Rows: SoC.",
        ),
    ]
    return header, fields
