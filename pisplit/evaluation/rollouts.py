"""Open-loop roll-outs of whole episodes against the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes
from pisplit.evaluation.pieces import SIDE_BY_SIDE, pieces
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
        return float(sum(values.sum() for values in self.squared) / sum(map(len, self.squared)))

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
        values = np.concatenate(self.squared)
        position = int(q * (len(values) - 1))
        values.partition(position)  # in place: as large as the errors, not twice
        return float(values[position])

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
    the errors of the states before they are squared. Episodes of equal length are rolled out side by side, in
    pieces that keep memory small at any number of pairs.
    Raises ValueError for episodes of other sizes or another time step, or shorter than the model's delays.
    """
    check_same_system(model, episodes)
    chosen = state_indices(model, states)
    weight = np.ones(len(chosen)) if weights is None else np.asarray(weights)[chosen]
    delays = model.n_delays
    lengths = np.array([len(u) for u in episodes.us]) - delays
    if lengths.min() < 1:
        i = int(lengths.argmin())
        raise ValueError(f"episode {i} has {lengths[i] + delays} steps; {delays} delays need at least {delays + 1}")
    squared = tuple(np.full(length, np.inf) for length in lengths)
    diverged = np.zeros(len(squared), dtype=bool)
    for group in _groups(lengths):
        histories = [episodes.xs[i][: delays + 1] for i in group], [episodes.us[i][:delays] for i in group]
        z0 = model.lift(np.stack(histories[0]), np.stack(histories[1]))
        for piece in pieces(model, z0, [episodes.us[i][delays:] for i in group]):
            for row, position in enumerate(piece.which):
                i, at = group[position], int(piece.diverged_at[row])
                diverged[i] |= at >= 0
                end = piece.first + piece.x.shape[1] - 1 if at < 0 else at - 1
                if end > piece.first:
                    truth = episodes.xs[i][delays + piece.first + 1 : delays + end + 1, chosen]
                    error = (piece.x[row, 1 : end - piece.first + 1, chosen].T - truth) * weight
                    squared[i][piece.first : end] = (error**2).sum(axis=1)
    return RolloutErrors(squared=squared, diverged=diverged)


def _groups(lengths: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Episodes of one length, not too many at once."""
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        yield from (same[first : first + SIDE_BY_SIDE] for first in range(0, len(same), SIDE_BY_SIDE))


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
