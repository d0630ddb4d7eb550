"""Noise on the states pulls eigenvalues toward zero; instrumental variables take the pull away."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from pisplit import BilinearEDMDc, Dictionary, Episodes, LinearEDMDc, modes
from pisplit import observables as ob
from pisplit.estimators.instruments import instrumented_moments
from pisplit.splitting import pair_moments

Array = NDArray[np.float64]


def rotation(radius: float, angle: float) -> Array:
    return radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def oscillator(seed: int = 1, episodes: int = 20, steps: int = 200) -> Episodes:
    """A slowly decaying oscillator (radius 0.995) that small inputs move."""
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(episodes):
        x, u = np.zeros((steps + 1, 2)), 0.05 * rng.normal(size=(steps, 1))
        x[0] = rng.normal(size=2)
        for k in range(steps):
            x[k + 1] = rotation(0.995, 0.2) @ x[k] + np.array([0.0, 1.0]) * u[k]
        xs.append(x)
        us.append(u)
    return Episodes(xs, us, 0.1)


def three_modes(seed: int = 1) -> Episodes:
    """Radii 0.98, 0.95 and 0.99 in mixed coordinates, moved by two inputs; every state has the spread 1."""
    a = scipy.linalg.block_diag(rotation(0.98, 0.3), rotation(0.95, 0.8), [[0.99]])
    mixing = np.random.default_rng(5).normal(size=(5, 5))
    a, b = mixing @ a @ np.linalg.inv(mixing), np.random.default_rng(6).normal(size=(5, 2))
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(20):
        x, u = np.zeros((401, 5)), rng.normal(size=(400, 2))
        for k in range(400):
            x[k + 1] = a @ x[k] + b @ u[k]
        xs.append(x)
        us.append(u)
    spread = np.concatenate(xs).std(axis=0)
    return Episodes([x / spread for x in xs], us, 0.1)


def noisy(data: Episodes, size: float, seed: int = 2) -> Episodes:
    rng = np.random.default_rng(seed)
    return Episodes([x + size * rng.normal(size=x.shape) for x in data.xs], data.us, data.dt)


def plain(n: int, m: int, *more: ob.Observable) -> Dictionary:
    return Dictionary(ob.Constant(), ob.Identity(), *more, n_states=n, n_inputs=m)


def radii(estimator: LinearEDMDc, data: Episodes, count: int) -> Array:
    """Largest magnitudes of eigenvalues, the constant's left out."""
    values = np.abs(modes(estimator.fit(data).lifted).eigenvalues)
    return np.sort(np.delete(values, np.argmin(np.abs(values - 1.0))))[::-1][:count]


@pytest.mark.parametrize("size", [0.05, 0.1, 0.2])
def test_a_noisy_oscillator_keeps_its_eigenvalue(size: float) -> None:
    data = noisy(oscillator(), size)
    biased = radii(LinearEDMDc(plain(2, 1)), data, 1)[0]
    assert biased < 0.995 - 1.2 * size**2  # least squares loses the share of the noise in the variance
    assert abs(radii(LinearEDMDc(plain(2, 1), instruments=3), data, 1)[0] - 0.995) < 0.002


def test_every_mode_of_a_system_with_inputs_keeps_its_eigenvalue() -> None:
    data, truth = noisy(three_modes(), 0.1), [0.99, 0.98, 0.98, 0.95, 0.95]
    assert np.abs(radii(LinearEDMDc(plain(5, 2)), data, 5) - truth).max() > 0.1
    assert np.abs(radii(LinearEDMDc(plain(5, 2), instruments=3), data, 5) - truth).max() < 0.005


def test_delays_and_penalties_work_on_instruments_too() -> None:
    data = noisy(oscillator(), 0.1)
    late = plain(2, 1, ob.Delays(1, 1))
    with_delays = modes(LinearEDMDc(late, alpha=1e-8, instruments=3).fit(data).lifted).eigenvalues
    assert np.abs(np.abs(with_delays) - 0.995).min() < 0.002
    assert abs(radii(LinearEDMDc(plain(2, 1), alpha=1e-6, penalty="lasso", instruments=3), data, 1)[0] - 0.995) < 0.002
    chosen = LinearEDMDc(plain(2, 1), alpha="cv", alphas=[1e-8, 1e-6], instruments=3)
    assert abs(radii(chosen, data, 1)[0] - 0.995) < 0.002


def test_products_with_inputs_are_instrumented() -> None:
    rng, xs, us = np.random.default_rng(3), [], []
    for _ in range(20):
        x, u = np.zeros((201, 1)), rng.choice([-1.0, 1.0], size=(200, 1))
        x[0] = 2.0
        for k in range(200):
            x[k + 1] = (0.9 + 0.05 * u[k]) * x[k] + 0.2 * u[k]
        xs.append(x)
        us.append(u)
    data = noisy(Episodes(xs, us, 0.1), 0.2)
    found = BilinearEDMDc(plain(1, 1), instruments=3).fit(data).lifted
    biased = BilinearEDMDc(plain(1, 1)).fit(data).lifted
    assert found.N is not None and biased.N is not None
    assert abs(found.A[1, 1] - 0.9) < 0.01 < abs(biased.A[1, 1] - 0.9)
    assert abs(found.N[0, 1, 1] - 0.05) < 0.01


def test_without_noise_nothing_changes() -> None:
    clean = oscillator(episodes=3, steps=60)
    plainly, by_past = (LinearEDMDc(plain(2, 1), instruments=k).fit(clean).lifted for k in (0, 3))
    np.testing.assert_allclose(by_past.A, plainly.A, atol=1e-10)
    np.testing.assert_allclose(by_past.B, plainly.B, atol=1e-10)


def test_projected_moments_are_those_of_projected_rows() -> None:
    """Two-stage least squares written out: W (W^T W)^-1 W^T of all rows."""
    data = noisy(oscillator(episodes=2, steps=50), 0.3)
    theta, pairs = plain(2, 1).named_after(data), data.pairs()
    late = pairs.take(pairs.index >= 2)
    row, step = late.row, late.input_row
    w = np.hstack([np.ones((len(late), 1)), *(late.inputs[step - j] for j in range(3))])
    w = np.hstack([w, *(late.states[row - j] for j in (1, 2))])
    both = np.hstack([theta.evaluate(late), theta.next_learned(late)])
    q, _ = np.linalg.qr(w)
    expected = q @ (q.T @ both)
    found = instrumented_moments(theta, pairs, 2)
    rows = found.rows(centred=False)
    np.testing.assert_allclose(rows.T @ rows, expected.T @ expected, atol=1e-9)
    assert found.n_samples == len(late) < pair_moments(theta, pairs).n_samples


def test_episodes_too_short_for_instruments_are_refused() -> None:
    with pytest.raises(ValueError, match="instruments = 9 with 0 delays needs 10 steps"):
        LinearEDMDc(plain(2, 1), instruments=9).fit(oscillator(episodes=2, steps=8))
    with pytest.raises(ValueError, match="instruments = -1"):
        LinearEDMDc(plain(2, 1), instruments=-1)
