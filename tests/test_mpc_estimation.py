"""What an MPC makes of measurements: which sample is which, disturbances, read-outs that are wrong."""

from dataclasses import replace

import numpy as np
import pytest

from example_models import EXACT, arm_model
from pisplit.controllers import MPC
from pisplit.lifted.model import LiftedModel


def shift_register() -> LiftedModel:
    """y_{k+1} = u_k in three coordinates: the input is the output of the next step."""
    model = arm_model(0)
    return replace(
        model, A=np.zeros((6, 6)), B=np.eye(6, 3), c=np.zeros(6), input_offset=np.zeros(3), input_basis=np.eye(3)
    )


def test_the_first_sample_of_the_window_is_that_of_the_next_step() -> None:
    mpc = MPC(shift_register(), 6, -1.0, 1.0, 2.0, rate_weight=0.0, qp=EXACT)
    for k in range(4):
        window = np.random.default_rng(k).uniform(-0.5, 0.5, (6, 3))
        move = mpc.step(np.zeros(6) if k == 0 else np.concatenate([u, np.zeros(3)]), window)  # noqa: F821
        u = move.u
        np.testing.assert_allclose(u, window[0], atol=1e-6)
        np.testing.assert_allclose(move.predicted, window, atol=1e-6)


def test_the_estimate_closes_the_gap_to_the_prediction_by_its_gain() -> None:
    model, rng = arm_model(5), np.random.default_rng(5)
    for gain in (0.0, 0.3, 1.0):
        mpc = MPC(model, 5, -0.01, 0.01, 0.003, estimator_gain=gain)
        mpc.reset(model.input_offset)
        w, predicted = np.zeros(6), None
        for _ in range(4):
            x = 0.05 * rng.standard_normal(6)
            u = mpc.step(x, np.zeros((5, 3))).u
            if predicted is not None:
                w = w + gain * (x - predicted)
            np.testing.assert_allclose(mpc.disturbance, w, atol=1e-14)
            predicted = model.A @ x + model.B @ u + model.c + w


def test_a_constant_disturbance_is_found_with_its_sign() -> None:
    model, load = arm_model(6), 1e-3 * np.arange(1.0, 7.0)
    mpc = MPC(model, 5, -0.01, 0.01, 0.003)
    mpc.reset(model.input_offset)
    x = np.zeros(6)
    for _ in range(60):
        x = model.step(x, mpc.step(x, np.zeros((5, 3))).u) + load
    np.testing.assert_allclose(mpc.disturbance, load, rtol=1e-6)


@pytest.mark.parametrize("error", [0.9, 1.2])
def test_a_wrong_read_out_leaves_no_offset(error: float) -> None:
    """C = 0.9 or 1.2 where the output is the state: what it misses now it is taken to miss over the horizon."""
    model = replace(arm_model(7, basis=np.eye(3)), C=error * np.eye(6))
    mpc = MPC(model, 10, -0.1, 0.1, 0.01, rate_weight=1e-3)
    mpc.reset(model.input_offset)
    x, target = np.zeros(6), np.array([0.05, -0.03, 0.04])
    for _ in range(300):
        move = mpc.step(x, np.tile(target, (10, 1)))
        x = model.step(x, move.u)
    np.testing.assert_allclose(x[:3], target, atol=2e-4)
    np.testing.assert_allclose(move.predicted[0], x[:3], atol=1e-4)
