"""Does a model stay bounded under the inputs it is made for? No recording of the answer is needed to ask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array
from pisplit.data.episodes import Pairs
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import state_range

Array = NDArray[np.float64]

#: A model that takes a state so many times as far as the data of its quantity reach is not bounded: inputs of the
#: recorded kind do not move a stable system there, and a model that goes so far is on its way to where it diverges.
EXCURSION = 3.0
#: Roll-outs side by side.
BATCH = 16


@dataclass(frozen=True)
class Excitation:
    """Roll-outs that a model has to survive: E input sequences from states of the data.

    inputs     (E, T, m)
    x_history  (E, D+1, n) and u_history (E, D, m), where each begins: the pair of the data with the most similar input
    limit      (n,) magnitude that no state may exceed
    """

    inputs: Array
    x_history: Array
    u_history: Array
    limit: Array

    @classmethod
    def of(cls, inputs: ArrayLike, data: Sequence[Pairs], quantities: Sequence[str]) -> Excitation:
        """Input sequences (E, T, m) beginning in the largest of ``data``; limits from all of them, by quantity (n,).

        Raises ValueError for inputs of another shape.
        """
        sequences = finite_array(inputs, "excitation", (None, None, data[0].inputs.shape[1]))
        if 0 in sequences.shape:
            raise ValueError(f"excitation has the shape {sequences.shape}; expected input sequences (E, T, m)")
        starts = max(data, key=len)
        u = starts.u
        nearest = starts.take([int(np.argmin(((u - first) ** 2).sum(axis=1))) for first in sequences[:, 0]])
        return cls(
            inputs=sequences,
            x_history=nearest.x_history,
            u_history=nearest.u_history,
            limit=EXCURSION * np.max([state_range(pairs, quantities) for pairs in data], axis=0),
        )

    def bounds(self, model: LiftedModel) -> bool:
        """True if no state of any roll-out exceeds its limit."""
        starts = [model.lift(x, u) for x, u in zip(self.x_history, self.u_history, strict=True)]
        for first in range(0, len(starts), BATCH):  # most models that are not bounded show it at once
            part = slice(first, first + BATCH)
            found = model.rollout(np.stack(starts[part]), self.inputs[part])
            if np.any(found.diverged) or np.any(np.abs(found.x) > self.limit):
                return False
        return True
