"""Outputs of an arm along a plan of MPC, and their derivatives, from one call to the next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.mapping import Buffered
from pisplit.models.rod.dynamics.planned import PlannedMotion, Tangent

if TYPE_CHECKING:
    from pisplit.front.physical import PhysicalStep

#: Steps of the horizon that get new derivatives at a move: the new one, and two others where they need them.
FRESH = 3


class PlannedOutputs:
    """y = C z + d along a plan of inputs, and dy/dv, for z = [strains, rates, u before, fields] and u = T v.

    ``step``: the arm's; ``read`` (p, M) and ``offset`` (p,): rows of C and d; T (m, r). Between calls it keeps the
    tangents of the last plan, whose steps are those of the next one, one earlier.
    """

    def __init__(self, step: PhysicalStep, read: Array, offset: Array, T: Array) -> None:
        self._step, self._read, self._offset, self._T = step, read, offset, T
        self._motion = PlannedMotion(step.stepper, FRESH)
        self._kept: tuple[Tangent | None, ...] = ()
        self._fields_at: tuple[int, Buffered] | None = None

    def __call__(self, z: Array, w: Array, u: Array) -> tuple[Array, Array]:
        """S (H p, H r) = dy/dv and y (H p,) from z (M,) under u (H, m) and w (M,), added to z after every step.

        Raises RuntimeError where a step fails.
        """
        H, (m, r), n, p = len(u), self._T.shape, self._step.n, len(self._read)
        kept = (*self._kept[1:], *[None] * H)[:H]
        ends, slopes, tangents = self._motion(z[:n], z[n : n + m], u, w[: n + m], kept)
        self._kept = tuple(tangents)
        fields, by_strain = self._fields(ends)
        y = fields.reshape(H, p) + (ends + w[:n]) @ self._read[:, :n].T + self._offset
        y += (u + w[n : n + m]) @ self._read[:, n : n + m].T + self._read[:, n + m :] @ w[n + m :]
        by_end = by_strain.reshape(H, n, p).transpose(0, 2, 1) + self._read[:, :n]
        by_before, by_command = slopes[:, :, n : n + m] @ self._T, slopes[:, :, n + m :] @ self._T
        S, bent = np.zeros((H, p, H * r)), np.zeros((n, H * r))
        for j in range(H):
            bent[:, : j * r] = slopes[j, :, :n] @ bent[:, : j * r]
            bent[:, j * r : (j + 1) * r] = by_command[j]
            if j:
                bent[:, (j - 1) * r : j * r] += by_before[j]
            S[j, :, : (j + 1) * r] = by_end[j] @ bent[:, : (j + 1) * r]
            S[j, :, j * r : (j + 1) * r] += self._read[:, n : n + m] @ self._T
        return S.reshape(H * p, H * r), y.ravel()

    def snapshot(self) -> tuple[Tangent | None, ...]:
        """What the next call starts from."""
        return self._kept

    def restore(self, kept: tuple[Tangent | None, ...] | None) -> None:
        """Go on from ``kept``, a snapshot, or None: from nothing."""
        self._kept = kept or ()

    def _fields(self, ends: Array) -> tuple[Array, ...]:
        """What is read from the fields at ``ends`` (H, n), (H, p), and its slopes (H, n, p); flat."""
        if self._fields_at is None or len(ends) != self._fields_at[0]:
            x, y = self._step.measured
            read = ca.DM(self._read[:, self._step.n + self._step.m :]) @ y
            one = ca.Function("read", [x], [ca.densify(read), ca.densify(ca.jacobian(read, x))])
            self._fields_at = len(ends), Buffered(one.map(len(ends)))
        return self._fields_at[1](ends)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_fields_at": None}
