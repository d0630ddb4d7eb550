"""Stability of a rod whose tip is held: on the deformations that leave the tip where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.descent import Judge, definite

#: Least singular value of the conditions, relative, of a direction in which they hold the tip.
HOLDING = 1e-6


@dataclass(frozen=True)
class HeldJudge(Judge):
    """Judges by the second variation of the energy on the deformations that the conditions leave.

    Unknowns are strains and multipliers, and their stiffness is [[H, -J], [-G, 0]] with the slopes G of the conditions;
    a shape is stable where Z^T H Z is positive definite, Z a basis of the deformations with G Z = 0 (Nocedal & Wright,
    *Numerical Optimization*, 2006, section 12.5).

    Attributes:
        strains: number n of strains; the other unknowns are multipliers.
    """

    strains: int

    def stable(self, stiffness: Array) -> bool:
        """Whether no deformation that the conditions leave goes on by itself; see ``Judge``."""
        return bool(np.isfinite(stiffness).all()) and super().stable(self._left(stiffness, stiffness))

    def kept(self, now: Array, before: Array, share: float, slack: float) -> bool:
        """The same as ``Judge.kept`` on the deformations that the conditions of ``now`` leave."""
        if not self.has_energy:
            return self.stable(now)
        if not (np.isfinite(now).all() and np.isfinite(before).all()):
            return False
        return definite(self._left(now - share * before, now), slack)

    def softest(self, stiffness: Array) -> tuple[float, Array]:
        """Least stiffness and its direction, with the change of the multipliers that holds the tip there."""
        basis, n = self.basis(stiffness), self.strains
        value, direction = super().softest(basis.T @ stiffness[:n, :n] @ basis)
        whole = basis @ direction
        reaction = np.linalg.lstsq(stiffness[:n, n:], -stiffness[:n, :n] @ whole, rcond=HOLDING)[0]
        return value, np.concatenate([whole, reaction])

    def size(self, step: Array) -> float:
        """Length of the strains in a ``step`` of all unknowns."""
        return super().size(step[: self.strains])

    def drag(self, n: int) -> Array:
        """Strains are slowed down, multipliers of ``n`` unknowns follow at once."""
        return np.concatenate([np.ones(self.strains), np.zeros(n - self.strains)])

    def uphill(self, force: Array, ahead: Array, step: Array) -> bool:
        """Never said: forces of conditions do work while these are not met exactly."""
        return False

    def _left(self, matrix: Array, stiffness: Array) -> Array:
        """``matrix`` of all unknowns on the deformations that the conditions in ``stiffness`` leave."""
        basis, n = self.basis(stiffness), self.strains
        left: Array = basis.T @ matrix[:n, :n] @ basis
        return left

    def basis(self, stiffness: Array) -> Array:
        """Orthonormal basis (n, n - c) of the deformations that the conditions in ``stiffness`` leave."""
        _, values, rows = np.linalg.svd(stiffness[self.strains :, : self.strains])
        held = int((values > HOLDING * max(float(values.max(initial=0.0)), 1e-300)).sum())
        basis: Array = rows[held:].T
        return basis
