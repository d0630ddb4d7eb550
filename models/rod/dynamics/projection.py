"""States whose tip is where it is held: starts are put there, and what an integrator is off by is taken back."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.base import joint_stiffness
from pisplit.models.rod.terms.held import held_tip

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Distance from the conditions (parts of L, rad) from which on a state is not one of a held tip.
FAR = 1e-2
#: Newton corrections of a state, at most, and what is left of the conditions when they end.
CORRECTIONS, LEFT = 8, 1e-13
#: Least share of the largest response to the wrench at the tip that counts: straight rods do not shorten.
RESPONSE = 1e-12


class Projection(Rebuilt):
    """The nearest states that meet the conditions at the tip and their rates, nearest in elastic energy.

    Args:
        scene: with a ``HeldTip``.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @classmethod
    def of(cls, scene: Scene) -> Projection | None:
        """That of a ``scene``, None where its tip is free.

        Raises ValueError for a tip whose position or rotation is an input without its rates.
        """
        tip = held_tip(scene.terms)
        if tip is None:
            return None
        names = {item.name for item in tip.inputs}
        for pose, rate in (("position", "velocity"), ("rotation", "spin")):
            value, moves = getattr(tip, pose), getattr(tip, rate)
            if getattr(value, "name", None) in names and getattr(moves, "name", None) not in names:
                raise ValueError(
                    f"the {pose} of HeldTip is an input and its {rate} is not: a motion needs both; "
                    "HeldTip.driven() has them, tip_commands() makes rows of them"
                )
        return cls(scene)

    @cached_property
    def _conditions(self) -> ca.Function:
        """``(xi, xi_t, u) -> g, G, g_t, change of strains by multipliers`` (n, c), see ``equations.held``."""
        from pisplit.models.rod.equations.held import Conditions

        scene = self.scene
        xi, xi_t, u = (
            ca.SX.sym("xi", scene.n_strains),
            ca.SX.sym("xi_t", scene.n_strains),
            ca.SX.sym("u", scene.n_inputs),
        )
        balance = scene.balance(xi, xi_t, None, u)
        tip = held_tip(scene.terms)
        assert tip is not None
        g, slope, g_t, _ = Conditions(balance, tip).chain
        rod = scene.rod
        stiffness = rod.profile(scene.rule.nodes).stiffness[list(rod.strain_set.free)].T.ravel()
        stiffness = np.append(stiffness, joint_stiffness(rod, scene.terms))
        soft = ca.diag(ca.DM(1.0 / (stiffness * scene.weights) * min(rod.stiffness[:2]) / rod.length)) @ slope.T
        return ca.Function("conditions", [xi, xi_t, u], [g, slope, g_t, soft])

    def state(self, x: Array, what: str = "x0") -> Array:
        """The state [xi, xi_t, u] (n_states,) nearest to ``x`` (n_states,), which ``what`` names in messages.

        Raises ValueError for a state far from the conditions, or one at which they depend on one another (a straight
        rod that cannot be compressed).
        """
        found, layout = x.copy(), self.scene.layout
        for k in range(CORRECTIONS):
            g, slope, _, soft = self._at(found)
            worst = float(np.abs(g).max())
            if k == 0 and not worst <= FAR:
                raise ValueError(
                    f"the tip of {what} is {worst:.2g} (parts of L, rad) from where it is held under its inputs; "
                    "start from statics().solve(u).state, and give rates that fit the pose"
                )
            found[layout.strains] -= (soft @ self._weights(slope @ soft, g, what)).ravel()
            if worst <= LEFT:
                break
        _, slope, g_t, soft = self._at(found)
        found[layout.rates] -= (soft @ self._weights(slope @ soft, g_t, what)).ravel()
        return found

    def _at(self, x: Array) -> list[Array]:
        strains, rates, _, u = self.scene.layout.split(x)
        return [np.asarray(v) for v in self._conditions(strains, rates, u)]

    def _weights(self, response: Array, missed: Array, what: str) -> Array:
        values = np.linalg.svd(response, compute_uv=False)
        if not (np.isfinite(values).all() and values[-1] > RESPONSE * values[0]):
            raise ValueError(
                f"the tip of {what} cannot be moved in every direction in which it is held (a straight rod that does "
                "not shorten); start from statics().solve(u).state"
            )
        solved: Array = np.asarray(np.linalg.solve(response, missed), dtype=np.float64)
        return solved
