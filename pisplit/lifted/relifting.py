"""Products that a model evaluates anew at every step, from the state it has predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data.rows import frozen

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReliftedTerm:
    """g(z, u) = W q(v), products q of the variables v = F [z; u] + f: what re-lifting adds to a step of z.

    basis    F (V, M + m) and
    offset   f (V,) of the variables
    factors  (P, d) positions of the variables that are multiplied in each product; V stands for the factor 1
    weights  W (M, P)

    Arrays are copied, and read-only. Raises ValueError for shapes that do not fit each other.
    """

    basis: Array
    offset: Array
    factors: NDArray[np.int64]
    weights: Array

    def __post_init__(self) -> None:
        basis = finite_array(self.basis, "basis", (None, None))
        factors = np.array(self.factors, dtype=np.int64)
        if factors.ndim != 2 or (factors.size and not 0 <= factors.min() <= factors.max() <= len(basis)):
            raise ValueError(f"factors = {factors!r}; expected positions (P, d) from 0 to {len(basis)}")
        object.__setattr__(self, "basis", frozen(np.ascontiguousarray(basis)))
        object.__setattr__(self, "offset", frozen(finite_array(self.offset, "offset", (len(basis),))))
        object.__setattr__(self, "factors", frozen(factors))
        weights = finite_array(self.weights, "weights", (None, len(factors)))
        object.__setattr__(self, "weights", frozen(np.ascontiguousarray(weights)))

    def products(self, z: Array, u: Array) -> Array:
        """q (..., P) at lifted states z (..., M) under inputs u (..., m)."""
        return np.asarray(self._factors(z, u).prod(axis=-1))

    def __call__(self, z: Array, u: Array) -> Array:
        """g (..., M) at lifted states z (..., M) under inputs u (..., m)."""
        return np.asarray(self.products(z, u) @ self.weights.T)

    def jacobian(self, z: Array, u: Array) -> tuple[Array, Array]:
        """dg/dz (M, M) and dg/du (M, m) at one z (M,) and u (m,)."""
        values, count = self._factors(z, u), len(self.factors)
        by_variable = np.zeros((count, len(self.basis) + 1))
        for j in range(self.factors.shape[1]):
            by_variable[np.arange(count), self.factors[:, j]] += np.delete(values, j, axis=1).prod(axis=1)
        found = (self.weights @ by_variable[:, :-1]) @ self.basis
        return found[:, : len(z)], found[:, len(z) :]

    def _factors(self, z: Array, u: Array) -> Array:
        """The factors (..., P, d) of every product."""
        v = np.concatenate([z, u], axis=-1) @ self.basis.T + self.offset
        ones = np.ones((*v.shape[:-1], 1))
        return np.asarray(np.concatenate([v, ones], axis=-1)[..., self.factors])
