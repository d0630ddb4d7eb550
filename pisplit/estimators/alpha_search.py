"""The choice of alpha: a fit is called for every alpha of a grid, its models roll held-out episodes out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.problem import Problem
from pisplit.evaluation.rollouts import rollout_errors
from pisplit.regression.moments import Moments, accumulate
from pisplit.regression.scaling import column_scales
from pisplit.splitting import SplitFit

Array = NDArray[np.float64]
#: A fit to the moments of pairs, for one alpha.
Fit = Callable[[Moments, float], SplitFit]

MAX_HELD_OUT = 4


@dataclass(frozen=True)
class AlphaSearch:
    """alphas (G,) tried, their median squared errors (G,) of held-out roll-outs in scaled states.

    chosen     the choice
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
class Choice:
    """A ``fit`` to all pairs, its ``alpha``, and the ``search`` that chose it (None: it was given).

    ``bounded`` says whether it stays so, None if nobody asked.
    """

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


def fit_at(problem: Problem, fit: Fit, alpha: float) -> Choice:
    """``fit`` to all pairs of ``problem`` with a given ``alpha``."""
    found = fit(problem.moments, alpha)
    bounded = problem.stays_bounded(found.K, problem.model(found.K)) if problem.excitation else None
    return Choice(found, alpha, None, bounded)


def fit_with_search(
    problem: Problem,
    fit: Fit,
    alphas: Sequence[float],
    states: str | Sequence[int] | Sequence[str] | None = None,
    tolerance: float = 0.0,
) -> Choice:
    """``fit`` to all pairs of ``problem`` with the best of ``alphas`` on roll-outs of its held-out episodes.

    The error is the median over the roll-outs of ``states`` (output group, names or indices; default all), each in
    units of its quantity's spread; ``tolerance`` as in :func:`choose`.
    """
    held = problem.held
    assert held is not None
    weights = state_weights(problem.theta, problem.pairs)
    learned = lru_cache(maxsize=None)(lambda alpha: fit(held.moments, alpha))

    def error(alpha: float) -> float:
        k = learned(alpha).K
        if not np.isfinite(k).all():
            return np.inf
        return rollout_errors(problem.without_held_out(k), held.episodes, states, weights).median

    def bounded(alpha: float) -> bool:
        k = learned(alpha).K
        return problem.stays_bounded(k, problem.without_held_out(k))

    grid = np.array(alphas, dtype=np.float64)
    errors = np.array([error(alpha) for alpha in grid.tolist()])
    search = choose(grid, errors, tolerance, held.numbers, bounded if problem.excitation else None)
    if held.moments is problem.moments:  # that is the model which was rolled out
        return Choice(learned(search.chosen), search.chosen, search, search.bounded)
    best = fit_at(problem, fit, search.chosen)
    return Choice(best.fit, search.chosen, search, best.bounded)


def choose(
    alphas: Array,
    errors: Array,
    tolerance: float,
    held_out: tuple[int, ...],
    bounded: Callable[[float], bool] | None = None,
) -> AlphaSearch:
    """The largest alpha within ``tolerance`` of the smallest error, among those whose models stay ``bounded``.

    ``alphas`` (G,) were tried on the episodes ``held_out``, with these ``errors`` (G,). Models are looked at in the
    order of preference until one stays bounded. Where none does, the choice is that of the errors alone.
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
    warnings.warn(f"every alpha of the grid diverged on held-out roll-outs; took {last:g}", stacklevel=5)
    return AlphaSearch(alphas, errors, last, held_out, tried, None if bounded is None else bounded(last))


def _preferred(alphas: Array, errors: Array, tolerance: float) -> int:
    """Position of the largest alpha within ``tolerance`` of the smallest error."""
    level = np.flatnonzero(errors <= (1.0 + tolerance) * errors.min())
    return int(level[np.argmax(alphas[level])])


def hold_out(d1: Episodes, pairs: Pairs, delays: int) -> tuple[Pairs, Episodes, tuple[int, ...]]:
    """Training pairs, held-out episodes and their numbers, of ``pairs`` of ``d1`` with ``delays`` steps of history.

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
    """1 / scale (n,) of every state of ``theta`` by its quantity's spread over ``pairs``: errors of any unit add up."""
    std = accumulate(block.x for block in pairs.blocks()).std
    return 1.0 / column_scales(std, theta.names.quantities)
