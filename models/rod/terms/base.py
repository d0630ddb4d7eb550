"""The base of the rod: how it is held, and how that moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, finite_array
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import BaseState, Motion
from pisplit.models.rod.kinematics.rotations import compose, exponential
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector

_ZERO = (0.0, 0.0, 0.0)
_MOTION = ("position", "rotation", "velocity", "acceleration", "spin", "spin_rate")


@dataclass(frozen=True)
class Base:
    """Prescribed pose and motion of the clamp; without it the clamp rests at the origin with its tangent along +z.

    A base with a ``hinge`` or ``slides`` is free in some directions, from the prescribed pose on: its joint coordinates
    (slides in m in their order, then the angle of a hinge in rad or the rotation vector of a ball joint) stand behind
    the strains of a state, so that no constraint drifts.

    Each argument is three numbers or an ``Input`` of size 3, in world axes. They are taken as they are given: whoever
    drives several of them sees to it that velocity and acceleration are the derivatives of the position (an arm on a
    shaker whose terms do not read positions and velocities needs the acceleration only). Statics of a rod on a moving
    base is the shape that rests relative to the base: under a constant acceleration, a constant spin, or towed through
    a medium.

    Args:
        position: of the clamp in m.
        rotation: rotation vector of the clamp in rad, e.g. (0, pi/2, 0) for a rod that starts along +x.
        velocity, acceleration: of the clamp in m/s, m/s^2.
        spin, spin_rate: angular velocity of the clamp and its rate in rad/s, rad/s^2.
        hinge: axis (3,) in world axes about which the base turns freely, any number of times; "ball" for all of them,
            up to a turn (the rotation vector is singular there). None: it does not turn by itself.
        slides: world axes along which it slides freely, some of "xyz".
        stiffness: of springs in the joint that pull it to the prescribed pose: N/m along slides, N m/rad about a hinge,
            one number for all of one kind of joint or one for each joint coordinate. A force or moment on the joint is
            ``PointWrench(0.0, ...)``.

    Raises ValueError for axes that are none, and for a rotation or spin prescribed beside a hinge.
    """

    position: Vector = _ZERO
    rotation: Vector = _ZERO
    velocity: Vector = _ZERO
    acceleration: Vector = _ZERO
    spin: Vector = _ZERO
    spin_rate: Vector = _ZERO
    hinge: Sequence[float] | str | None = None
    slides: str = ""
    stiffness: float | Sequence[float] = 0.0

    def __post_init__(self) -> None:
        for name in _MOTION:
            object.__setattr__(self, name, checked_vector(getattr(self, name), f"Base {name}"))
        named = isinstance(self.slides, str) and len(set(self.slides)) == len(self.slides)
        if not named or set(self.slides) - set("xyz"):
            raise ValueError(f"Base slides = {self.slides!r}; expected some of 'xyz', such as 'xy'")
        if isinstance(self.hinge, str) and self.hinge != "ball":
            raise ValueError(f"Base hinge = {self.hinge!r}; expected an axis such as (0, 1, 0), or 'ball'")
        if self.hinge is not None and self.hinge != "ball":
            axis = finite_array(self.hinge, "Base hinge", (3,))
            length = float(np.linalg.norm(axis))
            if length == 0.0:
                raise ValueError("Base hinge = (0, 0, 0); expected an axis such as (0, 1, 0), or 'ball'")
            object.__setattr__(self, "hinge", tuple((axis / length).tolist()))
        turns = isinstance(self.rotation, Input) or any(v != _ZERO for v in (self.spin, self.spin_rate))
        if self.hinge is not None and turns:
            raise ValueError("a Base with a hinge turns by itself; give its rotation as numbers, and no spin")
        self._check_springs()

    def _check_springs(self) -> None:
        """Raise ValueError for springs that are none, or that no joint has."""
        one = np.ndim(self.stiffness) == 0
        given = finite_array(self.stiffness, "Base stiffness", () if one else (self.freedom,))
        if one and not given:
            return
        if not self.freedom:
            raise ValueError(f"Base stiffness = {self.stiffness} of a base that is clamped; give hinge= or slides=")
        if one and self.slides and self.hinge is not None:
            names = ", ".join(self.joint_names)
            raise ValueError(f"Base stiffness = {self.stiffness} of slides and turns; give one number each: {names}")
        if given.min(initial=0.0) < 0.0:
            raise ValueError(f"Base stiffness = {self.stiffness} pushes the joint away; expected numbers >= 0")
        object.__setattr__(self, "stiffness", tuple(np.broadcast_to(given, self.freedom).tolist()))

    @property
    def springs(self) -> Array:
        """Stiffness of every joint coordinate (f,) in N/m and N m/rad."""
        return np.broadcast_to(np.asarray(self.stiffness, dtype=np.float64), self.freedom)

    @property
    def freedom(self) -> int:
        """Number of joint coordinates."""
        return len(self.slides) + (0 if self.hinge is None else 3 if self.hinge == "ball" else 1)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint coordinates."""
        turns = () if self.hinge is None else ("turn_x", "turn_y", "turn_z") if self.hinge == "ball" else ("angle",)
        return (*(f"slide_{axis}" for axis in self.slides), *turns)

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError for a joint that takes a planar rod out of its plane.

        ``rod`` and ``rule`` are those of the scene.
        """
        if not rod.strain_set.planar:
            return
        across = self.hinge is not None and (self.hinge == "ball" or any((self.hinge[0], self.hinge[2])))
        if across or "y" in self.slides:
            raise ValueError("the Base takes a planar rod out of its plane; give hinge=(0, 1, 0), slides of 'xz'")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those arguments that are inputs."""
        values = [getattr(self, name) for name in _MOTION]
        return tuple(v for v in values if isinstance(v, Input))

    @property
    def moves(self) -> bool:
        """Whether velocities or accelerations are prescribed."""
        rates = (self.velocity, self.acceleration, self.spin, self.spin_rate)
        return any(isinstance(v, Input) or any(v) for v in rates)

    def apply(self, motion: Motion, loads: Loads) -> None:
        """No load: the motion of the rod starts from this base.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """

    def state(
        self, inputs: dict[str, ca.SX], moving: bool, joint: tuple[ca.SX, ca.SX, ca.SX] | None = None
    ) -> BaseState:
        """Its motion in symbols; at rest unless ``moving``. ``inputs`` are symbols by name.

        ``joint`` are the joint coordinates (f,), their rates and accelerations; needed where there are any.
        """

        def read(name: str) -> ca.SX:
            value = getattr(self, name)
            return inputs[value.name] if isinstance(value, Input) else ca.sparsify(ca.SX(ca.DM(list(value))))

        zero = ca.SX(3, 1)
        turn = self.rotation
        quaternion = exponential(read("rotation")) if isinstance(turn, Input) else _quaternion(np.asarray(turn))
        rates = [read(n) if moving else zero for n in ("velocity", "acceleration", "spin", "spin_rate")]
        given = BaseState(read("position"), quaternion, *rates)
        return given if joint is None or not self.freedom else self._moved(given, *joint)

    def _moved(self, given: BaseState, q: ca.SX, q_t: ca.SX, q_tt: ca.SX) -> BaseState:
        """``given`` moved by the joint."""
        k = len(self.slides)
        shift, velocity, acceleration = (self._along @ part[:k] if k else ca.SX(3, 1) for part in (q, q_t, q_tt))
        turn, spin, spin_rate = self._turned(q[k:], q_t[k:], q_tt[k:])
        return BaseState(
            given.position + shift,
            given.quaternion if turn is None else compose(turn, given.quaternion),
            given.velocity + velocity,
            given.acceleration + acceleration,
            given.spin + spin,
            given.spin_rate + spin_rate,
        )

    @property
    def _along(self) -> ca.SX:
        """Directions (3, k) of the slides."""
        return ca.sparsify(ca.SX(ca.DM(np.eye(3)[:, ["xyz".index(axis) for axis in self.slides]])))

    @property
    def _axis(self) -> ca.SX:
        """Direction (3,) of the hinge."""
        return ca.sparsify(ca.SX(ca.DM(np.asarray(self.hinge, dtype=np.float64))))

    def _turned(self, q: ca.SX, q_t: ca.SX, q_tt: ca.SX) -> tuple[ca.SX | None, ca.SX, ca.SX]:
        """Quaternion, angular velocity and its rate by the turning joint coordinates."""
        if self.hinge is None:
            return None, ca.SX(3, 1), ca.SX(3, 1)
        if self.hinge == "ball":
            spin = _spinning(q) @ q_t
            return exponential(q), spin, ca.jtimes(spin, q, q_t) + _spinning(q) @ q_tt
        axis = self._axis
        return ca.vertcat(ca.cos(0.5 * q), ca.sin(0.5 * q) * axis), axis * q_t, axis * q_tt

    def joint_forces(self, force: ca.SX, moment: ca.SX, q: ca.SX) -> ca.SX:
        """What a world ``force`` (3,) in N and ``moment`` (3,) in N m at the base do to the joint coordinates ``q``."""
        k = len(self.slides)
        rows = [self._along.T @ force] if k else []
        if self.hinge == "ball":
            rows.append(_spinning(q[k:]).T @ moment)
        elif self.hinge is not None:
            rows.append(ca.dot(self._axis, moment))
        return ca.vertcat(*rows) - ca.sparsify(ca.SX(ca.DM(self.springs))) * q

    def describe(self, rod: Any) -> str:
        """What is prescribed. ``rod`` is that of the scene."""
        given = [f"{name} {getattr(self, name)}" for name in _MOTION if getattr(self, name) != _ZERO]
        free = [f"slides along {self.slides}"] if self.slides else []
        if self.hinge is not None:
            axis = "any axis" if self.hinge == "ball" else f"({', '.join(f'{v:g}' for v in self.hinge)})"
            free.append(f"turns about {axis}")
        if self.springs.any():
            free.append(f"springs of {', '.join(f'{k:g}' for k in self.springs)} N/m or N m/rad")
        return f"base {', '.join(given) or 'at the origin'}{''.join(f', {what}' for what in free)}"


def joint_of(terms: tuple[Any, ...]) -> Base | None:
    """The base among ``terms`` if it has joint coordinates."""
    found = [t for t in terms if isinstance(t, Base) and t.freedom]
    return found[0] if found else None


def joint_stiffness(rod: Rod, terms: tuple[Any, ...]) -> Array:
    """Stiffness of the ``rod`` that joint coordinates of the base among ``terms`` compare with: EI/L^3, EI/L (f,)."""
    base = joint_of(terms)
    if base is None:
        return np.zeros(0)
    turn = min(rod.stiffness[:2]) / rod.length
    slides = len(base.slides)
    return np.array([turn / rod.length**2] * slides + [turn] * (base.freedom - slides))


def _spinning(q: ca.SX) -> ca.SX:
    """Matrix (3, 3) from the rate of the rotation vector ``q`` to the angular velocity of exp(hat(q)), world axes.

    1 + a hat(q) + b hat(q)^2, a = (1 - cos t) / t^2, b = (t - sin t) / t^3, t = |q|, smoothed at zero as
    ``rotations.exponential`` is.
    """
    square = ca.dot(q, q) + 1e-12
    half = 0.5 * ca.sqrt(square)
    ratio = ca.sin(half) / half
    cross = ca.skew(q)
    return ca.SX.eye(3) + 0.5 * ratio**2 * cross + (1.0 - ratio * ca.cos(half)) / square * (cross @ cross)


def _quaternion(turn: np.ndarray) -> ca.SX:
    half = 0.5 * float(np.linalg.norm(turn))
    vector = 0.5 * np.sinc(half / np.pi) * turn
    return ca.SX(ca.DM([np.cos(half), *vector.tolist()]))
