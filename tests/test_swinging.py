"""A loop that swings between its rate limits says so, once; loops that follow or only hurry do not."""

import numpy as np
import pytest

from pisplit import from_state_space
from pisplit.controllers import MPC, ClosedLoop, LoopLog, plants, references
from pisplit.controllers.plants import ModelPlant

DT, LATE = 0.05, 4


def loop(told: bool, moves: references.Reference, du_max: float = 0.2) -> LoopLog:
    """An oscillator of 1 Hz whose commands act four steps late, which the controller is told or not."""
    w = 2.0 * np.pi
    c, s, d = np.cos(w * DT), np.sin(w * DT), np.exp(-0.05 * w * DT)
    A = d * np.array([[c, s], [-s, c]])
    model = from_state_space((A, (np.eye(2) - A)[:, :1], np.eye(2)), DT, state_range=[1.0, 1.0])
    plant = plants.DelayedCommands(ModelPlant(model, np.zeros(2)), LATE)
    mpc = MPC(model, 20, -1.0, 1.0, du_max, track=[model.state_names[0]], rate_weight=1e-4, command_delay=LATE * told)
    return ClosedLoop(plant, mpc).run(moves, 200, progress=False)


def test_a_loop_whose_delay_nobody_told_swings_and_says_so() -> None:
    jump = references.setpoint([[0.3]], [0.5], track="")
    with pytest.warns(UserWarning, match="the loop swings: inputs at their rate limits"):
        log = loop(False, jump)
    assert sum("swings" in note for note in log.notes) == 1 and "swings" in log.summary()
    assert not any("swings" in note for note in loop(True, jump).notes)


def test_a_reference_that_is_too_fast_for_the_limits_is_no_swing() -> None:
    t = DT * np.arange(260)
    fast = references.from_array(0.6 * np.sin(4.0 * t)[:, None], DT, track="")
    log = loop(True, fast, du_max=0.05)
    assert (np.abs(np.diff(log.u[:, 0])) > 0.99 * 0.05).mean() > 0.5
    assert not any("swings" in note for note in log.notes)
