"""Open-loop roll-outs of whole episodes against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes
from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RolloutErrors:
    """Squared errors of open-loop roll-outs, |x_hat - x|^2 summed over the chosen states.

    squared   one array (T_i,) an episode, a value a predicted step; infinite from the step of divergence on
    diverged  (E,) flags
    """

    squared: tuple[Array, ...]
    diverged: NDArray[np.bool_]

    @property
    def median(self) -> float:
        """Median over all steps of all episodes."""
        return self.quantile(0.5)

    @property
    def quartiles(self) -> tuple[float, float]:
        """25th and 75th percentile over all steps of all episodes."""
        return self.quantile(0.25), self.quantile(0.75)

    @property
    def mean(self) -> float:
        """Mean over all steps of all episodes: infinite if one diverged."""
        return float(np.concatenate(self.squared).mean())

    @property
    def per_episode(self) -> Array:
        """Mean squared error (E,) of every episode."""
        return np.array([values.mean() for values in self.squared])

    @property
    def diverged_fraction(self) -> float:
        """Fraction of episodes that diverged."""
        return float(self.diverged.mean())

    def quantile(self, q: float) -> float:
        """Quantile over all steps of all episodes (the lower neighbour: no interpolation with infinity)."""
        return float(np.quantile(np.concatenate(self.squared), q, method="lower"))

    def __str__(self) -> str:
        low, high = self.quartiles
        return (
            f"squared error {self.median:.3g} [{low:.3g}, {high:.3g}] over {len(self.squared)} episodes, "
            f"{100 * self.diverged_fraction:.0f} % diverged"
        )


def rollout_errors(
    model: LiftedModel,
    episodes: Episodes,
    states: str | Sequence[int] | Sequence[str] | None = None,
    weights: Array | None = None,
) -> RolloutErrors:
    """Roll every episode out from its first states and compare with the truth.

    ``states``: name of an output group of the model, state names or indices (default: all). ``weights`` (n,) multiply
    the errors of the states before they are squared. Episodes of equal length are rolled out side by side.
    Raises ValueError for episodes of other sizes or another time step, or shorter than the model's delays.
    """
    check_same_system(model, episodes)
    chosen = state_indices(model, states)
    weight = np.ones(len(chosen)) if weights is None else np.asarray(weights)[chosen]
    starts = [episodes.start(i, model.n_delays) for i in range(len(episodes))]
    squared: list[Array] = [np.empty(0)] * len(starts)
    diverged = np.zeros(len(starts), dtype=bool)
    for length in sorted({len(start.inputs) for start in starts}):
        same = [i for i, start in enumerate(starts) if len(start.inputs) == length]
        z0 = np.stack([model.lift(starts[i].x_history, starts[i].u_history) for i in same])
        result = model.rollout(z0, np.stack([starts[i].inputs for i in same]))
        for position, i in enumerate(same):
            error = (result.x[position] - starts[i].states)[1:, chosen] * weight
            squared[i] = (error**2).sum(axis=1)
            at = int(np.asarray(result.diverged_at)[position])
            if at >= 0:
                diverged[i] = True
                squared[i][max(at - 1, 0) :] = np.inf
    return RolloutErrors(squared=tuple(squared), diverged=diverged)


def check_same_system(model: LiftedModel, episodes: Episodes) -> None:
    """Raises ValueError if the episodes have other sizes or another time step than the model."""
    if (episodes.n_states, episodes.n_inputs) != (model.n_states, model.n_inputs):
        raise ValueError(
            f"the episodes have {episodes.n_states} states and {episodes.n_inputs} inputs; "
            f"the model {model.n_states} and {model.n_inputs}"
        )
    if abs(episodes.dt - model.dt) > 1e-9 * model.dt:
        raise ValueError(f"the episodes have dt = {episodes.dt:g} s; the model was fitted for {model.dt:g} s")


def state_indices(model: LiftedModel, states: str | Sequence[int] | Sequence[str] | None) -> NDArray[np.int64]:
    """Indices of an output group, of named states, or of states given by index; all states for None."""
    if states is None:
        return np.arange(model.n_states)
    if isinstance(states, str):
        if states in model.outputs:
            return np.array(model.outputs[states], dtype=np.int64)
        states = [states]
    names = {name: i for i, name in enumerate(model.state_names)}
    indices = [names.get(s, -1) if isinstance(s, str) else int(s) for s in states]
    if not indices or any(not 0 <= i < model.n_states for i in indices):
        known = ", ".join([*model.outputs, *model.state_names][:8])
        raise ValueError(f"states = {states!r}; expected an output group, state names or indices ({known}, ...)")
    return np.array(indices, dtype=np.int64)
