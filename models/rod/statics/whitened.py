"""The static balance in whitened strains, in which the elastic energy is |y|^2 / 2, and ways to load it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.base import joint_stiffness

if TYPE_CHECKING:
    from pisplit.models.rod.statics.search import Search

#: A way from 0 to 1: ``(y, t) -> `` force g (n,), stiffness H = -dg/dy (n, n), and dg/dt (n,).
Way = Callable[[Array, float], tuple[Array, Array, Array]]


class Whitened(Rebuilt):
    """Balance g(y) = f(y) - y of the strains y = sqrt(b k L / EI) (xi - xi*), with f what the loads ask for.

    b are the weights of the nodes, k the stiffness of each strain; joint coordinates at the base are in rad and parts
    of L. With the load factor t the balance is t f(y) - y and
    its stiffness I - t F, F = df/dy: one evaluation under the whole load serves every load factor. For loads with an
    energy g is minus its gradient, in parts of EI/L.

    Args:
        search: the scaled balance.
    """

    def __init__(self, search: Search) -> None:
        self.search = search

    @cached_property
    def sizes(self) -> tuple[Array, Array, Array]:
        """Factors from scaled unknowns to y, from scaled residuals to g, and of the Jacobian."""
        scene = self.search.scene
        rod, rule = scene.rod, scene.rule
        stiffness = rod.profile(rule.nodes).stiffness[list(rod.strain_set.free)].T.ravel()
        stiffness = np.append(stiffness, joint_stiffness(rod, scene.terms))
        weights = scene.weights
        unit = np.sqrt(min(rod.stiffness[:2]) / rod.length)
        of_x = np.sqrt(weights * stiffness) * scene.nominal_strains / unit
        of_residual = np.sqrt(weights / stiffness) * scene.nominal_residual / unit
        return of_x, of_residual, of_residual[:, None] / of_x

    @cached_property
    def identity(self) -> Array:
        """Elastic stiffness."""
        return np.eye(self.search.scene.n_strains)

    def of(self, x: Array) -> Array:
        """y (n,) of scaled unknowns ``x`` (n,)."""
        y: Array = self.sizes[0] * x
        return y

    def unknowns(self, y: Array) -> Array:
        """Scaled unknowns (n,) of ``y`` (n,)."""
        x: Array = y / self.sizes[0]
        return x

    @cached_property
    def _balance(self) -> ca.Function:
        """``(x, u) -> residual, dr/dx``."""
        (x, u), (residual,) = self.search.loaded
        return ca.Function("balance", [x, u], [residual, ca.densify(self.search.blocks[0])])

    @cached_property
    def _buffered(self) -> tuple[Any, Array, Array, Array, Array]:
        """The balance as a call without arguments, and the arrays that it reads (x, u) and writes (r, dr/dx)."""
        function = self._balance
        n = function.size1_in(0)
        arrays = np.zeros(n), np.zeros(function.size1_in(1)), np.zeros(n), np.zeros(n * n)
        buffer: Any
        buffer, call = function.buffer()
        for i, array in enumerate(arrays[:2]):
            buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(arrays[2:]):
            buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]
        return (buffer, call), *arrays

    def demand(self, y: Array, u: Array) -> tuple[Array, Array]:
        """f (n,) and F (n, n) at ``y`` (n,) under inputs ``u`` (n_inputs,)."""
        of_x, of_residual, of_slopes = self.sizes
        (_, call), x, inputs, residual, slopes = self._buffered
        np.divide(y, of_x, out=x)
        inputs[:] = u
        call()
        return of_residual * residual + y, of_slopes * slopes.reshape(len(x), -1).T + self.identity

    def input_slopes(self, y: Array, u: Array) -> Array:
        """df/du (n, n_inputs) of ``y`` (n,) under inputs ``u`` (n_inputs,)."""
        slopes: Array = self.sizes[1][:, None] * np.asarray(self.search.slopes(y / self.sizes[0], u)[1])
        return slopes

    def stiffness(self, y: Array, u: Array) -> Array:
        """H = I - F (n, n) of ``y`` (n,) under inputs ``u`` (n_inputs,)."""
        return np.asarray(self.identity - self.demand(y, u)[1])

    # Ways ------------------------------------------------------------------------------------------------------------

    def loading(self, u: Array, start: float = 0.0, end: float = 1.0) -> Way:
        """All loads in proportion, under inputs ``u`` (n_inputs,): load factors from ``start`` to ``end``."""

        def way(y: Array, t: float) -> tuple[Array, Array, Array]:
            f, slopes = self.demand(y, u)
            factor = start + t * (end - start)
            return factor * f - y, self.identity - factor * slopes, (end - start) * f

        return way

    def commands(self, before: Array, after: Array) -> Way:
        """Loads stay, the inputs go from ``before`` to ``after`` (n_inputs,)."""
        change = after - before

        def way(y: Array, t: float) -> tuple[Array, Array, Array]:
            u = before + t * change
            f, slopes = self.demand(y, u)
            return f - y, self.identity - slopes, self.input_slopes(y, u) @ change

        return way
