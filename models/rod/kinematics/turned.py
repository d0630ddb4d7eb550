"""A motion whose frames are unknowns of their own, by which derivatives along a rod take few operations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.kinematics.turning import turn_slopes


@dataclass(frozen=True, eq=False)
class TurnedMotion(Motion):
    """A motion with every frame turned by a small rotation, (1 + hat(phi)) R, with symbols for phi and R.

    Derivatives with respect to the strains then go through the rotations, d/dxi + d/dphi Theta, with Theta = dphi/dxi
    in closed form (``turn_slopes``) instead of the derivatives of exponentials and products of quaternions: the same
    numbers to rounding in two thirds of the operations.

    Attributes:
        true: the motion whose frames these are.
        turned: symbols phi (3,) and R (3, 3) of every arclength asked for, in m.
    """

    true: Motion = field(kw_only=True)
    turned: dict[float, tuple[ca.SX, ca.SX]] = field(default_factory=dict, kw_only=True)

    @classmethod
    def of(cls, motion: Motion) -> TurnedMotion:
        """The turned twin of a ``motion``."""
        parts = (motion.rod, motion.rule, motion.strains, motion.rates, motion.accelerations, motion.base)
        return cls(*parts, true=motion)

    def _at(self, s: float) -> tuple[ca.SX, ca.SX]:
        if s not in self.turned:
            (frame,) = self.true.frames_at([s])
            self.turned[s] = ca.SX.sym("phi", 3), ca.SX.sym("frame", frame.sparsity())
        return self.turned[s]

    def frames_at(self, points: Sequence[float]) -> list[ca.SX]:
        """Rotations at arclengths ``points`` in m, turned."""
        return [frame + ca.skew(phi) @ frame for phi, frame in map(self._at, points)]

    def _nodes(self) -> tuple[ca.SX, list[ca.SX]]:
        """Small rotations (3, K) and frames at the nodes."""
        pairs = [self._at(s) for s in self.rule.nodes.tolist()]
        return ca.horzcat(*[phi for phi, _ in pairs]), [frame for _, frame in pairs]

    def to_world(self, body: ca.SX) -> ca.SX:
        """``body`` vectors at the nodes (3, K) in world axes."""
        phi, frames = self._nodes()
        world = ca.horzcat(*[r @ b for r, b in zip(frames, ca.horzsplit(body), strict=True)])
        return world + columnwise_cross(phi, world)

    def to_body(self, world: ca.SX) -> ca.SX:
        """``world`` vectors at the nodes (3, K) in body axes."""
        phi, frames = self._nodes()
        turned = world - columnwise_cross(phi, world)
        return ca.horzcat(*[r.T @ w for r, w in zip(frames, ca.horzsplit(turned), strict=True)])

    def slope(self, values: ca.SX) -> ca.SX:
        """Derivative (k, n) of ``values`` (k,) of this motion with respect to the strains."""
        points = list(self.turned)
        phis, symbols = [self.turned[s][0] for s in points], [self.turned[s][1] for s in points]
        unknowns = ca.vertcat(self.strains, *phis)
        ways = ca.vertcat(ca.SX.eye(self.strains.numel()), *turn_slopes(self.true, points))
        slope = ca.jtimes(values, unknowns, ways)
        zeros = [ca.SX(3, 1) for _ in points]
        frames = self.true.frames_at(points)
        (found,) = ca.substitute([slope], [*phis, *symbols], [*map(ca.densify, zeros), *frames])
        return found
