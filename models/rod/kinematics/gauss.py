"""Gauss-Legendre collocation on [0, L], in one element or several: nodes, weights, integration, interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
#: Nodes of an element from which on frames take two steps from one to the next.
HALVED = 12


def _kept(array: Array) -> Array:
    """The array itself, which nobody can write to: it is kept and handed out again."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class GaussRule:
    """``K`` Gauss-Legendre nodes on ``[0, length]``.

    A polynomial of degree ``K - 1`` is its values at the nodes. ``weights`` integrate it over ``[0, L]``;
    ``integration[k]`` integrates it from 0 to node k. Gauss nodes satisfy
    ``b_k (b_j - A_kj) = b_j A_jk``: integrating loads from the tip with ``b_j - A_kj`` is the exact
    adjoint of integrating motion from the base (Hairer, Lubich & Wanner, *Geometric Numerical
    Integration*, IV.2: the condition for a symplectic Runge-Kutta method).

    ``n_nodes`` is K.
    """

    length: float
    n_nodes: int

    @cached_property
    def nodes(self) -> Array:
        """Arclengths of the nodes (K,) in metres."""
        return _kept(0.5 * self.length * (np.polynomial.legendre.leggauss(self.n_nodes)[0] + 1.0))

    @property
    def borders(self) -> tuple[float, ...]:
        """Ends of the elements: 0 and L."""
        return (0.0, self.length)

    @property
    def step_ends(self) -> tuple[float, ...]:
        """Arclengths from which frames step on: the base, the nodes, and from ``HALVED`` of these on what is between.

        Strains of so many nodes are exacter than frames by steps of sixth order from node to node.
        """
        ends = np.append(0.0, self.nodes)
        between = 0.5 * (ends[1:] + ends[:-1]) if self.n_nodes >= HALVED else ends[:0]
        return tuple(np.sort(np.append(ends, between)).tolist())

    def nodes_around(self, s: float) -> int:
        """Number of nodes of the element that an arclength ``s`` in m lies in."""
        return self.n_nodes

    @cached_property
    def weights(self) -> Array:
        """Quadrature weights b (K,) in metres."""
        return _kept(0.5 * self.length * np.polynomial.legendre.leggauss(self.n_nodes)[1])

    @cached_property
    def integration(self) -> Array:
        """Matrix A (K, K): ``A @ g = int_0^{s_k} g ds`` at every node."""
        return _kept(self.integrate_to(self.nodes))

    def interpolate(self, s: ArrayLike) -> Array:
        """Rows of Lagrange weights (S, K): values at arclengths ``s`` from values at the nodes."""
        return self._legendre(s) @ self._to_legendre

    def integrate_to(self, s: ArrayLike) -> Array:
        """Rows (S, K): integrals from 0 to each arclength in ``s`` from values at the nodes."""
        x = 2.0 * np.atleast_1d(np.asarray(s, float)) / self.length - 1.0
        values = np.polynomial.legendre.legvander(x, self.n_nodes)
        # int_-1^x P_n = (P_n+1 - P_n-1) / (2 n + 1), with -1 for P_-1
        below = np.hstack([np.full((len(x), 1), -1.0), values[:, : self.n_nodes - 1]])
        integrals = (values[:, 1:] - below) / (2.0 * np.arange(self.n_nodes) + 1.0)
        return np.asarray(0.5 * self.length * integrals @ self._to_legendre)

    @cached_property
    def differentiation(self) -> Array:
        """Matrix D (K, K): ``D @ g`` is dg/ds at every node."""
        x = 2.0 * self.nodes / self.length - 1.0
        units = np.eye(self.n_nodes)
        slopes = [np.polynomial.legendre.legval(x, np.polynomial.legendre.legder(unit)) for unit in units]
        return _kept(2.0 / self.length * np.stack(slopes, axis=1) @ self._to_legendre)

    def _legendre(self, s: ArrayLike) -> Array:
        x = 2.0 * np.atleast_1d(np.asarray(s, float)) / self.length - 1.0
        return np.polynomial.legendre.legvander(x, self.n_nodes - 1).astype(np.float64)

    @cached_property
    def _to_legendre(self) -> Array:
        """Legendre coefficients (K, K) of the polynomial through node values: orthogonality on Gauss nodes."""
        x, b = np.polynomial.legendre.leggauss(self.n_nodes)
        degrees = np.arange(self.n_nodes)
        return (degrees + 0.5)[:, None] * np.polynomial.legendre.legvander(x, self.n_nodes - 1).T * b


@dataclass(frozen=True)
class CompositeRule:
    """Gauss-Legendre nodes on several elements in a row: strains are smooth within each and may jump between them.

    Offers what ``GaussRule`` offers. Integrals from the base run over whole elements and the part of the last one, so
    the matrices are block triangular and the adjoint identity ``b_k (b_j - A_kj) = b_j A_jk`` holds across borders.
    """

    elements: tuple[GaussRule, ...]

    @property
    def length(self) -> float:
        """Length of all elements in metres."""
        return self.borders[-1]

    @property
    def n_nodes(self) -> int:
        """Number of nodes K of all elements."""
        return sum(element.n_nodes for element in self.elements)

    @cached_property
    def borders(self) -> tuple[float, ...]:
        """Arclengths of the ends of the elements, from 0 to L."""
        return (0.0, *np.cumsum([element.length for element in self.elements]).tolist())

    @cached_property
    def nodes(self) -> Array:
        """Arclengths of the nodes (K,) in metres."""
        return _kept(np.concatenate([start + e.nodes for start, e in zip(self.borders, self.elements, strict=False)]))

    @property
    def step_ends(self) -> tuple[float, ...]:
        """Arclengths from which frames step on: those of all elements."""
        return tuple(start + s for start, e in zip(self.borders, self.elements, strict=False) for s in e.step_ends)

    def nodes_around(self, s: float) -> int:
        """Number of nodes of the element that an arclength ``s`` in m lies in."""
        return self.elements[int(np.searchsorted(self.borders[1:-1], s, side="left"))].n_nodes

    @cached_property
    def weights(self) -> Array:
        """Quadrature weights b (K,) in metres."""
        return _kept(np.concatenate([element.weights for element in self.elements]))

    @cached_property
    def integration(self) -> Array:
        """Matrix A (K, K): ``A @ g = int_0^{s_k} g ds`` at every node."""
        return _kept(self.integrate_to(self.nodes))

    @cached_property
    def differentiation(self) -> Array:
        """Matrix D (K, K): dg/ds at every node, within each element."""
        matrix = np.zeros((self.n_nodes, self.n_nodes))
        for columns, element in zip(self._columns, self.elements, strict=True):
            matrix[columns, columns] = element.differentiation
        return _kept(matrix)

    def interpolate(self, s: ArrayLike) -> Array:
        """Rows of Lagrange weights (S, K); a border takes the values of the element before it.

        ``s`` (S,) are arclengths in m.
        """
        points = np.atleast_1d(np.asarray(s, float))
        rows = np.zeros((len(points), self.n_nodes))
        owner = np.searchsorted(self.borders[1:-1], points, side="left")
        for k, (columns, element) in enumerate(zip(self._columns, self.elements, strict=True)):
            rows[owner == k, columns] = element.interpolate(points[owner == k] - self.borders[k])
        return rows

    def integrate_to(self, s: ArrayLike) -> Array:
        """Rows (S, K): integrals from 0 to each arclength in ``s`` from values at the nodes."""
        points = np.atleast_1d(np.asarray(s, float))
        rows = np.zeros((len(points), self.n_nodes))
        for k, (columns, element) in enumerate(zip(self._columns, self.elements, strict=True)):
            past = points >= self.borders[k + 1]
            within = (points > self.borders[k]) & ~past
            rows[past, columns] = element.weights
            rows[within, columns] = element.integrate_to(points[within] - self.borders[k])
        return rows

    @cached_property
    def _columns(self) -> list[slice]:
        ends = np.cumsum([0, *(element.n_nodes for element in self.elements)]).tolist()
        return [slice(a, b) for a, b in pairwise(ends)]


#: Either rule; a rod of one element has the simple one.
Rule = GaussRule | CompositeRule
