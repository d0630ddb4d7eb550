"""How fast a model grows by itself, and a warning where a horizon is too long for it."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse.linalg import ArpackError, eigs

from pisplit.checks import Array

GROWTH_LIMIT = 100.0


def warn_of_growth(A: Array, horizon: int) -> None:
    """Warn if predictions by ``A`` (M, M) grow so much over the ``horizon`` that the QP loses its digits."""
    radius = spectral_radius(A)
    growth = radius**horizon
    if growth > GROWTH_LIMIT:
        warnings.warn(
            f"the model's spectral radius {radius:.4f} grows {growth:.2g} times over {horizon} steps; "
            "the QP is ill-conditioned: shorten the horizon or regularise the fit",
            stacklevel=3,
        )


def spectral_radius(A: Array) -> float:
    """Largest modulus of the eigenvalues of ``A`` (M, M), to 1e-3 of it where M is above 50."""
    if len(A) > 50:
        start = np.random.default_rng(0).standard_normal(len(A))
        try:
            return float(np.abs(eigs(A, k=1, which="LM", v0=start, tol=1e-3, return_eigenvectors=False)).max())
        except ArpackError:  # clustered eigenvalues: all of them then, in a second rather than in milliseconds
            pass
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
