"""The balance of a scene by virtual work on exact derivatives of the discrete frames and positions.

``Balance`` integrates angular velocities along the rod; that is as accurate as the frames, but for a spatial rod it is
not their exact derivative, and over many periods of an undamped motion the difference feeds energy in: a soft rod at
five nodes blows up within two seconds. Here velocities are the derivatives of positions and frames by automatic
differentiation, and forces act through the transposed derivative. The balance is then Lagrange's equation of the
discrete rod: without damping and inputs its energy is constant at any number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from pisplit.models.rod.balance import Balance
from pisplit.models.rod.kinematics import Motion


@dataclass(frozen=True, eq=False)
class VariationalMotion(Motion):
    """Motion whose velocities and accelerations differentiate the discrete positions and frames exactly.

    ``strains`` and ``rates`` must be symbols; rates may be exact zeros.
    """

    def _rate(self, value: ca.SX) -> ca.SX:
        """d/dt of a function of the strains."""
        return ca.reshape(ca.jtimes(ca.vec(value), self.strains, self.rates), *value.shape)

    def _second_rate(self, rate: ca.SX) -> ca.SX:
        """d/dt of a function of strains and rates."""
        if self.rates.nnz() == 0:
            return ca.SX(*rate.shape)
        symbols, velocities = ca.vertcat(self.strains, self.rates), ca.vertcat(self.rates, self.accelerations)
        return ca.reshape(ca.jtimes(ca.vec(rate), symbols, velocities), *rate.shape)

    def _spins(self, frames: Sequence[ca.SX]) -> ca.SX:
        """World angular velocities of frames."""
        return ca.horzcat(*[ca.inv_skew(self._rate(r) @ r.T) for r in frames])

    @cached_property
    def spin(self) -> ca.SX:
        """World angular velocity at the nodes in rad/s."""
        return self._spins(self.frames[:-1])

    @cached_property
    def spin_rate(self) -> ca.SX:
        """O_t at the nodes in rad/s^2."""
        return self._second_rate(self.spin)

    @cached_property
    def velocity_density(self) -> ca.SX:
        """p_ts."""
        return self._rate(self.tangent)

    @cached_property
    def acceleration_density(self) -> ca.SX:
        """p_tts."""
        return self._second_rate(self.velocity_density)

    def spin_at(self, points: Sequence[float]) -> ca.SX:
        """World angular velocity O (3, S) at arclengths in rad/s."""
        return self._spins([self.frame_at(s) for s in points])

    def spin_rate_at(self, points: Sequence[float]) -> ca.SX:
        """O_t (3, S) at arclengths in rad/s^2."""
        return self._second_rate(self.spin_at(points))


@dataclass(frozen=True, eq=False)
class VariationalBalance(Balance):
    """``Balance`` with virtual work of all loads on the discrete frames and positions.

    With the internal force N of the integrated loads, virtual rotations hat(dO) = dR R^T and virtual strains de,

        sum_k b_k (N_k . d(p_s)_k + l_k . dO_k - stress_k . de_k) + M_tip . dO(L) = 0

    divided by b_k has the units of ``Balance.residual`` and tends to it as the nodes grow. About three times the cost
    of the usual balance of a spatial rod; a planar rod has nothing to gain.
    """

    @cached_property
    def motion(self) -> Motion:
        """Kinematics."""
        base = super().motion.base
        return VariationalMotion(self.rod, self.rule, self.strains, self.rates, self.accelerations, base)

    @cached_property
    def residual(self) -> ca.SX:
        """Residual of the free strains, node by node; moments in N m, forces in N."""
        motion, loads, count = self.motion, self.loads, self.rule.n_nodes
        density = loads.moment - self._rotary_inertia() if self.inertia else loads.moment
        weights = ca.DM(self.rule.weights[None, :])
        moments = ca.horzcat(ca.repmat(weights, 3, 1) * density, loads.tip_moment)
        # dR = hat(dO) R, so that M . dO is half the product of hat(M) R with dR.
        turning = [0.5 * ca.skew(m) @ r for m, r in zip(ca.horzsplit(moments), motion.frames, strict=True)]
        moved = ca.vertcat(ca.vec(motion.tangent), *[ca.vec(r) for r in motion.frames])
        seeds = ca.vertcat(ca.vec(ca.repmat(weights, 3, 1) * self._force), *[ca.vec(t) for t in turning])
        free = list(self.rod.strain_set.free)
        work = ca.reshape(ca.jtimes(moved, self.strains, seeds, True), len(free), count)
        stress = ca.vertcat(loads.stress_w, loads.stress_v)[free, :]
        return ca.vec(work / ca.repmat(weights, len(free), 1) - stress) + self._elastic.residual

    @property
    def _elastic(self) -> Balance:
        """The rod alone, at rest: what is left is its elastic stress."""
        zero = ca.SX(*self.strains.shape)
        return Balance(self.rod, (), self.rule, self.strains, zero, zero, {}, inertia=False)
