"""Cross-sections of a rod, constant or varying along it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import numpy as np

from pisplit.checks import finite_array, finite_number, positive, real_array


@runtime_checkable
class Section(Protocol):
    """What a rod asks of a cross-section.

    ``area`` in m^2; ``second_moments`` of area about the body axes 1, 2 (bending) and 3 (polar) and
    ``torsion_constant`` in m^4 (the polar moment for circles, less for other shapes); ``shear_factors`` along the axes
    1 and 2 (Timoshenko).
    """

    @property
    def area(self) -> float:
        """Area in m^2."""

    @property
    def second_moments(self) -> tuple[float, float, float]:
        """About the axes 1, 2 and 3 in m^4."""

    @property
    def torsion_constant(self) -> float:
        """In m^4."""

    @property
    def shear_factors(self) -> tuple[float, float]:
        """Along the axes 1 and 2."""


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

    @property
    def torsion_constant(self) -> float:
        """Polar second moment in m^4."""
        return self.second_moments[2]

    @property
    def shear_factors(self) -> tuple[float, float]:
        """The shear correction, the same in both directions."""
        return (self.shear_factor, self.shear_factor)


@dataclass(frozen=True)
class Tube:
    """Hollow circular cross-section.

    Args:
        outer, inner: radii in m, ``inner < outer``.
        shear_factor: Timoshenko shear correction (1 = none).

    Raises ValueError for an ``inner`` radius that is not below the outer one.
    """

    outer: float
    inner: float
    shear_factor: float = 1.0

    def __post_init__(self) -> None:
        positive(self.outer, "Tube outer", "m")
        positive(self.inner, "Tube inner", "m")
        positive(self.shear_factor, "Tube shear_factor")
        if self.inner >= self.outer:
            raise ValueError(f"Tube inner = {self.inner:g} m; expected less than the outer radius {self.outer:g} m")

    @property
    def area(self) -> float:
        """Area in m^2."""
        return float(np.pi * (self.outer**2 - self.inner**2))

    @property
    def second_moments(self) -> tuple[float, float, float]:
        """Second moments of area about the body axes 1, 2 (bending) and 3 (polar) in m^4."""
        bending = float(np.pi * (self.outer**4 - self.inner**4) / 4.0)
        return (bending, bending, 2.0 * bending)

    @property
    def torsion_constant(self) -> float:
        """Polar second moment in m^4."""
        return self.second_moments[2]

    @property
    def shear_factors(self) -> tuple[float, float]:
        """The shear correction, the same in both directions."""
        return (self.shear_factor, self.shear_factor)


@dataclass(frozen=True)
class GeneralSection:
    """Any cross-section whose body axes 1 and 2 are principal axes through its centroid.

    Args:
        area: area in m^2.
        second_moments: second moments of area about the body axes 1 and 2 in m^4.
        torsion_constant: torsion constant in m^4; the polar moment (their sum) when not given, which only circles and
            tubes reach.
        shear_factors: Timoshenko shear corrections along the axes 1 and 2.
    """

    area: float
    second_moments: tuple[float, ...]
    torsion_constant: float = np.nan
    shear_factors: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        positive(self.area, "GeneralSection area", "m^2")
        moments = np.atleast_1d(real_array(self.second_moments, "GeneralSection second_moments"))
        i1, i2 = finite_array(moments[:2], "GeneralSection second_moments", (2,)).tolist()
        positive(i1, "GeneralSection second_moments[0]", "m^4")
        positive(i2, "GeneralSection second_moments[1]", "m^4")
        factors = finite_array(self.shear_factors, "GeneralSection shear_factors", (2,)).tolist()
        for k, factor in enumerate(factors):
            positive(factor, f"GeneralSection shear_factors[{k}]")
        torsion = i1 + i2 if np.isnan(self.torsion_constant) else self.torsion_constant
        object.__setattr__(self, "second_moments", (i1, i2, i1 + i2))
        object.__setattr__(self, "shear_factors", tuple(factors))
        object.__setattr__(self, "torsion_constant", positive(torsion, "GeneralSection torsion_constant", "m^4"))


@dataclass(frozen=True)
class Tapered:
    """A section whose dimensions change linearly with arclength from ``start`` at the base to ``end`` at the tip.

    Args:
        start, end: two sections of one type, e.g. ``Tapered(Circle(2e-3), Circle(1e-3))``.

    Raises ValueError for sections of two types.
    """

    start: Section
    end: Section

    def __post_init__(self) -> None:
        if type(self.start) is not type(self.end):
            raise ValueError(
                f"Tapered goes from {type(self.start).__name__} to {type(self.end).__name__}; give sections of one type"
            )

    def between(self, fraction: float) -> Section:
        """The section at ``fraction`` of the length, 0 at the base and 1 at the tip."""
        mixed = {}
        for item in fields(self.start):  # type: ignore[arg-type]
            a, b = np.asarray(getattr(self.start, item.name)), np.asarray(getattr(self.end, item.name))
            value = (1.0 - fraction) * a + fraction * b
            mixed[item.name] = float(value) if value.ndim == 0 else tuple(value.tolist())
        section: Section = type(self.start)(**mixed)
        return section


#: A constant section, one an element, or one that varies with arclength s in m.
Sections = Section | tuple[Section, ...] | Tapered | Callable[[float], Section]


def checked_section(value: object, s: float) -> Section:
    """``value`` as a section, named by the arclength it belongs to. ``s`` in m."""
    if not isinstance(value, Section):
        raise ValueError(f"Rod section at s = {s:g} m is {value!r}; expected a section such as Circle(radius)")
    positive(value.area, f"Rod section area at s = {s:g} m", "m^2")
    for number in (*value.second_moments, value.torsion_constant, *value.shear_factors):
        finite_number(number, f"Rod section at s = {s:g} m")
    return value
