"""EDMDc on data that stream in, with forgetting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pisplit.checks import check_same_step, non_negative
from pisplit.data.episodes import Episodes
from pisplit.data.noise import noise_margins
from pisplit.data.pairs import Pairs
from pisplit.data.sums import not_episodes, together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import Estimator
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import lifted_model
from pisplit.regression import ridge
from pisplit.regression.moments import block_rows
from pisplit.regression.recursive import RecursiveRegression
from pisplit.regression.scaling import column_scales
from pisplit.threads import one_blas_thread


class StreamingEDMDc(Estimator):
    """L-EDMDc whose data arrive in pieces: memory is one triangle, and the answer that of all pairs so far at once.

    theta       dictionary
    forgetting  a pair that is j pairs old counts ``forgetting`` ** j; 1 remembers everything
    alpha       ridge, relative to the mean diagonal of the Gram matrix of columns scaled by quantity; with forgetting
                it keeps directions that are no longer excited from drifting

    With forgetting = 1 and alpha = 0 it equals LinearEDMDc on all pairs.

    Raises ValueError for a ``theta`` that is no Dictionary, and for numbers out of range.
    """

    _latest: tuple[Dictionary, Episodes, Pairs] | None

    def __init__(self, theta: Dictionary, forgetting: float = 1.0, alpha: float = 0.0) -> None:
        if not isinstance(theta, Dictionary):
            raise ValueError(f"theta is a {type(theta).__name__}; expected a Dictionary")
        non_negative(alpha, "alpha")
        self.theta = theta
        self.forgetting = forgetting
        self.alpha: float = alpha
        self._forget()

    def update(self, episodes: Episodes, pairs: Pairs | None = None) -> StreamingEDMDc:
        """Add all pairs of new ``episodes``, or ``pairs`` drawn from them, oldest first. Returns itself.

        Columns are matched by name with those of the first episodes. Raises ValueError if these cannot be found, or
        have another unit or time step.
        """
        if not isinstance(episodes, Episodes):
            raise ValueError(not_episodes(episodes, "episodes"))
        if self._latest is None:
            names = self.theta.wanted_names
            arranged = episodes.arranged(*names, owner="the dictionary")
            theta = self._dictionary(arranged)
        else:
            theta, before, _ = self._latest
            check_same_step(episodes.dt, before.dt, "new episodes have", "those before")
            wanted = (before.state_names, before.input_names, before.units, before.input_units)
            arranged = episodes.arranged(*wanted, owner="the episodes before")
        if pairs is not None and arranged is not episodes:
            raise ValueError("pairs were drawn from episodes with other columns; draw them from episodes.arranged(...)")
        used = arranged.pairs(theta.n_delays) if pairs is None else arranged.checked_pairs(pairs, theta.n_delays)
        for block in used.blocks(block_rows(theta.n_columns)):
            self.regression.update(theta.evaluate(block), theta.next_learned(block))
        self._latest = theta, arranged, used
        return self

    @one_blas_thread()
    def fit(self, d1: Episodes | Sequence[Episodes], pairs: Pairs | None = None) -> StreamingEDMDc:
        """Forget everything, then :meth:`update` with the episodes ``d1``, or ``pairs`` drawn from them."""
        self._forget()
        return self.update(together(d1, "d1"), pairs)

    def _forget(self) -> None:
        self.regression = RecursiveRegression(self.theta.n_columns, len(self.theta.learned_columns), self.forgetting)
        self._latest = None

    @property
    def theta_(self) -> Dictionary:  # type: ignore[override]
        """The dictionary with the names of the data."""
        return self._data()[0]

    @property
    def lifted(self) -> LiftedModel:  # type: ignore[override]
        """The model of all pairs so far; ranges and excited inputs are those of the latest episodes."""
        theta, episodes, pairs = self._data()
        a, y = self.regression.rows
        size = np.sqrt((a**2).sum(axis=0) / self.regression.effective_samples)
        scale = column_scales(size, theta.column_quantities, margins=noise_margins(episodes))
        scaled = a / scale
        fit = ridge(scaled, y, self.alpha * float((scaled**2).sum()) / a.shape[1])
        provenance = {
            "estimator": type(self).__name__,
            "alpha": self.alpha,
            "forgetting": self.regression.forgetting,
            "pairs": self.regression.n_samples,
        }
        return lifted_model(theta, fit.K / scale, episodes, pairs, provenance)

    def _fitted(self) -> LiftedModel:
        return self.lifted

    def _data(self) -> tuple[Dictionary, Episodes, Pairs]:
        if self._latest is None:
            raise ValueError("StreamingEDMDc has no data; call update first")
        return self._latest
