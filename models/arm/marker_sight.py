"""What markers see of a state of an arm, with its derivatives."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit import Episodes
from pisplit.checks import Array, real_array
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.rod import Scene
from pisplit.models.rod.kinematics.rotations import exponential, rotation_matrix

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm


class MarkerSight:
    """Columns of a :class:`MotionCapture` as functions of a state [xi, xi_t] and of the pose of the base.

    Args:
        scene: the arm.
        capture: its markers.
    """

    def __init__(self, scene: Scene, capture: MotionCapture) -> None:
        self.scene, self.capture = scene, capture
        self.points = capture.at(scene.rod.length)
        self.rows = np.arange(capture.n_columns)
        self.pose = np.array([*np.asarray(capture.position), *np.asarray(capture.turn)])

    @property
    def sizes(self) -> Array:
        """Standard deviations (K,) of the columns."""
        return self.capture.sizes

    @cached_property
    def function(self) -> ca.Function:
        """xi (n,), pose (6,) -> columns (K,), d columns / d xi (K, n), d columns / d pose (K, 6)."""
        xi, _, balance = self.scene.static_balance
        pose = ca.SX.sym("pose", 6)
        turn = rotation_matrix(exponential(pose[3:]))
        motion, capture = balance.motion, self.capture
        p, frames = motion.position_at(list(self.points)), motion.frames_at(list(self.points))
        columns = []
        for k in range(len(self.points)):
            aside = ca.SX(3, 1) if capture.offsets is None else frames[k] @ ca.DM(np.asarray(capture.offsets)[k])
            columns.append(pose[:3] + turn @ (p[:, k] + aside))
            if k + 1 in capture.frames:
                columns.append(ca.vec((turn @ frames[k]).T))
        y = ca.vertcat(*columns)
        return ca.Function("markers", [xi, pose], [y, ca.jacobian(y, xi), ca.jacobian(y, pose)])

    def look(self, state: Array, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """Columns (K,), their derivatives (K, 2n) in the ``state`` [xi, xi_t] (2n,) and (K, 6) in the pose.

        ``pose`` (6,) of the base: position in m and rotation vector in rad; the given one where it is left out.
        """
        n = self.scene.n_strains
        y, of_shape, of_pose = (
            np.asarray(v, dtype=np.float64) for v in self.function(state[:n], self.pose if pose is None else pose)
        )
        return y.ravel(), np.hstack([of_shape, np.zeros_like(of_shape)]), of_pose


def marker_array(values: ArrayLike, capture: MotionCapture, length: float, shape: tuple[int, ...]) -> Array:
    """``values`` (*shape, K) of the markers of a ``capture`` on an arm of ``length`` in m; -1 in ``shape``: any number.

    Raises ValueError for another shape, numbers that are infinite, positions far from the arm, and where all are lost.
    """
    found = real_array(values, "markers").astype(np.float64)
    wanted = (*shape, capture.n_columns)
    fits = found.ndim == len(wanted) and all(w in (-1, s) for w, s in zip(wanted, found.shape, strict=True))
    if not fits:
        told = ", ".join("any" if w == -1 else str(w) for w in wanted)
        raise ValueError(f"markers have shape {found.shape}; expected ({told})")
    if np.isinf(found).any() or not np.isfinite(found).any():
        raise ValueError("markers are infinite, or all of them are lost; expected positions in m, NaN for a lost one")
    capture.check(found, length)
    return found


def read_markers(episodes: Episodes, arm: Arm, capture: MotionCapture) -> tuple[list[Array], Episodes]:
    """Columns (T+1, K) in m of the markers in every one of the ``episodes``, and these with the inputs of the ``arm``.

    Inputs that have the names of its tendons are put in their order, others count by position; known units are
    converted. Raises ValueError for other numbers of inputs, and for what ``capture`` (``MotionCapture.read``) refuses.
    """
    scene = arm.scene
    if episodes.n_inputs != scene.n_inputs:
        raise ValueError(f"the recordings have {episodes.n_inputs} inputs; the arm has {scene.n_inputs} tendons")
    named = set(episodes.input_names or ()) == set(scene.input_names)
    data = episodes.arranged(None, scene.input_names if named else None, None, scene.input_units, owner="the arm")
    return capture.read(data, scene.rod.length), data
