"""Residuals of eigenpairs of fitted models: true ones, products of them, and those that only a dictionary made."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, ReliftedEDMDc, model_spectrum
from pisplit import observables as ob

RADIUS, ANGLE, DT = 0.98, 0.2, 0.1
TRUE = RADIUS * np.exp(1j * ANGLE)


def oscillator(episodes: int, seed: int, noise: float = 0.0, push: float = 0.05) -> Episodes:
    """A damped oscillator, pushed at random."""
    rng = np.random.default_rng(seed)
    turn = RADIUS * np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
    xs, us = [], []
    for _ in range(episodes):
        x, u = np.zeros((81, 2)), push * rng.normal(size=(80, 1))
        x[0] = rng.normal(size=2)
        for k in range(80):
            x[k + 1] = turn @ x[k] + np.array([0.0, 1.0]) * u[k]
        xs.append(x + noise * rng.normal(size=x.shape))
        us.append(u)
    return Episodes(xs, us, DT, state_names=["a", "b"])


def near(values: np.ndarray, wanted: complex) -> int:
    """Position of the eigenvalue next to the one that is ``wanted``."""
    assert np.abs(values - wanted).min() < 1e-6
    return int(np.abs(values - wanted).argmin())


def test_eigenvalues_of_the_system_are_told_from_those_of_the_dictionary() -> None:
    d1, test = oscillator(12, 0), oscillator(4, 1)
    centres = ob.Radial.from_data(d1.stacked_states(), 20)
    theta = Dictionary(ob.Constant(), ob.States(), centres, ob.Inputs(), n_states=2, n_inputs=1)
    found = model_spectrum(LinearEDMDc(theta).fit(d1), test)
    true = [near(found.eigenvalues, value) for value in (TRUE, TRUE.conjugate())]
    constant = near(found.eigenvalues, 1.0)
    assert found.residuals[[*true, constant]].max() < 1e-8
    others = np.setdiff1d(np.arange(len(found.residuals)), [*true, constant])
    assert len(others) == 20 and found.residuals[others].min() > 0.05
    assert found.spurious(0.05).sum() == 20 and np.all(np.diff(found.residuals) >= 0.0)
    rate = np.log(TRUE) / DT
    assert f"{rate.imag / (2.0 * np.pi):.3g} Hz, time constant {-1.0 / rate.real:.3g} s" in found.report(0.05)
    assert found.plot().axes


def test_products_of_eigenfunctions_are_some_where_nothing_pushes() -> None:
    d1, test = oscillator(6, 0, push=0.0), oscillator(2, 1, push=0.0)
    theta = Dictionary(ob.Constant(), ob.States(), ob.Polynomials(2), ob.Inputs(), n_states=2, n_inputs=1)
    found = model_spectrum(LinearEDMDc(theta).fit(d1), test)
    for wanted in (TRUE, TRUE**2, abs(TRUE) ** 2):
        assert found.residuals[near(found.eigenvalues, wanted)] < 1e-10


def test_a_residual_is_how_far_the_function_is_from_moving_so() -> None:
    d1, test = oscillator(6, 0, 0.02), oscillator(3, 1, 0.02)
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), ob.Bilinear(), n_states=2, n_inputs=1)
    model = BilinearEDMDc(theta, alpha=1e-6).fit(d1).lifted
    found, pairs = model_spectrum(model, test), test.pairs(1)
    k = int(np.argmax(np.abs(found.eigenvalues)))
    w, phi, missed = found.functions[k], [], []
    np.testing.assert_allclose(w @ model.A, found.eigenvalues[k] * w, atol=1e-10)
    for x, u in zip(test.xs, test.us, strict=True):
        for t in range(1, len(u)):
            z, after = model.lift(x[t - 1 : t + 1], u[t - 1 : t]), model.lift(x[t : t + 2], u[t : t + 1])
            pushed = w @ (model.step(z, u[t]) - model.A @ z)
            phi.append(w @ z)
            missed.append(w @ after - found.eigenvalues[k] * (w @ z) - pushed)
    assert len(phi) == found.pairs == len(pairs)
    assert found.residuals[k] == pytest.approx(np.sqrt(np.mean(np.abs(missed) ** 2)) / np.std(phi), rel=1e-8)
    assert 1e-3 < found.residuals[k] < 0.1  # noise


def test_a_step_that_is_not_linear_is_refused() -> None:
    d1 = oscillator(6, 0)
    relifted = ReliftedEDMDc((2,), (2,), (2,), (1e-8,)).fit(d1)
    with pytest.raises(ValueError, match="re-lifted"):
        model_spectrum(relifted, d1)
