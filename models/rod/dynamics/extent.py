"""How long, how far and how roughly a rod moves: what a motion that was checked says of the next."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.dynamics.trajectory import Trajectory

#: By how much a motion may be longer, larger or rougher than one that was checked, and how much smaller.
LONGER, SMALLER = 1.5, 0.1


@dataclass(frozen=True)
class Extent:
    """Length, size and roughness of a motion.

    Attributes:
        duration: in s.
        size: largest change and rate of a strain, in parts of typical ones.
        work: internal steps per s that the scheme took.
    """

    duration: float
    size: float
    work: float

    @classmethod
    def of(cls, found: Trajectory, nominal: Array) -> Extent:
        """That of ``found``; ``nominal`` are typical strains and rates (2 n_strains,)."""
        states, duration = found.x[:, : len(nominal)], float(found.t[-1])
        changes = np.abs(states - np.where(np.arange(len(nominal)) < len(nominal) // 2, states[0], 0.0)) / nominal
        return cls(duration, float(changes.max(initial=0.0)), found.stats.get("nsteps", 0) / max(duration, 1e-300))

    def within(self, other: Extent) -> bool:
        """Whether what is known of the error of ``other`` holds for this one."""
        return bool(
            self.duration <= LONGER * other.duration
            and SMALLER * other.size <= self.size <= LONGER * other.size
            and self.work <= LONGER * other.work
        )


@dataclass
class Checked:
    """What was checked.

    Attributes:
        extents: of the motions of a scene that were checked.
    """

    extents: list[Extent] = field(default_factory=list)

    def is_new(self, extent: Extent) -> bool:
        """Whether nothing is known of a motion of this ``extent``; from now on it is."""
        if any(extent.within(known) for known in self.extents):
            return False
        self.extents.append(extent)
        return True
