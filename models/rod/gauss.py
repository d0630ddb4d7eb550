"""Gauss-Legendre collocation on [0, L]: nodes, weights, integration and interpolation matrices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GaussRule:
    """``K`` Gauss-Legendre nodes on ``[0, length]``.

    A polynomial of degree ``K - 1`` is its values at the nodes. ``weights`` integrate it over ``[0, L]``;
    ``integration[k]`` integrates it from 0 to node k. Gauss nodes satisfy
    ``b_k (b_j - A_kj) = b_j A_jk``: integrating loads from the tip with ``b_j - A_kj`` is the exact
    adjoint of integrating motion from the base (Hairer, Lubich & Wanner, *Geometric Numerical
    Integration*, IV.2: the condition for a symplectic Runge-Kutta method).
    """

    length: float
    n_nodes: int

    @cached_property
    def nodes(self) -> Array:
        """Arclengths of the nodes (K,) in metres."""
        return 0.5 * self.length * (np.polynomial.legendre.leggauss(self.n_nodes)[0] + 1.0)

    @cached_property
    def weights(self) -> Array:
        """Quadrature weights b (K,) in metres."""
        return 0.5 * self.length * np.polynomial.legendre.leggauss(self.n_nodes)[1]

    @cached_property
    def integration(self) -> Array:
        """Matrix A (K, K): ``A @ g = int_0^{s_k} g ds`` at every node."""
        return self.integrate_to(self.nodes)

    def interpolate(self, s: ArrayLike) -> Array:
        """Rows of Lagrange weights (S, K): values at arclengths ``s`` from values at the nodes."""
        return self._legendre(s) @ self._to_legendre

    def integrate_to(self, s: ArrayLike) -> Array:
        """Rows (S, K): integrals from 0 to each arclength in ``s`` from values at the nodes."""
        x = 2.0 * np.atleast_1d(np.asarray(s, float)) / self.length - 1.0
        columns = []
        for degree in range(self.n_nodes):
            unit = np.zeros(degree + 1)
            unit[degree] = 1.0
            columns.append(np.polynomial.legendre.legval(x, np.polynomial.legendre.legint(unit, lbnd=-1.0)))
        return 0.5 * self.length * np.stack(columns, axis=1) @ self._to_legendre

    def _legendre(self, s: ArrayLike) -> Array:
        x = 2.0 * np.atleast_1d(np.asarray(s, float)) / self.length - 1.0
        return np.polynomial.legendre.legvander(x, self.n_nodes - 1).astype(np.float64)

    @cached_property
    def _to_legendre(self) -> Array:
        """Legendre coefficients (K, K) of the polynomial through node values: orthogonality on Gauss nodes."""
        x, b = np.polynomial.legendre.leggauss(self.n_nodes)
        degrees = np.arange(self.n_nodes)
        return (degrees + 0.5)[:, None] * np.polynomial.legendre.legvander(x, self.n_nodes - 1).T * b
