"""No splitting: one regression of the whole operator."""

from __future__ import annotations

import numpy as np

from pisplit.regression.moments import Moments
from pisplit.splitting.base import SplitContext, SplitFit
from pisplit.splitting.unknown_part import unknown_part


class Direct:
    """K = argmin |K Theta(X, U) - Theta(X', U)|^2 + alpha |K|: EDMDc (paper, eq. discrete-time-koop).

    context  what it may use (:class:`pisplit.splitting.SplitContext`)
    """

    def __init__(self, context: SplitContext) -> None:
        self.context = context

    def fit(self, moments: Moments, alpha: float) -> SplitFit:
        """K from ``moments`` of pairs; ``alpha`` weighs the penalty."""
        identity = np.eye(self.context.theta.n_columns)
        k = unknown_part(self.context, identity, identity, moments, alpha)
        return SplitFit.of(self.context, k.K[self.context.theta.learned_columns], k, {})
