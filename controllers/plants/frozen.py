"""Sensors that freeze: they go on to send the last value that they saw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pisplit.checks import Array, count
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.plants.measurements import _positions
from pisplit.controllers.plants.wrapped import WrappedPlant


class FrozenMeasurements(WrappedPlant):
    """Some states are measured as they were in sample ``start``, for so many ``steps``; then they live again.

    Args:
        plant: the inner plant.
        states: names or positions of the states that freeze.
        start: sample that is repeated, 0 being the state at rest.
        steps: how often it is repeated; for ever when not given.
    """

    def __init__(self, plant: Plant, states: Sequence[int | str], start: int, steps: int | None = None) -> None:
        super().__init__(plant)
        self.start = count(start, "start", 0)
        self.steps = None if steps is None else count(steps, "steps")
        self._chosen = _positions(plant, states)
        self._held = np.zeros(len(self._chosen))
        self._sample = 0

    def _begin(self, u: Array, state: Array) -> None:
        self._sample = 0

    def _measured(self, state: Array) -> Array:
        since = self._sample - self.start
        if since == 0:
            self._held = state[self._chosen].copy()
        elif since > 0 and (self.steps is None or since <= self.steps):
            state[self._chosen] = self._held
        self._sample += 1
        return state

    def _own(self) -> Any:
        return self._sample, self._held.copy()

    def _take(self, own: Any) -> None:
        self._sample, self._held = own[0], own[1].copy()
