"""Owns the cone program as data: named variables, named rows, cones, and a finite box.

``min q'x + constant  subject to  A x + s = b,  s in {0}^m0 x R+^m1 x SOC x ...,  l <= x <= u``

``Assembly`` collects rows as index arrays and turns them into one CSC matrix in
a single conversion. Columns carry a scale (x is dimensionless, ``x * scale`` is
physical) and rows are scaled to O(1). Knows nothing of cars and of solvers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

__all__ = ["Assembly", "ConeProgram", "Term", "add_cutoff", "make_cone_program"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Term = tuple[npt.ArrayLike, npt.ArrayLike]
"""Columns and coefficients of one term, broadcast over the rows; column -1: no such variable."""


KEPT_BYTES = 1 << 24
"""Arrays up to this size are kept by the C library when they are freed."""


def _keep_freed_memory() -> None:
    """Let the C library keep freed arrays instead of having the system page them in anew.

    glibc hands arrays above a threshold back at once, and freeing a larger one raises the
    threshold (``mallopt(3)``, M_MMAP_THRESHOLD); elsewhere this does nothing. Programs are made
    of arrays of 0.1 to 1 MB: paging them took 2 to 3 % of a plan.
    """
    np.empty(KEPT_BYTES, dtype=np.uint8)


_keep_freed_memory()


class _Entries:
    """Entries of one block of rows, collected in arrays that grow."""

    def __init__(self) -> None:
        self.count, self.room = 0, 1 << 14
        self.row, self.column = np.empty(self.room, np.int64), np.empty(self.room, np.int64)
        self.value = np.empty(self.room)

    def add(
        self, begin: int, shape: tuple[int, ...], terms: Sequence[Term], stride: int = 1
    ) -> None:
        """Add terms of rows of a shape: ``begin``, ``begin`` + ``stride``, ... in its order.

        Columns and values of every term are broadcast to the shape.
        """
        size, first = prod(shape), self.count
        self.count += len(terms) * size
        while self.count > self.room:
            self.room *= 2
            self.row, self.column = (
                np.resize(self.row, self.room),
                np.resize(self.column, self.room),
            )
            self.value = np.resize(self.value, self.room)
        rows = np.arange(begin, begin + stride * size, stride)
        self.row[first : self.count].reshape(len(terms), size)[...] = rows
        column = self.column[first : self.count].reshape(len(terms), *shape)
        value = self.value[first : self.count].reshape(len(terms), *shape)
        for k, (columns, values) in enumerate(terms):
            column[k], value[k] = columns, values


@dataclass(frozen=True)
class ConeProgram:
    """A conic program with named variables and rows.

    Parameters
    ----------
    q : ndarray, shape (n,)
        Linear cost of the scaled variables.
    constant : float
        Added to every objective value.
    A : csc_array, shape (m, n)
        Rows in the order zero cone, nonnegative cone, second-order cones.
    b : ndarray, shape (m,)
        Right-hand side.
    n_zero, n_nonneg : int
        Sizes of the first two blocks.
    soc_sizes : tuple of int
        Sizes of the second-order cones, in the order of the rows.
    l, u : ndarray, shape (n,)
        Finite box that every feasible point of interest lies in (scaled).
    scale : ndarray, shape (n,)
        Physical value of one unit of every variable.
    row_scale : ndarray, shape (m,)
        Factor that every row was multiplied by.
    variables : mapping of str to ndarray of int
        Columns by name, in the shape of the quantity; -1 where it does not exist.
    rows : mapping of str to ndarray of int
        Rows by name.
    """

    q: Array
    constant: float
    A: sp.csc_array
    b: Array
    n_zero: int
    n_nonneg: int
    soc_sizes: tuple[int, ...]
    l: Array  # noqa: E741
    u: Array
    scale: Array
    row_scale: Array
    variables: Mapping[str, Index] = field(default_factory=lambda: MappingProxyType({}))
    rows: Mapping[str, Index] = field(default_factory=lambda: MappingProxyType({}))

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: read-only mappings are not."""
        names = {"variables": dict(self.variables), "rows": dict(self.rows)}
        return {**self.__dict__, **names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore what ``__getstate__`` gave."""
        names = {name: MappingProxyType(state[name]) for name in ("variables", "rows")}
        self.__dict__.update({**state, **names})

    def value(self, name: str, x: Array) -> Array:
        """Return the physical values of a named variable; absent entries are 0.

        Parameters
        ----------
        name : str
            Name of the variable.
        x : ndarray, shape (n,)
            Scaled point.
        """
        index = self.variables[name]
        return np.where(index >= 0, (x * self.scale)[index], 0.0)

    def slack(self, x: Array) -> Array:
        """Return by how much every row or cone is satisfied (scaled, >= 0 is feasible).

        Zero rows give -|residual|; a cone gives its margin s_0 - |s_1..|, in
        its first row, and 0 in its others.
        """
        s: Array = self.b - self.A @ x
        out = s.copy()
        out[: self.n_zero] = -np.abs(s[: self.n_zero])
        first = self.n_zero + self.n_nonneg
        if self.soc_sizes:
            sizes = np.array(self.soc_sizes)
            start = np.concatenate([[0], np.cumsum(sizes)[:-1]])
            tail = s[first:] ** 2
            head = s[first:][start]
            norm = np.sqrt(np.maximum(np.add.reduceat(tail, start) - head**2, 0.0))
            out[first:] = 0.0
            out[first + start] = head - norm
        return out


class Assembly:
    """Collects variables, rows and cones, then builds the program once.

    Every ``rhs`` fixes the shape of its rows; terms broadcast to it. All numbers
    are physical: scaling happens in ``build``.

    Examples
    --------
    >>> rows = Assembly()
    >>> x = rows.variable("x", [True, True], scale=2.0, lo=0.0, hi=4.0)
    >>> rows.less("sum", 3.0, (x[0], 1.0), (x[1], 1.0))
    >>> program = rows.build({"x": -1.0})
    >>> program.A.shape, program.q.tolist(), program.u.tolist()
    ((1, 2), [-2.0, -2.0], [2.0, 2.0])
    """

    def __init__(self) -> None:
        self._n = 0
        self._index: dict[str, Index] = {}
        self._scale: list[Array] = []
        self._lo: list[Array] = []
        self._hi: list[Array] = []
        # one list per block: zero, nonnegative, second-order
        self._entries = (_Entries(), _Entries(), _Entries())
        self._rhs: tuple[list[Array], ...] = ([], [], [])
        self._count = [0, 0, 0]
        self._names: list[tuple[str, int, int, int]] = []
        self._soc: list[tuple[int, int]] = []

    def variable(
        self,
        name: str,
        exists: npt.ArrayLike,
        *,
        scale: float,
        lo: npt.ArrayLike,
        hi: npt.ArrayLike,
    ) -> Index:
        """Add a variable and return its columns, -1 where it does not exist.

        Parameters
        ----------
        name : str
            Unique name.
        exists : array_like of bool
            Shape of the quantity.
        scale : float
            Physical size of one unit.
        lo, hi : array_like
            Physical box, broadcast to the shape.
        """
        mask = np.asarray(exists, dtype=bool)
        count = int(mask.sum())
        index = np.full(mask.shape, -1, dtype=np.int64)
        index[mask] = np.arange(self._n, self._n + count)
        self._n += count
        self._index[name] = index
        self._scale.append(np.full(count, scale))
        ends = np.empty((2, *mask.shape))
        ends[0], ends[1] = lo, hi
        self._lo.append(ends[0][mask])
        self._hi.append(ends[1][mask])
        return index

    def alias(self, name: str, columns: Index) -> None:
        """Give existing columns a further name, to be read back from a point."""
        self._index[name] = columns

    def _linear(
        self, block: int, name: str, rhs: npt.ArrayLike, terms: Sequence[Term], unit: Index | None
    ) -> None:
        b = np.asarray(rhs, dtype=np.float64)
        if b.size == 0:
            return
        if unit is not None and (unit >= 0).any():
            terms = [*terms, (unit, -b)]
            b = np.where(unit >= 0, 0.0, b)
        begin = self._count[block]
        self._count[block] += b.size
        self._names.append((name, block, begin, b.size))
        self._rhs[block].append(b.ravel())
        self._entries[block].add(begin, b.shape, terms)

    def equal(self, name: str, rhs: npt.ArrayLike, *terms: Term, unit: Index | None = None) -> None:
        """Add rows sum of terms = rhs * unit.

        ``unit`` are columns of variables that take the place of the number 1, -1 for the
        number itself, broadcast to the rows: so a row becomes its own perspective.
        """
        self._linear(0, name, rhs, terms, unit)

    def less(self, name: str, rhs: npt.ArrayLike, *terms: Term, unit: Index | None = None) -> None:
        """Add rows sum of terms <= rhs * unit."""
        self._linear(1, name, rhs, terms, unit)

    def cone(
        self,
        name: str,
        *components: tuple[npt.ArrayLike, Sequence[Term]],
        unit: Index | None = None,
    ) -> None:
        """Add second-order cones s_0 >= |(s_1, ...)|.

        Parameters
        ----------
        name : str
            Unique name.
        *components : pair of (constant, terms)
            Affine expressions s_0, s_1, ..., each of shape (k,) for k cones.
        unit : ndarray of int, shape (k,), optional
            Columns that take the place of the number 1, as in ``equal``.
        """
        size = len(components)
        k = np.asarray(components[0][0]).size
        if k == 0:
            return
        begin = self._count[2]
        self._count[2] += size * k
        self._names.append((name, 2, begin, size * k))
        self._soc.append((size, k))
        constants = np.empty((k, size))
        for i, (constant, terms) in enumerate(components):
            constants[:, i] = constant
            if unit is not None and (unit >= 0).any():
                terms = [*terms, (unit, constants[:, i].copy())]
                constants[unit >= 0, i] = 0.0
            minus = [(c, -np.asarray(value, dtype=np.float64)) for c, value in terms]
            self._entries[2].add(begin + i, (k,), minus, stride=size)
        self._rhs[2].append(constants.ravel())

    def build(self, cost: Mapping[str, npt.ArrayLike], constant: float = 0.0) -> ConeProgram:
        """Return the program with cost sum of ``cost[name] * name`` + constant.

        Parameters
        ----------
        cost : mapping of str to array_like
            Physical cost coefficients, broadcast to the variable's shape.
        constant : float
            Constant of the objective.
        """
        n, counts = self._n, self._count
        offset = np.concatenate([[0], np.cumsum(counts)])
        m = int(offset[-1])
        scale = np.concatenate(self._scale)
        row = np.concatenate(
            [e.row[: e.count] + begin for e, begin in zip(self._entries, offset[:3], strict=True)]
        )
        col = np.concatenate([e.column[: e.count] for e in self._entries])
        val = np.concatenate([e.value[: e.count] for e in self._entries])
        b = np.concatenate([r for k in range(3) for r in self._rhs[k]])
        keep = (col >= 0) & (val != 0.0)
        row, col, val = row[keep], col[keep], val[keep]
        val = val * scale[col]
        size = np.zeros(m)
        np.maximum.at(size, row, np.abs(val))
        sizes = tuple(size for size, k in self._soc for _ in range(k))
        if sizes:  # one factor per cone
            blocks = np.array(sizes)
            start = np.concatenate([[0], np.cumsum(blocks)[:-1]])
            tail = np.maximum(size[offset[2] :], np.abs(b[offset[2] :]))
            size[offset[2] :] = np.repeat(np.maximum.reduceat(tail, start), blocks)
        row_scale = 1.0 / np.where(size > 0.0, size, 1.0)
        A = sp.csc_array(
            sp.coo_array((val * row_scale[row], (row, col)), shape=(m, n), dtype=np.float64)
        )
        q = np.zeros(n)
        for name, coefficient in cost.items():
            index = self._index[name]
            value = np.broadcast_to(np.asarray(coefficient, dtype=np.float64), index.shape)
            np.add.at(q, index[index >= 0], value[index >= 0])
        return ConeProgram(
            q=q * scale,
            constant=constant,
            A=A,
            b=b * row_scale,
            n_zero=counts[0],
            n_nonneg=counts[1],
            soc_sizes=sizes,
            l=np.concatenate(self._lo) / scale,
            u=np.concatenate(self._hi) / scale,
            scale=scale,
            row_scale=row_scale,
            variables=MappingProxyType(dict(self._index)),
            rows=MappingProxyType(
                {
                    name: np.arange(offset[block] + begin, offset[block] + begin + k)
                    for name, block, begin, k in self._names
                }
            ),
        )


def add_cutoff(program: ConeProgram, cutoff: float) -> ConeProgram:
    """Return the program with one more row: the cost is at most the cutoff.

    Parameters
    ----------
    program : ConeProgram
        Any program.
    cutoff : float
        Largest cost, constant included.

    Examples
    --------
    >>> program = make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0])
    >>> add_cutoff(program, 5.0).b.tolist()
    [-2.0, 5.0]
    """
    at = program.n_zero + program.n_nonneg
    size = float(np.abs(program.q).max(initial=0.0)) or 1.0
    data, indices = np.array(program.A.data), np.array(program.A.indices)
    pointer = np.array(program.A.indptr)
    indices = indices + (indices >= at)
    columns = np.flatnonzero(program.q)
    data = np.insert(data, pointer[columns + 1], program.q[columns] / size)
    indices = np.insert(indices, pointer[columns + 1], at)
    pointer = pointer + np.concatenate([[0], np.cumsum(program.q != 0.0)])
    A = sp.csc_array(
        (data, indices.astype(np.int32), pointer.astype(np.int32)),
        shape=(program.b.size + 1, program.q.size),
    )
    A.sort_indices()
    return replace(
        program,
        A=A,
        b=np.insert(program.b, at, (cutoff - program.constant) / size),
        n_nonneg=program.n_nonneg + 1,
        row_scale=np.insert(program.row_scale, at, 1.0 / size),
        rows=MappingProxyType({k: v + (v >= at) for k, v in program.rows.items()}),
    )


def make_cone_program(
    q: npt.ArrayLike,
    A: npt.ArrayLike,
    b: npt.ArrayLike,
    *,
    n_zero: int = 0,
    n_nonneg: int = 0,
    soc_sizes: Sequence[int] = (),
    l: npt.ArrayLike,  # noqa: E741
    u: npt.ArrayLike,
    constant: float = 0.0,
) -> ConeProgram:
    """Return a program from dense data, unscaled and unnamed: for tests and examples.

    Raises
    ------
    ValueError
        The blocks do not add up to the rows.

    Examples
    --------
    >>> make_cone_program([1.0], [[-1.0]], [-2.0], n_nonneg=1, l=[0.0], u=[9.0]).b.tolist()
    [-2.0]
    """
    matrix = sp.csc_array(np.asarray(A, dtype=np.float64))
    rhs = np.asarray(b, dtype=np.float64)
    if n_zero + n_nonneg + sum(soc_sizes) != rhs.size or matrix.shape[0] != rhs.size:
        raise ValueError("the cones must cover every row once")
    cost = np.asarray(q, dtype=np.float64)
    return ConeProgram(
        q=cost,
        constant=constant,
        A=matrix,
        b=rhs,
        n_zero=n_zero,
        n_nonneg=n_nonneg,
        soc_sizes=tuple(soc_sizes),
        l=np.asarray(l, dtype=np.float64),
        u=np.asarray(u, dtype=np.float64),
        scale=np.ones(cost.size),
        row_scale=np.ones(rhs.size),
    )
