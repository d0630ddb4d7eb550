"""Cross-sections and materials of a rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import positive


@dataclass(frozen=True)
class Circle:
    """Solid circular cross-section.

    Args:
        radius: radius in m.
        shear_factor: Timoshenko shear correction (1 = none).
    """

    radius: float
    shear_factor: float = 1.0

    def __post_init__(self) -> None:
        positive(self.radius, "Circle radius", "m")
        positive(self.shear_factor, "Circle shear_factor")

    @property
    def area(self) -> float:
        """Area in m^2."""
        return float(np.pi * self.radius**2)

    @property
    def second_moments(self) -> tuple[float, float, float]:
        """Second moments of area about the body axes 1, 2 (bending) and 3 (polar) in m^4."""
        bending = float(np.pi * self.radius**4 / 4.0)
        return (bending, bending, 2.0 * bending)


@dataclass(frozen=True)
class Elastic:
    """Linear elastic material: Young's modulus and shear modulus in Pa, density in kg/m^3."""

    young: float
    shear: float
    density: float

    def __post_init__(self) -> None:
        positive(self.young, "Elastic young", "Pa")
        positive(self.shear, "Elastic shear", "Pa")
        positive(self.density, "Elastic density", "kg/m^3")
