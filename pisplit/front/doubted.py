"""An identified model in the place of the system, with what it is known to miss."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.plant import PlantStep
from pisplit.controllers.plants import ModelPlant
from pisplit.data.episodes import Episodes
from pisplit.evaluation.predicted import NearestResiduals
from pisplit.lifted.model import LiftedModel

#: Pairs from which residuals are taken at most.
MOST = 1000
#: Pairs over which residuals are averaged: those of the nearest alone jump as the nearest changes.
NEIGHBOURS = 20


class DoubtedPlant(ModelPlant):
    """A plant that moves as a ``model`` predicts, off at every step by what it missed in the recorded pairs nearby.

    Loops on it show what the errors of a model do that no other candidate comes near: see
    :func:`pisplit.predicted_error`.

    Args:
        model: what moves.
        x_rest: measured state (n,) at rest, where runs start.
        held: recordings of the model's columns that it did not learn from.
    """

    def __init__(self, model: LiftedModel, x_rest: ArrayLike, held: Episodes) -> None:
        super().__init__(model, x_rest)
        pairs = held.pairs(model.n_delays)
        some = np.unique(np.linspace(0, len(pairs) - 1, MOST).astype(np.int64))
        self._nearest = NearestResiduals(model, pairs.take(some) if len(pairs) > MOST else pairs)
        self._before = np.zeros(self.n_inputs)

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """The state at rest (n,), as it has been under ``u0`` (m,): see ``ModelPlant``."""
        self._before = np.zeros(self.n_inputs) if u0 is None else finite_array(u0, "u0", (self.n_inputs,))
        return super().reset(u0)

    def step(self, u: ArrayLike) -> PlantStep:
        """The state after one step under ``u`` (m,): see ``ModelPlant``."""
        inputs = finite_array(u, "u", (self.n_inputs,))
        with np.errstate(over="ignore", invalid="ignore"):
            state = self.model.read(self._z)
            missed = self._nearest.mean(state[None], self._before[None], inputs[None], NEIGHBOURS)[0]
        moved = super().step(inputs)
        if not moved.ok:
            return moved
        self._z, self._before = self._z + missed, inputs
        return PlantStep(self.model.read(self._z), True, "")
