"""The equations of an arm as a model of MPC: what they predict is the arm's own motion."""

import pickle

import numpy as np
import pytest

from pisplit.controllers import MPC, ClosedLoop, references
from pisplit.front import physical_model
from pisplit.lifted.model import LiftedModel
from pisplit.models.arm import TendonArm

DT = 0.03


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper()


@pytest.fixture(scope="module")
def model(arm: TendonArm) -> LiftedModel:
    return physical_model(arm, DT)


def test_a_step_is_that_of_the_arm_and_its_derivative_that_of_the_step(arm: TendonArm, model: LiftedModel) -> None:
    stepper = arm.scene.fast_stepper(dt=DT)
    before, u = stepper.reset(arm.rest_inputs), arm.rest_inputs + 2e-3 * np.array([1.0, -0.7, -0.3])
    after = stepper.step(u).state
    seen = np.array([i for i, name in enumerate(model.state_names) if not name.startswith("v_")])
    z = model.lift(np.stack([before, before]), arm.rest_inputs[None])
    np.testing.assert_allclose(model.read(z), before, atol=1e-12)
    np.testing.assert_allclose(model.read(model.step(z, u))[seen], after[seen], atol=1e-7)
    z = model.lift(np.stack([before, after]), u[None])  # moving, from measured fields alone
    np.testing.assert_allclose(model.read(model.step(z, u))[seen], stepper.step(u).state[seen], atol=1e-6)
    tip, h = list(model.outputs["tip"]), 1e-4
    by_state, by_input = (J[-len(model.state_names) :][tip] for J in model.jacobian(z, u))
    way = np.array([1.0, -0.5, -0.5])
    slope = model.read(model.step(z, u + h * way) - model.step(z, u - h * way))[tip] / (2 * h)
    np.testing.assert_allclose(by_input @ way, slope, rtol=1e-3, atol=1e-3)
    bend = np.zeros(model.n_lifted)
    bend[1] = 1.0  # a curvature
    slope = model.read(model.step(z + h * bend, u) - model.step(z - h * bend, u))[tip] / (2 * h)
    np.testing.assert_allclose(by_state @ bend, slope, rtol=1e-3, atol=1e-4)


def test_mpc_on_it_follows_at_once(arm: TendonArm, model: LiftedModel) -> None:
    mpc = MPC(model, 6, -0.014, 0.016, 0.002, rate_weight=1e-3)
    loop = ClosedLoop(arm.scene.fast_stepper(dt=DT), mpc)
    log = loop.run(references.circle(radius=0.1, period=4.0), 6, u0=arm.rest_inputs, progress=False)
    assert not log.fallbacks and log.error.max() < 1e-3


def test_a_plan_from_the_last_one_is_the_motion_and_its_derivative(arm: TendonArm, model: LiftedModel) -> None:
    tip, H = list(model.outputs["tip"]), 6
    T = 2e-3 * arm.differential_basis
    along = model.relifted.along(model.C[tip], model.d[tip], T)
    z = model.lift(np.zeros((2, model.n_states)), arm.rest_inputs[None])
    w = 1e-4 * np.random.default_rng(1).standard_normal(model.n_lifted)
    v = 0.4 * np.sin(0.5 * np.arange(2 * (H + 2)).reshape(-1, 2))
    for k in range(3):  # shifted plans: derivatives of steps that are no longer new
        u = arm.rest_inputs + v[k : k + H] @ T.T
        S, y = along(z, w, u)
        after, exact = z, np.zeros((model.n_lifted, 0))
        for j in range(H):
            by_state, by_input = model.jacobian(after, u[j])
            exact = np.hstack([by_state @ exact, by_input @ T])
            after = model.step(after, u[j]) + w
            if k == 2:
                np.testing.assert_allclose(y[3 * j : 3 * j + 3], model.read(after)[tip], atol=1e-4)
                near = S[3 * j : 3 * j + 3, : 2 * j + 2]
                np.testing.assert_allclose(near, model.C[tip] @ exact, atol=0.02 * np.abs(S).max())
        z = model.step(z, u[0]) + w


def test_a_restored_controller_goes_on_to_the_last_bit(arm: TendonArm, model: LiftedModel) -> None:
    mpc, tip = MPC(model, 4, -0.014, 0.016, 0.002), list(model.outputs["tip"])
    mpc.reset(arm.rest_inputs)
    x = model.read(model.lift(np.zeros((2, model.n_states)), arm.rest_inputs[None]))
    window = np.tile(x[tip] + [0.02, 0.01, 0.0], (4, 1))
    mpc.step(x, window)
    state = mpc.snapshot()
    moves = [mpc.step(x, window).u for _ in range(2)]
    mpc.restore(state)
    np.testing.assert_array_equal([mpc.step(x, window).u for _ in range(2)], moves)


def test_it_is_no_file(model: LiftedModel, tmp_path) -> None:  # type: ignore[no-untyped-def]
    kept = pickle.loads(pickle.dumps(model))
    assert kept.relifted.dt == DT and kept.column_names == model.column_names
    with pytest.raises(ValueError, match="keep the arm"):
        model.save(tmp_path / "arm.h5")
