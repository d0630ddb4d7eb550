"""A controller whose numbers follow from model and data."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import Array
from pisplit.controllers.loop.tracking import tracked_states
from pisplit.controllers.mpc.limits import input_limits
from pisplit.controllers.mpc.mpc import GAIN, MPC
from pisplit.controllers.tuning.innovations import Innovations, Misses, innovations
from pisplit.controllers.tuning.spectrum import LONGEST, SHORTEST, horizon_of, impulses, slow_modes, steps_of
from pisplit.controllers.tuning.trials import InLiftedState, PushedModel, Trials, references_within
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, matched, model_of
from pisplit.lifted.model import LiftedModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Where the search begins, and what it may choose.
FIRST_WEIGHT, GAINS = 0.1, (0.01, 0.6)
#: A bolder choice must be better by this factor than a cautious one.
BETTER = 0.75
#: Error of the trials, in parts of the circle's radius, that is called poor.
POOR = 0.2


@dataclass(frozen=True)
class Trial:
    """``error`` of the loops, in parts of the circle's radius, with ``horizon``, ``rate_weight`` and ``gain``.

    ``defaults``: those of :class:`MPC`, with its own scale of the outputs too.
    """

    horizon: int
    rate_weight: float
    gain: float
    error: float
    defaults: bool = False

    def __str__(self) -> str:
        named = "defaults: " if self.defaults else ""
        return (
            f"{named}horizon {self.horizon}, rate weight {self.rate_weight:.3g}, gain {self.gain:.3g}: {self.error:.3g}"
        )


@dataclass(frozen=True, eq=False)
class Tuned:
    """A controller ``mpc`` whose numbers were chosen, where it rests (``u_rest`` (m,), middle of the limits), the
    ``trials``, best first, the one ``chosen`` of them, the ``innovations`` of the recordings, the ``seconds`` it took,
    and ``notes`` in words."""

    mpc: MPC
    u_rest: Array
    trials: tuple[Trial, ...]
    chosen: Trial
    innovations: Innovations
    seconds: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(self.notes)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Errors of the trials over each number that was chosen; written to ``path`` where one is given."""
        from pisplit.controllers.tuning.pictures import plot_trials

        return plot_trials(self, path)


def tune(
    model: LiftedModel | Fitted,
    episodes: Episodes,
    u_min: ArrayLike,
    u_max: ArrayLike,
    du_max: ArrayLike,
    track: str | Sequence[int | str] = "tip",
    axes: Sequence[int] | None = None,
    progress: bool = True,
    **settings: Any,
) -> Tuned:
    """Choose horizon, rate weight and gain of the disturbance estimate of an :class:`MPC` by loops on the model itself.

    The horizon is a period of the slowest mode that matters in the outputs' answer to the inputs, found in the impulse
    response. The gain begins where the innovations on the ``episodes`` are smallest. Then weight (seven decades), gain
    and horizon are chosen one after the other by closed loops: on the model, pushed at every step by what it
    missed in the recordings, in proportion to its motion, along a circle and a jump of half the box. Everything is
    relative to box, range of the outputs in the data and modes of the model, so that units and sizes do not matter.
    The defaults of :class:`MPC` are tried, too, and taken where nothing is better than them by more than a third.

    model               the model, linear, bilinear or re-lifted, or a fitted estimator
    episodes            recordings with its states and inputs, best those that it did not learn from
    u_min, u_max, du_max, track, axes  as for :class:`MPC`
    progress            show a bar
    settings            what else :class:`MPC` takes; a ``horizon``, ``rate_weight`` or ``estimator_gain`` that is
                        given is kept. Known delays are put into the plants of the trials.

    Raises ValueError where nothing answers to the inputs, where the model comes to no rest or no loop can be closed,
    and for episodes that do not fit the model.
    """
    begin = time.perf_counter()
    found = model_of(model)
    data = matched(found, episodes)
    target = tracked_states(found, track, axes)
    tracked = target.states
    limits = input_limits(u_min, u_max, du_max, found.n_inputs, found.input_offset, found.input_basis)
    scale = _scale(found, data, tracked) if settings.get("output_scale") is None else settings["output_scale"]
    scale = np.broadcast_to(np.asarray(scale, dtype=np.float64), (len(tracked),)).copy()
    A, B = _linear(found, limits.offset)
    modes = slow_modes(impulses(A, B, found.C[list(tracked)] / scale[:, None]))
    misses = Misses.of(found, data, tracked, scale)
    first = innovations(misses)
    x_rest, u_rest, references, steps, after, size = references_within(
        found, limits, tracked, target.name, steps_of(modes)
    )
    delay = float(settings.get("command_delay", 0.0)) + float(settings.get("measurement_delay", 0.0))
    trials = Trials(PushedModel(found, x_rest, misses), delay, u_rest, references, steps, after, size)
    fixed = {"u_min": u_min, "u_max": u_max, "du_max": du_max, "track": track, "axes": axes, "output_scale": scale}
    fixed |= {k: v for k, v in settings.items() if k not in ("horizon", "rate_weight", "estimator_gain")}
    search = _Search(found, fixed, trials, settings, progress)
    horizon, gain = horizon_of(modes), min(max(first.gain, GAINS[0]), GAINS[1])
    search.defaults(20, 0.02, GAIN / (1.0 + delay))
    search.begin(horizon, FIRST_WEIGHT, gain)
    gains = sorted({0.01, 0.03, 0.1, 0.3, gain})
    search.scan("gain", gains)
    search.scan("rate_weight", [10.0**-k for k in range(-1, 6)])
    search.scan("gain", gains)
    search.scan("horizon", [horizon, min(3 * horizon // 2, LONGEST), max(2 * horizon // 3, SHORTEST)])
    search.scan("rate_weight", [search.best.rate_weight * 10.0**k for k in (0.5, 0.0, -0.5)])
    search.close()
    best = search.chosen()
    if not np.isfinite(best.error):
        raise ValueError(
            "no loop holds on the model itself: widen the limits, track other outputs, or give more recordings"
        )
    made = tuple(sorted([*search.made.values(), search.by_default], key=lambda t: t.error))
    seconds = time.perf_counter() - begin
    slow = steps_of(modes)
    notes = [
        f"slowest mode that matters: {slow:.3g} steps ({slow * found.dt:.3g} s)",
        f"innovations smallest at gain {first.gain:.2g}, correlated by {first.correlation:.2f} ({first.without:.2f} "
        "without an estimate)",
        f"chosen of {len(made)} trials in {seconds:.1f} s: {best} of the circle's radius (the defaults: "
        f"{search.by_default.error:.3g}, the least: {made[0].error:.3g})",
    ]
    if best.error > POOR:
        notes.append("expect no better of the system; more or other recordings may help")
    return Tuned(search.controller(best), u_rest, made, best, first, seconds, tuple(notes))


class _Search:
    """Changes one number at a time, as long as the trials improve."""

    def __init__(
        self, model: LiftedModel, fixed: dict[str, Any], trials: Trials, given: dict[str, Any], progress: bool
    ) -> None:
        self._model, self._fixed, self._trials = model, fixed, trials
        names = (("horizon", "horizon"), ("rate_weight", "rate_weight"), ("gain", "estimator_gain"))
        self._given = {mine: given[theirs] for mine, theirs in names if given.get(theirs) is not None}
        self._given_scale = given.get("output_scale")
        self._bar = tqdm(disable=not progress, desc="closed loops on the model", unit="trial")
        self.made: dict[tuple[int, float, float], Trial] = {}
        self.by_default = Trial(0, 0.0, 0.0, np.inf, True)
        self.best = Trial(0, 0.0, 0.0, np.inf)

    def defaults(self, horizon: int, rate_weight: float, gain: float) -> None:
        """Try the defaults of a controller, as far as nothing is given."""
        numbers = {"horizon": horizon, "rate_weight": rate_weight, "gain": gain} | self._given
        trial = Trial(**numbers, error=np.inf, defaults=True)
        self.by_default = replace(trial, error=self._trials.error(self._trial_controller(trial)))
        self._bar.update()

    def chosen(self) -> Trial:
        """Of all trials: the defaults where they are within a third of the least error, where the scans ended if that
        is, and the least otherwise: what every scan gives away for caution must not add up."""
        made = [self.by_default, *self.made.values()]
        least = min(made, key=lambda trial: trial.error)
        return next(t for t in (self.by_default, self.best, least) if t.error <= least.error / BETTER)

    def begin(self, horizon: int, rate_weight: float, gain: float) -> None:
        start = {"horizon": horizon, "rate_weight": rate_weight, "gain": gain} | self._given
        self.best = self._tried(**start)

    def scan(self, name: str, values: Sequence[float]) -> None:
        """Try ``values`` of a number, the cautious first: that one is taken whose error is within a third of the
        least."""
        if name in self._given:
            return
        now = {n: getattr(self.best, n) for n in ("horizon", "rate_weight", "gain")}
        trials = [self._tried(**(now | {name: value})) for value in values]
        least = min(trial.error for trial in trials)
        self.best = next(trial for trial in trials if trial.error <= least / BETTER)

    def controller(self, trial: Trial) -> MPC:
        return MPC(self._model, trial.horizon, **self._fixed | self._numbers(trial))

    def _trial_controller(self, trial: Trial) -> MPC:
        """The same in the trials, where a delay of measurements is one of commands and nothing is unknown."""
        known = {"command_delay": self._trials.delay, "measurement_delay": 0.0, "observer": None, "stuck_after": None}
        fixed = self._fixed | known | self._numbers(trial)
        return InLiftedState(self._trials.moving, self._model, trial.horizon, **fixed)

    def _numbers(self, trial: Trial) -> dict[str, Any]:
        scale = {"output_scale": self._given_scale} if trial.defaults else {}
        return {"rate_weight": trial.rate_weight, "estimator_gain": trial.gain, **scale}

    def close(self) -> None:
        self._bar.close()

    def _tried(self, horizon: int, rate_weight: float, gain: float) -> Trial:
        key = (horizon, round(float(np.log10(rate_weight)), 6) if rate_weight > 0 else -np.inf, round(gain, 9))
        if key not in self.made:
            trial = Trial(horizon, rate_weight, gain, np.inf)
            error = self._trials.error(self._trial_controller(trial), 3.0 * self.best.error)
            self.made[key] = Trial(horizon, rate_weight, gain, error)
            self._bar.update()
        return self.made[key]


def _scale(model: LiftedModel, data: Episodes, tracked: Sequence[int]) -> Array:
    """Half of the range of each output in the data; the largest of those of its unit for all of one unit."""
    x = np.concatenate([x[:, list(tracked)] for x in data.xs])
    half = 0.5 * np.ptp(x, axis=0)
    units = [model.units[i] for i in tracked]
    return np.array([max(h for h, other in zip(half, units, strict=True) if other == unit) for unit in units])


def _linear(model: LiftedModel, u: Array) -> tuple[Array, Array]:
    """A (M, M) and B (M, m) of the model near rest under u (m,)."""
    D = model.n_delays
    x = model.d if model.relifted is not None else np.zeros(model.n_states)
    z = model.lift(np.tile(x, (D + 1, 1)), np.tile(u, (D, 1)))
    return model.jacobian(z, u)
