"""Are the nodes enough for a rod whose tip is held? The finer grid takes its step with the tip where it is."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.resolution import Resolution

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.held_balance import HeldBalance


class HeldResolution(Resolution):
    """``Resolution`` of shapes whose tip is held: Newton's step is one of the strains and of the wrench at the tip.

    Args:
        scene: the rod and what acts on it.
        balance: that of the scene with its tip held.
        finer: the grid to compare with, if not that of ``Resolution``.
        pose: position and columns of the rotation (12,) of the tip in all states; that of each when not given.
    """

    def __init__(
        self,
        scene: Scene,
        balance: HeldBalance,
        finer: Scene | None = None,
        pose: Array | None = None,
    ) -> None:
        super().__init__(scene, finer)
        self._held, self._given = balance, pose
        self._pose = np.zeros(12) if pose is None else pose

    def judged(self, state: Array) -> tuple[float, Array]:
        """As in ``Resolution``; the tip stays where it is in ``state``."""
        if self._given is None:
            place, frame = self._held.pose(state)
            self._pose = np.concatenate([place, frame.ravel(order="F")])
        return super().judged(state)

    def of(self, scene: Scene) -> HeldResolution:
        """That of another ``scene``, with the tip at the same place."""
        return HeldResolution(scene, self._held.on(scene), None, self._pose)

    def on(self, scene: Scene) -> HeldResolution:
        """That of the same scene beside another ``scene`` than ``finer``, with the tip at the same place."""
        return self if scene is self.finer else HeldResolution(self.scene, self._held, scene, self._pose)

    @cached_property
    def _finer_balance(self) -> HeldBalance:
        return self._held.on(self.finer)

    def _newton_step(self, xi: Array, u: Array, force: Array | float = 0.0) -> Array:
        """Change of the strains ``xi`` (n,) on the finer grid by one Newton step from the wrench that fits best."""
        try:
            return self._finer_balance.newton_step(xi, u, self._pose)
        except np.linalg.LinAlgError:
            return np.full(len(xi), np.inf)
