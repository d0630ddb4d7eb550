"""When a motion begins that noise hides from one sample to the next: for clocks that are right, late and early."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit.data import find_latency
from pisplit.data.late_commands import said
from pisplit.data.latency import Latency

Array = NDArray[np.float64]

DT, HOLD, NOISE = 0.01, 5, 3e-4


def followed(order: int, late: float, seed: int = 0, step: float = 0.0) -> Latency:
    """What is found of markers of a swing (``order`` 2) or a lag (1) whose servo starts at once and moves for 50 ms.

    Their largest spread is 30 mm, their noise 0.3 mm; the commands stand ``late`` [s] too late in the log,
    and are smooth and rounded there where a ``step`` of it is given.
    """
    rng, xs, us = np.random.default_rng(seed), [], []
    for _ in range(5):
        moves = rng.standard_normal(120)
        moves = np.convolve(moves, np.ones(6) / 6.0, "same") if step else moves
        commands = np.cumsum(moves) if step else np.clip(np.cumsum(moves), -3.0, 3.0)
        path = np.interp(DT * np.arange(120 * HOLD + 1), HOLD * DT * np.arange(121), np.append(0.0, commands))
        q, v, motion = 0.0, 0.0, []
        for servo in path:
            motion.append(q)
            for _ in range(5):
                v += DT / 5 * (81.0 * (servo - q) - 1.8 * v)
                q += DT / 5 * (v if order == 2 else 8.0 * (servo - q))
        clean = np.outer(motion, [0.015, 0.005, 1e-5])
        xs.append(clean + NOISE * rng.standard_normal(clean.shape))
        stamped = np.floor((DT * np.arange(120 * HOLD) - late) / (HOLD * DT) + 1e-9).astype(int)
        logged = step * np.round(commands / step) if step else commands
        us.append(logged[np.clip(stamped, 0, 119)][:, None])
    return find_latency(xs, us, DT)


@pytest.mark.parametrize("late", [-0.06, 0.0, 0.03, 0.06])
def test_the_motion_begins_where_it_does_whatever_the_clock(late: float) -> None:
    found = followed(2, late)
    assert found.begins and found.delay is not None
    assert (
        found.delay + late == pytest.approx(0.5 * HOLD * DT, abs=0.02) and found.error <= 0.02
    )  # a ramp is a step half as late
    assert ("before" in said(found, DT)) == (late > 0.04) and ("stamped early" in said(found, DT) or late > -0.02)


@pytest.mark.parametrize("late", [-0.06, 0.0, 0.06])
def test_rounded_commands_show_it_as_they_may_have_been_before(late: float) -> None:
    """Up to 3 % of their usual change, within what is told; coarser ones do not."""
    found = followed(2, late, step=0.02)
    assert found.begins and found.delay is not None and found.error <= 0.02
    assert found.delay + late == pytest.approx(0.5 * HOLD * DT, abs=0.02)
    assert not followed(2, late, step=0.1).begins


def test_a_command_that_moves_at_once_is_not_taken_for_a_late_one() -> None:
    """What a velocity does is seen earlier than what a force does; neither comes before its command."""
    found = followed(1, 0.0)
    assert found.delay is not None and found.delay > -found.error and "before" not in said(found, DT)
