"""Whether the system is still the one that was recorded: one-step innovations, held against those of recordings."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields, replace

import numpy as np

from pisplit.checks import Array, positive
from pisplit.controllers.estimation.input_faults import InputFault, input_faults
from pisplit.controllers.loop.following import LoopStep
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, States, matched, model_of, state_indices
from pisplit.lifted.model import LiftedModel

#: Times the largest mean square innovation of the recordings from which on a warning is given, and how much worse it
#: has to become for the next one.
ALARM, AGAIN = 4.0, 10.0
#: Parts of the window over which innovations are averaged, and the least steps of each.
PARTS, LEAST = (0.5, 1.0), 3
#: Part of the usual mean square innovation that is expected of a system that does not move.
AT_REST = 0.1
#: Part of the innovations that is left under a fault of the inputs where it is one, and the level, in parts of the
#: alarm, from which on it is looked for where all of them are turned round: no other error looks like that.
LEFT, SUSPECTED = 0.3, 0.3


@dataclass(frozen=True, eq=False)
class _Seen:
    """Steps of a run: lifted from ``states`` (T, D + 1, n) under ``inputs`` (T, D + 1, m), the last of them the one
    that acts; ``after`` (T, n) was measured then, NaN where it was not."""

    states: Array
    inputs: Array
    after: Array


class InnovationWatch:
    """A callback of closed loops that warns where measurements leave one-step predictions as they never did in
    recordings: a payload, a force, a broken tendon, another arm.

    The innovations, relative to their usual size, state by state, and to what is usual for the motion of the moment
    (models err more where more moves), are averaged over ``window`` seconds and half of that. Each is
    compared with the worst such stretch of the ``episodes``; a mean square four times as large is said: a warning, a
    note in the log, and again when it is ten times worse. Noise, delays and whatever else was in the recordings is
    known by that. States that are not measured count for nothing. Where innovations
    nearly vanish under flipped signs, or with inputs in each other's place, that is said too, once, by name.

    Delays and servos that the controller is told of are known here: the inputs are those that it takes to act
    (``Move.acting``).

    Args:
        model: the model, or a fitted estimator.
        episodes: recordings of the system as it should be, best those that the model did not learn from.
        states: output group, names or indices that are watched; all when not given.
        window: seconds.

    Attributes:
        level: mean square innovation in parts of that which warns, of the window that is worst; 1 and more is an alarm.
        fault: the name of the fault of the inputs that was found, empty without one.

    Raises ValueError for episodes that do not fit the model or are shorter than the window.

    Source: Basseville and Nikiforov, *Detection of Abrupt Changes* (1993), chapters 2 and 7: windowed chi-squared tests
    and banks of hypotheses.
    """

    def __init__(
        self, model: LiftedModel | Fitted, episodes: Episodes, states: States = None, window: float = 0.5
    ) -> None:
        self.model = found = model_of(model, "model")
        data = matched(found, episodes)
        self._rows = state_indices(found, states)
        whole = max(LEAST, round(positive(window, "window", "s") / found.dt))
        self._windows = sorted({max(LEAST, round(part * whole)) for part in PARTS})
        D = found.n_delays
        runs = []
        for x, u in zip(data.xs, data.us, strict=True):
            if len(u) >= D + whole:
                at = np.arange(D, len(u))
                past = at[:, None] + np.arange(-D, 1)
                runs.append(_Seen(x[past], u[past], x[at + 1]))
        if not runs:
            raise ValueError(f"no episode has the {D + whole} steps of a window; give longer ones")
        self._reach = np.maximum(
            np.max([np.abs(r.inputs - found.input_offset).max(axis=(0, 1)) for r in runs], axis=0), 1e-300
        )
        self._size = np.ones(len(self._rows))
        misses = [self._missed(run) for run in runs]
        size = np.sqrt(np.mean(np.concatenate(misses) ** 2, axis=0))
        self._size = np.maximum(size, 1e-9 * found.state_range[self._rows] + 1e-300)
        squares = [np.mean((miss / self._size) ** 2, axis=1) for miss in misses]
        motions = [self._motion(run) for run in runs]
        self._moved = np.maximum(np.concatenate(motions).mean(axis=0), 1e-300)
        relative = [q / self._expected(a) for q, a in zip(squares, motions, strict=True)]
        self._limits = {n: ALARM * max(float(_averaged(q, n).max()) for q in relative) for n in self._windows}
        #: What already explains the recordings better than the inputs as they are is no fault.
        self._faults = tuple(f for f in input_faults(found) if not any(self._left(f, run) < LEFT for run in runs))
        self._begin()

    def _begin(self) -> None:
        D = self.model.n_delays
        self._states: deque[Array] = deque(maxlen=D + 1)
        self._inputs: deque[Array] = deque(maxlen=D + 1)
        self._steps: deque[_Seen] = deque(maxlen=self._windows[-1])
        self._squares: deque[Array] = deque(maxlen=self._windows[-1])
        self._said, self.level, self.fault = 1.0, 0.0, ""

    def _predicted(self, seen: _Seen) -> Array:
        """States (T, n) one step after those of ``seen``."""
        z = self.model.lift(seen.states, seen.inputs[:, :-1])
        return self.model.read(self.model.rollout(z, seen.inputs[:, -1:]).z[:, 1])

    def _missed(self, seen: _Seen) -> Array:
        """Innovations (T, p) of the watched states in parts of their usual size."""
        return np.asarray((seen.after - self._predicted(seen))[:, self._rows] / self._size)

    def _motion(self, seen: _Seen) -> Array:
        """What moves (T, 3): change of the states in a step, deflection, and inputs; mean squares in parts of their
        ranges."""
        model, rows, span = self.model, self._rows, self.model.state_range[self._rows]
        before = seen.states[:, -1]
        changed = np.nan_to_num((seen.after - before)[:, rows] / span) ** 2
        deflected = ((before - model.d)[:, rows] / span) ** 2
        pushed = ((seen.inputs[:, -1] - model.input_offset) / self._reach) ** 2
        return np.stack([changed.mean(axis=1), deflected.mean(axis=1), pushed.mean(axis=1)], axis=1)

    def _expected(self, motion: Array) -> Array:
        """Mean square innovation (T,) that is usual under a ``motion`` (T, 3), one for that of the recordings."""
        return np.asarray(AT_REST + (1.0 - AT_REST) * (motion / self._moved).mean(axis=1))

    def __call__(self, step: LoopStep) -> Warning | None:
        """Take in a ``step``; a warning where innovations are larger than ever recorded."""
        if step.k == 0:
            self._begin()
        D = self.model.n_delays
        measured = step.x.copy()
        measured[list(step.move.stuck)] = np.nan
        self._inputs.append(step.u if step.move.acting is None else step.move.acting)
        if len(self._states) == D + 1:
            self._take_in(_Seen(np.array(self._states)[None], np.array(self._inputs)[None], measured[None]))
        if np.isnan(measured).any():
            self._states.clear()
        else:
            self._states.append(measured)
        return self._warning(step.t)

    def _take_in(self, seen: _Seen) -> None:
        self._steps.append(seen)
        missed = np.nan_to_num(self._missed(seen)[0])
        self._squares.append(missed**2 / self._expected(self._motion(seen))[0])

    def _warning(self, t: float) -> Warning | None:
        """What there is to say at the time ``t`` [s]."""
        squares = np.array(self._squares)
        if len(squares) < self._windows[0]:
            return None
        levels = {n: float(squares[-n:].mean() / limit) for n, limit in self._limits.items() if len(squares) >= n}
        worst = max(levels, key=levels.__getitem__)
        self.level = levels[worst]
        if self.level >= SUSPECTED and not self.fault and (name := self._fault(self.level < 1.0)):
            self.fault = name
            return UserWarning(f"t = {t:.2f} s: {name}")
        if not self.level >= self._said:
            return None
        self._said = AGAIN * self.level
        i = int(np.argmax(squares[-worst:].mean(axis=0)))
        name, times = self.model.state_names[self._rows[i]], np.sqrt(ALARM * self.level)
        return UserWarning(
            f"t = {t:.2f} s: innovations are {times:.3g} times the largest of the recordings, most in {name}: "
            "a payload, a force, a fault, or a model of another system"
        )

    def _fault(self, turned: bool) -> str:
        """The name of the fault of the inputs that explains the last steps best, empty where none does.

        ``turned``: whether it has to be that all of them act the other way round.
        """
        steps = self._steps
        seen = _Seen(*(np.concatenate([getattr(s, f.name) for s in steps]) for f in fields(_Seen)))
        left = {fault: self._left(fault, seen) for fault in self._faults if fault.turned or not turned}
        best = min(left, key=left.__getitem__, default=None)
        return best.name if best is not None and left[best] < LEFT else ""

    def _left(self, fault: InputFault, seen: _Seen) -> float:
        """The part of the innovations that is left where the inputs of ``seen`` act as under the ``fault``."""
        acting = replace(seen, inputs=fault.acting(seen.inputs, self.model.input_offset))
        missed, left = (float(np.nansum(self._missed(s) ** 2)) for s in (seen, acting))
        return left / missed if missed > 0.0 else 1.0


def _averaged(squares: Array, n: int) -> Array:
    """Means of ``squares`` (T,) over each ``n`` steps in a row (T - n + 1,)."""
    sums = np.cumsum(np.concatenate([[0.0], squares]))
    return np.asarray((sums[n:] - sums[:-n]) / n)
