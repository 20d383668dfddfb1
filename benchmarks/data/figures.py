"""Owns how open figures become maps: reads ``sources``, smooths, continues, scales.

Knows nothing of any particular car but the key under which its rows stand.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from benchmarks.data.emit import SOURCES, Curve, points

__all__ = [
    "TEST_AUXILIARY_KW",
    "WALL_TO_BATTERY",
    "drive_efficiency",
    "driving_cycle_kwh_per_100km",
    "heat_pump_cop",
    "i3_ratio",
    "internal_power_kw",
    "lfp_ratio",
    "ocv_v",
    "source_of",
    "temperature_factor",
]

Array = npt.NDArray[np.float64]

KELVIN = 273.15
ARRHENIUS_NMC_K = 27_600.0 / 8.314
"""Activation temperature [K] of the fit to the BMW i3's resistances (27.6 kJ/mol)."""

WALL_TO_BATTERY = 0.88
"""Assumed: share of the AC wall energy that later leaves the battery."""

TEST_AUXILIARY_KW = 0.25
"""Assumed consumers during a dynamometer test (value of FASTSim 2.1.5's cars)."""

ROTATING_MASS = 1.02
"""Assumed: inertia over test mass."""


def _source(name: str) -> dict[str, npt.NDArray[np.float64]]:
    lines = (SOURCES / name).read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    return {c: np.array([float(r[i]) for r in rows[1:]]) for i, c in enumerate(rows[0])}


def source_of(name: str, vehicle: str) -> list[list[float]]:
    """Return a car's rows of a source file, without the key.

    Examples
    --------
    >>> source_of("road_load.csv", "polestar-2-dual")[0][3]
    2268.0
    """
    lines = (SOURCES / name).read_text(encoding="utf-8").splitlines()
    return [[float(x) for x in r[1:]] for r in (x.split(",") for x in lines) if r[0] == vehicle]


def ocv_v(chemistry: str) -> Curve:
    """Return the cell's OCV over SoC [V], thinned; ``chemistry`` is "nmc" or "lfp".

    Examples
    --------
    >>> ocv_v("nmc")[-1]
    (1.0, 4.2)
    """
    low = [0.0, 0.02, 0.05, 0.10]
    if chemistry == "lfp":
        table, nodes = _source("sony_lfp_ocv.csv"), [*low, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
        nodes += [0.8, 0.9, 0.98, 1.0]
    else:
        table, nodes = _source("mohtat2020_ocv.csv"), [*low, *np.arange(0.15, 1.01, 0.05)]
    return points(nodes, np.interp(nodes, table["soc"], table["ocv_v"]))


def i3_ratio(temperature_c: Array) -> Array:
    """Smooth the i3's medians in 1/T, continue them by the Arrhenius fit, relate to 25 C.

    Examples
    --------
    >>> bool(1.7 < i3_ratio(np.array([10.0, 25.0]))[0] < 1.8)
    True
    """
    data = _source("bmw_i3_resistance.csv")
    seen = np.clip(temperature_c, 0.0, 30.0)
    log_r = np.empty_like(seen)
    for k, t in enumerate(seen):
        weight = np.sqrt(data["n"] * np.exp(-0.5 * ((data["temperature_c"] - t) / 3.0) ** 2))
        inverse = 1 / (data["temperature_c"] + KELVIN) - 1 / (t + KELVIN)
        design = np.stack([np.ones_like(inverse), inverse], axis=1) * weight[:, None]
        fit = np.linalg.lstsq(design, np.log(data["resistance_ohm"]) * weight, rcond=None)[0]
        log_r[k] = fit[0]
    log_r += ARRHENIUS_NMC_K * (1 / (temperature_c + KELVIN) - 1 / (seen + KELVIN))
    out: Array = np.exp(log_r - log_r[np.searchsorted(temperature_c, 25.0)])
    return out


def lfp_ratio(temperature_c: Array) -> Array:
    """Arrhenius between the measured 10 / 25 / 40 C, continued beyond them, relative to 25 C.

    Examples
    --------
    >>> lfp_ratio(np.array([10.0, 25.0])).round(3).tolist()
    [1.426, 1.0]
    """
    data = _source("sony_lfp_resistance.csv")
    mean = np.log(0.5 * (data["charge_ohm"] + data["discharge_ohm"]))
    inverse = 1 / (data["temperature_c"] + KELVIN)
    cold = (mean[0] - mean[1]) / (inverse[0] - inverse[1])
    warm = (mean[1] - mean[2]) / (inverse[1] - inverse[2])
    here = 1 / (temperature_c + KELVIN) - inverse[1]
    out: Array = np.exp(np.where(here > 0, cold, warm) * here)
    return out


def temperature_factor() -> Curve:
    """Return the share of the warm charge limit over battery temperature.

    Median of three plating models up to 25 C, continued below -10 C with the
    slope (of the logarithm) of -10..0 C; then assumed: 1 to 40 C, 0.6 at 45, 0.2 at 50.

    Examples
    --------
    >>> dict(temperature_factor())[25.0]
    1.0
    """
    data = _source("charge_temperature_factor.csv")
    models = np.stack([data["ecker2015"], data["mohtat2020"], data["okane2022"]])
    median = np.median(models, axis=0)
    t = data["temperature_c"]
    slope = math.log(median[2] / median[0]) / (t[2] - t[0])
    cold = np.arange(-30.0, t[0] - 0.1, 5.0)
    below = median[0] * np.exp(slope * (cold - t[0]))
    return points([*cold, *t, 40.0, 45.0, 50.0], [*below, *median, 1.0, 0.6, 0.2])


def internal_power_kw(grid_kw: Array, volt: Array, resistance_ohm: float) -> Array:
    """Return the internal power p that takes ``grid_kw`` at the terminals: p + R*p^2/U^2 = grid.

    Examples
    --------
    >>> round(float(internal_power_kw(np.array(101.0), np.array(400.0), 0.016)), 9)
    100.0
    """
    k = resistance_ohm * 1000.0 / volt**2
    return np.asarray((np.sqrt(1.0 + 4.0 * k * grid_kw) - 1.0) / (2.0 * k))


def driving_cycle_kwh_per_100km(vehicle: str, cycle: str, efficiency: float) -> float:
    """Return the battery's consumption on a cycle, one efficiency both ways [kWh/100 km].

    Parameters
    ----------
    vehicle : str
        Row of ``road_load.csv``.
    cycle : {"hwfet", "udds"}
        Cycle file.
    efficiency : float
        Battery to wheel and back.

    Examples
    --------
    >>> 10 < driving_cycle_kwh_per_100km("polestar-2-dual", "hwfet", 0.88) < 18
    True
    """
    a, b, c, mass = source_of("road_load.csv", vehicle)[0][:4]
    speed = _source(f"{cycle}.csv")["speed_mps"]
    mean = 0.5 * (speed[1:] + speed[:-1])
    force = a + b * mean + c * mean**2 + ROTATING_MASS * mass * np.diff(speed)
    wheel = np.where(mean > 0, force * mean, 0.0)
    joule = np.where(wheel > 0, wheel / efficiency, wheel * efficiency).sum()
    joule += 1000.0 * TEST_AUXILIARY_KW * mean.size
    return float(joule / 3.6e6 / (mean.sum() / 1e5))


def drive_efficiency(vehicle: str) -> float:
    """Return the efficiency that meets EPA's highway consumption, to 0.01 (bisection).

    Examples
    --------
    >>> 0.7 < drive_efficiency("polestar-2-dual") < 0.9
    True
    """
    target = WALL_TO_BATTERY * source_of("road_load.csv", vehicle)[0][4]
    lo, hi = 0.6, 1.0
    for _ in range(40):
        mid = 0.5 * (lo + hi)
        if driving_cycle_kwh_per_100km(vehicle, "hwfet", mid) > target:
            lo = mid
        else:
            hi = mid
    return round(lo, 2)


def heat_pump_cop() -> Curve:
    """Return the CoP over battery temperature: 7.5 K to the evaporator, 50 / 55 C condenser.

    Examples
    --------
    >>> bool(2.9 < dict(heat_pump_cop())[0.0] < 3.1)
    True
    """
    data = _source("cop_r1234yf.csv")
    evaporation = np.unique(data["evaporation_c"])
    inverse = np.array([np.mean(1 / data["cop"][data["evaporation_c"] == t]) for t in evaporation])
    battery = evaporation + 7.5
    t = np.arange(-30.0, 37.6, 2.5)
    slope = (inverse[1] - inverse[0]) / (battery[1] - battery[0])
    below = inverse[0] + slope * (t - battery[0])
    table = 1 / np.where(t < battery[0], below, np.interp(t, battery, inverse))
    return points([*t, 50.0], [*table, table[-1]])
