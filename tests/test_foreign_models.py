"""Linear models of scipy.signal and python-control come in as models of ours, and go out again unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, dlsim

from pisplit import LiftedModel, from_state_space, modes, to_state_space
from pisplit.controllers import MPC

A = np.array([[1.0, 0.1], [-0.2, 0.9]])
B = np.array([[0.005], [0.1]])
C = np.array([[1.0, 0.0]])


@pytest.fixture
def model() -> LiftedModel:
    return from_state_space((A, B, C), dt=0.1, state_names=["p", "v"], input_names=["f"], output_names=["seen"])


def test_roll_outs_are_those_of_scipy(model: LiftedModel) -> None:
    u = np.random.default_rng(0).normal(size=(30, 1))
    _, y, x = dlsim(StateSpace(A, B, C, np.zeros((1, 1)), dt=0.1), u, x0=[0.3, -0.1])
    start = np.array([0.3, -0.1, 0.3])
    found = model.rollout(model.lift(start[None, :], np.zeros((0, 1))), u).x[:-1]
    np.testing.assert_allclose(found, np.hstack([x, y]), atol=1e-12)
    assert model.state_names == ("p", "v", "seen") and model.outputs == {"outputs": (2,)}


def test_in_and_out_is_the_same_system() -> None:
    system = from_state_space(StateSpace(A, B, np.eye(2), np.zeros((2, 1)), dt=0.1))
    again = to_state_space(system)
    np.testing.assert_array_equal(again.A, A)
    np.testing.assert_array_equal(again.B, B)
    assert system.state_names == ("x1", "x2") and system.outputs == {}


def test_continuous_systems_are_sampled_with_held_inputs() -> None:
    oscillator = StateSpace([[0.0, 1.0], [-4.0, -0.4]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    found = modes(from_state_space(oscillator, dt=0.05))
    assert found.frequencies.max() == pytest.approx(np.sqrt(4.0 - 0.04) / (2 * np.pi), rel=1e-9)
    with pytest.raises(ValueError, match="give dt"):
        from_state_space(oscillator)


def test_mpc_moves_a_system_of_python_control() -> None:
    control = pytest.importorskip("control")
    made = control.ss(A, B, C, 0.0, 0.1, states=["p", "v"], inputs=["f"], outputs=["y"])
    model = from_state_space(made)
    assert model.state_names == ("p", "v", "y") and model.input_names == ("f",) and model.dt == 0.1
    mpc = MPC(model, horizon=15, u_min=-2.0, u_max=2.0, du_max=1.0, track="outputs", rate_weight=1e-3)
    x = np.zeros(2)
    for _ in range(120):
        u = mpc.step(np.append(x, x[0]), np.full((15, 1), 0.5)).u
        x = A @ x + B @ u
    assert abs(x[0] - 0.5) < 1e-4


@pytest.mark.parametrize(
    ("system", "options", "said"),
    [
        ((A, B, C), {}, "no time step"),
        ((A, B, C, [[1.0]]), {"dt": 0.1}, "D is not zero"),
        (StateSpace(A, B, C, [[0.0]], dt=0.1), {"dt": 0.2}, "steps of 0.1 s"),
        ((A, B, C), {"dt": 0.1, "state_range": [1.0, 0.0, 1.0]}, "above zero"),
        ((A, B[:1], C), {"dt": 0.1}, "B"),
        (3.0, {"dt": 0.1}, "expected a StateSpace"),
        ((A, B, C), {"dt": 0.1, "output_names": ["x1"]}, "share the name"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(system: object, options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        from_state_space(system, **options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
