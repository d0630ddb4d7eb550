"""Folds over whole recordings: pairs of one recording are alike, and no model is tested on what it has seen."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import count

Index = NDArray[np.int64]

#: With fewer recordings each is left out in turn; from here on there are so many folds.
LEAVE_ONE_OUT, FOLDS = 10, 5


class EpisodeSplit:
    """Folds over recordings, as ``alpha="cv"`` makes them, for scikit-learn's ``cross_val_score`` and searches.

    n_splits  number of folds; if not given, each recording is left out in turn where there are fewer than 10, and five
              folds are made where there are more

    Recordings fall into folds at random, by a fixed seed: their order often follows the plan of an experiment. Raises
    ValueError for fewer than two folds.
    """

    def __init__(self, n_splits: int | None = None) -> None:
        if n_splits is not None:
            count(n_splits, "n_splits", minimum=2)
        self.n_splits = n_splits

    def split(self, X: Any, y: Any = None, groups: Any = None) -> Iterator[tuple[Index, Index]]:
        """Positions (E - e,) of the recordings to learn from and (e,) of those to test on, fold by fold.

        X  Episodes, or anything whose length is the number of recordings
        y, groups  scikit-learn's; not used

        Raises ValueError for fewer recordings than folds, or than two.
        """
        size = len(X)
        everything = np.arange(size)
        for held in episode_groups(size, self.get_n_splits(X)):
            yield np.setdiff1d(everything, held), held

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """Number of folds for the recordings ``X``; ``y`` and ``groups`` are scikit-learn's, and not used.

        Raises ValueError where it depends on the number of recordings and none are given.
        """
        if self.n_splits is not None:
            return self.n_splits
        if X is None:
            raise ValueError("the number of folds depends on the recordings; give X, or n_splits to EpisodeSplit")
        return default_folds(len(X))


def default_folds(size: int) -> int:
    """Number of folds for ``size`` recordings: one each below 10, five from there on."""
    return size if size < LEAVE_ONE_OUT else FOLDS


def episode_groups(size: int, folds: int) -> list[Index]:
    """The positions of ``size`` recordings in so many ``folds``, each in ascending order.

    Raises ValueError for fewer recordings than folds, or than two.
    """
    if size < 2 or folds > size:
        raise ValueError(f"{folds} folds of {size} recordings; give at least {max(2, folds)} recordings")
    if folds == size:
        return [np.array([i]) for i in range(size)]
    order = np.random.default_rng(0).permutation(size)
    return [np.sort(part) for part in np.array_split(order, folds)]
