"""Owns the fit of the car to the paper's tables: linear models, steps, what is determined.

Gauss-Newton with bounds: values are linearised by differences of optimal values, a step is a
linear least-squares problem within ranges. Where two choices of stops are close, the least of
both linear models is fitted. Knows nothing of files and pages.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isfinite

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from tqdm import tqdm

from benchmarks.data.paper import NAMES, RANGES, Fit
from benchmarks.paper.published import (
    AMBIENT_C,
    CASES,
    ENERGY_KWH,
    HEAT_PUMP_KW,
    LEAST_TIME_MIN,
)
from benchmarks.paper.values import Car, Key, Plans, Value, values

__all__ = [
    "ORDERS",
    "ROWS",
    "SIGMA",
    "Linear",
    "Report",
    "determined",
    "deviations",
    "fitted",
    "from_vector",
    "linearise",
    "step",
    "summary",
]

Array = npt.NDArray[np.float64]
Stops = tuple[int, ...]

SIGMA = {"energy": 0.05, "time": 0.05}
"""Standard deviation of a table value: half a unit of its last digit [kWh, min]."""
AHEAD = 0.05
"""Wanted lead of a choice of stops that the paper states over the other [kWh or min]."""
AHEAD_SIGMA = 0.03
"""Standard deviation of that lead [kWh or min]."""
DIFFERENCE = 0.1
"""Step of the differences, in standard deviations of the guess."""
LONGEST = 1.0
"""Longest step of a number in the first round, in standard deviations of the guess; halved
when the values after a step are not better."""
NEAR = 1.0
"""Choices of stops this much above the best may become the best [kWh or min]."""
STALLED = 0.01
"""Relative gain below which the fit ends."""
ROWS: tuple[tuple[Key, float], ...] = tuple(
    row
    for t in AMBIENT_C
    for p in HEAT_PUMP_KW
    for row in ((("energy", t, p), ENERGY_KWH[t, p]), (("time", t, p), LEAST_TIME_MIN[t, p]))
)
"""The 18 figures of the tables."""
ORDERS: tuple[tuple[Key, Stops, Stops], ...] = tuple(
    (
        ("time" if c.aim == "time" else "free", -10.0, c.heat_pump_kw),
        c.stops,
        (1,) if c.stops == (1, 2) else (1, 2),
    )
    for c in CASES
    if c.aim != "cost"
)
"""What is to be the better choice of stops, and against which."""


@dataclass(frozen=True)
class Linear:
    """Optimal values as linear functions of the numbers, in standard deviations of the guess.

    Parameters
    ----------
    values : dict
        By figure and choice of stops, at the present numbers.
    slopes : dict
        Their derivatives, shape (14,).
    """

    values: dict[tuple[Key, Stops], float]
    slopes: dict[tuple[Key, Stops], Array]


def vector(fit: Fit) -> Array:
    """Return the numbers as standard deviations from the guess."""
    return np.array([(getattr(fit, n) - RANGES[n].likely) / RANGES[n].deviation for n in NAMES])


def from_vector(x: Array) -> Fit:
    """Return the fit of such a vector, within the ranges."""
    given = {}
    for name, value in zip(NAMES, x.tolist(), strict=True):
        r = RANGES[name]
        given[name] = min(max(r.likely + value * r.deviation, r.low), r.high)
    return Fit(**given)


def linearise(fit: Fit, plans: Plans) -> tuple[dict[Key, Value], Linear, Plans]:
    """Return values and slopes at a fit; one set of values per number is computed.

    Parameters
    ----------
    fit : Fit
        Where.
    plans : Plans
        To start from.
    """
    base, plans = values(Car(fit), plans)
    x = vector(fit)
    slopes: dict[tuple[Key, Stops], Array] = {}
    for j in tqdm(range(len(NAMES)), file=sys.stderr, desc="slopes", leave=False, disable=None):
        r = RANGES[NAMES[j]]
        up = getattr(fit, NAMES[j]) + DIFFERENCE * r.deviation <= r.high
        moved = x.copy()
        moved[j] += DIFFERENCE if up else -DIFFERENCE
        there, _ = values(Car(from_vector(moved)), plans)
        for key, value in base.items():
            for stops, now in value.by_set.items():
                then = there[key].by_set.get(stops, inf)
                slope = (then - now) / (moved[j] - x[j]) if isfinite(then) and now < inf else 0.0
                slopes.setdefault((key, stops), np.zeros(len(NAMES)))[j] = slope
    flat = {(k, s): v for k, value in base.items() for s, v in value.by_set.items() if v < inf}
    return base, Linear(flat, slopes), plans


def _objective(model: Linear, x: Array, d: Array) -> float:
    """Return the sum of squares that the linear models predict after a step."""
    total = float((x + d) @ (x + d))
    for key, published in ROWS:
        now = min(v + float(model.slopes[k] @ d) for k, v in model.values.items() if k[0] == key)
        total += ((now - published) / SIGMA[key[0]]) ** 2
    for key, good, bad in ORDERS:
        if (key, good) in model.values and (key, bad) in model.values:
            total += (max(_margin(model, key, good, bad, d), 0.0) / AHEAD_SIGMA) ** 2
    return float(total)


def _margin(model: Linear, key: Key, good: Stops, bad: Stops, d: Array) -> float:
    """Return by how much a choice that the paper states misses its wanted lead."""
    a, b = (key, good), (key, bad)
    difference = model.values[a] - model.values[b] + AHEAD
    return difference + float((model.slopes[a] - model.slopes[b]) @ d)


def step(model: Linear, x: Array, longest: float) -> Array:
    """Return the step that fits the linear models best within ranges and longest step.

    Every assignment of the figures to one of their close choices of stops is a linear
    least-squares problem; the best by the least of all models is taken.

    Parameters
    ----------
    model : Linear
        At ``x``.
    x : ndarray, shape (14,)
        Present numbers, in standard deviations from the guess.
    longest : float
        Bound on the step of each number.
    """
    lo = np.array([(RANGES[n].low - RANGES[n].likely) / RANGES[n].deviation for n in NAMES])
    hi = np.array([(RANGES[n].high - RANGES[n].likely) / RANGES[n].deviation for n in NAMES])
    lower, upper = np.maximum(lo - x, -longest) - 1e-9, np.minimum(hi - x, longest) + 1e-9
    choices = []
    for key, _ in ROWS:
        by_set = {k[1]: v for k, v in model.values.items() if k[0] == key}
        least = min(by_set.values())
        choices.append([s for s, v in by_set.items() if v <= least + NEAR])
    best, best_value = np.zeros(x.size), _objective(model, x, np.zeros(x.size))
    for assigned in product(*choices):
        d = np.zeros(x.size)
        for _ in range(4):  # which inequalities bind settles in a few rounds
            rows, wanted = [np.eye(x.size)], [-x]
            for (key, published), stops in zip(ROWS, assigned, strict=True):
                scale = SIGMA[key[0]]
                rows.append(model.slopes[key, stops][None, :] / scale)
                wanted.append(np.array([(published - model.values[key, stops]) / scale]))
            for key, good, bad in ORDERS:
                if not {(key, good), (key, bad)} <= model.values.keys():
                    continue
                if _margin(model, key, good, bad, d) > -1e-6:
                    slope = model.slopes[key, good] - model.slopes[key, bad]
                    lead = model.values[key, bad] - model.values[key, good]
                    rows.append(slope[None, :] / AHEAD_SIGMA)
                    wanted.append(np.array([(lead - AHEAD) / AHEAD_SIGMA]))
            d = lsq_linear(np.vstack(rows), np.concatenate(wanted), (lower, upper)).x
            value = _objective(model, x, d)
            if value < best_value:
                best, best_value = d, value
    return np.asarray(best)


@dataclass(frozen=True)
class Report:
    """What the tables say about the numbers.

    Parameters
    ----------
    singular_values : ndarray, shape (14,)
        Of the slopes, a table value's and a guess's standard deviation as units: above 1
        the tables say more about that combination than the guess.
    combinations : ndarray, shape (14, 14)
        The combinations, one per row, in standard deviations of the guess.
    standard_error : ndarray, shape (14,)
        Of each number, guess and tables together [its unit].
    share : ndarray, shape (14,)
        Part of the guess's variance that the tables remove.
    """

    singular_values: Array
    combinations: Array
    standard_error: Array
    share: Array


def determined(base: dict[Key, Value], model: Linear) -> Report:
    """Return singular values and standard errors at the fit."""
    rows = [model.slopes[key, base[key].stops] / SIGMA[key[0]] for key, _ in ROWS]
    slopes = np.vstack(rows)
    covariance = np.linalg.inv(slopes.T @ slopes + np.eye(len(NAMES)))
    error = np.sqrt(np.diag(covariance))
    unit = np.array([RANGES[n].deviation for n in NAMES])
    _, singular, directions = np.linalg.svd(slopes)
    return Report(np.asarray(singular), np.asarray(directions), error * unit, 1.0 - error**2)


def deviations(base: dict[Key, Value]) -> list[tuple[Key, float, float]]:
    """Return figure, published value and ours, in the order of the tables."""
    return [(key, published, base[key].best) for key, published in ROWS]


def summary(base: dict[Key, Value]) -> str:
    """Return root mean squares and largest deviations as a sentence."""
    rows = deviations(base)
    off = {k: [ours - said for key, said, ours in rows if key[0] == k] for k in SIGMA}
    worst = {k: max(map(abs, v)) for k, v in off.items()}
    rms = {k: float(np.sqrt(np.mean(np.square(v)))) for k, v in off.items()}
    return (
        f"energy rms {rms['energy']:.3f} worst {worst['energy']:.2f} kWh, "
        f"time rms {rms['time']:.3f} worst {worst['time']:.2f} min"
    )


def fitted(fit: Fit, rounds: int) -> Fit:
    """Return the fit after some Gauss-Newton steps with a bound on their length."""
    base, model, plans = linearise(fit, {})
    zero, longest = np.zeros(len(NAMES)), LONGEST
    value = _objective(model, vector(fit), zero)
    print(f"0: {summary(base)}; sum of squares {value:.1f}", file=sys.stderr)
    for k in range(1, rounds + 1):
        trial = from_vector(vector(fit) + step(model, vector(fit), longest))
        there, trial_plans = values(Car(trial), plans)
        flat = {(key, s): v for key, w in there.items() for s, v in w.by_set.items() if v < inf}
        then = _objective(replace(model, values=flat), vector(trial), zero)
        better = then < value
        print(
            f"{k}: {summary(there)}; sum of squares {then:.1f}" + ("" if better else ", refused"),
            file=sys.stderr,
        )
        if not better:
            longest *= 0.5
            continue
        if value - then < STALLED * value:
            return trial
        fit, value = trial, then
        base, model, plans = linearise(fit, trial_plans)
    return fit
