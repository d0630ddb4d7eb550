"""LASSO by an active set on the Gram matrix: many targets, few non-zero entries each.

Feature-sign search (Lee, Battle, Raina, Ng: Efficient sparse coding algorithms, NIPS 2006) with several columns
activated at a time. All columns are screened against the optimality conditions; products are taken with active columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from pisplit.regression.multi_target import Array, Index, Mask

#: Ridge about the iterate in every solve, relative to |G|: collinear columns have a step, the answer does not change.
PROXIMAL = 1e-12
#: Optimality conditions hold to this fraction of the penalty.
TOLERANCE = 1e-9
#: A predicted decrease below this fraction of the penalty term is rounding.
DECREASE = 1e-13
MAX_STEPS, MAX_STALLS = 5000, 4


def solve_by_active_set(r: Array, b: Array, alpha: float, start: Array | None = None) -> Array:
    """K (S, M) with rows argmin |R k - b_i|^2 + alpha |k|_1 for ``r`` (M', M) and ``b`` (M', S).

    ``start`` (S, M) is a warm start: the answer for another alpha. Targets are solved one by one, so that the answer of
    one does not depend on the others.
    """
    size = np.linalg.norm(r, axis=0)
    alive = np.flatnonzero(size > 0.0)  # a zero column has a zero coefficient
    result = np.zeros((b.shape[1], r.shape[1]))
    if len(alive) == 0:
        return result
    unit = r[:, alive] / size[alive]  # unit columns, each with a penalty of its own: scales of columns do not matter
    gram = unit.T @ unit
    cross = unit.T @ b
    penalty = 0.5 * alpha / size[alive]
    ridge = PROXIMAL * float(np.abs(gram).sum(axis=1).max())  # bounds the largest eigenvalue, without a decomposition
    for i in range(b.shape[1]):
        if start is None and (np.abs(cross[:, i]) <= penalty).all():
            continue
        k = np.zeros(len(alive)) if start is None else start[i, alive] * size[alive]
        result[i, alive] = _solve(gram, np.ascontiguousarray(cross[:, i]), penalty, k, ridge) / size[alive]
    return result


@dataclass
class _Active:
    """Active columns, the signs their coefficients have or are to get, the coefficients, and which are still zero."""

    columns: Index
    signs: Array
    values: Array

    def kept(self, which: Mask) -> _Active:
        return _Active(self.columns[which], self.signs[which], self.values[which])


def _solve(gram: Array, cross: Array, penalty: Array, k: Array, ridge: float) -> Array:
    """k (M,) = argmin k^T G k / 2 - c^T k + penalty^T |k|, from the warm start k."""
    support = np.flatnonzero(k)
    active = _Active(support, np.sign(k[support]), k[support])
    slope = cross - gram[:, support] @ active.values
    rounding = 4e-16 * float(np.abs(cross).max())
    stalls = 0
    for _ in range(MAX_STEPS):
        if len(active.columns):
            active, decrease = _step(gram, slope, penalty, active, ridge)
            columns, size = active.columns, float(np.abs(active.values).sum())
            slope = cross - gram[:, columns] @ active.values
            rounding = 4e-16 * (float(np.abs(cross).max()) + size)
            if decrease > DECREASE * float(penalty[columns] @ np.abs(active.values)):
                stalls = 0
                error = np.abs(slope[columns] - penalty[columns] * active.signs)
                if (error > TOLERANCE * penalty[columns] + rounding).any():
                    continue
            else:
                stalls += 1
                if stalls == MAX_STALLS:
                    break
        excess = (np.abs(slope) - rounding) / penalty - 1.0
        excess[active.columns] = -1.0
        violated = np.flatnonzero(excess > TOLERANCE)
        if len(violated) == 0:
            break
        # Adding a quarter of the support at a time keeps the number of solves logarithmic in its size.
        most = max(4, len(active.columns) // 4)
        if len(violated) > most:
            violated = violated[np.argpartition(-excess[violated], most)[:most]]
        active = _joined(active, violated, np.sign(slope[violated]))
    result = np.zeros_like(cross)
    result[active.columns] = active.values
    return result


def _joined(active: _Active, columns: Index, signs: Array) -> _Active:
    merged = np.concatenate([active.columns, columns])
    order = np.argsort(merged)
    return _Active(
        merged[order],
        np.concatenate([active.signs, signs])[order],
        np.concatenate([active.values, np.zeros(len(columns))])[order],
    )


def _step(gram: Array, slope: Array, penalty: Array, active: _Active, ridge: float) -> tuple[_Active, float]:
    """Newton step for the signs of the active set, cut where the objective along it is smallest.

    Returns the columns that are not zero after it, and the decrease that the step promised.
    """
    while True:
        columns, signs, values = active.columns, active.signs, active.values
        block = gram.ravel().take(columns[:, None] * len(gram) + columns)
        weights = penalty[columns]
        downhill = slope[columns] - weights * signs
        step = _newton(block, downhill, ridge)
        wrong = (values == 0.0) & (step * signs <= 0.0)
        if not wrong.any() or np.count_nonzero(values == 0.0) == 1:
            break
        active = active.kept(~wrong)  # these would take the other sign: leave them at zero
    decrease = float(downhill @ step)
    crossing = np.divide(-values, step, out=np.full(len(step), np.inf), where=values * step < 0.0)
    kinks = (crossing < 1.0).nonzero()[0]
    moved = values + step
    if len(kinks):
        moved = _along(values, step, crossing, kinks, decrease, weights)
        clipped = values + step
        clipped[kinks] = 0.0
        if len(kinks) > 1 and _change(block, downhill, weights, signs, values, clipped) < _change(
            block, downhill, weights, signs, values, moved
        ):
            moved = clipped
    kept = moved != 0.0
    return _Active(columns[kept], np.sign(moved[kept]), moved[kept]), decrease


def _newton(block: Array, downhill: Array, ridge: float) -> Array:
    for _ in range(20):
        lifted = block.copy()
        lifted.flat[:: len(block) + 1] += ridge
        triangle, failed = lapack.dpotrf(lifted, lower=1, overwrite_a=1, clean=0)
        if not failed:
            return np.asarray(lapack.dpotrs(triangle, downhill, lower=1)[0])
        ridge *= 10.0  # rounding of a large, collinear block
    raise ValueError("the Gram matrix of the LASSO is not positive semidefinite; scale the columns")


def _along(values: Array, step: Array, crossing: Array, kinks: Index, slope: float, weights: Array) -> Array:
    """Point of the smallest objective on values + t step: it is convex, quadratic between the kinks."""
    kinks = kinks[np.argsort(crossing[kinks])]
    jumps = 2.0 * weights[kinks] * np.abs(step[kinks])
    after = slope * (crossing[kinks] - 1.0) + np.cumsum(jumps)
    turning = np.flatnonzero(after >= 0.0)
    if len(turning) == 0:
        return np.asarray(values + min(1.0, 1.0 - jumps.sum() / slope) * step)
    first = int(turning[0])
    if after[first] - jumps[first] >= 0.0:
        return np.asarray(values + (1.0 - jumps[:first].sum() / slope) * step)
    moved = values + crossing[kinks[first]] * step
    moved[kinks[first]] = 0.0
    return np.asarray(moved)


def _change(block: Array, downhill: Array, weights: Array, signs: Array, values: Array, moved: Array) -> float:
    """Objective at ``moved`` minus objective at ``values``."""
    step = moved - values
    bent = np.abs(moved) - np.abs(values) - signs * step
    return float(-(downhill @ step) + 0.5 * step @ (block @ step) + weights @ bent)
