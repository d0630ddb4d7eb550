"""Gravity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.idle import idle_force
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector, spread


@dataclass(frozen=True)
class Gravity:
    """Uniform acceleration of gravity (3,) in m/s^2 in world axes, or an ``Input`` of size 3."""

    acceleration: Vector

    def __post_init__(self) -> None:
        object.__setattr__(self, "acceleration", checked_vector(self.acceleration, "Gravity acceleration"))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The acceleration, when it is an input."""
        return (self.acceleration,) if isinstance(self.acceleration, Input) else ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Weight per length rho A g at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        gravity = loads.read(self.acceleration)
        loads.gravity += gravity
        loads.force += spread(gravity, motion.profile.mass)

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Why it acts on nothing, if so: it is across the plane of a planar ``rod``.

        ``rod`` and ``terms`` are those of the scene.
        """
        return idle_force(self.acceleration, rod, terms)

    def describe(self, rod: Any) -> str:
        """Acceleration in m/s^2. ``rod`` is that of the scene."""
        return f"gravity {self.acceleration} m/s^2"
