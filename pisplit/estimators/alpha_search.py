"""The choice of alpha: roll-outs of held-out training episodes, and boundedness under an excitation."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.excitation import Excitation
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import operators
from pisplit.regression.moments import accumulate
from pisplit.regression.scaling import column_scales
from pisplit.splitting.base import SplitFit

Array = NDArray[np.float64]

MAX_HELD_OUT = 4


@dataclass(frozen=True)
class AlphaSearch:
    """alphas (G,) tried, their median squared errors (G,) of held-out roll-outs in scaled states, and the choice.

    held_out   numbers of the episodes that were held out
    unbounded  alphas that were passed over: their models do not stay bounded under the excitation
    bounded    whether that of the choice does; None if nobody asked
    """

    alphas: Array
    errors: Array
    chosen: float
    held_out: tuple[int, ...]
    unbounded: tuple[float, ...] = ()
    bounded: bool | None = None

    @property
    def error(self) -> float:
        """Error of the choice."""
        return float(self.errors[int(np.flatnonzero(self.alphas == self.chosen)[0])])


@dataclass(frozen=True)
class Trial:
    """What the fits of one estimator to one set of data have in common.

    pairs       all training pairs
    base        the model but for its dynamics: lifting, read-out, names
    held        pairs to learn from, held-out episodes and their numbers; None where alpha is given
    learning    base of the model that learns without the held-out episodes
    excitation  what models must survive, or None
    """

    theta: Dictionary
    scale: Array
    pairs: Pairs
    base: LiftedModel
    held: tuple[Pairs, Episodes, tuple[int, ...]] | None
    learning: LiftedModel
    excitation: Excitation | None

    def model(self, k: Array) -> LiftedModel:
        """The model with the learned rows ``k``."""
        return replace(self.base, **operators(self.theta, k))

    def bounds(self, k: Array) -> bool:
        """True if ``k`` stays bounded, or nobody asks."""
        if self.excitation is None:
            return True
        return bool(np.isfinite(k).all()) and self.excitation.bounds(self.model(k))


@dataclass(frozen=True)
class Choice:
    """A fit to all pairs with the alpha that was chosen for it, and whether it stays bounded (None: nobody asked)."""

    fit: SplitFit
    alpha: float
    search: AlphaSearch | None
    bounded: bool | None

    @property
    def rank(self) -> tuple[bool, float]:
        """Smaller is better: bounded ones first, then by the error of held-out roll-outs."""
        return self.bounded is False, self.search.error if self.search else 0.0

    @property
    def refused(self) -> bool:
        """True if what rolls out best does not stay bounded."""
        return self.bounded is False or bool(self.search and self.search.unbounded)


def choose(
    alphas: Array,
    errors: Array,
    tolerance: float,
    held_out: tuple[int, ...],
    bounded: Callable[[float], bool] | None = None,
) -> AlphaSearch:
    """The largest alpha within ``tolerance`` of the smallest error, among those whose models stay ``bounded``.

    Models are looked at in the order of preference until one is. Where none is, the choice is that of the errors alone.
    """
    left = errors.copy()
    while np.isfinite(left).any():
        best = _preferred(alphas, left, tolerance)
        if bounded is None or bounded(float(alphas[best])):
            passed = tuple(alphas[np.isinf(left) & np.isfinite(errors)].tolist())
            return AlphaSearch(alphas, errors, float(alphas[best]), held_out, passed, None if bounded is None else True)
        left[best] = np.inf
    tried = tuple(alphas[np.isfinite(errors)].tolist())
    if tried:
        best = _preferred(alphas, errors, tolerance)
        return AlphaSearch(alphas, errors, float(alphas[best]), held_out, tried, False)
    last = float(alphas.max())
    warnings.warn(f"every alpha of the grid diverged on held-out roll-outs; took {last:g}", stacklevel=7)
    return AlphaSearch(alphas, errors, last, held_out, tried, None if bounded is None else bounded(last))


def _preferred(alphas: Array, errors: Array, tolerance: float) -> int:
    """Position of the largest alpha within ``tolerance`` of the smallest error."""
    level = np.flatnonzero(errors <= (1.0 + tolerance) * errors.min())
    return int(level[np.argmax(alphas[level])])


def hold_out(d1: Episodes, pairs: Pairs, delays: int) -> tuple[Pairs, Episodes, tuple[int, ...]]:
    """Training pairs, held-out episodes and their numbers.

    Episodes with the fewest training pairs are held out, later ones first: drawn pairs stay in use where possible, and
    episodes without any cost nothing (the training pairs are then ``pairs`` itself).
    A single episode is cut in time: its last third is held out.
    """
    if len(d1) == 1:
        steps = len(d1.us[0])
        cut = max(int(np.quantile(pairs.index, 2 / 3)), delays + 1)
        training = pairs.take(pairs.index < cut)
        if len(training) == 0 or steps - cut <= delays:
            raise ValueError("alpha='cv' needs more data: one episode is too short to hold out its end; give alpha")
        held = Episodes([d1.xs[0][cut:]], [d1.us[0][cut:]], d1.dt)
        return training, held, (0,)
    numbers = np.bincount(pairs.episode, minlength=len(d1))
    long_enough = [i for i in range(len(d1)) if len(d1.us[i]) > delays]
    order = sorted(long_enough, key=lambda i: (numbers[i], -i))
    unused = sum(numbers[i] == 0 for i in order)
    names = tuple(sorted(order[: min(MAX_HELD_OUT, max(1, len(order) // 5, unused))]))
    kept = ~np.isin(pairs.episode, names)
    training = pairs if kept.all() else pairs.take(kept)
    if len(training) == 0:
        raise ValueError("alpha='cv' has no pairs left beside the held-out episodes; give more episodes, or alpha")
    return training, d1.subset(names), names


def state_weights(theta: Dictionary, pairs: Pairs) -> Array:
    """1 / scale (n,) of every state by physical quantity, so that held-out errors of different units add up."""
    std = accumulate(block.x for block in pairs.blocks()).std
    return 1.0 / column_scales(std, theta.names.quantities)
