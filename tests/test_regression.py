"""Regressions satisfy their optimality conditions; moments stand for the data they were made from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit.regression import alpha_max, composed_ridge, lasso, least_squares, ridge
from pisplit.regression.moments import accumulate, stacked
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]
RNG = np.random.default_rng(1)


def problem(n: int = 60, m: int = 12, s: int = 4) -> tuple[Array, Array, Array]:
    a = RNG.normal(size=(n, m)) * np.logspace(0, -2, m)
    k = RNG.normal(size=(s, m)) * (RNG.random((s, m)) < 0.4)
    return a, a @ k.T + 0.02 * RNG.normal(size=(n, s)), k


def test_least_squares_satisfies_the_normal_equations_and_reports_the_rank() -> None:
    a, y, _ = problem()
    fit = least_squares(a, y)
    np.testing.assert_allclose(a.T @ (a @ fit.K.T - y), 0, atol=1e-12)
    assert fit.rank == 12
    doubled = least_squares(np.hstack([a, a]), y)
    assert doubled.rank == 12
    np.testing.assert_allclose(doubled.K, np.hstack([fit.K, fit.K]) / 2, atol=1e-9)  # the smallest of the minimisers


@pytest.mark.parametrize("alpha", [1e-6, 1e-2, 10.0])
def test_ridge_satisfies_its_normal_equations(alpha: float) -> None:
    a, y, k = problem()
    prior = k + 0.1 * RNG.normal(size=k.shape)
    fit = ridge(a, y, alpha, prior)
    np.testing.assert_allclose((fit.K @ a.T - y.T) @ a + alpha * (fit.K - prior), 0, atol=1e-11)
    np.testing.assert_allclose(ridge(a, y, 1e14, prior).K, prior, atol=1e-9)


@pytest.mark.parametrize("alpha", [0.0, 1e-5, 1e-1])
def test_composed_ridge_satisfies_its_normal_equations(alpha: float) -> None:
    a, y, _ = problem()
    f = RNG.normal(size=(4, 3))
    h = composed_ridge(f, a, y, alpha).K
    np.testing.assert_allclose(f.T @ (f @ h @ a.T - y.T) @ a + alpha * h, 0, atol=1e-11)


def test_composed_least_squares_does_not_invert_a_singular_factor() -> None:
    a, y, _ = problem()
    f = np.diag([1.0, 1.0, 1e-18, 0.0])
    h = composed_ridge(f, a, y, 0.0).K
    np.testing.assert_allclose(h[:2], least_squares(a, y[:, :2]).K, atol=1e-10)
    assert np.abs(h[2:]).max() < 1e-9


@pytest.mark.parametrize("solver", ["cvxpy", "active-set"])
@pytest.mark.parametrize("relative", [0.5, 1e-2, 1e-4])
def test_lasso_satisfies_the_subgradient_condition(solver: str, relative: float) -> None:
    a, y, k = problem()
    prior = np.round(k, 1)
    alpha = relative * alpha_max(a, y, prior)
    fit = lasso(a, y, alpha, prior, solver=solver)
    change, slope = fit.K - prior, 2 * (fit.K @ a.T - y.T) @ a
    active = change != 0
    np.testing.assert_allclose(slope[active], -alpha * np.sign(change[active]), atol=1e-7 * alpha_max(a, y))
    assert np.abs(slope[~active]).max(initial=0) <= alpha * (1 + 1e-6)
    assert fit.gap is not None and fit.gap < 1e-7


def test_alpha_max_is_the_smallest_alpha_that_leaves_the_prior() -> None:
    a, y, k = problem()
    largest = alpha_max(a, y, k)
    assert np.array_equal(lasso(a, y, largest, k).K, k)
    assert not np.array_equal(lasso(a, y, 0.98 * largest, k).K, k)
    assert alpha_max(a, 3 * y) == pytest.approx(3 * alpha_max(a, y))


def test_both_lasso_solvers_agree_on_correlated_columns() -> None:
    base = RNG.normal(size=(200, 6))
    a = base @ RNG.normal(size=(6, 50)) + 0.05 * RNG.normal(size=(200, 50))
    y = a[:, :3] @ RNG.normal(size=(3, 5)) + 0.1 * RNG.normal(size=(200, 5))
    alpha = 1e-2 * alpha_max(a, y)
    reference, ours = (lasso(a, y, alpha, solver=s) for s in ("cvxpy", "active-set"))
    np.testing.assert_allclose(ours.K, reference.K, atol=1e-5 * np.abs(reference.K).max())


@pytest.mark.parametrize("method", ["least squares", "ridge", "lasso"])
def test_fixed_entries_keep_the_prior_and_free_ones_are_optimal(method: str) -> None:
    a, y, k = problem()
    free = RNG.random(k.shape) < 0.5
    free[0] = False
    prior = k.copy()
    if method == "lasso":
        fit = lasso(a, y, 1e-3 * alpha_max(a, y, prior, free), prior, free).K
    else:
        fit = ridge(a, y, 1e-3 if method == "ridge" else 0.0, prior, free).K
    assert np.array_equal(fit[~free], prior[~free])
    slope = 2 * (fit @ a.T - y.T) @ a
    if method != "lasso":
        slope += 2 * (1e-3 if method == "ridge" else 0.0) * (fit - prior)
        np.testing.assert_allclose(slope[free], 0, atol=1e-10)
    else:
        assert np.abs(slope[free]).max() <= 1e-3 * alpha_max(a, y, prior, free) * (1 + 1e-6)


def test_regressions_leave_their_arguments_alone() -> None:
    a, y, k = problem()
    copies = a.copy(), y.copy(), k.copy()
    for solver in ("cvxpy", "active-set"):
        lasso(a, y, 0.1, k, solver=solver)
    ridge(a, y, 0.1, k)
    composed_ridge(np.eye(4), a, y, 0.1)
    for before, after in zip(copies, (a, y, k), strict=True):
        np.testing.assert_array_equal(before, after)


def test_moments_in_blocks_stand_for_the_whole_data() -> None:
    data = RNG.normal(size=(500, 5)) * np.array([1, 1e-3, 1e3, 1, 0]) + np.array([0, 1, 1e3, -2, 7])
    moments = accumulate(data[i : i + 64] for i in range(0, 500, 64))
    centred = data - data.mean(axis=0)
    np.testing.assert_allclose(moments.mean, data.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(moments.std, data.std(axis=0), rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(moments.factor.T @ moments.factor, centred.T @ centred, rtol=1e-9, atol=1e-6)
    rows = moments.rows(centred=False)
    np.testing.assert_allclose(rows.T @ rows, data.T @ data, rtol=1e-10)
    assert moments.std[4] == 0.0


def test_moments_do_not_square_the_condition_number() -> None:
    a = RNG.normal(size=(300, 1)) + 1e-10 * RNG.normal(size=(300, 2))
    k = np.array([[1.0, -2.0]])
    moments = accumulate([np.hstack([a, a @ k.T])])
    fit = least_squares(moments.factor[:, :2], moments.factor[:, 2:])
    assert fit.rank == 2
    np.testing.assert_allclose(fit.K, k, atol=1e-4)


def test_one_scale_for_each_quantity() -> None:
    std = np.array([3.0, 4.0, 1e-6, 0.0])
    np.testing.assert_allclose(column_scales(std, ["p", "p", "q", "1"]), [12.5**0.5, 12.5**0.5, 1e-6, 1])
    np.testing.assert_allclose(column_scales(std, ["p", "p", "q", "1"], "column"), [3, 4, 1e-6, 1])
    np.testing.assert_array_equal(column_scales(std, ["p", "p", "q", "1"], None), np.ones(4))
    with pytest.raises(ValueError, match="scale"):
        column_scales(std, ["p", "p", "q", "1"], "row")


@pytest.mark.parametrize("rows", [1, 5, 40])
def test_triangles_that_are_stacked_give_the_regression_of_all_rows(rows: int) -> None:
    first, second = RNG.normal(size=(30, 8)), RNG.normal(size=(rows, 8))
    y, z = RNG.normal(size=(30, 3)), RNG.normal(size=(rows, 3))
    q, r = np.linalg.qr(first)
    triangle, target = stacked((r, q.T @ y), (second, z))
    assert not np.tril(triangle, -1).any()
    wanted = np.linalg.lstsq(np.vstack([first, second]), np.vstack([y, z]), rcond=None)[0]
    np.testing.assert_allclose(np.linalg.solve(triangle, target), wanted, atol=1e-12)
    if rows >= 8:
        p, s = np.linalg.qr(second)
        again = stacked((r, q.T @ y), (np.triu(s), p.T @ z))
        np.testing.assert_allclose(np.linalg.solve(*again), wanted, atol=1e-12)
