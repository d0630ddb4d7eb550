"""Loads and masses at points of the rod."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from pisplit.checks import finite_array, non_negative, positive
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import joint_of
from pisplit.models.rod.terms.idle import idle_wrench
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector, on_the_rod


@dataclass(frozen=True)
class PointWrench:
    """Force in N and moment in N m at arclength ``s`` in m; each three numbers or an ``Input`` of size 3.

    Components are in world axes (a dead load) or, with ``follower=True``, in the axes of the cross-section at ``s``.
    Below the point the rod carries the load and above it does not: exact where an element ends at ``s``, within the
    smoothness of the strains otherwise (its work is exact either way). At ``s = 0`` it acts on a base with a hinge or
    slides.

    Args:
        s: arclength in m.
        force, moment: components in N and N m.
        follower: whether they turn with the cross-section.
    """

    s: float
    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    follower: bool = False

    def __post_init__(self) -> None:
        non_negative(self.s, "PointWrench s", "m")
        object.__setattr__(self, "force", checked_vector(self.force, "PointWrench force"))
        object.__setattr__(self, "moment", checked_vector(self.moment, "PointWrench moment"))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those of force and moment that are inputs."""
        return tuple(v for v in (self.force, self.moment) if isinstance(v, Input))

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError where ``s`` is off the rod. ``rod`` and ``rule``, its nodes, are those of the scene."""
        if self.s:
            on_the_rod(self.s, rod.length, "PointWrench")

    def jumps(self, rod: Rod) -> list[float]:
        """Where the load of the ``rod`` jumps."""
        return [self.s] if self.s else []

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the wrench at ``s``. ``motion`` is that of the rod; ``loads`` takes what is added."""
        force, moment = loads.read(self.force), loads.read(self.moment)
        if self.follower:
            frame = motion.frame_at(self.s)
            force, moment = frame @ force, frame @ moment
        loads.add_at(motion, self.s, ca.sparsify(force), ca.sparsify(moment))

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Why it acts on nothing, if so: it is on a clamped base, or across the plane of a planar ``rod``.

        ``rod`` and ``terms`` are those of the scene.
        """
        if not self.s and joint_of(terms) is None:
            return "acts on a base that is clamped; give it s > 0, or a Base with hinge= or slides="
        return idle_wrench(self.force, self.moment, rod, terms)

    def describe(self, rod: Any) -> str:
        """Place, force and moment. ``rod`` is that of the scene."""
        kind = "follower" if self.follower else "dead"
        return f"{kind} wrench at s = {self.s:g} m, force {self.force} N, moment {self.moment} N m"


@dataclass(frozen=True)
class Spring:
    """Linear spring from a point of the rod to a point of the world; force k (|d| - l0) along d, the way to that point.

    Args:
        point: in m in world axes, or an ``Input`` of size 3.
        stiffness: k in N/m.
        rest_length: l0 in m; with 0 the force is k d.
        s: arclength in m where it is attached, the tip when not given.
    """

    point: Vector
    stiffness: float
    rest_length: float = 0.0
    s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", checked_vector(self.point, "Spring point"))
        non_negative(self.stiffness, "Spring stiffness", "N/m")
        non_negative(self.rest_length, "Spring rest_length", "m")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The point, when it is an input."""
        return (self.point,) if isinstance(self.point, Input) else ()

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError where ``s`` is off the rod. ``rod`` and ``rule``, its nodes, are those of the scene."""
        if self.s is not None:
            on_the_rod(self.s, rod.length, "Spring")

    def jumps(self, rod: Rod) -> list[float]:
        """Where the load of the ``rod`` jumps."""
        return [] if self.s is None else [self.s]

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the force at ``s``. ``motion`` is that of the rod; ``loads`` takes what is added."""
        if self.stiffness == 0.0:
            return
        s = motion.rod.length if self.s is None else self.s
        here = motion.tip if motion.is_tip(s) else motion.position_at([s])
        way = loads.read(self.point) - here
        force = self.stiffness * way
        if self.rest_length > 0.0:  # rounded over 1e-6 of the rest length where the ends meet
            force -= (
                self.stiffness * self.rest_length * way / ca.sqrt(ca.dot(way, way) + (1e-6 * self.rest_length) ** 2)
            )
        loads.add_at(motion, s, force, ca.SX(3, 1))

    def describe(self, rod: Any) -> str:
        """Ends and stiffness. ``rod`` is that of the scene."""
        place = "the tip" if self.s is None else f"s = {self.s:g} m"
        return f"spring from {place} to {self.point}, {self.stiffness:g} N/m, rest length {self.rest_length:g} m"


@dataclass(frozen=True)
class PointMass:
    """A rigid body fixed to the rod at arclength ``s``: its weight (with the gravity of the scene) and its inertia.

    The load is the exact adjoint of the interpolated motion of its centre, so that the mass matrix stays symmetric.

    Args:
        s: arclength in m.
        mass: in kg.
        inertia: moments of inertia about the body axes through its centre of mass in kg m^2.
        offset: centre of mass in the axes of the cross-section in m.
    """

    s: float
    mass: float
    inertia: Sequence[float] = (0.0, 0.0, 0.0)
    offset: Sequence[float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        positive(self.s, "PointMass s", "m")
        non_negative(self.mass, "PointMass mass", "kg")
        inertia = finite_array(self.inertia, "PointMass inertia", (3,)).tolist()
        object.__setattr__(self, "inertia", tuple(non_negative(j, "PointMass inertia", "kg m^2") for j in inertia))
        offset = finite_array(self.offset, "PointMass offset", (3,)).tolist()
        object.__setattr__(self, "offset", tuple(offset))

    @classmethod
    def disc(cls, s: float, mass: float, radius: float, thickness: float = 0.0) -> PointMass:
        """A round disc across the rod at arclength ``s`` in m, centred on it.

        Args:
            s: arclength in m.
            mass: in kg.
            radius: in m.
            thickness: in m, along the rod.
        """
        non_negative(mass, "disc mass", "kg")
        non_negative(radius, "disc radius", "m")
        non_negative(thickness, "disc thickness", "m")
        across = mass * (radius**2 / 4.0 + thickness**2 / 12.0)
        return cls(s, mass, (across, across, mass * radius**2 / 2.0))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError where ``s`` is off the rod. ``rod`` and ``rule``, its nodes, are those of the scene."""
        on_the_rod(self.s, rod.length, "PointMass")

    def jumps(self, rod: Rod) -> list[float]:
        """Where the load of the ``rod`` jumps."""
        return [self.s]

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add weight m g and inertia -m a at the centre of mass, and the rate of its angular momentum.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """
        add_mass(motion, loads, self.s, self.mass, self.offset)
        if loads.moving and any(self.inertia):
            frame, j = motion.frame_at(self.s), ca.sparsify(ca.SX(ca.DM(list(self.inertia))))
            omega, alpha = frame.T @ motion.spin_at([self.s]), frame.T @ motion.spin_rate_at([self.s])
            loads.add_at(motion, self.s, ca.SX(3, 1), -frame @ (j * alpha + ca.cross(omega, j * omega)))

    def describe(self, rod: Any) -> str:
        """Place and mass. ``rod`` is that of the scene."""
        inertia = f", inertia {_short(self.inertia)} kg m^2" if any(self.inertia) else ""
        offset = f", offset {_short(self.offset)} m" if any(self.offset) else ""
        return f"mass {self.mass:g} kg at s = {self.s:g} m{inertia}{offset}"


def add_mass(
    motion: Motion, loads: Loads, s: float, mass: float | ca.SX, offset: Sequence[float] = (0.0, 0.0, 0.0)
) -> None:
    """Weight and inertia of a mass in kg, a number or an expression, at arclength ``s`` and ``offset`` in m.

    ``offset`` is in the axes of the cross-section. Without mass nothing is added.

    ``motion`` is that of the rod; ``loads`` takes what is added.
    """
    if not isinstance(mass, ca.SX) and mass == 0.0:
        return
    centred = not any(offset)
    arm = ca.SX(3, 1) if centred else motion.frame_at(s) @ ca.SX(ca.DM(list(offset)))
    if loads.gravity.nnz() > 0:
        weight = mass * loads.gravity
        loads.add_at(motion, s, weight, ca.SX(3, 1) if centred else ca.cross(arm, weight))
    if not loads.moving:
        return
    acceleration = motion.acceleration_at([s])
    if not centred:
        spin, rate = motion.spin_at([s]), motion.spin_rate_at([s])
        acceleration += ca.cross(rate, arm) + ca.cross(spin, ca.cross(spin, arm))
    force = -mass * acceleration
    loads.add_inertia_at(motion, s, force)
    if not centred:
        loads.add_at(motion, s, ca.SX(3, 1), ca.cross(arm, force))


def _short(values: Sequence[float]) -> str:
    return f"({', '.join(f'{v:g}' for v in values)})"
