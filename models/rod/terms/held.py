"""A tip that is held: pinned, clamped, sliding, or driven along a given motion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.kinematics.rotations import exponential, rotation_matrix
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector

_ZERO = (0.0, 0.0, 0.0)
#: Names of the inputs of a driven tip.
DRIVEN = ("position", "rotation", "velocity", "acceleration", "spin", "spin_rate")


@dataclass(frozen=True)
class HeldTip:
    """Prescribed pose of the tip: whatever wrench it takes acts there, see ``Scene.reactions``.

    Pinned with a position, clamped with a rotation beside it, sliding with some ``axes`` of the position alone. Each
    argument is three numbers or an ``Input`` of size 3, in world axes. A tip that moves takes velocity and acceleration
    (spin and its rate) beside its position (rotation); they are taken as they are given, see ``dynamics.driven`` for
    rows of inputs that fit one another.

    Args:
        position: of the tip in m; None leaves it free.
        rotation: rotation vector of the tip in rad, many turns are many times 2 pi; None lets it turn freely.
        axes: world axes along which the position is prescribed, e.g. "xy" for a tip that slides along z.
        velocity, acceleration: of the tip in m/s, m/s^2.
        spin, spin_rate: angular velocity of the tip and its rate in rad/s, rad/s^2.

    Raises ValueError where nothing is held, for axes that are none, and for velocities without a position or rotation.
    """

    position: Vector | None = None
    rotation: Vector | None = None
    axes: str = "xyz"
    velocity: Vector = _ZERO
    acceleration: Vector = _ZERO
    spin: Vector = _ZERO
    spin_rate: Vector = _ZERO

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "axes" and value is not None:
                object.__setattr__(self, item.name, checked_vector(value, f"HeldTip {item.name}"))
        if self.position is None and self.rotation is None:
            raise ValueError("HeldTip holds nothing; give a position, a rotation or both")
        named = isinstance(self.axes, str) and len(set(self.axes)) == len(self.axes) > 0
        if not named or set(self.axes) - set("xyz"):
            raise ValueError(f"HeldTip axes = {self.axes!r}; expected some of 'xyz', such as 'xy'")
        if self.rotation is None and (self.spin != _ZERO or self.spin_rate != _ZERO):
            raise ValueError("HeldTip has a spin and no rotation; give the rotation that it turns from")
        if self.position is None and (self.velocity != _ZERO or self.acceleration != _ZERO):
            raise ValueError("HeldTip has a velocity and no position; give the position that it starts from")

    @classmethod
    def driven(cls, rotation: bool = False) -> HeldTip:
        """A tip whose motion is an input: "tip position", "tip velocity", "tip acceleration".

        With ``rotation`` also "tip rotation", "tip spin" and "tip spin_rate". ``pisplit.models.rod.tip_commands`` makes
        rows of them.
        """
        names = DRIVEN if rotation else ("position", "velocity", "acceleration")
        given: dict[str, Any] = {name: Input(f"tip {name}", 3) for name in names}
        return cls(**given)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those arguments that are inputs."""
        values = [getattr(self, name) for name in DRIVEN]
        return tuple(v for v in values if isinstance(v, Input))

    @property
    def moves(self) -> bool:
        """Whether the pose may change over time."""
        rates = (self.velocity, self.acceleration, self.spin, self.spin_rate)
        return bool(self.inputs) or any(any(v) for v in rates if not isinstance(v, Input))

    def held_axes(self, planar: bool) -> list[int]:
        """World axes along which the position is prescribed; a ``planar`` rod stays in its plane by itself."""
        held = [] if self.position is None else ["xyz".index(axis) for axis in self.axes]
        return sorted(k for k in held if not (planar and k == 1))

    def held_turns(self, planar: bool) -> list[int]:
        """Axes of the prescribed frame about which the tip does not turn; one for a ``planar`` rod."""
        return [] if self.rotation is None else [1] if planar else [0, 1, 2]

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError for a pose that a planar rod cannot take. ``rod`` and ``rule`` are those of the scene."""
        if not rod.strain_set.planar:
            return
        if not self.held_axes(True) and not self.held_turns(True):
            raise ValueError("HeldTip holds a planar rod across its plane alone; hold it along x or z or about y")
        across = [] if self.position is None or isinstance(self.position, Input) else [self.position[1]]
        if self.rotation is not None and not isinstance(self.rotation, Input):
            across += [self.rotation[0], self.rotation[2]]
        if any(across):
            raise ValueError("HeldTip takes a planar rod out of the x-z plane; give a pose in it, or a spatial rod")

    def apply(self, motion: Motion, loads: Loads) -> None:
        """No load of its own: the reaction follows from the balance.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """

    def pose(self, inputs: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Position (3,) and rotation matrix (3, 3) of the tip in symbols; zero and identity where they are free.

        ``inputs`` are symbols by name.
        """
        return self._read(self.position or _ZERO, inputs), rotation_matrix(exponential(self.turn(inputs)))

    def turn(self, inputs: dict[str, ca.SX]) -> ca.SX:
        """Rotation vector (3,) in symbols; zero where the tip turns freely. ``inputs`` are symbols by name."""
        return self._read(self.rotation or _ZERO, inputs)

    def rates(self, inputs: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Velocity, acceleration, spin and its rate, (3,) each, in symbols. ``inputs`` are symbols by name."""
        velocity, acceleration, spin, spin_rate = (self._read(getattr(self, name), inputs) for name in DRIVEN[2:])
        return velocity, acceleration, spin, spin_rate

    @staticmethod
    def _read(value: Vector, inputs: dict[str, ca.SX]) -> ca.SX:
        return inputs[value.name] if isinstance(value, Input) else ca.SX(ca.DM(list(value)))

    def describe(self, rod: Any) -> str:
        """What is prescribed. ``rod`` is that of the scene."""
        kind = "clamped" if self.rotation is not None else "pinned"
        parts = [] if self.position is None else [f"position {_short(self.position)} along {self.axes}"]
        parts += [] if self.rotation is None else [f"rotation {_short(self.rotation)}"]
        rates = [f"{n} {_short(getattr(self, n))}" for n in DRIVEN[2:] if getattr(self, n) != _ZERO]
        return f"{kind} tip, {', '.join(parts + rates)}"


def held_tip(terms: tuple[Any, ...]) -> HeldTip | None:
    """The term among ``terms`` that holds the tip, if there is one."""
    found = [t for t in terms if isinstance(t, HeldTip)]
    return found[0] if found else None


def _short(value: Vector) -> str:
    return value.name if isinstance(value, Input) else f"({', '.join(f'{np.round(v, 9):g}' for v in value)})"
