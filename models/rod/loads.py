"""What the terms of a scene add to the balance of the rod."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from pisplit.checks import count, finite_array
from pisplit.models.rod.kinematics import Motion


@dataclass(frozen=True)
class Input:
    """A named input of the scene with ``size`` entries, in place of a fixed number."""

    name: str
    size: int

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f"Input name = {self.name!r}; expected a non-empty string")
        count(self.size, f"Input {self.name!r} size")


#: A load that is either three numbers or an input of size 3.
Vector = Sequence[float] | Input


def checked_vector(value: Vector, name: str) -> Vector:
    """Three finite numbers as a tuple, or an ``Input`` of size 3."""
    if isinstance(value, Input):
        if value.size != 3:
            raise ValueError(f"{name} is an input of size {value.size}; expected size 3")
        return value
    return tuple(finite_array(np.asarray(value), name, (3,)).tolist())


@dataclass
class Loads:
    """Sums of loads. A term adds to what it affects; what nobody adds to stays exactly zero.

    Attributes:
        force: world force per length at the nodes (3, K) in N/m.
        moment: world moment per length at the nodes (3, K) in N.
        tip_force, tip_moment: world wrench at the tip (3,) in N, N m.
        stress_w, stress_v: body moment (3, K) in N m and force (3, K) in N that a term adds to the elastic stress
            at the nodes (damping, tendons).
        inputs: symbol of each input by name.
        outputs: quantities that a term offers for reading, by name (e.g. tendon tensions).
        work: stored energies in J by name.
    """

    force: ca.SX
    moment: ca.SX
    tip_force: ca.SX
    tip_moment: ca.SX
    stress_w: ca.SX
    stress_v: ca.SX
    inputs: dict[str, ca.SX]
    outputs: dict[str, ca.SX] = field(default_factory=dict)

    @classmethod
    def none(cls, n_nodes: int, inputs: dict[str, ca.SX]) -> Loads:
        """No loads at all."""
        zero = ca.SX(3, n_nodes)
        return cls(zero, zero, ca.SX(3, 1), ca.SX(3, 1), zero, zero, inputs)

    def read(self, value: Vector) -> ca.SX:
        """Symbol of an input, or the numbers themselves."""
        return self.inputs[value.name] if isinstance(value, Input) else ca.SX(ca.DM(list(value)))


@runtime_checkable
class Term(Protocol):
    """Anything that acts on a rod. ``inputs`` lists what it reads; ``apply`` adds its loads."""

    @property
    def inputs(self) -> tuple[Input, ...]: ...

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the loads of this term for a motion of the rod."""

    def describe(self, rod: Any) -> str:
        """One line for the table of the scene."""
