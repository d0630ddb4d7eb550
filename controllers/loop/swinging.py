"""Whether a loop swings: inputs thrown from one rate limit to the other, outputs far from the reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array

if TYPE_CHECKING:
    from pisplit.controllers.loop.recorder import Recorder
    from pisplit.controllers.loop.tracking import Controller

#: Steps that are looked at; part of them at a rate limit and turns between the limits from which on a loop swings;
#: error in parts of what the reference moves by in that time.
STEPS, LIMITED, TURNS, FAR = 40, 0.5, 4, 1.0
#: Part of the rate limit, and of the range of the training data that an error has to reach.
AT, SEEN = 0.95, 0.02


def swinging(record: Recorder, controller: Controller, dt: float) -> str:
    """What to say of the last steps of a run where they swing, else nothing; told once a run (``record.swings``).

    A limit cycle of a model that does not carry its loop looks like this: at least half of the steps at a rate limit,
    turned from one to the other four times and more, an error larger than the way of the reference in that time.
    ``controller``: whose rate limits and outputs these are; ``dt``: the step in s.
    """
    k = len(record.u)
    if record.swings or k < STEPS or k % (STEPS // 4):
        return ""
    u = np.array([record.u0, *record.u] if k == STEPS else record.u[-STEPS - 1 :])
    moves = np.diff(u, axis=0) / controller.du_max
    at = np.where(moves >= AT, 1, np.where(moves <= -AT, -1, 0))
    if at.any(axis=1).mean() < LIMITED or max(_turns(column) for column in at.T) < TURNS:
        return ""
    tracked = list(controller.tracked)
    missed = np.array(record.x[-STEPS:])[:, tracked] - record.wanted[k + 1 - STEPS : k + 1]
    scale = controller.model.state_range[tracked]
    error = _size(np.nan_to_num(missed) / scale)
    way = float(np.nan_to_num(np.ptp(np.nan_to_num(record.wanted[k + 1 - STEPS : k + 1] / scale), axis=0)).max())
    if error < max(FAR * way, SEEN):
        return ""
    record.swings = True
    limited = f"inputs at their rate limits in {100 * at.any(axis=1).mean():.0f} % of the last {STEPS} steps"
    return (
        f"t = {k * dt:.2f} s: the loop swings: {limited}, outputs off by {error:.2g} of the training range: "
        "the model does not carry it; a larger rate_weight, tune(), a KalmanFilter where measurements are noisy, or a "
        "better model"
    )


def _turns(limited: Array) -> int:
    """How often a column of -1, 0 and 1 goes from one end to the other."""
    ends = limited[limited != 0]
    return int(np.count_nonzero(np.diff(ends)))


def _size(missed: Array) -> float:
    return float(np.sqrt((missed**2).sum(axis=1).mean()))
