"""What tendons of every kind have in common: where they run, and what their inputs may be."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.disks import checked_disks, holes
from pisplit.models.rod.terms.loads import Input, Loads

#: Tensions below zero by this part of the largest one, or of 1 N, are rounding of whoever computed them.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Pull:
    """What the inputs of a group of m tendons may be.

    Attributes:
        lengths: (m,) in m that displacements stay below, for tendons that are pulled by displacement; None for those
            that are driven by their tension, which is not negative.
    """

    lengths: Array | None

    @property
    def identity(self) -> list[float] | None:
        """The lengths as numbers."""
        return None if self.lengths is None else self.lengths.tolist()

    @property
    def limits(self) -> tuple[float, Array | float]:
        """Lowest and highest inputs, one or (m,)."""
        return (0.0, np.inf) if self.lengths is None else (-np.inf, np.nextafter(self.lengths, 0.0))

    def check(self, inputs: Array, name: str) -> None:
        """Raise ValueError where rows of inputs (N, m) cannot be; ``name`` is what the message calls them."""
        if not inputs.size:
            return
        if self.lengths is None:
            least, most = float(inputs.min()), float(inputs.max())
            if least < -ROUNDING * max(most, 1.0):
                raise ValueError(f"{name} pushes a tendon with {-least:g} N; tendons only pull: give tensions >= 0")
            return
        for most, length in zip(np.max(inputs, axis=0), self.lengths, strict=True):
            if most >= length:
                raise ValueError(f"{name} pulls a tendon of {length:g} m by {most:g} m; give metres below its length")


class TendonTerm(ABC):
    """A term that pulls tendons, one entry of the input ``name`` a tendon: as drawn (``Tendons``), or as identified."""

    name: str
    #: Arclength in m at which they are fixed to the rod, None at the tip.
    end: float | None = None
    #: Number of disks that they run over in straight pieces, or their arclengths in m; None: along the backbone.
    disks: int | Sequence[float] | None = None

    def holes(self, length: float) -> Array:
        """Arclengths (n + 1,) in m of base plate and disks on a rod of ``length`` in m; (0,) without disks.

        Raises ValueError where the last disk is not where the tendons end.
        """
        end = length if self.end is None else self.end
        return np.zeros(1) if self.disks is None else holes(checked_disks(self.disks), end)

    @property
    def kept_stiffness(self) -> float:
        """Part of the backbone's elastic stiffness that is surely left; corrections of it may take some away."""
        return 1.0

    @abstractmethod
    def points(self, s: float, length: float) -> Array:
        """Points (m, 2) in m of the tendons in the section at arclength ``s`` in m of a rod of ``length`` in m."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[Input, ...]:
        """The input ``name``, and others if there are any."""

    @abstractmethod
    def apply(self, motion: Any, loads: Loads) -> None:
        """Add the active stress of every tendon for a motion of the rod.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """

    @abstractmethod
    def describe(self, rod: Any) -> str:
        """One line for the table of the scene. ``rod`` is that of the scene."""

    @abstractmethod
    def pull(self, rod: Rod, rule: Rule) -> Pull:
        """What the input ``name`` may be on a rod with the nodes of ``rule``."""
