"""One internal step by Gauss collocation: the functions of a scene that it takes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.analysis.energy import powers
from pisplit.models.rod.dynamics.overstress import Overstress
from pisplit.models.rod.equations.held import slopes
from pisplit.models.rod.kinematics.gauss import GaussRule
from pisplit.models.rod.sharing import Rebuilt

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Newton iterations with one matrix before their convergence is looked at.
ITERATIONS = 3


class Collocation(Rebuilt):
    """Gauss collocation of the equations of a scene (Hairer, Lubich & Wanner, *Geometric Numerical Integration*, 2006).

    The unknowns of a step h are the accelerations z_i at s stages; strains and rates are their integrals:

        v_i = xi_t + h sum_j a_ij z_j,   x_i = xi + h c_i xi_t + h^2 sum_j (A A)_ij z_j

    and the end of the step has the weights b in place of the rows of A. Inputs move linearly over the step. The
    overstress of Maxwell branches follows from the accelerations: see ``Overstress``.

    Args:
        equations: the scene whose balance (paper, eq. cosserat_rod_eq) holds at the stages.
        stages: number s of stages.
        family: "gauss", of order 2 s, which keeps the energy of undamped rods; or "radau" (Radau IIA, order 2 s - 1),
            whose last stage is the end of the step and which damps what is too fast for it (Hairer & Wanner, *Solving
            Ordinary Differential Equations II*, 1996, section IV.5).
        shared: whether common subexpressions are computed once: see ``motion_residual``.
    """

    def __init__(self, equations: Scene, stages: int, family: str = "gauss", shared: bool = False) -> None:
        self.equations, self.stages, self.family, self.shared = equations, stages, family, shared
        if family == "gauss":
            rule = GaussRule(1.0, stages)
            self.c, self.b, self.a = rule.nodes, rule.weights, rule.integration
        else:
            self.c, self.a = radau(stages)
            self.b = self.a[-1]
        self.overstress = Overstress(equations, self.a, self.b)

    # Functions of the equations --------------------------------------------------------------------------------------

    @cached_property
    def newton(self) -> ca.Function:
        """``(x, u0, u1, h, z) -> z, last two corrections, inverse matrix``: iterations with a new matrix."""
        x, u0, u1, h, z = self.symbols
        inverse = self.inverse(x, u0, u1, h, z)
        sizes = [ca.MX(np.inf)]
        for _ in range(ITERATIONS):
            z, size = self.corrected(x, u0, u1, h, z, inverse)
            sizes.append(size)
        return ca.Function("newton", list(self.symbols), [z, *sizes[-2:], inverse])

    @cached_property
    def residual(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> residual`` in parts of ``nominal_residual``."""
        scene = self.equations
        return scene.native(scene.shared_motion_residual if self.shared else scene.motion_residual)

    def inverse(self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX, z: ca.MX) -> ca.MX:
        """Inverse (s n, s n) of the iteration matrix at ``x``, ``u0``, ``u1``, ``h``, ``z``: see ``symbols``."""
        n, s = self.equations.n_strains, self.stages
        blocks = self.residual.jacobian().map(s)(*self.at_stages(x, z, (u0, u1), h), ca.DM(n, s))
        stages = [ca.horzsplit(block, n) for block in blocks[:3]]
        acting = ca.horzsplit(blocks[3], self.equations.layout.n_acting) if self.equations.branches else []
        return ca.solve(self.iteration_matrix([*stages, acting], h), ca.DM.eye(s * n), "lapacklu")

    @cached_property
    def iteration(self) -> ca.Function:
        """``(x, u0, u1, h, z, inverse) -> z, correction``."""
        inverse = ca.MX.sym("inverse", *[self.stages * self.equations.n_strains] * 2)
        symbols = [*self.symbols, inverse]
        return ca.Function("iteration", symbols, list(self.corrected(*symbols)))

    @cached_property
    def symbols(self) -> tuple[ca.MX, ...]:
        """Of a step: x, u0, u1, h, z."""
        n, m = self.equations.n_strains, self.equations.n_inputs
        sizes = {
            "x": (self.equations.layout.n_moving, 1),
            "u0": (m, 1),
            "u1": (m, 1),
            "h": (1, 1),
            "z": (n, self.stages),
        }
        return tuple(ca.MX.sym(name, *size) for name, size in sizes.items())

    def corrected(self, x: ca.MX, u0: ca.MX, u1: ca.MX, h: ca.MX, z: ca.MX, inverse: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Accelerations after one Newton correction, and its size in strains.

        Args:
            x, u0, u1, h, z: as in ``symbols``.
            inverse: of the iteration matrix.
        """
        residual = self.residual.map(self.stages)
        change = ca.reshape(inverse @ ca.vec(residual(*self.at_stages(x, z, (u0, u1), h))), *z.shape)
        nominal = ca.DM(np.tile(self.equations.nominal_strains, (self.stages, 1)).T)
        return z - change, h**2 * ca.norm_fro(change / nominal)  # norm_inf of CasADi passes over NaN

    @cached_property
    def derivatives(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> `` exact derivatives of the scaled residual with respect to each, at all stages."""
        *symbols, balance = self.equations.dynamic_balance
        scale = ca.diag(1.0 / ca.DM(self.equations.nominal_residual))
        blocks = [scale @ block for block in slopes(balance, symbols)]
        exact = ca.Function("derivatives", symbols, [ca.densify(block) for block in blocks])
        return exact.map(self.stages)

    @cached_property
    def powers(self) -> ca.Function:
        """``(xi, xi_t, u) -> power`` of every term at all stages, (n_terms, s)."""
        return powers(self.equations).map(self.stages)

    # Arithmetic of a step --------------------------------------------------------------------------------------------

    def at_stages(self, x: Any, z: Any, u: tuple[Any, Any], h: Any) -> tuple[Any, Any, Any, Any]:
        """Strains, rates, accelerations (n, s) and inputs (m, s) at the stages; numpy or MX.

        In a scene with Maxwell branches inputs are [sigma, u].

        Args:
            x: [xi, xi_t] (2n,) or [xi, xi_t, sigma] at the start of the step.
            z: accelerations (n, s).
            u: inputs (m,) at the start and at the end.
            h: step in s.
        """
        n, c, one = self.equations.n_strains, self.c[None, :], np.ones((1, self.stages))
        xi, xi_t = x[:n].reshape((n, 1)), x[n : 2 * n].reshape((n, 1))
        start, end = (value.reshape((self.equations.n_inputs, 1)) for value in u)
        shape = xi @ one + h * (xi_t @ c) + h * h * (z @ (self.a @ self.a).T)
        inputs = start @ (1.0 - c) + end @ c
        if self.equations.branches:
            sigma = self.overstress.along(x, z, h)[:, : self.stages]
            inputs = np.vstack([sigma, inputs]) if isinstance(z, np.ndarray) else ca.vertcat(sigma, inputs)
        return shape, xi_t @ one + h * (z @ self.a.T), z, inputs

    def end(self, x: Any, z: Any, h: Any) -> Any:
        """[xi, xi_t] (2n,), with Maxwell branches [xi, xi_t, sigma], after a step; numpy or MX.

        Args:
            x: the same at its start.
            z: accelerations (n, s).
            h: step in s.
        """
        n = self.equations.n_strains
        xi, xi_t = x[:n], x[n : 2 * n]
        parts = [xi + h * xi_t + h * h * (z @ (self.b @ self.a)), xi_t + h * (z @ self.b)]
        if self.equations.branches:
            parts.append(self.overstress.along(x, z, h)[:, -1])
        return np.concatenate(parts) if isinstance(z, np.ndarray) else ca.vertcat(*parts)

    def iteration_matrix(self, blocks: Sequence[Sequence[Any]], h: Any) -> Any:
        """Derivative (s n, s n) of the stage residuals with respect to the stage accelerations; numpy or MX.

        Args:
            blocks: derivatives with respect to strains, rates and accelerations, each a list over the stages of (n, n),
                and with Maxwell branches to [sigma, u], (n, n_acting) each.
            h: step in s.
        """
        a, stages = self.a, range(self.stages)
        twice = a @ a
        of_shape, of_rate, mass, acting = blocks
        rows = [[h * h * twice[i, j] * of_shape[i] + h * a[i, j] * of_rate[i] for j in stages] for i in stages]
        for i in stages:
            rows[i][i] = rows[i][i] + mass[i]
        if self.equations.branches:
            through = self.overstress.slopes(acting, h)
            rows = [[rows[i][j] + through[i][j] for j in stages] for i in stages]
        return np.block(rows) if isinstance(mass[0], np.ndarray) else ca.blockcat(rows)

    @cached_property
    def onwards(self) -> Array:
        """Weights (s, s) that extrapolate a polynomial at the stages of one step to those of the next."""
        here, there = np.vander(self.c, self.stages), np.vander(1.0 + self.c, self.stages)
        return np.asarray(np.linalg.solve(here.T, there.T), dtype=np.float64)


def radau(stages: int) -> tuple[Array, Array]:
    """Nodes (s,) and matrix (s, s) of Radau IIA: collocation at the zeros of d^(s-1)/dx^(s-1) x^(s-1) (x-1)^s.

    ``stages`` is s.
    """
    polynomial = np.poly1d([1.0, 0.0]) ** (stages - 1) * np.poly1d([1.0, -1.0]) ** stages
    c = np.sort(np.real(np.roots(np.polyder(polynomial, stages - 1))))
    powers = np.arange(1, stages + 1)
    a = (c[:, None] ** powers / powers) @ np.linalg.inv(c[:, None] ** (powers - 1))
    return c, a
