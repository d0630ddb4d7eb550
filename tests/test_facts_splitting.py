"""Facts of the splittings: their order in dt, and the kick as the minimiser of the residual that the paper prints."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.regression import alpha_max
from pisplit.regression.moments import accumulate
from pisplit.splitting import SplitContext
from pisplit.splitting.rows import free_block, row_weights
from pisplit.splitting.unknown_part import unknown_part

Array = NDArray[np.float64]
STIFFNESS, DAMPING, GAIN = 2.0, 0.7, 1.5


def oscillator(dt: float, split: str) -> float:
    """Distance of the fitted one-step map of x'' = -x - (k x + c v) + b u from the exact one; h acts on v alone."""
    full = np.array([[0.0, 1.0, 0.0], [-1.0 - STIFFNESS, -DAMPING, GAIN], [0.0, 0.0, 0.0]])
    exact = scipy.linalg.expm(dt * full)
    rng = np.random.default_rng(0)
    xs, us = [], []
    for _ in range(8):
        u = rng.normal(size=(20, 1))
        x = [rng.normal(size=2)]
        for value in u:
            x.append(exact[:2] @ [*x[-1], value[0]])
        xs.append(np.array(x))
        us.append(u)
    states = rng.normal(size=(50, 2))
    d2 = PhaseSamples(states, rng.normal(size=(50, 1)), np.column_stack([states[:, 1], -states[:, 0]]))
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    model = PIEDMDc(theta, 0.0, penalty="ridge", rows=["x2"], half_step="generator", split=split)
    fitted = model.fit(Episodes(xs, us, dt), d2).lifted
    return float(np.abs(np.hstack([fitted.A, fitted.B]) - exact[:2]).max())


@pytest.mark.parametrize(("split", "local"), [("strang", 3), ("lie", 2)])
def test_a_step_of_the_split_has_the_order_of_the_split(split: str, local: int) -> None:
    """One step errs by O(dt^3) for K_f K_h K_f and by O(dt^2) where both half steps stand on one side."""
    errors = np.array([oscillator(dt, split) for dt in (0.04, 0.02, 0.01)])
    orders = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(orders, local, atol=0.15)


def problem(
    penalty: str, toward: str, rows: Sequence[str] | Mapping[str, float] | None, constant: bool
) -> tuple[SplitContext, Array, Array, Array, Array]:
    """A context in three states and two inputs, L and R on scaled columns, and samples of Theta and Theta'."""
    rng = np.random.default_rng(3)
    parts: list[ob.Observable] = [ob.Constant(), ob.Identity()] if constant else [ob.Identity()]
    theta = Dictionary(*parts, n_states=3, n_inputs=2)
    size, learned = theta.n_columns, theta.learned_columns
    scale = rng.uniform(0.3, 3.0, size)
    if constant:
        scale[theta.constant_column] = 1.0
    context = SplitContext(theta, scale, 0.1, penalty=penalty, toward=toward, rows=rows, relative=False)
    left, right = np.eye(size), np.eye(size)
    left[learned] += 0.3 * rng.normal(size=(len(learned), size))
    right[learned] += 0.3 * rng.normal(size=(len(learned), size))
    a = rng.normal(size=(80, size)) * scale + 0.5
    if constant:
        a[:, theta.constant_column] = 1.0
    after = a @ rng.normal(size=(size, 3)) + 0.3 * rng.normal(size=(80, 3))
    return context, left, right, a, after


ROWS = [None, ["x2", "x3"], {"x1": 4.0, "x3": 0.5}]


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("toward", ["zero", "identity"])
def test_the_kick_minimises_the_composed_residual(
    toward: str, rows: Sequence[str] | Mapping[str, float] | None, constant: bool
) -> None:
    """|L K_h R Theta - Theta'|^2 + alpha |K_h - prior|^2 on scaled columns; the constant's column is free of alpha."""
    context, left, right, a, after = problem("ridge", toward, rows, constant)
    theta, scale, learned, alpha = context.theta, context.scale, context.theta.learned_columns, 2.5
    free, columns, _ = free_block(theta, rows)
    weights = row_weights(theta, rows, free)
    k_h = unknown_part(context, left, right, accumulate([np.hstack([a, after])]), alpha).K
    prior = np.eye(theta.n_columns) if toward == "identity" else np.zeros((theta.n_columns, theta.n_columns))

    def objective(k: Array) -> float:
        residual = (a / scale) @ (left @ k @ right)[learned].T - after / scale[learned]
        departure = (k - prior)[np.ix_(free, columns)]
        return float((residual**2).sum() + alpha * (weights[:, None] * departure**2).sum())

    every = [*columns, theta.constant_column] if constant else list(columns)
    for i in free:
        for j in every:
            step = np.zeros_like(k_h)
            step[i, j] = 1e-2
            slope = (objective(k_h + step) - objective(k_h - step)) / 2e-2  # exact: the objective is a square
            assert abs(slope) < 1e-7 * objective(k_h)
    fixed = np.setdiff1d(np.arange(theta.n_columns), free)
    np.testing.assert_array_equal(k_h[fixed], np.eye(theta.n_columns)[fixed])


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("toward", ["zero", "identity"])
def test_the_sparse_kick_minimises_the_pulled_back_residual(
    toward: str, rows: Sequence[str] | Mapping[str, float] | None, constant: bool
) -> None:
    """|K_h R Theta - L^-1 Theta'|^2 + alpha |K_h - prior|_1, where Theta' of inputs and constant is R Theta."""
    context, left, right, a, after = problem("lasso", toward, rows, constant)
    theta, scale, learned, alpha = context.theta, context.scale, context.theta.learned_columns, 50.0
    free, columns, _ = free_block(theta, rows)
    weights = row_weights(theta, rows, free)
    k_h = unknown_part(context, left, right, accumulate([np.hstack([a, after])]), alpha).K
    w = (a / scale) @ right.T
    complete = w.copy()
    complete[:, learned] = after / scale[learned]
    target = np.linalg.solve(left, complete.T).T
    prior = np.eye(theta.n_columns) if toward == "identity" else np.zeros((theta.n_columns, theta.n_columns))
    slope = 2.0 * ((w @ k_h.T - target).T @ w)[np.ix_(free, columns)]
    departure = (k_h - prior)[np.ix_(free, columns)]
    level = alpha * np.broadcast_to(weights[:, None], slope.shape)
    at_zero = np.abs(departure) < 1e-12
    assert at_zero.any() and not at_zero.all()
    np.testing.assert_allclose((slope + level * np.sign(departure))[~at_zero], 0.0, atol=1e-6)
    assert (np.abs(slope) <= level + 1e-6)[at_zero].all()
    if constant:
        np.testing.assert_allclose((target - w @ k_h.T)[:, free].mean(axis=0), 0.0, atol=1e-9)
    fixed = np.setdiff1d(np.arange(theta.n_columns), free)
    np.testing.assert_array_equal(k_h[fixed], np.eye(theta.n_columns)[fixed])


def test_units_of_alpha_are_the_data_nothing_or_the_samples() -> None:
    context, left, right, a, after = problem("lasso", "zero", None, False)
    moments = accumulate([np.hstack([a, after])])
    w = (a / context.scale) @ right.T
    found = {}
    for relative in (True, False, "samples"):
        other = SplitContext(context.theta, context.scale, 0.1, penalty="lasso", relative=relative)
        found[relative] = unknown_part(other, left, right, moments, 0.05).alpha
    complete = w.copy()
    complete[:, :3] = after / context.scale[:3]
    assert found[False] == 0.05 and found["samples"] == pytest.approx(0.05 * len(a))
    assert found[True] == pytest.approx(0.05 * alpha_max(w, np.linalg.solve(left, complete.T).T[:, :3]))
    none = SplitContext(context.theta, context.scale, 0.1, penalty="lasso")
    assert not unknown_part(none, left, right, moments, 1.0 + 1e-9).K[:3].any()
    ridge = SplitContext(context.theta, context.scale, 0.1)
    gram, factor = float((w**2).sum()) / 5, float((left[:3, :3] ** 2).sum()) / 3
    assert unknown_part(ridge, left, right, moments, 0.05).alpha == pytest.approx(0.05 * gram * factor)


def test_a_damped_half_step_amplifies_no_noise() -> None:
    """Where K_f damps a column to nothing, ridge leaves it to the prior: K_f is not inverted."""
    context, left, right, a, after = problem("ridge", "identity", None, False)
    left[2] *= 1e-13
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        k_h = unknown_part(context, left, right, accumulate([np.hstack([a, after])]), 1e-3).K
    assert np.abs(k_h).max() < 100.0


def test_a_kick_without_a_penalty_is_least_squares_and_its_rank_counts_every_unknown() -> None:
    """Three rows on five columns: 15 unknowns, determined by full-rank data, whatever the penalty of weight zero."""
    found = {}
    for penalty in ("lasso", "ridge"):
        context, left, right, a, after = problem(penalty, "zero", None, False)
        found[penalty] = unknown_part(context, left, right, accumulate([np.hstack([a, after])]), 0.0)
    assert found["lasso"].rank == found["ridge"].rank == 15
