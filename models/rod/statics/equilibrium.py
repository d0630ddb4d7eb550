"""What a search for static equilibria returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


@dataclass(frozen=True)
class Equilibrium:
    """A static equilibrium, or the best that was found.

    Attributes:
        state: [xi, 0, u] (n_states,).
        success: whether the residual is below tolerance.
        residual: largest residual in parts of EI/L (moments) and EI/L^2 (forces).
        iterations: Newton iterations of the solver that ended the search (all loads of a continuation together); None
            after kinsol, whose CasADi interface does not report them.
        solver: ``"kinsol"``, ``"newton"``, ``"continuation"`` or ``"relaxation"``.
        tensions: tendon tensions in N.
        slack: by how much each tendon is longer than its path, in m (0 when taut).
        message: why the search failed, empty on success.
        scene: the scene in equilibrium.
    """

    state: Array
    success: bool
    residual: float
    iterations: int | None
    solver: str
    tensions: Array
    slack: Array
    message: str = ""
    scene: Scene = field(repr=False, compare=False, kw_only=True)

    @property
    def strains(self) -> Array:
        """Free strains xi (n_strains,): 1/m for bending and torsion, 1 for shear and stretch."""
        return self.state[: self.scene.n_strains]

    def pose(self, s: float) -> tuple[Array, Array]:
        """Position (3,) in m and rotation (3, 3) at arclength ``s`` in m."""
        y = self.scene.field_map([s]).evaluate(self.state)[0]
        return y[:3], y[3:12].reshape(3, 3)

    @property
    def tip(self) -> Array:
        """Position of the tip (3,) in m."""
        return self.pose(self.scene.rod.length)[0]


@dataclass(frozen=True)
class EquilibriumBatch:
    """Equilibria of many inputs; rows that failed hold the last iterate, and ``success`` tells them apart.

    Attributes:
        states: [xi, 0, u] (N, n_states).
        success: (N,) whether the residual is below tolerance.
        residual: (N,) in parts of EI/L.
        tensions: (N, tendons) in N.
    """

    states: Array
    success: np.ndarray
    residual: Array
    tensions: Array
