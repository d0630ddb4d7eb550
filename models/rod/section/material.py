"""Materials of a rod."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from pisplit.checks import positive
from pisplit.models.rod.section.section import Section


@runtime_checkable
class Material(Protocol):
    """What a rod asks of its material: ``density`` in kg/m^3 and the stiffness of each strain of a section."""

    @property
    def density(self) -> float:
        """In kg/m^3."""

    def stiffness(self, section: Section) -> tuple[float, ...]:
        """Stiffness of (w1, w2, w3) in N m^2 and of (v1, v2, v3) in N. ``section`` is the cross-section."""


@dataclass(frozen=True)
class Elastic:
    """Linear elastic material: Young's modulus and shear modulus in Pa, density in kg/m^3.

    Args:
        young, shear: moduli in Pa.
        density: in kg/m^3.
    """

    young: float
    shear: float
    density: float

    def __post_init__(self) -> None:
        positive(self.young, "Elastic young", "Pa")
        positive(self.shear, "Elastic shear", "Pa")
        positive(self.density, "Elastic density", "kg/m^3")

    def stiffness(self, section: Section) -> tuple[float, ...]:
        """(E I1, E I2, G J) in N m^2 and (k1 G A, k2 G A, E A) in N. ``section`` is the cross-section."""
        i1, i2, _ = section.second_moments
        k1, k2 = section.shear_factors
        young, shear, area = self.young, self.shear, section.area
        return (
            young * i1,
            young * i2,
            shear * section.torsion_constant,
            k1 * shear * area,
            k2 * shear * area,
            young * area,
        )


@dataclass(frozen=True)
class Stiffness:
    """Stiffness of every strain by number, in place of elastic constants and section geometry (braids, composites).

    The section still gives area and second moments for mass and rotary inertia.

    Args:
        bending: stiffness about the body axes 1 and 2 in N m^2.
        torsion: stiffness in N m^2.
        shear: stiffness along the body axes 1 and 2 in N.
        stretch: stiffness in N.
        density: density in kg/m^3.

    Raises ValueError where bending and shear are not two numbers each.
    """

    bending: tuple[float, float]
    torsion: float
    shear: tuple[float, float]
    stretch: float
    density: float

    def __post_init__(self) -> None:
        for name in ("bending", "shear"):
            values = getattr(self, name)
            if not isinstance(values, tuple | list) or len(values) != 2:
                raise ValueError(f"Stiffness {name} = {values!r}; expected two numbers, one for each body axis")
            object.__setattr__(self, name, tuple(positive(v, f"Stiffness {name}") for v in values))
        positive(self.torsion, "Stiffness torsion", "N m^2")
        positive(self.stretch, "Stiffness stretch", "N")
        positive(self.density, "Stiffness density", "kg/m^3")

    def stiffness(self, section: Section) -> tuple[float, ...]:
        """The numbers themselves, whatever the section."""
        return (*self.bending, self.torsion, *self.shear, self.stretch)
