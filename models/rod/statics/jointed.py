"""Equilibria of a rod whose base turns or slides freely: it goes to where its support need not hold it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.answers import Unresolved
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.certificate import without_energy
from pisplit.models.rod.statics.equilibrium import Equilibrium
from pisplit.models.rod.statics.flutter import Vibration
from pisplit.models.rod.statics.resolution import Resolution
from pisplit.models.rod.statics.search import TOLERANCE
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.loads import Input

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

PLACE, TURN = "place of the base", "turn of the base"
#: Steps of the base, their largest size (rad, parts of L), and that of one that leaves an unstable place.
STEPS, LARGEST, PUSH = 100, 0.3, 0.05
#: Stiffness of a joint in parts of EI/L up to which it resists nothing, and Newton steps of all unknowns at the end.
SOFT, LAST = 1e-7, 2


@dataclass(frozen=True)
class _Joint:
    """What a joint feels in parts of EI/L: scaled ``forces`` (f,), and the ``stiffness`` (f, f) with the rod following.

    ``residual`` is the largest of the whole balance, ``step`` (n,) the Newton step of all unknowns.
    """

    forces: Array
    stiffness: Array
    residual: float
    step: Array


class JointedScene(Rebuilt):
    """Equilibria of a scene whose base has a hinge or slides.

    The rod is clamped where its joint is, which ``Statics`` solves; the joint then follows the forces that it feels,
    downhill in energy, by Newton's method with the stiffness S that it has with the rod following (a Schur complement):

        S = K_qq - K_qx K_xx^-1 K_xq,   dq = |S|^-1 g

    with |S| the matrix of the moduli of its eigenvalues, so that no step goes uphill and unstable places are left.

    On a ball joint nothing holds the rod about its own axis. The usual balance of few nodes has a small torque there,
    which would turn it for ever; its ``variational`` twin has none and is solved in its place.

    Args:
        scene: the rod and what acts on it.
        base: its base.
    """

    def __init__(self, scene: Scene, base: Base) -> None:
        still = not (base.inputs or base.moves)
        self.given, self.base = scene, base
        self.scene = scene.variational() if base.hinge == "ball" and still else scene

    @cached_property
    def clamped(self) -> Scene:
        """The scene on a base whose pose is an input."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # said by the scene itself
            still = replace(
                self.base, position=Input(PLACE, 3), rotation=Input(TURN, 3), hinge=None, slides="", stiffness=0.0
            )
            return self.scene.replace(still)

    @cached_property
    def resolution(self) -> Resolution:
        """Tells whether the nodes are enough, for where the base comes to rest too."""
        return Resolution(self.scene)

    @cached_property
    def _pose(self) -> ca.Function:
        """``(q, u) -> `` position (3,) and rotation vector (3,) of the base."""
        symbols = {item.name: ca.SX.sym(item.name, item.size) for item in self.scene.inputs}
        q = ca.SX.sym("q", self.base.freedom)
        zero = ca.SX(*q.shape)
        state = self.base.state(symbols, False, (q, zero, zero))
        quaternion = ca.if_else(state.quaternion[0] < 0.0, -state.quaternion, state.quaternion)
        sine = ca.sqrt(ca.sumsqr(quaternion[1:]) + 1e-32)
        turn = 2.0 * ca.atan2(sine, quaternion[0]) / sine * quaternion[1:]
        return ca.Function("pose", [q, ca.vertcat(ca.SX(0, 1), *symbols.values())], [state.position, turn])

    def inputs(self, q: Array, u: Array) -> Array:
        """Inputs of the clamped scene for joint coordinates ``q`` (f,) under ``u`` (n_inputs,)."""
        place, turn = (np.asarray(v).ravel() for v in self._pose(q, u))
        parts, start = {PLACE: place, TURN: turn}, 0
        for item in self.scene.inputs:
            parts[item.name] = u[start : start + item.size]
            start += item.size
        return np.concatenate([parts[item.name] for item in self.clamped.inputs])

    @cached_property
    def _balance(self) -> ca.Function:
        """``(xi, u) -> `` scaled residual (n,), work (n,) of its rows on typical changes, and minus its derivative."""
        xi, u, balance = self.scene.static_balance
        unit = ca.DM(self.scene.nominal_strains * self.scene.weights)
        work = unit * balance.residual
        slope = -ca.jacobian(work, xi) @ ca.diag(ca.DM(self.scene.nominal_strains))
        return ca.Function("joint", [xi, u], [balance.residual / ca.DM(self.scene.nominal_residual), work, slope])

    def _at(self, x: Array, u: Array) -> _Joint:
        """What the joint feels at coordinates ``x`` (n,) under ``u`` (n_inputs,)."""
        residual, work, slope = (np.asarray(v) for v in self._balance(x, u))
        unit = min(self.scene.rod.stiffness[:2]) / self.scene.rod.length
        strains = self.scene.n_strains - self.base.freedom
        k = slope / unit
        forces = work.ravel() / unit
        follow = np.linalg.solve(k[:strains, :strains], np.column_stack([k[:strains, strains:], forces[:strains]]))
        stiffness = k[strains:, strains:] - k[strains:, :strains] @ follow[:, :-1]
        left = forces[strains:] - k[strains:, :strains] @ follow[:, -1]
        turned = np.linalg.lstsq(stiffness, left, rcond=SOFT)[0]
        step = np.concatenate([follow[:, -1] - follow[:, :-1] @ turned, turned]) * self.scene.nominal_strains
        return _Joint(forces[strains:], stiffness, float(np.abs(residual).max()), step)

    def solve(self, u: Array, start: Array | None) -> Equilibrium:
        """Where the rod comes to rest under ``u`` (n_inputs,), let go at ``start`` (n_strains,) if given."""
        scene, strains = self.scene, self.scene.n_strains - self.base.freedom
        q = np.zeros(self.base.freedom) if start is None else start[strains:].copy()
        guess = None if start is None else start[:strains]
        message, came = f"the base does not come to rest in {STEPS} steps", False
        for moved in range(STEPS):
            found = self._held_at(q, u, guess)
            guess = found.strains
            x = np.concatenate([guess, q])
            if not found.success:
                message = f"with the base held on the way: {found.message or 'no equilibrium'}"
                break
            joint = self._at(x, u)
            values, directions = np.linalg.eigh(0.5 * (joint.stiffness + joint.stiffness.T))
            if np.abs(joint.forces).max() <= TOLERANCE:
                if values[0] >= -SOFT:
                    came, message = True, ""
                    break
                change = PUSH * directions[:, 0]
            else:
                change = directions @ (directions.T @ joint.forces / np.maximum(np.abs(values), SOFT))
            change *= min(1.0, LARGEST / np.abs(change).max())
            if moved == STEPS - 1 and np.abs(values[np.argmax(np.abs(directions.T @ change))]) <= SOFT:
                name = self.base.joint_names[int(np.abs(change).argmax())]
                message = f"nothing holds the base: it goes on along {name}"
            q = q + change * scene.nominal_strains[strains:]
        if came:
            x = self._settled(x, u)
            self.resolution.check(scene.at_rest(x, u)[None])
        branch = ("settled" if moved else found.branch) if came else "unverified"
        vibration = self._vibration(x, u) if came and without_energy(scene) else None
        if vibration is not None:
            came, branch, message = False, "flutters", f"it flutters: {vibration}"
        return Equilibrium(
            state=scene.at_rest(x, u),
            success=came,
            residual=self._at(x, u).residual,
            iterations=moved + 1,
            solver="path",
            tensions=found.tensions,
            slack=found.slack,
            message=message,
            stable=False if vibration is not None else came or None,
            branch=branch,
            scene=self.given,
        )

    def _vibration(self, x: Array, u: Array) -> Vibration | None:
        """The vibration of rod and joint that grows about coordinates ``x`` (n,) under ``u`` (n_inputs,), or None."""
        branches = self.scene.statics().branches
        return branches.flutter.at(branches.whitened.of(branches.search.scaled(x)), u)

    def _held_at(self, q: Array, u: Array, guess: Array | None) -> Equilibrium:
        """Equilibrium with the base held at ``q`` (f,) under ``u``, near strains ``guess`` or loaded from nothing."""
        statics, inputs = self.clamped.statics(), self.inputs(q, u)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Unresolved)  # of a shape that is on the way alone
            found = statics.solve(inputs, guess)
            return found if found.success or guess is None else statics.solve(inputs)

    def _settled(self, x: Array, u: Array) -> Array:
        """Coordinates after Newton steps of all unknowns, as long as they make the residual smaller."""
        joint = self._at(x, u)
        for _ in range(LAST):
            better = self._at(x + joint.step, u)
            if not better.residual < joint.residual:
                break
            x, joint = x + joint.step, better
        return x

    def of_clamped(self, x: Array, u: Array) -> Array:
        """The state at rest of the clamped scene with coordinates ``x`` (n_strains,) under ``u`` (n_inputs,)."""
        strains = self.scene.n_strains - self.base.freedom
        return self.clamped.at_rest(x[:strains], self.inputs(x[strains:], u))

    def margin(self, x: Array, u: Array) -> float:
        """Least stiffness of the rod on the clamped base, or of the joint with the rod following, in parts of EI/L.

        At coordinates ``x`` (n_strains,) under ``u`` (n_inputs,).
        """
        stiffness = self._at(x, u).stiffness
        of_joint = float(np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))[0])
        return min(of_joint, self.clamped.statics().margin(self.of_clamped(x, u)))
