"""Snapshot pairs with their history, all of the same episode."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import count
from pisplit.data.mapped import release
from pisplit.data.rows import frozen, refrozen

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Start:
    """What a roll-out of one episode needs, and the truth to compare with (D delays).

    x_history  (D+1, n) states before and at the first step
    u_history  (D, m) inputs before it
    inputs     (T-D, m) inputs of the roll-out
    states     (T-D+1, n) the truth, with states[0] = x_history[-1]
    """

    x_history: Array
    u_history: Array
    inputs: Array
    states: Array


@brief
@dataclass(frozen=True, eq=False)
class Pairs:
    """N snapshot pairs with their history, as positions in the rows of all episodes: no state is stored twice.

    states    (R, n) and
    inputs    (R', m) all rows of all episodes, read-only, usually the memory of the episodes themselves
    row       (N,) position of x_k in ``states``; x_{k+1} is the row after it
    input_row (N,) position of u_k in ``inputs``
    episode   (N,) number of the episode that a pair is from
    index     (N,) its step k there
    n_delays  D, steps of history

    What is gathered (``x``, ``x_next``, ``u``, histories) is a new array at every call: walk through ``blocks`` where
    there are many pairs.
    """

    states: Array
    inputs: Array
    row: Index
    input_row: Index
    episode: Index
    index: Index
    n_delays: int

    def __post_init__(self) -> None:
        for name in ("states", "inputs", "row", "input_row", "episode", "index"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(refrozen(state))

    def __len__(self) -> int:
        return len(self.row)

    @property
    def x(self) -> Array:
        """x_k (N, n)."""
        return self.states[self.row]

    @property
    def x_next(self) -> Array:
        """x_{k+1} (N, n)."""
        return self.states[self.row + 1]

    @property
    def u(self) -> Array:
        """u_k (N, m)."""
        return self.inputs[self.input_row]

    @property
    def x_history(self) -> Array:
        """x_{k-D}..x_k (N, D+1, n), oldest first."""
        return self.states[self.row[:, None] + np.arange(-self.n_delays, 1)]

    @property
    def u_history(self) -> Array:
        """u_{k-D}..u_{k-1} (N, D, m), oldest first."""
        return self.inputs[self.input_row[:, None] + np.arange(-self.n_delays, 0)]

    def take(self, which: ArrayLike) -> Pairs:
        """The pairs at positions ``which`` (integers) or under a boolean mask (N,) of that name."""
        chosen = np.arange(len(self))[np.asarray(which)]
        arrays = (self.row[chosen], self.input_row[chosen], self.episode[chosen], self.index[chosen])
        return Pairs(self.states, self.inputs, *arrays, n_delays=self.n_delays)

    def sample(self, n: int, seed: int) -> Pairs:
        """``n`` pairs drawn without replacement by a generator of ``seed``. Raises ValueError if there are fewer."""
        size = count(n, "n")
        if size > len(self):
            raise ValueError(f"n = {size} pairs asked for; the episodes hold {len(self)}")
        return self.take(np.sort(np.random.default_rng(seed).choice(len(self), size, replace=False)))

    def blocks(self, size: int = 4096) -> Iterator[Pairs]:
        """The pairs in order, at most ``size`` at a time; of a mapped file, no more stays in memory."""
        for first in range(0, len(self), size):
            yield self.take(np.arange(first, min(first + size, len(self))))
            release(self.states)
            release(self.inputs)


def all_pairs(states: Array, inputs: Array, steps: Sequence[int], n_delays: int) -> Pairs:
    """All pairs with ``n_delays`` steps of history of episodes of so many ``steps`` (E,).

    ``states`` (R, n) and ``inputs`` (R', m) are all their rows. Raises ValueError if no episode is long enough.
    """
    delays = count(n_delays, "n_delays", minimum=0)
    own = [np.arange(delays, size) for size in steps]
    if not sum(map(len, own)):
        raise ValueError(f"n_delays = {delays} needs episodes of {delays + 1} steps; the longest has {max(steps)}")
    episode = np.repeat(np.arange(len(steps)), [len(k) for k in own])
    index = np.concatenate(own)
    input_row = (np.cumsum(steps) - np.asarray(steps))[episode] + index
    return Pairs(states, inputs, input_row + episode, input_row, episode, index, delays)


def checked_pairs(pairs: Pairs, states: Array, inputs: Array, steps: Sequence[int], n_delays: int) -> Pairs:
    """``pairs`` of the episodes with rows ``states`` (R, n), ``inputs`` (R', m) and ``steps`` (E,), or of equal ones.

    The result has ``n_delays`` steps of history. Raises ValueError for pairs of other data or without that history.
    """
    if not isinstance(pairs, Pairs):
        raise ValueError(f"pairs is a {type(pairs).__name__}; expected what d1.pairs(...) gives")
    if len(pairs) == 0:
        raise ValueError("pairs holds no pair; make them with d1.pairs(...)")
    if not (_equal(pairs.states, states) and _equal(pairs.inputs, inputs) and _placed(pairs, np.asarray(steps))):
        raise ValueError("pairs are of other data, not from these episodes; make them with d1.pairs(...)")
    if int(pairs.index.min()) < n_delays:
        raise ValueError(f"pairs need {n_delays} steps of history; make them with d1.pairs({n_delays})")
    return replace(pairs, n_delays=n_delays)


def _equal(first: Array, second: Array) -> bool:
    return first is second or np.array_equal(first, second)


def _placed(pairs: Pairs, steps: Index) -> bool:
    """Whether every row is that of its step in episodes of so many ``steps``."""
    if pairs.episode.min() < 0 or pairs.episode.max() >= len(steps) or (pairs.index >= steps[pairs.episode]).any():
        return False
    expected = (np.cumsum(steps) - steps)[pairs.episode] + pairs.index
    return np.array_equal(pairs.input_row, expected) and np.array_equal(pairs.row, expected + pairs.episode)
