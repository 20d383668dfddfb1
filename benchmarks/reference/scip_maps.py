"""Owns the maps as a global solver likes them: short closed forms with measured margins.

A branch-and-bound code relaxes every term on every box: one exponential or one
quadratic over the whole range costs it one secant and a few tangents, a table
with forty nodes costs it forty binaries or kinks. So each table is replaced by
the shortest form that is near it, or by its own kinks, thinned; and what is
left between form and table is measured and kept as a margin. The solver may
take any value within the margin: its program contains ours. Knows no program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.reference.splines import cut
from relax.maps import Table1, Table2

__all__ = ["FIT_TOLERANCE", "Band", "Form", "SurfaceCap", "fit_band", "fit_cap", "fit_form"]

Array = npt.NDArray[np.float64]
Kept = npt.NDArray[np.bool_]

FIT_TOLERANCE = 5e-3
"""Error up to which a shorter form is preferred, as a share of the table's value."""
RATE_STEP = 0.1
"""Spacing of the exponents tried first."""
RATES = tuple(n * RATE_STEP for n in (*range(-40, 0), *range(1, 41)))
"""Exponents tried, over the normalised argument in [-1, 1]."""
SAFETY = 1e-6
"""Added to every margin, which is measured at a table's nodes and between, not everywhere."""
PER_SEGMENT = 8
"""Points of a table's segment at which a form is compared with it."""
PRODUCT_TOLERANCE = 1e-3
"""Singular value below which a surface is a constant plus one product."""


@dataclass(frozen=True)
class Form:
    """A function of one variable in few terms, over t = (x - middle) / half.

    Parameters
    ----------
    middle, half : float
        Normalisation: t in [-1, 1].
    powers : tuple of float
        Coefficients of 1, t, t^2, ...
    rate, size : float
        Of the term ``size * exp(rate * t)``; size 0: none.
    kinks, bends : tuple of float
        Terms ``bend * |t - kink|``.

    Examples
    --------
    >>> Form(1.0, 2.0, (1.0, 2.0), 0.0, 0.0, (0.5,), (4.0,))(3.0)
    5.0
    """

    middle: float
    half: float
    powers: tuple[float, ...]
    rate: float = 0.0
    size: float = 0.0
    kinks: tuple[float, ...] = ()
    bends: tuple[float, ...] = ()

    @property
    def is_affine(self) -> bool:
        """Whether it is linear in its argument."""
        return len(self.powers) <= 2 and self.size == 0.0 and not self.kinks

    def __call__(self, x: Any) -> Any:
        """Return the value at numbers or at an expression of SCIP's."""
        t = (x - self.middle) / self.half
        value = self.powers[0] + self.powers[1] * t
        for n, c in enumerate(self.powers[2:], start=2):
            value = value + c * t**n
        if self.size != 0.0:
            value = value + self.size * _exp(self.rate * t)
        for kink, bend in zip(self.kinks, self.bends, strict=True):
            value = value + bend * abs(t - kink)
        return value


def _exp(x: Any) -> Any:
    if isinstance(x, float | np.ndarray):
        return np.exp(x)
    from pyscipopt import exp

    return exp(x)


def _grid(nodes: Array) -> Array:
    """Return points of every segment, its ends included."""
    share = np.linspace(0.0, 1.0, PER_SEGMENT, endpoint=False)
    points = nodes[:-1, None] + share * np.diff(nodes)[:, None]
    return np.append(points.ravel(), nodes[-1])


def _closed(middle: float, half: float, t: Array, value: Array, weight: Array) -> list[Form]:
    """Return the short forms by weighted least squares, shortest first."""
    forms = []
    for degree in (1, 2, 3):
        basis = np.vander(t, degree + 1, increasing=True)
        c = np.linalg.lstsq(basis * weight[:, None], value * weight, rcond=None)[0]
        forms.append(Form(middle, half, tuple(c.tolist())))

    def exponential(rate: float) -> tuple[float, Form]:
        basis = np.column_stack([np.ones_like(t), np.exp(rate * t)])
        c = np.linalg.lstsq(basis * weight[:, None], value * weight, rcond=None)[0]
        error = float(np.abs((basis @ c - value) * weight).max())
        return error, Form(middle, half, (float(c[0]), 0.0), rate, float(c[1]))

    coarse = min(RATES, key=lambda rate: exponential(float(rate))[0])
    fine = np.linspace(coarse - RATE_STEP, coarse + RATE_STEP, 21)
    best = min((float(rate) for rate in fine if abs(rate) > 1e-3), key=lambda r: exponential(r)[0])
    return [*forms, exponential(best)[1]]


def _kinked(middle: float, half: float, nodes: Array, f: Array, keep: Kept) -> Form:
    """Return the piecewise linear form through the kept nodes."""
    t, v = nodes[keep], f[keep]
    slope = np.diff(v) / np.diff(t)
    bends = 0.5 * np.diff(slope)
    inner = t[1:-1]
    tilt = 0.5 * (slope[0] + slope[-1])
    level = v[0] - tilt * t[0] - float(bends @ np.abs(t[0] - inner))
    return Form(middle, half, (float(level), float(tilt)), 0.0, 0.0, tuple(inner), tuple(bends))


def fit_form(
    x: Array, f: Array, weight: Array | None = None, tolerance: float = FIT_TOLERANCE
) -> Form:
    """Return the shortest form near the piecewise linear function with nodes (x, f).

    Affine, quadratic or one exponential if that is within the tolerance; else kinks at
    as few of the nodes as hold it, so that a tolerance of 0 gives the table itself.

    Parameters
    ----------
    x, f : ndarray, shape (n,)
        Nodes and values.
    weight : ndarray, shape (n,), optional
        One over the size to which the tolerance refers; by default of the values.
    tolerance : float
        Largest weighted error.

    Examples
    --------
    >>> x = np.linspace(0.0, 10.0, 21)
    >>> fit_form(x, np.exp(-0.2 * x)).kinks, len(fit_form(x, np.abs(x - 4.0) + 1.0).kinks)
    ((), 1)
    """
    middle, half = 0.5 * float(x[0] + x[-1]), 0.5 * float(x[-1] - x[0])
    nodes = (x - middle) / half
    weight = 1.0 / np.abs(f) if weight is None else weight
    t = _grid(nodes)
    value, w = np.interp(t, nodes, f), np.interp(t, nodes, weight)
    for form in _closed(middle, half, t, value, w) if tolerance > 0.0 else ():
        if float(np.abs((form(middle + half * t) - value) * w).max()) <= tolerance:
            return form
    keep = np.zeros(x.size, dtype=bool)
    keep[[0, -1]] = True
    while True:
        error = np.abs(np.interp(nodes, nodes[keep], f[keep]) - f) * weight
        worst = int(np.argmax(error))
        if error[worst] <= tolerance or keep.all():
            return _kinked(middle, half, nodes, f, keep)
        keep[worst] = True


@dataclass(frozen=True)
class Band:
    """A positive table between two multiples of a form: lower * form <= table <= upper * form.

    Parameters
    ----------
    form : Form
        The function.
    lower, upper : float
        The multiples; both one if the form is the table.
    """

    form: Form
    lower: float
    upper: float

    @property
    def deviation(self) -> float:
        """Largest relative distance between form and table."""
        return max(self.upper - 1.0, 1.0 - self.lower)


def fit_band(
    table: Table1, lo: float, hi: float, inverse: bool = False, tolerance: float = FIT_TOLERANCE
) -> Band:
    """Return a form of a positive table on [lo, hi] with its margins.

    Parameters
    ----------
    table : Table1
        The map.
    lo, hi : float
        Part of its domain that counts.
    inverse : bool
        Whether the form is of one over the table.
    tolerance : float
        Below which shortness counts; 0: the table itself.

    Raises
    ------
    ValueError
        The table is not positive there.

    Examples
    --------
    >>> band = fit_band(Table1([0.0, 1.0, 2.0], [1.0, 2.0, 4.0]), 0.0, 2.0)
    >>> round(band.lower, 3), round(band.upper, 3), len(band.form.kinks)
    (1.0, 1.0, 1)
    """
    x = cut(table.x, lo, hi)
    f = np.asarray(table(x))
    if f.min() <= 0.0:
        raise ValueError(f"{table.name}: not positive on {lo:g} .. {hi:g}")
    form = fit_form(x, 1.0 / f if inverse else f, None, tolerance)
    points = _grid(x)
    target = np.interp(points, x, f)
    ratio = (1.0 / target if inverse else target) / form(points)
    lower, upper = float(ratio.min()), float(ratio.max())
    if max(upper - 1.0, 1.0 - lower) < 1e-9:
        return Band(form, 1.0, 1.0)
    return Band(form, lower - SAFETY, upper + SAFETY)


@dataclass(frozen=True)
class SurfaceCap:
    """An upper bound of a table of two variables: factor * (level + sum of products of forms).

    Parameters
    ----------
    level : float
        Constant term.
    terms : tuple of pairs of Form
        Factors over the first and the second variable.
    factor : float
        At least the table over the form, everywhere.
    deviation : float
        Largest relative distance between table and form.
    """

    level: float
    terms: tuple[tuple[Form, Form], ...]
    factor: float
    deviation: float


def _product(values: Array) -> tuple[float, list[tuple[Array, Array]]]:
    """Return a constant and products of vectors that give a matrix, or nearly."""
    for level in (0.0, float(values.min())):
        left, singular, right = np.linalg.svd(values - level)
        if singular.size < 2 or singular[1] <= PRODUCT_TOLERANCE * singular[0]:
            sign = 1.0 if right[0].sum() > 0.0 else -1.0
            return level, [(sign * singular[0] * left[:, 0], sign * right[0])]
    left, singular, right = np.linalg.svd(values)
    rank = int(np.count_nonzero(singular > PRODUCT_TOLERANCE * singular[0]))
    return 0.0, [(singular[r] * left[:, r], right[r]) for r in range(rank)]


def fit_cap(
    table: Table2,
    x_lo: float,
    x_hi: float,
    y_lo: float,
    y_hi: float,
    tolerance: float = FIT_TOLERANCE,
) -> SurfaceCap:
    """Return an upper bound of a positive table on a rectangle, near it.

    Power limits are one curve over charge times one factor of temperature, some with a
    floor: a constant and one product. Others take as many products as it needs.

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 11)
    >>> cap = fit_cap(Table2(x, x, 2.0 + np.outer(1.0 - x, x)), 0.0, 1.0, 0.0, 1.0)
    >>> cap.level, len(cap.terms), cap.factor < 1.001
    (2.0, 1, True)
    """
    x, y = cut(table.x, x_lo, x_hi), cut(table.y, y_lo, y_hi)
    values = table(*np.meshgrid(x, y, indexing="ij"))
    level, products = _product(values)
    terms = []
    for u, v in products:
        # an error of u matters as a share of the whole: least where the table is small
        weight_u = 1.0 / np.maximum(_size(values, v[None, :], 1), 1e-9)
        weight_v = 1.0 / np.maximum(_size(values, u[:, None], 0), 1e-9)
        terms.append((fit_form(x, u, weight_u, tolerance), fit_form(y, v, weight_v, tolerance)))
    fine_x, fine_y = _grid(x), _grid(y)
    form = np.full((fine_x.size, fine_y.size), level)
    for f, g in terms:
        form += np.outer(f(fine_x), g(fine_y))
    target = table(*np.meshgrid(fine_x, fine_y, indexing="ij"))
    ratio = target / np.maximum(form, 1e-9)
    upper = float(ratio.max())
    exact = float(np.abs(ratio - 1.0).max()) < 1e-9
    return SurfaceCap(
        level, tuple(terms), 1.0 if exact else upper + SAFETY, float(np.abs(ratio - 1.0).max())
    )


def _size(values: Array, factor: Array, axis: int) -> Array:
    """Return by how much a factor may change per share of the least affected value."""
    share = np.abs(values) / np.maximum(np.abs(factor), 1e-12)
    return np.asarray(share.min(axis=axis))
