"""LASSO: optimality, certificates, paths and awkward data; the active set against cvxpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit.regression import alpha_max, lasso, lasso_path, least_squares
from pisplit.regression.moments import accumulate, triangular_factor

Array = NDArray[np.float64]


def delayed(n: int = 1500, states: int = 24, delays: int = 4, seed: int = 0) -> tuple[Array, Array]:
    """Standardised delay columns of damped oscillations seen by many sensors: strongly correlated."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=(n // 8 + 2, 3)), 8, axis=0)[: n + delays + 1]
    turn = 0.3 * (1.0 + 0.7 * np.arange(6))
    growth = np.exp((-0.06 + 1.0j) * turn)
    drive = rng.normal(size=(6, 3))
    z = np.zeros((len(u), 6), dtype=complex)
    for k in range(len(u) - 1):
        z[k + 1] = growth * z[k] + drive @ u[k]
    x = np.hstack([z.real, z.imag]) @ rng.normal(size=(12, states))
    x += 0.05 * x.std(axis=0) * rng.normal(size=x.shape)
    a = np.hstack([x[delays - j : len(u) - 1 - j] for j in range(delays + 1)] + [u[delays:-1]])
    y = x[delays + 1 :]
    return (a - a.mean(axis=0)) / a.std(axis=0), (y - y.mean(axis=0)) / y.std(axis=0)


def violation(a: Array, y: Array, k: Array, alpha: float) -> float:
    """Largest distance of zero from the subdifferential, relative to alpha."""
    slope = 2.0 * (k @ a.T - y.T) @ a
    off = np.where(k == 0.0, np.maximum(np.abs(slope) - alpha, 0.0), np.abs(slope + alpha * np.sign(k)))
    return float(off.max() / alpha)


def test_the_active_set_agrees_with_cvxpy_on_correlated_delays() -> None:
    a, y = delayed()
    alpha = 0.01 * len(a)
    ours, reference = (lasso(a, y[:, :12], alpha, solver=s) for s in ("active-set", "cvxpy"))
    np.testing.assert_allclose(ours.K, reference.K, atol=1e-7)
    assert ours.gaps is not None and ours.gaps.shape == (12,) and ours.gap is not None and ours.gap < 1e-8
    assert violation(a, y[:, :12], ours.K, alpha) < 1e-8
    assert 0.01 < (ours.K != 0.0).mean() < 0.3


def test_the_gap_bounds_the_distance_to_the_smallest_objective() -> None:
    a, y = delayed(400, 8)
    alpha = 0.05 * alpha_max(a, y)

    def objective(k: Array) -> Array:
        return np.asarray(((a @ k.T - y) ** 2).sum(axis=0) + alpha * np.abs(k).sum(axis=1))

    fit = lasso(a, y, alpha)
    for trial in (fit.K * 0.99, fit.K + 1e-3, np.zeros_like(fit.K)):
        assert (objective(trial) >= objective(fit.K) * (1.0 - 2e-9)).all()


def test_the_factor_of_the_data_stands_for_the_data() -> None:
    a, y = delayed(600, 6)
    rows = triangular_factor(np.hstack([a, y]))
    alpha = 1e-2 * alpha_max(a, y)
    whole, short = lasso(a, y, alpha), lasso(rows[:, :33], rows[:, 33:], alpha)
    np.testing.assert_allclose(short.K, whole.K, atol=1e-9)
    np.testing.assert_allclose(np.abs(rows.T @ rows - np.hstack([a, y]).T @ np.hstack([a, y])), 0, atol=1e-8)


@pytest.mark.parametrize("order", [1, -1])
def test_a_warm_started_path_equals_single_fits(order: int) -> None:
    a, y = delayed(600, 8)
    alphas = np.geomspace(1.0, 1e-5, 6)[::order] * alpha_max(a, y)
    for alpha, fit in zip(alphas, lasso_path(a, y, alphas), strict=True):
        np.testing.assert_allclose(fit.K, lasso(a, y, alpha).K, atol=1e-6)
        assert fit.gap is not None and fit.gap < 1e-6
    assert np.count_nonzero(lasso_path(a, y, alphas)[0 if order == 1 else -1].K) == 0


def test_targets_do_not_depend_on_each_other() -> None:
    a, y = delayed(600, 8)
    rows = triangular_factor(np.hstack([a, y]))
    a, y = rows[:, : a.shape[1]], rows[:, a.shape[1] :]
    together = lasso(a, y, 5.0, solver="active-set").K
    for i in (0, 5):
        np.testing.assert_allclose(lasso(a, y[:, [i]], 5.0, solver="active-set").K[0], together[i], atol=1e-11)


@pytest.mark.parametrize("relative", [1e-1, 1e-3, 1e-6])
def test_columns_of_any_scale_duplicates_and_zeros(relative: float) -> None:
    rng = np.random.default_rng(3)
    base = rng.normal(size=(80, 10))
    a = np.hstack([base, base[:, :4], np.zeros((80, 1)), 1e-9 * base[:, :2], 1e3 * rng.normal(size=(80, 1))])
    y = base @ rng.normal(size=(10, 3)) + 0.1 * rng.normal(size=(80, 3))
    alpha = relative * alpha_max(base, y)
    fit = lasso(a, y, alpha, solver="active-set")
    assert fit.gap is not None and fit.gap < 1e-7
    assert not fit.K[:, 14].any()
    assert violation(a, y, fit.K, alpha) < 1e-3


def test_more_columns_than_samples() -> None:
    rng = np.random.default_rng(4)
    a = rng.normal(size=(40, 90))
    y = a[:, :3] @ rng.normal(size=(3, 4)) + 0.1 * rng.normal(size=(40, 4))
    for relative in (0.3, 1e-2, 1e-5):
        fit = lasso(a, y, relative * alpha_max(a, y))
        assert fit.gap is not None and fit.gap < 1e-7
        assert (np.count_nonzero(fit.K, axis=1) <= 40).all()


def test_targets_without_variation_have_zero_coefficients() -> None:
    a, y = delayed(300, 4)
    y[:, 1] = 0.0
    fit = lasso(a, y, 1.0)
    assert not fit.K[1].any() and fit.gaps is not None and fit.gaps[1] == 0.0


def test_a_vanishing_penalty_approaches_least_squares() -> None:
    a, y = delayed(600, 4)
    np.testing.assert_allclose(lasso(a, y, 1e-9 * alpha_max(a, y)).K, least_squares(a, y).K, atol=1e-5)
    assert np.array_equal(lasso(a, y, 0.0).K, least_squares(a, y).K)


def test_a_gap_that_stays_is_reported() -> None:
    points = np.linspace(0.0, 1.0, 120)
    a = np.vander(points, 40)  # condition number 1e17
    y = np.sin(9.0 * points)[:, None]
    alpha = 1e-9 * alpha_max(a, y)
    with pytest.warns(UserWarning, match="duality gap"):
        fit = lasso(a, y, alpha, solver="active-set")
    assert fit.gap is not None and fit.gap > 1e-6


def test_moments_name_the_first_column_that_is_not_finite() -> None:
    data = np.random.default_rng(0).normal(size=(50, 6))
    for bad in (np.nan, np.inf):
        data[17, 3] = bad
        with pytest.raises(ValueError, match="column 4 of 6 has NaN or infinite"):
            accumulate([data[:20], data[20:]])


def test_moments_do_not_depend_on_the_blocks() -> None:
    data = np.random.default_rng(0).normal(size=(300, 40)) * np.logspace(-12, 12, 40)
    whole, parts = accumulate([data]), accumulate(data[i : i + 7] for i in range(0, 300, 7))
    np.testing.assert_allclose(whole.std, parts.std, rtol=1e-10)
    np.testing.assert_allclose(whole.mean, parts.mean, rtol=1e-9, atol=1e-13 * np.logspace(-12, 12, 40).min())
    assert accumulate([data[:1]]).factor.shape == (0, 40)
    assert accumulate([data[:5]]).factor.shape == (4, 40)


@pytest.mark.parametrize("n_rows", [1, 2, 5, 9, 60])
def test_moments_of_few_rows_with_dependent_columns_lose_nothing(n_rows: int) -> None:
    rng = np.random.default_rng(1)
    data = rng.normal(size=(n_rows, 6))
    data[:, 0], data[:, 3] = 1.0, data[:, 1]
    moments = accumulate(data[i : i + 2] for i in range(0, n_rows, 2))
    centred = data - data.mean(axis=0)
    np.testing.assert_allclose(moments.factor.T @ moments.factor, centred.T @ centred, atol=1e-12)
    rows = triangular_factor(data)
    np.testing.assert_allclose(rows.T @ rows, data.T @ data, atol=1e-12)
    assert len(rows) <= 6
