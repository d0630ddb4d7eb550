"""Products that a model evaluates anew at every step, from the state it has predicted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data.rows import frozen

Array = NDArray[np.float64]

#: Kinds of kinks: rounded hinges w log(1 + exp(s / w)), and gates 1 / (1 + exp(-s / w)).
HINGE, GATE = 0.0, 1.0
#: Largest exponent.
LARGEST = 50.0


@dataclass(frozen=True, eq=False)
class ReliftedTerm:
    """g(z, u) = W q(v), products q of variables v: what re-lifting adds to a step of z.

    basis    F (V, M + m) and
    offset   f (V,) of the linear variables F [z; u] + f
    factors  (P, d) positions of the variables that are multiplied in each product; behind the linear ones stand the
             kinks, and V + K for the factor 1
    weights  W (M, P)
    kinks    (K, M + m + 3): s = rows [z; u] + offset, the kind and the width w in the last two columns: softplus
             w log(1 + exp(s / w)) of kind 0, gates 1 / (1 + exp(-s / w)) of kind 1; none if not given

    Arrays are copied, and read-only. Raises ValueError for shapes that do not fit each other.
    """

    basis: Array
    offset: Array
    factors: NDArray[np.int64]
    weights: Array
    kinks: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        basis = finite_array(self.basis, "basis", (None, None))
        kinks = np.array(self.kinks, dtype=np.float64)
        if not kinks.size:
            kinks = np.zeros((0, basis.shape[1] + 3))
        kinks = finite_array(kinks, "kinks", (None, basis.shape[1] + 3))
        if len(kinks) and not (kinks[:, -1] > 0.0).all():
            raise ValueError("widths of kinks are not positive; the last column of kinks holds them")
        factors = np.array(self.factors, dtype=np.int64)
        total = len(basis) + len(kinks)
        if factors.ndim != 2 or (factors.size and not 0 <= factors.min() <= factors.max() <= total):
            raise ValueError(f"factors = {factors!r}; expected positions (P, d) from 0 to {total}")
        object.__setattr__(self, "basis", frozen(np.ascontiguousarray(basis)))
        object.__setattr__(self, "offset", frozen(finite_array(self.offset, "offset", (len(basis),))))
        object.__setattr__(self, "factors", frozen(factors))
        weights = finite_array(self.weights, "weights", (None, len(factors)))
        object.__setattr__(self, "weights", frozen(np.ascontiguousarray(weights)))
        object.__setattr__(self, "kinks", frozen(np.ascontiguousarray(kinks)))

    def products(self, z: Array, u: Array) -> Array:
        """q (..., P) at lifted states z (..., M) under inputs u (..., m)."""
        return np.asarray(self._factors(z, u).prod(axis=-1))

    def __call__(self, z: Array, u: Array) -> Array:
        """g (..., M) at lifted states z (..., M) under inputs u (..., m)."""
        return np.asarray(self.products(z, u) @ self.weights.T)

    def jacobian(self, z: Array, u: Array) -> tuple[Array, Array]:
        """dg/dz (M, M) and dg/du (M, m) at one z (M,) and u (m,)."""
        values, count, linear = self._factors(z, u), len(self.factors), len(self.basis)
        by_variable = np.zeros((count, linear + len(self.kinks) + 1))
        for j in range(self.factors.shape[1]):
            by_variable[np.arange(count), self.factors[:, j]] += np.delete(values, j, axis=1).prod(axis=1)
        by_variable = self.weights @ by_variable[:, :-1]
        found = by_variable[:, :linear] @ self.basis
        if len(self.kinks):
            gate, width = self._gates(np.concatenate([z, u])), self.kinks[:, -1]
            slope = np.where(self.kinks[:, -2] == HINGE, gate, gate * (1.0 - gate) / width)
            found = found + (by_variable[:, linear:] * slope) @ self.kinks[:, :-3]
        return found[:, : len(z)], found[:, len(z) :]

    def _gates(self, joined: Array) -> Array:
        """1 / (1 + exp(-s / w)) (..., K) of every kink at [z; u], ``joined`` (..., M + m)."""
        s = joined @ self.kinks[:, :-3].T + self.kinks[:, -3]
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(s / self.kinks[:, -1], -LARGEST, LARGEST))))

    def _kinks(self, joined: Array) -> Array:
        """Values (..., K) of the kinks at [z; u], ``joined`` (..., M + m)."""
        width = self.kinks[:, -1]
        s = joined @ self.kinks[:, :-3].T + self.kinks[:, -3]
        hinge = width * np.logaddexp(0.0, s / width)
        return np.asarray(np.where(self.kinks[:, -2] == HINGE, hinge, self._gates(joined)))

    def _factors(self, z: Array, u: Array) -> Array:
        """The factors (..., P, d) of every product."""
        joined = np.concatenate([z, u], axis=-1)
        parts = [joined @ self.basis.T + self.offset]
        if len(self.kinks):
            parts.append(self._kinks(joined))
        parts.append(np.ones((*joined.shape[:-1], 1)))
        return np.asarray(np.concatenate(parts, axis=-1)[..., self.factors])
