"""Stable transition matrices near one that is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import positive
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import refuse_relifted

Array = NDArray[np.float64]


def limited_radius(a: Array, bound: float = 1.0) -> Array:
    """A with every eigenvalue outside the circle of radius ``bound`` moved onto it along its ray.

    Works on the real Schur form A = Q T Q^T with the eigenvalues inside the circle first: the diagonal blocks of the
    others (1 x 1, or 2 x 2 for complex pairs) are scaled, all other entries stay. Motions that stay in the modes inside
    the circle are therefore unchanged, and the change |A' - A| is that of the scaled blocks: an orthogonal Q keeps it
    small where eigenvectors are nearly parallel. It is not the nearest such matrix, which is a non-convex problem
    (Gillis, Karow, Sharma: Approximating the nearest stable discrete-time system, 2019).
    """
    limit = positive(bound, "bound")
    triangle, basis, inside = scipy.linalg.schur(
        np.asarray(a, dtype=np.float64), output="real", sort=lambda re, im: np.hypot(re, im) <= limit
    )
    if int(inside) == len(triangle):
        return np.array(a, dtype=np.float64)
    return np.asarray(basis @ limited_blocks(triangle, limit) @ basis.T)


def limited_blocks(triangle: Array, bound: float) -> Array:
    """A real Schur form ``triangle`` (M, M), its diagonal blocks outside the radius ``bound`` scaled onto it."""
    limited, size, i = np.array(triangle), len(triangle), 0
    while i < size:
        width = 2 if i + 1 < size and limited[i + 1, i] != 0.0 else 1
        block = slice(i, i + width)
        radius = float(np.abs(np.linalg.eigvals(limited[block, block])).max())
        if radius > bound:
            limited[block, block] *= bound / radius
        i += width
    return limited


def stabilised(model: LiftedModel, bound: float = 1.0) -> LiftedModel:
    """The model with the spectral radius of A limited to ``bound``.

    Rows that only shift (constants, delays) are part of A and change with it where they take part in a mode that is
    moved; predictions of slower modes stay. Raises ValueError for a re-lifted model: its A is a part of its step only.
    """
    refuse_relifted(model, "spectral radius that A alone decides")
    return replace(
        model, A=limited_radius(model.A, bound), provenance={**model.provenance, "spectral_radius_bound": bound}
    )
