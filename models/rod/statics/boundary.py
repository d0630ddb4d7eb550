"""Equilibria with the tip pinned or clamped: the wrench at the tip is part of the solution."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pisplit.checks import Array, finite_array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.continuation import follow
from pisplit.models.rod.statics.search import TOLERANCE
from pisplit.models.rod.terms.loads import Input
from pisplit.models.rod.terms.wrench import TipWrench

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

_FORCE, _MOMENT = "force at the tip", "moment at the tip"


@dataclass(frozen=True)
class FixedTipEquilibrium:
    """An equilibrium whose tip is pinned (its position is prescribed) or clamped (its rotation too).

    Attributes:
        state: [xi, 0, u] (n_states,).
        force: (3,) in N and moment: (3,) in N m at the tip, in world axes; the moment of a pinned tip is zero.
        success: whether balance and pose are met; message: why not, empty on success.
        residual: largest error of balance (parts of EI/L) and pose (parts of L, rad).
        scene: the scene in equilibrium.
    """

    state: Array
    force: Array
    moment: Array
    success: bool
    residual: float
    message: str
    scene: Scene = field(repr=False, compare=False)


class FixedTip(Rebuilt):
    """Equilibria of a scene with its tip in a given place; see ``Statics.pin_tip`` and ``Statics.clamp_tip``.

    Args:
        scene: the rod and what acts on it.
        clamped: whether the rotation of the tip is prescribed beside its position.
    """

    def __init__(self, scene: Scene, clamped: bool) -> None:
        self.scene = scene
        planar = scene.rod.strain_set.planar
        self._axes = [0, 2] if planar else [0, 1, 2]
        self._turns = ([1] if planar else [0, 1, 2]) if clamped else []
        self._force_scale = min(scene.rod.stiffness[:2]) / scene.rod.length**2
        self._moment_scale = self._force_scale * scene.rod.length

    @cached_property
    def _errors(self) -> ca.Function:
        """``(x, [u, p, turn]) -> `` errors of balance (paper, eq. cosserat_rod_eq) and pose, scaled."""
        scene = self.scene
        loaded = scene + TipWrench(Input(_FORCE, 3), Input(_MOMENT, 3))
        n, m = scene.n_strains, scene.n_inputs
        xi, inputs, balance = loaded.static_balance
        motion = balance.motion
        x, u = ca.SX.sym("x", n + len(self._axes) + len(self._turns)), ca.SX.sym("u", m)
        p, turn = ca.SX.sym("p", 3), ca.SX.sym("turn", 3, 3)
        off = ca.inv_skew(turn.T @ motion.tip_frame) - ca.inv_skew(motion.tip_frame.T @ turn)
        pose = [(motion.tip - p)[self._axes] / scene.rod.length, 0.5 * off[self._turns]]
        errors = ca.vertcat(balance.residual / ca.DM(loaded.nominal_residual), *pose)
        wrench = self._wrench(x[n:], ca.SX)
        known = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x[:n]
        (errors,) = ca.substitute([errors], [xi, inputs], [known, ca.vertcat(u, wrench)])
        return ca.Function("errors", [x, ca.vertcat(u, p, ca.vec(turn))], [errors], {"cse": True})

    @cached_property
    def _solver(self) -> ca.Function:
        options: dict[str, Any] = {"error_on_fail": True, "abstol": 1e-10, "max_iter": 30, "linear_solver": "qr"}
        return ca.rootfinder("fixed_tip", "newton", self._errors, {**options, "show_eval_warnings": False})

    def _wrench(self, multipliers: ca.SX | Array, kind: type) -> ca.SX | Array:
        """Force and moment (6,) from the scaled unknowns."""
        wrench = kind.zeros(6) if kind is ca.SX else np.zeros(6)
        for k, axis in enumerate(self._axes):
            wrench[axis] = self._force_scale * multipliers[k]
        for k, axis in enumerate(self._turns):
            wrench[3 + axis] = self._moment_scale * multipliers[len(self._axes) + k]
        return wrench

    def _bend(self, way: Array) -> Array:
        """A slight bend of the scaled unknowns towards where the tip shall go."""
        free, nodes = self.scene.rod.strain_set.free, self.scene.nodes
        across = way[:2] / np.linalg.norm(way[:2]) if np.linalg.norm(way[:2]) > 0.0 else np.array([1.0, 0.0])
        node = [{0: -across[1], 1: across[0]}.get(component, 0.0) for component in free]
        taper = 1.0 - self.scene.rule.nodes / self.scene.rod.length
        bend = np.zeros(self.scene.n_strains + len(self._axes) + len(self._turns))
        bend[: len(free) * nodes] = np.outer(taper, node).ravel()
        return bend

    def solve(self, u: Array, position: ArrayLike, rotation: ArrayLike | None, free: Array) -> FixedTipEquilibrium:
        """Equilibrium under inputs ``u`` (n_inputs,) reached from the free one along a straight way.

        Args:
            u: inputs.
            position: of the tip (3,) in m.
            rotation: of a clamped tip (3, 3), None for a pinned one.
            free: state (n_states,) of the equilibrium without the constraint.

        Raises ValueError for a rotation that is none.
        """
        scene = self.scene
        n = scene.n_strains
        goal = finite_array(position, "position", (3,))
        here, frame = scene.fields(free, [scene.rod.length])[0, :3], scene.fields(free, [scene.rod.length])[0, 3:12]
        start = Rotation.from_matrix(frame.reshape(3, 3))
        turn = np.zeros(3)
        if rotation is not None:
            wanted = finite_array(rotation, "rotation", (3, 3))
            if np.abs(wanted @ wanted.T - np.eye(3)).max() > 1e-6 or np.linalg.det(wanted) < 0.0:
                raise ValueError("rotation is not a rotation matrix; give R with R R^T = I and det R = 1")
            turn = (start.inv() * Rotation.from_matrix(wanted)).as_rotvec()

        def parameters(t: float) -> Array:
            now = (start * Rotation.from_rotvec(t * turn)).as_matrix()
            return np.concatenate([u, here + t * (goal - here), now.ravel(order="F")])

        def at(t: float, guess: Array) -> Array | None:
            try:
                x = np.asarray(self._solver(guess, parameters(t))).ravel()
            except RuntimeError:
                return None
            return x if np.all(np.isfinite(x)) else None

        first = np.zeros(n + len(self._axes) + len(self._turns))
        first[:n] = (free[:n] - scene.rest_coordinates) / scene.nominal_strains
        x, reached = follow(at, first)
        if reached == 0.0:  # the tip of a straight inextensible rod cannot start to move along it
            x, reached = follow(at, first + self._bend(goal - here))
        residual = float(np.abs(np.asarray(self._errors(x, parameters(1.0)))).max())
        success = bool(residual <= TOLERANCE)
        wrench = np.asarray(self._wrench(x[n:], np.ndarray))
        state = np.concatenate([scene.rest_coordinates + scene.nominal_strains * x[:n], np.zeros(n), u])
        message = "" if success else f"the tip could be moved {100.0 * reached:.0f} % of the way"
        return FixedTipEquilibrium(state, wrench[:3], wrench[3:], success, residual, message, scene)
