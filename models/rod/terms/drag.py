"""Drag of the surrounding medium, the same in all directions or along and across the rod."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import casadi as ca

from pisplit.checks import non_negative
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.loads import Input, Loads

if TYPE_CHECKING:
    from pisplit.models.rod.section.body import Rod

#: Drag in parts of the inertia of a swing as far as the rod is long, below which it is weak: up to 0.45 large steps and
#: IDAS take as many steps without its derivative, within 3 %, be a step a tenth or three times 1 / bending_rate.
WEAK = 0.5
#: Speed in m/s below which the drag goes smoothly through zero.
SPEED_FLOOR = 1e-6


@dataclass(frozen=True)
class LinearDrag:
    """Force per length -c p_t with c in N s/m^2.

    Args:
        coefficient: c in N s/m^2.
    """

    coefficient: float

    def __post_init__(self) -> None:
        non_negative(self.coefficient, "LinearDrag coefficient", "N s/m^2")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add -c p_t at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        if self.coefficient == 0.0:
            return
        loads.force -= self.coefficient * motion.velocity

    def weak(self, rod: Rod) -> bool:
        """Whether it is so small beside the inertia of the ``rod`` that steps converge without its derivative."""
        return _share(rod, self.coefficient, 0.0) < WEAK

    def describe(self, rod: Any) -> str:
        """Coefficient. ``rod`` is that of the scene."""
        return f"linear drag {self.coefficient:g} N s/m^2"


@dataclass(frozen=True)
class QuadraticDrag:
    """Force per length -c |p_t| p_t with c in N s^2/m^3, the same in all directions.

    Args:
        coefficient: c in N s^2/m^3.
    """

    coefficient: float

    def __post_init__(self) -> None:
        non_negative(self.coefficient, "QuadraticDrag coefficient", "N s^2/m^3")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add -c |p_t| p_t at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        velocity = motion.velocity
        if self.coefficient == 0.0 or velocity.nnz() == 0 or velocity.is_zero():
            return
        speed = ca.sqrt(ca.sum1(velocity * velocity) + SPEED_FLOOR**2)
        loads.force -= self.coefficient * ca.repmat(speed, 3, 1) * velocity

    def weak(self, rod: Rod) -> bool:
        """Whether it is so small beside the inertia of the ``rod`` that steps converge without its derivative."""
        return _share(rod, 0.0, self.coefficient) < WEAK

    def describe(self, rod: Any) -> str:
        """Coefficient. ``rod`` is that of the scene."""
        return f"quadratic drag {self.coefficient:g} N s^2/m^3"


@dataclass(frozen=True)
class AnisotropicDrag:
    """Force per length of different drag across (n) and along (t) the rod, about the body axes.

    With the body velocity q = R^T p_t, its part q_n across axis 3 and q_t along it:
    f = -R [(c_n + d_n |q_n|) q_n + (c_t + d_t |q_t|) q_t]. For a cylinder of radius r in a medium of density rho the
    quadratic coefficients are rho r C_n and pi rho r C_t with C_n about 1.1, C_t about 0.01
    (Taylor, Proc. R. Soc. A 1952).

    Args:
        normal, tangential: linear coefficients c_n, c_t in N s/m^2.
        normal_quadratic, tangential_quadratic: coefficients d_n, d_t in N s^2/m^3.
    """

    normal: float = 0.0
    tangential: float = 0.0
    normal_quadratic: float = 0.0
    tangential_quadratic: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            non_negative(getattr(self, item.name), f"AnisotropicDrag {item.name}")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the drag at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        unused = not any(getattr(self, item.name) for item in fields(self))
        if unused or motion.velocity.nnz() == 0 or motion.velocity.is_zero():
            return
        q = motion.to_body(motion.velocity)
        across, along = q[:2, :], q[2, :]
        force_n = _drag(self.normal, self.normal_quadratic, across)
        force_t = _drag(self.tangential, self.tangential_quadratic, along)
        loads.force -= motion.to_world(ca.vertcat(force_n, force_t))

    def weak(self, rod: Rod) -> bool:
        """Whether it is so small beside the inertia of the ``rod`` that steps converge without its derivative."""
        linear = max(self.normal, self.tangential)
        return _share(rod, linear, max(self.normal_quadratic, self.tangential_quadratic)) < WEAK

    def describe(self, rod: Any) -> str:
        """Coefficients. ``rod`` is that of the scene."""
        return (
            f"drag across {self.normal:g} N s/m^2, {self.normal_quadratic:g} N s^2/m^3, "
            f"along {self.tangential:g} N s/m^2, {self.tangential_quadratic:g} N s^2/m^3"
        )


def _share(rod: Rod, linear: float, quadratic: float) -> float:
    """Drag of coefficients in N s/m^2 and N s^2/m^3 in parts of the inertia, at the first bending frequency."""
    return (linear / rod.bending_rate + quadratic * rod.length) / rod.mass_per_length


def _drag(linear: float, quadratic: float, q: ca.SX) -> ca.SX:
    """(c + d |q|) q column by column; what is zero leaves nothing."""
    force = linear * q if linear > 0.0 else ca.SX(*q.shape)
    if quadratic > 0.0:
        speed = ca.sqrt(ca.sum1(q * q) + SPEED_FLOOR**2)
        force += quadratic * ca.repmat(speed, q.shape[0], 1) * q
    return force
