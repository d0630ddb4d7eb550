"""Multi-target regressions in closed form: least squares, ridge, and ridge through a known left factor."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular

from pisplit.checks import non_negative
from pisplit.regression.moments import REFLECTOR
from pisplit.regression.multi_target import Array, Mask, Regression, patterns, prior_or_zero
from pisplit.threads import one_blas_thread

#: Rows that are rotated into the triangle of a ridge at once.
BLOCK = 256
#: F^T F that differs from a multiple of the identity by less than this part of it is one.
ORTHOGONAL = 1e-12


def least_squares(a: Array, y: Array, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K (S, M) nearest to the prior (default 0) among the minimisers of |A K^T - Y|^2, by singular values.

    ``a`` (N, M), ``y`` (N, S), ``prior`` (S, M); ``free`` (S, M): entries that may differ from it.
    """
    return ridge(a, y, 0.0, prior, free)


@one_blas_thread()
def ridge(a: Array, y: Array, alpha: float, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K (S, M) = argmin |A K^T - Y|^2 + alpha |K - prior|^2 (Frobenius norms).

    ``a`` (N, M), ``y`` (N, S), ``prior`` (S, M, default zero); ``free`` (S, M): entries that may differ from it.
    By a QR factorisation of [A; sqrt(alpha) I], which does not square the condition number (Golub, Van Loan: Matrix
    Computations, section 6.1.4); for alpha = 0, where the rank is to be found, by the singular values of A.
    Raises ValueError for entries that are not finite.
    """
    non_negative(alpha, "alpha")
    start = prior_or_zero(a, y, prior)
    _check_finite(a, y)
    result, ranks = start.copy(), [0]
    for rows, columns in patterns(start, free):
        residual, free_columns = y[:, rows] - a @ start[rows].T, a[:, columns]
        if alpha > 0.0:
            change = _penalised(free_columns, residual, alpha)
        else:
            u, s, vt = np.linalg.svd(free_columns, full_matrices=False)
            gain, rank = _pseudo_inverse(s, a.shape)
            change = (vt.T * gain) @ (u.T @ residual)
            ranks.append(rank)
        result[np.ix_(rows, columns)] += change.T
    return Regression(K=result, rank=max(ranks) if alpha == 0.0 else None)


@one_blas_thread()
def composed_ridge(f: Array, a: Array, y: Array, alpha: float) -> Regression:
    """H (r, M) = argmin |A H^T F^T - Y|^2 + alpha |H|^2 for a known ``f`` (S, r), ``a`` (N, M) and ``y`` (N, S).

    Where F^T F = c I (F is the identity, or orthogonal) it is the ridge of Y F / c with the weight alpha / c.
    Else, with F = U s V^T and A = P t Q^T, the unknowns separate:
    (V^T H Q)_ij = s_i t_j (U^T Y^T P)_ij / (s_i^2 t_j^2 + alpha).
    F is never inverted, so a strongly damped F amplifies no noise. alpha = 0 is least squares. Raises ValueError for
    entries that are not finite.
    """
    non_negative(alpha, "alpha")
    _check_finite(f, a, y)
    square = _square_of_orthogonal(f)
    if alpha > 0.0 and square is not None:
        return Regression(K=_penalised(a, (y @ f) / square, alpha / square).T)
    u, s, vt = np.linalg.svd(f, full_matrices=False)
    p, t, qt = np.linalg.svd(a, full_matrices=False)
    rank: int | None = None
    if alpha == 0.0:
        gain_f, rank_f = _pseudo_inverse(s, f.shape)
        gain_a, rank_a = _pseudo_inverse(t, a.shape)
        gain, rank = np.outer(gain_f, gain_a), rank_f * rank_a
    else:
        st = np.outer(s, t)
        gain = st / (st**2 + alpha)
    return Regression(K=vt.T @ (gain * (u.T @ y.T @ p)) @ qt, rank=rank)


def _penalised(a: Array, y: Array, alpha: float) -> Array:
    """X (M, S) = argmin |A X - Y|^2 + alpha |X|^2 for ``a`` (N, M), ``y`` (N, S) and alpha > 0."""
    n, size = a.shape
    root = np.sqrt(alpha)
    if n < size:  # the shortest solution of [A, sqrt(alpha) I] [X; E] = Y
        q, r = qr(np.vstack([a.T, root * np.eye(n)]), mode="economic", overwrite_a=True, check_finite=False)
        return np.asarray(q[:size] @ solve_triangular(r, y, trans="T", check_finite=False))
    triangle, projected = np.asfortranarray(root * np.eye(size)), np.zeros((size, y.shape[1]), order="F")
    used = a.any(axis=1)  # of a triangle [A, Y], the last rows say nothing of A
    a, y = a[used], y[used]
    for first in range(0, len(a), BLOCK):
        part = a[first : first + BLOCK]
        begin = int(np.argmax(part.any(axis=0)))  # of a triangle, the first columns are zero
        nb = min(REFLECTOR, size - begin)
        corner = np.asfortranarray(triangle[begin:, begin:])
        corner, v, t, _ = lapack.dtpqrt(0, nb, corner, np.asfortranarray(part[:, begin:]), overwrite_a=1)
        above, _, _ = lapack.dtpmqrt(
            0, v, t, projected[begin:], np.asfortranarray(y[first : first + BLOCK]), side="L", trans="T"
        )
        triangle[begin:, begin:], projected[begin:] = corner, above
    return np.asarray(solve_triangular(triangle, projected, check_finite=False))


def _square_of_orthogonal(f: Array) -> float | None:
    """c where F^T F = c I for ``f`` (S, r), or None."""
    gram = f.T @ f
    square = float(np.trace(gram)) / max(len(gram), 1)
    if square == 0.0 or not np.isfinite(square):
        return None
    return square if np.abs(gram - square * np.eye(len(gram))).max() <= ORTHOGONAL * square else None


def _check_finite(*arrays: Array) -> None:
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("a regression was given NaN or infinite entries; remove these samples, or scale the columns")


def _pseudo_inverse(s: Array, shape: tuple[int, ...]) -> tuple[Array, int]:
    """Gains 1 / s of the singular values that count, 0 of the others, and the number of those that do."""
    kept = s > np.finfo(float).eps * max(shape) * s.max(initial=0.0)
    return np.divide(1.0, s, out=np.zeros_like(s), where=kept), int(kept.sum())
