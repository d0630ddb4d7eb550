"""Motion of the rod from its strains and their rates, at the Gauss nodes and at the tip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.models.rod.kinematics.gauss import Array, Rule

if TYPE_CHECKING:
    from pisplit.models.rod.section.body import Profile, Rod


@dataclass(frozen=True, eq=False)
class BaseState:
    """Symbolic motion of the base in world axes.

    Attributes:
        position (3,) in m, quaternion (4,), velocity (3,) in m/s, acceleration (3,) in m/s^2, spin (3,) in rad/s,
        spin_rate (3,) in rad/s^2.
    """

    position: ca.SX
    quaternion: ca.SX
    velocity: ca.SX
    acceleration: ca.SX
    spin: ca.SX
    spin_rate: ca.SX

    @classmethod
    def fixed(cls) -> BaseState:
        """At the origin, upright, at rest; leaves nothing in a graph."""
        zero = ca.SX(3, 1)
        return cls(zero, ca.SX(ca.DM([1.0, 0.0, 0.0, 0.0])), zero, zero, zero, zero)


@dataclass(frozen=True, eq=False)
class Motion:
    """Symbolic kinematics at the nodes of ``rule``, computed when first read.

    World quantities are 3 x K matrices with one column a node; ``*_tip`` are columns (3,). With exact zeros as rates
    (statics) every velocity folds to zero and leaves nothing in the graph.

    Equations (s = arclength, t = time; R_s = R hat(w), p_s = R v):
        O_s = R w_t,  O_ts = O x R w_t + R w_tt      (O: world angular velocity, that of the base at the clamp)
        p_ts = O x p_s + R v_t,  p_tts = O_t x p_s + O x (O x p_s) + 2 O x R v_t + R v_tt

    Attributes:
        rod, rule: the rod and its nodes.
        strains, rates, accelerations: its coordinates (n_strains,) and their derivatives; those of a joint at the base,
            behind those of the rod, are not looked at.
        base: motion of the clamp.
        shape: another motion through the same strains and the same clamp, whose frames and tangents serve here too.
    """

    rod: Rod
    rule: Rule
    strains: ca.SX
    rates: ca.SX
    accelerations: ca.SX
    base: BaseState = field(default_factory=BaseState.fixed)
    shape: Motion | None = None

    @cached_property
    def profile(self) -> Profile:
        """Constants of the rod at the nodes."""
        return self.rod.profile(self.rule.nodes)

    def _split(self, values: ca.SX, rest: Array) -> tuple[ca.SX, ca.SX]:
        free, k = self.rod.strain_set, self.rule.n_nodes
        nodes = ca.horzsplit(ca.reshape(values[: free.n_fields * k], free.n_fields, k))
        pairs = [free.split(node, column) for node, column in zip(nodes, rest.T.tolist(), strict=True)]
        return ca.horzcat(*[w for w, _ in pairs]), ca.horzcat(*[v for _, v in pairs])

    @cached_property
    def _wv(self) -> tuple[ca.SX, ca.SX]:
        return self._split(self.strains, self.profile.rest)

    @cached_property
    def _wv_t(self) -> tuple[ca.SX, ca.SX]:
        return self._split(self.rates, np.zeros((6, self.rule.n_nodes)))

    @cached_property
    def _wv_tt(self) -> tuple[ca.SX, ca.SX]:
        return self._split(self.accelerations, np.zeros((6, self.rule.n_nodes)))

    @property
    def w(self) -> ca.SX:
        """Bending and torsion strains in 1/m."""
        return self._wv[0]

    @property
    def v(self) -> ca.SX:
        """Shear and stretch strains."""
        return self._wv[1]

    @property
    def w_t(self) -> ca.SX:
        """Rates of ``w`` in 1/(m s)."""
        return self._wv_t[0]

    @property
    def v_t(self) -> ca.SX:
        """Rates of ``v`` in 1/s."""
        return self._wv_t[1]

    @cached_property
    def frames(self) -> list[ca.SX]:
        """Rotations R at the nodes, then at the tip."""
        if self.shape is not None:
            return self.shape.frames
        points = [*self.rule.nodes.tolist(), self.rule.length]
        return self.frames_at(points)

    def frames_at(self, points: Sequence[float]) -> list[ca.SX]:
        """Rotations R at arclengths. ``points`` in m."""
        if self.shape is not None:
            return self.shape.frames_at(points)
        return self.rod.strain_set.frames(self.w, self.rule, points, self._steps, self.rod.kinks)

    @cached_property
    def _steps(self) -> list[ca.SX]:
        return self.rod.strain_set.steps(self.w, self.rule, self.base.quaternion, self.rod.kinks)

    @property
    def tip_frame(self) -> ca.SX:
        """Rotation of the tip."""
        return self.frames[-1]

    def to_world(self, body: ca.SX) -> ca.SX:
        """Body vectors at the nodes (3, K) in world axes. ``body`` are these vectors."""
        if self.shape is not None:
            return self.shape.to_world(body)
        return ca.horzcat(*[r @ b for r, b in zip(self.frames, ca.horzsplit(body), strict=False)])

    def to_body(self, world: ca.SX) -> ca.SX:
        """World vectors at the nodes (3, K) in body axes. ``world`` are these vectors."""
        if self.shape is not None:
            return self.shape.to_body(world)
        return ca.horzcat(*[r.T @ b for r, b in zip(self.frames, ca.horzsplit(world), strict=False)])

    def integral(self, density: ca.SX, rows: Array) -> ca.SX:
        """Integrals from the base (3, S) of a density at the nodes (3, K), by rows of integration weights (S, K)."""
        return ca.mtimes(density, ca.DM(rows.T))

    def from_base(self, density: ca.SX) -> ca.SX:
        """int_0^{s_k} at every node. ``density`` (3, K) is given at the nodes."""
        return self.integral(density, self.rule.integration)

    def to_tip(self, density: ca.SX) -> ca.SX:
        """int_{s_k}^L at every node, the adjoint of ``from_base``. ``density`` (3, K) is given at the nodes."""
        return self.integral(density, self.rule.weights[None, :] - self.rule.integration)

    def total(self, density: ca.SX) -> ca.SX:
        """int_0^L. ``density`` (3, K) is given at the nodes."""
        return self.integral(density, self.rule.weights[None, :])

    @cached_property
    def tangent(self) -> ca.SX:
        """p_s = R v."""
        if self.shape is not None:
            return self.shape.tangent
        return self.to_world(self.v)

    @cached_property
    def position(self) -> ca.SX:
        """p at the nodes in m."""
        return self._based(self.base.position) + self.from_base(self.tangent)

    @cached_property
    def tip(self) -> ca.SX:
        """p(L) in m."""
        return self.base.position + self.total(self.tangent)

    @cached_property
    def spin_density(self) -> ca.SX:
        """O_s = R w_t."""
        return self.to_world(self.w_t)

    @cached_property
    def spin(self) -> ca.SX:
        """World angular velocity O at the nodes in rad/s."""
        return self._based(self.base.spin) + self.from_base(self.spin_density)

    @cached_property
    def _stretching(self) -> ca.SX:
        return self.to_world(self.v_t)

    @cached_property
    def velocity_density(self) -> ca.SX:
        """p_ts."""
        return columnwise_cross(self.spin, self.tangent) + self._stretching

    @cached_property
    def velocity(self) -> ca.SX:
        """World velocity p_t at the nodes in m/s."""
        return self._based(self.base.velocity) + self.from_base(self.velocity_density)

    @cached_property
    def tip_velocity(self) -> ca.SX:
        """p_t(L) in m/s."""
        return self.base.velocity + self.total(self.velocity_density)

    @cached_property
    def spin_rate_density(self) -> ca.SX:
        """O_ts."""
        return columnwise_cross(self.spin, self.spin_density) + self.to_world(self._wv_tt[0])

    @cached_property
    def spin_rate(self) -> ca.SX:
        """O_t at the nodes in rad/s^2."""
        return self._based(self.base.spin_rate) + self.from_base(self.spin_rate_density)

    @cached_property
    def acceleration_density(self) -> ca.SX:
        """p_tts."""
        carried = columnwise_cross(self.spin, columnwise_cross(self.spin, self.tangent) + 2.0 * self._stretching)
        return columnwise_cross(self.spin_rate, self.tangent) + carried + self.to_world(self._wv_tt[1])

    @cached_property
    def acceleration(self) -> ca.SX:
        """World acceleration p_tt at the nodes in m/s^2."""
        return self._based(self.base.acceleration) + self.from_base(self.acceleration_density)

    # Anywhere on the rod ---------------------------------------------------------------------------------------------

    def position_at(self, points: Sequence[float]) -> ca.SX:
        """p (3, S) at arclengths in m. ``points`` are these."""
        return self._along(self.base.position, self.tangent, points)

    def velocity_at(self, points: Sequence[float]) -> ca.SX:
        """World velocity p_t (3, S) at arclengths in m/s. ``points`` are these."""
        return self._along(self.base.velocity, self.velocity_density, points)

    def acceleration_at(self, points: Sequence[float]) -> ca.SX:
        """World acceleration p_tt (3, S) at arclengths in m/s^2. ``points`` are these."""
        return self._along(self.base.acceleration, self.acceleration_density, points)

    def spin_at(self, points: Sequence[float]) -> ca.SX:
        """World angular velocity O (3, S) at arclengths in rad/s. ``points`` are these, in m."""
        return self._along(self.base.spin, self.spin_density, points)

    def spin_rate_at(self, points: Sequence[float]) -> ca.SX:
        """O_t (3, S) at arclengths in rad/s^2. ``points`` are arclengths in m."""
        return self._along(self.base.spin_rate, self.spin_rate_density, points)

    def frame_at(self, s: float) -> ca.SX:
        """Rotation R at one arclength. ``s`` in m."""
        return self.tip_frame if self.is_tip(s) else self.frames_at([s])[0]

    def is_tip(self, s: float) -> bool:
        """Whether an arclength is that of the tip, to rounding: the elements of a rod add up to L only to that.

        ``s`` in m.
        """
        return bool(np.isclose(s, self.rule.length, rtol=1e-12, atol=0.0))

    def _based(self, base: ca.SX) -> ca.SX:
        return ca.repmat(base, 1, self.rule.n_nodes)

    def _along(self, base: ca.SX, density: ca.SX, points: Sequence[float]) -> ca.SX:
        return ca.repmat(base, 1, len(points)) + self.integral(density, self.rule.integrate_to(points))


def columnwise_cross(a: ca.SX, b: ca.SX) -> ca.SX:
    """Cross products of the columns of two 3 x K matrices. ``a`` and ``b`` are these."""
    return ca.vertcat(
        a[1, :] * b[2, :] - a[2, :] * b[1, :],
        a[2, :] * b[0, :] - a[0, :] * b[2, :],
        a[0, :] * b[1, :] - a[1, :] * b[0, :],
    )
