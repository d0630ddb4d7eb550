"""The balance of a rod whose tip is held: strains, and multipliers of which the wrench at the tip consists."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.loads import Input
from pisplit.models.rod.terms.wrench import TipWrench

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

_FORCE, _MOMENT = "force at the tip", "moment at the tip"
#: Unit of the multipliers in EI/L^2 and EI/L: the Euler load of a clamped strut, so that they compare with angles.
UNIT = 4.0 * np.pi**2
#: Step of differences of scaled unknowns.
PROBE = 1e-6


class HeldBalance(Rebuilt):
    """Balance of a scene and conditions on the pose of its tip, in scaled strains x and multipliers.

    Args:
        scene: the rod and what acts on it.
        clamped: whether the rotation of the tip is prescribed beside its position.
        axes: world axes along which the position is prescribed.
    """

    def __init__(self, scene: Scene, clamped: bool, axes: Sequence[int] = (0, 1, 2)) -> None:
        self.scene, self.clamped = scene, clamped
        planar = scene.rod.strain_set.planar
        self.axes = [k for k in axes if not (planar and k == 1)]
        self._turns = ([1] if planar else [0, 1, 2]) if clamped else []
        self._force_unit = UNIT * min(scene.rod.stiffness[:2]) / scene.rod.length**2
        self._moment_unit = self._force_unit * scene.rod.length

    @property
    def n_held(self) -> int:
        """Number of conditions and multipliers."""
        return len(self.axes) + len(self._turns)

    def on(self, scene: Scene) -> HeldBalance:
        """The same of another ``scene`` of the rod."""
        return HeldBalance(scene, self.clamped, self.axes)

    @cached_property
    def _balance(self) -> tuple[list[ca.SX], ca.SX, ca.SX]:
        """Symbols x, multipliers, u and pose; errors of balance (paper, eq. cosserat_rod_eq) and of the pose."""
        scene = self.scene
        loaded = scene + TipWrench(Input(_FORCE, 3), Input(_MOMENT, 3))
        n, m = scene.n_strains, scene.n_inputs
        xi, inputs, balance = loaded.static_balance
        motion = balance.motion
        x, many = ca.SX.sym("x", n), ca.SX.sym("multipliers", self.n_held)
        u, p, turn = ca.SX.sym("u", m), ca.SX.sym("p", 3), ca.SX.sym("turn", 3, 3)
        off = ca.inv_skew(turn.T @ motion.tip_frame) - ca.inv_skew(motion.tip_frame.T @ turn)
        # The moment acts along the axes of the prescribed frame, which does not turn with the rod.
        pose = ca.vertcat((motion.tip - p)[self.axes] / scene.rod.length, 0.5 * off[self._turns])
        residual = balance.residual / ca.DM(loaded.nominal_residual)
        known = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x
        wrench = self.wrench(many, turn, ca.SX.zeros(3), ca.SX.zeros(3))
        residual, pose = ca.substitute([residual, pose], [xi, inputs], [known, ca.vertcat(u, *wrench)])
        return [x, many, u, ca.vertcat(p, ca.vec(turn))], residual, pose

    @cached_property
    def errors(self) -> ca.Function:
        """``(x, multipliers, u, pose) -> `` errors of balance and pose, and their slopes."""
        symbols, residual, pose = self._balance
        slopes = [ca.jacobian(residual, symbols[0]), ca.jacobian(residual, symbols[1]), ca.jacobian(pose, symbols[0])]
        return ca.Function("errors", symbols, [residual, pose, *map(ca.densify, slopes)])

    @cached_property
    def _tip(self) -> ca.Function:
        """``(xi, u) -> `` position (3,) and rotation (3, 3) of the tip."""
        xi, u, balance = self.scene.static_balance
        return ca.Function("tip", [xi, u], [balance.motion.tip, ca.densify(balance.motion.tip_frame)])

    def pose(self, state: Array) -> tuple[Array, Array]:
        """Position (3,) and rotation (3, 3) of the tip of a ``state`` (n_states,)."""
        strains, *_, u = self.scene.layout.split(state)
        place, frame = (np.asarray(v) for v in self._tip(strains, u))
        return place.ravel(), frame

    @cached_property
    def _both(self) -> ca.Function:
        """``(x, multipliers, u, pose) -> `` errors of balance and pose in a column, of a column a probe."""
        symbols, residual, pose = self._balance
        return ca.Function("both", symbols, [ca.vertcat(residual, pose)]).map(sum(s.numel() for s in symbols[:2]) + 1)

    def newton_step(self, xi: Array, u: Array, pose: Array) -> Array:
        """Change of strains ``xi`` (n,) by a Newton step under ``u`` (n_inputs,) with the tip held at ``pose`` (12,).

        From the multipliers that balance them best; slopes by differences, for it is called once a grid. Raises
        LinAlgError where there is none.
        """
        x, n, held = (xi - self.scene.rest_coordinates) / self.scene.nominal_strains, len(xi), self.n_held

        def slopes(y: Array) -> tuple[Array, Array]:
            columns = (y + np.vstack([np.zeros(n + held), PROBE * np.eye(n + held)])).T
            errors = np.asarray(self._both(columns[:n], columns[n:], u, pose)).T
            return errors[0], (errors[1:] - errors[0]).T / PROBE

        errors, by = slopes(np.append(x, np.zeros(held)))
        best = np.append(x, np.linalg.lstsq(by[:n, n:], -errors[:n], rcond=None)[0])
        errors, by = slopes(best)
        change: Array = self.scene.nominal_strains * np.linalg.solve(by, -errors)[:n]
        return change

    def wrench(self, multipliers: Any, turn: Any, force: Any, moment: Any) -> tuple[Any, Any]:
        """World force and moment, (3,) each, of ``multipliers`` at a tip with the rotation ``turn`` (3, 3).

        ``force`` and ``moment`` come as zeros.
        """
        for k, axis in enumerate(self.axes):
            force[axis] = self._force_unit * multipliers[k]
        for k, axis in enumerate(self._turns):
            moment[axis] = self._moment_unit * multipliers[len(self.axes) + k]
        return force, turn @ moment
