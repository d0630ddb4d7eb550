"""Facts of the LASSO by an interior-point solver: the optimality conditions, and the exact answer on the support."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit.regression import lasso
from pisplit.regression.lasso_cvxpy import _on_support, _violation


def data(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = np.triu(rng.normal(size=(6, 6))) + 2.0 * np.eye(6)
    return a, a @ np.array([1.5, 0.0, -2.0, 0.0, 0.7, 0.0]) + 0.01 * rng.normal(size=6)


@pytest.mark.parametrize("seed", range(4))
def test_the_violation_is_the_distance_of_the_subgradient_from_zero(seed: int) -> None:
    """At k without zeros it is the gradient; at k = 0 what exceeds alpha; at the solution nothing."""
    a, b = data(seed)
    k = np.random.default_rng(seed).normal(size=6)
    objective = lambda k: float(((a @ k - b) ** 2).sum() + 0.3 * np.abs(k).sum())  # noqa: E731
    gradient = [(objective(k + h) - objective(k - h)) / 2e-6 for h in 1e-6 * np.eye(6)]
    assert _violation(a, b, k, 0.3) == pytest.approx(float(np.linalg.norm(gradient)), rel=1e-5)
    beyond = np.maximum(np.abs(2.0 * a.T @ b) - 0.3, 0.0)
    assert _violation(a, b, np.zeros(6), 0.3) == pytest.approx(float(np.linalg.norm(beyond)))
    solved = lasso(a, b[:, None], 0.3, solver="active-set").K[0]
    assert _violation(a, b, solved, 0.3) < 1e-8 * _violation(a, b, np.zeros(6), 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_an_answer_near_the_solution_is_made_exact_on_its_support(seed: int) -> None:
    a, b = data(seed)
    exact = lasso(a, b[:, None], 0.3, solver="active-set").K[0]
    near = exact + 1e-8 * np.random.default_rng(seed).normal(size=6)
    assert _on_support(a, b, near, 0.3) == pytest.approx(exact, abs=1e-11)


def test_an_answer_with_another_support_is_left_as_it_is() -> None:
    a, b = data(0)
    wrong = np.array([0.0, 3.0, 0.0, -1.0, 0.0, 2.0])
    found = _on_support(a, b, wrong, 0.3)
    assert np.array_equal(found, wrong) or _violation(a, b, found, 0.3) <= _violation(a, b, wrong, 0.3)


def test_both_solvers_agree() -> None:
    a, b = data(5)
    y = np.stack([b, 0.5 * b + 0.1], axis=1)
    fits = [lasso(a, y, 0.2, solver=solver).K for solver in ("active-set", "cvxpy")]
    assert fits[0] == pytest.approx(fits[1], abs=1e-8)
