"""Errors of roll-outs: by horizon, over the amount of data, of several models."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc, StreamingEDMDc, TwinEDMDc
from pisplit import observables as ob
from pisplit.evaluation.comparison import compare, learning_curve
from pisplit.evaluation.horizon import horizon_errors
from pisplit.evaluation.rollouts import rollout_errors
from pisplit.models import systems

Array = NDArray[np.float64]
A, B = np.array([[0.95, 0.1], [-0.1, 0.95]]), np.array([[0.0], [0.1]])


def episodes(count: int = 6, steps: int = 40, seed: int = 0, growth: float = 1.0) -> Episodes:
    rng = np.random.default_rng(seed)
    xs, us = [], []
    for _ in range(count):
        u, x = rng.normal(size=(steps, 1)), np.empty((steps + 1, 2))
        x[0] = rng.normal(size=2)
        for k in range(steps):
            x[k + 1] = growth * A @ x[k] + B @ u[k]
        xs.append(x)
        us.append(u)
    return Episodes(xs, us, 0.1, state_names=("p", "q"), units=("m", "m/s"))


def plain_scalar() -> LinearEDMDc:
    return LinearEDMDc(Dictionary(ob.Identity(), n_states=1, n_inputs=1))


def plain(alpha: float = 0.0) -> LinearEDMDc:
    return LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), alpha=alpha)


def test_errors_by_horizon_are_those_of_a_wrong_model_in_closed_form() -> None:
    data = episodes()
    model = plain().fit(data).lifted
    exact = horizon_errors(model, data, [1, 5, 20])
    assert exact.normalised.max() < 1e-12 and exact.starts == 6 * 21 and exact.units == ("m", "m/s")
    shifted = replace(model, c=np.array([0.1, 0.0]))
    found = horizon_errors(shifted, data, [3, 1], stride=4)
    power = [np.array([0.1, 0.0]), sum(np.linalg.matrix_power(A, k) for k in range(3)) @ np.array([0.1, 0.0])]
    np.testing.assert_array_equal(found.horizons, [1, 3])
    np.testing.assert_allclose(found.rms, np.abs(power), atol=1e-12)
    spread = data.stacked_states().std(axis=0)
    np.testing.assert_allclose(found.normalised, np.sqrt(((np.abs(power) / spread) ** 2).mean(axis=1)), atol=1e-12)
    assert horizon_errors(shifted, data, [1], states=["q"]).names == ("q",)


def test_divergence_is_infinite_not_large() -> None:
    data = episodes()
    model = plain().fit(data).lifted
    wild = replace(model, A=30.0 * np.eye(2))
    found = horizon_errors(wild, data, [1, 30])
    assert np.isfinite(found.rms[0]).all() and np.isinf(found.rms[1]).all()
    np.testing.assert_array_equal(found.diverged, [0.0, 1.0])
    table = compare({"good": model, "wild": wild}, data, horizons=[1, 30])
    assert "100.0 %" in str(table) and "inf" in str(table)
    figures = json.loads(json.dumps(table.as_dict(), allow_nan=False))
    assert figures["wild"]["diverged"] == 1.0 and figures["wild"]["normalised"]["30"] is None
    assert figures["good"]["median"] < 1e-20 and figures["good"]["diverged"] == 0.0


def test_estimators_and_their_models_compare_alike() -> None:
    data = episodes()
    estimator = plain(1e-2).fit(data)
    table = compare({"estimator": estimator, "model": estimator.lifted}, data, states=["p"]).as_dict()
    assert table["estimator"] == table["model"] and "normalised" not in table["model"]
    with pytest.raises(ValueError, match="'new' is not fitted"):
        compare({"new": plain()}, data)


def test_learning_curves_have_quartiles_over_seeds_and_leave_the_estimators_alone() -> None:
    data, test = episodes(), episodes(seed=9)
    noisy = Episodes([x + 0.02 * np.random.default_rng(1).normal(size=x.shape) for x in data.xs], data.us, 0.1)
    estimators = {"least squares": plain(), "ridge": plain(1e-2)}
    curve = learning_curve(estimators, noisy, test, [8, 200], seeds=range(5))
    assert not hasattr(estimators["ridge"], "lifted")
    errors = curve.errors["least squares"]
    assert errors.shape == (2, 5) and len(set(errors[0])) == 5
    assert curve.quantile("least squares", 0.5)[1] < curve.quantile("least squares", 0.5)[0]
    assert (curve.quantile("ridge", 0.25) <= curve.quantile("ridge", 0.75)).all()
    assert json.loads(json.dumps(curve.as_dict(), allow_nan=False))["sizes"] == [8, 200]
    assert "least squares" in str(curve)
    again = learning_curve({"ridge": plain(1e-2)}, noisy, test, [8], seeds=[3])
    assert again.errors["ridge"][0, 0] == curve.errors["ridge"][0, 3]


def test_learning_curves_give_phase_samples_to_those_who_want_them() -> None:
    system, rng = systems.slow_manifold(), np.random.default_rng(0)
    u = 0.1 * rng.normal(size=(400, 1))
    d1 = Episodes([system.simulate([0.3, 0.7], u, 1e-2)], [u], 1e-2)
    d2 = PhaseSamples.from_system(system, rng.uniform(-1, 1, (100, 2)), np.zeros((100, 1)))
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    split = PIEDMDc(theta, alpha=1e-6, penalty="ridge", toward="identity")
    curve = learning_curve({"split": split, "plain": LinearEDMDc(theta)}, d1, d1, [16], seeds=[0], d2=d2)
    assert np.isfinite(curve.errors["split"]).all() and not curve.refusals
    refused = learning_curve({"split": split}, d1, d1, [16], seeds=[0])
    assert np.isinf(refused.errors["split"]).all() and "give d2" in refused.refusals[0][3]


def test_every_estimator_has_a_learning_curve() -> None:
    data, test = episodes(), episodes(seed=9)
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    kinds = {"twin": TwinEDMDc(theta, alpha=1e-6, twin_alpha=1e-12), "streaming": StreamingEDMDc(theta)}
    curve = learning_curve(kinds, data, test, [20], seeds=[0], twin=episodes(seed=4))
    assert not curve.refusals and max(errors.max() for errors in curve.errors.values()) < 1e-12
    refused = learning_curve(kinds, data, test, [20], seeds=[0, 1])
    assert "twin: 2 of 2 fits refused: TwinEDMDc learns from episodes of a twin too; give twin" in str(refused)
    assert np.isfinite(refused.errors["streaming"]).all()


def test_divergence_counts_from_the_step_at_which_it_happens() -> None:
    """x doubles from 1 and leaves 1000 times the range of 1 at step 10: 2^9 = 512 is within, 2^10 = 1024 is not."""
    data = Episodes([2.0 ** np.arange(15)[:, None]], [np.zeros((14, 1))], 0.1)
    model = replace(plain_scalar().fit(data).lifted, state_range=np.ones(1))
    found = horizon_errors(model, data, [1, 9, 10, 11], stride=100)
    np.testing.assert_array_equal(found.diverged, [0.0, 0.0, 1.0, 1.0])
    np.testing.assert_array_equal(np.isfinite(found.rms[:, 0]), [True, True, False, False])
    scored = model.predict(data.xs[0][0], None, data.us[0])
    assert scored.diverged_at == 10 and scored.x[9, 0] == pytest.approx(512.0) == pytest.approx(scored.x[14, 0])
    squared = rollout_errors(model, data).squared[0]  # of the steps 1 to 14
    np.testing.assert_array_equal(np.isfinite(squared), np.arange(1, 15) < 10)


def test_a_roll_out_may_diverge_at_its_start_or_at_its_end() -> None:
    data = Episodes([2.0 ** np.arange(11)[:, None]], [np.zeros((10, 1))], 0.1)
    model = replace(plain_scalar().fit(data).lifted, state_range=np.ones(1))
    at_the_end = rollout_errors(model, data)
    assert at_the_end.diverged.all() and np.isfinite(at_the_end.squared[0]).sum() == 9
    at_the_start = rollout_errors(replace(model, state_range=np.full(1, 1e-4)), data)
    assert at_the_start.diverged.all() and np.isinf(at_the_start.squared[0]).all()
    found = horizon_errors(replace(model, state_range=np.full(1, 1e-4)), data, [1])
    assert found.diverged[0] == 1.0


def test_bad_questions_are_refused_in_one_line() -> None:
    data = episodes()
    model = plain().fit(data).lifted
    for build, message in (
        (lambda: horizon_errors(model, data, []), "horizons is empty"),
        (lambda: horizon_errors(model, data, [41]), "the longest has 40"),
        (lambda: horizon_errors(model, data, [1], stride=0), "stride"),
        (lambda: compare({}, data), "models is empty"),
        (lambda: learning_curve({}, data, data, [4]), "at least one"),
        (lambda: learning_curve({"a": plain()}, data, data, [1000]), "hold 240"),
    ):
        with pytest.raises(ValueError, match=message):
            build()
