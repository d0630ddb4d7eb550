"""The base of the rod: where it is clamped, and how that moves."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from pisplit.models.rod.kinematics.kinematics import BaseState, Motion
from pisplit.models.rod.kinematics.rotations import exponential
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector

_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Base:
    """Prescribed pose and motion of the clamp; without it the clamp rests at the origin with its tangent along +z.

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
    """

    position: Vector = _ZERO
    rotation: Vector = _ZERO
    velocity: Vector = _ZERO
    acceleration: Vector = _ZERO
    spin: Vector = _ZERO
    spin_rate: Vector = _ZERO

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(self, item.name, checked_vector(getattr(self, item.name), f"Base {item.name}"))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those arguments that are inputs."""
        values = [getattr(self, item.name) for item in fields(self)]
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

    def state(self, inputs: dict[str, ca.SX], moving: bool) -> BaseState:
        """Its motion in symbols; at rest unless ``moving``. ``inputs`` are symbols by name."""

        def read(name: str) -> ca.SX:
            value = getattr(self, name)
            return inputs[value.name] if isinstance(value, Input) else ca.sparsify(ca.SX(ca.DM(list(value))))

        zero = ca.SX(3, 1)
        turn = self.rotation
        quaternion = exponential(read("rotation")) if isinstance(turn, Input) else _quaternion(np.asarray(turn))
        rates = [read(n) if moving else zero for n in ("velocity", "acceleration", "spin", "spin_rate")]
        return BaseState(read("position"), quaternion, *rates)

    def describe(self, rod: Any) -> str:
        """What is prescribed. ``rod`` is that of the scene."""
        given = [f"{f.name} {getattr(self, f.name)}" for f in fields(self) if getattr(self, f.name) != _ZERO]
        return f"base {', '.join(given) or 'at the origin'}"


def _quaternion(turn: np.ndarray) -> ca.SX:
    half = 0.5 * float(np.linalg.norm(turn))
    vector = 0.5 * np.sinc(half / np.pi) * turn
    return ca.SX(ca.DM([np.cos(half), *vector.tolist()]))
