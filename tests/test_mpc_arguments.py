"""What an MPC refuses, in one line."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from example_models import arm_model
from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC, FeedForward, QPSettings


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": 0}, "horizon = 0"),
        ({"u_min": [-0.01, -0.01]}, r"u_min has shape \(2,\); expected \(3,\)"),
        ({"u_min": 0.02}, "u_min = 0.02 is not below u_max = 0.01"),
        ({"du_max": 0.0}, "du_max = 0; expected a positive change"),
        ({"du_max": np.nan}, "du_max has 3 NaN"),
        ({"u_min": 0.005}, "contains no input of the training data"),
        ({"track": "elbow"}, "'elbow' names no output of the model; it has 'tip'"),
        ({"track": (0, 9)}, "expected state names, or indices from 0 to 5"),
        ({"axes": (0, 3)}, "axes"),
        ({"dt": 0.05}, "dt = 0.05 s, the model has 0.03 s"),
        ({"output_weight": [1.0, 2.0]}, "output_weight"),
        ({"output_weight": 0.0}, "output_weight"),
        ({"rate_weight": -1.0}, "rate_weight = -1"),
        ({"y_min": 0.1, "y_max": 0.0}, "y_min"),
        ({"estimator_gain": 1.5}, "estimator_gain = 1.5"),
        ({"u_min": None}, "u_min = None; give the lower limits"),
        ({"u_max": None}, "u_max = None; give the upper limits"),
        ({"du_max": None}, "du_max = None; give the largest change per step"),
        ({"u_min": 0.01}, "u_min = 0.01 is not below u_max = 0.01"),
        ({"u_min": 0.02, "u_max": -0.02}, "u_min = 0.02 is not below u_max = -0.02"),
        ({"y_min": [0.0]}, "y_min = .* expected a number or 3 numbers"),
        ({"output_scale": [1.0, 2.0]}, "output_scale = .* expected a number or 3 numbers"),
        ({"output_scale": 0.0}, "output_scale"),
        ({"output_slack_weight": 10.0}, "output_slack_weight has no effect without y_min or y_max"),
        ({"output_slack_weight": 10.0, "y_max": np.inf}, "output_slack_weight has no effect"),
        ({"output_slack_weight": 0.0, "y_max": 1.0}, "output_slack_weight = 0"),
        ({"rate_weight": [1.0, 1.0]}, "rate_weight is not a number"),
        ({"input_weight": None}, "input_weight is not a number"),
        ({"horizon": 5.0}, "horizon = 5.0"),
        ({"track": ["x0", "x7"]}, "'x7', which is no state of the model"),
        ({"track": ["x0", 0]}, "names a state twice"),
        ({"track": []}, "axes"),
        ({"axes": (0, 0)}, "axes"),
        ({"axes": (0.5,)}, "axes"),
    ],
)
def test_wrong_arguments_raise_one_line(changes: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"horizon": 5, "u_min": -0.01, "u_max": 0.01, "du_max": 0.002} | changes
    with pytest.raises(ValueError, match=message) as caught:
        MPC(arm_model(0), **arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_wrong_measurements_and_references_raise() -> None:
    mpc = MPC(arm_model(0), 5, -0.01, 0.01, 0.002)
    with pytest.raises(ValueError, match="x_measured has shape"):
        mpc.step(np.zeros(5), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="x_measured has infinite entries"):
        mpc.step(np.array([0, 0, 0, 0, 0, np.inf]), np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"reference_window has shape \(4, 3\); expected \(5, 3\)"):
        mpc.step(np.zeros(6), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="outside u_min"):
        mpc.reset([0.05, 0.0, 0.0])
    with pytest.raises(ValueError, match="input_basis"):
        MPC(arm_model(0, basis=np.zeros((3, 0))), 5, -0.01, 0.01, 0.002)
    for wrong in ({"eps": 0.0}, {"max_iterations": 0}, {"first_max_iterations": 2.5}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            QPSettings(**wrong)  # type: ignore[arg-type]


def test_a_model_without_inputs_controls_nothing() -> None:
    base = arm_model(0)
    x, v, u = ca.SX.sym("x", 6), ca.SX.sym("v", 0, 0), ca.SX.sym("u", 0)
    free = replace(
        base,
        B=np.zeros((6, 0)),
        input_names=(),
        feature_names=(),
        input_offset=np.zeros(0),
        input_basis=np.zeros((0, 0)),
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        input_units=None,
    )
    for make in (
        lambda: MPC(free, 5, -1.0, 1.0, 0.1),
        lambda: FeedForward(lambda y: np.zeros(0), free, -1.0, 1.0, 0.1),
    ):
        with pytest.raises(ValueError, match="the model has no inputs: nothing can be controlled"):
            make()


def test_a_model_that_does_not_predict_over_the_horizon_is_refused() -> None:
    rng, xs, us = np.random.default_rng(0), [], []
    for _ in range(3):
        u, x = np.repeat(rng.uniform(-1.0, 1.0, (12, 1)), 5, axis=0), [np.zeros(2)]
        for v in u:
            x.append(np.array([[0.95, 0.3], [-0.3, 0.9]]) @ x[-1] + np.array([0.0, 0.2]) * v)
        xs.append(np.array(x))
        us.append(u)
    data = Episodes(xs, us, 0.05, outputs={"tip": (0,)})
    theta = Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    right = LinearEDMDc(theta, 1e-9).fit(data[:2]).lifted
    wrong = replace(right, A=0.6 * right.A, B=-right.B)  # of another system
    good = MPC(right, 20, -1.0, 1.0, 0.5, recordings=data[2:])
    assert not any("forced" in note for note in good.notes)
    with pytest.raises(
        ValueError, match=r"does not carry MPC: .* of the spread .* 20 steps ahead; expected at most 0.4"
    ):
        MPC(wrong, 20, -1.0, 1.0, 0.5, recordings=data[2:])
    with pytest.warns(UserWarning, match="MPC was forced"):
        forced = MPC(wrong, 20, -1.0, 1.0, 0.5, recordings=data[2:], force=True)
    assert forced.notes[-1].startswith("forced: predictions")
    forced.limit(u_max=0.8)  # what was forced once is not asked again
    MPC(right, 200, -1.0, 1.0, 0.5, recordings=data[2:])  # as far as the recordings go
