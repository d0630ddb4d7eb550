"""The equations of a scene in CasADi, its typical sizes, and the states and inputs that they take."""

from __future__ import annotations

import warnings
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.data.columns import in_order
from pisplit.models.rod.equations.balance import Balance
from pisplit.models.rod.equations.held import held, slopes
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.scene.contents import Contents
from pisplit.models.rod.terms.base import Base, joint_of
from pisplit.models.rod.terms.damping import KelvinVoigt, Retardation
from pisplit.models.rod.terms.held import HeldTip, held_tip
from pisplit.models.rod.terms.loads import NoEffect
from pisplit.models.rod.terms.pull import Pull, TendonTerm


class Equations(Contents):
    """Balance of the contents at rest and in motion, as functions of xi, xi_t, xi_tt and u.

    Args:
        rod: the rod.
        terms: what acts on it.
        nodes: number of Gauss nodes of every element, or a number for each.
    """

    # Scales ----------------------------------------------------------------------------------------------------------

    @cached_property
    def nominal_strains(self) -> Array:
        """Typical size of each coordinate: 1/L for bending and torsion, 1 % for shear, stretch; of joints 1 rad, L."""
        sizes = [1.0 / self.rod.length if c < 3 else 0.01 for c in self.rod.strain_set.free]
        return _fixed(np.append(np.tile(sizes, self.nodes), self._joint_sizes(self.rod.length, 1.0)))

    def _joint_sizes(self, slide: float, turn: float) -> list[float]:
        """One number for every slide of the base, another for every turn."""
        base = joint_of(self.terms)
        slides = 0 if base is None else len(base.slides)
        return [slide] * slides + [turn] * (self.n_joint - slides)

    @cached_property
    def nominal_rates(self) -> Array:
        """Typical rate in 1/s at which each coordinate changes."""
        rates = np.tile([self.rod.natural_rates[c] for c in self.rod.strain_set.free], self.nodes)
        return _fixed(np.append(rates, [self.rod.bending_rate] * self.n_joint))

    @cached_property
    def weights(self) -> Array:
        """Quadrature weight in m of every coordinate, 1 for joints: residual times rate times weight is power."""
        return _fixed(np.append(np.repeat(self.rule.weights, self.rod.strain_set.n_fields), np.ones(self.n_joint)))

    @cached_property
    def rest_coordinates(self) -> Array:
        """Free strains of the unloaded rod, and joint coordinates of zero (n_strains,)."""
        rest = self.rod.profile(self.rule.nodes).rest
        return _fixed(np.append(rest[list(self.rod.strain_set.free)].T.ravel(), np.zeros(self.n_joint)))

    @cached_property
    def nominal_residual(self) -> Array:
        """Typical size of each residual row: EI/L for moments, EI/L^2 for forces."""
        moment = min(self.rod.stiffness[:2]) / self.rod.length
        sizes = [moment if c < 3 else moment / self.rod.length for c in self.rod.strain_set.free]
        joint = self._joint_sizes(moment / self.rod.length, moment)
        return _fixed(np.append(np.tile(sizes, self.nodes), joint))

    @property
    def damped(self) -> bool:
        """Whether the material damps every free strain."""
        terms = [t for t in self.terms if isinstance(t, KelvinVoigt | Retardation)]
        return all(any(t.coefficient(c) > 0.0 for t in terms) for c in self.rod.strain_set.free)

    # Balance ---------------------------------------------------------------------------------------------------------

    def balance(
        self,
        strains: ca.SX,
        rates: ca.SX,
        accelerations: ca.SX | None,
        u: ca.SX,
        dead_force: ca.SX | None = None,
        shape: Motion | None = None,
    ) -> Balance:
        """Symbolic balance at given coordinates.

        Args:
            strains: free strains xi (n_strains,), node by node.
            rates: xi_t (n_strains,) per s; exact zeros (an empty sparsity) for a rod at rest.
            accelerations: xi_tt (n_strains,) per s^2; None leaves inertia out.
            u: stacked inputs (n_inputs,), in a scene with Maxwell branches behind their overstress (n_acting,); with
                the inputs alone the branches are relaxed.
            dead_force: internal force (3, K) in N at the nodes that does not depend on the motion; None: none.
            shape: the motion of another balance at the same ``strains`` and ``u``, so that frames are written once.
        """
        parts: dict[str, ca.SX] = {}
        branches = self.branches if u.numel() == self.layout.n_acting else ()
        sizes = [(branch.state, self.layout.n_free) for branch in branches] + [(i.name, i.size) for i in self.inputs]
        start = 0
        for name, size in sizes:
            parts[name] = u[start : start + size]
            start += size
        carried = any(isinstance(t, Base) and t.moves for t in self.terms)
        at_rest = accelerations is None and not rates.nnz() and dead_force is None
        moving = accelerations is not None or (at_rest and carried)  # at rest on a moving base: inertia of that motion
        second = ca.SX(self.n_strains, 1) if accelerations is None else accelerations
        motion = (strains, rates, second)
        made = self.balance_type(
            self.rod, self.terms, self.rule, *motion, parts, inertia=moving, dead_force=dead_force, shape=shape
        )
        tip = held_tip(self.terms)
        return made if tip is None else held(made, tip, moving=accelerations is not None)

    @cached_property
    def static_balance(self) -> tuple[ca.SX, ca.SX, Balance]:
        """Symbols (xi, u) and the balance at rest."""
        xi, u = ca.SX.sym("xi", self.n_strains), ca.SX.sym("u", self.n_inputs)
        return xi, u, self.balance(xi, ca.SX(self.n_strains, 1), None, u)

    @cached_property
    def dynamic_balance(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, Balance]:
        """Symbols (xi, xi_t, xi_tt, u) and the balance in motion. Warns of inputs that nothing in it reads.

        Where the scene has Maxwell branches u is [sigma, u] (n_acting,), here and in all functions of a motion.
        """
        xi, xi_t, xi_tt = (ca.SX.sym(name, self.n_strains) for name in ("xi", "xi_t", "xi_tt"))
        u = ca.SX.sym("u", self.layout.n_acting)
        balance = self.balance(xi, xi_t, xi_tt, u)
        self._say_unread(u, balance)
        return xi, xi_t, xi_tt, u, balance

    def _say_unread(self, u: ca.SX, balance: Balance) -> None:
        moved = {
            i.name for t in self.terms if isinstance(t, Base | HeldTip) for i in t.inputs
        }  # a pose is in the fields alone
        start = self.layout.n_overstress
        for item in self.inputs:
            part = u[start : start + item.size]
            start += item.size
            if item.name not in moved and not ca.depends_on(balance.residual, part):
                warnings.warn(f"input {item.name!r} acts on nothing in this scene", NoEffect, stacklevel=3)

    @cached_property
    def acceleration(self) -> ca.Function:
        """``(xi, xi_t, u) -> xi_tt``: the balance is linear in the accelerations; solved exactly."""
        xi, xi_t, xi_tt, u, balance = self.dynamic_balance
        scale = 1.0 / ca.DM(self.nominal_residual)
        (mass,) = slopes(balance, [xi_tt])
        rest = ca.substitute(balance.residual, xi_tt, ca.SX.zeros(self.n_strains))
        parts = ca.Function("parts", [xi, xi_t, u], [ca.diag(scale) @ mass, scale * rest])
        x, v, w = ca.MX.sym("xi", self.n_strains), ca.MX.sym("xi_t", self.n_strains), ca.MX.sym("u", u.numel())
        m, r = parts(x, v, w)
        return ca.Function(
            "acceleration", [x, v, w], [-ca.solve(m, r, "qr", {"eps": 1e-30})], ["xi", "xi_t", "u"], ["xi_tt"]
        )

    @cached_property
    def relaxation(self) -> tuple[Array, Array]:
        """Of every overstress its branch's fraction, and the rate 1/time in 1/s at which it relaxes."""
        given = np.array([(b.fraction, 1.0 / b.time) for b in self.branches]).reshape(-1, 2)
        fractions, rates = np.repeat(given, self.layout.n_free, axis=0).T
        return _fixed(fractions.copy()), _fixed(rates.copy())

    def overstress_rates(self, rates: ca.MX, overstress: ca.MX) -> ca.MX:
        """sigma_t = fraction xi_t - sigma / time (n_overstress,) per s, of ``rates`` (n_strains,), ``overstress``."""
        fractions, relaxing = (ca.DM(values) for values in self.relaxation)
        return fractions * ca.repmat(rates[: self.layout.n_free], len(self.branches), 1) - relaxing * overstress

    def native(self, function: ca.Function) -> ca.Function:
        """``function`` as this scene evaluates it: by the virtual machine of CasADi; compiled scenes differ."""
        return function

    # States and inputs -----------------------------------------------------------------------------------------------

    def state(self, strains: ArrayLike, rates: ArrayLike, u: ArrayLike, overstress: ArrayLike | None = None) -> Array:
        """Stack a state [xi, xi_t, u], with Maxwell branches [xi, xi_t, sigma, u], from its parts.

        Args:
            strains: xi (n_strains,).
            rates: xi_t (n_strains,) per s.
            u: inputs (n_inputs,).
            overstress: sigma (n_overstress,) of the branches, relaxed when not given.
        """
        n, hidden = self.n_strains, self.layout.n_overstress
        return np.concatenate(
            [
                finite_array(strains, "strains", (n,)),
                finite_array(rates, "rates", (n,)),
                finite_array(np.zeros(hidden) if overstress is None else overstress, "overstress", (hidden,)),
                self.checked_inputs(u, "u", (self.n_inputs,)),
            ]
        )

    def at_rest(self, strains: Array, u: Array) -> Array:
        """States (..., n_states) at rest with ``strains`` (..., n_strains) under inputs ``u`` (..., n_inputs)."""
        still = np.zeros((*strains.shape[:-1], self.layout.n_moving - self.n_strains))
        return np.concatenate([strains, still, u], axis=-1)

    def checked_inputs(self, u: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
        """Inputs as an array.

        Args:
            u: inputs (n_inputs,) or rows of them; columns that have the names of the inputs may have any order.
            name: what messages call them.
            shape: expected shape, None for any length.

        Raises ValueError for other shapes, entries that are not finite, a displacement that would shorten a tendon to
        nothing, and a tension that would push.
        """
        array = finite_array(in_order(u, self.input_names, "inputs", "the scene"), name, shape)
        start = 0
        for item in self.inputs:
            pull = self.pulls.get(item.name)
            if pull is not None:
                pull.check(array[..., start : start + item.size].reshape(-1, item.size), name)
            start += item.size
        return array

    @cached_property
    def input_limits(self) -> tuple[Array, Array]:
        """Lowest and highest inputs (n_inputs,) each that ``checked_inputs`` lets pass, infinite where any will do."""
        low, high, start = np.full(self.n_inputs, -np.inf), np.full(self.n_inputs, np.inf), 0
        for item in self.inputs:
            pull = self.pulls.get(item.name)
            if pull is not None:
                entries = slice(start, start + item.size)
                low[entries], high[entries] = pull.limits
            start += item.size
        return _fixed(low), _fixed(high)

    @cached_property
    def pulls(self) -> dict[str, Pull]:
        """What the inputs of tendons may be, by input."""
        return {t.name: t.pull(self.rod, self.rule) for t in self.terms if isinstance(t, TendonTerm)}


def _fixed(array: Array) -> Array:
    """The array itself, which nobody can write to: it is kept and handed out again."""
    array.flags.writeable = False
    return array
