"""The rod itself: length, cross-section, material, rest shape and free strains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import finite_array, one_of, positive
from pisplit.models.rod.kinematics.gauss import Array, CompositeRule, GaussRule, Rule
from pisplit.models.rod.kinematics.strains import STRAIN_SETS, StrainSet
from pisplit.models.rod.section.material import Material
from pisplit.models.rod.section.section import Section, Sections, Tapered, checked_section
from pisplit.models.rod.section.texts import OPTION, brief

#: Nodes an element for the means of a rod that varies along its length.
MEAN_NODES = 24

#: Three numbers, or a function of arclength s in m that returns them.
Curvature = Sequence[float] | Callable[[float], Sequence[float]]


@dataclass(frozen=True)
class Profile:
    """Constants of the rod at S arclengths.

    Attributes:
        stiffness: (6, S), of (w1, w2, w3) in N m^2 and of (v1, v2, v3) in N.
        mass: (S,) rho A in kg/m.
        area: (S,) in m^2.
        inertia: (3, S) rho J about the body axes in kg m.
        rest: (6, S) strains of the unloaded rod; w in 1/m.
    """

    stiffness: Array
    mass: Array
    area: Array
    inertia: Array
    rest: Array


@dataclass(frozen=True, repr=False)
class Rod:
    """A rod clamped at the origin with its tangent along +z there, free at the tip.

    Args:
        length: length L in m.
        section: cross-section, e.g. ``Circle(radius)``; where it varies, ``Tapered(start, end)``, a function
            s -> section of the arclength in m, or a tuple with one section an element.
        material: ``Elastic(young, shear, density)`` or ``Stiffness(...)``, or a function s -> material.
        strains: ``"cosserat"`` (bending, torsion, shear, stretch), ``"extensible"`` (without shear),
            ``"kirchhoff"`` (bending, torsion), ``"planar"`` (bending about body axis 2, motion in the x-z plane),
            ``"planar-cosserat"`` (the same with shear and stretch in that plane), or a ``StrainSet``.
        rest_curvature: (w1, w2, w3) of the unloaded rod in 1/m in body axes, or a function s -> (3,).
        elements: lengths in m of elements in a row, which add up to L. Strains are smooth within an element and may
            jump at its border: put one where the section, its slope or a load jumps. Empty: one element.
        kinks: pairs (s, vector) of an arclength in m at which an element ends and the rotation vector (3,) in rad, in
            the axes of the section before, by which the rod turns there rigidly; a section at s is the one behind.

    Raises ValueError for lengths, curvatures and materials that are none, and for a planar rod that is curved out of
    its plane.
    """

    length: float
    section: Sections
    material: Material | Callable[[float], Material]
    strains: str | StrainSet = "kirchhoff"
    rest_curvature: Curvature = field(default=(0.0, 0.0, 0.0), metadata=OPTION)
    elements: tuple[float, ...] = field(default=(), metadata=OPTION)
    kinks: tuple[tuple[float, tuple[float, ...]], ...] = field(default=(), metadata=OPTION)

    def __post_init__(self) -> None:
        positive(self.length, "Rod length", "m")
        if not isinstance(self.strains, StrainSet):
            one_of(self.strains, "Rod strains", tuple(STRAIN_SETS))
        self._check_elements()
        if not callable(self.rest_curvature):
            curvature = finite_array(self.rest_curvature, "Rod rest_curvature", (3,))
            object.__setattr__(self, "rest_curvature", tuple(curvature.tolist()))
        ends = [k * self.length for k in (0.0, 0.5, 1.0)]
        rest = self.profile(ends).rest
        if self.strain_set.planar and np.any(rest[[0, 2]]):
            raise ValueError("a planar rod is curved in its plane only; rest_curvature must be (0, w2, 0)")
        object.__setattr__(self, "kinks", self._checked_kinks())

    def _checked_kinks(self) -> tuple[tuple[float, tuple[float, ...]], ...]:
        ends, found = np.cumsum(self.elements)[:-1], list[tuple[float, tuple[float, ...]]]()
        try:
            pairs = [(float(place), vector) for place, vector in self.kinks]
        except (TypeError, ValueError):
            raise ValueError(
                f"Rod kinks = {self.kinks!r}; expected pairs (arclength in m, rotation vector (3,) in rad)"
            ) from None
        for place, vector in pairs:
            if not np.any(np.abs(ends - place) < 1e-9 * self.length):
                raise ValueError(f"Rod kinks at s = {place:g} m; expected the end of an element: give elements= too")
            turn = finite_array(vector, f"Rod kinks at s = {place:g} m", (3,)).tolist()
            if self.strain_set.planar and (turn[0] or turn[2]):
                raise ValueError("a planar rod turns in its plane only; kinks must be (s, (0, angle, 0))")
            if any(abs(place - known) < 1e-9 * self.length for known, _ in found):
                raise ValueError(f"Rod kinks has two at s = {place:g} m; give one rotation vector for both")
            if any(turn):
                found.append((place, tuple(turn)))
        return tuple(found)

    def _check_elements(self) -> None:
        try:
            given = tuple(self.elements)
        except TypeError:
            raise ValueError(
                f"Rod elements = {self.elements!r}; expected lengths in m, such as (0.2, 0.3), () for one element"
            ) from None
        lengths = tuple(positive(e, f"Rod elements[{k}]", "m") for k, e in enumerate(given))
        object.__setattr__(self, "elements", lengths)
        if lengths and not np.isclose(sum(lengths), self.length, rtol=1e-9, atol=0.0):
            raise ValueError(f"Rod elements add up to {sum(lengths):g} m; expected the length {self.length:g} m")
        if isinstance(self.section, tuple) and len(self.section) != max(1, len(lengths)):
            raise ValueError(
                f"Rod has {len(self.section)} sections for {max(1, len(lengths))} elements; give one an element"
            )

    __repr__ = brief

    @property
    def strain_set(self) -> StrainSet:
        """The strain set that ``strains`` names."""
        return self.strains if isinstance(self.strains, StrainSet) else STRAIN_SETS[self.strains]

    @property
    def uniform(self) -> bool:
        """Whether section and material are the same everywhere."""
        return isinstance(self.section, Section) and isinstance(self.material, Material)

    # Along the rod ---------------------------------------------------------------------------------------------------

    def section_at(self, s: float) -> Section:
        """The cross-section at arclength ``s`` in m; a border belongs to the element before it."""
        if isinstance(self.section, tuple):
            owner = int(np.searchsorted(np.cumsum(self.elements)[:-1], s, side="left")) if self.elements else 0
            return checked_section(self.section[owner], s)
        if isinstance(self.section, Tapered):
            return checked_section(self.section.between(s / self.length), s)
        return checked_section(self.section(s) if callable(self.section) else self.section, s)

    def material_at(self, s: float) -> Material:
        """The material at arclength ``s`` in m."""
        material = self.material(s) if callable(self.material) else self.material
        if not isinstance(material, Material):
            raise ValueError(f"Rod material at s = {s:g} m is {material!r}; expected one such as Elastic(...)")
        return material

    def rest_curvature_at(self, s: float) -> tuple[float, ...]:
        """(w1, w2, w3) of the unloaded rod in 1/m at arclength ``s`` in m."""
        value = self.rest_curvature(s) if callable(self.rest_curvature) else self.rest_curvature
        return tuple(finite_array(value, f"Rod rest_curvature at s = {s:g} m", (3,)).tolist())

    def profile(self, s: ArrayLike) -> Profile:
        """Constants of the rod at arclengths ``s`` (S,) in m."""
        points = np.atleast_1d(np.asarray(s, float)).tolist()
        sections = [self.section_at(p) for p in points]
        materials = [self.material_at(p) for p in points]
        pairs = list(zip(sections, materials, strict=True))
        return Profile(
            stiffness=np.array([m.stiffness(c) for c, m in pairs], float).T,
            mass=np.array([m.density * c.area for c, m in pairs]),
            area=np.array([c.area for c in sections]),
            inertia=np.array([[m.density * i for i in c.second_moments] for c, m in pairs]).T,
            rest=np.array([[*self.rest_curvature_at(p), 0.0, 0.0, 1.0] for p in points]).T,
        )

    def rule(self, nodes: Sequence[int]) -> Rule:
        """Gauss nodes: so many on every element."""
        if len(nodes) == 1:
            return GaussRule(self.length, nodes[0])
        return CompositeRule(tuple(GaussRule(e, k) for e, k in zip(self.elements, nodes, strict=True)))

    # Means -----------------------------------------------------------------------------------------------------------

    @cached_property
    def _means(self) -> tuple[tuple[float, ...], float, tuple[float, ...]]:
        if self.uniform:
            at = self.profile(0.0)
            return tuple(at.stiffness[:, 0].tolist()), float(at.mass[0]), tuple(at.inertia[:, 0].tolist())
        rule = self.rule([MEAN_NODES] * max(1, len(self.elements)))
        along, share = self.profile(rule.nodes), rule.weights / self.length
        stiffness = 1.0 / ((1.0 / along.stiffness) @ share)
        return tuple(stiffness.tolist()), float(along.mass @ share), tuple((along.inertia @ share).tolist())

    @property
    def stiffness(self) -> tuple[float, ...]:
        """Stiffness of (w1, w2, w3) in N m^2 and of (v1, v2, v3) in N; the harmonic mean where it varies."""
        return self._means[0]

    @property
    def mass_per_length(self) -> float:
        """rho A in kg/m; its mean where it varies."""
        return self._means[1]

    @property
    def inertia_per_length(self) -> tuple[float, ...]:
        """rho J about the body axes in kg m; its mean where it varies."""
        return self._means[2]

    @property
    def bending_rate(self) -> float:
        """First clamped-free bending frequency in rad/s (Euler-Bernoulli, beta L = 1.8751), of the mean rod."""
        stiffness = min(self.stiffness[:2])
        return float(1.8751040687119611**2 * np.sqrt(stiffness / (self.mass_per_length * self.length**4)))

    @property
    def natural_rates(self) -> tuple[float, ...]:
        """Lowest natural frequencies in rad/s of the mean rod that move (w1, w2, w3, v1, v2, v3).

        Bending: ``bending_rate``; torsion and stretch: a quarter of a wave in L; shear: thickness shear, the root of
        shear stiffness over rotary inertia. None is below that of bending.
        """
        quarter = 0.5 * np.pi / self.length
        torsion = quarter * np.sqrt(self.stiffness[2] / self.inertia_per_length[2])
        stretch = quarter * np.sqrt(self.stiffness[5] / self.mass_per_length)
        shear = np.sqrt(np.array(self.stiffness[3:5]) / np.array(self.inertia_per_length[1::-1]))
        bending = self.bending_rate
        return tuple(max(bending, float(rate)) for rate in (bending, bending, torsion, *shear, stretch))
