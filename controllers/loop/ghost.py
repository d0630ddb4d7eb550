"""What a model predicted some steps before, along a run: the ghost of its page."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array, count
from pisplit.controllers.loop.log import LoopLog
from pisplit.evaluation.matching import Fitted, model_of
from pisplit.lifted.model import LiftedModel


def ghost_of(log: LoopLog, model: LiftedModel | Fitted, ahead: int) -> Array:
    """States (N+1, n) that the ``model`` predicted ``ahead`` steps before, from the states and inputs of the ``log``.

    NaN in the first rows, where a measurement was missing and where the roll-out diverged. Raises ValueError for a
    model of other states or inputs.
    """
    known, H = model_of(model), count(ahead, "ahead")
    if tuple(known.state_names) != log.state_names or tuple(known.input_names) != log.input_names:
        raise ValueError("the model has other states or inputs than the log; give the one that the loop ran on")
    D, ghost = known.n_delays, np.full(log.x.shape, np.nan)
    usable = [k for k in range(D, len(log.u) - H + 1) if np.isfinite(log.x[k - D : k + 1]).all()]
    if usable:
        starts = np.array(usable)
        past, before = starts[:, None] + np.arange(-D, 1), starts[:, None] + np.arange(-D, 0)
        with np.errstate(over="ignore", invalid="ignore"):
            z = known.lift(log.x[past], log.u[before])
            found = known.rollout(z, log.u[starts[:, None] + np.arange(H)])
        kept = np.asarray(found.diverged_at) < 0
        ghost[starts[kept] + H] = found.x[kept, -1]
    return ghost
