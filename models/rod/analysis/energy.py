"""Energy accounts of a scene: what is stored, what every term does to the rod, what is lost."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.brief import brief
from pisplit.checks import Array, finite_array
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.sharing import lock_of
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.buoyancy import Buoyancy
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.held import held_tip
from pisplit.models.rod.terms.loads import Term, by_row
from pisplit.models.rod.terms.maxwell import Maxwell
from pisplit.models.rod.terms.points import PointMass

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene


@dataclass(frozen=True)
class Energies:
    """Stored energies in J of N states: kinetic, elastic (of the rod and the springs of its Maxwell branches) and
    gravity (of constant gravity), each (N,)."""

    kinetic: Array
    elastic: Array
    gravity: Array

    @property
    def total(self) -> Array:
        """Their sum (N,)."""
        return self.kinetic + self.elastic + self.gravity


@brief
@dataclass(frozen=True)
class EnergyAccount:
    """Energies along a trajectory in J.

    Attributes:
        t: (T+1,) in s.
        stored: kinetic, elastic and gravity energy (T+1,).
        work: name of a term -> work (T+1,) that it has done on the rod since the start. Tendons and springs count here:
            one that is stretched takes energy from the rod and gives it back later.
        dissipated: energy (T+1,) that terms which act on rates alone (damping, drag) and dashpots of Maxwell branches
            have taken since the start.
    """

    t: Array
    stored: Energies
    work: dict[str, Array]
    dissipated: Array

    @property
    def imbalance(self) -> Array:
        """Gain of stored energy + dissipated energy - work (T+1,): the error of the time integration."""
        gain = self.stored.total - self.stored.total[0]
        imbalance: Array = gain + self.dissipated - sum(self.work.values(), np.zeros_like(gain))
        return imbalance

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Stored energies, work, dissipation and what they miss; written to ``path`` where one is given."""
        from pisplit.models.rod.analysis.pictures import plot_account

        return plot_account(self, path)


def energies(scene: Scene, x: ArrayLike) -> Energies:
    """Stored energies of states ``x`` (N, n_states) of a scene.

    Raises ValueError for a base that moves, and for states so large that the energies overflow.
    """
    states = finite_array(x, "x", (None, scene.n_states))
    strains, rates, overstress, _ = scene.layout.split(states)
    with lock_of(scene):
        function = stored(scene)
        parts = function.map(len(states))(strains.T, rates.T, overstress.T) if len(states) else np.empty((3, 0))
    kinetic, elastic, gravity = (finite_answer(np.asarray(part).ravel(), "energies") for part in parts)
    return Energies(kinetic, elastic, gravity)


def account(scene: Scene, t: Array, x: Array, work: Array) -> EnergyAccount:
    """Energies along a trajectory.

    Args:
        scene: what moves.
        t: times (T+1,) in s.
        x: states (T+1, n_states).
        work: of the terms (T+1, n_terms) in J since the start; see ``powers``.
    """
    names = term_names(scene)
    weights = _weight_terms(scene)
    others = [i for i, term in enumerate(scene.terms) if term not in weights]
    lost = [i for i in others if _acts_on_rates(scene, scene.terms[i])]
    kept = [i for i in others if i not in lost]
    done = {names[i]: work[:, i].copy() for i in kept}
    return EnergyAccount(t.copy(), energies(scene, x), done, -work[:, lost].sum(axis=1))


def term_names(scene: Scene) -> tuple[str, ...]:
    """A name for every term of ``scene``: its type, numbered where there are several of them."""
    kinds = [type(term).__name__ for term in scene.terms]
    seen: Counter[str] = Counter()
    names = []
    for kind in kinds:
        seen[kind] += 1
        names.append(kind if kinds.count(kind) == 1 else f"{kind} {seen[kind]}")
    return tuple(names)


def stored(scene: Scene) -> ca.Function:
    """``(xi, xi_t, sigma) -> kinetic, elastic, gravity`` energy in J of ``scene``.

    Kinetic energy is half the rates times the mass matrix of the balance, elastic energy half the strains times the
    stress of the rod alone: the Gauss quadrature of the usual densities, for everything that has mass or stiffness.
    The spring of a Maxwell branch holds K sigma^2 / (2 fraction) per length.
    """
    if "_stored" not in scene.__dict__:
        _check_base(scene)
        xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
        balance = replace(balance, reaction=None)  # what holds the tip has no mass
        weights, sigma = ca.DM(scene.weights), ca.SX.sym("sigma", scene.layout.n_overstress)
        momentum = -weights * ca.jtimes(balance.residual, xi_tt, xi_t)
        rest = _residual(scene, (), xi, ca.SX(scene.n_strains, 1), u)
        elastic = -0.5 * ca.dot(xi - ca.DM(scene.rest_coordinates), weights * rest)
        for branch, s in zip(scene.branches, _by_branch(scene, sigma), strict=True):
            elastic += 0.5 / branch.fraction * _square(scene, s)
        parts = [0.5 * ca.dot(xi_t, momentum), elastic, _potential(scene, xi)]
        scene.__dict__["_stored"] = ca.Function("stored", [xi, xi_t, sigma], parts)
    found: ca.Function = scene.__dict__["_stored"]
    return found


def powers(scene: Scene) -> ca.Function:
    """``(xi, xi_t, u) -> power`` (n_terms,) in W that every term of ``scene`` puts into the motion.

    The power of a term is what it adds to the balance, times the rates, integrated along the rod. Inertia of added
    masses is kinetic energy and not part of it; their weight is. That of a Maxwell branch is what its dashpot loses,
    for what its spring takes is stored: -K sigma^2 / (fraction time) per length. u is [sigma, u] (n_acting,).
    """
    if "_powers" not in scene.__dict__:
        _check_base(scene)
        n, layout = scene.n_strains, scene.layout
        xi, xi_t, acting = ca.SX.sym("xi", n), ca.SX.sym("xi_t", n), ca.SX.sym("u", layout.n_acting)
        u = acting[layout.n_overstress :]
        lost = dict(zip(scene.branches, _by_branch(scene, acting[: layout.n_overstress]), strict=True))
        gravity = tuple(t for t in scene.terms if isinstance(t, Gravity))
        rates = ca.DM(scene.weights) * xi_t
        work = []
        for term in scene.terms:
            if isinstance(term, Maxwell):
                taken = _square(scene, lost[term]) / (term.fraction * term.time) if term in lost else ca.SX(0)
                work.append(-taken)
                continue
            beside = () if isinstance(term, Gravity) else gravity  # masses read the gravity for their weight
            load = _residual(scene, (*beside, term), xi, xi_t, u) - _residual(scene, beside, xi, xi_t, u)
            work.append(ca.dot(rates, load))
        total = ca.vertcat(ca.SX(0, 1), *work)
        scene.__dict__["_powers"] = ca.Function("powers", [xi, xi_t, acting], [total])
    found: ca.Function = scene.__dict__["_powers"]
    return found


def _acts_on_rates(scene: Scene, term: Term) -> bool:
    """Whether a term leaves a rod at rest alone."""
    xi, u = ca.SX.sym("xi", scene.n_strains), ca.SX.sym("u", scene.n_inputs)
    loads = replace(scene.balance(xi, ca.SX(*xi.shape), None, u), terms=(term,)).loads
    parts = (loads.force, loads.moment, loads.tip_force, loads.tip_moment, loads.stress_w, loads.stress_v)
    return all(part.is_zero() for part in (*parts, loads.point_force, *loads.point_moments.values()))


def _weight_terms(scene: Scene) -> tuple[Term, ...]:
    """Terms whose load is weight in a constant gravity; none when the gravity is an input."""
    gravity = [t for t in scene.terms if isinstance(t, Gravity)]
    if any(t.inputs for t in gravity):
        return ()
    return tuple(t for t in scene.terms if isinstance(t, Gravity | Buoyancy | PointMass))


def _potential(scene: Scene, xi: ca.SX) -> ca.SX:
    """Potential energy of the weights in J, zero where the base of the world axes is."""
    u = ca.SX.sym("u", scene.n_inputs)
    balance = scene.balance(xi, ca.SX(*xi.shape), None, u)
    motion, moment = balance.motion, ca.SX(3, 1)  # moment: int rho A p, plus added masses, less the displaced medium
    for term in _weight_terms(scene):
        if isinstance(term, Gravity):
            moment += motion.total(motion.position * by_row(motion.profile.mass, 3))
        elif isinstance(term, Buoyancy):
            moment -= term.density * motion.total(motion.position * by_row(motion.profile.area, 3))
        elif isinstance(term, PointMass):
            arm = motion.frame_at(term.s) @ ca.SX(ca.DM(list(term.offset)))
            moment += term.mass * (motion.position_at([term.s]) + arm)
    return -ca.dot(balance.loads.gravity, moment) if _weight_terms(scene) else ca.SX(0.0)


def _residual(scene: Scene, terms: tuple[Term, ...], xi: ca.SX, xi_t: ca.SX, u: ca.SX) -> ca.SX:
    """Residual of the rod on its base with some of the terms, without inertia."""
    base = tuple(t for t in scene.terms if isinstance(t, Base) and t not in terms)
    return replace(scene.balance(xi, xi_t, None, u), terms=(*base, *terms), reaction=None).residual


def _by_branch(scene: Scene, sigma: ca.SX) -> list[ca.SX]:
    """Overstress (n_free,) of each branch."""
    n = scene.layout.n_free
    return [sigma[k * n : (k + 1) * n] for k in range(len(scene.branches))]


def _square(scene: Scene, sigma: ca.SX) -> ca.SX:
    """int K sigma^2 ds of the overstress (n_free,) of a branch in J."""
    stiffness = scene.rod.profile(scene.rule.nodes).stiffness[list(scene.rod.strain_set.free)].T.ravel()
    return ca.dot(ca.DM(scene.weights[: len(stiffness)] * stiffness) * sigma, sigma)


def _check_base(scene: Scene) -> None:
    if any(isinstance(t, Base) and (t.inputs or t.moves) for t in scene.terms):
        raise ValueError(
            "energies are those of a rod on a resting base; give Base(...) a fixed pose and nothing that moves"
        )
    tip = held_tip(scene.terms)
    if tip is not None and tip.moves:
        raise ValueError("energies leave out the work on a tip that is driven; give HeldTip(...) a fixed pose")
