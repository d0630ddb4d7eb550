"""The horizon that a model asks for: its slowest mode that matters to the outputs."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array

#: Samples of the impulse response in a row of the Hankel matrix.
ROWS = 60
#: Singular values from this part of the largest on are modes that matter.
MATTERS = 0.05
#: Horizons that are tried at least and at most, and time constants after which a mode without swing is over.
SHORTEST, LONGEST, OVER = 8, 60, 3.0


def impulses(A: Array, B: Array, C: Array) -> Array:
    """C A^j B (p, P) for j = 0 .. 2 ROWS; A (M, M), B (M, P), C (p, M)."""
    found, left = [], C
    for _ in range(2 * ROWS + 1):
        found.append(left @ B)
        left = left @ A
    return np.array(found)


def slow_modes(response: Array) -> Array:
    """Eigenvalues of the modes that matter in an impulse ``response`` (2 ROWS + 1, p, P), as complex numbers (k,).

    Raises ValueError for a response that is zero or not finite.

    Source: eigensystem realisation, Juang and Pappa, Journal of Guidance 8 (1985).
    """
    if not np.isfinite(response).all() or not response.any():
        raise ValueError("the outputs do not answer to the inputs, or without bound: nothing can be tuned")
    first = np.vstack([np.hstack(list(response[i : i + ROWS])) for i in range(ROWS)])
    then = np.vstack([np.hstack(list(response[i + 1 : i + 1 + ROWS])) for i in range(ROWS)])
    left, size, right = np.linalg.svd(first, full_matrices=False)
    k = max(1, int(np.count_nonzero(size >= MATTERS * size[0])))
    root = np.sqrt(size[:k])
    reduced = (left[:, :k] / root).T @ then @ (right[:k].T / root)
    return np.asarray(np.linalg.eigvals(reduced))


def steps_of(modes: Array) -> float:
    """Steps in which the slowest of the ``modes`` (k,) goes once around, or is over where it does not swing."""
    rate = np.log(np.maximum(np.abs(modes), 1e-12)) + 1j * np.angle(modes)
    speed = np.maximum(np.abs(rate), 1e-6)
    swings = np.abs(rate.imag) > 0.5 * speed
    return float(np.max(np.where(swings, 2.0 * np.pi, OVER) / speed))


def horizon_of(modes: Array) -> int:
    """The horizon, in steps, for the ``modes`` (k,): a period of the slowest, within what can be computed."""
    return int(np.clip(np.ceil(steps_of(modes)), SHORTEST, LONGEST))
