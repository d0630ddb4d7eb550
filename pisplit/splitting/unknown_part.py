"""The regression of K_h in K = L K_h R (paper, eq. full_kth): its composed residual by ridge, pulled back by LASSO.

L and R (M, M) are known and act on scaled columns: the half step K_f for Strang, the identity for EDMDc. K_h is the
identity outside its free block (:mod:`pisplit.splitting.rows`). Rows below stand for samples; those of Theta K_f^T are
called w. The constant's column of K_h carries no penalty: regressions are about the means where it is free.
"""

from __future__ import annotations

import numpy as np

from pisplit.regression import alpha_max, composed_ridge, lasso
from pisplit.regression.moments import Moments
from pisplit.splitting.base import Array, SplitContext, Unknown
from pisplit.splitting.rows import free_block, row_weights


def unknown_part(context: SplitContext, left: Array, right: Array, moments: Moments, alpha: float) -> Unknown:
    """K_h of K = ``left`` K_h ``right`` by the penalty of ``context``, of weight ``alpha``, from ``moments`` of D1."""
    solve = pulled_back_lasso if context.penalty == "lasso" else composed_residual_ridge
    return solve(context, left, right, moments, alpha)


def composed_residual_ridge(
    context: SplitContext, left: Array, right: Array, moments: Moments, alpha: float
) -> Unknown:
    """K_h = argmin |L K_h R Theta - Theta'|^2 + alpha |K_h - prior|^2 (paper, eq. full_kth before L is taken across).

    ``left`` and ``right`` (M, M) are L and R; ``moments`` of Theta and Theta'; ``alpha`` in the unit of ``context``. L
    is never inverted: where it damps a column to nothing, no noise is amplified.
    """
    theta, learned = context.theta, context.theta.learned_columns
    rows, columns, affine = free_block(theta, context.rows)
    a, y, mean, mean_next = context.scaled(moments, affine)
    w, w_mean = _across(a, right), right @ mean
    factor, root = left[np.ix_(learned, rows)], np.sqrt(row_weights(theta, context.rows, rows))
    k_h = _prior(context)
    residual = y - w @ (left[learned] @ k_h).T
    free = w[:, columns]
    unit = float(np.vdot(free, free) / len(columns) * (factor**2).sum() / len(rows))
    weight = context.weight(alpha, unit, moments.n_samples)
    fit = composed_ridge(factor / root, free, residual, weight)
    k_h[np.ix_(rows, columns)] += fit.K / root[:, None]
    if affine:
        offset = mean_next - left[learned] @ (k_h @ w_mean)
        k_h[rows, theta.constant_column] = np.linalg.pinv(factor) @ offset / w_mean[theta.constant_column]
    return Unknown(k_h, weight, fit.rank)


def pulled_back_lasso(context: SplitContext, left: Array, right: Array, moments: Moments, alpha: float) -> Unknown:
    """K_h = argmin |K_h R Theta - L^+ Theta'|^2 + alpha |K_h - prior|_1 (paper, eq. full_kth and "Regularization").

    ``left`` and ``right`` (M, M) are L and R; ``moments`` of Theta and Theta'; ``alpha`` in the unit of ``context``.
    L moves other columns than the learned ones (inputs, delays) into Theta' too: their part is taken off before L^+.
    """
    theta, learned = context.theta, context.theta.learned_columns
    rows, columns, affine = free_block(theta, context.rows)
    a, y, mean, mean_next = context.scaled(moments, affine)
    w, w_mean = _across(a, right), right @ mean
    inverse = np.linalg.pinv(left[np.ix_(learned, learned)])[np.searchsorted(learned, rows)]
    others = np.setdiff1d(np.arange(theta.n_columns), learned)
    back = -inverse @ left[np.ix_(learned, others)]
    k_h, weights = _prior(context), row_weights(theta, context.rows, rows)
    residual = (y @ inverse.T + w[:, others] @ back.T - w @ k_h[rows].T) / weights
    weight = context.weight(alpha, alpha_max(w[:, columns], residual), moments.n_samples)
    if weight > 0.0:
        fit = lasso(w[:, columns], residual, weight, solver=context.solver)
    else:
        fit = composed_ridge(np.eye(len(rows)), w[:, columns], residual, 0.0)
    k_h[np.ix_(rows, columns)] += weights[:, None] * fit.K
    if affine:
        offset = inverse @ mean_next + back @ w_mean[others] - k_h[rows] @ w_mean
        k_h[rows, theta.constant_column] = offset / w_mean[theta.constant_column]
    return Unknown(k_h, weight, fit.rank, fit.gap)


def _across(a: Array, right: Array) -> Array:
    """A R^T for ``a`` (N, M) and ``right`` (M, M); A itself for the identity, as without a splitting."""
    same = np.count_nonzero(right) == len(right) and (np.diagonal(right) == 1.0).all()
    return a if same else a @ right.T


def _prior(context: SplitContext) -> Array:
    """K_h (M, M) before anything is learned: the identity, or zero in the free block where the penalty pulls to it."""
    k_h = np.eye(context.theta.n_columns)
    if context.toward != "identity":
        rows, columns, _ = free_block(context.theta, context.rows)
        k_h[np.ix_(rows, columns)] = 0.0
    return k_h
