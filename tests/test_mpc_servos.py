"""Servos with lag and play between MPC and a plant: the lag is predicted, the play taken out of what is sent."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from pisplit import Actuator, Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.controllers import MPC, ClosedLoop, references
from pisplit.controllers.mpc.limits import input_limits
from pisplit.controllers.mpc.servos import Servos
from pisplit.controllers.plants import ActuatedPlant, ModelPlant
from pisplit.lifted.model import LiftedModel

DT, STEPS = 0.05, 100
A = np.array([[0.97, 0.2], [-0.2, 0.93]])


@pytest.fixture(scope="module")
def model() -> LiftedModel:
    """Of an oscillator under the mean position over each step, from positions."""
    rng, xs, us = np.random.default_rng(0), [], []
    for _ in range(4):
        u = np.cumsum(0.1 * rng.normal(size=(80, 1)), axis=0)
        before = np.vstack([u[:1], u[:-1]])
        x = [np.zeros(2)]
        for k in range(80):
            x.append(A @ x[-1] + np.array([0.05, 0.15]) * 0.5 * (u[k] + before[k]))
        xs.append(np.array(x))
        us.append(u)
    theta = Dictionary(ob.States(), ob.Inputs(), ob.Delays(inputs=1), n_states=2, n_inputs=1)
    return LinearEDMDc(theta).fit(Episodes(xs, us, DT)).lifted


def missed(
    model: LiftedModel, servo: Actuator, told: Actuator | None, inputs: str = "ramp", **more: float
) -> tuple[float, Any]:
    """RMS miss of a slow sine, once it is on it, and the controller; the plant is the model behind the ``servo``."""
    numbers: dict[str, Any] = {"rate_weight": 1e-3, "estimator_gain": 0.0, **more}
    mpc = MPC(model, 20, -3.0, 3.0, 0.5, [0], **numbers, actuator=told, actuator_inputs=inputs)
    wanted = 0.4 * np.sin(2.0 * np.pi * np.arange(STEPS + 30)[:, None] * DT / 3.0)
    plant = ActuatedPlant(ModelPlant(model, [0.0, 0.0]), servo, inputs)
    reference = references.from_array(wanted, DT, track="")
    log = ClosedLoop(plant, mpc).run(reference, STEPS, u0=[0.0], progress=False)
    assert np.abs(np.diff(np.vstack([log.u0, log.u]), axis=0)).max() <= 0.5 + 1e-12
    return float(np.sqrt(np.mean((log.y - log.reference)[30:] ** 2))), mpc


@pytest.mark.parametrize("inputs", ["ramp", "step"])
def test_a_lag_that_is_told_costs_nothing(model: LiftedModel, inputs: str) -> None:
    servo = Actuator(lag=0.08)
    without, with_it = (missed(model, servo, told, inputs)[0] for told in (None, servo))
    assert with_it < 0.01 * without


def test_play_that_is_told_is_taken_out(model: LiftedModel) -> None:
    servo = Actuator(lag=0.04, play=0.3)
    without, with_it = (missed(model, servo, told)[0] for told in (None, servo))
    assert with_it < 0.25 * without


@pytest.mark.parametrize(
    ("servo", "told"),
    [
        (Actuator(lag=0.04, play=0.3), Actuator(lag=0.04, play=0.4)),
        (Actuator(lag=0.04, play=0.3), Actuator(lag=0.0, play=0.4)),
        (Actuator(lag=0.04, play=0.3), Actuator(lag=0.08, play=0.3)),
        (Actuator(lag=0.04, play=0.3), Actuator(lag=0.04, play=0.6)),
    ],
)
def test_servos_that_are_told_wrong_are_better_than_none(model: LiftedModel, servo: Actuator, told: Actuator) -> None:
    without, with_it = (missed(model, servo, a)[0] for a in (None, told))
    assert with_it < 0.5 * without


def test_two_standard_errors_of_the_play_are_left_in() -> None:
    limits = input_limits(-14.0, 16.0, 2.0, 1)
    for error, taken in ((None, 0.28), (0.04, 0.32), (0.0, 0.4), (0.3, 0.0)):
        servos = Servos(Actuator(lag=0.05, play=0.4), 0.03, "ramp", limits, 20, error)
        assert servos.actuator.play == pytest.approx(taken) and servos.actuator.lag == 0.05


@pytest.mark.parametrize(("lag", "play"), [(0.05, 0.2), (0.0, 0.3), (0.015, 0.5)])
def test_positions_are_those_of_servos_without_play(lag: float, play: float) -> None:
    dt, limits = 0.03, input_limits(-14.0, 16.0, 2.0, 1)
    commands = 5.0 * np.sin(0.5 * np.pi * dt * np.arange(230))[:, None]
    found: list[Array] = []
    free = Actuator(lag=lag).simulate(commands, dt)[0]
    servos = Servos(Actuator(lag=lag, play=play), dt, "ramp", limits, 20, play_error=0.0)
    servos.reset(commands[0])
    for k in range(200):
        found.append(servos.send(commands[k], free[k : k + 20])[1])
    with_play = Actuator(lag=lag, play=play).simulate(commands[:200], dt)[0]
    late, left = (np.sqrt(np.mean((p - free[:200]) ** 2)) for p in (with_play, np.array(found)))
    assert left < 0.1 * late


def test_a_copy_goes_on_as_the_original_would(model: LiftedModel) -> None:
    mpc = missed(model, Actuator(lag=0.04, play=0.3), Actuator(lag=0.04, play=0.3))[1]
    other = MPC(model, 20, -3.0, 3.0, 0.5, [0], rate_weight=1e-3, estimator_gain=0.0, actuator=Actuator(0.04, 0.3))
    other.restore(copy.deepcopy(mpc.snapshot()))
    window = np.full((20, 1), 0.2)
    for x in ([0.1, 0.0], [0.2, 0.0]):
        np.testing.assert_array_equal(mpc.step(x, window).u, other.step(x, window).u)


def test_what_cannot_be_is_refused(model: LiftedModel) -> None:
    with pytest.raises(ValueError, match="expected an Actuator"):
        MPC(model, 5, -1.0, 1.0, 1.0, [0], actuator=0.03)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="inputs"):
        MPC(model, 5, -1.0, 1.0, 1.0, [0], actuator=Actuator(lag=0.03), actuator_inputs="hold")
    with pytest.raises(ValueError, match="play_error"):
        MPC(model, 5, -1.0, 1.0, 1.0, [0], actuator=Actuator(lag=0.03), play_error=0.1)
    with pytest.raises(ValueError, match="servos"):
        MPC(model, 5, -1.0, 1.0, 1.0, [0], actuator=Actuator(lag=0.03), stuck_after=None).to_c("x.h")
