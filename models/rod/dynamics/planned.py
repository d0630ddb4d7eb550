"""Motion along a plan of commands that changes little from one call to the next, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, count
from pisplit.mapping import Buffered
from pisplit.models.rod.dynamics.fast import FastStepper

#: Last correction of the strains in parts of their nominal size up to which a step converged: the next would be smaller
#: by the contraction of the iteration, 0.1 or less.
CONVERGED = 1e-4
#: First correction, in the same parts, beyond which a step is not tried: the start is not near.
LARGEST = 5.0
#: Contraction beyond which an iteration is given up, and corrections that it may take.
SLOW, CORRECTIONS = 0.5, 8
#: Way from where derivatives were taken, in nominal strains, within which they are good enough.
NEAR = 0.02


@dataclass(frozen=True, eq=False)
class Tangent:
    """One step of a plan with its derivatives, and where it went last.

    Attributes:
        at: [state, inputs before, command] (k,) = (n_moving + 2 m,) of the last motion.
        z: accelerations (n, s) at its stages there.
        inverse: of the iteration matrix (s n, s n) where the derivatives were taken.
        of_z: derivative of the accelerations (s n, k) there, by ``at``.
        slope: of the end (n_moving, k).
        origin: where that was, (k,).
    """

    at: Array
    z: Array
    inverse: Array
    of_z: Array
    slope: Array
    origin: Array


class PlannedMotion:
    """Steps of a scene, each found by the iteration matrix that it had in the last plan, and their derivatives.

    A plan of predictive control is almost the last one, one step on. What its steps had there, accelerations,
    iteration matrices and derivatives, starts this one: every step is solved to ``CONVERGED`` by one or two
    corrections. ``fresh`` steps at most get new derivatives: those that have none, which is the last one of a shifted
    plan, then those that went farthest, and farther than ``NEAR``, from where theirs were taken; beside them those
    whose matrix leads nowhere. A step that has none and gets none takes those of the step before. A step that even a
    new matrix does not solve is taken in the pieces of the stepper. Values are those of large Radau steps without a
    look at their defect: what is too fast for them is damped.

    Source: Diehl, Bock and Schloeder, SIAM J. Control Optim. 43 (2005), real-time iterations; Bock, Diehl, Kostina and
    Schloeder, in *Real-Time PDE-Constrained Optimization* (2007), with inexact derivatives.

    Args:
        stepper: one step a control interval; of a scene without Maxwell branches whose tip is not held.
        fresh: see above.

    Raises ValueError for other steppers.
    """

    def __init__(self, stepper: FastStepper, fresh: int) -> None:
        if stepper.substeps != 1 or stepper.equations.branches or stepper.projection is not None:
            raise ValueError("a planned motion takes one step an interval, without Maxwell branches or a held tip")
        self.stepper, self.fresh = stepper, count(fresh, "fresh")

    def __call__(
        self, x: Array, before: Array, commands: Array, push: Array, kept: Sequence[Tangent | None]
    ) -> tuple[Array, Array, list[Tangent | None]]:
        """Ends (H, n_moving) of the steps, before ``push``, their slopes as in ``Tangent``, and what to keep of them.

        Args:
            x: [xi, xi_t] (n_moving,) at the start.
            before: inputs (m,) there.
            commands: (H, m).
            push: (n_moving + m,), what is added to [x, u] after every step.
            kept: of these steps in the last plan (H,), None where there is nothing.

        Raises RuntimeError where a step fails.
        """
        anew = self._farthest(kept)
        q, ends, slopes = len(x), [], []
        tangents: list[Tangent | None] = []
        neighbour: Tangent | None = None
        for j, command in enumerate(commands):
            at = np.concatenate([x, before, command])
            tangent, end = self._step(at, kept[j] or neighbour, j in anew)
            if tangent is None:
                whole = self.stepper.sensitivity(at[: -len(command)], command)
                end, slope = whole.x[:q], np.hstack([whole.d_state[:q], whole.d_input[:q]])
            else:
                slope = tangent.slope
            neighbour = tangent or neighbour
            ends.append(end)
            slopes.append(slope)
            tangents.append(tangent)
            x, before = end + push[:q], command + push[q:]
        return np.array(ends), np.array(slopes), tangents

    def _farthest(self, kept: Sequence[Tangent | None]) -> set[int]:
        """Positions of the steps, ``fresh`` at most, that went farther than ``NEAR`` or have no derivatives."""
        n, scene = self.stepper.scene.n_strains, self.stepper.equations
        away = np.full(len(kept), np.inf)
        for j, tangent in enumerate(kept):
            if tangent is not None:
                off = (tangent.at - tangent.origin)[: 2 * n].reshape(2, n) / scene.nominal_strains
                away[j] = np.linalg.norm(off[0]) + self.stepper.dt * np.linalg.norm(off[1])
        return {int(j) for j in np.argsort(-away, kind="stable")[: self.fresh] if away[j] > NEAR}

    def _step(self, at: Array, known: Tangent | None, anew: bool) -> tuple[Tangent | None, Array]:
        """The tangent of the step ``at`` its state and inputs, None where no matrix solves it, and its end."""
        found = None
        if known is not None:
            guess = known.z + (known.of_z @ (at - known.at)).reshape(known.z.shape[::-1]).T
            found = self._solved(at, guess, known.inverse)
        if found is None:
            z = np.zeros((self.stepper.scene.n_strains, self.stepper.stages))
            found, anew = self._solved(at, z, self._slopes(at, z)[0]), True
        if found is None:
            return None, at
        z, end = found
        if anew or known is None:
            return Tangent(at, z, *self._slopes(at, z), at), end
        return replace(known, at=at, z=z), end

    def _solved(self, at: Array, z: Array, inverse: Array) -> tuple[Array, Array] | None:
        """Accelerations (n, s) from the guess ``z`` by one matrix, and the end; None where they do not converge."""
        last = LARGEST / SLOW
        for _ in range(CORRECTIONS):
            found, end, size = self._corrected(at, z.T, inverse.T)
            if not size[0] <= max(SLOW * last, CONVERGED):  # NaN, too
                return None
            z, last = found.reshape(z.shape[::-1]).T.copy(), float(size[0])
            if last <= CONVERGED:
                return z, end.copy()
        return None

    def _slopes(self, at: Array, z: Array) -> tuple[Array, Array, Array]:
        """Inverse of the iteration matrix, derivatives of the accelerations and of the end, at accelerations ``z``."""
        scheme, h = self.stepper.collocation, self.stepper.dt
        (n, s), a, c = z.shape, scheme.a, scheme.c[:, None, None]
        before, command = np.split(at[2 * n :], 2)
        stages = scheme.at_stages(at[: 2 * n], z, (before, command), h)
        blocks = self._derivatives(*(value.T for value in stages))
        of_shape, of_rate, mass, of_input = (block.reshape(s, -1, n).transpose(0, 2, 1) for block in blocks)
        coupled = np.einsum("ij,iab->iajb", h * h * a @ a, of_shape) + np.einsum("ij,iab->iajb", h * a, of_rate)
        coupled[np.arange(s), :, np.arange(s)] += mass
        inverse = np.linalg.inv(coupled.reshape(s * n, s * n))
        given = np.concatenate([of_shape, h * c * of_shape + of_rate, (1.0 - c) * of_input, c * of_input], axis=2)
        of_z = -inverse @ given.reshape(s * n, -1)
        by_stage = of_z.reshape(s, n, -1)
        bent = np.tensordot(np.stack([h * h * (scheme.b @ a), h * scheme.b]), by_stage, 1)
        slope = bent.reshape(2 * n, -1)
        slope[:, : 2 * n] += np.eye(2 * n)
        slope[:n, n : 2 * n] += h * np.eye(n)
        return inverse, of_z, slope

    @cached_property
    def _corrected(self) -> Buffered:
        """``[x, u0, u1], z, inverse -> z, end, size`` of one Newton correction."""
        scheme, h = self.stepper.collocation, self.stepper.dt
        x, u0, u1, _, z = scheme.symbols
        inverse = ca.MX.sym("inverse", *[self.stepper.stages * self.stepper.scene.n_strains] * 2)
        at = ca.MX.sym("at", x.numel() + u0.numel() + u1.numel())
        parts = ca.vertsplit(at, [0, x.numel(), x.numel() + u0.numel(), at.numel()])
        found, size = scheme.corrected(parts[0], parts[1], parts[2], ca.MX(h), z, inverse)
        return Buffered(ca.Function("corrected", [at, z, inverse], [found, scheme.end(parts[0], found, h), size]))

    @cached_property
    def _derivatives(self) -> Buffered:
        """Exact derivatives of the scaled residual at all stages."""
        return Buffered(self.stepper.collocation.derivatives)

    def __getstate__(self) -> dict[str, Any]:
        return {"stepper": self.stepper, "fresh": self.fresh}
