"""Condensed prediction: outputs over the horizon as an affine map of the lifted state and the input features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array


@dataclass(frozen=True)
class Condensed:
    """y_{k+j} = C A^j z_k + sum_{i<j} C A^{j-1-i} (B phi_{k+i} + c + w) + d for j = 1 .. H, with w constant.

    M lifted states, P input features, p = ``n_outputs`` outputs, H = ``horizon``. ``free`` and
    ``disturbance`` (H p, M) and ``constant`` (H p,) are ordered stage by stage; ``impulse`` (H, p, P) holds the answer
    to one feature in one step.
    """

    free: Array  # (H p, M): C A^j
    disturbance: Array  # (H p, M): sum_{i<j} C A^i
    constant: Array  # (H p,): what c and d contribute
    impulse: Array  # (H, p, P): C A^j B for j = 0 .. H-1
    horizon: int
    n_outputs: int

    def response(self) -> Array:
        """Block-Toeplitz map (H, p, H, P) from the features of each step to the outputs of each stage."""
        H, p, P = self.impulse.shape
        blocks = np.zeros((H, p, H, P))
        for i in range(H):
            blocks[i:, :, i, :] = self.impulse[: H - i]
        return blocks

    def predict(self, z: ArrayLike, features: ArrayLike, disturbance: ArrayLike | None = None) -> Array:
        """Outputs (H, p) of steps k+1 .. k+H from ``z`` (M,) at k, ``features`` (H, P), a ``disturbance`` (M,)."""
        H, p, P = self.impulse.shape
        y = self.free @ finite_array(z, "z", (self.free.shape[1],)) + self.constant
        if disturbance is not None:
            y += self.disturbance @ finite_array(disturbance, "disturbance", (self.free.shape[1],))
        phi = finite_array(features, "features", (H, P))
        return (y + self.response().reshape(H * p, H * P) @ phi.ravel()).reshape(H, p)


def condense(A: ArrayLike, B: ArrayLike, c: ArrayLike, C: ArrayLike, d: ArrayLike, horizon: int) -> Condensed:
    """Eliminate the states of z+ = A z + B phi + c, y = C z + d over ``horizon`` steps.

    A (M, M), B (M, P), c (M,), C (p, M), d (p,). The rows C A^j come from the recursion (C A^{j-1}) A: H products of a
    p-row block with A, no power of A. Raises ValueError on a wrong shape or a horizon below 1.

    Source: condensing after Maciejowski, Predictive Control with Constraints (2002), section 2.6; Jerez, Kerrigan and
    Constantinides, Automatica 48 (2012).
    """
    H = count(horizon, "horizon")
    C = finite_array(C, "C", (None, None))
    p, M = C.shape
    A = finite_array(A, "A", (M, M))
    B = finite_array(B, "B", (M, None))
    c = finite_array(c, "c", (M,))
    d = finite_array(d, "d", (p,))
    rows = np.empty((H + 1, p, M))  # C A^0 .. C A^H
    rows[0] = C
    for j in range(H):
        rows[j + 1] = rows[j] @ A
    sums = np.cumsum(rows[:H], axis=0)
    disturbance = sums.reshape(H * p, M)
    return Condensed(
        free=rows[1:].reshape(H * p, M),
        disturbance=disturbance,
        constant=disturbance @ c + np.tile(d, H),
        impulse=rows[:H] @ B,
        horizon=H,
        n_outputs=p,
    )
