"""Shapes at rest that follow the parameters of an arm."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod import Scene
from pisplit.models.rod.statics.branch import LOST
from pisplit.models.rod.statics.search import TOLERANCE

#: Newton steps from a known shape to that of other parameters, and the largest of them in scaled strains.
NEWTON, LONGEST = 12, 1.0


class FollowedShapes:
    """Equilibria of a parametrised arm, each known from the last parameters it was asked for.

    Every shape is loaded from nothing once. For other parameters Newton's method starts from the shape last known and
    its derivative, which is that of the implicit function; what is found counts if it is stable. Where that fails the
    parameters are moved slowly from the last shape to the new one (``Branches.of_state``).

    Args:
        scene: the arm, with its parameters as inputs.
        number: of shapes.
    """

    def __init__(self, scene: Scene, number: int) -> None:
        self.scene = scene
        self.search, self.branches = scene.statics().search, scene.statics().branches
        self._known: list[tuple[Array, Array] | None] = [None] * number

    def solved(self, i: int, w: Array) -> tuple[Array, Array] | None:
        """Strains (n,) of shape ``i`` under all inputs ``w`` (n_inputs,) and their derivative (n, n_inputs) in them.

        None where there is no such shape to be found.
        """
        shape = self._shape(i, w)
        if shape is None:
            return None
        self._known[i] = shape, w.copy()
        of_x, of_u = (np.asarray(v) for v in self.search.slopes(shape, w))
        slope = -np.asarray(self.scene.nominal_strains)[:, None] * np.linalg.solve(of_x, of_u)
        return np.asarray(self.search.strains(shape)), slope

    def _shape(self, i: int, w: Array) -> Array | None:
        """Scaled strains (n,) of shape ``i`` under inputs ``w`` (n_inputs,); None where there is none to be found."""
        search, branches, known = self.search, self.branches, self._known[i]
        if known is None:
            found, _, _ = search.find(w, np.zeros(self.scene.n_strains), branches.unique(w))
            verdict = branches.of_root(found, w, search.worst(found, w) <= TOLERANCE)
        else:
            start, before = known
            near = self._newton(start + search.along(start, before, w - before), w)
            if near is not None and branches.near(near, w).stable:
                return near
            verdict = branches.of_state(start, w, start, before, False)
        rests = verdict.branch not in LOST and search.worst(verdict.x, w) <= TOLERANCE
        return verdict.x if rests else None

    def _newton(self, x: Array, w: Array) -> Array | None:
        """The root next to ``x`` (n,), None where the steps grow long or do not end."""
        for _ in range(NEWTON):
            if self.search.worst(x, w) <= 1e-2 * TOLERANCE:
                return x
            try:
                step = np.linalg.solve(np.asarray(self.search.slopes(x, w)[0]), self.search.residual(x, w))
            except np.linalg.LinAlgError:
                return None
            if not np.abs(step).max() <= LONGEST:
                return None
            x = x - step
        return x if self.search.worst(x, w) <= TOLERANCE else None
