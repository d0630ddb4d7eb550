"""Systems inside the span of the dictionary are found and rolled out exactly."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.evaluation.rollouts import rollout_errors

RNG = np.random.default_rng(3)


def integrator(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """x+ = x + u: a model that uses an input twice, or one step late, cannot follow it."""
    u = RNG.normal(size=(steps, 1))
    return np.vstack([np.zeros((1, 1)), np.cumsum(u, axis=0)]), u


def autoregression(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """x_{k+1} = 1.6 x_k - 0.9 x_{k-1} + u_k + 0.5 u_{k-1}."""
    u, x = RNG.normal(size=(steps, 1)), np.zeros((steps + 1, 1))
    x[:2] = RNG.normal(size=(2, 1))
    for k in range(1, steps):
        x[k + 1] = 1.6 * x[k] - 0.9 * x[k - 1] + u[k] + 0.5 * u[k - 1]
    return x, u


def test_an_exact_integrator_rolls_out_exactly() -> None:
    x, u = integrator(50)
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(Episodes([x], [u], dt=1.0))
    test_x, test_u = integrator(1000)
    np.testing.assert_allclose(model.predict(test_x[0], test_u), test_x, atol=1e-10)


def test_an_exact_ar2_rolls_out_exactly() -> None:
    x, u = autoregression(60)
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta).fit(Episodes([x], [u], dt=1.0))
    test_x, test_u = autoregression(400)
    start = Episodes([test_x], [test_u], dt=1.0).start(0, 1)
    predicted = model.predict((start.x_history, start.u_history), start.inputs)
    np.testing.assert_allclose(predicted, test_x[1:], atol=1e-10)


def test_state_delays_alone_need_only_past_states() -> None:
    x = np.zeros((41, 1))
    x[:2] = [[1.0], [0.7]]
    for k in range(1, 40):
        x[k + 1] = 1.2 * x[k] - 0.8 * x[k - 1]
    theta = Dictionary(ob.Identity(), ob.Delays(states=1), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta).fit(Episodes([x], [np.zeros((40, 1))], dt=1.0))
    np.testing.assert_allclose(model.predict(x[:2], np.zeros((39, 1))), x[1:], atol=1e-10)


def test_an_affine_system_needs_the_constant_and_is_then_exact_under_any_ridge_of_its_mean() -> None:
    x, u = integrator(30)
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=1, n_inputs=1)
    shifted = LinearEDMDc(theta, alpha=1e-3).fit(Episodes([x + 100.0], [u], dt=1.0))
    plain = LinearEDMDc(theta, alpha=1e-3).fit(Episodes([x], [u], dt=1.0))
    # The constant carries no penalty, so a shift of the state changes nothing but the constant.
    np.testing.assert_allclose(shifted.K_[:, 1:], plain.K_[:, 1:], atol=1e-10)


def test_drawn_pairs_and_blocks_give_the_same_answer_as_all_pairs_when_the_system_is_exact() -> None:
    data = [autoregression(30) for _ in range(4)]
    d1 = Episodes([x for x, _ in data], [u for _, u in data], dt=1.0)
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), n_states=1, n_inputs=1)
    everything, few = (LinearEDMDc(theta).fit(d1, pairs=p) for p in (None, d1.pairs(1).sample(12, seed=0)))
    np.testing.assert_allclose(few.K_, everything.K_, atol=1e-9)


def test_units_of_the_states_do_not_change_a_regularised_model() -> None:
    data = [autoregression(30) for _ in range(3)]
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=1)
    metres = LinearEDMDc(theta, alpha=1e-2).fit(Episodes([x for x, _ in data], [u for _, u in data], 1.0))
    millimetres = LinearEDMDc(theta, alpha=1e-2).fit(Episodes([1e3 * x for x, _ in data], [u for _, u in data], 1.0))
    np.testing.assert_allclose(millimetres.lifted.A, metres.lifted.A, atol=1e-12)
    np.testing.assert_allclose(millimetres.lifted.B, 1e3 * metres.lifted.B, atol=1e-9)


def test_states_that_are_no_columns_are_regressed() -> None:
    x = 0.5 + RNG.normal(size=(200, 1))
    cubes = ob.Expression(lambda x, u: (x[0] - 1.0) / 2.0, name="half")
    theta = Dictionary(cubes, ob.Inputs(), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta).fit(Episodes([x], [np.zeros((199, 1))], dt=1.0))
    lifted = model.lifted
    np.testing.assert_allclose(lifted.read(lifted.lift(x[3])), x[3], atol=1e-10)


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
def test_alpha_is_chosen_on_held_out_training_episodes(penalty: str) -> None:
    data = [autoregression(40) for _ in range(6)]
    d1 = Episodes([x + 0.05 * RNG.normal(size=x.shape) for x, _ in data], [u for _, u in data], dt=1.0)
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta, alpha="cv", penalty=penalty).fit(d1)
    search = model.cv_
    assert search is not None and search.held_out == (0, 1, 2, 3, 4, 5)
    assert search.errors[list(search.alphas).index(search.chosen)] == search.errors.min()
    assert model.alpha_ == search.chosen
    one = LinearEDMDc(theta, alpha="cv", penalty=penalty).fit(d1[0]).cv_
    assert one is not None and np.isfinite(one.errors).any()


def test_pairs_of_held_out_episodes_are_avoided_where_possible() -> None:
    data = [integrator(20) for _ in range(5)]
    d1 = Episodes([x for x, _ in data], [u for _, u in data], dt=1.0)
    pairs = d1.pairs()
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1), alpha="cv")
    model.fit(d1, pairs=pairs.take(pairs.episode != 2))
    assert model.cv_ is not None and model.cv_.held_out == (0, 1, 2, 3, 4)
    once = LinearEDMDc(model.theta, alpha="cv", cv_folds=1).fit(d1, pairs=pairs.take(pairs.episode != 2))
    assert once.cv_ is not None and once.cv_.held_out == (2,)


def test_fitting_and_predicting_change_no_argument() -> None:
    x, u = autoregression(30)
    d1 = Episodes([x], [u], dt=1.0)
    theta = Dictionary(ob.Identity(), ob.Delays(states=1, inputs=1), n_states=1, n_inputs=1)
    model = LinearEDMDc(theta, alpha="cv")
    before = x.copy(), u.copy(), dict(model.get_params())
    history, inputs = (x[:2].copy(), u[:1].copy()), u[1:].copy()
    copies = history[0].copy(), history[1].copy(), inputs.copy()
    model.fit(d1)
    model.predict(history, inputs)
    model.score(d1)
    for a, b in zip((x, u, *history, inputs), (*before[:2], *copies), strict=True):
        np.testing.assert_array_equal(a, b)
    assert model.get_params() == before[2]


def test_scores_pool_all_steps_and_flag_divergence() -> None:
    x, u = integrator(30)
    d1 = Episodes([x, x[:11]], [u, u[:10]], dt=1.0, outputs={"tip": (0,)})
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(d1)
    score = model.score(d1, states="tip")
    assert [len(s) for s in score.squared] == [30, 10]
    assert score.median < 1e-20 and score.diverged_fraction == 0
    growing = Episodes([2.0 ** np.arange(60.0)[:, None]], [np.zeros((59, 1))], dt=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unstable = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(
            Episodes([growing.xs[0][:5]], [growing.us[0][:4]], dt=1.0)
        )
        errors = rollout_errors(unstable.lifted, growing)
    assert errors.diverged_fraction == 1 and np.isinf(errors.squared[0][-1]) and "100 % diverged" in str(errors)
    with pytest.warns(UserWarning, match="diverged at step"):
        assert np.isfinite(unstable.predict([1.0], np.zeros((2000, 1)))).all()


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda m, d: LinearEDMDc(m.theta, penalty="elastic"), "penalty"),
        (lambda m, d: LinearEDMDc(m.theta, alpha=-1.0).fit(d), "alpha"),
        (lambda m, d: LinearEDMDc(m.theta, alpha="best").fit(d), "alpha"),
        (lambda m, d: LinearEDMDc(m.theta).predict([0.0], [[0.0]]), "call fit first"),
        (lambda m, d: m.fit([1]), "expected Episodes"),
        (lambda m, d: m.fit(d, pairs=Episodes([np.zeros((3, 1))], [np.zeros((2, 1))], 1.0).pairs()), "not from these"),
        (lambda m, d: m.predict([0.0, 1.0], [[0.0]]), "x_history"),
        (lambda m, d: m.predict([0.0], [[0.0, 1.0]]), "U has shape"),
        (lambda m, d: m.predict([np.nan], [[0.0]]), "NaN"),
        (lambda m, d: m.score(Episodes([np.zeros((3, 2))], [np.zeros((2, 1))], 1.0)), "2 states"),
        (lambda m, d: m.score(Episodes([np.zeros((3, 1))], [np.zeros((2, 1))], 0.5)), "dt"),
        (lambda m, d: m.score(d, states="nose"), "output group"),
    ],
)
def test_misuse_is_refused_in_one_line(use: Any, message: str) -> None:
    x, u = integrator(10)
    d1 = Episodes([x], [u], dt=1.0)
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1)).fit(d1)
    with pytest.raises(ValueError, match=message) as error:
        use(model, d1)
    assert "\n" not in str(error.value)
