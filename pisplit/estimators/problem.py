"""What the fits of one estimator to one set of data have in common, whatever their alpha."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.boundedness import Excitation
from pisplit.estimators.folds import Fold
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import operators
from pisplit.regression.moments import Moments

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """What alpha is chosen on, one fold of it.

    fold     which stretches are rolled out
    moments  of the pairs that are left to learn from
    base     the model that learns from these, but for its dynamics
    """

    fold: Fold
    moments: Moments
    base: LiftedModel


@dataclass(frozen=True)
class Problem:
    """Data of one fit, checked, named and with their moments.

    d1          training episodes
    theta       dictionary of M columns with the names of the data, S of them learned
    pairs       all training pairs
    n_equilibria  states at rest that count as pairs
    moments     of the pairs: [Theta(k) | learned columns of psi(k+1)] (M + S)
    scale       (M,) units of the columns in the regressions
    margins     factors by which scales of noisy quantities exceed their spreads
    base        the model but for its dynamics: lifting, read-out, names
    held        folds that choose alpha; empty where it is given
    excitation  what models must survive, or None
    """

    d1: Episodes
    theta: Dictionary
    pairs: Pairs
    n_equilibria: int
    moments: Moments
    scale: Array
    margins: Mapping[str, float]
    base: LiftedModel
    held: tuple[HeldOut, ...]
    excitation: Excitation | None

    def model(self, k: Array, held: HeldOut | None = None) -> LiftedModel:
        """The model with the learned rows ``k`` (S, M), of all pairs or of those that ``held`` leaves."""
        return replace(self.base if held is None else held.base, **operators(self.theta, k))

    def stays_bounded(self, k: Array) -> bool:
        """True if the model of the learned rows ``k`` stays bounded under the excitation, or nobody asks."""
        if self.excitation is None:
            return True
        return bool(np.isfinite(k).all()) and self.excitation.bounds(self.model(k))
