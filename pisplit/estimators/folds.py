"""What alpha is chosen on: folds over recordings, or over stretches of time where there is one recording only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.input_subspace import combination
from pisplit.evaluation.splits import FOLDS, LEAVE_ONE_OUT, default_folds, episode_groups
from pisplit.regression.moments import Moments, joined

Array = NDArray[np.float64]

#: Recordings held out at once, and recordings without a single pair from which on nothing else is held out: they cost
#: nothing, and what they judge is the model that all pairs make.
MAX_HELD_OUT = 4
#: Spread of an input direction, in parts of that of all recordings, up to which training pairs do not know it, and
#: from which on held-out recordings move it.
UNSEEN, MOVED = 0.1, 0.3
#: Roll-outs of limited length in which no pair was learned from, all in all, from which on these alone are held out.
UNTOUCHED = 150
#: Roll-outs of limited length begin so many times a horizon: each alone is a matter of chance.
OVERLAP = 5


@dataclass(frozen=True)
class Fold:
    """One fold.

    training  pairs to learn from; the very object that was given where nothing was taken away
    kept      (N,) which of all pairs these are
    episodes  stretches that are rolled out, cut to the horizon
    numbers   of the recordings they are from
    name      what reports call them: "recording 3", "recordings 2 and 7", "steps 40 to 60"
    horizon   steps of its roll-outs, None: as long as the stretches are
    unseen    input direction that these recordings move and no training pair does, "" if there is none
    untouched whether it is the only one, of roll-outs all over the recordings that pass no pair
    """

    training: Pairs
    kept: NDArray[np.bool_]
    episodes: Episodes
    numbers: tuple[int, ...]
    name: str
    horizon: int | None = None
    unseen: str = ""
    untouched: bool = False


def make_folds(
    d1: Episodes, pairs: Pairs, delays: int, start: int, horizon: int | None = None, folds: int | None = None
) -> tuple[Fold, ...]:
    """Folds of ``pairs`` of the recordings ``d1``.

    delays   steps of history of the model
    start    steps at the beginning of a recording that are history: at least ``delays``, equal for models to compare
    horizon  steps of a roll-out; None: to the end
    folds    their number; 1 holds out a fifth of the recordings once (of one recording the last third). None: each of
             fewer than 10 recordings in turn (with a ``horizon`` each half of them, so that more is left to learn
             from; where enough roll-outs of it pass no pair, as of few pairs out of long recordings, these alone),
             five folds of more; where at least four recordings have no pair, these alone; of one recording five
             stretches of time

    Raises ValueError, in one line, for data of which nothing can be held out.
    """
    cut = _Cut(d1, delays, start, horizon)
    if len(d1) == 1:
        return _stretches(cut, pairs, folds)
    numbers = np.bincount(pairs.episode, minlength=len(d1))
    long_enough = [i for i in range(len(d1)) if len(d1.us[i]) > start]
    order = sorted(long_enough, key=lambda i: (numbers[i], -i))
    unused = sum(numbers[i] == 0 for i in order)
    if folds == 1 or (folds is None and unused >= MAX_HELD_OUT):
        groups = [order[: min(MAX_HELD_OUT, max(1, len(order) // 5, unused))]]
    elif len(long_enough) < 2:
        groups = [long_enough]
    elif folds is None and horizon is not None and len(long_enough) < LEAVE_ONE_OUT:
        return _untouched(cut, pairs, long_enough) or _halves(cut, pairs, long_enough)
    else:
        wanted = min(folds or default_folds(len(long_enough)), len(long_enough))
        parts = [[long_enough[i] for i in part] for part in episode_groups(len(long_enough), wanted)]
        groups = [sorted(part, key=order.index)[:MAX_HELD_OUT] for part in parts]
    made = []
    for group in groups:
        names = tuple(sorted(group))
        kept = ~np.isin(pairs.episode, names)
        if names and kept.any():
            training = pairs if kept.all() else pairs.take(kept)
            unseen = _unseen(d1, names, training)
            made.append(Fold(training, kept, cut.whole(names), names, _label(names), horizon, unseen))
    if not made:
        raise ValueError("alpha='cv' has no pairs left beside the held-out episodes; give more episodes, or alpha")
    return tuple(made)


def _halves(cut: _Cut, pairs: Pairs, numbers: Sequence[int]) -> tuple[Fold, ...]:
    """Folds over the halves of recordings, those whole that are too short for a horizon in each."""
    made = []
    for i in numbers:
        steps, wanted = len(cut.d1.us[i]), 2 * (cut.start + (cut.horizon or 0))
        edges = [0, steps // 2, steps] if steps >= wanted else [0, steps]
        for first, last in pairwise(edges):
            kept = ~((pairs.episode == i) & (pairs.index >= first) & (pairs.index < last))
            if not kept.any():
                continue
            training = pairs if kept.all() else pairs.take(kept)
            name = f"recording {i}" + (f", steps {first} to {last}" if len(edges) > 2 else "")
            unseen = _unseen(cut.d1, (i,), training)
            made.append(Fold(training, kept, cut.stretch(i, first, last), (i,), name, cut.horizon, unseen))
    if not made:
        raise ValueError("alpha='cv' has no pairs left beside the held-out episodes; give more episodes, or alpha")
    return tuple(made)


def _untouched(cut: _Cut, pairs: Pairs, numbers: Sequence[int]) -> tuple[Fold, ...]:
    """One fold of all roll-outs that pass no pair, and judge what all pairs make; () if too few do."""
    pieces, seen = [], []
    for i in numbers:
        used = np.zeros(len(cut.d1.us[i]) + 1, dtype=np.int64)
        used[pairs.index[pairs.episode == i] + 1] = 1
        before = np.cumsum(used)  # pairs up to a step
        free = [(a, b) for a, b in cut.windows(len(cut.d1.us[i]), 1) if before[b] == before[max(a - 1, 0)]]
        free = [(a, b) for a, b in free if b - a == cut.horizon]
        if free:
            pieces.append(cut.pieces(i, free))
            seen.append(i)
    if sum(map(len, pieces)) < UNTOUCHED or 2 * len(seen) <= len(numbers):
        return ()
    xs, us = [x for part in pieces for x in part.xs], [u for part in pieces for u in part.us]
    whole = replace(cut.d1, xs=xs, us=us, extra={})
    kept = np.ones(len(pairs), dtype=bool)
    return (Fold(pairs, kept, whole, tuple(seen), "steps without a pair", cut.horizon, untouched=True),)


def _stretches(cut: _Cut, pairs: Pairs, folds: int | None) -> tuple[Fold, ...]:
    """Folds over stretches of the one recording; those without a pair alone where they are the larger part."""
    steps = len(cut.d1.us[0])
    if folds == 1:
        edges = np.array([max(int(np.quantile(pairs.index, 2 / 3)), cut.start + 1), steps])
    else:
        edges = np.linspace(0, steps, min(folds or FOLDS, steps // (cut.start + 1)) + 1).astype(int)
    made = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        kept = np.asarray((pairs.index < first) | (pairs.index >= last))
        if kept.any() and last - first > cut.start:
            training = pairs if kept.all() else pairs.take(kept)
            made.append(
                Fold(training, kept, cut.stretch(0, first, last), (0,), f"steps {first} to {last}", cut.horizon)
            )
    untouched = [fold for fold in made if fold.training is pairs]
    if not made or (len(made) == 1 and folds != 1):
        raise ValueError("alpha='cv' needs more data: one episode is too short to hold out a part of it; give alpha")
    return tuple(untouched if 2 * len(untouched) > len(made) else made)


@dataclass(frozen=True)
class _Cut:
    """How recordings are cut for roll-outs."""

    d1: Episodes
    delays: int
    start: int
    horizon: int | None

    def whole(self, names: tuple[int, ...]) -> Episodes:
        if self.horizon is None and self.start == self.delays:
            return self.d1.subset(names)
        return self._of([(self.d1.xs[i], self.d1.us[i]) for i in names])

    def stretch(self, i: int, first: int, last: int) -> Episodes:
        return self._of([(self.d1.xs[i][first : last + 1], self.d1.us[i][first:last])])

    def pieces(self, i: int, windows: Sequence[tuple[int, int]]) -> Episodes:
        """Roll-outs between the steps ``windows`` of recording ``i``."""
        x, u = self.d1.xs[i], self.d1.us[i]
        xs = [x[first - self.delays : last + 1] for first, last in windows]
        return replace(self.d1, xs=xs, us=[u[first - self.delays : last] for first, last in windows], extra={})

    def _of(self, runs: list[tuple[Array, Array]]) -> Episodes:
        xs, us = [], []
        for x, u in runs:
            for first, last in self.windows(len(u)):
                xs.append(x[first - self.delays : last + 1])
                us.append(u[first - self.delays : last])
        return replace(self.d1, xs=xs, us=us, extra={})

    def windows(self, steps: int, every: int | None = None) -> list[tuple[int, int]]:
        """First and last step of each roll-out: one, or full horizons.

        They begin ``every`` so many steps; None: a fifth of a horizon.
        """
        if self.horizon is None or steps - self.start <= self.horizon:
            return [(self.start, steps)]
        starts = range(self.start, steps - self.horizon + 1, every or max(1, self.horizon // OVERLAP))
        return [(first, first + self.horizon) for first in starts]


def fold_moments(
    folds: Sequence[Fold], pairs: Pairs, whole: Moments, moments: Callable[[Pairs], Moments], rest: Moments | None
) -> list[Moments]:
    """Moments of the training pairs of every one of ``folds``, where no pair is held out twice.

    ``whole`` are those of all ``pairs``, ``moments`` makes those of some, ``rest`` are those of samples beside pairs.
    The dictionary is evaluated once on every pair: each fold joins what the others hold out.
    """
    out = [moments(pairs.take(~fold.kept)) if not fold.kept.all() else None for fold in folds]
    always = np.logical_and.reduce([fold.kept for fold in folds])
    common = [moments(pairs.take(always))] if always.any() else []
    common += [rest] if rest is not None else []
    found = []
    for i, own in enumerate(out):
        others = [part for j, part in enumerate(out) if j != i and part is not None]
        found.append(whole if own is None else joined([*common, *others]))
    return found


def _unseen(d1: Episodes, names: tuple[int, ...], training: Pairs) -> str:
    """The direction that the inputs of the recordings ``names`` move and those of ``training`` do not, in words."""
    spread = d1.stacked_inputs().std(axis=0)
    scale = np.where(spread > 0.0, spread, 1.0)
    known = (training.u - training.u.mean(axis=0)) / scale
    values, vectors = np.linalg.eigh(known.T @ known / len(known))
    still = vectors[:, values <= UNSEEN**2]
    held = np.concatenate([d1.us[i] for i in names])
    moves = ((held - held.mean(axis=0)) / scale) @ still
    values, directions = np.linalg.eigh(moves.T @ moves / len(moves))
    if values.max(initial=0.0) <= MOVED**2:
        return ""
    row = (still @ directions[:, -1]) / scale
    return combination(row / np.linalg.norm(row) * np.sign(row[np.argmax(np.abs(row))]), d1.input_names or ())


def _label(names: tuple[int, ...]) -> str:
    if len(names) == 1:
        return f"recording {names[0]}"
    return f"recordings {', '.join(map(str, names[:-1]))} and {names[-1]}"
