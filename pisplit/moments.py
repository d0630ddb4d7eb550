"""First and second moments of data that never need to be in memory at once, without squaring its condition number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONSTANT = 1e-13


@dataclass(frozen=True)
class Moments:
    """Mean (k,) and triangular factor R (r <= k, k) of N samples of k columns: R^T R = sum (a - mean)(a - mean)^T.

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
        """Rows (r, k) or (r + 1, k) that stand for the data in a regression, about the mean or about zero."""
        if centred:
            return self.factor
        return np.vstack([np.sqrt(self.n_samples) * self.mean, self.factor])

    def scaled(self, scale: Array) -> Moments:
        """Moments of the columns divided by ``scale`` (k,)."""
        return Moments(self.n_samples, self.mean / scale, self.factor / scale)


def accumulate(blocks: Iterable[Array]) -> Moments:
    """Moments of rows that arrive in blocks (N_i, k)."""
    triangle: Array | None = None
    n_samples = 0
    for block in blocks:
        n_samples += len(block)
        rows = np.hstack([np.ones((len(block), 1)), block])
        stacked = rows if triangle is None else np.vstack([triangle, rows])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    if triangle is None or n_samples == 0:
        raise ValueError("there are no samples to learn from; give at least one snapshot pair or phase sample")
    # The leading column of ones makes the first row the mean, and the rest the factor about it.
    mean = triangle[0, 1:] / triangle[0, 0]
    factor = triangle[1:, 1:].copy()
    constant = np.linalg.norm(factor, axis=0) <= CONSTANT * np.sqrt(n_samples) * np.abs(mean)
    factor[:, constant] = 0.0
    return Moments(n_samples=n_samples, mean=mean, factor=factor)
