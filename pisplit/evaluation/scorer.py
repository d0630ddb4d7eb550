"""A scorer over recordings for scikit-learn: errors of roll-outs in the unit of the states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pisplit.checks import count
from pisplit.data.episodes import Episodes
from pisplit.data.sums import together
from pisplit.evaluation.horizon import horizon_errors
from pisplit.evaluation.matching import States, model_of, state_indices
from pisplit.evaluation.rollouts import rollout_errors


class RolloutScore:
    """Minus the root mean square error of roll-outs, in the unit of the states: larger is better, 0 is perfect.

    states   output group, names or indices of the states whose errors count, |x_hat - x| over all of them; default all.
             Give states of one unit: errors of different ones do not add up
    horizon  steps ahead, from every step of the recordings; default: roll-outs from the first step to the end

    For ``scoring=`` of scikit-learn's ``cross_val_score``, ``GridSearchCV`` and the like. Raises ValueError for a
    horizon that is no number of steps; for states of different units when it is called.
    """

    def __init__(self, states: States = None, horizon: int | None = None) -> None:
        if horizon is not None:
            count(horizon, "horizon")
        self.states = states
        self.horizon = horizon

    def __call__(self, estimator: Any, X: Episodes | Sequence[Episodes], y: Any = None) -> float:
        """Score of a fitted ``estimator`` on the recordings ``X``; minus infinity if a roll-out diverges.

        ``y`` is scikit-learn's, and not used.
        """
        model, episodes = model_of(estimator), together(X, "X")
        units = {model.units[i] for i in state_indices(model, self.states)}
        if len(units) > 1:
            raise ValueError(
                f"states have the units {', '.join(sorted(map(repr, units))[:4])}; give states of one unit"
            )
        if self.horizon is not None:
            return -float(np.linalg.norm(horizon_errors(model, episodes, [self.horizon], self.states).rms[0]))
        return -float(np.sqrt(rollout_errors(model, episodes, self.states).mean))

    def __repr__(self) -> str:
        return f"RolloutScore(states={self.states!r}, horizon={self.horizon!r})"
