"""A protocol: draws of training data, methods that fit a predictor to a draw, errors of its open-loop roll-outs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pisplit import Episodes, LiftedModel, PhaseSamples
from pisplit.checks import count
from pisplit.data.episodes import Pairs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Training episodes kept for choices such as alpha; as many as ``alpha="cv"`` of the estimators takes.
HELD_OUT = 4
#: Steps of history that every pair and every roll-out has, whatever the delays of a method.
HISTORY = 4
#: A roll-out diverges where a point of the arm is predicted this far from the truth, in m, or is not finite.
ASTRAY = 10.0


@dataclass(frozen=True)
class Draw:
    """Training data of one fit.

    law       input law of the trajectories
    episodes  training episodes; the last ``HELD_OUT`` of them are held out, and hold no pair
    rows      (N, 2) episode and step k of each training pair, x_k -> x_{k+1} under u_k, with its history
    d2        phase-space samples of the known part
    seed      of the draw
    """

    law: str
    episodes: Episodes
    rows: Index
    d2: PhaseSamples
    seed: int

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def held_out(self) -> Episodes:
        """Training episodes for choices; no pair is from them."""
        return self.episodes[-HELD_OUT:]

    def pairs(self, n_delays: int = 0) -> Pairs:
        """The pairs with ``n_delays`` <= ``HISTORY`` steps of history, for ``fit(draw.episodes, pairs=...)``."""
        return pairs_at(self.episodes, self.rows, n_delays)


@dataclass(frozen=True)
class Prediction:
    """Roll-outs of E episodes over T steps: points (E, T, 3 k) and distal velocity (E, T, 3); steps from
    ``diverged_at`` (E,) on are void (-1: never)."""

    points: Array
    velocity: Array
    diverged_at: Index


class Predictor(Protocol):
    """A fitted model that rolls out open loop."""

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Predict steps start + 1 .. end of episodes of one length from states up to ``start`` and all inputs."""


@dataclass(frozen=True)
class Method:
    """A named way to make a predictor from a draw. ``fit`` raises ValueError for draws that it refuses."""

    name: str
    fit: Callable[[Draw], Predictor]


@dataclass(frozen=True)
class Lifted:
    """Predictor of a :class:`LiftedModel`; ``points`` and ``velocity`` are its output groups."""

    model: LiftedModel
    points: str = "shape"
    velocity: str = "tip_velocity"

    def __call__(self, episodes: Episodes, start: int) -> Prediction:
        """Roll all episodes out side by side."""
        model, past = self.model, start - self.model.n_delays
        z0 = np.stack(
            [model.lift(x[past : start + 1], u[past:start]) for x, u in zip(episodes.xs, episodes.us, strict=True)]
        )
        found = model.rollout(z0, np.stack([u[start:] for u in episodes.us]))
        groups = (np.array(model.outputs[name]) for name in (self.points, self.velocity))
        points, velocity = (found.x[:, 1:, group] for group in groups)
        at = np.asarray(found.diverged_at)
        return Prediction(points, velocity, np.where(at > 0, at - 1, at))


@dataclass(frozen=True)
class Errors:
    """Squared errors (E, T) of roll-outs, infinite from the step of divergence on, and that step (E,), -1 for never.

    shape     |p_hat - p|^2 of the concatenated points, in m^2
    velocity  |q_hat - q|^2 of the distal end, in m^2/s^2
    """

    shape: Array
    velocity: Array
    diverged_at: Index

    @property
    def diverged(self) -> float:
        """Fraction of roll-outs that diverged."""
        return float((self.diverged_at >= 0).mean())


@dataclass(frozen=True)
class Summary:
    """Median and quartiles over all steps of all roll-outs; infinite where divergent ones reach so far."""

    median: float
    lower: float
    upper: float
    diverged: float


def random_pairs(episodes: Episodes, size: int, seed: int, history: int = HISTORY) -> Index:
    """(size, 2) episode and step of pairs drawn evenly without replacement; none from held-out episodes.

    Draws of one seed are nested: the pairs of a smaller size are the first ones of a larger.
    """
    rows = _all_rows(episodes, history)
    if count(size, "size") > len(rows):
        raise ValueError(f"size = {size} pairs asked for; the training episodes hold {len(rows)}")
    return rows[np.random.default_rng(seed).permutation(len(rows))[:size]]


def all_pairs(episodes: Episodes, history: int = HISTORY) -> int:
    """Number of pairs that training episodes hold."""
    return len(_all_rows(episodes, history))


def contiguous(episodes: Episodes, size: int, seed: int, history: int = HISTORY) -> Index:
    """(size, 2) episode and steps of one recording of ``size`` steps at a random place; none held out."""
    rng = np.random.default_rng(seed)
    usable = episodes.us[:-HELD_OUT]
    long_enough = [i for i, u in enumerate(usable) if len(u) - history >= count(size, "size")]
    if not long_enough:
        longest = max(map(len, usable)) - history
        raise ValueError(f"size = {size} steps in one recording; the longest training episode holds {longest}")
    episode = int(rng.choice(long_enough))
    first = history + int(rng.integers(len(usable[episode]) - history - size + 1))
    return np.stack([np.full(size, episode), first + np.arange(size)], axis=1)


def pairs_at(episodes: Episodes, rows: Index, n_delays: int) -> Pairs:
    """Snapshot pairs of ``episodes`` at (episode, step) ``rows`` (N, 2)."""
    steps = np.array([len(u) for u in episodes.us])
    first = np.concatenate([[0], np.cumsum(steps)[:-1]])
    episode, index = rows[:, 0], rows[:, 1]
    input_row = first[episode] + index
    states, inputs = episodes.stacked_states(), episodes.stacked_inputs()
    return Pairs(states, inputs, input_row + episode, input_row, episode, index, n_delays)


def evaluate(predictor: Predictor, test: Episodes, start: int = HISTORY) -> Errors:
    """Squared errors of open-loop roll-outs of test episodes of one length, all from step ``start``."""
    groups = test.outputs or {}
    truth = np.stack([x[start + 1 :] for x in test.xs])
    found = predictor(test, start)
    with np.errstate(over="ignore", invalid="ignore"):
        shape = squared_error(truth[:, :, list(groups["shape"])], found.points)
        velocity = squared_error(truth[:, :, list(groups["tip_velocity"])], found.velocity)
        astray = ~np.isfinite(shape) | ~np.isfinite(velocity) | (shape > ASTRAY**2)
    steps = np.arange(shape.shape[1])
    flagged = (found.diverged_at >= 0)[:, None] & (steps >= found.diverged_at[:, None])
    void = np.logical_or.accumulate(astray | flagged, axis=1)
    shape[void] = velocity[void] = np.inf
    at = np.where(void.any(axis=1), np.argmax(void, axis=1), -1)
    return Errors(shape, velocity, at)


def squared_error(truth: Array, predicted: Array) -> Array:
    """|x_hat - x|^2 over the last axis."""
    return np.asarray(((predicted - truth) ** 2).sum(axis=-1))


def summary(errors: Sequence[Errors], what: str = "shape") -> Summary:
    """Median and quartiles of the "shape" or "velocity" error over all steps and roll-outs of several draws."""
    values = np.concatenate([np.ravel(getattr(e, what)) for e in errors])
    lower, median, upper = (float(np.quantile(values, q, method="lower")) for q in (0.25, 0.5, 0.75))
    return Summary(median, lower, upper, float(np.mean([e.diverged for e in errors])))


def _all_rows(episodes: Episodes, history: int) -> Index:
    """(N, 2) episode and step of all pairs with ``history`` steps before them, held-out episodes left out."""
    if len(episodes) <= HELD_OUT:
        raise ValueError(f"{len(episodes)} training episodes; {HELD_OUT} are held out, give more")
    parts = [
        np.stack([np.full(max(len(u) - history, 0), i), np.arange(history, max(len(u), history))], axis=1)
        for i, u in enumerate(episodes.us[:-HELD_OUT])
    ]
    return np.concatenate(parts).astype(np.int64)
