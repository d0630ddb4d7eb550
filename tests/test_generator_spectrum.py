"""Eigenpairs of generators: exact where the dictionary is closed under f, called spurious where it is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.generator import (
    equilibrium_drift,
    generator_edmd,
    generator_spectrum,
    half_step,
    weighted_moments,
)
from pisplit.generator.generator import PLAIN
from pisplit.generator.half_step import _condition
from pisplit.generator.spectrum import spectrum
from pisplit.models import systems
from pisplit.regression.moments import accumulate

MU, LAM = -0.1, -1.0


def slow_manifold(n: int = 80, flow: bool = False, dt: float = 0.2) -> PhaseSamples:
    rng = np.random.default_rng(5)
    system = systems.slow_manifold(mu=MU, lam=LAM)
    return PhaseSamples.from_system(system, rng.uniform(-1, 1, (n, 2)), rng.uniform(-1, 1, (n, 1)), dt=dt, flow=flow)


def closed() -> Dictionary:
    square = ob.Polynomials(2, variables=("x1",))
    return Dictionary(ob.Constant(), ob.Identity(), square, n_states=2, n_inputs=1)


def linear_part() -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)


def test_an_invariant_dictionary_has_exact_eigenpairs_without_residual() -> None:
    found = generator_spectrum(closed(), slow_manifold())
    np.testing.assert_allclose(np.sort(found.values.real), sorted([LAM, 2 * MU, MU, 0.0, 0.0]), atol=1e-10)
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-9)
    assert not found.spurious().any() and found.report() == ()


def test_eigenfunctions_are_those_of_the_slow_manifold() -> None:
    # x2 - c x1^2 with c = lam / (lam - 2 mu) decays at lam (Brunton et al., 2016).
    found, theta = generator_spectrum(closed(), slow_manifold()), closed()
    fast = found.functions[int(np.argmin(np.abs(found.values - LAM)))]
    fast = fast / fast[theta.column_names.index("x2")]
    np.testing.assert_allclose(fast[theta.column_names.index("x1^2")], -LAM / (LAM - 2 * MU), atol=1e-9)
    np.testing.assert_allclose(np.delete(fast, [2, 3]), 0.0, atol=1e-9)


def test_a_dictionary_that_is_not_closed_keeps_true_pairs_and_names_the_spurious_one() -> None:
    found = generator_spectrum(linear_part(), slow_manifold())
    true = found.residuals < 1e-8
    np.testing.assert_allclose(np.sort(found.values[true].real), [MU, 0.0, 0.0], atol=1e-10)
    (spurious,) = np.flatnonzero(~true)
    assert found.spurious()[spurious] and found.columns[spurious] == "x2"
    (text,) = found.report()
    assert "mostly x2" in text and "residual" in text


def test_a_harmonic_oscillator_and_its_squares() -> None:
    x = np.random.default_rng(0).normal(size=(60, 2))
    samples = PhaseSamples(x, np.zeros((60, 0)), np.column_stack([x[:, 1], -x[:, 0]]))
    theta = Dictionary(ob.Constant(), ob.States(), ob.Polynomials(2), n_states=2, n_inputs=0)
    found = generator_spectrum(theta, samples)
    np.testing.assert_allclose(np.sort(found.values.imag), [-2, -1, 0, 0, 1, 2], atol=1e-10)
    np.testing.assert_allclose(found.values.real, 0.0, atol=1e-10)
    np.testing.assert_allclose(found.residuals, 0.0, atol=1e-6)


def test_the_residual_is_the_error_of_the_eigenvalue_equation_on_the_samples() -> None:
    theta, samples = linear_part(), slow_manifold()
    found = generator_spectrum(theta, samples)
    columns = np.hstack([theta.present(samples.x), theta.features(samples.u)])
    lie = theta.lie_derivative(samples.x, samples.u, samples.xdot)
    for value, function, absolute, residual in zip(
        found.values, found.functions, found.absolute, found.residuals, strict=True
    ):
        phi, rate = columns @ function, lie @ function
        np.testing.assert_allclose((np.abs(phi) ** 2).mean(), 1.0, atol=1e-9)
        miss = np.linalg.norm(rate - value * phi) / np.linalg.norm(phi)
        np.testing.assert_allclose(absolute, miss, atol=1e-9)
        if miss > 1e-6:
            speed = np.linalg.norm(rate) / np.linalg.norm(phi) + abs(value)
            np.testing.assert_allclose(residual, miss / speed, atol=1e-9)


def test_the_factor_gives_the_residual_of_the_third_moment_matrix() -> None:
    rng = np.random.default_rng(1)
    theta, lie = rng.normal(size=(50, 4)), rng.normal(size=(50, 4))
    generator = np.linalg.lstsq(theta, lie, rcond=None)[0].T
    found = spectrum(generator, theta, lie, np.ones(4), list("abcd"), 50)
    g, a, third = theta.T @ theta, theta.T @ lie, lie.T @ lie
    for value, w, absolute in zip(found.values, found.functions, found.absolute, strict=True):
        square = w.conj() @ (third - np.conj(value) * a - value * a.T + abs(value) ** 2 * g) @ w
        np.testing.assert_allclose(absolute**2, square.real / (w.conj() @ g @ w).real, rtol=1e-9)
    triangle = np.linalg.qr(np.hstack([theta, lie]), mode="r")
    again = spectrum(generator, triangle[:, :4], triangle[:, 4:], np.ones(4), list("abcd"), 50)
    np.testing.assert_allclose(again.residuals, found.residuals, rtol=1e-9)


def test_residuals_do_not_depend_on_the_scales_of_the_columns() -> None:
    theta, samples = linear_part(), slow_manifold()
    plain = generator_spectrum(theta, samples, np.ones(4))
    scaled = generator_spectrum(theta, samples, np.array([1.0, 1e-3, 50.0, 1e4]))
    np.testing.assert_allclose(np.sort(scaled.residuals), np.sort(plain.residuals), atol=1e-8)


def test_a_function_that_vanishes_on_all_samples_is_no_eigenfunction() -> None:
    twice = ob.Expression(lambda x, u: 2.0 * x[0], name="double")
    theta = Dictionary(ob.States(), twice, n_states=1, n_inputs=0)
    x = np.random.default_rng(0).normal(size=(20, 1))
    found = generator_spectrum(theta, PhaseSamples(x, np.zeros((20, 0)), -x))
    np.testing.assert_allclose(found.values[0], -1.0)
    assert found.residuals[0] < 1e-9 and found.residuals[1] == 1.0 and np.isinf(found.absolute[1])


def test_whole_weights_count_samples_and_zero_weights_drop_them() -> None:
    rng = np.random.default_rng(2)
    x, u, f = rng.normal(size=(30, 2)), rng.normal(size=(30, 1)), rng.normal(size=(30, 2))
    times = rng.integers(0, 4, 30)
    theta, scale = linear_part(), np.array([1.0, 2.0, 0.5, 3.0])
    repeated = PhaseSamples(*(np.repeat(a, times, axis=0) for a in (x, u, f)))
    for factor in (1.0, 1e-6):
        weighted = PhaseSamples(x, u, f, weights=factor * times)
        for alpha in (0.0, 1e-2):
            np.testing.assert_allclose(
                generator_edmd(theta, weighted, scale, alpha), generator_edmd(theta, repeated, scale, alpha), atol=1e-10
            )
        np.testing.assert_allclose(
            np.sort(generator_spectrum(theta, weighted, scale).residuals),
            np.sort(generator_spectrum(theta, repeated, scale).residuals),
            atol=1e-10,
        )


def test_weighted_moments_are_the_weighted_mean_and_covariance() -> None:
    rng = np.random.default_rng(3)
    rows, w = rng.normal(size=(40, 3)) + 10.0, rng.uniform(size=40)
    found = weighted_moments(iter([(w[:15], rows[:15]), (w[15:], rows[15:])]))
    np.testing.assert_allclose(found.mean, np.average(rows, axis=0, weights=w), rtol=1e-12)
    covariance = np.cov(rows.T, aweights=w, ddof=0)
    np.testing.assert_allclose(found.factor.T @ found.factor / found.n_samples, covariance, atol=1e-12)
    equal = weighted_moments(iter([(None, rows)]))
    np.testing.assert_allclose(np.abs(equal.factor), np.abs(accumulate([rows]).factor), atol=1e-12)


def test_quadrature_weights_make_the_projection_that_of_the_weighted_measure() -> None:
    # Best linear fit of x^3 over [-1, 1] is 3/5 x: Gauss nodes give it exactly.
    nodes, weights = np.polynomial.legendre.leggauss(8)
    x = nodes[:, None]
    theta = Dictionary(ob.States(), n_states=1, n_inputs=0)
    found = generator_edmd(theta, PhaseSamples(x, np.zeros((8, 0)), x**3, weights=weights), np.ones(1))
    np.testing.assert_allclose(found, [[0.6]], atol=1e-13)


def test_weights_are_kept_by_selections_and_files(tmp_path: Path) -> None:
    x = np.arange(6.0)[:, None]
    samples = PhaseSamples(x, 0 * x, -x, weights=np.array([0.0, 1, 2, 0, 3, 0]))
    samples.save(tmp_path / "d2.h5")
    np.testing.assert_array_equal(PhaseSamples.load(tmp_path / "d2.h5").weights, samples.weights)
    np.testing.assert_array_equal(samples.take([1, 4]).weights, [1, 3])
    assert [len(block) for block in samples.blocks(2)] == [2, 1]
    for bad in (-np.ones(6), np.zeros(6), np.full(6, np.nan), np.ones(5)):
        with pytest.raises(ValueError, match="weights"):
            PhaseSamples(x, 0 * x, -x, weights=bad)


def test_errors_against_the_flow_vanish_for_an_invariant_dictionary() -> None:
    half = half_step(closed(), slow_manifold(flow=True), 0.2, np.ones(5))
    assert half.kind == "generator" and max(half.errors.values()) < 1e-7 and "misses" in half.reason
    assert half.spectrum is not None and not half.spectrum.spurious().any()
    rough = half_step(linear_part(), slow_manifold(flow=True), 0.2, np.ones(4))
    assert rough.errors["flow"] <= rough.errors["generator"] and rough.errors["flow"] > 0.1


def test_auto_takes_the_flow_where_the_generator_does_not_follow_it() -> None:
    # A stable but wrong derivative: the generator stands still where the flow moves.
    x = np.random.default_rng(0).normal(size=(20, 1))
    samples = PhaseSamples(x, 0 * x, -1e-3 * x, x_half=0.5 * x, dt=0.5)
    half = half_step(Dictionary(ob.Identity(), n_states=1, n_inputs=1), samples, 0.5, np.ones(2))
    assert half.kind == "flow" and "misses 1 of the flow's movement" in half.reason
    assert half.errors["flow"] < 1e-12


def test_equilibria_of_f_are_kept_by_an_exact_half_step_and_lost_ones_are_announced() -> None:
    rng = np.random.default_rng(1)
    x = np.vstack([[[0.0], [1.0], [-1.0]], rng.uniform(-1.5, 1.5, (60, 1))])  # x' = x - x^3 rests at 0, 1 and -1
    samples = PhaseSamples(x, np.zeros_like(x), x - x**3)
    short = Dictionary(ob.Constant(), ob.Identity(), n_states=1, n_inputs=1)
    with pytest.warns(UserWarning, match="moves an equilibrium"):
        half = half_step(short, samples, 1.0, np.ones(3), "generator")
    assert half.drift is not None and half.drift > 0.01
    linear = PhaseSamples(x - 1.0, np.zeros_like(x), -(x - 1.0))
    kept = half_step(short, linear, 1.0, np.ones(3), "generator")
    assert kept.drift is not None and kept.drift < 1e-12
    moving = linear.take(np.arange(4, 30))
    assert equilibrium_drift(short, moving, 1.0, np.ones(3), kept.K) is None


def test_a_fitted_split_says_what_was_spurious_and_what_was_chosen() -> None:
    system = systems.slow_manifold(mu=MU, lam=LAM)
    u = np.random.default_rng(0).normal(size=(60, 1))
    d1 = Episodes([system.simulate([0.3, 0.7], u, 0.05)], [u], dt=0.05)
    fitted = PIEDMDc(linear_part(), alpha=0.0).fit(d1, slow_manifold(flow=True, dt=0.05))
    facts = fitted.lifted.provenance["details"]
    assert facts["half_step"] == "generator" and "misses" in facts["reason"]
    assert len(facts["spurious"]) == 1 and "x2" in facts["spurious"][0]


def test_a_bilinear_dictionary_has_no_half_step() -> None:
    with pytest.raises(ValueError, match="linear in Theta"):
        generator_spectrum(closed().bilinear(), slow_manifold())


def test_samples_that_move_by_less_than_a_millionth_of_a_scale_in_half_a_step_rest() -> None:
    """f = -v on a column of scale one: half a step of 1 s moves it by v / 2."""
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=1)
    for speed, rests in ((1.5e-6, True), (2.5e-6, False)):
        x = np.full((3, 1), 0.4)
        samples = PhaseSamples(x, 0 * x, np.full((3, 1), -speed))
        assert (equilibrium_drift(theta, samples, 1.0, np.ones(2), np.eye(2)) is not None) == rests


def test_the_condition_of_a_half_step_that_loses_a_column_is_infinite_without_a_division() -> None:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    with np.errstate(all="raise"):
        assert _condition(theta, np.diag([1.0, 0.0, 1.0]), PLAIN) == np.inf
        assert _condition(theta, np.diag([1.0, 0.5, 1.0]), PLAIN) == pytest.approx(2.0)
