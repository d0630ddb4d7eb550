"""The known part: units of its penalty, its LASSO, known rows, the first order, the past of a phase sample."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc, generator_edmd, half_step
from pisplit import observables as ob
from pisplit.generator import KnownOptions, flow_map
from pisplit.models import systems

F = np.array([[0.0, 1.0], [-4.0, -0.3]])
PLAIN = Dictionary(ob.States(), n_states=2, n_inputs=1, state_names=("x", "v"))


def samples(n: int = 40, noise: float = 0.0, unit: float = 1.0) -> PhaseSamples:
    """x' = F x with noise in f; x in 1 / ``unit`` metres."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, 2))
    f = x @ F.T + noise * rng.normal(size=(n, 2))
    scale = np.array([unit, 1.0])
    return PhaseSamples(x * scale, np.zeros((n, 1)), f * scale)


@pytest.mark.parametrize("n", [10, 400])
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_a_relative_ridge_of_the_generator_has_no_units(n: int, unit: float) -> None:
    """x' = l x in one column: alpha in parts of sum x^2 makes l / (1 + alpha) of l, in any unit of x, of any number."""
    x = unit * np.random.default_rng(0).normal(size=(n, 1))
    d2, theta = PhaseSamples(x, np.zeros((n, 1)), -3.0 * x), Dictionary(ob.States(), n_states=1, n_inputs=1)
    total = float((x**2).sum())
    for relative, weight in ((True, 0.5 * total), ("samples", 0.5 * n), (False, 0.5)):
        found = generator_edmd(theta, d2, np.ones(1), 0.5, KnownOptions(relative=relative))
        assert found[0, 0] == pytest.approx(-3.0 * total / (total + weight), rel=1e-12)
    assert generator_edmd(theta, d2, np.ones(1), 0.5)[0, 0] == pytest.approx(-2.0)


def test_generator_alpha_of_the_estimator_has_the_same_unit() -> None:
    theta = Dictionary(ob.States(), n_states=1, n_inputs=1)
    x = np.linspace(0.5, 1.0, 12)[:, None]
    d1 = Episodes([x], [np.zeros((11, 1))], 0.1)
    d2 = PhaseSamples(x, np.zeros((12, 1)), -3.0 * x)
    for relative, weight in ((True, 1.0), ("samples", 12.0 / float((x**2).sum()))):
        model = PIEDMDc(theta, 0.0, "ridge", generator_alpha=1.0, relative=relative, scale=None).fit(d1, d2)
        assert model.fit_.details["max_real"] == pytest.approx(-3.0 / (1.0 + weight))


@pytest.mark.parametrize("solver", ["active-set", "cvxpy"])
def test_generator_and_flow_map_by_lasso_are_minimisers(solver: str) -> None:
    """min |L Theta - J|^2 + 0.01 N |L|_1, and the same for the flow over dt/2: "in every regression"."""
    d2 = samples(noise=0.5)
    d2 = PhaseSamples(d2.x, d2.u, d2.xdot, d2.x + 0.05 * d2.xdot, 0.1)
    options = KnownOptions("lasso", solver, "samples")
    for found, target in (
        (generator_edmd(PLAIN, d2, np.ones(2), 0.3, options), d2.xdot),
        (flow_map(PLAIN, d2, 0.1, np.ones(2), 0.3, options), d2.x_half),
    ):
        k = cp.Variable((2, 2))
        objective = cp.sum_squares(d2.x @ k.T - target) + 0.3 * 40 * cp.sum(cp.abs(k))
        cp.Problem(cp.Minimize(objective)).solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12)
        np.testing.assert_allclose(found, k.value, atol=1e-6)
    assert np.count_nonzero(np.abs(generator_edmd(PLAIN, d2, np.ones(2), 0.3, options)) < 1e-12) > 0


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_known_rows_are_taken_as_they_are_in_units_of_the_columns(unit: float) -> None:
    """x' = v is kinematics: noise in the samples of f does not reach this row, whatever its unit and scale."""
    options = KnownOptions(rows={"x": {"v": unit}})
    d2, scale = samples(noise=0.5, unit=unit), np.array([3.0, 0.2])
    found = generator_edmd(PLAIN, d2, scale, 0.1, options) * scale[:, None] / scale
    np.testing.assert_allclose(found[0], [0.0, unit], rtol=1e-14)
    plain = generator_edmd(PLAIN, d2, scale, 0.1) * scale[:, None] / scale
    np.testing.assert_allclose(found[1], plain[1], rtol=1e-12)
    assert abs(plain[0, 1] / unit - 1.0) > 1e-2


def test_known_rows_reach_the_operator_and_wrong_names_are_refused() -> None:
    rng, system = np.random.default_rng(0), systems.duffing()
    d1 = Episodes.from_system(system, rng.uniform(-1, 1, (3, 2)), [rng.uniform(-1, 1, (20, 1)) for _ in range(3)], 0.1)
    d2 = PhaseSamples(rng.normal(size=(40, 2)), np.zeros((40, 1)), rng.normal(size=(40, 2)))  # f unknown altogether
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    known = {"x": {"v": 1.0}, "v": {"x": -2.0}}
    fit = PIEDMDc(theta, 1e12, "ridge", "identity", half_step="first-order", known_rows=known).fit(d1, d2)
    half = np.array([[1.0, 0.05, 0.0], [-0.1, 1.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(fit.K_, (half @ half)[:2], atol=1e-9)
    for wrong in ({"y": {"v": 1.0}}, {"x": {"w": 1.0}}, {"u1": {"x": 1.0}}):
        with pytest.raises(ValueError, match="known rows name") as error:
            PIEDMDc(theta, 0.0, known_rows=wrong).fit(d1, d2)
        assert "\n" not in str(error.value)


def test_the_first_order_half_step_is_the_start_of_the_exponential() -> None:
    errors = []
    for dt in (0.1, 0.05):
        first = half_step(PLAIN, samples(), dt, np.ones(2), "first-order")
        np.testing.assert_allclose(first.K, np.eye(2) + 0.5 * dt * F, atol=1e-12)
        errors.append(np.abs(half_step(PLAIN, samples(), dt, np.ones(2), "generator").K - first.K).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert first.kind == "first-order" and first.spectrum is not None


def test_a_past_that_equals_the_present_shares_what_the_present_does() -> None:
    theta = Dictionary(ob.States(), ob.Delays(states=2), n_states=2, n_inputs=1)
    absent, equal = (
        generator_edmd(theta, samples(), np.ones(6), 0.0, KnownOptions(past=past)) for past in ("absent", "equal")
    )
    np.testing.assert_allclose(absent[:2], np.hstack([F, np.zeros((2, 4))]), atol=1e-10)
    np.testing.assert_allclose(equal[:2].reshape(2, 3, 2), np.stack([F / 3.0] * 3, axis=1), atol=1e-10)
    np.testing.assert_array_equal(equal[2:], 0.0)
    half = half_step(theta, samples(), 0.1, np.ones(6), "generator", options=KnownOptions(past="equal"))
    at_rest = np.tile(np.array([1.0, -0.5]), 3)
    np.testing.assert_array_equal((half.K @ at_rest)[2:], at_rest[2:])


def test_moments_that_are_remembered_are_those_of_these_samples_and_this_dictionary() -> None:
    first, second = samples(), samples(noise=0.5)
    wide = Dictionary(ob.States(), ob.Polynomials(2), n_states=2, n_inputs=1)
    alone = {
        (theta, d2): generator_edmd(theta, d2, np.ones(theta.n_columns))
        for theta in (PLAIN, wide)
        for d2 in (first, second)
    }
    for (theta, d2), expected in alone.items():
        np.testing.assert_array_equal(generator_edmd(theta, d2, np.ones(theta.n_columns)), expected)
    assert np.abs(alone[PLAIN, first] - alone[PLAIN, second]).max() > 1e-2
