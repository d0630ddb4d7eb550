"""Multi-target linear regression Y ~ A K^T: least squares, ridge, LASSO, and ridge through a known left factor.

A (N, M) holds one sample a row, Y (N, S) its targets; K (S, M) is the operator of the paper, K a ~ y. Penalties act on
K - prior. ``free`` (S, M) marks the entries that may differ from the prior; the others are fixed to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import non_negative, one_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PENALTIES = ("ridge", "lasso")
ADMM_GAP, ADMM_ITERATIONS = 1e-8, 5000


@dataclass(frozen=True)
class Regression:
    """K (S, M), the numerical rank of the data (None for LASSO) and, for LASSO, the largest relative duality gap."""

    K: Array
    rank: int | None = None
    gap: float | None = None


def least_squares(a: Array, y: Array, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K nearest to the prior (default 0) among the minimisers of |A K^T - Y|^2, by singular values."""
    return ridge(a, y, 0.0, prior, free)


def ridge(a: Array, y: Array, alpha: float, prior: Array | None = None, free: Mask | None = None) -> Regression:
    """K = argmin |A K^T - Y|^2 + alpha |K - prior|^2 (Frobenius norms), by singular values of A."""
    non_negative(alpha, "alpha")
    start = _prior(a, y, prior)
    result, ranks = start.copy(), [0]
    for rows, columns in _patterns(start, free):
        u, s, vt = np.linalg.svd(a[:, columns], full_matrices=False)
        gain, rank = _filter(s, alpha, a.shape)
        residual = y[:, rows] - a @ start[rows].T
        result[np.ix_(rows, columns)] += ((vt.T * gain) @ (u.T @ residual)).T
        ranks.append(rank)
    return Regression(K=result, rank=max(ranks))


def composed_ridge(f: Array, a: Array, y: Array, alpha: float) -> Regression:
    """H (r, M) = argmin |A H^T F^T - Y|^2 + alpha |H|^2 for a known F (S, r), in closed form.

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


def alpha_max(a: Array, y: Array, prior: Array | None = None, free: Mask | None = None) -> float:
    """Smallest alpha for which the LASSO answer is the prior: 2 max |A^T (Y - A prior^T)| over the free entries."""
    start = _prior(a, y, prior)
    correlation = np.abs((y - a @ start.T).T @ a)
    return float(2.0 * correlation[_mask(start, free)].max(initial=0.0))


def lasso(
    a: Array, y: Array, alpha: float, prior: Array | None = None, free: Mask | None = None, solver: str = "auto"
) -> Regression:
    """K = argmin |A K^T - Y|^2 + alpha |K - prior|_1 (the objective that the paper prints, eq. of "Regularization").

    ``solver``: "cvxpy" (reference, one convex problem a target), "admm" (all targets on one factorisation) or "auto"
    (cvxpy up to 40 columns). alpha = 0 is least squares.
    """
    if non_negative(alpha, "alpha") == 0.0:
        return least_squares(a, y, prior, free)
    one_of(solver, "solver", ("auto", "cvxpy", "admm"))
    start = _prior(a, y, prior)
    result, gaps = start.copy(), [0.0]
    for rows, columns in _patterns(start, free):
        small = a[:, columns]
        residual = y[:, rows] - a @ start[rows].T
        use_cvxpy = solver == "cvxpy" or (solver == "auto" and small.shape[1] <= 40)
        solve: Callable[[Array, Array, float], tuple[Array, float]] = _lasso_cvxpy if use_cvxpy else _lasso_admm
        change, gap = solve(small, residual, alpha)
        result[np.ix_(rows, columns)] += change
        gaps.append(gap)
    return Regression(K=result, gap=max(gaps))


def _lasso_cvxpy(a: Array, y: Array, alpha: float) -> tuple[Array, float]:
    import cvxpy as cp  # takes a second to import: only those who need it pay

    q, r = np.linalg.qr(a)
    targets = q.T @ y  # |A k - y|^2 and |R k - Q^T y|^2 differ by a constant
    sizes = np.linalg.norm(targets, axis=0)
    unknown, target, weight = cp.Variable(a.shape[1]), cp.Parameter(len(r)), cp.Parameter(nonneg=True)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(r @ unknown - target) + weight * cp.norm1(unknown)))
    result = np.zeros((y.shape[1], a.shape[1]))
    gram, cross = r.T @ r, r.T @ targets
    for i in np.flatnonzero(2.0 * np.abs(cross).max(axis=0) > alpha):  # the answer for the others is zero
        target.value, weight.value = targets[:, i] / sizes[i], alpha / sizes[i]
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            raise ValueError(f"LASSO of target {i} failed in Clarabel; use solver='admm' or scale the data") from None
        if unknown.value is None:
            raise ValueError(f"LASSO of target {i} ended as {problem.status}; use solver='admm' or scale the data")
        result[i] = unknown.value * sizes[i]
    result = _polish(gram, cross, result, alpha)
    return result, float(_gap(gram, cross, (y**2).sum(axis=0), result, alpha).max(initial=0.0))


def _lasso_admm(a: Array, y: Array, alpha: float) -> tuple[Array, float]:
    """Alternating directions for all targets at once (Boyd et al., 2011, section 6.4), by the duality gap."""
    gram, cross, energy = a.T @ a, a.T @ y, (y**2).sum(axis=0)
    values, vectors = np.linalg.eigh(gram)
    rho = max(0.3 * float(values.mean()), np.finfo(float).tiny)
    z = dual = np.zeros_like(cross)
    step = _step_matrix(values, vectors, rho)
    best = np.zeros_like(cross.T)
    best_gap = np.inf
    for iteration in range(1, ADMM_ITERATIONS + 1):
        x = step @ (2.0 * cross + rho * (z - dual))
        relaxed = 1.6 * x - 0.6 * z
        previous, z = z, _shrink(relaxed + dual, alpha / rho)
        dual = dual + relaxed - z
        if iteration % 25:
            continue
        gap = float(_gap(gram, cross, energy, z.T, alpha).max(initial=0.0))
        if gap < best_gap:
            best, best_gap = z.T.copy(), gap
        if gap <= ADMM_GAP:
            break
        if iteration % 100 == 0:
            factor = _balance(x - z, z - previous, z, dual)
            if not 0.3 < factor < 3.0:
                rho, dual = rho * factor, dual / factor
                step = _step_matrix(values, vectors, rho)
    best = _polish(gram, cross, best, alpha)
    return best, float(_gap(gram, cross, energy, best, alpha).max(initial=0.0))


def _balance(primal: Array, change: Array, z: Array, dual: Array) -> float:
    """Factor on rho that makes the relative primal and dual residuals of ADMM alike."""
    tiny = np.finfo(float).tiny
    relative_primal = np.linalg.norm(primal) / max(float(np.linalg.norm(z)), tiny)
    relative_dual = np.linalg.norm(change) / max(float(np.linalg.norm(dual)), tiny)
    return float(np.clip(np.sqrt(relative_primal / max(float(relative_dual), tiny)), 0.1, 10.0))


def _step_matrix(values: Array, vectors: Array, rho: float) -> Array:
    return np.asarray((vectors / (2.0 * values + rho)) @ vectors.T)


def _shrink(value: Array, threshold: float) -> Array:
    return np.sign(value) * np.maximum(np.abs(value) - threshold, 0.0)


def _gap(gram: Array, cross: Array, energy: Array, k: Array, alpha: float) -> Array:
    """Duality gap of every target, relative to |y|^2, at K (S, M)."""
    slope = cross.T - k @ gram
    fit = (k * cross.T).sum(axis=1)
    residual = np.maximum(energy - fit - (k * slope).sum(axis=1), 0.0)
    primal = residual + alpha * np.abs(k).sum(axis=1)
    largest = np.abs(slope).max(axis=1, initial=0.0)
    scale = np.minimum(1.0, 0.5 * alpha / np.maximum(largest, np.finfo(float).tiny))
    dual = 2.0 * scale * (energy - fit) - scale**2 * residual
    return np.asarray((primal - dual) / np.where(energy > 0.0, energy, 1.0))


def _polish(gram: Array, cross: Array, k: Array, alpha: float) -> Array:
    """Solve the optimality conditions exactly on the support that an iterative answer has found, where that helps."""
    polished = k.copy()
    for i, row in enumerate(k):
        support = np.flatnonzero(np.abs(row) > 1e-6 * np.abs(row).max(initial=0.0))
        if len(support) == 0:
            continue
        block = gram[np.ix_(support, support)]
        signs = np.sign(row[support])
        exact = np.zeros_like(row)
        exact[support] = np.linalg.lstsq(block, cross[support, i] - 0.5 * alpha * signs, rcond=None)[0]
        if np.array_equal(np.sign(exact[support]), signs) and (
            _violation(gram, cross[:, i], exact, alpha) <= _violation(gram, cross[:, i], row, alpha)
        ):
            polished[i] = exact
    return polished


def _violation(gram: Array, cross: Array, k: Array, alpha: float) -> float:
    """Distance of zero from the subdifferential of the LASSO objective at one target's k (M,)."""
    slope = 2.0 * (gram @ k - cross)
    at_zero = np.maximum(np.abs(slope) - alpha, 0.0)
    return float(np.linalg.norm(np.where(k == 0.0, at_zero, slope + alpha * np.sign(k))))


def _filter(s: Array, alpha: float, shape: tuple[int, ...]) -> tuple[Array, int]:
    """Gains s / (s^2 + alpha) of the singular values, those of a pseudo-inverse for alpha = 0, and the rank."""
    kept = s > np.finfo(float).eps * max(shape) * s.max(initial=0.0)
    if alpha > 0.0:
        return s / (s**2 + alpha), int(kept.sum())
    return np.divide(1.0, s, out=np.zeros_like(s), where=kept), int(kept.sum())


def _prior(a: Array, y: Array, prior: Array | None) -> Array:
    shape = (y.shape[1], a.shape[1])
    if prior is None:
        return np.zeros(shape)
    if prior.shape != shape:
        raise ValueError(f"prior has shape {prior.shape}; expected {shape}, one row a target")
    return np.asarray(prior, dtype=np.float64)


def _mask(prior: Array, free: Mask | None) -> Mask:
    if free is None:
        return np.ones(prior.shape, dtype=bool)
    if free.shape != prior.shape:
        raise ValueError(f"free has shape {free.shape}; expected {prior.shape}, one row a target")
    return np.asarray(free, dtype=bool)


def _patterns(prior: Array, free: Mask | None) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Targets that share their free entries, and these entries: each group is one regression."""
    mask = _mask(prior, free)
    patterns, which = np.unique(mask, axis=0, return_inverse=True)
    for i, pattern in enumerate(patterns):
        if pattern.any():
            yield np.flatnonzero(which.reshape(-1) == i), np.flatnonzero(pattern)
