"""Owns the closed forms of the preset ``paper-2022``, their numbers and their tables.

The maps of Hamednia et al. (2022) are unpublished. The forms are chosen here;
their numbers are fitted to the paper's two tables by
``benchmarks.paper.calibrate``, which writes them to ``paper_2022.csv`` beside
this file, with the range each was allowed. A calibration, not a measurement.
Units inside: degrees C, m/s, kW, ohm.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.data.emit import Curve, Field, Value, points, rounded

__all__ = [
    "FIT",
    "FIT_FILE",
    "NAMES",
    "RANGES",
    "Fit",
    "Range",
    "charge_limit_kw",
    "cop",
    "discharge_limit_kw",
    "interpolation_errors",
    "overrides",
    "paper_2022",
    "read_fit",
    "resistance_ohm",
]

Array = npt.NDArray[np.float64]

NAME = "paper-2022"
SOURCE = (
    "Hamednia et al., Optimal Thermal Management and Charging of Battery Electric Vehicles over "
    "Long Trips (2022): published figures; unpublished maps calibrated here to its two tables"
)
FIT_FILE = Path(__file__).parent / "paper_2022.csv"
"""The fitted numbers: name, value, standard error, share that the paper's tables determine."""


@dataclass(frozen=True)
class Fit:
    """The numbers that are fitted, in the order of ``RANGES``; what each means stands there."""

    propulsion_factor: float
    cabin_minus10_kw: float
    cabin_0_kw: float
    cabin_10_kw: float
    charge_max_kw: float
    soc_knee: float
    share_at_80: float
    charge_slope_per_k: float
    charge_full_c: float
    resistance_25_mohm: float
    carnot_share: float
    cop_droop_per_kw: float
    heat_loss_slope_w: float
    drivetrain_heat_share: float


@dataclass(frozen=True)
class Range:
    """What is plausible for a number before the tables are looked at.

    Parameters
    ----------
    likely : float
        Best guess.
    low, high : float
        Never left by the fit; counted as two standard deviations of the guess.
    unit : str
        Of all three.
    meaning : str
        What the number is and where the range comes from.
    """

    likely: float
    low: float
    high: float
    unit: str
    meaning: str

    @property
    def deviation(self) -> float:
        """Standard deviation of the guess: a quarter of the range."""
        return 0.25 * (self.high - self.low)


RANGES = {
    "propulsion_factor": Range(1.0, 0.93, 1.07, "-", "propulsion of road load and cycle, times"),
    "cabin_minus10_kw": Range(4.0, 2.0, 6.0, "kW", "cabin heating demand at -10 C"),
    "cabin_0_kw": Range(2.7, 1.2, 4.2, "kW", "cabin heating demand at 0 C"),
    "cabin_10_kw": Range(1.5, 0.5, 2.5, "kW", "cabin heating demand at 10 C"),
    "charge_max_kw": Range(155.0, 135.0, 175.0, "kW", "charge limit, warm and nearly empty; "
                           "150 kW is sold for this class"),
    "soc_knee": Range(0.30, 0.10, 0.50, "-", "SoC above which the charge limit falls"),
    "share_at_80": Range(0.25, 0.10, 0.40, "-", "share of the charge limit left at SoC 0.8"),
    "charge_slope_per_k": Range(0.055, 0.030, 0.080, "1/K", "rise of the charge limit with "
                                "temperature; median of three plating models: 0.048 to 0.060"),
    "charge_full_c": Range(22.0, 14.0, 30.0, "C", "temperature above which it rises no more"),
    "resistance_25_mohm": Range(33.0, 15.0, 60.0, "mohm", "pack resistance at 25 C; models of "
                                "such cells: 23 to 109, measured in one pack: 25"),
    "carnot_share": Range(0.45, 0.35, 0.55, "-", "CoP over that of Carnot"),
    "cop_droop_per_kw": Range(0.05, 0.0, 0.10, "1/kW", "fall of the CoP with compressor power"),
    "heat_loss_slope_w": Range(1.1, 0.5, 1.7, "W/K per m/s", "rise of the heat loss with speed"),
    "drivetrain_heat_share": Range(0.6, 0.2, 1.0, "-", "drivetrain loss that heats the loop"),
}  # fmt: skip
"""One per number of ``Fit``, in its order; stated before this fit, but after a first trial."""
NAMES = tuple(f.name for f in fields(Fit))
"""The numbers' names, in order."""


def read_fit(file: Path = FIT_FILE) -> Fit:
    """Return the numbers of a calibration file.

    Examples
    --------
    >>> all(RANGES[n].low <= getattr(read_fit(), n) <= RANGES[n].high for n in NAMES)
    True
    """
    lines = [x for x in file.read_text(encoding="utf-8").splitlines() if x[:1] != "#"]
    rows = [line.split(",") for line in lines[1:]]
    return Fit(**{row[0]: float(row[1]) for row in rows})


FIT = read_fit()
"""The shipped numbers."""

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


def charge_limit_kw(soc: Array, temperature_c: Array, fit: Fit = FIT) -> Array:
    """Return the limit of the charging power [kW]; 2 kW where the formula's share is below 0.

    Examples
    --------
    >>> warm, cold = charge_limit_kw(np.array(0.1), np.array([25.0, -10.0]))
    >>> bool(0.9 * FIT.charge_max_kw < warm < FIT.charge_max_kw and cold < 0.4 * warm)
    True
    """
    fall = (1 - fit.share_at_80) / (0.8 - fit.soc_knee)
    share = 1 - fall * _plus(soc - fit.soc_knee, 0.05)
    factor = np.exp(-fit.charge_slope_per_k * _plus(fit.charge_full_c - temperature_c, 4.0))
    return np.asarray(2.0 + fit.charge_max_kw * factor * np.maximum(share, 0.0))


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


def resistance_ohm(temperature_c: Array, fit: Fit = FIT) -> Array:
    """Return the pack resistance [ohm].

    Examples
    --------
    >>> float(resistance_ohm(np.array(25.0))) == FIT.resistance_25_mohm / 1000.0
    True
    """
    return np.asarray(fit.resistance_25_mohm / 1000.0 * np.exp(0.035 * (25.0 - temperature_c)))


def cop(temperature_c: Array, fit: Fit = FIT) -> Array:
    """Return the heat pump's coefficient of performance at vanishing power.

    Examples
    --------
    >>> bool(1.5 < cop(np.array(-10.0)) < cop(np.array(10.0)) < 4.0)
    True
    """
    return np.asarray(fit.carnot_share * 328.15 / (63.0 - temperature_c))


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


def _limit(form: Array, soc: Array, temperature: Array) -> dict[str, Value]:
    return {
        "soc": [rounded(float(s)) for s in soc],
        "temperature_c": [rounded(float(t)) for t in temperature],
        "power_kw": [[rounded(float(p)) for p in row] for row in form],
    }


def _cabin_heating(fit: Fit) -> Curve:
    """Demand over ambient temperature; beyond -10 and 10 C assumed."""
    slope = (fit.cabin_0_kw - fit.cabin_minus10_kw) / 10.0
    coldest = min(fit.cabin_minus10_kw - 20.0 * slope, 6.9)
    pairs = [(-30.0, coldest), (-10.0, fit.cabin_minus10_kw), (0.0, fit.cabin_0_kw)]
    pairs += [(10.0, fit.cabin_10_kw), (20.0, 0.0), (50.0, 0.0)]
    return [(x, rounded(y)) for x, y in pairs]


def _maps(fit: Fit) -> dict[str, Value]:
    """Every field of the vehicle that depends on the fit."""
    t = TEMPERATURE_C
    charge = charge_limit_kw(CHARGE_SOC[:, None], t[None, :], fit)
    return {
        "resistance_ohm": points(t, resistance_ohm(t, fit)),
        "heat_loss_kw_per_k": [
            (0.0, 0.010),
            (200.0, rounded(0.010 + 0.001 * fit.heat_loss_slope_w * 200.0 / 3.6)),
        ],
        "heat_pump_cop": points(FINE_TEMPERATURE_C, cop(FINE_TEMPERATURE_C, fit)),
        "heat_pump_droop_per_kw": fit.cop_droop_per_kw,
        "cabin_heating_kw": _cabin_heating(fit),
        "propulsion_factor": fit.propulsion_factor,
        "drivetrain_heat_share": fit.drivetrain_heat_share,
        "charge_limit": _limit(charge, CHARGE_SOC, t),
    }


def overrides(fit: Fit) -> dict[str, Value]:
    """Return what turns the shipped preset into the car of another fit, for ``load_trip``.

    Examples
    --------
    >>> sorted(overrides(FIT))[0]
    'vehicle.cabin_heating_kw'
    """
    return {f"vehicle.{key}": value for key, value in _maps(fit).items()}


def paper_2022(fit: Fit = FIT) -> tuple[str, list[Field]]:
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
    maps = _maps(fit)
    knee, share = fit.soc_knee, fit.share_at_80
    pairs = [
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
            maps["resistance_ohm"],
            f"Calibrated: {fit.resistance_25_mohm / 1000:.4g} ohm*exp(0.035*(25 - T)), slope "
            "assumed.",
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
            maps["heat_loss_kw_per_k"],
            f"Calibrated: 10 + {fit.heat_loss_slope_w:.4g}*v W/K, v in m/s; 10 assumed.",
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
            maps["heat_pump_cop"],
            f"Calibrated: {fit.carnot_share:.4g}*328.15/(63 - T_b)*(1 - {fit.cop_droop_per_kw:.4g}"
            "*P), P in kW (condenser 55 C, evaporator 8 K below the battery).",
        ),
        Field("heat_pump_droop_per_kw", fit.cop_droop_per_kw),
        Field(
            "cabin_heating_kw",
            maps["cabin_heating_kw"],
            "Calibrated at -10 / 0 / 10 C. Assumed elsewhere: below -10 C the slope of -10..0 C "
            "(at most 6.9 kW at -30 C), above 10 C a straight line to no demand at 20 C.",
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
            "binds. On longhaul-400km the road load gives 78.14 kWh of propulsion with kinetic "
            f"energy counted; calibrated: {fit.propulsion_factor:.4g} times that, and the share of "
            "the drivetrain's loss that heats the loop.",
        ),
        Field("regen_efficiency", 0.88),
        Field("regen_max_kw", 150.0),
        Field("propulsion_factor", fit.propulsion_factor),
        Field("drivetrain_heat_share", fit.drivetrain_heat_share),
        Field(
            "charge_limit",
            maps["charge_limit"],
            f"Calibrated: 2 + {fit.charge_max_kw:.4g}*fT*fs kW, fs = 1 - {1 - share:.4g}/"
            f"{0.8 - knee:.4g}*sp(soc - {knee:.4g}, 0.05) but at least 0, fT = exp(-"
            f"{fit.charge_slope_per_k:.4g}*sp({fit.charge_full_c:.4g} - T, 4)), sp(x, w) = "
            "(x + sqrt(x^2 + w^2))/2. Rows: SoC.",
        ),
        Field(
            "discharge_limit",
            _limit(
                discharge_limit_kw(DISCHARGE_SOC[:, None], DISCHARGE_T_C[None, :]),
                DISCHARGE_SOC,
                DISCHARGE_T_C,
            ),
            "Assumed, never binds: 25 + 300*sig((T + 5)/7)*sig((soc - 0.10)/0.05) kW. Rows: SoC.",
        ),
    ]
    return header, pairs
