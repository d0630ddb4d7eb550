"""Open-loop roll-outs of whole episodes against the truth."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.checks import finite_array
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, States, matched, model_of, state_indices
from pisplit.evaluation.pieces import SIDE_BY_SIDE, pieces
from pisplit.lifted.model import LiftedModel
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@brief
@dataclass(frozen=True)
class RolloutErrors:
    """Squared errors of open-loop roll-outs, |x_hat - x|^2 summed over the chosen states.

    squared   one array (T_i,) an episode, a value a predicted step; infinite from the step of divergence on
    diverged  (E,) flags
    unit      of ``squared``: "m^2"; "" where it is not known, or not one
    """

    squared: tuple[Array, ...]
    diverged: NDArray[np.bool_]
    unit: str = ""

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
        """Quantile ``q`` in [0, 1] over all steps of all episodes.

        It is the lower neighbour: no interpolation with infinity.
        """
        values = np.concatenate(self.squared)
        position = int(q * (len(values) - 1))
        values.partition(position)  # in place: as large as the errors, not twice
        return float(values[position])

    def __str__(self) -> str:
        low, high = self.quartiles
        return (
            f"squared error {self.median:.3g} [{low:.3g}, {high:.3g}]{' ' + self.unit if self.unit else ''} "
            f"over {len(self.squared)} episodes, "
            f"{100 * self.diverged_fraction:.0f} % diverged"
        )

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Squared errors over the steps of the roll-outs with their median; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_rollouts

        return plot_rollouts(self, path)


@one_blas_thread()
def rollout_errors(
    model: LiftedModel | Fitted,
    episodes: Episodes,
    states: States = None,
    weights: Array | None = None,
) -> RolloutErrors:
    """Roll every episode out from its first states and compare with the truth; columns are matched by name.

    ``model``: a LiftedModel, or an estimator that was fitted. ``episodes``: test data with its states and inputs.
    ``states``: name of an output group of the model, state names or indices (default: all). ``weights`` (n,) multiply
    the errors of the states before they are squared. Episodes of equal length are rolled out side by side, in
    pieces that keep memory small at any number of pairs.
    Raises ValueError for episodes of other names, units, sizes or time step, or shorter than the model's delays.
    """
    model = model_of(model)
    episodes = matched(model, episodes, states)
    chosen = state_indices(model, states)
    weight = np.ones(len(chosen)) if weights is None else finite_array(weights, "weights", (model.n_states,))[chosen]
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
    unit = squared_unit([model.units[i] for i in chosen]) if weights is None else ""
    return RolloutErrors(squared=squared, diverged=diverged, unit=unit)


def squared_unit(units: Sequence[str]) -> str:
    """Unit of a sum of squares of values in ``units``, "" if they are not all of one known unit."""
    if len(set(units)) != 1 or not units[0]:
        return ""
    return f"({units[0]})^2" if "/" in units[0] else f"{units[0]}^2"


def _groups(lengths: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Episodes of one length, not too many at once."""
    for length in np.unique(lengths):
        same = np.flatnonzero(lengths == length)
        yield from (same[first : first + SIDE_BY_SIDE] for first in range(0, len(same), SIDE_BY_SIDE))
