"""Facts of the regressions: soft thresholds, duality, descent, ranks, and moments of many rows."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit.regression import alpha_max, composed_ridge, lasso, least_squares, penalised, ridge
from pisplit.regression import lasso_active_set as active_set
from pisplit.regression.lasso import _Triangular, composed_lasso
from pisplit.regression.moments import BLOCK_BYTES, CONSTANT, accumulate, block_rows, triangular_factor

Array = NDArray[np.float64]
module = importlib.import_module("pisplit.regression.lasso")  # the function has the same name


def orthonormal(rows: int, columns: int, seed: int = 0) -> Array:
    return np.asarray(np.linalg.qr(np.random.default_rng(seed).normal(size=(rows, columns)))[0])


def soft(x: Array, threshold: float) -> Array:
    return np.asarray(np.sign(x) * np.maximum(np.abs(x) - threshold, 0.0))


@pytest.mark.parametrize("columns", [1, 7])
@pytest.mark.parametrize("solver", ["active-set", "cvxpy"])
def test_the_lasso_of_orthonormal_columns_is_a_soft_threshold(solver: str, columns: int) -> None:
    a, y = orthonormal(30, columns), np.random.default_rng(1).normal(size=(30, 3))
    alpha = 0.6 * alpha_max(a, y)
    np.testing.assert_allclose(lasso(a, y, alpha, solver=solver).K, soft(y.T @ a, 0.5 * alpha), atol=1e-8)


def test_the_composed_lasso_of_orthonormal_factors_is_a_soft_threshold() -> None:
    a, f, y = orthonormal(30, 4), orthonormal(9, 3, 1), np.random.default_rng(2).normal(size=(30, 9))
    for alpha in (0.3, 1.0):
        found = composed_lasso(f, a, y, alpha)
        np.testing.assert_allclose(found.K, soft(f.T @ y.T @ a, 0.5 * alpha), atol=1e-8)
        assert found.K.shape == (3, 4) and found.gap is not None and found.gap < 1e-8


def test_the_composed_lasso_without_a_factor_is_the_lasso() -> None:
    rng = np.random.default_rng(3)
    a, y = rng.normal(size=(40, 6)), rng.normal(size=(40, 2))
    np.testing.assert_allclose(composed_lasso(np.eye(2), a, y, 9.0).K, lasso(a, y, 9.0).K, atol=1e-8)


@pytest.mark.parametrize("rows", [8, 60])
def test_the_gap_is_the_primal_minus_the_dual_objective(rows: int) -> None:
    """max over |A^T v| <= alpha of y^T v - |v|^2 / 4 is the dual of min |A k - y|^2 + alpha |k|_1.

    What no column can reach is not limited by the constraint: where there are many rows it is in v unscaled.
    """
    rng = np.random.default_rng(4)
    a, y, k = rng.normal(size=(rows, 5)), rng.normal(size=(rows, 3)), 0.1 * rng.normal(size=(3, 5))
    for alpha in (0.5, 4.0, 200.0):
        found = _Triangular(a, y, alpha).gaps(k)
        for i in range(3):
            error = y[:, i] - a @ k[i]
            reached = error if rows == 8 else a @ np.linalg.lstsq(a, error, rcond=None)[0]
            v = 2.0 * (error - reached) + 2.0 * reached * min(1.0, 0.5 * alpha / np.abs(a.T @ error).max())
            primal = error @ error + alpha * np.abs(k[i]).sum()
            assert found[i] == pytest.approx((primal - y[:, i] @ v + 0.25 * v @ v) / primal, rel=1e-9)


def test_each_solver_is_the_one_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    a, y = rng.normal(size=(20, 4)), rng.normal(size=(20, 2))
    right = lasso(a, y, 5.0).K

    def refuse(*_: object) -> Array:
        raise RuntimeError("this one")

    with monkeypatch.context() as patch:
        patch.setattr(module, "solve_by_cvxpy", refuse)
        np.testing.assert_allclose(lasso(a, y, 5.0, solver="active-set").K, right)
        with pytest.raises(RuntimeError, match="this one"):
            lasso(a, y, 5.0, solver="cvxpy")
    with monkeypatch.context() as patch:
        patch.setattr(module, "solve_by_active_set", refuse)
        np.testing.assert_allclose(lasso(a, y, 5.0, solver="cvxpy").K, right, atol=1e-8)
        with pytest.raises(RuntimeError, match="this one"):
            lasso(a, y, 5.0)


def test_auto_mends_the_one_target_that_has_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    a, y = rng.normal(size=(40, 5)), rng.normal(size=(40, 3))
    right = lasso(a, y, 6.0, solver="active-set").K

    def one_wrong(*_: object) -> Array:
        wrong = right.copy()
        wrong[1] += 0.5
        return wrong

    monkeypatch.setattr(module, "solve_by_active_set", one_wrong)
    mended = lasso(a, y, 6.0)
    np.testing.assert_allclose(mended.K, right, atol=1e-8)
    np.testing.assert_array_equal(mended.K[[0, 2]], right[[0, 2]])
    assert mended.gap is not None and mended.gap < 1e-8


def correlated(rows: int, columns: int, targets: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(rows, columns)) + 2.0 * rng.normal(size=(rows, 1))
    return a, a[:, ::3] @ rng.normal(size=(len(range(0, columns, 3)), targets)) + rng.normal(size=(rows, targets))


def violation(a: Array, y: Array, k: Array, alpha: float) -> float:
    slope = 2.0 * (k @ a.T - y.T) @ a
    off = np.where(k == 0.0, np.maximum(np.abs(slope) - alpha, 0.0), np.abs(slope + alpha * np.sign(k)))
    return float(off.max() / alpha)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("start", ["none", "other signs", "dense", "answer"])
def test_every_step_of_the_active_set_goes_down_to_the_optimum(
    seed: int, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, y = correlated(60, 40, 2, seed)
    alpha = 10.0 ** (-1 - seed / 2) * alpha_max(a, y)
    answer = active_set.solve_by_active_set(a, y, alpha)
    rng = np.random.default_rng(seed)
    warm = {"none": None, "other signs": -3.0 * answer, "dense": rng.normal(size=answer.shape), "answer": answer}[start]
    values: list[float] = []
    step = active_set._step

    def watched(gram: Array, slope: Array, penalty: Array, active: active_set._Active, ridge: float) -> object:
        def objective(found: active_set._Active) -> float:  # up to a constant, from the slope c - G k of the start
            k = found.values
            c = slope + gram[:, active.columns] @ active.values
            block = gram[np.ix_(found.columns, found.columns)]
            return float(0.5 * k @ block @ k - c[found.columns] @ k + penalty[found.columns] @ np.abs(k))

        before = objective(active)
        found, promised = step(gram, slope, penalty, active, ridge)
        assert promised >= 0.0
        assert objective(found) <= before + 1e-10 * (1.0 + abs(before))
        values.append(objective(found))
        return found, promised

    monkeypatch.setattr(active_set, "_step", watched)
    k = active_set.solve_by_active_set(a, y, alpha, warm)
    assert violation(a, y, k, alpha) < 1e-7
    np.testing.assert_allclose(k, answer, atol=1e-6 * np.abs(answer).max())
    assert len(values) <= (2 * 2 if start == "answer" else 2 * 60)


def test_a_line_search_of_the_lasso_finds_the_lowest_point_of_the_line() -> None:
    """Along values + t step the objective is convex and quadratic between the kinks, where an entry passes zero."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        n = int(rng.integers(2, 7))
        root = rng.normal(size=(n + 1, n))
        block, weights = root.T @ root, rng.uniform(0.1, 2.0, n)
        values = rng.normal(size=n) * 10.0 ** rng.uniform(-2, 0.5)
        signs, c = np.sign(values), rng.normal(size=n) * 2.0

        def objective(k: Array, block: Array = block, c: Array = c, weights: Array = weights) -> float:
            return float(0.5 * k @ block @ k - c @ k + weights @ np.abs(k))

        downhill = c - block @ values - weights * signs
        step = np.linalg.solve(block, downhill)
        crossing = np.where(values * step < 0.0, -values / step, np.inf)
        kinks = np.flatnonzero(crossing < 1.0)
        if not len(kinks):
            continue
        slope = float(downhill @ step)
        moved = active_set._along(values, step, crossing, kinks, slope, weights)
        t = float((moved - values) @ step / (step @ step))
        on_line = np.linspace(0.0, 1.0, 101)
        lowest = min(objective(values + s * step) for s in (*on_line, *crossing[kinks]))
        assert 0.0 <= t <= 1.0 + 1e-12
        assert objective(moved) <= lowest + 1e-12 * (1.0 + abs(lowest))
        change = active_set._change(block, downhill, weights, signs, values, moved)
        assert change == pytest.approx(objective(moved) - objective(values), rel=1e-9, abs=1e-11)


def test_the_ridge_through_a_factor_satisfies_its_normal_equations() -> None:
    rng = np.random.default_rng(8)
    f, a, y = rng.normal(size=(7, 3)), rng.normal(size=(30, 5)), rng.normal(size=(30, 7))
    for alpha in (0.0, 0.3, 20.0):
        h = composed_ridge(f, a, y, alpha).K
        np.testing.assert_allclose(f.T @ (f @ h @ a.T - y.T) @ a + alpha * h, 0.0, atol=1e-10)
    known = rng.normal(size=(3, 5))
    exact = composed_ridge(f, a, a @ known.T @ f.T, 0.0)
    np.testing.assert_allclose(exact.K, known, atol=1e-10)
    assert exact.rank == 15


def test_the_ridge_satisfies_its_normal_equations_about_the_prior() -> None:
    rng = np.random.default_rng(9)
    a, y, prior = rng.normal(size=(30, 5)), rng.normal(size=(30, 4)), rng.normal(size=(4, 5))
    for alpha in (0.0, 0.3, 20.0):
        k = ridge(a, y, alpha, prior).K
        np.testing.assert_allclose((k @ a.T - y.T) @ a + alpha * (k - prior), 0.0, atol=1e-10)


@pytest.mark.parametrize(("rows", "columns", "rank"), [(300, 200, 100), (200, 300, 150), (50, 50, 20)])
def test_rounding_is_not_taken_for_rank(rows: int, columns: int, rank: int) -> None:
    rng = np.random.default_rng(10)
    a = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
    found = least_squares(a, a @ rng.normal(size=(columns, 1)))
    assert found.rank == rank
    assert np.abs(found.K).max() < 10.0


def test_moments_of_one_long_block_are_those_of_its_rows() -> None:
    data = np.random.default_rng(11).normal(size=(9000, 3)) + np.linspace(0.0, 5.0, 9000)[:, None]
    found = accumulate([data])
    assert found.n_samples == 9000
    np.testing.assert_allclose(found.mean, data.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.std, data.std(axis=0), rtol=1e-12)
    rows = triangular_factor(data)
    np.testing.assert_allclose(rows.T @ rows, data.T @ data, rtol=1e-12)
    centred, plain = found.rows(centred=True), found.rows(centred=False)
    np.testing.assert_allclose(centred.T @ centred, (data - data.mean(axis=0)).T @ (data - data.mean(axis=0)))
    np.testing.assert_allclose(plain.T @ plain, data.T @ data)
    halved = found.scaled(np.array([2.0, 1.0, 4.0]))
    np.testing.assert_allclose(halved.std * [2.0, 1.0, 4.0], found.std)
    np.testing.assert_allclose(halved.mean * [2.0, 1.0, 4.0], found.mean)


def test_a_constant_has_no_deviation_and_a_small_deviation_is_kept() -> None:
    rng = np.random.default_rng(12)
    wobble = rng.normal(size=500)
    found = accumulate([np.column_stack([np.full(500, 0.1), 1.0 + 1e-7 * wobble, 1e-9 * wobble])])
    assert found.std[0] == 0.0
    np.testing.assert_allclose(found.std[1:], [1e-7 * wobble.std(), 1e-9 * wobble.std()], rtol=1e-6)


def test_masked_entries_keep_their_prior_in_every_regression() -> None:
    rng = np.random.default_rng(13)
    a, y, prior = rng.normal(size=(40, 6)), rng.normal(size=(40, 4)), rng.normal(size=(4, 6))
    free = rng.uniform(size=(4, 6)) < 0.5
    free[2] = False
    fits: tuple[Callable[[], Array], ...] = (
        lambda: least_squares(a, y, prior, free).K,
        lambda: ridge(a, y, 2.0, prior, free).K,
        lambda: lasso(a, y, 2.0, prior, free).K,
    )
    for fit in fits:
        k = fit()
        np.testing.assert_array_equal(k[~free], prior[~free])
        assert (k[free] != prior[free]).any()
    k = ridge(a, y, 2.0, prior, free).K
    slope = (k @ a.T - y.T) @ a + 2.0 * (k - prior)
    np.testing.assert_allclose(slope[free], 0.0, atol=1e-10)


def test_blocks_hold_at_most_their_bytes_and_never_less_than_their_least() -> None:
    assert block_rows(1) == 4096 and block_rows(10**5) == 256
    for columns in (300, 1000, 3000):
        assert 0.99 * BLOCK_BYTES < 8 * columns * block_rows(columns) <= BLOCK_BYTES


def test_a_column_that_varies_above_rounding_is_kept_whatever_their_number() -> None:
    rng = np.random.default_rng(0)
    n, mean = 10_000, 1.0
    for size, kept in ((20.0, True), (0.05, False)):
        found = accumulate([mean + size * CONSTANT * rng.choice([-1.0, 1.0], size=(n, 1))])
        assert bool(np.abs(found.factor).max() > 0.0) == kept


def test_a_composed_ridge_is_a_ridge_for_every_direction_of_its_factor() -> None:
    """Through U s V^T the rows of V^T H are ridges of their own; of a rotation, all are one ridge."""
    rng = np.random.default_rng(0)
    f, a, y = rng.normal(size=(5, 2)), rng.normal(size=(20, 3)), rng.normal(size=(20, 5))
    u, s, vt = np.linalg.svd(f, full_matrices=False)
    each = [ridge(a, y @ u[:, [i]] / s[i], 0.1 / s[i] ** 2).K for i in range(2)]
    np.testing.assert_allclose(composed_ridge(f, a, y, 0.1).K, vt.T @ np.vstack(each), rtol=1e-12)
    turned = 3.0 * np.linalg.qr(rng.normal(size=(5, 2)))[0]
    h = composed_ridge(turned, a, y, 0.1).K
    np.testing.assert_allclose(turned.T @ (turned @ h @ a.T - y.T) @ a + 0.1 * h, 0.0, atol=1e-12)
    np.testing.assert_array_equal(composed_ridge(np.zeros((5, 2)), a, y, 0.1).K, 0.0)


@pytest.mark.parametrize("shape", [(90, 40), (40, 40), (12, 40), (600, 300)])
@pytest.mark.parametrize("form", ["dense", "triangle", "wanting rank"])
@pytest.mark.parametrize("alpha", [1e-10, 1e-3, 1e2])
def test_a_ridge_by_orthogonal_transformations_is_that_by_singular_values(
    shape: tuple[int, int], form: str, alpha: float
) -> None:
    """Condition numbers up to 1e8: the normal equations would lose all digits, this keeps what the SVD keeps."""
    rng = np.random.default_rng(shape[0])
    n, size = shape
    a, y = rng.normal(size=shape) * np.logspace(0, -8, size), rng.normal(size=(n, 3))
    if form == "triangle":
        rows = np.linalg.qr(np.hstack([a, y]), mode="r")
        a, y = rows[:, :size], rows[:, size:]
    if form == "wanting rank":
        a[:, size // 2 :] = a[:, : size - size // 2]
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    want = (vt.T * (s / (s**2 + alpha))) @ (u.T @ y)
    # What both lose: rounding, times the condition number of [A; sqrt(alpha) I].
    lost = 1e-15 * np.sqrt((s[0] ** 2 + alpha) / alpha) * size
    found = ridge(a, y, alpha)
    assert np.abs(found.K.T - want).max() <= lost * np.abs(want).max()
    assert found.rank is None


def test_a_regression_of_what_is_not_finite_is_refused() -> None:
    a, y = np.ones((4, 2)), np.ones((4, 1))
    for bad in (np.nan, np.inf):
        for regress in (lambda a, y: ridge(a, y, 1.0), lambda a, y: composed_ridge(np.eye(1), a, y, 1.0)):
            for which in (0, 1):
                given = [a.copy(), y.copy()]
                given[which][1, 0] = bad
                with pytest.raises(ValueError, match="NaN or infinite"):
                    regress(*given)


def test_moments_do_not_depend_on_how_rows_arrive() -> None:
    """Fewer rows than columns wait; where there are enough the first triangle is made, and the rest rotated in."""
    data = np.random.default_rng(15).normal(size=(2300, 300))
    whole = accumulate([data]).factor
    for size in (7, 150, 1100):
        found = accumulate(data[i : i + size] for i in range(0, len(data), size)).factor
        np.testing.assert_allclose(np.abs(found), np.abs(whole), atol=1e-11)
        assert not np.tril(found, -1).any()
    few = accumulate([data[:40], data[40:90]])
    assert few.factor.shape[0] < 100
    centred = data[:90] - data[:90].mean(axis=0)
    np.testing.assert_allclose(few.factor.T @ few.factor, centred.T @ centred, atol=1e-11)


def test_small_weights_of_a_lasso_are_a_lasso() -> None:
    rng = np.random.default_rng(0)
    a, y = rng.normal(size=(40, 6)), rng.normal(size=(40, 2))
    found = penalised(a, y, 0.5, "lasso")
    np.testing.assert_allclose(found.K, lasso(a, y, 0.5).K, atol=1e-10)
    assert found.gaps is not None


def test_a_target_that_is_known_whole_has_no_gap() -> None:
    a, y = orthonormal(30, 3), np.random.default_rng(1).normal(size=(30, 2))
    free = np.array([[True, True, True], [False, False, False]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lasso(a, y, 0.1, prior=np.ones((2, 3)), free=free)
    assert found.gaps is not None and found.gaps[1] == 0.0
    np.testing.assert_array_equal(found.K[1], 1.0)
