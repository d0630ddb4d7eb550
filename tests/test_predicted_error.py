"""Predicted errors against true ones, of models whose faults are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc, predicted_error, rollout_errors
from pisplit import observables as ob

A = np.array([[0.92, 0.25], [-0.25, 0.92]])
B = np.array([[0.02], [0.1]])


def recorded(seed: int, cubic: float = 0.0, noise: float = 0.0, episodes: int = 12, steps: int = 80) -> Episodes:
    """A lightly damped oscillator under smooth random commands, with a spring that hardens."""
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(episodes):
        knots = rng.normal(size=steps // 8 + 2)
        u = np.interp(np.arange(steps) / 8.0, np.arange(len(knots)), knots)[:, None]
        x = [rng.normal(size=2) * 0.3]
        for k in range(steps):
            x.append(A @ x[-1] + B @ u[k] - np.array([0.0, cubic * x[-1][0] ** 3]))
        xs.append(np.array(x) + noise * rng.normal(size=(steps + 1, 2)))
        us.append(u)
    return Episodes(xs, us, dt=0.05)


def exact() -> LiftedModel:
    theta = Dictionary(ob.Constant(), ob.States(), ob.Inputs(), n_states=2, n_inputs=1)
    return LinearEDMDc(theta).fit(recorded(0)).lifted


def faulty(what: str) -> LiftedModel:
    model = exact()
    rows = list(model.column_names)
    a, b, c = np.array(model.A), np.array(model.B), np.array(model.c)
    x1, x2 = rows.index("x1"), rows.index("x2")
    if what == "gain":
        b[:] *= 1.2
    if what == "offset":
        c[x2] += 0.02
    if what == "stiffness":
        a[x2, x1] *= 1.15
    if what == "damping":
        a[[x1, x2], [x1, x2]] *= 0.95
    return replace(model, A=a, B=b, c=c)


@pytest.mark.parametrize("what", ["gain", "offset", "stiffness", "damping"])
def test_the_error_of_a_wrong_number_is_predicted_within_a_factor_of_three(what: str) -> None:
    model = faulty(what)
    true = rollout_errors(model, recorded(1)).median
    found = predicted_error(model, recorded(2))
    assert true > 1e-5
    assert true / 3.0 < found.median < 3.0 * true, (true, found.median)


def test_the_error_of_a_missing_term_is_predicted_within_a_factor_of_three() -> None:
    theta = Dictionary(ob.Constant(), ob.States(), ob.Inputs(), n_states=2, n_inputs=1)
    model = LinearEDMDc(theta).fit(recorded(0, cubic=0.05))
    true = rollout_errors(model, recorded(1, cubic=0.05)).median
    found = predicted_error(model, recorded(2, cubic=0.05)).median
    assert true / 3.0 < found < 3.0 * true, (true, found)


def test_few_pairs_give_the_same_order() -> None:
    model, d1 = faulty("gain"), recorded(2)
    true = rollout_errors(model, recorded(1)).median
    found = predicted_error(model, d1, pairs=d1.pairs().sample(64, 0)).median
    assert true / 4.0 < found < 4.0 * true, (true, found)


def test_an_exact_model_is_believed() -> None:
    assert predicted_error(exact(), recorded(2)).median < 1e-20


def test_it_grows_with_the_horizon_and_counts_the_states_that_are_asked_for() -> None:
    model, d1 = faulty("gain"), recorded(2)
    found = predicted_error(model, d1)
    assert found.squared.shape == (12, 80)
    assert found.by_horizon[0] < 0.1 * found.by_horizon[-20:].mean()
    parts = [predicted_error(model, d1, states=[name]) for name in ("x1", "x2")]
    own = [part.squared / part.scale for part in parts]
    np.testing.assert_allclose(own[0] + own[1], found.squared / found.scale, rtol=1e-12)
    assert "predicted squared error" in str(found)


def test_one_step_ahead_it_is_the_residual_of_the_nearest_pair() -> None:
    model, d1 = faulty("offset"), recorded(2)
    found = predicted_error(model, d1, excitation=d1.us[0][None, :3])
    np.testing.assert_allclose(found.squared[:, 0], 0.02**2, rtol=1e-9)


def test_what_came_true_under_the_recorded_commands_corrects_the_estimate() -> None:
    """Residuals of other recordings say all where they are the same everywhere, and nothing where they are noise."""
    assert predicted_error(faulty("offset"), recorded(2)).scale == pytest.approx(1.0, rel=1e-6)
    assert predicted_error(faulty("gain"), recorded(2, episodes=1)).scale == 1.0  # nothing to hold it against
    noisy = recorded(2, noise=0.05)
    found = predicted_error(exact(), noisy)
    true = rollout_errors(exact(), noisy).median  # with the noise of what it is compared with
    assert true / 2.0 < found.median < 2.0 * true
    assert not true / 2.0 < found.median / found.scale < 2.0 * true


def test_delays_take_part() -> None:
    theta = Dictionary(ob.Constant(), ob.States(), ob.Inputs(), ob.Delays(states=2, inputs=1), n_states=2, n_inputs=1)
    model = LinearEDMDc(theta).fit(recorded(0, cubic=0.05))
    true = rollout_errors(model, recorded(1, cubic=0.05)).median
    found = predicted_error(model, recorded(2, cubic=0.05)).median
    assert true / 3.0 < found < 3.0 * true, (true, found)


def test_a_model_that_diverges_is_infinitely_wrong() -> None:
    model = exact()
    a = np.array(model.A)
    a[1:3, 1:3] *= 1.5
    assert predicted_error(replace(model, A=a), recorded(2)).median == np.inf


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="excitation"):
        predicted_error(exact(), recorded(2), excitation=np.zeros((2, 5, 3)))
    with pytest.raises(ValueError, match="other data"):
        predicted_error(exact(), recorded(2), pairs=recorded(3).pairs())
