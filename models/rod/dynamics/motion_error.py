"""Is a motion right? Its distance from the same motion on a finer grid in space and time."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pisplit.brief import brief
from pisplit.checks import Array
from pisplit.models.rod.dynamics.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Points along the rod at which shapes are compared.
POINTS = 20


@brief
@dataclass(frozen=True)
class MotionError:
    """Estimated error of a motion.

    Attributes:
        distance: (T+1,) m, largest along the rod, from the motion on the finer grid.
        travel: m, farthest that any point of the rod gets from where it starts.
        drift: (T+1,) m, largest along the rod by which the ways of a point since the start differ: what the start is
            off by is not in it.
    """

    distance: Array
    travel: float
    drift: Array

    @classmethod
    def between(cls, here: Array, there: Array) -> MotionError:
        """That of the positions ``here`` (T+1, S, 3) beside those of the finer motion, ``there``, in m."""
        off = here - there
        distance, drift = (
            np.nan_to_num(np.linalg.norm(o, axis=2).max(axis=1), nan=np.inf) for o in (off, off - off[0])
        )
        return cls(distance, float(np.linalg.norm(here - here[0], axis=2).max()), drift)

    @property
    def largest(self) -> float:
        """Largest distance in m."""
        return float(self.distance.max())

    @property
    def of_travel(self) -> float:
        """Largest distance in parts of the travel; of a rod that stays exactly where it is, 0 or infinite."""
        if self.travel > 0.0:
            return self.largest / self.travel
        return 0.0 if self.largest == 0.0 else float("inf")

    def first_above(self, share: float, least: float = 0.0) -> int | None:
        """First step after which the drift is more than ``share`` of the travel and ``least`` (m), or None.

        What both shapes differ by at the start is an error of the equilibrium or of the given state, which is told
        there. Errors of less than ``least`` are not judged: that of a motion that travels less than ``least / share``
        may be a larger part of it, and of one that travels less than ``least`` all of it (``of_travel`` tells).
        """
        above = np.flatnonzero(self.drift > max(share * self.travel, least))
        return int(above[0] - 1) if len(above) else None

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The distance over the steps; written to ``path`` where one is given."""
        from pisplit.models.rod.output.results import plot_motion_error

        return plot_motion_error(self, path)


def motion_error(found: Trajectory, finer: Trajectory) -> MotionError:
    """Distance of two motions of one rod, at 20 points along it, over the time that both last.

    Args:
        found: the motion that is judged.
        finer: the same on more nodes, with smaller steps.
    """
    points = found.scene.rod.length * np.arange(1, POINTS + 1) / POINTS
    last = min(len(found.t), len(finer.t))
    here, there = (motion.fields(points)[:last, :, :3] for motion in (found, finer))
    return MotionError.between(here, there)
