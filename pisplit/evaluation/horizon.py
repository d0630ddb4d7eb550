"""Roll-out errors by horizon: how far ahead a model may be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import count
from pisplit.data.episodes import Episodes
from pisplit.evaluation.rollouts import check_same_system, state_indices
from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]

CHUNK = 256


@dataclass(frozen=True)
class HorizonErrors:
    """Errors h steps after the start of roll-outs that start along the episodes.

    horizons    (H,) steps ahead
    rms         (H, s) root mean square error of every state, in its unit; infinite if a roll-out diverged by then
    normalised  (H,) root mean square over states of rms / standard deviation of the state in the test data:
                1 is as bad as predicting the mean
    diverged    (H,) fraction of roll-outs that diverged by then
    starts      number of roll-outs
    names       (s,) of the states, with ``units`` (s,)
    """

    horizons: NDArray[np.int64]
    rms: Array
    normalised: Array
    diverged: Array
    starts: int
    names: tuple[str, ...]
    units: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{'steps':>6} {'normalised':>11} {'diverged':>9}"]
        for h, error, fraction in zip(self.horizons, self.normalised, self.diverged, strict=True):
            lines.append(f"{h:>6} {error:>11.3g} {100.0 * fraction:>7.1f} %")
        return "\n".join(lines)


def horizon_errors(
    model: LiftedModel,
    episodes: Episodes,
    horizons: Sequence[int],
    states: str | Sequence[int] | Sequence[str] | None = None,
    stride: int = 1,
) -> HorizonErrors:
    """Roll out from every ``stride``-th step of every episode; errors after each of ``horizons`` steps.

    ``states``: output group, names or indices (default: all). Raises ValueError if no episode is as long as the longest
    horizon plus the delays of the model.
    """
    check_same_system(model, episodes)
    ahead = np.array(sorted({count(h, "horizons") for h in horizons}), dtype=np.int64)
    if len(ahead) == 0:
        raise ValueError("horizons is empty; give numbers of steps")
    step = count(stride, "stride")
    chosen = state_indices(model, states)
    longest, delays = int(ahead[-1]), model.n_delays
    starts = [(i, k) for i, u in enumerate(episodes.us) for k in range(delays, len(u) - longest + 1, step)]
    if not starts:
        raise ValueError(
            f"horizons up to {longest} with {delays} delays need episodes of {longest + delays} steps; "
            f"the longest has {max(map(len, episodes.us))}"
        )
    squared = np.zeros((len(ahead), len(chosen)))
    lost = np.zeros(len(ahead))
    for first in range(0, len(starts), CHUNK):
        part = starts[first : first + CHUNK]
        z0 = [model.lift(episodes.xs[i][k - delays : k + 1], episodes.us[i][k - delays : k]) for i, k in part]
        result = model.rollout(np.stack(z0), np.stack([episodes.us[i][k : k + longest] for i, k in part]))
        truth = np.stack([episodes.xs[i][k + ahead][:, chosen] for i, k in part])
        error = (result.x[:, ahead][:, :, chosen] - truth) ** 2
        at = np.asarray(result.diverged_at)[:, None]
        gone = (at >= 0) & (at <= ahead)
        lost += gone.sum(axis=0)
        squared += np.where(gone[:, :, None], np.inf, error).sum(axis=0)
    rms = np.sqrt(squared / len(starts))
    spread = episodes.stacked_states()[:, chosen].std(axis=0)
    varying = spread > 0.0
    normalised = np.sqrt(((rms[:, varying] / spread[varying]) ** 2).mean(axis=1)) if varying.any() else rms.max(axis=1)
    return HorizonErrors(
        horizons=ahead,
        rms=rms,
        normalised=normalised,
        diverged=lost / len(starts),
        starts=len(starts),
        names=tuple(model.state_names[i] for i in chosen),
        units=tuple((episodes.units or [""] * model.n_states)[i] for i in chosen),
    )
