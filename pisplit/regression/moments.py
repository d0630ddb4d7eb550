"""First and second moments of data that never need to be in memory at once, without squaring its condition number."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from pisplit.threads import one_blas_thread

Array = NDArray[np.float64]

CONSTANT = 1e-13
#: Columns that one block reflector of the QR factorisation eliminates: fastest of 16 to 128 at 723 columns.
REFLECTOR = 32
#: Rows that are rotated into the triangle at once.
BLOCK = 1024
#: Bytes of a block of samples: what evaluates and stacks them holds a few times as much.
BLOCK_BYTES = 8_000_000


@dataclass(frozen=True)
class Moments:
    """Mean (k,) and triangular factor R (r <= k, k) of n_samples of k columns: R^T R = sum (a - mean)(a - mean)^T.

    Regressions on R give the same answer as on the centred data. R comes from orthogonal transformations, so the
    condition number is that of the data, where a Gram matrix would have its square.
    """

    n_samples: int
    mean: Array
    factor: Array

    @property
    def std(self) -> Array:
        """Standard deviation (k,) of every column about its mean."""
        return np.sqrt((self.factor**2).sum(axis=0) / self.n_samples)

    def rows(self, centred: bool) -> Array:
        """Rows (r, k) or (r + 1, k) that stand for the data in a regression, about the mean if ``centred``, or zero."""
        if centred:
            return self.factor
        return np.vstack([np.sqrt(self.n_samples) * self.mean, self.factor])

    def scaled(self, scale: Array) -> Moments:
        """Moments of the columns divided by ``scale`` (k,)."""
        return Moments(self.n_samples, self.mean / scale, self.factor / scale)


@one_blas_thread()
def accumulate(blocks: Iterable[Array]) -> Moments:
    """Moments of rows that arrive in blocks (N_i, k).

    Every block is rotated into the triangle of those before it, so that memory holds one block and one triangle.
    Raises ValueError if there are no rows and for entries that are not finite.
    """
    n_samples = 0

    def parts() -> Iterator[Array]:
        nonlocal n_samples
        for block in blocks:
            n_samples += len(block)
            for first in range(0, len(block), BLOCK):
                part = block[first : first + BLOCK]
                rows = np.ones((len(part), part.shape[1] + 1), order="F")
                rows[:, 1:] = part
                yield rows

    triangle = _triangle(parts())
    if triangle is None or n_samples == 0:
        raise ValueError("there are no samples to learn from; give at least one snapshot pair or phase sample")
    return _moments(triangle, n_samples)


@one_blas_thread()
def joined(parts: Sequence[Moments]) -> Moments:
    """Moments of all samples of ``parts``, at least one, of the same columns: no sample is looked at again."""

    def rows(part: Moments) -> Array:
        found = np.zeros((len(part.factor) + 1, len(part.mean) + 1), order="F")
        found[0, 0] = np.sqrt(part.n_samples)
        found[0, 1:] = np.sqrt(part.n_samples) * part.mean
        found[1:, 1:] = part.factor
        return found

    triangle = _triangle(map(rows, parts))
    assert triangle is not None
    return _moments(triangle, sum(part.n_samples for part in parts))


def _moments(triangle: Array, n_samples: int) -> Moments:
    """The moments that the triangle of [1 | columns] holds."""
    bad = np.flatnonzero(~np.isfinite(triangle[:, 1:].sum(axis=0)))
    if len(bad):
        raise ValueError(f"column {bad[0] + 1} of {len(triangle) - 1} has NaN or infinite entries, or overflows")
    # The leading column of ones makes the first row the mean, and the rest the factor about it.
    mean = triangle[0, 1:] / triangle[0, 0]
    factor = np.array(triangle[1:, 1:], order="C")
    spread = np.sqrt((factor**2).sum(axis=0))
    factor[:, spread <= CONSTANT * np.sqrt(n_samples) * np.abs(mean)] = 0.0
    return Moments(n_samples=n_samples, mean=mean, factor=factor)


def block_rows(columns: int) -> int:
    """Rows of a block of samples of so many columns that keeps memory small, at most 4096."""
    return int(np.clip(BLOCK_BYTES // (8 * max(columns, 1)), 256, 4096))


@one_blas_thread()
def triangular_factor(rows: Array) -> Array:
    """R (min(N, k), k) with R^T R = rows^T rows for rows (N, k), by orthogonal transformations."""
    starts = range(0, len(rows), BLOCK)
    triangle = _triangle(np.array(rows[first : first + BLOCK], dtype=np.float64, order="F") for first in starts)
    return np.zeros((0, rows.shape[1])) if triangle is None else np.ascontiguousarray(triangle)


@one_blas_thread()
def stacked(upper: tuple[Array, Array], rows: tuple[Array, Array]) -> tuple[Array, Array]:
    """Triangle R (k, k) and targets Q^T Y (k, r) of the regression [R1; A] X = [Y1; Y2].

    ``upper`` is (R1, Y1) with a triangle R1 (k, k), ``rows`` (A, Y2) with A (N, k); zeros below the diagonal of a
    triangle A cost nothing.
    """
    (a, y), (b, z) = upper, rows
    if len(a) == 0 or len(b) == 0:
        return a, y
    corner = len(b) if b.shape == a.shape and not np.tril(b, -1).any() else 0
    below = np.array(b, order="F")
    found, v, t, _ = lapack.dtpqrt(corner, min(REFLECTOR, len(a)), np.array(a, order="F"), below, overwrite_a=1)
    above, _, _ = lapack.dtpmqrt(corner, v, t, np.array(y, order="F"), np.array(z, order="F"), side="L", trans="T")
    return np.asarray(found), np.asarray(above)


def _triangle(parts: Iterable[Array]) -> Array | None:
    """Triangle of the rows of all ``parts`` (overwritten), a trapezoid of fewer rows than columns; None of no part.

    Rows wait until there are as many as columns: a triangle that grows would be factorised again and again.
    """
    triangle: Array | None = None
    waiting: list[Array] = []
    for rows in parts:
        if triangle is not None:
            triangle = _rotated(triangle, rows)
            continue
        waiting.append(rows)
        if sum(map(len, waiting)) >= rows.shape[1]:
            triangle = _stacked(waiting)
            waiting.clear()
    return _stacked(waiting) if triangle is None and waiting else triangle


def _stacked(parts: list[Array]) -> Array:
    """Triangle (min(N, k), k) of the rows of ``parts``."""
    stacked = np.vstack(parts)
    first = np.linalg.qr(stacked[: stacked.shape[1]], mode="r")
    return _rotated(np.asfortranarray(first), np.asfortranarray(stacked[stacked.shape[1] :]))


def _rotated(triangle: Array, rows: Array) -> Array:
    """Triangle (k, k) of the QR factorisation of [triangle; rows].

    Both are overwritten; in Fortran order nothing is copied. What is below the diagonal stays zero.
    """
    size = rows.shape[1]
    if len(rows) == 0 or size == 0:
        return triangle
    result, _, _, _ = lapack.dtpqrt(0, min(REFLECTOR, size), triangle, rows, overwrite_a=1, overwrite_b=1)
    return np.asarray(result)
