"""Are the nodes enough for a rod whose tip is held? The finer grid takes its step with the tip where it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.resolution import Resolution

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.boundary import FixedTip


class HeldResolution(Resolution):
    """``Resolution`` of shapes whose tip is held: Newton's step is one of the strains and of the wrench at the tip.

    Args:
        scene: the rod and what acts on it.
        holding: makes what holds the tip of a scene.
        finer: the grid to compare with, if not that of ``Resolution``.
        pose: position and columns of the rotation (12,) of the tip in all states; that of each when not given.
    """

    def __init__(
        self,
        scene: Scene,
        holding: Callable[[Scene], FixedTip],
        finer: Scene | None = None,
        pose: Array | None = None,
    ) -> None:
        super().__init__(scene, finer)
        self._holding, self._given = holding, pose
        self._pose = np.zeros(12) if pose is None else pose

    def judged(self, state: Array) -> tuple[float, Array]:
        """As in ``Resolution``; the tip stays where it is in ``state``."""
        if self._given is None:
            self._pose = self._holding(self.scene).pose_of(state)
        return super().judged(state)

    def of(self, scene: Scene) -> HeldResolution:
        """That of another ``scene``, with the tip at the same place."""
        return HeldResolution(scene, self._holding, None, self._pose)

    def on(self, scene: Scene) -> HeldResolution:
        """That of the same scene beside another ``scene`` than ``finer``, with the tip at the same place."""
        return self if scene is self.finer else HeldResolution(self.scene, self._holding, scene, self._pose)

    def _newton_step(self, xi: Array, u: Array, force: Array | float = 0.0) -> Array:
        """Change of the strains ``xi`` (n,) on the finer grid by one Newton step from the wrench that fits best."""
        try:
            return self._holding(self.finer).newton_step(xi, u, self._pose)
        except np.linalg.LinAlgError:
            return np.full(len(xi), np.inf)
