"""Owns the judgement: safe lower bounds and proofs of infeasibility from any dual vector.

For min q'x, A x + s = b, s in K, l <= x <= u and *any* z, projected onto the dual
cone: optimum >= -b'z + sum_i min(r_i l_i, r_i u_i) with r = q + A'z (C1). Every
rounding error is bounded and subtracted, so the number printed is a theorem
about the program's data. Numpy only: knows nothing of who wrote the program
and of who solved it.

References: Neumaier & Shcherbina 2004; Jansson, Chaykin & Keil 2007; the error
bounds of dot products are Higham 2002, section 3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

__all__ = [
    "CertifiableProgram",
    "Infeasible",
    "LowerBound",
    "Unproved",
    "certify_infeasible",
    "certify_lower_bound",
]

Array = npt.NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
"""Twice the unit roundoff: the factor 2 pays for rounding in the error bounds themselves."""
NEGLIGIBLE = 1e-140
"""Dual entries below this are set to zero: any vector may be judged."""
TINY = 1e-290
"""Added per operation, for underflow."""


class _Columns(Protocol):
    """Compressed sparse columns."""

    @property
    def data(self) -> npt.NDArray[np.float64]: ...
    @property
    def indices(self) -> npt.NDArray[np.int32]: ...
    @property
    def indptr(self) -> npt.NDArray[np.int32]: ...


class CertifiableProgram(Protocol):
    """The data a certificate is about; ``ConeProgram`` has them."""

    @property
    def q(self) -> Array: ...  # noqa: D102
    @property
    def constant(self) -> float: ...  # noqa: D102
    @property
    def A(self) -> _Columns: ...  # noqa: D102
    @property
    def b(self) -> Array: ...  # noqa: D102
    @property
    def n_zero(self) -> int: ...  # noqa: D102
    @property
    def n_nonneg(self) -> int: ...  # noqa: D102
    @property
    def soc_sizes(self) -> tuple[int, ...]: ...  # noqa: D102
    @property
    def l(self) -> Array: ...  # noqa: D102, E743
    @property
    def u(self) -> Array: ...  # noqa: D102


@dataclass(frozen=True)
class LowerBound:
    """Proved: no point of the program costs less.

    Parameters
    ----------
    value : float
        Safe lower bound, the program's constant included.
    """

    value: float


@dataclass(frozen=True)
class Infeasible:
    """Proved: the program has no point in its box.

    Parameters
    ----------
    margin : float
        By how much the ray separates (scaled), > 0.
    """

    margin: float


@dataclass(frozen=True)
class Unproved:
    """Nothing proved.

    Parameters
    ----------
    reason : str
        Why, as a phrase.
    """

    reason: str


def _project(program: CertifiableProgram, z: Array) -> Array:
    """Return a point of the dual cone near z; membership holds in exact arithmetic."""
    out = np.where(np.abs(z) < NEGLIGIBLE, 0.0, z)  # their squares would underflow
    first = program.n_zero + program.n_nonneg
    out[program.n_zero : first] = np.maximum(z[program.n_zero : first], 0.0)
    if program.soc_sizes:
        sizes = np.array(program.soc_sizes)
        start = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        tail = out[first:].copy()
        tail[start] = 0.0
        norm = np.sqrt(np.add.reduceat(tail**2, start))
        # raising the head never leaves the cone; the factor covers the norm's rounding
        norm = norm * (1.0 + (sizes + 4) * EPS)
        out[first + start] = np.maximum(out[first + start], norm)
    return out


def _transposed(A: _Columns, z: Array) -> tuple[Array, Array]:
    """A'z and a bound of its rounding error, shape (n,) both."""
    n = A.indptr.size - 1
    count = np.diff(A.indptr)
    column = np.repeat(np.arange(n), count)
    products = A.data * z[A.indices]
    value: Array = np.bincount(column, products, n).astype(np.float64, copy=False)
    size = np.bincount(column, np.abs(products), n)
    return value, (count + 2) * EPS * size + count * TINY


def _box_minimum(r: Array, error: Array, l: Array, u: Array) -> tuple[float, float]:  # noqa: E741
    """Sum of min(r_i l_i, r_i u_i) over all r within the error, and the sum of sizes."""
    reach = np.maximum(np.abs(l), np.abs(u))
    terms = np.minimum(r * l, r * u) - error * reach
    return float(terms.sum()), float((np.abs(r) * reach + error * reach).sum())


def _fit(program: CertifiableProgram, z: Array) -> str | None:
    """Reason why z or the box cannot be used, or None."""
    if z.shape != program.b.shape:
        return "the dual vector has the wrong length"
    if not np.all(np.isfinite(z)) or np.abs(z).max(initial=0.0) > 1e100:
        return "the dual vector is not finite"
    if not (np.all(np.isfinite(program.l)) and np.all(np.isfinite(program.u))):
        return "a variable has no finite box"
    if np.any(program.l > program.u):
        return "the box of a variable is empty"
    return None


def certify_lower_bound(program: CertifiableProgram, z: Array) -> LowerBound | Unproved:
    """Return a lower bound of a program that holds in exact arithmetic (C1).

    Parameters
    ----------
    program : CertifiableProgram
        Data of the program, with a finite box.
    z : ndarray, shape (m,)
        Any vector; a good bound needs a good dual point. It is projected onto the
        dual cone first. With a linear cost the primal point does not enter.

    Returns
    -------
    LowerBound or Unproved
        Unproved if the vector or the box is unusable.

    Examples
    --------
    >>> from relax.program import make_cone_program
    >>> program = make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0])
    >>> certify_lower_bound(program, np.array([1.0]))  # min x subject to x >= 2
    LowerBound(value=1.99999...)
    >>> certify_lower_bound(program, np.array([np.nan]))
    Unproved(reason='the dual vector is not finite')
    """
    z = np.asarray(z, dtype=np.float64)
    reason = _fit(program, z)
    if reason is not None:
        return Unproved(reason)
    z = _project(program, z)
    value, error = _transposed(program.A, z)
    r = program.q + value
    error = error + EPS * (np.abs(program.q) + np.abs(value))
    inner, size = _box_minimum(r, error, program.l, program.u)
    products = program.b * z
    bound = program.constant - float(products.sum()) + inner
    size += float(np.abs(products).sum()) + abs(program.constant)
    # no summation order makes a larger error than (terms + 4) * eps * sum of sizes
    count = r.size + z.size + 8
    bound -= 2.0 * count * EPS * size + count * TINY
    if not np.isfinite(bound):
        return Unproved("the bound overflows")
    return LowerBound(float(np.nextafter(bound, -np.inf)))


def certify_infeasible(program: CertifiableProgram, z: Array) -> Infeasible | Unproved:
    """Return whether a ray proves that no point of the box satisfies the rows (C2).

    Infeasible if b'z - sum_i min(g_i l_i, g_i u_i) < 0 with g = A'z, z in the dual cone.

    Parameters
    ----------
    program : CertifiableProgram
        Data of the program, with a finite box.
    z : ndarray, shape (m,)
        Any vector, e.g. the ray of a solver.

    Returns
    -------
    Infeasible or Unproved
        Unproved if the ray separates by less than the rounding error.

    Examples
    --------
    >>> from relax.program import make_cone_program
    >>> rows = [[-1.0], [1.0]]  # x >= 2 and x <= 1
    >>> program = make_cone_program([0.0], rows, [-2.0, 1.0], n_nonneg=2, l=[0.0], u=[9.0])
    >>> certify_infeasible(program, np.array([1.0, 1.0]))
    Infeasible(margin=0.99999...)
    """
    z = np.asarray(z, dtype=np.float64)
    reason = _fit(program, z)
    if reason is not None:
        return Unproved(reason)
    z = _project(program, z)
    largest = float(np.abs(z).max(initial=0.0))
    if largest == 0.0:
        return Unproved("the ray is zero")
    z = _project(program, z / largest)
    value, error = _transposed(program.A, z)
    inner, size = _box_minimum(value, error, program.l, program.u)
    products = program.b * z
    size += float(np.abs(products).sum())
    count = value.size + z.size + 8
    margin = inner - float(products.sum()) - 2.0 * count * EPS * size - count * TINY
    if not margin > 0.0:
        return Unproved("the ray does not separate by more than rounding")
    return Infeasible(float(margin))
