"""EDMDc on data that stream in, with forgetting."""

from __future__ import annotations

from typing import Any

import numpy as np

from pisplit.checks import non_negative
from pisplit.data.episodes import Episodes, Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.parameters import Parameters
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import lifted_model
from pisplit.regression import ridge
from pisplit.regression.moments import block_rows
from pisplit.regression.recursive import RecursiveRegression
from pisplit.regression.scaling import column_scales


class StreamingEDMDc(Parameters):
    """L-EDMDc whose data arrive in pieces: memory is one triangle, and the answer that of all pairs so far at once.

    theta       dictionary
    forgetting  a pair that is j pairs old counts ``forgetting`` ** j; 1 remembers everything
    alpha       ridge, relative to the mean diagonal of the Gram matrix of columns scaled by quantity; with forgetting
                it keeps directions that are no longer excited from drifting

    With forgetting = 1 and alpha = 0 it equals LinearEDMDc on all pairs.
    """

    def __init__(self, theta: Dictionary, forgetting: float = 1.0, alpha: float = 0.0) -> None:
        non_negative(alpha, "alpha")
        self.theta = theta
        self.forgetting = forgetting
        self.alpha = alpha
        self._restart()

    def set_params(self, **params: Any) -> StreamingEDMDc:
        """Change options ``params``; with another dictionary or forgetting the data so far are forgotten."""
        super().set_params(**params)
        if {"theta", "forgetting"} & set(params):
            self._restart()
        return self

    def _restart(self) -> None:
        self.regression = RecursiveRegression(self.theta.n_columns, len(self.theta.learned_columns), self.forgetting)
        self._latest: tuple[Dictionary, Episodes, Pairs] | None = None

    def update(self, episodes: Episodes) -> StreamingEDMDc:
        """Add all pairs of new episodes, oldest first. Returns itself.

        Columns are matched by name with those of the first episodes. Raises ValueError if these cannot be found, or
        have another unit or time step.
        """
        if self._latest is None:
            episodes = episodes.arranged(*self.theta.wanted_names, owner="the dictionary")
            theta = self.theta.named_after(episodes)
        else:
            theta, before, _ = self._latest
            if abs(episodes.dt - before.dt) > 1e-9 * before.dt:
                raise ValueError(f"new episodes have dt = {episodes.dt:g} s; those before {before.dt:g} s")
            wanted = (before.state_names, before.input_names, before.units, before.input_units)
            episodes = episodes.arranged(*wanted, owner="the episodes before")
        pairs = episodes.pairs(theta.n_delays)
        for block in pairs.blocks(block_rows(theta.n_columns)):
            self.regression.update(theta.evaluate(block), theta.next_learned(block))
        self._latest = theta, episodes, pairs
        return self

    @property
    def lifted(self) -> LiftedModel:
        """The model of all pairs so far; ranges and excited inputs are those of the latest episodes."""
        if self._latest is None:
            raise ValueError("StreamingEDMDc has no data; call update first")
        theta, episodes, pairs = self._latest
        a, y = self.regression.rows
        size = np.sqrt((a**2).sum(axis=0) / self.regression.effective_samples)
        scale = column_scales(size, theta.column_quantities)
        scaled = a / scale
        fit = ridge(scaled, y, self.alpha * float((scaled**2).sum()) / a.shape[1])
        provenance = {
            "estimator": type(self).__name__,
            "alpha": self.alpha,
            "forgetting": self.regression.forgetting,
            "pairs": self.regression.n_samples,
        }
        return lifted_model(theta, fit.K / scale, episodes, pairs, provenance)
