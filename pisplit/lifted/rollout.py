"""What a model predicts, and where that has left the range of what it learned."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: How many times the training range of a state is beyond all sense.
DIVERGENCE_FACTOR = 1e3


@brief
@dataclass(frozen=True)
class Rollout:
    """Open-loop prediction of one episode, or of E episodes (leading axis E on every field).

    x            (T+1, n) states; from the step of divergence on they hold the last admissible value
    z            (T+1, M) lifted states as computed (after divergence they may overflow)
    diverged     True if z overflowed or a state left 1e3 times the training range; (E,) of episodes
    diverged_at  first such step, or None; (E,) of episodes, -1 for "never"
    """

    x: Array
    z: Array
    diverged: bool | NDArray[np.bool_]
    diverged_at: int | NDArray[np.int64] | None

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The six states that move most over the steps; written to ``path`` where one is given."""
        from pisplit.lifted.pictures import plot_rollout

        return plot_rollout(self, path)

    @classmethod
    def of(cls, x: Array, z: Array, state_range: Array) -> Rollout:
        """Roll-outs of E episodes, states held where they diverge.

        Args:
            x: states (E, T+1, n) as computed.
            z: lifted states (E, T+1, M).
            state_range: (n,) that of the training data.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            within = np.abs(x) <= DIVERGENCE_FACTOR * state_range
            admissible = np.all(np.isfinite(z), axis=2) & np.all(within, axis=2)
        at = np.where(admissible.all(axis=1), -1, np.argmin(admissible, axis=1))
        x = np.array(x, order="C")  # apart from z, which a slice would share
        for episode in np.flatnonzero(at >= 0):
            x[episode, at[episode] :] = x[episode, max(at[episode] - 1, 0)]
        return cls(x=x, z=z, diverged=at >= 0, diverged_at=at.astype(np.int64))
