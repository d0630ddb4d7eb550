"""A bound on the spectral radius of an identified operator; its exact rows, delays and the constant, stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.dictionary.dictionary import Dictionary
from pisplit.lifted.operators import operators
from pisplit.lifted.radius import limited_blocks
from pisplit.splitting.base import Solver, SplitFit

Array = NDArray[np.float64]

#: Learned rows reach a mode if its left vectors, of length one, keep this much of it on them.
REACHED = 1e-6
#: What rounding may add to the radius.
SLACK = 1e-9


def bounded(solve: Solver, theta: Dictionary, scale: Array, bound: float) -> Solver:
    """The same solver with the spectral radius of A at most ``bound``; ``details`` keep the radius before."""

    def limited(alpha: float) -> SplitFit:
        fit = solve(alpha)
        if not np.isfinite(fit.K).all():
            return fit
        before = transition_radius(theta, fit.K)
        if before <= bound * (1.0 + SLACK):
            return fit
        return replace(
            fit, K=limited_rows(theta, fit.K, scale, bound), details={**fit.details, "unbounded_radius": before}
        )

    return limited


def transition_radius(theta: Dictionary, k: Array) -> float:
    """Spectral radius of A without the constant (its eigenvalue is 1) and past inputs (theirs are 0)."""
    moving = _moving(theta)
    values = np.linalg.eigvals(operators(theta, k)["A"][np.ix_(moving, moving)])
    return float(np.abs(values).max(initial=0.0))


def limited_rows(theta: Dictionary, k: Array, scale: Array, bound: float) -> Array:
    """Learned rows (S, M) whose A has a spectral radius of at most ``bound``, close to ``k`` in scaled columns (M,).

    W (left Schur vectors of the modes outside, in scaled columns) obeys W^T A = T W^T. Adding F W^T to the learned
    rows E makes T + W^T E F of T and changes no other eigenvalue, nor what motions in the other modes do. F is the
    smallest one that scales the diagonal blocks of T onto the circle. With state delays the learned rows may be too few
    to move all modes so (W^T E singular): then all eigenvalues shrink alike, A_j to r^(j+1) A_j for the j-th delay.
    """
    learned, moving = theta.learned_columns, _moving(theta)
    unit = scale[moving]
    a = operators(theta, k)["A"][np.ix_(moving, moving)] * unit / unit[:, None]
    triangle, basis, count = scipy.linalg.schur(a.T, output="real", sort=lambda re, im: np.hypot(re, im) > bound)
    left, block = basis[:, :count], triangle[:count, :count]
    reach = left[: len(learned)].T
    if np.linalg.svd(reach, compute_uv=False).min(initial=1.0) > REACHED and len(reach) <= len(learned):
        gain = np.linalg.pinv(reach) @ (limited_blocks(block, bound) - block).T
        found = k.copy()
        found[:, moving] += (gain @ left.T) * scale[learned][:, None] / unit
        if transition_radius(theta, found) <= bound * (1.0 + SLACK):
            return found
    return _shrunk(theta, k, bound / transition_radius(theta, k))


def _moving(theta: Dictionary) -> NDArray[np.int64]:
    """Learned columns, then past states: the part of psi that has dynamics of its own."""
    past = np.arange(theta.n_present, theta.n_present + theta.state_delays * theta.n_states)
    return np.concatenate([theta.learned_columns, past])


def _shrunk(theta: Dictionary, k: Array, r: float) -> Array:
    """Rows for which every eigenvalue of A is r times what it was."""
    factors = np.ones(theta.n_columns)
    factors[theta.learned_columns] = r
    for j in range(theta.state_delays):
        first = theta.n_present + j * theta.n_states
        factors[first : first + theta.n_states] = r ** (j + 2)
    return np.asarray(k * factors)
