"""The way of a tip from one pose to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Journey:
    """How the tip goes from one pose to another: straight on, at a constant turn, about itself if it is twisted.

    Attributes:
        start, goal: positions (3,) in m.
        frame: rotation at the start; turn: rotation vector (3,) to that of the goal, in the axes of the start.
        turns: about the axis of the tip, beside that.
    """

    start: Array
    goal: Array
    frame: Rotation
    turn: Array
    turns: float

    def at(self, t: float) -> Array:
        """Position and columns of the rotation (12,) at ``t``, 0 at the start and 1 at the goal."""
        turned = rotations().from_rotvec
        spun = turned([0.0, 0.0, 2.0 * np.pi * self.turns * t])
        now = (self.frame * turned(t * self.turn) * spun).as_matrix()
        return np.concatenate([self.start + t * (self.goal - self.start), now.ravel(order="F")])


def wound(turn: Array, frame: Rotation, vector: Array | None) -> Array:
    """``turn`` (3,) with as many whole turns more as the rotation ``vector`` (3,) in world axes has.

    It leads from ``frame``, in its axes, to where ``vector`` leads from the unloaded tip.
    """
    whole = 0.0 if vector is None else float(np.linalg.norm(vector))
    if vector is None or whole <= np.pi:
        return turn
    wanted = frame.inv().apply(vector)
    size = float(np.linalg.norm(turn))
    axis = turn / size if size > 1e-9 else wanted / whole
    return turn + 2.0 * np.pi * np.round((wanted - turn) @ axis / (2.0 * np.pi)) * axis


def checked_rotation(rotation: ArrayLike) -> Rotation:
    """A rotation matrix (3, 3) as a rotation. Raises ValueError for a matrix ``rotation`` that is none."""
    wanted = finite_array(rotation, "rotation", (3, 3))
    if np.abs(wanted @ wanted.T - np.eye(3)).max() > 1e-6 or np.linalg.det(wanted) < 0.0:
        raise ValueError("rotation is not a rotation matrix; give R with R R^T = I and det R = 1")
    return rotations().from_matrix(wanted)


def rotations() -> type[Rotation]:
    """Rotations of scipy, which are slow to load, and needed where a tip is held alone."""
    from scipy.spatial.transform import Rotation

    return Rotation
