"""LASSO of one target at a time by an interior-point method: the reference of the active-set solver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pisplit.regression.multi_target import Array, Index

#: Columns of the first working set, and the most that are added to it at a time.
WORKING_SET = 60
#: Columns outside the working set may violate their optimality condition by this fraction of alpha.
VIOLATION = 1e-9


def solve_by_cvxpy(r: Array, b: Array, alpha: float, targets: Sequence[int] | Index | None = None) -> Array:
    """K (S, M) with rows argmin |R k - b_i|^2 + alpha |k|_1 for ``r`` (M', M), ``b`` (M', S), by cvxpy (Clarabel).

    The convex problem is solved on a working set of columns, which grows until every other column satisfies its
    optimality condition with a zero coefficient; each answer is made exact on its support. Only ``targets`` (default
    all) are solved, the other rows are zero. Raises ValueError if the solver fails.
    """
    result = np.zeros((b.shape[1], r.shape[1]))
    for i in range(b.shape[1]) if targets is None else targets:
        working = np.empty(0, dtype=np.int64)
        while True:
            excess = 2.0 * np.abs(r.T @ (b[:, i] - r @ result[i])) - alpha * (1.0 + VIOLATION)
            excess[working] = 0.0
            violated = np.flatnonzero(excess > 0.0)
            if len(violated) == 0:
                break
            worst = violated[np.argsort(-excess[violated])[:WORKING_SET]]
            working = np.sort(np.concatenate([working, worst]))
            try:
                result[i, working] = _solve(r[:, working], b[:, i], alpha)
            except ValueError as error:
                raise ValueError(f"LASSO of target {i} {error}; scale the data or raise alpha") from None
    return result


def _solve(r: Array, b: Array, alpha: float) -> Array:
    import cvxpy as cp  # takes a second to import: only those who need it pay

    q, triangle = np.linalg.qr(r)
    target = q.T @ b
    size = float(np.linalg.norm(target))  # the problem is solved in units of its target
    k = cp.Variable(r.shape[1])
    objective = cp.sum_squares(triangle @ k - target / size) + alpha / size * cp.norm1(k)
    problem = cp.Problem(cp.Minimize(objective))
    try:
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12)
    except cp.SolverError:
        raise ValueError("failed in Clarabel") from None
    if k.value is None:
        raise ValueError(f"ended as {problem.status}")
    return _on_support(triangle, target, k.value * size, alpha)


def _on_support(r: Array, b: Array, k: Array, alpha: float) -> Array:
    """Solve the optimality conditions exactly on the support of an interior-point answer, where that helps."""
    support = np.flatnonzero(np.abs(k) > 1e-6 * np.abs(k).max(initial=0.0))
    signs = np.sign(k[support])
    exact = np.zeros_like(k)
    block, cross = r[:, support].T @ r[:, support], r[:, support].T @ b
    exact[support] = np.linalg.lstsq(block, cross - 0.5 * alpha * signs, rcond=None)[0]
    same = np.array_equal(np.sign(exact[support]), signs)
    return exact if same and _violation(r, b, exact, alpha) <= _violation(r, b, k, alpha) else k


def _violation(r: Array, b: Array, k: Array, alpha: float) -> float:
    """Distance of zero from the subdifferential of the LASSO objective at k (M,)."""
    slope = 2.0 * (r.T @ (r @ k - b))
    at_zero = np.maximum(np.abs(slope) - alpha, 0.0)
    return float(np.linalg.norm(np.where(k == 0.0, at_zero, slope + alpha * np.sign(k))))
