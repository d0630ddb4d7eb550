"""Sensors that repeat one value while the arm must have moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array, count

#: What the past counts for a step later, in the sums of predicted motion and of moved inputs.
MEMORY = 0.9
#: Predicted motion, in parts of the state's range, and motion of inputs, in half box widths, that a live sensor shows.
MOVED, DRIVEN = 0.01, 0.01
#: So many times the smallest change seen of a reading (the resolution of its sensor) are no motion either.
QUANTA = 3.0

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class StuckState:
    """``last`` readings (n,) and the command (m,) before them, ``repeats`` (n,) in a row, predicted ``motion`` (n,)
    since, smallest change ``quantum`` (n,) seen, motion ``driven`` of the inputs, which are ``stuck`` (n,)."""

    last: Array
    command: Array | None
    repeats: NDArray[np.int64]
    motion: Array
    quantum: Array
    driven: float
    stuck: Mask


class StuckSensors:
    """Tells readings that repeat a value, to the last bit, ``steps`` times in a row although the arm must have moved.

    It must have where the inputs moved and where one-step predictions, summed over the repeats with a memory of ten
    steps, lead away by more than 1 % of the state's range and three times the resolution of the sensor, which is the
    smallest change seen of it. So states that are constant, coarse sensors and an arm at rest are not taken for stuck.
    A reading stays stuck until it changes. States that never moved in the training data are not watched.

    Args:
        steps: repeats before a reading is doubted.
        state_range: range (n,) of the states in the training data.
        amplitude: half box widths (m,) of the inputs.

    Raises ValueError for ``steps`` below 1.
    """

    def __init__(self, steps: int, state_range: Array, amplitude: Array) -> None:
        self.steps = count(steps, "stuck_after")
        self._threshold = np.where(state_range > 0.0, MOVED * state_range, np.inf)
        self._amplitude = amplitude
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        n = len(self._threshold)
        nothing = np.zeros(n)
        self._state = StuckState(
            np.full(n, np.nan), None, np.zeros(n, np.int64), nothing, np.full(n, np.inf), 0.0, np.zeros(n, bool)
        )

    def since(self, stuck: Mask) -> int:
        """For how many samples the readings ``stuck`` (n,) have repeated themselves at most, but this one."""
        return int(self._state.repeats[stuck].max(initial=1)) - 1

    @property
    def known(self) -> Mask:
        """Readings (n,) that were stuck before this sample."""
        return self._state.stuck

    def snapshot(self) -> StuckState:
        """What the next answers depend on."""
        return self._state

    def restore(self, state: StuckState) -> None:
        """Go on from the ``state`` of a ``snapshot``."""
        self._state = state

    def __call__(self, x: Array, u: Array, predicted: Callable[[NDArray[np.intp]], Array] | None) -> Mask:
        """Which entries (n,) of the measurement ``x`` (n,), NaN where there is none, are stuck.

        ``u`` (m,): the command before it; ``predicted``: indices (k,) -> their predicted states (k,), None at first.
        """
        s = self._state
        moved = 0.0 if s.command is None else float(np.max(np.abs(u - s.command) / self._amplitude))
        driven = MEMORY * s.driven + moved
        change = np.abs(x - s.last)
        same = change == 0.0
        absent = np.isnan(x)
        if not same.any() and not s.stuck.any():  # the usual case
            quantum = np.fmin(s.quantum, change)
            last = np.where(absent, s.last, x) if absent.any() else x.copy()
            repeats, motion = np.where(absent, s.repeats, 0), np.where(absent, s.motion, 0.0)
            self._state = StuckState(last, u.copy(), repeats, motion, quantum, driven, s.stuck)
            return s.stuck
        repeats = np.where(same, s.repeats + 1, np.where(absent, s.repeats, 0))
        motion = np.where(same | absent, MEMORY * s.motion, 0.0)
        again = np.flatnonzero(same & np.isfinite(self._threshold))
        if predicted is not None and len(again):
            ahead = predicted(again) - x[again]
            motion[again] += np.where(np.isfinite(ahead), ahead, 0.0)
        quantum = np.where(same, s.quantum, np.fmin(s.quantum, change))
        resolution = np.where(np.isfinite(quantum), QUANTA * quantum, 0.0)
        far = np.abs(motion) > np.maximum(self._threshold, resolution)
        stuck = (same | absent) & (s.stuck | ((repeats >= self.steps) & far & (driven > DRIVEN)))
        last = np.where(absent, s.last, x)
        self._state = StuckState(last, u.copy(), repeats, motion, quantum, driven, stuck)
        return stuck & ~absent
