"""What the fits of one estimator to one set of data have in common, whatever their alpha."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.data.episodes import Episodes, Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.boundedness import Excitation
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import operators
from pisplit.regression.moments import Moments

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """What alpha is chosen on.

    episodes  that are rolled out
    numbers   of these among the training episodes
    moments   of the pairs that are left to learn from
    base      the model that learns from these, but for its dynamics
    """

    episodes: Episodes
    numbers: tuple[int, ...]
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
    base        the model but for its dynamics: lifting, read-out, names
    held        None where alpha is given
    excitation  what models must survive, or None
    """

    d1: Episodes
    theta: Dictionary
    pairs: Pairs
    n_equilibria: int
    moments: Moments
    scale: Array
    base: LiftedModel
    held: HeldOut | None
    excitation: Excitation | None

    def model(self, k: Array) -> LiftedModel:
        """The model with the learned rows ``k`` (S, M)."""
        return replace(self.base, **operators(self.theta, k))

    def without_held_out(self, k: Array) -> LiftedModel:
        """The model with the learned rows ``k`` (S, M) that has not seen the held-out episodes."""
        return replace(self.held.base if self.held else self.base, **operators(self.theta, k))

    def stays_bounded(self, k: Array, model: LiftedModel) -> bool:
        """True if the ``model`` of the learned rows ``k`` stays bounded under the excitation, or nobody asks."""
        if self.excitation is None:
            return True
        return bool(np.isfinite(k).all()) and self.excitation.bounds(model)
