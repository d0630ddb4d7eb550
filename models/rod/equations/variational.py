"""The balance of a scene by virtual work on exact derivatives of the discrete frames and positions.

``Balance`` integrates angular velocities along the rod; that is as accurate as the frames, but for a spatial rod it is
not their exact derivative, and over many periods of an undamped motion the difference feeds energy in: a soft rod at
five nodes blows up within two seconds. Here velocities are the derivatives of positions and frames, turn by turn from
node to node, and moments act through the transposed derivative. The balance is then Lagrange's equation of the
discrete rod: without damping and inputs its energy is constant at any number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from pisplit.models.rod.equations.balance import Balance
from pisplit.models.rod.kinematics.gauss import Array
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.kinematics.rotations import turning_coefficients
from pisplit.models.rod.kinematics.strains import rotation_vector, turn_rows


@cache
def _vector(size: int) -> tuple[ca.Function, ca.Function]:
    """``(parts, rates, accelerations) -> Omega_t, Omega_tt`` and ``(parts, moment) -> its share in the parts``."""
    parts, rates, accelerations = (ca.SX.sym(name, 3, size) for name in ("parts", "rates", "accelerations"))
    moment, omega = ca.SX.sym("moment", 3), rotation_vector(parts)
    first = ca.jtimes(omega, parts, rates)
    second = ca.jtimes(first, parts, rates) + ca.jtimes(omega, parts, accelerations)
    moving = ca.Function("moving", [parts, rates, accelerations], [first, second])
    acting = ca.Function("acting", [parts, moment], [ca.jtimes(omega, parts, moment, True)])
    return moving, acting


@dataclass(frozen=True, eq=False)
class Turn:
    """One step of the frames by the rotation vector omega (see ``strains.rotation_vector``).

    The rotation exp(hat(omega)) turns by ``dexp(omega) omega_t`` in the frame before it, where

        dexp(omega) x = x + a omega x x + b omega x (omega x x),  a = (1 - cos t) / t^2,  b = (t - sin t) / t^3

    with t = |omega|, smoothed at zero as ``rotations.exponential`` does.

    Attributes:
        rows: (2 or 3, K) from nodal strains w to the parts of omega (``turn_rows``).
        parts: these parts of the strains, of their rates and of their accelerations, each (3, 2 or 3).
    """

    rows: Array
    parts: tuple[ca.SX, ca.SX, ca.SX]

    @cached_property
    def omega(self) -> ca.SX:
        """Rotation vector (3,)."""
        return rotation_vector(self.parts[0])

    @cached_property
    def _coefficients(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """t^2, a and b."""
        return turning_coefficients(self.omega)

    @cached_property
    def rates(self) -> tuple[ca.SX, ca.SX]:
        """Angular velocity and acceleration (3,) that the step adds, in the frame before it."""
        first, second = _vector(len(self.rows))[0](*self.parts)
        square, a, b = self._coefficients
        once = ca.cross(self.omega, first)
        twice = ca.cross(self.omega, once)
        growth = ca.dot(self.omega, first) / square
        a_t, b_t = (1.0 - b * square - 2.0 * a) * growth, (a - 3.0 * b) * growth
        again = ca.cross(self.omega, second)
        rate = second + a_t * once + a * again + b_t * twice
        rate = rate + b * (ca.cross(first, once) + ca.cross(self.omega, again))
        return first + a * once + b * twice, rate

    def conjugate(self, moment: ca.SX) -> ca.SX:
        """Share (3, K) of the nodal strains w in a moment (3,) in the frame before the step: transpose of ``rates``."""
        _, a, b = self._coefficients
        once = ca.cross(self.omega, moment)
        acting = _vector(len(self.rows))[1](self.parts[0], moment - a * once + b * ca.cross(self.omega, once))
        return ca.mtimes(acting, ca.DM(self.rows))


@dataclass(frozen=True, eq=False)
class VariationalMotion(Motion):
    """Motion whose velocities and accelerations differentiate the discrete positions and frames exactly."""

    def _turn(self, start: float, end: float) -> Turn:
        rows = turn_rows(self.rule, start, end)
        w, w_t, w_tt = (ca.mtimes(w, ca.DM(rows.T)) for w in (self.w, self.w_t, self._wv_tt[0]))
        return Turn(rows, (w, w_t, w_tt))

    @cached_property
    def _turns(self) -> list[Turn]:
        return [self._turn(start, end) for start, end in pairwise(self.rule.step_ends)]

    @cached_property
    def _ends(self) -> list[ca.SX]:
        """Rotations R at ``rule.step_ends``."""
        return self.frames_at(self.rule.step_ends)

    @cached_property
    def _chain(self) -> list[tuple[ca.SX, ca.SX]]:
        """World angular velocity and acceleration at ``rule.step_ends``."""
        chain = [(self.base.spin, self.base.spin_rate)]
        for frame, turn in zip(self._ends, self._turns, strict=False):
            chain.append(_turned(*chain[-1], frame, turn))
        return chain

    def _spins(self, points: Sequence[float]) -> list[tuple[ca.SX, ca.SX]]:
        ends, found = self.rule.step_ends, []
        for point in points:
            last = int(np.searchsorted(ends, point, side="right")) - 1
            spin = self._chain[last]
            if point > ends[last]:
                spin = _turned(*spin, self._ends[last], self._turn(ends[last], point))
            found.append(spin)
        return found

    def spin_at(self, points: Sequence[float]) -> ca.SX:
        """World angular velocity O (3, S) in rad/s at arclengths ``points`` (S,) in m."""
        if self.rod.strain_set.planar:
            return super().spin_at(points)
        return ca.horzcat(*[spin for spin, _ in self._spins(points)])

    def spin_rate_at(self, points: Sequence[float]) -> ca.SX:
        """O_t (3, S) in rad/s^2 at arclengths ``points`` (S,) in m."""
        if self.rod.strain_set.planar:
            return super().spin_rate_at(points)
        return ca.horzcat(*[rate for _, rate in self._spins(points)])

    @cached_property
    def spin(self) -> ca.SX:
        """World angular velocity at the nodes in rad/s."""
        return self.spin_at(self.rule.nodes.tolist())

    @cached_property
    def spin_rate(self) -> ca.SX:
        """O_t at the nodes in rad/s^2."""
        return self.spin_rate_at(self.rule.nodes.tolist())

    def conjugate(self, moments: ca.SX, tip: ca.SX, at_points: dict[float, ca.SX]) -> ca.SX:
        """World moments at the nodes (3, K), at the tip (3,) and ``at_points`` between as they act on w, (3, K).

        The transpose of ``spin_at`` these points: sum_k moments_k . dO_k + tip . dO(L) + sum_s at_points[s] . dO(s).
        """
        ends, nodes = self.rule.step_ends, self.rule.nodes.tolist()
        total = tip
        acting = self._turn(ends[-1], self.rule.length).conjugate(self._ends[-1].T @ total)
        for k in reversed(range(len(ends))):
            for s, moment in at_points.items():
                if ends[k] < s and (k + 1 == len(ends) or s < ends[k + 1]):
                    acting = acting + self._turn(ends[k], s).conjugate(self._ends[k].T @ moment)
                    total = total + moment
                elif s == ends[k]:
                    total = total + moment
            if ends[k] in nodes:
                total = total + moments[:, nodes.index(ends[k])]
            if k:
                acting = acting + self._turns[k - 1].conjugate(self._ends[k - 1].T @ total)
        return acting


def _turned(spin: ca.SX, spin_rate: ca.SX, frame: ca.SX, turn: Turn) -> tuple[ca.SX, ca.SX]:
    """World angular velocity and acceleration after a turn of ``frame``."""
    rate, change = turn.rates
    rate, change = frame @ rate, frame @ change
    return spin + rate, spin_rate + ca.cross(spin, rate) + change


@dataclass(frozen=True, eq=False)
class VariationalBalance(Balance):
    """``Balance`` with virtual work of all loads on the discrete frames and positions.

    With the internal force N of the integrated loads, virtual rotations hat(dO) = dR R^T and virtual strains de,

        sum_k b_k (N_k . d(p_s)_k + l_k . dO_k - stress_k . de_k) + M_tip . dO(L) = 0

    divided by b_k has the units of ``Balance.residual`` and tends to it as the nodes grow. A planar rod has nothing to
    gain: its usual balance is this one.
    """

    @cached_property
    def motion(self) -> Motion:
        """Kinematics."""
        return self._motion

    @cached_property
    def _motion(self) -> VariationalMotion:
        motion = (self.strains, self.rates, self.accelerations, self.base, self.shape)
        return VariationalMotion(self.rod, self.rule, *motion)

    @cached_property
    def _body_moment(self) -> ca.SX:
        """Moment that acts on the strains w at the nodes (3, K) in N m."""
        if self.rod.strain_set.planar:
            return super()._body_moment
        weights = ca.repmat(ca.DM(self.rule.weights[None, :]), 3, 1)
        loads = self.loads
        return self._motion.conjugate(weights * self._moment_density, loads.tip_moment, loads.point_moments) / weights
