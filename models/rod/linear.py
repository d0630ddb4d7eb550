"""Linear dynamics of a scene about a state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import Array, finite_array

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


@dataclass(frozen=True)
class Linearisation:
    """``d/dt [xi, xi_t] = A ([xi, xi_t] - x0) + B (u - u0) + stress_ports s`` about a state ``(x0, u0)``.

    Attributes:
        A: (2n, 2n); B: (2n, m).
        stress_ports: (2n, n) response of the rates to an active stress added at the nodes, node by node, in N m or N.
    """

    A: Array
    B: Array
    stress_ports: Array

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A in 1/s, slowest first."""
        values = np.linalg.eigvals(self.A).astype(np.complex128)
        return values[np.argsort(np.abs(values))]


def linearise(scene: Scene, state: ArrayLike) -> Linearisation:
    """Exact first derivatives of the dynamics at a state [xi, xi_t, u], by the implicit function theorem."""
    x = finite_array(state, "state", (scene.n_states,))
    n = scene.n_strains
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    symbols = [xi, xi_t, xi_tt, u]
    jacobian = ca.Function("jacobian", symbols, [ca.jacobian(balance.residual, v) for v in symbols], {"cse": True})
    parts = x[:n], x[n : 2 * n], x[2 * n :]
    acceleration = scene.acceleration(*parts)
    d_xi, d_rate, mass, d_u = (np.asarray(v) for v in jacobian(parts[0], parts[1], acceleration, parts[2]))
    # Residuals are torques in very different units for shear and bending: solve with rows scaled.
    scale = 1.0 / scene.nominal_residual[:, None]
    response = np.linalg.solve(scale * mass, scale * np.hstack([d_xi, d_rate, d_u, -np.eye(n)]))
    lower = -response
    top = np.hstack([np.zeros((n, n)), np.eye(n)])
    return Linearisation(
        A=np.vstack([top, lower[:, : 2 * n]]),
        B=np.vstack([np.zeros((n, scene.n_inputs)), lower[:, 2 * n : 2 * n + scene.n_inputs]]),
        stress_ports=np.vstack([np.zeros((n, n)), lower[:, 2 * n + scene.n_inputs :]]),
    )
