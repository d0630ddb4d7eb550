"""Ridge or LASSO toward a physical map: from the data alone to the physics alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pisplit.data.episodes import Pairs
from pisplit.regression import penalised, unit_weight
from pisplit.splitting.base import Solver, SplitContext, SplitFit, Splitting

#: Grids of alpha="cv", relative: both ends are limits, the data alone (EDMDc) and the physical map alone.
GRIDS = {
    "ridge": (0.0, *np.logspace(-12, 8, 11).tolist()),
    "lasso": (0.0, *np.logspace(-8, 0, 9).tolist()),
}


class TwoStage:
    """A splitting, fitted without a penalty, then a regression of the whole operator toward its map.

    K = argmin |K Theta - psi'|^2 + alpha |K - K_0| in scaled columns, all rows free, K_0 the map of the splitting.
    alpha = 0 is EDMDc, nearest to K_0 where the data leave it open; a large alpha is K_0, its constant included.
    """

    def __init__(self, context: SplitContext, splitting: Callable[[SplitContext], Splitting]) -> None:
        self.context = context
        self.first = splitting(replace(context, penalty="ridge", toward="zero", solver="auto"))
        self.alphas = GRIDS[context.penalty]

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        context = self.context
        learned, size = context.theta.learned_columns, context.theta.n_columns
        physical = self.first.solver(pairs)(0.0)
        own = context.scale[learned]
        moments = context.moments(pairs).scaled(np.concatenate([context.scale, own]))
        rows = moments.rows(centred=False)
        a, y = rows[:, :size], rows[:, size:]
        prior = physical.K * context.scale / own[:, None]
        residual = y - a @ prior.T
        unit = unit_weight(a, residual, context.penalty)

        def solve(alpha: float) -> SplitFit:
            weight = context.weight(alpha, unit, moments.n_samples)
            fit = penalised(a, residual, weight, context.penalty, context.solver)
            k = (prior + fit.K) * own[:, None] / context.scale
            return SplitFit(K=k, alpha=weight, rank=fit.rank, gap=fit.gap, details=physical.details)

        return solve
