"""Limits of the inputs that change under way."""

from typing import Any

import numpy as np
import pytest

from example_models import EXACT, arm_model, delayed_model
from pisplit.controllers import MPC, ClosedLoop, references
from pisplit.controllers.plants import ModelPlant

REFERENCE = references.from_array(0.03 * np.cos(0.2 * np.arange(80)[:, None] + np.arange(3)), 0.03)


def loop(**settings: Any) -> ClosedLoop:
    model = delayed_model()
    return ClosedLoop(ModelPlant(model, np.zeros(6)), MPC(model, 8, -0.02, 0.02, 0.004, qp=EXACT, **settings))


def test_the_same_limits_given_again_change_nothing() -> None:
    logs = []
    for again in (False, True):
        made = loop(command_delay=0.5)
        made.run(REFERENCE, 10, progress=False)
        if again:
            made.controller.limit(-0.02, [0.02, 0.02, 0.02], du_max=0.004)  # type: ignore[attr-defined]
        logs.append(made.resume(10, progress=False))
    np.testing.assert_allclose(logs[0].u, logs[1].u, atol=1e-8)
    np.testing.assert_allclose(logs[0].x, logs[1].x, atol=1e-7)


def test_tightened_limits_hold_from_the_next_step_on() -> None:
    made = loop()
    wide = made.run(REFERENCE, 20, progress=False)
    now = wide.u[-1]
    low, high = np.minimum(now, -0.005), np.maximum(now, 0.005)
    made.controller.limit(low, high, 0.001)  # type: ignore[attr-defined]
    log = made.resume(20, progress=False)
    later = np.abs(np.diff(log.u, axis=0))[19:]
    assert (log.u[20:] >= low).all() and (log.u[20:] <= high).all() and later.max() <= 0.001 + 1e-12
    assert np.abs(np.diff(log.u, axis=0))[:19].max() > 0.0011  # before, which counts as no violation
    assert log.limit_violations == 0 and log.fallbacks == 0


def test_limits_that_cannot_be_are_refused_and_nothing_changes() -> None:
    model = arm_model(1, basis=np.eye(3))
    mpc, other = (MPC(model, 5, -0.02, 0.02, 0.004) for _ in range(2))
    for controller in (mpc, other):
        controller.reset([0.01, 0.0, 0.0])
    for wrong, message in (
        ({"u_max": 0.005}, "present input 0 is 0.01, outside the new box -0.02 .. 0.005; bring it inside"),
        ({"du_max": 0.0}, "du_max = 0"),
        ({"u_min": 0.03}, "u_min = 0.03 is not below u_max"),
        ({"u_min": [0.0, 0.0]}, "u_min has shape"),
    ):
        with pytest.raises(ValueError, match=message):
            mpc.limit(**wrong)  # type: ignore[arg-type]
    window = np.full((5, 3), 0.02)
    np.testing.assert_array_equal(mpc.step(np.zeros(6), window).u, other.step(np.zeros(6), window).u)
    np.testing.assert_array_equal(mpc.u_max, 0.02)
