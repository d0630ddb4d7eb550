"""Buoyancy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pisplit.checks import non_negative
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.loads import Input, Loads, spread


@dataclass(frozen=True)
class Buoyancy:
    """Weight of the displaced medium, -rho_medium A g per length, with the gravity of the scene; needs a ``Gravity``.

    Args:
        density: of the medium in kg/m^3. The pressure on the end faces is that of a closed rod in uniform pressure: the
            load per length is exact for slender rods (Archimedes section by section). Added mass is not in it.
    """

    density: float

    def __post_init__(self) -> None:
        non_negative(self.density, "Buoyancy density", "kg/m^3")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add -rho_medium A g at every node."""
        loads.force -= spread(loads.gravity, self.density * motion.profile.area)

    def describe(self, rod: Any) -> str:
        """Density of the medium."""
        return f"buoyancy in a medium of {self.density:g} kg/m^3"
