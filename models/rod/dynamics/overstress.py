"""Overstress of Maxwell branches over one step of a collocation."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


class Overstress:
    """Overstress at the stages of a step h and at its end, under accelerations z_j at the stages.

    The same collocation as of the strains, with rates v_i = xi_t + h sum_j a_ij z_j: for a branch of relaxation time T
    and fraction f

        sigma_i = sigma + h sum_j a_ij (f v_j - sigma_j / T)

    is linear in sigma, xi_t and z, and is solved for them, so that a branch adds no unknown to a step. One scheme for
    all that moves keeps what it promises: a Gauss step neither makes nor loses energy beyond what the dashpots take,
    however fast the waves are (integrating sigma exactly instead makes stiff waves grow).

    Args:
        equations: the scene.
        a: matrix (s, s) of the collocation.
        b: weights (s,) of the end of the step.
    """

    def __init__(self, equations: Scene, a: Array, b: Array) -> None:
        self.branches, self.layout = equations.branches, equations.layout
        self.a, self.b = a, b

    @cached_property
    def _weights(self) -> ca.Function:
        """``h -> `` for each branch the weights (s+2, s+1), see ``weights``."""
        h, stages = ca.SX.sym("h"), len(self.b)
        found = []
        for branch in self.branches:
            rate, f = h / branch.time, branch.fraction
            solved = ca.inv_minor(ca.SX.eye(stages) + rate * ca.DM(self.a))
            given = ca.horzcat(ca.DM.ones(stages), f * h * self.a.sum(axis=1), f * h**2 * ca.DM(self.a @ self.a))
            at_stages = solved @ given
            if np.array_equal(self.a[-1], self.b):  # the last stage is the end
                end = at_stages[-1, :]
            else:
                drive = ca.horzcat(1.0, f * h, f * h**2 * ca.DM(self.b @ self.a).T)
                end = drive - rate * ca.DM(self.b).T @ at_stages
            found.append(ca.vertcat(at_stages, end).T)
        return ca.Function("overstress_weights", [h], found)

    def weights(self, h: Any) -> list[Any]:
        """Of each branch (s+2, s+1), at the stages and the end: of sigma, of xi_t, of the accelerations.

        ``h`` is the step in s, a number or an MX.
        """
        if not self.branches:
            return []
        found = self._weights.call([h])
        return found if isinstance(h, ca.MX) else [np.asarray(w) for w in found]

    def along(self, x: Any, z: Any, h: Any) -> Any:
        """Overstress (n_overstress, s+1) at the stages and at the end; numpy or MX.

        Args:
            x: [xi, xi_t, sigma] at the start of the step.
            z: accelerations (n, s).
            h: step in s.
        """
        n, free, rows = self.layout.n_strains, self.layout.n_free, []
        for k, weights in enumerate(self.weights(h)):
            first = 2 * n + k * free
            sigma, rates = x[first : first + free].reshape((free, 1)), x[n : n + free].reshape((free, 1))
            rows.append(sigma @ weights[:1, :] + rates @ weights[1:2, :] + z[:free, :] @ weights[2:, :])
        if not rows:
            return np.empty((0, len(self.b) + 1)) if isinstance(z, np.ndarray) else ca.MX(0, len(self.b) + 1)
        return np.vstack(rows) if isinstance(z, np.ndarray) else ca.vertcat(*rows)

    def slopes(self, acting: Any, h: Any) -> list[Any]:
        """Derivatives (n, n) of a residual at each stage by the accelerations at every stage, through the overstress.

        Row by row over the stages i, then j; ``acting`` are derivatives (n, n_acting) by [sigma, u], one a stage, and
        ``h`` is the step in s.
        """
        stages, weights = range(len(self.b)), self.weights(h)
        free, joint, found = self.layout.n_free, self.layout.n_joint, []
        for i in stages:
            blocks = [acting[i][:, k * free : (k + 1) * free] for k in range(len(weights))]
            if joint:  # it has no overstress
                blocks = [_widened(block, joint) for block in blocks]
            found.append([sum(w[2 + j, i] * b for w, b in zip(weights, blocks, strict=True)) for j in stages])
        return found


def _widened(block: Any, by: int) -> Any:
    """``block`` with that many columns of zeros behind it; numpy or MX."""
    rows = block.shape[0]
    return (
        np.hstack([block, np.zeros((rows, by))])
        if isinstance(block, np.ndarray)
        else ca.horzcat(block, ca.MX(rows, by))
    )
