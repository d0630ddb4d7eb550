"""Products with matrices of a lifted model whose delay rows only shift entries: a step costs the dense rows alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pisplit.checks import finite_array

Array = NDArray[np.float64]

#: Below this size the plain product is as fast.
SMALL = 64
#: Rows with a larger share of non-zero entries count as dense.
DENSE_SHARE = 0.1


class Transition:
    """z -> A z for a square A (M, M), split into dense rows, rows that copy one entry of z, and other sparse rows."""

    def __init__(self, A: Array) -> None:
        self.matrix = finite_array(A, "A", (None, None))
        size = len(self.matrix)
        if self.matrix.shape != (size, size):
            raise ValueError(f"A has shape {self.matrix.shape}; expected a square matrix")
        filled = np.count_nonzero(self.matrix, axis=1)
        self.structured = size > SMALL and bool((filled <= DENSE_SHARE * size).any())
        if not self.structured:
            return
        dense = filled > DENSE_SHARE * size
        column = np.argmax(self.matrix != 0.0, axis=1)
        copies = (filled == 1) & (self.matrix[np.arange(size), column] == 1.0) & ~dense
        self._dense_rows = np.flatnonzero(dense)
        self._dense = np.ascontiguousarray(self.matrix[dense])
        self._copy_rows, self._copied = np.flatnonzero(copies), column[copies]
        self._other_rows = np.flatnonzero(~dense & ~copies & (filled > 0))
        self._other = sparse.csr_array(self.matrix[self._other_rows])
        self._spans = tuple(map(span, (self._dense_rows, self._copy_rows, self._copied)))

    def __call__(self, z: Array) -> Array:
        """A z for z (M,), or for every column of z (M, E)."""
        if not self.structured:
            return np.asarray(self.matrix @ z)
        product = np.zeros_like(z)
        product[self._dense_rows] = self._dense @ z
        product[self._copy_rows] = z[self._copied]
        if len(self._other_rows):
            product[self._other_rows] = self._other @ z
        return product

    def add(self, z: Array, result: Array) -> None:
        """Add A z to ``result`` in place, for every row of z (E, M)."""
        if not self.structured:
            result += z @ self.matrix.T
            return
        dense, copies, copied = self._spans
        result[:, dense] += z @ self._dense.T
        result[:, copies] += z[:, copied]
        if len(self._other_rows):
            result[:, self._other_rows] += (self._other @ z.T).T


def span(positions: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """A slice, which is a view, where positions follow each other; delays are laid out so."""
    if len(positions) and (np.diff(positions) == 1).all():
        return slice(int(positions[0]), int(positions[-1]) + 1)
    return positions


def runs(positions: NDArray[np.int64]) -> list[slice]:
    """Increasing positions as slices of those that follow each other."""
    if not len(positions):
        return []
    parts = np.split(positions, np.flatnonzero(np.diff(positions) != 1) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


class BilinearTerm:
    """sum_i u_i N_i z for N (m, M, M); rows and columns that are zero for every input cost nothing.

    ``rows`` (R,) are the entries of z+ that the term changes.
    """

    def __init__(self, N: Array) -> None:
        self.inputs = len(N)
        self.rows = np.flatnonzero(N.any(axis=(0, 2)))
        self.columns = np.flatnonzero(N.any(axis=(0, 1)))
        size = self.inputs * len(self.rows)
        self._stack = np.ascontiguousarray(N[:, self.rows][:, :, self.columns].reshape(size, len(self.columns)))

    def __call__(self, z: Array, u: Array) -> Array:
        """The term (..., R) on ``rows`` for lifted states z (..., M) under inputs u (..., m)."""
        products = (z[..., self.columns] @ self._stack.T).reshape(*z.shape[:-1], self.inputs, len(self.rows))
        return np.asarray((u[..., None, :] @ products)[..., 0, :])

    def matrix(self, u: Array) -> Array:
        """sum_i u_i N_i (R, columns) on ``rows`` and ``columns`` for one input u (m,)."""
        blocks = self._stack.reshape(self.inputs, len(self.rows), len(self.columns))
        return np.asarray(np.tensordot(u, blocks, axes=1))

    def slopes(self, z: Array) -> Array:
        """Derivative (R, m) of the term by u at one lifted state z (M,)."""
        return np.asarray((self._stack @ z[self.columns]).reshape(self.inputs, len(self.rows)).T)
