"""LASSO with many targets: K = argmin |A K^T - Y|^2 + alpha |K - prior|_1, with a duality gap for every target."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np

from pisplit.checks import non_negative, one_of
from pisplit.regression.lasso_active_set import solve_by_active_set
from pisplit.regression.lasso_cvxpy import solve_by_cvxpy
from pisplit.regression.least_squares import least_squares
from pisplit.regression.moments import triangular_factor
from pisplit.regression.multi_target import Array, Index, Mask, Regression, free_entries, patterns, prior_or_zero

SOLVERS = ("auto", "active-set", "cvxpy")
#: Larger relative duality gaps are repaired, and reported if that fails.
GAP = 1e-6
#: Objectives below this fraction of |y|^2 are rounding to six digits.
ROUNDING = 1e-8


def alpha_max(a: Array, y: Array, prior: Array | None = None, free: Mask | None = None) -> float:
    """Smallest alpha for which the LASSO answer is the prior: 2 max |A^T (Y - A prior^T)| over the free entries.

    ``a`` (N, M), ``y`` (N, S), ``prior`` (S, M, default zero), ``free`` (S, M): entries that may differ from it.
    """
    start = prior_or_zero(a, y, prior)
    correlation = np.abs((y - a @ start.T).T @ a)
    return float(2.0 * correlation[free_entries(start, free)].max(initial=0.0))


def lasso(
    a: Array,
    y: Array,
    alpha: float,
    prior: Array | None = None,
    free: Mask | None = None,
    solver: str = "auto",
    start: Array | None = None,
) -> Regression:
    """K = argmin |A K^T - Y|^2 + alpha |K - prior|_1 (the objective that the paper prints, eq. of "Regularization").

    ``a`` (N, M), ``y`` (N, S); ``prior`` (S, M), default zero; ``free`` (S, M): entries that may differ from it.
    ``solver``: "active-set" (all targets on one Gram matrix), "cvxpy" (reference, one convex problem a target), or
    "auto": the active set, then cvxpy for targets whose relative duality gap is above 1e-6. ``start`` (S, M) is a warm
    start for the active set. alpha = 0 is least squares. Warns if a gap stays above 1e-6.
    """
    one_of(solver, "solver", SOLVERS)
    if non_negative(alpha, "alpha") == 0.0:
        return least_squares(a, y, prior, free)
    base = prior_or_zero(a, y, prior)
    result, gaps = base.copy(), np.zeros(len(base))
    for rows, columns in patterns(base, free):
        residual = y[:, rows] - a @ base[rows].T
        problem = _Triangular(a[:, columns], residual, alpha)
        warm = None if start is None else (start - base)[np.ix_(rows, columns)]
        change = problem.solve_by_cvxpy() if solver == "cvxpy" else solve_by_active_set(*problem.data, warm)
        gaps[rows] = problem.gaps(change)
        if solver == "auto" and (gaps[rows] > GAP).any():
            change = problem.repaired(change, gaps[rows])
            gaps[rows] = problem.gaps(change)
        result[np.ix_(rows, columns)] += change
    if gaps.max(initial=0.0) > GAP:
        warnings.warn(
            f"LASSO of {np.count_nonzero(gaps > GAP)} of {len(gaps)} targets ended with a relative duality gap of up "
            f"to {gaps.max():.1e}; raise alpha or drop collinear columns",
            stacklevel=2,
        )
    return Regression(K=result, gaps=gaps)


def lasso_path(
    a: Array, y: Array, alphas: Iterable[float], prior: Array | None = None, free: Mask | None = None
) -> tuple[Regression, ...]:
    """LASSO for each of ``alphas``, in their order; solved from the largest to the smallest, each from the one before.

    ``a``, ``y``, ``prior`` and ``free`` as in :func:`lasso`.
    """
    weights = [non_negative(alpha, "alpha") for alpha in alphas]
    size = a.shape[1]
    rows = triangular_factor(np.hstack([a, y])) if len(a) > 2 * (size + y.shape[1]) else np.hstack([a, y])
    fits: dict[int, Regression] = {}
    start = None
    for i in sorted(range(len(weights)), key=lambda i: -weights[i]):
        fits[i] = lasso(rows[:, :size], rows[:, size:], weights[i], prior, free, start=start)
        start = fits[i].K
    return tuple(fits[i] for i in range(len(weights)))


def composed_lasso(f: Array, a: Array, y: Array, alpha: float, solver: str = "auto") -> Regression:
    """H (r, M) = argmin |A H^T F^T - Y|^2 + alpha |H|_1 for a known ``f`` (S, r), ``a`` (N, M) and ``y`` (N, S).

    One LASSO of all r M entries, on the Kronecker product of the triangles of A and F; ``solver`` as in :func:`lasso`.
    """
    q_a, r_a = np.linalg.qr(a)
    q_f, r_f = np.linalg.qr(f)
    target = (q_a.T @ y @ q_f).reshape(-1, 1)
    found = lasso(np.kron(r_a, r_f), target, alpha, solver=solver)
    return Regression(K=found.K.reshape(a.shape[1], f.shape[1]).T, gaps=found.gaps)


class _Triangular:
    """The targets of one group; a tall A becomes a triangle: |A k - y|^2 = |R k - b|^2 + rest."""

    def __init__(self, a: Array, y: Array, alpha: float) -> None:
        size = a.shape[1]
        if len(a) > 2 * size:
            rows = triangular_factor(np.hstack([a, y]))
            self.r, self.b = rows[:size, :size], rows[:size, size:]
            self.rest = (rows[size:, size:] ** 2).sum(axis=0)
        else:
            self.r, self.b, self.rest = a, y, np.zeros(y.shape[1])
        self.alpha = alpha

    @property
    def data(self) -> tuple[Array, Array, float]:
        return self.r, self.b, self.alpha

    def solve_by_cvxpy(self, targets: Index | None = None) -> Array:
        q, r = np.linalg.qr(self.r)
        return solve_by_cvxpy(r, q.T @ self.b, self.alpha, targets)

    def repaired(self, k: Array, gaps: Array) -> Array:
        """The targets of a large gap once more by cvxpy, kept where that is better."""
        bad = np.flatnonzero(gaps > GAP)
        try:
            other = self.solve_by_cvxpy(bad)
        except ValueError:
            return k
        better = bad[self.gaps(other)[bad] < gaps[bad]]
        return np.asarray(np.where(np.isin(np.arange(len(k)), better)[:, None], other, k))

    def gaps(self, k: Array) -> Array:
        """Duality gap of every target at K (S, M), relative to its objective or, if that is larger, to 1e-8 |y|^2.

        With the residual e = b - R k and the dual point 2 s e, s <= 1 so that it is feasible, primal minus dual is
        (1 - s)^2 |e|^2 + sum_i (alpha |k_i| - 2 s k_i (R^T e)_i): every term is non-negative, nothing large cancels.
        """
        error = self.b - self.r @ k.T
        slope = self.r.T @ error
        size = np.abs(k).sum(axis=1)
        largest = np.maximum(np.abs(slope).max(axis=0, initial=0.0), np.finfo(float).tiny)
        s = np.minimum(1.0, 0.5 * self.alpha / largest)
        squared = (error**2).sum(axis=0)
        gap = (1.0 - s) ** 2 * squared + self.alpha * size - 2.0 * s * (k.T * slope).sum(axis=0)
        objective = np.maximum(
            squared + self.rest + self.alpha * size, ROUNDING * ((self.b**2).sum(axis=0) + self.rest)
        )
        return np.asarray(np.maximum(gap, 0.0) / np.where(objective > 0.0, objective, 1.0))
