"""First derivatives of an equilibrium: how its pose follows inputs and wrenches, and whether it is stable."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.equations.held import slopes
from pisplit.models.rod.terms.loads import Input
from pisplit.models.rod.terms.points import PointWrench

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

_FORCE, _MOMENT = "force of the probe", "moment of the probe"


@dataclass(frozen=True)
class PoseSensitivity:
    """How the pose at one arclength follows, at an equilibrium; a pose change is (dp, dtheta) in world axes, m and rad.

    Attributes:
        p: position (3,) in m; R: rotation (3, 3).
        jacobian: (6, n_inputs) pose change per unit of each input (the tendon Jacobian of a tendon arm).
        compliance: (6, 6) pose change per world force in N and moment in N m at that arclength.
        d_strains: (n_strains, n_inputs) change of the free strains per unit of each input.
    """

    p: Array
    R: Array
    jacobian: Array
    compliance: Array
    d_strains: Array


@dataclass(frozen=True)
class Stability:
    """Stability of an equilibrium from the tangent stiffness of the free strains.

    Attributes:
        margin: smallest eigenvalue of the tangent stiffness in parts of the elastic stiffness of the rod: 1 for a free
            rod, 0 where an equilibrium buckles; least real part where loads have no energy.
        mode: free strains (n_strains,) of that eigenvalue, largest entry 1.
        asymmetry: size of the antisymmetric part of the tangent stiffness in parts of the symmetric one. Follower loads
            make it: with them a positive margin rules out buckling (divergence) but not flutter. In a spatial scene on
            few nodes the usual balance adds some; ``scene.variational()`` does not.
        growth: rate in 1/s at which the vibration grows that grows fastest in parts of its frequency, by the linearised
            motion with the inertia and damping of the scene; 0 where none does. Asked where loads have no energy.
    """

    margin: float
    mode: Array
    asymmetry: float
    growth: float = 0.0

    @property
    def stable(self) -> bool:
        """Whether the margin is positive and no vibration grows."""
        return self.margin > 0.0 and not self.growth


class Tangent:
    """Derivatives of the static balance of a scene and of the pose at ``s``, built once: see ``PoseSensitivity``."""

    def __init__(self, scene: Scene, s: float) -> None:
        self.scene = scene
        probe = PointWrench(s, Input(_FORCE, 3), Input(_MOMENT, 3))
        scene = scene + probe
        xi, u, balance = scene.static_balance
        motion, scale = balance.motion, ca.diag(1.0 / ca.DM(scene.nominal_residual))
        frame = motion.frame_at(s)
        outputs = [motion.position_at([s]), frame]
        changes = [scale @ block for block in slopes(balance, [xi, u])]
        changes += [ca.jacobian(value, symbol) for value in (outputs[0], ca.vec(frame)) for symbol in (xi, u)]
        self._function = ca.Function("tangent", [xi, u], outputs + changes)

    def sensitivity(self, state: Array) -> PoseSensitivity:
        """Derivatives at an equilibrium ``state`` [xi, 0, u] (n_states,), by the implicit function theorem."""
        m, (strains, *_, u) = self.scene.n_inputs, self.scene.layout.split(state)
        inputs = np.concatenate([u, np.zeros(6)])
        values = [finite_answer(np.asarray(v), "derivatives of the balance") for v in self._function(strains, inputs)]
        p, frame, r_xi, r_u, p_xi, p_u, frame_xi, frame_u = values
        try:
            follow: Array = np.asarray(-np.linalg.solve(r_xi, r_u), dtype=np.float64)
        except np.linalg.LinAlgError:
            raise ValueError(
                "the equilibrium has no derivatives: the tangent stiffness is singular (it buckles); change its inputs"
            ) from None
        turn = frame_xi @ follow + frame_u
        change = np.vstack([p_xi @ follow + p_u, _rotation_vectors(turn, frame)])
        return PoseSensitivity(p.ravel(), frame, change[:, :m], change[:, m:], follow[:, :m])


def stability(scene: Scene, state: Array) -> Stability:
    """Tangent stiffness of ``scene`` at an equilibrium ``state`` [xi, 0, u], in parts of the elastic one."""
    strains, *_, inputs = scene.layout.split(state)
    if "_stiffness" not in scene.__dict__:
        xi, u, balance = scene.static_balance
        weights = ca.DM(np.repeat(scene.rule.weights, scene.rod.strain_set.n_fields))
        bare = replace(balance, terms=())
        pair = [-ca.diag(weights) @ ca.jacobian(b.residual, xi) for b in (balance, bare)]
        scene.__dict__["_stiffness"] = ca.Function("stiffness", [xi, u], pair)
    found = scene.__dict__["_stiffness"](strains, inputs)
    tangent, elastic = (finite_answer(np.asarray(k), "stiffnesses") for k in found)
    symmetric, skew = 0.5 * (tangent + tangent.T), 0.5 * (tangent - tangent.T)
    from scipy.linalg import eigh  # slow to load, and of no use to an equilibrium alone

    values, modes = eigh(symmetric, elastic, subset_by_index=[0, 0])
    mode = modes[:, 0] / modes[np.abs(modes[:, 0]).argmax(), 0]
    return Stability(float(values[0]), mode, float(np.linalg.norm(skew) / np.linalg.norm(symmetric)))


def checked_state(scene: Scene, state: ArrayLike) -> Array:
    """``state`` of ``scene`` as an array (n_states,)."""
    return finite_array(state, "state", (scene.n_states,))


def _rotation_vectors(turns: Array, frame: Array) -> Array:
    """World rotation vectors (3, k) of changes (9, k) of a rotation, column by column as CasADi stacks them."""
    vectors = []
    for turn in turns.T:
        spin = turn.reshape(3, 3, order="F") @ frame.T
        vectors.append(0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]))
    return np.array(vectors).reshape(-1, 3).T
