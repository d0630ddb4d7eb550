"""Commands of the recorded kind, as many and as long as wanted: recordings cut to pieces and put together anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.data.episodes import Episodes

Array = NDArray[np.float64]

#: Sequences, at least so many, of at most so many steps, with so many steps in all: what a test may cost.
SEQUENCES, FEWEST, LONGEST, TOTAL = 32, 8, 1600, 12_800
#: Pieces of recordings among which the one is taken that goes on where the last one ended.
CANDIDATES = 16
#: Recordings whose commands are mixed.
MIXED = 3


def excitation_inputs(
    given: ArrayLike | str | None, nonlinear: bool, d1: Episodes, horizon: int | None = None
) -> ArrayLike | None:
    """What a model has to stay bounded under: the inputs ``given``, those of "data", or None for no test.

    "auto" is "data" where the step of a model is ``nonlinear`` in state and input together. ``d1`` and ``horizon`` as
    in :func:`resampled_commands`. Raises ValueError for other words.
    """
    if not isinstance(given, str):
        return given
    if given not in ("auto", "data"):
        raise ValueError(f"excitation = {given!r}; expected 'auto', 'data', input sequences (E, T, m) or None")
    return resampled_commands(d1, horizon) if d1.n_inputs and (nonlinear or given == "data") else None


def resampled_commands(d1: Episodes, horizon: int | None = None, seed: int = 0) -> Array:
    """Commands (E, T, m) made of those of recordings ``d1``, twice as long as the longest one, or ``horizon`` steps.

    Half of them are pieces of half a recording, each going on about where the last one ended. The others are averages,
    with random weights, of three such sequences: recordings that move one input at a time say nothing of two that move
    together, and a model is asked for both. All of them lie where the recorded commands span, no step is beyond it.
    ``seed`` of the draws. The idea is the moving-block bootstrap (Kunsch, Annals of Statistics 17, 1989).
    """
    rng = np.random.default_rng(seed)
    steps = min(2 * max(map(len, d1.us)), LONGEST) if horizon is None else horizon
    number = int(np.clip(TOTAL // steps, FEWEST, SEQUENCES))
    spread = d1.stacked_inputs().std(axis=0)
    scale = np.where(spread > 0.0, spread, 1.0)
    piece = max(1, min(map(len, d1.us)) // 2)
    plain = np.stack([_sequence(d1, steps, piece, scale, rng) for _ in range(number)])
    half = number // 2
    weights = rng.dirichlet(np.ones(MIXED), size=number - half)
    mixed = [w @ plain[rng.permutation(number)[:MIXED]].reshape(MIXED, -1) for w in weights]
    return np.concatenate([plain[:half], np.reshape(mixed, (number - half, steps, d1.n_inputs))])


def _sequence(d1: Episodes, steps: int, piece: int, scale: Array, rng: np.random.Generator) -> Array:
    """Pieces of recordings, one after another, to so many ``steps``."""
    episode = int(rng.integers(len(d1)))
    parts = [d1.us[episode][: min(steps, piece)]]  # where recordings begin, systems are often at rest
    while sum(map(len, parts)) < steps:
        episodes = rng.integers(len(d1), size=CANDIDATES)
        firsts = [int(rng.integers(len(d1.us[i]) - piece + 1)) for i in episodes]
        last = parts[-1][-1]
        jumps = [np.abs((d1.us[i][k] - last) / scale).max(initial=0.0) for i, k in zip(episodes, firsts, strict=True)]
        best = int(np.argmin(jumps))
        parts.append(d1.us[episodes[best]][firsts[best] : firsts[best] + piece])
    return np.concatenate(parts)[:steps]
