"""Snapshot pairs with their history, and the directions in which inputs vary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EXCITED = 1e-6


@dataclass(frozen=True)
class Pairs:
    """N snapshot pairs with their history; arrays are gathered when asked for, so that only indices are stored.

    states (R, n) and inputs (R', m) are all rows of all episodes; ``row`` and ``input_row`` (N,) point at x_k and u_k.
    ``episode`` and ``index`` (N,) say which episode a pair is from, and its step k there.
    """

    states: Array
    inputs: Array
    row: Index
    input_row: Index
    episode: Index
    index: Index
    n_delays: int

    def __len__(self) -> int:
        return len(self.row)

    @property
    def x(self) -> Array:
        """x_k (N, n)."""
        return self.states[self.row]

    @property
    def x_next(self) -> Array:
        """x_{k+1} (N, n)."""
        return self.states[self.row + 1]

    @property
    def u(self) -> Array:
        """u_k (N, m)."""
        return self.inputs[self.input_row]

    @property
    def x_history(self) -> Array:
        """x_{k-D}..x_k (N, D+1, n), oldest first."""
        return self.states[self.row[:, None] + np.arange(-self.n_delays, 1)]

    @property
    def u_history(self) -> Array:
        """u_{k-D}..u_{k-1} (N, D, m), oldest first."""
        return self.inputs[self.input_row[:, None] + np.arange(-self.n_delays, 0)]

    def take(self, which: ArrayLike) -> Pairs:
        """The pairs at integer positions, in a slice-like index array or under a boolean mask."""
        chosen = np.arange(len(self))[np.asarray(which)]
        arrays = (self.row[chosen], self.input_row[chosen], self.episode[chosen], self.index[chosen])
        return Pairs(self.states, self.inputs, *arrays, n_delays=self.n_delays)

    def sample(self, n: int, seed: int) -> Pairs:
        """``n`` pairs drawn without replacement. Raises ValueError if there are fewer."""
        size = count(n, "n")
        if size > len(self):
            raise ValueError(f"n = {size} pairs asked for; the episodes hold {len(self)}")
        return self.take(np.sort(np.random.default_rng(seed).choice(len(self), size, replace=False)))

    def blocks(self, size: int = 4096) -> Iterator[Pairs]:
        """The pairs in order, at most ``size`` at a time."""
        for first in range(0, len(self), size):
            yield self.take(np.arange(first, min(first + size, len(self))))


def excited_directions(inputs: Array) -> tuple[Array, Array]:
    """Mean (m,) of inputs (N, m) and an orthonormal basis (m, r) of the directions in which they vary.

    A direction counts if its singular value exceeds 1e-6 of the largest.
    """
    offset = inputs.mean(axis=0)
    _, values, directions = np.linalg.svd(inputs - offset, full_matrices=False)
    rounding = np.finfo(float).eps * float(np.abs(inputs).max(initial=0.0)) * len(inputs)
    excited = values > max(EXCITED * float(values.max(initial=0.0)), rounding)
    return offset, directions[excited].T.copy()
