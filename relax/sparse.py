"""Owns sparse matrices of fixed pattern: named blocks of rows, values by one scatter.

A sequence of programs has one sparsity pattern and ever new numbers; the
pattern is worked out once and each matrix is then one ``bincount``. Knows
nothing of what rows and columns mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import sparse

__all__ = ["Pattern", "RowBlocks"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


class Pattern:
    """Sparsity pattern of a CSC matrix given by coordinates; duplicates add up.

    Parameters
    ----------
    rows, cols : ndarray of int, shape (m,)
        Coordinates of the values, in the order in which they will come.
    shape : tuple of int
        Shape of the matrix.

    Examples
    --------
    >>> pattern = Pattern(np.array([0, 1, 0]), np.array([0, 1, 0]), (2, 2))
    >>> pattern.matrix(np.array([1.0, 2.0, 3.0])).toarray().tolist()
    [[4.0, 0.0], [0.0, 2.0]]
    """

    def __init__(self, rows: Index, cols: Index, shape: tuple[int, int]) -> None:
        key, self._slot = np.unique(cols * shape[0] + rows, return_inverse=True)
        indices = (key % shape[0]).astype(np.int32)
        counts = np.bincount(key // shape[0], minlength=shape[1])
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._empty = sparse.csc_array((np.zeros(key.size), indices, indptr), shape=shape)
        self.size, self.shape = rows.size, shape

    def matrix(self, values: Array) -> sparse.csc_array:
        """Return the matrix with these values, shape (m,); explicit zeros are kept."""
        matrix = copy(self._empty)  # shares the pattern, which is checked once
        matrix.data = np.bincount(self._slot, values, matrix.nnz)
        return matrix


@dataclass(frozen=True)
class RowBlocks:
    """Named blocks of linear rows over fixed columns.

    Parameters
    ----------
    slices : dict of str to slice
        Rows of every block.
    columns : dict of str to tuple of ndarray
        Column indices of every block, one array per coefficient.
    pattern : Pattern
        Of the stacked matrix.
    """

    slices: Mapping[str, slice]
    columns: Mapping[str, tuple[Index, ...]]
    pattern: Pattern

    @classmethod
    def make(cls, blocks: Sequence[tuple[str, tuple[Index, ...]]], n_columns: int) -> RowBlocks:
        """Stack blocks in the order given; every block lists one column array per coefficient."""
        slices: dict[str, slice] = {}
        rows: list[Index] = []
        cols: list[Index] = []
        start = 0
        for name, columns in blocks:
            stop = start + columns[0].size
            slices[name] = slice(start, stop)
            rows += [np.arange(start, stop)] * len(columns)
            cols += columns
            start = stop
        pattern = Pattern(np.concatenate(rows), np.concatenate(cols), (start, n_columns))
        return cls(slices, dict(blocks), pattern)

    def assemble(
        self, values: Mapping[str, tuple[tuple[Array | float, ...], Array | float]]
    ) -> tuple[sparse.csc_array, Array]:
        """Return matrix and right-hand side from (coefficients, right-hand side) per block.

        Raises
        ------
        KeyError
            A block has no values: nothing is left out silently.
        """
        data, sides = np.empty(self.pattern.size), np.empty(self.pattern.shape[0])
        end = 0
        for name, columns in self.columns.items():
            coefficients, side = values[name]
            sides[self.slices[name]] = side
            for column, value in zip(columns, coefficients, strict=True):
                begin, end = end, end + column.size
                data[begin:end] = value
        return self.pattern.matrix(data), sides
