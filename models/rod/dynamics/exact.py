"""Collocation for scenes whose derivatives are wanted too: the iteration matrix is that of the exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.dynamics.collocation import ITERATIONS, Collocation


class ExactCollocation(Collocation):
    """Collocation without a simplified Jacobian: where derivatives of the motion are asked for anyway, a scene with
    many inputs or terms pays for one of the two graphs alone, which may take longer to build than to use.

    Arguments as in ``Collocation``; scenes without Maxwell branches.
    """

    @cached_property
    def residual(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> residual`` in parts of ``nominal_residual``, without its Jacobian."""
        return ca.Function("residual", *self._scaled)

    @cached_property
    def derivatives(self) -> ca.Function:
        """As in ``Collocation``; common subexpressions of the residual are differentiated once.

        Those of chords between disks are a third of it, and nearly half of the time of its derivatives.
        """
        if self.equations.dynamic_balance[-1].reaction is not None:
            return super().derivatives
        symbols, (scaled,) = self._scaled
        blocks = [ca.densify(block) for block in together(scaled, symbols)]
        return ca.Function("derivatives", symbols, blocks).map(self.stages)

    @cached_property
    def _scaled(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Symbols (xi, xi_t, xi_tt, u) and the scaled residual."""
        *symbols, balance = self.equations.dynamic_balance
        return symbols, [ca.cse(balance.residual / ca.DM(self.equations.nominal_residual))]

    def slopes(self, x: Array, z: Array, u: tuple[Array, Array], h: float) -> tuple[list[list[Array]], Array]:
        """Derivatives of the residual at the stages and the inverse (s n, s n) of the matrix they make.

        Args:
            x: [xi, xi_t] (2n,) at the start of a step.
            z: accelerations (n, s) at its stages.
            u: inputs (m,) at its ends.
            h: its length in s.

        Raises ``numpy.linalg.LinAlgError`` where that is singular.
        """
        found = self.derivatives(*self.at_stages(x, z, u, h))
        blocks = [np.split(np.asarray(block), self.stages, axis=1) for block in found]
        matrix = self.iteration_matrix([*blocks[:3], []], h)
        return blocks, np.asarray(np.linalg.inv(matrix), dtype=np.float64)

    def newton(self, x: Array, u0: Array, u1: Array, h: float, z: Array) -> tuple[Array, float, float, Array]:  # type: ignore[override]
        """``z``, last two corrections, inverse matrix: iterations with a new matrix, as those of ``Collocation``.

        ``x``, ``u0``, ``u1``, ``h`` and ``z`` as in ``slopes``. Raises RuntimeError where the matrix is singular.
        """
        try:
            _, inverse = self.slopes(x, z, (u0, u1), h)
        except np.linalg.LinAlgError as error:
            raise RuntimeError(str(error)) from None
        sizes, found = [np.inf], z
        for _ in range(ITERATIONS):
            after: Any
            after, size = self.iteration(x, u0, u1, h, found, inverse)
            found = np.asarray(after, dtype=np.float64)
            sizes.append(float(size))
        return found, sizes[-2], sizes[-1], inverse


def together(residual: ca.SX, symbols: Sequence[ca.SX]) -> list[ca.SX]:
    """Derivatives of a ``residual`` with respect to ``symbols``, in one sweep: they share up to half of the work."""
    whole = ca.jacobian(residual, ca.vertcat(*map(ca.vec, symbols)))
    return list(ca.horzsplit(whole, np.cumsum([0, *(symbol.numel() for symbol in symbols)]).tolist()))
