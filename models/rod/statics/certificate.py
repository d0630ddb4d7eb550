"""A proof that the equilibrium is the only one: the energy is convex in the strains, whatever the shape."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.mapping import Mapped
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.buoyancy import Buoyancy
from pisplit.models.rod.terms.chambers import Chambers
from pisplit.models.rod.terms.damping import KelvinVoigt, Retardation
from pisplit.models.rod.terms.distributed import DistributedWrench
from pisplit.models.rod.terms.drag import AnisotropicDrag, LinearDrag, QuadraticDrag
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.loads import Input
from pisplit.models.rod.terms.maxwell import Maxwell
from pisplit.models.rod.terms.points import PointMass, PointWrench
from pisplit.models.rod.terms.pull import TendonTerm
from pisplit.models.rod.terms.wrench import TipWrench

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Terms that do nothing to a rod at rest, add a linear or convex energy (chambers, tendons), or dead forces.
KNOWN = (
    AnisotropicDrag,
    Base,
    Buoyancy,
    Chambers,
    DistributedWrench,
    Gravity,
    KelvinVoigt,
    LinearDrag,
    Maxwell,
    PointMass,
    PointWrench,
    QuadraticDrag,
    Retardation,
    TipWrench,
)


class Certificate(Rebuilt):
    """Lower bound of the stiffness of a scene at *every* shape, in parts of the elastic one.

    The energy of a taut tendon is convex in the strains: its length is, and tension grows with it. Only dead forces
    break convexity: with N(s) their resultant beyond s, the second variation of their work is at least
    -int |N| |turn|^2 ds, so that diag(b k) - |A|^T diag(b |N|) |A| with k = min(EI, GJ) bounds the stiffness.
    Where it is positive definite the equilibrium is the only one. In the plane this is a proof; in space no
    counterexample is known. There is no bound for follower loads, friction, moments in space, weights off the axis,
    tendons over disks (between which rods buckle), user's own terms, a moving base and rods that shear or stretch.

    Args:
        scene: the rod and what acts on it.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._last: tuple[Array, float] | None = None

    def bound(self, u: Array) -> float:
        """Lower bound of the stiffness under inputs ``u`` (n_inputs,): 1 without loads, -inf where none is known."""
        return float(self.bounds(u[None])[0])

    def bounds(self, rows: Array) -> Array:
        """The same (N,) under each of ``rows`` (N, n_inputs)."""
        if not self._usable:
            return np.full(len(rows), -np.inf)
        bounds = np.full(len(rows), self._constant) if self._constant is not None else self._bounds(rows)
        slack = rows[:, self._tensions].min(axis=1, initial=0.0) < 0.0
        return np.where(slack, -np.inf, bounds)

    def unique_below(self, u: Array) -> float:
        """Load factor up to which the equilibrium under ``u`` (n_inputs,) is unique; 0 where nothing is known."""
        if self._always is not None:
            return self._always
        if self._last is None or not np.array_equal(self._last[0], u):
            self._last = u.copy(), _factor(self.bound(u))
        return self._last[1]

    def unique_below_of_rows(self, rows: Array) -> Array:
        """The same (N,) of ``rows`` (N, n_inputs)."""
        if self._always is not None:
            return np.full(len(rows), self._always)
        return np.array([_factor(bound) for bound in self.bounds(rows).tolist()])

    @cached_property
    def _always(self) -> float | None:
        """The load factor, where it is the same under all inputs."""
        if not self._usable:
            return 0.0
        return None if self._constant is None or len(self._tensions) else _factor(self._constant)

    @cached_property
    def _usable(self) -> bool:
        scene = self.scene
        planar, terms = scene.rod.strain_set.planar, scene.terms
        if not all(type(t) in KNOWN or isinstance(t, TendonTerm) for t in terms) or without_energy(scene):
            return False
        if any(isinstance(t, Base) and (t.moves or t.inputs) for t in terms) or self._kept <= 0.0:
            return False
        if any(getattr(t, "disks", None) is not None for t in terms):  # chords are not convex in the strains
            return False
        if any(isinstance(t, PointMass) and any(t.offset) for t in terms):  # its weight has an arm that turns
            return False
        if not set(scene.rod.strain_set.free) <= {0, 1, 2} or (not planar and any(_has_moment(t) for t in terms)):
            return False
        xi, _, balance = scene.static_balance
        return not ca.depends_on(ca.vec(balance.internal_force), xi)

    @cached_property
    def _kept(self) -> float:
        """Part of the elastic stiffness that tendons which correct it leave."""
        return float(np.prod([t.kept_stiffness for t in self.scene.terms if isinstance(t, TendonTerm)]))

    @cached_property
    def _resultant(self) -> Mapped:
        """``u -> |N|`` at the nodes."""
        _, u, balance = self.scene.static_balance
        force = balance.internal_force
        return Mapped(ca.Function("resultant", [u], [ca.densify(ca.sqrt(ca.sum1(force * force)))]))

    @cached_property
    def _constant(self) -> float | None:
        """The bound, where it does not depend on the inputs."""
        _, u, balance = self.scene.static_balance
        if ca.depends_on(ca.vec(balance.internal_force), u):
            return None
        return float(self._bounds(np.zeros((1, self.scene.n_inputs)))[0])

    def _bounds(self, rows: Array) -> Array:
        force = self.scene.rule.weights * self._resultant(rows)
        turn = self._turn
        largest = np.linalg.eigvalsh(turn.T @ (force[:, :, None] * turn))[:, -1]
        return 1.0 - np.asarray(largest, dtype=np.float64)

    @cached_property
    def _turn(self) -> Array:
        """|turn| at the nodes (K, K) of unit strains at the nodes, in units in which the elastic stiffness is 1."""
        rod, rule = self.scene.rod, self.scene.rule
        softest = self._kept * rod.profile(rule.nodes).stiffness[list(rod.strain_set.free)].min(axis=0)
        turn: Array = np.abs(rule.integration) / np.sqrt(rule.weights * softest)
        return turn

    @cached_property
    def _tensions(self) -> Array:
        """Indices of the inputs that are tensions: they are convex only while they pull."""
        found: list[int] = []
        start = 0
        for item in self.scene.inputs:
            if any(getattr(t, "name", None) == item.name and isinstance(t, TendonTerm) for t in self.scene.terms):
                pull = self.scene.pulls[item.name]
                found += range(start, start + item.size) if pull.lengths is None else ()
            start += item.size
        return np.array(found, dtype=int)


def without_energy(scene: Scene) -> bool:
    """Whether loads of the ``scene`` have no energy, as far as is known: their stiffness is not symmetric."""
    planar = scene.rod.strain_set.planar
    return any(
        bool(getattr(t, "follower", False))
        or bool(getattr(t, "friction", 0.0))
        or not (type(t) in KNOWN or isinstance(t, TendonTerm))
        or (not planar and _has_moment(t))
        or (isinstance(t, Base) and t.moves)
        for t in scene.terms
    )


def _factor(bound: float) -> float:
    """Load factor at which a ``bound`` of the whole loads becomes zero; 0 where none is known."""
    return 0.0 if not np.isfinite(bound) else np.inf if bound >= 1.0 else 1.0 / (1.0 - bound)


def _has_moment(term: Any) -> bool:
    moment = getattr(term, "moment", None)
    return moment is not None and (isinstance(moment, Input) or callable(moment) or bool(np.any(moment)))
