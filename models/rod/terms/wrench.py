"""Loads at the tip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.idle import idle_wrench
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector


@dataclass(frozen=True)
class TipWrench:
    """Force in N and moment in N m at the tip; each three numbers or an ``Input`` of size 3.

    Args:
        force, moment: components in world axes (a dead load) or, with ``follower=True``, in the axes of the tip.
    """

    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    follower: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", checked_vector(self.force, "TipWrench force"))
        object.__setattr__(self, "moment", checked_vector(self.moment, "TipWrench moment"))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those of force and moment that are inputs."""
        return tuple(v for v in (self.force, self.moment) if isinstance(v, Input))

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the wrench at the tip. ``motion`` is that of the rod; ``loads`` takes what is added."""
        force, moment = loads.read(self.force), loads.read(self.moment)
        if self.follower:
            force, moment = motion.tip_frame @ force, motion.tip_frame @ moment
        loads.tip_force += force
        loads.tip_moment += moment

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Why it acts on nothing, if so: all of it is across the plane of a planar ``rod``.

        ``rod`` and ``terms`` are those of the scene.
        """
        return idle_wrench(self.force, self.moment, rod, terms)

    def describe(self, rod: Any) -> str:
        """Force and moment. ``rod`` is that of the scene."""
        kind = "follower" if self.follower else "dead"
        return f"{kind} tip wrench, force {self.force} N, moment {self.moment} N m"
