"""A tip that is held in motion: the conditions on it, their rates, and the wrench that keeps them.

With the conditions g(xi, t) = 0 on the pose of the tip and their slope G = dg/dxi, the balance r(xi, xi_t, xi_tt) of
the free strains gets a wrench at the tip with multipliers lambda, r + J lambda = 0. The wrench is the one under which

    g_tt + 2 w g_t + w^2 g = 0                                                                        (stabilised)

holds (Baumgarte, Comput. Methods Appl. Mech. Eng. 1972), w the rate of the first bending mode: errors of the
integrator in g fade within a period and do not add up. It is written into the balance itself: for any diagonal D, here
the compliances of the strains,

    lambda = -(G D J)^-1 (G D r + (g_tt + 2 w g_t + w^2 g) / w^2)

makes r + J lambda vanish where, and only where, both the balance and the stabilised conditions hold. So a held scene
has as many equations and unknowns as a free one, at rest (where they are the balance and g = 0) and in motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.equations.balance import Balance, Holding
from pisplit.models.rod.terms.base import joint_stiffness
from pisplit.models.rod.terms.held import HeldTip


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions on the tip of a ``balance`` by a ``term``, their rates, and the wrench that keeps them."""

    balance: Balance
    term: HeldTip

    @cached_property
    def axes(self) -> list[int]:
        """World axes along which the tip is held."""
        return self.term.held_axes(self.balance.rod.strain_set.planar)

    @cached_property
    def turns(self) -> list[int]:
        """Axes of the prescribed frame about which it is."""
        return self.term.held_turns(self.balance.rod.strain_set.planar)

    @cached_property
    def _pose(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols of the prescribed position and rotation, and the conditions (c,) in them."""
        place, turn, motion = ca.SX.sym("place", 3), ca.SX.sym("turn", 3, 3), self.balance.motion
        off = ca.inv_skew(turn.T @ motion.tip_frame) - ca.inv_skew(motion.tip_frame.T @ turn)
        g = ca.vertcat((motion.tip - place)[self.axes] / motion.rod.length, 0.5 * off[self.turns])
        return place, turn, g

    @cached_property
    def chain(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """g (c,) in parts of L and rad, its slope G (c, n), its rate g_t and its second rate g_tt."""
        (place, turn, g), balance = self._pose, self.balance
        where = ca.vertcat(balance.strains, place, ca.vec(turn))
        first, second = ca.SX.sym("first", *where.shape), ca.SX.sym("second", *where.shape)
        g_t = ca.jtimes(g, where, first)
        g_tt = ca.jtimes(g_t, where, first) + ca.jtimes(g, where, second)
        at, now = self.term.pose(balance.inputs)
        velocity, acceleration, spin, spin_rate = self.term.rates(balance.inputs)
        turning = ca.skew(spin)
        turn_t, turn_tt = turning @ now, (ca.skew(spin_rate) + turning @ turning) @ now
        rates = ca.vertcat(balance.rates, velocity, ca.vec(turn_t))
        accelerations = ca.vertcat(balance.accelerations, acceleration, ca.vec(turn_tt))
        slope = ca.jacobian(g, balance.strains)
        g, slope, g_t, g_tt = ca.substitute(
            [g, ca.densify(slope), g_t, g_tt],
            [first, second, place, turn],
            [ca.densify(rates), ca.densify(accelerations), at, now],
        )
        return g, slope, g_t, g_tt

    @cached_property
    def _stiffness(self) -> Array:
        """Of every strain, EI/L^3 of slides and EI/L of turns of the base (n,)."""
        rod = self.balance.rod
        stiffness = np.asarray(self.balance.motion.profile.stiffness)[list(rod.strain_set.free)].T.ravel()
        return np.concatenate([stiffness, joint_stiffness(rod, self.balance.terms)])

    def wrench(self, multipliers: ca.SX) -> ca.SX:
        """World force in N and moment in N m (6,) of multipliers (c,) in parts of EI/L^2 and EI/L."""
        rod = self.balance.rod
        unit = min(rod.stiffness[:2]) / rod.length
        force, moment = ca.SX(3, 1), ca.SX(3, 1)
        for k, axis in enumerate(self.axes):
            force[axis] = unit / rod.length * multipliers[k]
        for k, axis in enumerate(self.turns):
            moment[axis] = unit * multipliers[len(self.axes) + k]
        return ca.densify(ca.vertcat(force, self.term.pose(self.balance.inputs)[1] @ moment))

    def holding(self, moving: bool) -> Holding:
        """How the wrench that keeps the conditions follows, of a rod that is ``moving`` or at rest."""
        balance, (g, slope, g_t, g_tt) = self.balance, self.chain
        many = ca.SX.sym("multipliers", len(self.axes) + len(self.turns))
        loaded = with_wrench(balance, self.wrench(many))
        residual = ca.substitute(loaded.residual, many, ca.SX.zeros(*many.shape))
        response = ca.densify(ca.jacobian(loaded.residual, many))
        along = slope @ ca.diag(ca.DM(1.0 / self._stiffness))
        asked = g
        if moving:
            rate = balance.rod.bending_rate
            asked = g + 2.0 * g_t / rate + g_tt / rate**2
        found = -ca.solve(along @ response, along @ residual + asked)
        return Holding(along, response, asked, slope, found)


def held(balance: Balance, term: HeldTip, moving: bool) -> Balance:
    """``balance`` with the wrench at the tip that keeps what ``term`` prescribes; ``moving``: not at rest."""
    conditions = Conditions(balance, term)
    holding = conditions.holding(moving)
    return with_wrench(balance, conditions.wrench(holding.multipliers), holding)


def with_wrench(balance: Balance, wrench: ca.SX | None, holding: Holding | None = None) -> Balance:
    """``balance`` with another ``wrench`` (6,) at the tip, which follows as ``holding`` says, or is just given."""
    if balance.reaction is None and wrench is None:
        return balance  # a tip that is free: nothing is built anew
    made = replace(balance, reaction=wrench, holding=holding)
    made.__dict__["motion"] = balance.motion
    return made


def slopes(balance: Balance, symbols: Sequence[ca.SX]) -> list[ca.SX]:
    """Derivatives of the residual of a ``balance`` with respect to ``symbols``, exact where it is met.

    With a tip that is held they are those under the wrench as a dead load and what its multipliers add, without the
    derivatives of their equations: a twentieth of the instructions.
    """
    if balance.reaction is None:
        return [_slope(balance, symbol) for symbol in symbols]
    wrench = ca.SX.sym("wrench", 6)
    loaded = with_wrench(balance, wrench)
    blocks = ca.substitute([_slope(loaded, symbol) for symbol in symbols], [wrench], [balance.reaction])
    assert balance.holding is not None
    return constrained(balance.holding, blocks, [ca.jacobian(balance.holding.asked, symbol) for symbol in symbols])


def _slope(balance: Balance, symbol: ca.SX) -> ca.SX:
    if symbol is balance.strains:
        return balance.slope
    return ca.jacobian(balance.residual, symbol)


def constrained(holding: Holding, blocks: Sequence[ca.SX], asked: Sequence[ca.SX]) -> list[ca.SX]:
    """Derivatives of a held balance from those under a dead wrench: B - J (P J)^-1 (P B + ds).

    Args:
        holding: P, J and s.
        blocks: derivatives B (n, k) of the residual under the wrench.
        asked: ds (c, k), of s with respect to the same symbols.
    """
    c = holding.along.size1()
    pull = holding.response @ ca.solve(holding.along @ holding.response, ca.SX.eye(c))
    return [b - pull @ (holding.along @ b + ds) for b, ds in zip(blocks, asked, strict=True)]
