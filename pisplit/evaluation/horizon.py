"""Roll-out errors by horizon: how far ahead a model may be trusted."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.checks import count
from pisplit.data.episodes import Episodes
from pisplit.data.noise import noise_margins
from pisplit.evaluation.matching import Fitted, States, matched, model_of, state_indices
from pisplit.evaluation.pieces import SIDE_BY_SIDE, pieces
from pisplit.lifted.model import LiftedModel
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Relative spread that rounding alone may make.
ROUNDING = 1e-13


@brief
@dataclass(frozen=True)
class HorizonErrors:
    """Errors h steps after the start of roll-outs that start along the episodes.

    horizons    (H,) steps ahead
    rms         (H, s) root mean square error of every state, in its unit; infinite if a roll-out diverged by then
    normalised  (H,) root mean square over states of rms / spread of its quantity in the test data, or noise where
                that varies alone: 1 is as bad as predicting the mean; states that hardly move do not decide it
    diverged    (H,) fraction of roll-outs that diverged by then
    starts      number of roll-outs
    names       (s,) of the states, with ``units`` (s,)
    spread      (s,) standard deviation of every state in the test data, in its unit
    """

    horizons: NDArray[np.int64]
    rms: Array
    normalised: Array
    diverged: Array
    starts: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    spread: Array

    def __str__(self) -> str:
        lines = [f"{'steps':>6} {'normalised':>11} {'diverged':>9}  worst state"]
        for h, error, fraction, rms in zip(self.horizons, self.normalised, self.diverged, self.rms, strict=True):
            worst = int(np.argmax(rms / np.where(self.spread > 0.0, self.spread, np.inf)))
            size = f"{rms[worst]:.3g} {self.units[worst]}".strip()
            lines.append(f"{h:>6} {error:>11.3g} {100.0 * fraction:>7.1f} %  {self.names[worst]}: {size}")
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Errors by horizon, of all states and of the six worst; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_horizons

        return plot_horizons(self, path)


@one_blas_thread()
def horizon_errors(
    model: LiftedModel | Fitted,
    episodes: Episodes,
    horizons: Sequence[int],
    states: States = None,
    stride: int = 1,
) -> HorizonErrors:
    """Roll out from every ``stride``-th step of every episode; errors after each of ``horizons`` steps.

    ``model``: a LiftedModel, or an estimator that was fitted. ``episodes``: test data with its states and inputs, which
    are matched by name. ``states``: output group, names or indices (default: all). Raises ValueError for other names,
    units, sizes or time step, and if no episode is as long as the longest horizon plus the delays of the model.
    """
    model = model_of(model)
    episodes = matched(model, episodes, states)
    ahead = np.array(sorted({count(h, "horizons") for h in horizons}), dtype=np.int64)
    if len(ahead) == 0:
        raise ValueError("horizons is empty; give numbers of steps")
    step = count(stride, "stride")
    chosen = state_indices(model, states)
    longest, delays = int(ahead[-1]), model.n_delays
    squared = np.zeros((len(ahead), len(chosen)))
    lost, starts = np.zeros(len(ahead)), 0
    for part in _starts(episodes, delays, longest, step):
        starts += len(part)
        z0 = model.lift(
            np.stack([episodes.xs[i][k - delays : k + 1] for i, k in part]),
            np.stack([episodes.us[i][k - delays : k] for i, k in part]),
        )
        for piece in pieces(model, z0, [episodes.us[i][k : k + longest] for i, k in part]):
            reached = np.flatnonzero((ahead > piece.first) & (ahead < piece.first + piece.x.shape[1]))
            truth = np.stack([episodes.xs[i][k + ahead[reached]] for i, k in part[piece.which]])[:, :, chosen]
            error = (piece.x[:, ahead[reached] - piece.first][:, :, chosen] - truth) ** 2
            gone = (piece.diverged_at[:, None] >= 0) & (piece.diverged_at[:, None] <= ahead)
            squared[reached] += np.where(gone[:, reached, None], 0.0, error).sum(axis=0)
            lost += gone.sum(axis=0)
    if starts == 0:
        raise ValueError(
            f"horizons up to {longest} with {delays} delays need episodes of {longest + delays} steps; "
            f"the longest has {max(map(len, episodes.us))}"
        )
    squared[lost > 0] = np.inf
    rms = np.sqrt(squared / starts)
    spread = _spread([x[:, chosen] for x in episodes.xs])
    size = _by_quantity(spread, [(episodes.quantities or ())[i] for i in chosen], noise_margins(episodes))
    varying = size > 0.0
    normalised = np.sqrt(((rms[:, varying] / size[varying]) ** 2).mean(axis=1)) if varying.any() else rms.max(axis=1)
    return HorizonErrors(
        horizons=ahead,
        rms=rms,
        normalised=normalised,
        diverged=lost / starts,
        starts=starts,
        names=tuple(model.state_names[i] for i in chosen),
        units=tuple(model.units[i] or (episodes.units or model.units)[i] for i in chosen),
        spread=spread,
    )


def _starts(episodes: Episodes, delays: int, longest: int, stride: int) -> Iterator[NDArray[np.int64]]:
    """Starts (E, 2), an episode and a step each, not too many at once."""
    waiting: list[NDArray[np.int64]] = []
    for i, u in enumerate(episodes.us):
        steps = np.arange(delays, len(u) - longest + 1, stride)
        waiting.append(np.column_stack([np.full(len(steps), i), steps]))
        if sum(map(len, waiting)) >= SIDE_BY_SIDE or i == len(episodes) - 1:
            found = np.concatenate(waiting)
            yield from (found[first : first + SIDE_BY_SIDE] for first in range(0, len(found), SIDE_BY_SIDE))
            waiting = []


def _by_quantity(spread: Array, quantities: Sequence[str], margins: Mapping[str, float]) -> Array:
    """Spread (k,) of the quantity of each state, its root mean square; more where it is noise alone."""
    labels = np.array(quantities)
    found = np.array([np.sqrt(np.mean(spread[labels == q] ** 2)) * margins.get(q, 1.0) for q in quantities])
    return np.asarray(found, dtype=np.float64)


def _spread(arrays: Sequence[Array]) -> Array:
    """Standard deviation (k,) of the rows (N_i, k) of all arrays; zero where only rounding varies."""
    size = sum(map(len, arrays))
    mean = np.sum([x.sum(axis=0) for x in arrays], axis=0) / size
    std = np.sqrt(np.sum([((x - mean) ** 2).sum(axis=0) for x in arrays], axis=0) / size)
    return np.where(std <= ROUNDING * np.abs(mean), 0.0, std)
