"""Whether the system is still the one that was recorded: one-step innovations, held against those of recordings."""

from __future__ import annotations

from collections import deque

import numpy as np

from pisplit.checks import Array, positive
from pisplit.controllers.loop.following import LoopStep
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, States, matched, model_of, state_indices
from pisplit.lifted.model import LiftedModel

#: Times the largest mean square innovation of the recordings from which on a warning is given, and how much worse it
#: has to become for the next one.
ALARM, AGAIN = 4.0, 10.0
#: Gain of the inputs, in parts of the model's, below which they act the other way round; part of the innovations that
#: it has to explain, and windows that it is found over.
OPPOSITE, EXPLAINED, WINDOWS = -0.3, 0.5, 2


class InnovationWatch:
    """A callback of closed loops that warns where measurements leave one-step predictions as they never did in
    recordings: a payload, a force, a broken tendon, another arm.

    The innovations of the last ``window`` seconds, relative to their usual size, state by state, are compared with the
    worst such stretch of the ``episodes``; a mean square four times as large is said: a warning, a note in the log, and
    again when it is ten times worse. Noise, delays and whatever else was in the recordings is known by that. States
    that are not measured count for nothing. Where inputs act the other way round, by what they explain of the
    innovations, that is said too, once: a flipped sign, or wires that were swapped.

    Args:
        model: the model, or a fitted estimator.
        episodes: recordings of the system as it should be, best those that the model did not learn from.
        states: output group, names or indices that are watched; all when not given.
        window: seconds.

    Attributes:
        level: mean square innovation of the last window in parts of that which warns; 1 and more is an alarm.
        gain: how much of the model's answer to the inputs was seen over the last two windows, 1 where all is well; None
            where they tell nothing.

    Raises ValueError for episodes that do not fit the model or are shorter than the window.
    """

    def __init__(
        self, model: LiftedModel | Fitted, episodes: Episodes, states: States = None, window: float = 0.5
    ) -> None:
        self.model = found = model_of(model, "model")
        data = matched(found, episodes)
        self._rows = state_indices(found, states)
        self._n = max(3, round(positive(window, "window", "s") / found.dt))
        D, runs, answers = found.n_delays, [], []
        for x, u in zip(data.xs, data.us, strict=True):
            if len(u) < D + self._n:
                continue
            at = np.arange(D, len(u))
            z = found.lift(x[at[:, None] + np.arange(-D, 1)], u[at[:, None] + np.arange(-D, 0)])
            predicted, still = (
                found.read(found.rollout(z, v[:, None]).z[:, 1])[:, self._rows]
                for v in (u[at], np.broadcast_to(found.input_offset, u[at].shape))
            )
            runs.append(x[at + 1][:, self._rows] - predicted)
            answers.append(predicted - still)
        if not runs:
            raise ValueError(f"no episode has the {D + self._n} steps of a window; give longer ones")
        size = np.sqrt(np.mean(np.concatenate(runs) ** 2, axis=0))
        self._size = np.maximum(size, 1e-9 * found.state_range[self._rows] + 1e-300)
        worst = max(float(self._smoothed((run / self._size) ** 2).max()) for run in runs)
        self._limit = ALARM * worst
        #: Signs are no matter of a model whose recordings seem to have them flipped.
        span = WINDOWS * self._n
        parts = [
            (run[k : k + span] / self._size, answer[k : k + span] / self._size)
            for run, answer in zip(runs, answers, strict=True)
            for k in range(0, len(run) - span + 1, self._n)
        ]
        self._sure = not any(self._opposite(_gain(*part)) for part in parts)
        self._begin()

    def _begin(self) -> None:
        D = self.model.n_delays
        self._states: deque[Array] = deque(maxlen=D + 1)
        self._inputs: deque[Array] = deque(maxlen=D + 1)
        self._seen: deque[Array] = deque(maxlen=self._n)
        self._answers: deque[Array] = deque(maxlen=WINDOWS * self._n)
        self._missed: deque[Array] = deque(maxlen=WINDOWS * self._n)
        self._said, self.level = 1.0, 0.0
        self.gain: float | None = None
        self._turned = False

    @staticmethod
    def _opposite(told: tuple[float | None, float]) -> bool:
        return told[0] is not None and told[0] < OPPOSITE and told[1] > EXPLAINED

    def _smoothed(self, squares: Array) -> Array:
        sums = np.cumsum(np.vstack([np.zeros(squares.shape[1]), squares]), axis=0)
        return np.asarray((sums[self._n :] - sums[: -self._n]).mean(axis=1) / self._n)

    def __call__(self, step: LoopStep) -> Warning | None:
        """Take in a ``step``; a warning where innovations are larger than ever recorded."""
        if step.k == 0:
            self._begin()
        D = self.model.n_delays
        self._inputs.append(step.u)
        if len(self._states) == D + 1 and not np.isnan(self._states).any():
            inputs = np.array(self._inputs)
            z = self.model.lift(np.array(self._states), inputs[:-1])
            predicted = self.model.read(self.model.step(z, inputs[-1]))
            miss = (step.x - predicted)[self._rows] / self._size
            answer = (predicted - self.model.read(self.model.step(z, self.model.input_offset)))[self._rows] / self._size
            self._seen.append(np.where(np.isnan(miss), 0.0, miss) ** 2)
            self._missed.append(np.where(np.isnan(miss), 0.0, miss))
            self._answers.append(np.where(np.isnan(miss), 0.0, answer))
        self._states.append(step.x)
        if self._sure and not self._turned and len(self._missed) == WINDOWS * self._n:
            told = _gain(np.array(self._missed), np.array(self._answers))
            self.gain, self._turned = told[0], self._opposite(told)
            if self._turned:
                return UserWarning(
                    f"t = {step.t:.2f} s: the inputs act the other way round, {told[0]:.2g} times as the model says: a "
                    "flipped sign, or wires that were swapped"
                )
        if len(self._seen) < self._n:
            return None
        squares = np.array(self._seen)
        self.level = float(squares.mean() / self._limit)
        if not self.level >= self._said:
            return None
        self._said = AGAIN * self.level
        i = int(np.argmax(squares.mean(axis=0)))
        name = self.model.state_names[self._rows[i]]
        times = np.sqrt(ALARM * self.level)
        return UserWarning(
            f"t = {step.t:.2f} s: innovations are {times:.3g} times the largest of the recordings, most in {name}: "
            "a payload, a force, a fault, or a model of another system"
        )


def _gain(missed: Array, answers: Array) -> tuple[float | None, float]:
    """How much of the model's ``answers`` (T, p) to the inputs was there, and the part of what was ``missed`` (T, p)
    that this explains, about the mean of each; None where the answers are smaller than what is usually missed."""
    e, m = answers - answers.mean(axis=0), missed - missed.mean(axis=0)
    power, all_missed = float((e**2).sum()), float((m**2).sum())
    if not (np.isfinite(power) and power > len(e)) or not all_missed > 0.0:
        return None, 0.0
    slope = float((e * m).sum()) / power
    return 1.0 + slope, slope**2 * power / all_missed
