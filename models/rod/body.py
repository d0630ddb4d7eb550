"""The rod itself: length, cross-section, material and free strains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pisplit.checks import one_of, positive
from pisplit.models.rod.section import Elastic
from pisplit.models.rod.strains import STRAIN_SETS, StrainSet


class Section(Protocol):
    """What a rod asks of a cross-section: area in m^2, second moments in m^4 and the shear correction."""

    @property
    def area(self) -> float: ...
    @property
    def second_moments(self) -> tuple[float, float, float]: ...
    @property
    def shear_factor(self) -> float: ...


@dataclass(frozen=True)
class Rod:
    """A rod clamped at the origin, straight along +z when unloaded, free at the tip.

    Args:
        length: length L in m.
        section: cross-section, e.g. ``Circle(radius)``.
        material: ``Elastic(young, shear, density)``.
        strains: ``"cosserat"`` (bending, torsion, shear, stretch), ``"kirchhoff"`` (bending, torsion) or ``"planar"``
            (bending about body axis 2, motion in the x-z plane).
    """

    length: float
    section: Section
    material: Elastic
    strains: str = "kirchhoff"

    def __post_init__(self) -> None:
        positive(self.length, "Rod length", "m")
        one_of(self.strains, "Rod strains", tuple(STRAIN_SETS))

    @property
    def strain_set(self) -> StrainSet:
        """The strain set that ``strains`` names."""
        return STRAIN_SETS[self.strains]

    @property
    def rest_strains(self) -> tuple[float, ...]:
        """Rest values of (w1, w2, w3, v1, v2, v3): straight, unstretched."""
        return (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    @property
    def stiffness(self) -> tuple[float, ...]:
        """Stiffness of (w1, w2, w3) in N m^2 and of (v1, v2, v3) in N."""
        i1, i2, i3 = self.section.second_moments
        young, shear, area = self.material.young, self.material.shear, self.section.area
        k = self.section.shear_factor
        return (young * i1, young * i2, shear * i3, k * shear * area, k * shear * area, young * area)

    @property
    def mass_per_length(self) -> float:
        """rho A in kg/m."""
        return self.material.density * self.section.area

    @property
    def inertia_per_length(self) -> tuple[float, ...]:
        """rho J about the body axes in kg m."""
        return tuple(self.material.density * i for i in self.section.second_moments)

    @property
    def bending_rate(self) -> float:
        """First clamped-free bending frequency in rad/s (Euler-Bernoulli, beta L = 1.8751)."""
        stiffness = min(self.stiffness[:2])
        return float(1.8751040687119611**2 * np.sqrt(stiffness / (self.mass_per_length * self.length**4)))
