"""Newton corrections of a collocation step with the derivatives at one point of it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import Array

if TYPE_CHECKING:
    from pisplit.models.rod.dynamics.collocation import Collocation

#: Where in a step the derivatives are taken, on the motion with the rates of its start: of 0.5, 0.64 and 0.8 the last
#: converges fastest.
AT = 0.8
#: Strains left to correct, in parts of their nominal size, that are small enough.
ENOUGH = 5e-5


class SimplifiedNewton:
    """Corrections of the stage accelerations of ``collocation`` by simplified Newton iterations.

    With derivatives K, D, M (of strains, rates and accelerations) at one point of the step for all stages, the matrix

        I (x) M + h A (x) D + h^2 A^2 (x) K

    falls apart where A does: T^-1 A T is block diagonal, with a number for each real eigenvalue and a 2 x 2 block for
    each pair of complex ones. One derivative instead of s, and inverses of n and 2 n rows instead of one of s n.

    Scenes with Maxwell branches, whose overstress couples the stages in another way, take the whole matrix.

    Source: Hairer and Wanner, *Solving Ordinary Differential Equations II* (1996), section IV.8.
    """

    def __init__(self, collocation: Collocation) -> None:
        self.scheme = collocation
        self.whole = bool(collocation.equations.branches)

    @cached_property
    def _parts(self) -> tuple[Array, list[Array]]:
        """T (s, s), and the blocks of T^-1 A T on its diagonal."""
        values, vectors = np.linalg.eig(self.scheme.a)
        columns, blocks = [], []
        for value, vector in zip(values, vectors.T, strict=True):
            if abs(value.imag) < 1e-12:
                columns.append(vector.real)
                blocks.append(np.array([[value.real]]))
            elif value.imag > 0.0:
                columns += [vector.real, vector.imag]
                blocks.append(np.array([[value.real, value.imag], [-value.imag, value.real]]))
        return np.column_stack(columns), blocks

    def inverses(self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX) -> list[ca.MX]:
        """Inverse of every block.

        Args:
            x, u0, u1, h: as in ``Collocation.symbols``.
        """
        scheme, n = self.scheme, self.scheme.equations.n_strains
        if self.whole:
            return [scheme.inverse(x, u0, u1, h, ca.MX(n, scheme.stages))]
        ahead, u = x[:n] + AT * h * x[n : 2 * n], (1.0 - AT) * u0 + AT * u1
        slopes = scheme.residual.jacobian()(ahead, x[n : 2 * n], ca.DM(n, 1), u, ca.DM(n, 1))
        k, d, m = slopes[:3]
        found = []
        for a in self._parts[1]:
            size, twice = len(a), a @ a
            rows = [[h * a[i, j] * d + h * h * twice[i, j] * k for j in range(size)] for i in range(size)]
            for i in range(size):
                rows[i][i] = rows[i][i] + m
            found.append(ca.solve(ca.blockcat(rows), ca.DM.eye(size * n), "lapacklu"))
        return found

    def corrected(
        self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX, z: ca.MX, inverses: list[ca.MX]
    ) -> tuple[ca.MX, ca.MX]:
        """Accelerations (n, s) after one correction, and its size in strains.

        Args:
            x, u0, u1, h, z: as in ``Collocation.symbols``.
            inverses: of the blocks.
        """
        scheme = self.scheme
        missed = scheme.residual.map(scheme.stages)(*scheme.at_stages(x, z, (u0, u1), h))
        change = self.applied(inverses, missed)
        nominal = ca.DM(np.tile(scheme.equations.nominal_strains, (scheme.stages, 1)).T)
        return z - change, h**2 * ca.norm_fro(change / nominal)  # norm_inf of CasADi passes over NaN

    def converged(
        self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX, z: ca.MX, inverses: list[ca.MX], corrections: tuple[int, int]
    ) -> tuple[ca.MX, ca.MX]:
        """Accelerations (n, s) after as many corrections as they need, and the size of the last one in strains.

        What is left after a correction is about t / (1 - t) times its size, with t the last contraction, 0.1 at least
        (Hairer and Wanner, 1996, section IV.8): below ``ENOUGH`` there are no more.

        Args:
            x, u0, u1, h, z: as in ``Collocation.symbols``.
            inverses: of the blocks.
            corrections: at least and at most.
        """
        least, most = corrections
        last = size = ca.MX(np.inf)
        for _ in range(least):
            last, (z, size) = size, self.corrected(x, u0, u1, h, z, inverses)
        given = [x, u0, u1, h, z, last, size, *inverses]
        symbols = [ca.MX.sym(f"i{k}", *value.shape) for k, value in enumerate(given)]
        y, before, after, step, guess, _, latest, *by = symbols
        found, next_size = self.corrected(y, before, after, step, guess, by)
        again = ca.Function("again", symbols, [found, latest, next_size])
        enough = ca.Function("enough", symbols, symbols[4:7])
        correct = ca.Function.if_else("correct", again, enough)
        for _ in range(most - least):
            rate = ca.fmax(size / last, 0.1)
            left = ca.if_else(rate < 1.0, size * rate / (1.0 - rate), np.inf)
            z, last, size = correct(1 - (left <= ENOUGH), x, u0, u1, h, z, last, size, *inverses)
        return z, size

    def applied(self, inverses: list[ca.MX], values: ca.MX) -> ca.MX:
        """The inverse of the whole matrix times ``values`` (n, s), by ``inverses`` of its blocks."""
        if self.whole:
            return ca.reshape(inverses[0] @ ca.vec(values), *values.shape)
        t, n = self._parts[0], values.shape[0]
        turned = values @ ca.DM(np.linalg.inv(t).T)
        parts, first = [], 0
        for inverse in inverses:
            size = inverse.shape[0] // n
            parts.append(ca.reshape(inverse @ ca.vec(turned[:, first : first + size]), n, size))
            first += size
        return ca.horzcat(*parts) @ ca.DM(t.T)
