"""Drag of the surrounding medium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from pisplit.checks import non_negative
from pisplit.models.rod.kinematics import Motion
from pisplit.models.rod.loads import Input, Loads

#: Speed in m/s below which the drag goes smoothly through zero.
SPEED_FLOOR = 1e-6


@dataclass(frozen=True)
class LinearDrag:
    """Force per length -c p_t with c in N s/m^2."""

    coefficient: float

    def __post_init__(self) -> None:
        non_negative(self.coefficient, "LinearDrag coefficient", "N s/m^2")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add -c p_t at every node."""
        loads.force -= self.coefficient * motion.velocity

    def describe(self, rod: Any) -> str:
        """Coefficient."""
        return f"linear drag {self.coefficient:g} N s/m^2"


@dataclass(frozen=True)
class QuadraticDrag:
    """Force per length -c |p_t| p_t with c in N s^2/m^3, the same in all directions."""

    coefficient: float

    def __post_init__(self) -> None:
        non_negative(self.coefficient, "QuadraticDrag coefficient", "N s^2/m^3")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add -c |p_t| p_t at every node."""
        velocity = motion.velocity
        if velocity.nnz() == 0 or velocity.is_zero():
            return
        speed = ca.sqrt(ca.sum1(velocity * velocity) + SPEED_FLOOR**2)
        loads.force -= self.coefficient * ca.repmat(speed, 3, 1) * velocity

    def describe(self, rod: Any) -> str:
        """Coefficient."""
        return f"quadratic drag {self.coefficient:g} N s^2/m^3"
