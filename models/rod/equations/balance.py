"""The balance of a scene in CasADi: residual of the free strains, and what else can be read from a state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from pisplit.models.rod.kinematics.gauss import CompositeRule, Rule
from pisplit.models.rod.kinematics.kinematics import BaseState, Motion, columnwise_cross
from pisplit.models.rod.kinematics.turned import TurnedMotion
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.base import Base, joint_of
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.loads import Input, Loads, Term, by_row, shares_below


@dataclass(frozen=True, eq=False)
class Holding:
    """How the reaction at a held tip follows from the balance r: lambda = -(P J)^-1 (P r + s); see ``held``.

    Attributes:
        along: P (c, n); response: J (n, c); asked: s (c,); slope: G (c, n) of the conditions.
        multipliers: lambda (c,).
    """

    along: ca.SX
    response: ca.SX
    asked: ca.SX
    slope: ca.SX
    multipliers: ca.SX


@dataclass(frozen=True, eq=False)
class Balance:
    """Weak form of the Cosserat equations (paper, eq. cosserat_rod_eq) at the Gauss nodes.

    Statics is the same balance with exact zeros as rates and no inertia: nothing of the motion is left in its graph.

    With loads f, l per length and a wrench at the tip, forces and moments come from the tip:

        N = F_tip + int_s^L (f - rho A p_tt),   M = M_tip + int_s^L (p_s x N + l - (R rho J omega)_t)

    and every free strain balances at every node, in body axes:

        0 = R^T M - K_bt (w - w*) - stress_w,   0 = R^T N - K_se (v - v*) - stress_v

    A base that is free in some directions balances there, with the resultants at s = 0 of all that acts on the rod:
    0 = slides . N(0), 0 = hinge . M(0).

    Attributes:
        rod: the rod; terms: what acts on it; rule: the nodes and how to integrate between them.
        strains, rates, accelerations: free strains, node by node, and joint coordinates (n,); time derivatives.
        inputs: symbol of each input by name.
        inertia: whether the rod has inertia.
        dead_force: (3, K) in N adds an internal force at the nodes that does not depend on the motion.
        reaction: (6,) world force in N and moment in N m by which the tip is held; None where it is free.
        holding: how the reaction follows from the balance: see ``held``.
        shape: a motion through the same strains, whose frames serve here too (see ``Motion``).
    """

    rod: Rod
    terms: tuple[Term, ...]
    rule: Rule
    strains: ca.SX
    rates: ca.SX
    accelerations: ca.SX
    inputs: dict[str, ca.SX]
    inertia: bool = True
    dead_force: ca.SX | None = None
    reaction: ca.SX | None = None
    holding: Holding | None = None
    shape: Motion | None = None

    @cached_property
    def motion(self) -> Motion:
        """Kinematics."""
        return Motion(self.rod, self.rule, self.strains, self.rates, self.accelerations, self.base, self.shape)

    @property
    def base(self) -> BaseState:
        """Motion of the clamp."""
        moving = self.inertia or self.rates.nnz() > 0
        states = [t.state(self.inputs, moving, self._joint(t)) for t in self.terms if isinstance(t, Base)]
        return states[0] if states else BaseState.fixed()

    def _joint(self, base: Base) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Joint coordinates, their rates and accelerations."""
        first = self.strains.numel() - base.freedom
        return self.strains[first:], self.rates[first:], self.accelerations[first:]

    @cached_property
    def base_wrench(self) -> tuple[ca.SX, ca.SX]:
        """World resultants (3,) at the base, N(0) in N and M(0) in N m, of all that acts on the rod."""
        density = self.loads.force + self._inertia_density if self.inertia else self.loads.force
        force = self.loads.tip_force + self.motion.total(density) + self.loads.base_force
        return force, self.loads.tip_moment + self.motion.total(self._moment_density) + self.loads.base_moment

    @cached_property
    def loads(self) -> Loads:
        """Loads of all the terms."""
        loads = Loads.none(self.rule.n_nodes, self.inputs, self.inertia)
        for term in sorted(self.terms, key=lambda t: not isinstance(t, Gravity)):  # what has weight reads the gravity
            loads.add(term, self.motion)
        if self.inertia and joint_of(self.terms) is not None:
            self._add_unseen_inertia(loads)
        if self.reaction is not None:
            loads.tip_force += self.reaction[:3]
            loads.tip_moment += self.reaction[3:]
        return loads

    def _add_unseen_inertia(self, loads: Loads) -> None:
        """Inertia of that motion on a joint which vanishes at all nodes.

        Rotations are polynomials of degree K; with a base that turns that by P_K(s) (Legendre) is one of them, and has
        no mass by the quadrature of K nodes. It is what the base moves apart from the extrapolated motion of the nodes
        and has the mass int j P_K^2 ds = j L / (2 K + 1), with the inertia j of torsion (of which bending has half).
        With shear and stretch the same is true of slides.
        """
        base, rule = joint_of(self.terms), self.rule
        first = rule.elements[0] if isinstance(rule, CompositeRule) else rule
        row, length = rule.interpolate([0.0]), first.length / (2 * first.n_nodes + 1)
        shares = ca.DM(-row / rule.weights)
        if base is not None and base.hinge is not None:
            apart = self.base.spin_rate - self.motion.integral(self.motion.spin_rate, row)
            moment = -length * float(self.motion.profile.inertia[2, 0]) * apart
            loads.base_moment += moment
            loads.moment += moment @ shares
        if base is not None and base.slides and any(c >= 3 for c in self.rod.strain_set.free):
            apart = self.base.acceleration - self.motion.integral(self.motion.acceleration, row)
            force = -length * float(self.motion.profile.mass[0]) * apart
            loads.base_force += force
            loads.force += force @ shares

    @cached_property
    def internal_force(self) -> ca.SX:
        """World internal force N at the nodes (3, K)."""
        density = self.loads.force
        if self.inertia:
            density = density + self._inertia_density
        force = ca.repmat(self.loads.tip_force, 1, self.rule.n_nodes) + self.motion.to_tip(density)
        force = force + self.loads.point_force + self.loads.point_inertia
        return force if self.dead_force is None else force + self.dead_force

    @cached_property
    def _inertia_density(self) -> ca.SX:
        """Inertia force per length, -rho A p_tt, at the nodes (3, K)."""
        return -by_row(self.motion.profile.mass, 3) * self.motion.acceleration

    @property
    def inertial_force(self) -> ca.SX:
        """The part of the internal force N that is due to inertia, at the nodes (3, K) in N."""
        return self.motion.to_tip(self._inertia_density) + self.loads.point_inertia

    @cached_property
    def _moment_density(self) -> ca.SX:
        """World moment per length, p_s x N + l - (R rho J omega)_t, at the nodes (3, K) in N."""
        density = columnwise_cross(self.motion.tangent, self.internal_force) + self.loads.moment
        return density - self._rotary_inertia() if self.inertia else density

    @cached_property
    def _body_moment(self) -> ca.SX:
        """Internal moment R^T M at the nodes (3, K) in N m."""
        moment = ca.repmat(self.loads.tip_moment, 1, self.rule.n_nodes) + self.motion.to_tip(self._moment_density)
        for s, at_point in self.loads.point_moments.items():
            moment += at_point @ ca.DM(shares_below(self.motion, s))
        return self.motion.to_body(moment)

    def _rotary_inertia(self) -> ca.SX:
        """Rate of angular momentum per length in world axes: R (rho J alpha + omega x rho J omega)."""
        omega = self.motion.to_body(self.motion.spin)
        alpha = self.motion.to_body(self.motion.spin_rate)
        j = ca.SX(ca.DM(self.motion.profile.inertia))
        return self.motion.to_world(j * alpha + columnwise_cross(omega, j * omega))

    @cached_property
    def elastic_force(self) -> ca.SX:
        """Body force that the material carries, n = R^T N - stress_v, at the nodes (3, K) in N."""
        return self.motion.to_body(self.internal_force) - self.loads.stress_v

    @cached_property
    def residual(self) -> ca.SX:
        """Residual of the free strains, node by node; moments in N m, forces in N."""
        stiffness, rest = ca.DM(self.motion.profile.stiffness), ca.DM(self.motion.profile.rest)
        moment = self._body_moment - self.loads.stress_w
        rows = []
        for component in self.rod.strain_set.free:
            axis = component % 3
            strain = self.motion.w[axis, :] if component < 3 else self.motion.v[axis, :]
            carried = moment[axis, :] if component < 3 else self.elastic_force[axis, :]
            rows.append(carried - stiffness[component, :] * (strain - rest[component, :]))
        strains, base = ca.vec(ca.vertcat(*rows)), joint_of(self.terms)
        if base is None:
            return strains
        return ca.vertcat(strains, base.joint_forces(*self.base_wrench, self._joint(base)[0]))

    @property
    def slope(self) -> ca.SX:
        """Derivative (n, n) of the residual with respect to the strains; a reaction counts as a dead load."""
        motion = TurnedMotion.of(self.motion)
        return motion.slope(replace(self, shape=motion).residual)

    @cached_property
    def strain_v(self) -> ca.SX:
        """Shear and stretch strains at the nodes (3, K); those that are not free follow from the force carried."""
        free = self.rod.strain_set.free
        stiffness, rest = ca.DM(self.motion.profile.stiffness), ca.DM(self.motion.profile.rest)
        rows = []
        for axis in range(3):
            if 3 + axis in free:
                rows.append(self.motion.v[axis, :])
            else:
                rows.append(rest[3 + axis, :] + self.elastic_force[axis, :] / stiffness[3 + axis, :])
        return ca.vertcat(*rows)


def collect_inputs(terms: tuple[Term, ...]) -> tuple[Input, ...]:
    """Inputs of all the terms in their order; the same input may be read by several terms."""
    found: dict[str, Input] = {}
    for term in terms:
        for item in term.inputs:
            known = found.setdefault(item.name, item)
            if known.size != item.size:
                raise ValueError(
                    f"input {item.name!r} has size {item.size} in one term and {known.size} in another; "
                    "give them different names"
                )
    return tuple(found.values())
