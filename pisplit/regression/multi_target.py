"""What all multi-target regressions share: their result, the prior, and the entries that are free to differ from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Regression:
    """K (S, M); the numerical rank of the data (None for LASSO); for LASSO the duality gap of every target.

    gaps  (S,) duality gaps relative to the objective |A k - y|^2 + alpha |k - prior|_1 (at least 1e-8 |y|^2), or None
    gap   the largest of them, or None
    """

    K: Array
    rank: int | None = None
    gaps: Array | None = None

    @property
    def gap(self) -> float | None:
        """Largest relative duality gap of all targets, None for regressions in closed form."""
        return None if self.gaps is None else float(self.gaps.max(initial=0.0))


def prior_or_zero(a: Array, y: Array, prior: Array | None) -> Array:
    """The prior (S, M) of a regression of ``y`` (N, S) on ``a`` (N, M); zero if none is given."""
    shape = (y.shape[1], a.shape[1])
    if prior is None:
        return np.zeros(shape)
    if prior.shape != shape:
        raise ValueError(f"prior has shape {prior.shape}; expected {shape}, one row a target")
    return np.asarray(prior, dtype=np.float64)


def free_entries(prior: Array, free: Mask | None) -> Mask:
    """The mask (S, M) of the entries that may differ from the ``prior``: ``free``, or all of them if none is given."""
    if free is None:
        return np.ones(prior.shape, dtype=bool)
    if free.shape != prior.shape:
        raise ValueError(f"free has shape {free.shape}; expected {prior.shape}, one row a target")
    return np.asarray(free, dtype=bool)


def patterns(prior: Array, free: Mask | None) -> Iterator[tuple[Index, Index]]:
    """Targets that share their ``free`` entries of the ``prior``, and these entries: each group is one regression."""
    mask = free_entries(prior, free)
    if mask.all() and mask.size:
        yield np.arange(len(mask)), np.arange(mask.shape[1])
        return
    found, which = np.unique(mask, axis=0, return_inverse=True)
    for i, pattern in enumerate(found):
        if pattern.any():
            yield np.flatnonzero(which.reshape(-1) == i), np.flatnonzero(pattern)
