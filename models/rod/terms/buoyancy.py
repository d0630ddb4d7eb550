"""Buoyancy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pisplit.checks import non_negative
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.loads import Input, Loads, spread

#: Terms of other modules may bring gravity of their own.
_OURS = "pisplit."


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
        """Add -rho_medium A g at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        if self.density == 0.0:
            return
        loads.force -= spread(loads.gravity, self.density * motion.profile.area)

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Why it acts on nothing, if so: nothing among the ``terms`` has brought gravity.

        ``rod`` and ``terms`` are those of the scene.
        """
        gravity = [t for t in terms if isinstance(t, Gravity) or not type(t).__module__.startswith(_OURS)]
        return None if gravity or self.density == 0.0 else "has no effect without gravity; add a Gravity"

    def describe(self, rod: Any) -> str:
        """Density of the medium. ``rod`` is that of the scene."""
        return f"buoyancy in a medium of {self.density:g} kg/m^3"
