"""The choice of alpha: a fit is called for every alpha of a grid, its models roll held-out episodes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.fold_errors import LOST, FoldErrors, RolloutVerdict, constant_error, judged, reasons
from pisplit.estimators.problem import HeldOut, Problem
from pisplit.regression.moments import Moments, accumulate
from pisplit.regression.scaling import column_scales
from pisplit.splitting import SplitFit

Array = NDArray[np.float64]
#: A fit to the moments of pairs, for one alpha.
Fit = Callable[[Moments, float], SplitFit]


@dataclass(frozen=True)
class AlphaSearch:
    """alphas (G,) tried, their median squared errors (G,) of held-out roll-outs in scaled states.

    Errors are geometric means over folds; infinite where a model diverges on a fold on which another does not.

    chosen     the choice
    held_out   numbers of the episodes that were held out, in one fold or another
    unbounded  alphas that were passed over: their models do not stay bounded under the excitation
    bounded    whether that of the choice does; None if nobody asked
    table      errors fold by fold
    reasons    why the choice may be wrong, a line each; fit warns of them
    """

    alphas: Array
    errors: Array
    chosen: float
    held_out: tuple[int, ...]
    unbounded: tuple[float, ...]
    bounded: bool | None
    table: FoldErrors
    reasons: tuple[str, ...]

    @property
    def position(self) -> int:
        """Where the choice stands in the grid."""
        return int(np.flatnonzero(self.alphas == self.chosen)[0])

    @property
    def error(self) -> float:
        """Error of the choice."""
        return float(self.errors[self.position])

    def facts(self) -> dict[str, Any]:
        """What a model keeps of it, JSON-able: folds, the error of the choice (None if infinite), reasons to doubt."""
        error = self.error if np.isfinite(self.error) else None
        return {"folds": list(self.names), "error": error, "reasons": list(self.reasons)}

    @property
    def folds(self) -> Array:
        """Errors (G, F) fold by fold."""
        return self.table.errors

    @property
    def names(self) -> tuple[str, ...]:
        """Names (F,) of the folds: "recording 3", "steps 40 to 60"."""
        return tuple(fold.name for fold in self.table.folds)


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


@dataclass(frozen=True)
class Preference:
    """Position ``best`` of the choice in a grid, positions ``passed`` over, and whether the choice is ``bounded``."""

    best: int
    passed: tuple[int, ...]
    bounded: bool | None


def fit_at(problem: Problem, fit: Fit, alpha: float) -> Choice:
    """``fit`` to all pairs of ``problem`` with a given ``alpha``."""
    found = fit(problem.moments, alpha)
    bounded = problem.stays_bounded(found.K) if problem.excitation else None
    return Choice(found, alpha, None, bounded)


def fit_with_search(
    problem: Problem,
    fit: Fit,
    alphas: Sequence[float],
    states: str | Sequence[int] | Sequence[str] | None = None,
    tolerance: float = 0.0,
) -> Choice:
    """``fit`` to all pairs of ``problem`` with the best of ``alphas`` on roll-outs of its held-out episodes.

    The error of a fold is that of its roll-outs of ``states`` (output group, names or indices; default all), each in
    units of its quantity's spread; ``tolerance`` as in :func:`preferred`.
    """
    grid = np.array(alphas, dtype=np.float64)
    weights = state_weights(problem.theta, problem.pairs, problem.margins)
    final = lru_cache(maxsize=None)(lambda alpha: fit(problem.moments, alpha))

    def verdict(held: HeldOut, alpha: float) -> RolloutVerdict:
        k = (final(alpha) if held.moments is problem.moments else fit(held.moments, alpha)).K
        if not np.isfinite(k).all():
            return LOST
        return judged(problem.model(k, held), held.fold, states, weights)

    verdicts = [[verdict(held, alpha) for held in problem.held] for alpha in grid.tolist()]
    folds = [held.fold for held in problem.held]
    constant = [constant_error(held.base, held.fold, states, weights) for held in problem.held]
    found = FoldErrors.of(folds, verdicts, constant)

    def bounded(position: int) -> bool:
        return problem.stays_bounded(final(float(grid[position])).K)

    errors = found.joint()
    best = preferred(grid, errors, found.fallback(), tolerance, bounded if problem.excitation else None)
    labels = [f"alpha = {alpha:.3g}" for alpha in grid]
    allowed = ~np.isin(np.arange(len(grid)), best.passed)
    said = reasons(found, labels, best.best, allowed, tolerance)
    chosen = float(grid[best.best])
    numbers = tuple(sorted({i for fold in folds for i in fold.numbers}))
    passed = tuple(grid[list(best.passed)].tolist())
    search = AlphaSearch(grid, errors, chosen, numbers, passed, best.bounded, found, said)
    return Choice(final(chosen), chosen, search, best.bounded)


def preferred(
    alphas: Array,
    errors: Array,
    fallback: Array,
    tolerance: float,
    bounded: Callable[[int], bool] | None = None,
) -> Preference:
    """The largest alpha within ``tolerance`` of the smallest error, among those whose models stay ``bounded``.

    ``alphas`` (G,) with their ``errors`` (G,); where all of these are infinite, ``fallback`` (G,) takes their place,
    and where that is, the largest alpha. Models are looked at in the order of preference until one stays bounded.
    Where none does, the choice is that of the errors alone.
    """
    values = next(
        (v for v in (errors, fallback) if np.isfinite(v).any()), np.where(alphas == alphas.max(), 0.0, np.inf)
    )
    left = values.copy()
    passed: list[int] = []
    while np.isfinite(left).any():
        best = _first(alphas, left, tolerance)
        if bounded is None or bounded(best):
            return Preference(best, tuple(sorted(passed)), None if bounded is None else True)
        passed.append(best)
        left[best] = np.inf
    return Preference(_first(alphas, values, tolerance), tuple(sorted(passed)), False)


def _first(alphas: Array, errors: Array, tolerance: float) -> int:
    """Position of the largest alpha within ``tolerance`` of the smallest error."""
    level = np.flatnonzero(errors <= (1.0 + tolerance) * errors.min())
    return int(level[np.argmax(alphas[level])])


def state_weights(theta: Dictionary, pairs: Pairs, margins: Mapping[str, float] | None = None) -> Array:
    """1 / scale (n,) of every state of ``theta`` by its quantity's spread over ``pairs``: errors of any unit add up.

    ``margins``: as in :func:`pisplit.regression.column_scales`.
    """
    std = accumulate(block.x for block in pairs.blocks()).std
    return 1.0 / column_scales(std, theta.names.quantities, margins=margins)
