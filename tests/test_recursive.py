"""Streaming regression equals the batch answer; limited spectral radii."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.estimators.streaming import StreamingEDMDc
from pisplit.lifted.radius import limited_radius, stabilised
from pisplit.regression import lasso, least_squares, ridge
from pisplit.regression.recursive import RecursiveRegression

RNG = np.random.default_rng(0)
A, Y = RNG.normal(size=(120, 6)) * np.logspace(0, -5, 6), RNG.normal(size=(120, 3))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=8))
def test_any_partition_gives_the_batch_answer(lengths: list[int]) -> None:
    stream, at = RecursiveRegression(6, 3), 0
    for length in lengths:
        stream.update(A[at : at + length], Y[at : at + length])
        at = min(at + length, 120)
        if at == 120:
            break
    batch = least_squares(A[:at], Y[:at]).K
    np.testing.assert_allclose(stream.solve().K, batch, atol=1e-9 * np.abs(batch).max())


def test_every_penalty_equals_its_batch_answer() -> None:
    stream = RecursiveRegression(6, 3)
    for a, y in zip(A, Y, strict=True):
        stream.update(a, y)
    prior = RNG.normal(size=(3, 6))
    np.testing.assert_allclose(stream.solve(0.3, prior=prior).K, ridge(A, Y, 0.3, prior).K, atol=1e-10)
    np.testing.assert_allclose(stream.solve(2.0, "lasso").K, lasso(A, Y, 2.0).K, atol=1e-9)
    assert stream.n_samples == 120 and len(stream.rows[0]) == 9


def test_forgetting_weights_samples_by_their_age() -> None:
    stream = RecursiveRegression(6, 3, forgetting=0.9)
    stream.update(A[:50], Y[:50])
    for a, y in zip(A[50:], Y[50:], strict=True):
        stream.update(a, y)
    weight = np.sqrt(0.9 ** np.arange(119, -1, -1.0))[:, None]
    batch = least_squares(weight * A, weight * Y).K
    np.testing.assert_allclose(stream.solve().K, batch, rtol=1e-6, atol=1e-9 * np.abs(batch).max())
    assert stream.effective_samples == pytest.approx((weight**2).sum())


def test_a_changed_system_is_followed() -> None:
    old, new = RNG.normal(size=(2, 1, 6))
    a = RNG.normal(size=(400, 6))
    y = np.vstack([a[:200] @ old.T, a[200:] @ new.T])
    np.testing.assert_allclose(RecursiveRegression(6, 1, 0.8).update(a, y).solve().K, new, atol=1e-8)
    assert np.abs(RecursiveRegression(6, 1).update(a, y).solve().K - new).max() > 0.1


def test_long_streams_do_not_lose_accuracy() -> None:
    k = np.array([[1.0, -2.0]])
    stream = RecursiveRegression(2, 1, forgetting=0.99)
    for _ in range(3000):
        a = RNG.normal() + 1e-6 * RNG.normal(size=2)  # nearly collinear: a covariance update would have blown up
        stream.update(a, k @ a)
    np.testing.assert_allclose(stream.solve().K, k, atol=1e-6)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: RecursiveRegression(0, 1), "columns"),
        (lambda: RecursiveRegression(2, 1, 1.1), "forgetting"),
        (lambda: RecursiveRegression(2, 1, 0.0), "forgetting"),
        (lambda: RecursiveRegression(2, 1).solve(), "no samples"),
        (lambda: RecursiveRegression(2, 1).update([1.0], [1.0]), "a has shape"),
        (lambda: RecursiveRegression(2, 1).update([1.0, np.nan], [1.0]), "a has 1 NaN"),
        (lambda: limited_radius(np.eye(2), 0.0), "bound"),
    ],
)
def test_bad_streams_are_refused_in_one_line(build: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


def test_radii_are_limited_and_stable_modes_stay() -> None:
    values = np.array([1.3, 0.5, 0.2, 1.1 * np.exp(0.4j), 1.1 * np.exp(-0.4j)])
    block = 1.1 * np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    diagonal = np.zeros((5, 5))
    diagonal[:3, :3], diagonal[3:, 3:] = np.diag(values[:3].real), block
    mixing = RNG.normal(size=(5, 5))
    a = mixing @ diagonal @ np.linalg.inv(mixing)
    found = limited_radius(a, 1.0)
    expected = values / np.maximum(np.abs(values), 1.0)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(found)), np.sort_complex(expected), atol=1e-9)
    inside = mixing[:, 1:3]  # motions in the modes 0.5 and 0.2
    np.testing.assert_allclose(found @ inside, a @ inside, atol=1e-10)
    assert np.array_equal(limited_radius(a, 1.31), a)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(limited_radius(a, 0.9))).max(), 0.9, atol=1e-9)


def test_a_stabilised_model_does_not_diverge() -> None:
    u = RNG.normal(size=(30, 1))
    x = np.zeros((31, 1))
    for k in range(30):
        x[k + 1] = 1.2 * x[k] + u[k]
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(Episodes([x], [u], 0.1)).lifted
    long = np.zeros((100, 1))
    assert model.rollout(np.ones(1), long).x[-1, 0] > 1e4
    held = stabilised(replace(model, state_range=np.ones(1)), 1.0)
    assert abs(held.rollout(np.ones(1), long).x[-1, 0]) == pytest.approx(1.0)
    assert held.provenance["spectral_radius_bound"] == 1.0


def rotating(angle: float, seed: int, steps: int = 60) -> Episodes:
    rng = np.random.default_rng(seed)
    a = 0.95 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    u, x = rng.normal(size=(steps, 1)), np.zeros((steps + 1, 2))
    for k in range(steps):
        x[k + 1] = a @ x[k] + np.array([0.0, 1.0]) * u[k]
    return Episodes([x], [u], 0.1)


THETA = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(states=1, inputs=1), n_states=2, n_inputs=1)


def test_a_streaming_model_equals_the_batch_model() -> None:
    noisy = [rotating(0.3, seed) for seed in range(4)]
    rng = np.random.default_rng(9)
    noisy = [Episodes([e.xs[0] + 0.1 * rng.normal(size=e.xs[0].shape)], e.us, 0.1) for e in noisy]
    stream = StreamingEDMDc(THETA)
    for episode in noisy:
        stream.update(episode)
    batch = LinearEDMDc(THETA).fit(Episodes([e.xs[0] for e in noisy], [e.us[0] for e in noisy], 0.1)).lifted
    np.testing.assert_allclose(stream.lifted.A, batch.A, atol=1e-9)
    np.testing.assert_allclose(stream.lifted.B, batch.B, atol=1e-9)
    assert stream.lifted.provenance["pairs"] == 4 * 59


def test_a_streaming_estimator_is_an_estimator() -> None:
    data = rotating(0.3, 1)
    stream, batch = StreamingEDMDc(THETA, alpha=1e-9), LinearEDMDc(THETA, alpha=1e-9).fit(data)
    with pytest.raises(ValueError, match="no data"):
        stream.score(data)
    assert stream.fit(data) is stream and stream.fit(data).lifted.provenance["pairs"] == 59  # fit begins anew
    assert stream.score(data).median == pytest.approx(batch.score(data).median, abs=1e-12)
    start = data.start(0, THETA.n_delays)
    history = (start.x_history, start.u_history) if THETA.n_delays else data.xs[0][0]
    np.testing.assert_allclose(stream.predict(history, start.inputs), batch.predict(history, start.inputs), atol=1e-7)
    assert stream.get_params() == {"theta": THETA, "forgetting": 1.0, "alpha": 1e-9}
    assert stream.set_params(forgetting=0.5).fit(data).lifted.provenance["forgetting"] == 0.5
    drawn = data.pairs(THETA.n_delays).sample(20, seed=0)
    assert stream.fit(data, pairs=drawn).lifted.provenance["pairs"] == 20
    for wrong, message in (
        ({"alpha": -1.0}, "alpha"),
        ({"forgetting": 2.0}, "forgetting"),
        ({"penalty": 1}, "no option"),
    ):
        with pytest.raises(ValueError, match=message):
            stream.set_params(**wrong)
    with pytest.raises(ValueError, match="expected Episodes"):
        stream.update(data.xs[0])  # type: ignore[arg-type]


def test_a_forgetting_model_follows_a_robot_that_changes() -> None:
    plain = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    stream = StreamingEDMDc(plain, forgetting=0.8, alpha=1e-10)
    for angle in (0.3, 0.5):
        stream.update(rotating(angle, 1, 150))
        found = np.angle(np.linalg.eigvals(stream.lifted.A)).max()
        assert found == pytest.approx(angle, abs=1e-5)
    with pytest.raises(ValueError, match="no data"):
        _ = StreamingEDMDc(plain).lifted
    with pytest.raises(ValueError, match=r"new episodes have dt = 0.2 s, those before 0.1 s"):
        stream.update(Episodes([np.zeros((3, 2))], [np.zeros((2, 1))], 0.2))
