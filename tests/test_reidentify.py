"""A loop that identifies its system again and goes on with the new model."""

from dataclasses import replace

import numpy as np
import pytest

from example_models import EXACT, arm_model, delayed_model
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, LoopLog, NewModel, references
from pisplit.controllers.plants import DelayedCommands, ModelPlant
from pisplit.data.episodes import Episodes

LIMITS = -0.02, 0.02, 0.004


def least_squares(log: LoopLog) -> NewModel:
    """x+ = A x + B u + c from the log, which has no noise."""
    rows = np.hstack([log.x[:-1], log.u, np.ones((len(log.u), 1))])
    found = np.linalg.lstsq(rows, log.x[1:], rcond=None)[0].T
    base = arm_model(1, basis=np.eye(3))
    model = replace(base, A=found[:, :6], B=found[:, 6:9], c=found[:, 9])
    return NewModel(model, ("fitted anew",), Episodes([log.x], [log.u], log.dt, **NAMES))


NAMES = {"state_names": arm_model(0).state_names, "input_names": arm_model(0).input_names}


def test_a_plant_that_changed_is_followed_with_the_model_of_its_log() -> None:
    model = arm_model(1, basis=np.eye(3))
    plant = ModelPlant(replace(model, A=0.9 * model.A, B=0.6 * model.B[:, [1, 0, 2]]), np.zeros(6))
    observer = KalmanFilter(model, 1e-8 * np.eye(6), 1e-4)
    loop = ClosedLoop(plant, MPC(model, 10, *LIMITS, rate_weight=1e-4, observer=observer))
    u = 0.01 * np.sin(np.arange(1, 200)[:, None] * np.array([0.19, 0.13, 0.07]))
    reference = references.from_array(plant.model.rollout(np.zeros(6), u).x[:, :3], 0.03)  # what the plant can do
    loop.run(reference, 60, progress=False)
    new = loop.reidentify(least_squares, seconds=1.2)
    assert len(new.episodes or ()) == 1 and len((new.episodes or [])[0].us[0]) == 40  # what was asked for of the log
    found = loop.controller.model
    np.testing.assert_allclose(found.A, plant.model.A, atol=1e-6)
    np.testing.assert_allclose(found.B, plant.model.B, atol=1e-6)
    log = loop.resume(60, progress=False)
    assert len(log.u) == 120 and log.limit_violations == 0 and log.notes[-1] == "t = 1.80 s: fitted anew"
    assert log.rms_error(after=2.4) < 0.1 * log.rms_error(after=0.6, before=1.8)


@pytest.mark.parametrize("delay", [0.0, 1.4])
def test_the_same_model_identified_again_changes_nothing(delay: float) -> None:
    """History, commands on their way and the reference go on: the next moves are those of the unbroken loop."""
    model = delayed_model()
    logs = []
    for again in (False, True):
        plant = DelayedCommands(ModelPlant(model, np.zeros(6)), delay)
        mpc = MPC(model, 8, *LIMITS, estimator_gain=0.0, command_delay=delay, qp=EXACT)
        loop = ClosedLoop(plant, mpc)
        reference = references.from_array(0.02 * np.cos(0.2 * np.arange(60)[:, None] + np.arange(3)), 0.03)
        loop.run(reference, 12, progress=False)
        if again:
            loop.reidentify(lambda log: NewModel(model))
            assert loop.controller is not mpc
        logs.append(loop.resume(10, progress=False))
    np.testing.assert_allclose(logs[0].u, logs[1].u, atol=1e-7)
    np.testing.assert_allclose(logs[0].x, logs[1].x, atol=1e-6)


def test_what_cannot_be_identified_leaves_the_loop_as_it_was() -> None:
    model = arm_model(2, basis=np.eye(3))
    mpc = MPC(model, 6, *LIMITS)
    loop = ClosedLoop(ModelPlant(model, np.zeros(6)), mpc)
    with pytest.raises(ValueError, match="nothing was run yet"):
        loop.reidentify(least_squares)
    loop.run(references.constant(np.zeros(3)), 5, progress=False)

    def refuse(log: LoopLog) -> NewModel:
        raise ValueError("the log says nothing")

    with pytest.raises(ValueError, match="the log says nothing"):
        loop.reidentify(refuse)
    swapped = replace(model, state_names=tuple(reversed(model.state_names)))
    with pytest.raises(ValueError, match="other state names"):
        loop.reidentify(lambda log: NewModel(swapped))
    with pytest.raises(ValueError, match="seconds"):
        loop.reidentify(least_squares, seconds=0.0)
    assert loop.controller is mpc and len(loop.resume(3, progress=False).u) == 8
    watched = MPC(model, 6, *LIMITS, observer=KalmanFilter(model, 1e-6 * np.eye(6), 1e-3))
    loop = ClosedLoop(ModelPlant(model, np.zeros(6)), watched)
    loop.run(references.constant(np.zeros(3)), 5, progress=False)
    with pytest.raises(ValueError, match="give episodes"):
        loop.reidentify(lambda log: NewModel(model))
