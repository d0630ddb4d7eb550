"""Linear dynamics of a scene about a state."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from pisplit.brief import brief
from pisplit.checks import Array, finite_array, positive
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.equations.held import slopes
from pisplit.models.rod.sharing import lock_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene


@brief
@dataclass(frozen=True)
class Linearisation:
    """``d/dt [xi, xi_t] = A ([xi, xi_t] - x0) + B (u - u0) + stress_ports s`` about a state ``(x0, u0)``.

    With Maxwell branches [xi, xi_t, sigma] moves, which has q entries in place of 2n.

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

    def discretise(self, dt: float) -> DiscreteLinearisation:
        """Exact step of ``dt`` seconds under inputs that move linearly from one command to the next.

        One exponential of the equations with ``u`` and ``dt u_t`` as further states (Van Loan, IEEE Trans. Automatic
        Control 1978).
        """
        n, m, step = len(self.A), self.B.shape[1], positive(dt, "dt", "s")
        augmented = np.zeros((n + 2 * m, n + 2 * m))
        augmented[:n, :n], augmented[:n, n : n + m] = step * self.A, step * self.B
        augmented[n : n + m, n + m :] = np.eye(m)
        whole = finite_answer(expm(finite_answer(augmented, "entries of dt A")), "exponentials of dt A")
        ramp = whole[:n, n + m :]
        return DiscreteLinearisation(whole[:n, :n], whole[:n, n : n + m] - ramp, ramp, step)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues in the complex plane; written to ``path`` where one is given."""
        from pisplit.models.rod.equations.pictures import plot_linearisation

        return plot_linearisation(self, path)


@dataclass(frozen=True)
class DiscreteLinearisation:
    """``x+ = A x + B_before u_k-1 + B u_k``, deviations from the state, inputs that ramp over ``dt`` seconds.

    With inputs that jump to ``u_k`` at the start of the step the input matrix is ``B_before + B``.
    """

    A: Array
    B_before: Array
    B: Array
    dt: float


def linearise(scene: Scene, state: ArrayLike) -> Linearisation:
    """Exact first derivatives of the dynamics of a scene, by the implicit function theorem.

    Args:
        scene: what moves.
        state: [xi, xi_t, u] (n_states,).

    Raises ValueError for a state of another scene, or one at which numbers overflow.
    """
    x = finite_array(state, "state", (scene.n_states,))
    n = scene.n_strains
    xi, xi_t, xi_tt, u, balance = scene.dynamic_balance
    symbols = [xi, xi_t, xi_tt, u]
    jacobian = ca.Function("jacobian", symbols, slopes(balance, symbols))
    parts = scene.layout.arguments(x)
    with lock_of(scene):
        acceleration = scene.acceleration(*parts)
    d_xi, d_rate, mass, d_u = (np.asarray(v) for v in jacobian(parts[0], parts[1], acceleration, parts[2]))
    # Residuals are torques in very different units for shear and bending: solve with rows scaled.
    scale = 1.0 / scene.nominal_residual[:, None]
    rows = finite_answer(scale * np.hstack([mass, d_xi, d_rate, d_u, -np.eye(n)]), "derivatives of the balance")
    lower = -np.linalg.solve(rows[:, :n], rows[:, n:])
    layout, (fractions, relaxing) = scene.layout, scene.relaxation
    top = np.hstack([np.zeros((n, n)), np.eye(n), np.zeros((n, layout.n_overstress))])
    strained = fractions[:, None] * np.tile(np.eye(layout.n_free, n), (layout.n_branches, 1))
    bottom = np.hstack([np.zeros((layout.n_overstress, n)), strained, -np.diag(relaxing)])
    still = np.zeros((layout.n_overstress, layout.n_inputs + n))
    given = np.vstack([np.zeros((n, layout.n_inputs + n)), lower[:, layout.n_moving :], still])
    return Linearisation(
        A=np.vstack([top, lower[:, layout.moving], bottom]),
        B=given[:, : layout.n_inputs],
        stress_ports=given[:, layout.n_inputs :],
    )
