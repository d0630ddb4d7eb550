"""Penalties on K - prior, and the units in which their weights are given.

|K - prior|^2 has a closed form, |K - prior|_1 is solved by coordinate descent or cvxpy.
"""

from __future__ import annotations

from pisplit.checks import one_of
from pisplit.regression.lasso import SOLVERS, alpha_max, lasso
from pisplit.regression.least_squares import ridge
from pisplit.regression.multi_target import Array, Regression

PENALTIES = ("ridge", "lasso")


def check_penalty(penalty: str, solver: str, relative: bool | str) -> None:
    """Raise ValueError for a ``penalty``, ``solver`` or unit ``relative`` that does not exist, or has no effect."""
    one_of(penalty, "penalty", PENALTIES)
    one_of(solver, "solver", SOLVERS)
    if solver != "auto" and penalty != "lasso":
        raise ValueError(f"solver = {solver!r} solves a LASSO, penalty = {penalty!r} is none; leave solver out")
    if not any(relative is choice or relative == choice for choice in ("samples", True, False)):
        raise ValueError(f"relative = {relative!r}; expected True, False or 'samples'")


def absolute_weight(alpha: float, relative: bool | str, unit: float, n_samples: int) -> float:
    """The weight of a penalty on a sum over samples.

    ``alpha`` is given relative to ``unit``, which the data set (``relative`` True), as it is (False) or for each of
    ``n_samples`` samples ("samples": the 0.01 N of the paper).
    """
    if relative == "samples":
        return alpha * n_samples
    return alpha * unit if relative else alpha


def penalised(a: Array, y: Array, weight: float, penalty: str, solver: str = "auto") -> Regression:
    """K (S, M) = argmin |A K^T - Y|^2 + weight |K| for ``a`` (N, M) and ``y`` (N, S).

    ``penalty``: "ridge", or "lasso" by ``solver`` (:func:`pisplit.regression.lasso`); a weight of 0 is least squares.
    """
    if penalty == "lasso" and weight > 0.0:
        return lasso(a, y, weight, solver=solver)
    return ridge(a, y, weight)


def unit_weight(a: Array, y: Array, penalty: str) -> float:
    """What weights of a ``penalty`` in a regression of ``y`` on ``a`` are relative to.

    For "lasso" the smallest weight with K = 0, for "ridge" the mean of |A|^2 a column.
    """
    return alpha_max(a, y) if penalty == "lasso" else float((a**2).sum()) / a.shape[1]
