"""Multi-target regressions in closed form: least squares, ridge, and ridge through a known left factor."""

from __future__ import annotations

import numpy as np

from pisplit.checks import non_negative
from pisplit.regression.multi_target import Array, Mask, Regression, patterns, prior_or_zero


def least_squares(a: Array, y: Array, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K (S, M) nearest to the prior (default 0) among the minimisers of |A K^T - Y|^2, by singular values.

    ``a`` (N, M), ``y`` (N, S), ``prior`` (S, M); ``free`` (S, M): entries that may differ from it.
    """
    return ridge(a, y, 0.0, prior, free)


def ridge(a: Array, y: Array, alpha: float, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K (S, M) = argmin |A K^T - Y|^2 + alpha |K - prior|^2 (Frobenius norms), by singular values of A.

    ``a`` (N, M), ``y`` (N, S), ``prior`` (S, M, default zero); ``free`` (S, M): entries that may differ from it.
    """
    non_negative(alpha, "alpha")
    start = prior_or_zero(a, y, prior)
    result, ranks = start.copy(), [0]
    for rows, columns in patterns(start, free):
        u, s, vt = np.linalg.svd(a[:, columns], full_matrices=False)
        gain, rank = _filter(s, alpha, a.shape)
        residual = y[:, rows] - a @ start[rows].T
        result[np.ix_(rows, columns)] += ((vt.T * gain) @ (u.T @ residual)).T
        ranks.append(rank)
    return Regression(K=result, rank=max(ranks))


def composed_ridge(f: Array, a: Array, y: Array, alpha: float) -> Regression:
    """H (r, M) = argmin |A H^T F^T - Y|^2 + alpha |H|^2 for a known ``f`` (S, r), ``a`` (N, M) and ``y`` (N, S).

    With F = U s V^T and A = P t Q^T the unknowns separate:
    (V^T H Q)_ij = s_i t_j (U^T Y^T P)_ij / (s_i^2 t_j^2 + alpha).
    F is never inverted, so a strongly damped F amplifies no noise. alpha = 0 is least squares.
    """
    non_negative(alpha, "alpha")
    u, s, vt = np.linalg.svd(f, full_matrices=False)
    p, t, qt = np.linalg.svd(a, full_matrices=False)
    if alpha == 0.0:
        gain_f, rank_f = _filter(s, 0.0, f.shape)
        gain_a, rank_a = _filter(t, 0.0, a.shape)
        gain, rank = np.outer(gain_f, gain_a), rank_f * rank_a
    else:
        st = np.outer(s, t)
        gain, rank = st / (st**2 + alpha), len(s) * len(t)
    return Regression(K=vt.T @ (gain * (u.T @ y.T @ p)) @ qt, rank=rank)


def _filter(s: Array, alpha: float, shape: tuple[int, ...]) -> tuple[Array, int]:
    """Gains s / (s^2 + alpha) of the singular values, those of a pseudo-inverse for alpha = 0, and the rank."""
    kept = s > np.finfo(float).eps * max(shape) * s.max(initial=0.0)
    if alpha > 0.0:
        return s / (s**2 + alpha), int(kept.sum())
    return np.divide(1.0, s, out=np.zeros_like(s), where=kept), int(kept.sum())
