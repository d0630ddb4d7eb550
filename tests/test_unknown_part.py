"""The regression of K_h between known factors, by brute force, and what Strang and Lie make of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from pisplit import Dictionary, PhaseSamples
from pisplit import observables as ob
from pisplit.regression import composed_lasso, composed_ridge
from pisplit.regression.moments import Moments, accumulate
from pisplit.splitting import Lie, SplitContext, Strang, Unknown, composed_residual_ridge, pulled_back_lasso

F = np.array([[0.0, 1.0], [-4.0, -0.3]])  # x' = F x is known


def problem(constant: bool, rows: Any, toward: str, **more: Any) -> tuple[SplitContext, Moments, np.ndarray]:
    """A context, moments of random rows, and a known half step that leaves delays, inputs and the constant alone."""
    parts: list[Any] = [ob.Constant()] if constant else []
    theta = Dictionary(*parts, ob.Identity(), ob.Delays(states=1), n_states=2, n_inputs=1)
    rng = np.random.default_rng(3)
    a, y = rng.normal(size=(40, theta.n_columns)), rng.normal(size=(40, 2))
    if constant:
        a[:, 0] = 1.0
    half = np.eye(theta.n_columns)
    half[theta.learned_columns] += 0.4 * rng.normal(size=(2, theta.n_columns))
    scale = rng.uniform(0.5, 2.0, theta.n_columns)
    if constant:
        scale[0] = 1.0
    context = SplitContext(theta, scale, 0.1, rows=rows, toward=toward, relative=False, **more)
    return context, accumulate([np.hstack([a, y])]), half


def basis(context: SplitContext, rows: Any) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """K_h at the prior, unit matrices of its free entries, and which of these carry a penalty."""
    theta = context.theta
    learned = list(theta.learned_columns)
    free = learned if rows is None else [learned[1]]
    columns = [theta.n_columns - 1] if rows == "inputs" else list(range(theta.n_columns))
    if rows == "inputs":
        free = learned
    start, units, weighed = np.eye(theta.n_columns), [], []
    for i in free:
        for j in columns:
            unit = np.zeros_like(start)
            unit[i, j] = 1.0
            units.append(unit)
            weighed.append(j != theta.constant_column)
            if context.toward == "zero":
                start[i, j] = 0.0
    return start, units, np.array(weighed)


def scaled(context: SplitContext, moments: Moments) -> tuple[np.ndarray, np.ndarray]:
    a, y, _, _ = context.scaled(moments, centred=False)
    return a, y


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("rows", [None, "inputs", ["x2"], {"x2": 3.0}])
@pytest.mark.parametrize("toward", ["zero", "identity"])
def test_the_composed_ridge_is_the_minimiser_that_brute_force_finds(constant: bool, rows: Any, toward: str) -> None:
    context, moments, half = problem(constant, rows, toward)
    start, units, weighed = basis(context, rows)
    learned, (a, y) = context.theta.learned_columns, scaled(context, moments)
    alpha, weight = 0.7, 3.0 if isinstance(rows, dict) else 1.0
    design = np.stack([(a @ (half @ unit @ half)[learned].T).ravel() for unit in units], axis=1)
    target = (y - a @ (half @ start @ half)[learned].T).ravel()
    penalty = np.sqrt(alpha * weight) * np.diag(weighed.astype(float))
    found = np.linalg.lstsq(np.vstack([design, penalty]), np.append(target, np.zeros(len(units))), rcond=None)[0]
    expected = start + sum(value * unit for value, unit in zip(found, units, strict=True))
    k_h = composed_residual_ridge(context, half, half, moments, alpha)
    np.testing.assert_allclose(half @ k_h.K @ half, half @ expected @ half, atol=1e-9)
    assert k_h.alpha == alpha


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("rows", [None, "inputs", ["x2"], {"x2": 3.0}])
@pytest.mark.parametrize("toward", ["zero", "identity"])
def test_the_pulled_back_lasso_is_the_minimiser_that_a_convex_solver_finds(
    constant: bool, rows: Any, toward: str
) -> None:
    """|K_h K_f Theta - K_f^+ Theta'|^2 + alpha |K_h - prior|_1 with all of Theta' = [psi'; delays and inputs]."""
    context, moments, half = problem(constant, rows, toward, penalty="lasso")
    start, units, weighed = basis(context, rows)
    learned, (a, y) = context.theta.learned_columns, scaled(context, moments)
    alpha, weight = 8.0, 3.0 if isinstance(rows, dict) else 1.0
    after = a @ half.T  # what K_f leaves of the rows that are not learned, and K_h and K_f leave alone
    after[:, learned] = y
    pulled, w = after @ np.linalg.inv(half).T, a @ half.T
    x = cp.Variable(len(units))
    k_h = start + sum(x[i] * unit for i, unit in enumerate(units))
    miss = cp.sum_squares(w @ k_h[learned].T - pulled[:, learned])
    objective = miss + alpha * weight * cp.norm1(cp.multiply(weighed.astype(float), x))
    cp.Problem(cp.Minimize(objective)).solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12)
    found = pulled_back_lasso(context, half, half, moments, alpha)
    np.testing.assert_allclose(found.K, k_h.value, atol=1e-5)
    if rows != "inputs":  # some free entries stay where they are
        assert np.count_nonzero(found.K - start) < len(units)


def test_composed_matrices_are_what_the_splits_are_called() -> None:
    context, _, half = problem(False, None, "zero")
    theta = context.theta
    k_f = replace(_half_step(context), K=half)
    kick = Unknown(np.eye(theta.n_columns) + np.arange(25.0).reshape(5, 5) / 25.0, 0.0)
    unit = context.scale[theta.learned_columns][:, None] / context.scale
    for split, expected in ((Strang, half @ kick.K @ half), (Lie, kick.K @ half @ half)):
        found = split(context).composed(k_f, kick).K
        np.testing.assert_allclose(found, expected[theta.learned_columns] * unit, atol=1e-12)


def _half_step(context: SplitContext) -> Any:
    points = np.random.default_rng(0).normal(size=(20, 2))
    samples = PhaseSamples(points, np.zeros((20, 1)), points @ F.T)
    return Strang(replace(context, samples=samples, half_step="generator")).known()


def test_a_matrix_between_known_factors_by_both_penalties() -> None:
    rng = np.random.default_rng(1)
    f, a, y = rng.normal(size=(4, 3)), rng.normal(size=(30, 5)), rng.normal(size=(30, 4))
    design = np.kron(a, f)  # (A H^T F^T)[n, s] = sum A[n, q] F[s, r] H[r, q]
    ridge = np.linalg.solve(design.T @ design + 2.0 * np.eye(15), design.T @ y.ravel()).reshape(5, 3).T
    np.testing.assert_allclose(composed_ridge(f, a, y, 2.0).K, ridge, atol=1e-10)
    h = cp.Variable((3, 5))
    objective = cp.sum_squares(a @ h.T @ f.T - y) + 6.0 * cp.sum(cp.abs(h))
    cp.Problem(cp.Minimize(objective)).solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12)
    np.testing.assert_allclose(composed_lasso(f, a, y, 6.0).K, h.value, atol=1e-6)
