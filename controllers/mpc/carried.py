"""Whether a model predicts well enough over the horizon to close a loop on it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from pisplit.data.episodes import Episodes
from pisplit.evaluation.horizon import horizon_errors
from pisplit.evaluation.matching import Fitted, model_of
from pisplit.lifted.model import LiftedModel

#: Error at the end of the horizon, in parts of the outputs' spread, up to which a model carries a loop: models of 16
#: pairs of two robots, linear and bilinear, are beyond, of 128 pairs and more below.
BOUND = 0.4
#: Roll-outs that are made, about.
ROLLOUTS = 200


def check_carried(
    model: LiftedModel | Fitted, episodes: Episodes, horizon: int, tracked: Sequence[int], force: bool = False
) -> str:
    """Hold the error of predictions over the horizon against the spread of what is tracked.

    Args:
        model: the model, or a fitted estimator.
        episodes: recordings of the plant, best those that the model did not learn from.
        horizon: steps; as many as the recordings have, where they are shorter.
        tracked: positions of the tracked states.
        force: whether a model that does not predict them is warned of, and not refused.

    Returns what was found where the model was forced, in words, else nothing. Raises ValueError for a model whose error
    at the end of the horizon is above 0.4 times the spread, and for recordings that do not fit it.
    """
    found = model_of(model, "model")
    longest = max(map(len, episodes.us)) - found.n_delays
    steps = max(1, min(horizon, longest))
    starts = sum(max(0, len(u) - found.n_delays - steps + 1) for u in episodes.us)
    errors = horizon_errors(found, episodes, [steps], list(tracked), stride=max(1, starts // ROLLOUTS))
    error = float(errors.normalised[0])
    if error <= BOUND:
        return ""
    told = (
        f"predictions of the recordings are off by {error:.2g} of the spread of the tracked outputs {steps} steps "
        f"ahead; expected at most {BOUND:g}: more recordings, another dictionary or penalty, or a shorter horizon"
    )
    if not force:
        raise ValueError(f"the model does not carry MPC: {told}; force=True tries it nonetheless")
    warnings.warn(f"MPC was forced: {told}", stacklevel=4)
    return f"forced: {told}"
