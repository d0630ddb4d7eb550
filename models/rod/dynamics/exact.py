"""Collocation for scenes whose derivatives are wanted too: the iteration matrix is that of the exact derivatives."""

from __future__ import annotations

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
        *symbols, balance = self.equations.dynamic_balance
        scaled = balance.residual / ca.DM(self.equations.nominal_residual)
        return ca.Function("residual", symbols, [scaled])

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
