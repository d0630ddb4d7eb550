"""How the base of an arm stands in the axes of a measurement, from shapes that the drawing explains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.arm.motion_capture import MotionCapture

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Second singular value of the points, in parts of the first, below which they lie on a line.
LINE = 1e-3


def aligned(arm: Arm, capture: MotionCapture, inputs: Array, measured: Array) -> MotionCapture:
    """The ``capture`` with the pose that lays the shapes at rest of the ``arm`` on those measured best, to start from.

    Args:
        arm: as drawn.
        capture: markers whose pose is estimated.
        inputs: displacements (N, m) in m.
        measured: columns (N, K) under them, nearly at rest; NaN: lost.

    Kabsch, *A solution for the best rotation to relate two sets of vectors*, Acta Cryst. A 1976. Raises ValueError
    where the arm does not rest under these displacements, and where all points lie on one line.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and needed here alone

    found = arm.scene.statics().solve_many(inputs)
    here = MarkerSight(arm.scene, capture)
    zero, n, at = np.zeros(6), arm.scene.n_strains, list(capture.positions)
    good = np.flatnonzero(found.success)
    if not len(good):
        raise ValueError("the arm as drawn rests under none of the displacements; check its numbers, or the inputs")
    drawn = np.stack([here.look(np.concatenate([s[:n], np.zeros(n)]), zero)[0] for s in found.states[good]])
    p, y = (v[:, at].reshape(-1, 3) for v in (drawn, measured[good]))
    seen = np.isfinite(y).all(axis=1)
    p, y = p[seen], y[seen]
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False) if len(p) > 2 else np.zeros(3)
    if spread[1] <= LINE * spread[0]:
        raise ValueError(
            "the pose of the base cannot be estimated: all marker positions lie on one line; give recordings or shapes "
            "that bend to several sides, or MotionCapture(position=, turn=)"
        )
    turn, _ = Rotation.align_vectors(y - y.mean(axis=0), p - p.mean(axis=0))
    position = y.mean(axis=0) - turn.apply(p.mean(axis=0))
    placed = capture.placed(position, turn.as_rotvec())
    return MotionCapture(**{**vars(placed), "pose": "estimated"})
