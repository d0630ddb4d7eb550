"""Ridge or LASSO toward a physical map: from the data alone to the physics alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pisplit.regression import penalised, unit_weight
from pisplit.regression.kept import Kept
from pisplit.regression.moments import Moments
from pisplit.splitting.base import Array, SplitContext, SplitFit, Splitting, Unknown

#: Grids of alpha="cv", relative: both ends are limits, the data alone (EDMDc) and the physical map alone.
GRIDS = {
    "ridge": (0.0, *np.logspace(-12, 8, 11).tolist()),
    "lasso": (0.0, *np.logspace(-8, 0, 9).tolist()),
}


class TwoStage:
    """A splitting, fitted without a penalty, then a regression of the whole operator toward its map.

    K = argmin |K Theta - psi'|^2 + alpha |K - K_0| in scaled columns, all rows free, K_0 the map of the splitting.
    alpha = 0 is EDMDc, nearest to K_0 where the data leave it open; a large alpha is K_0, its constant included.

    context    what it may use (:class:`pisplit.splitting.SplitContext`)
    splitting  class of the first stage
    """

    def __init__(self, context: SplitContext, splitting: Callable[[SplitContext], Splitting[Any]]) -> None:
        self.context = context
        self.first = splitting(replace(context, penalty="ridge", toward="zero", solver="auto"))
        self.alphas = GRIDS[context.penalty]
        self.physical: Kept[SplitFit] = Kept()

    def known(self) -> Any:
        """The known part of the first stage."""
        return self.first.known()

    def unknown(self, k_f: Any, moments: Moments, alpha: float) -> Unknown:
        """Departure from the physical map of the known part ``k_f``, from ``moments`` of pairs; ``alpha`` weighs it."""
        physical = self.physical(moments, lambda: self.first.composed(k_f, self.first.unknown(k_f, moments, 0.0)))
        return departure(self.context, physical.K, moments, alpha, physical.details)

    def composed(self, k_f: Any, k_h: Unknown) -> SplitFit:
        """The physical map of ``k_f`` plus the departure ``k_h``."""
        return departed(self.context, k_h)


def departure(
    context: SplitContext, physical: Array, moments: Moments, alpha: float, details: Mapping[str, Any]
) -> Unknown:
    """K - K_0 = argmin |K Theta - psi'|^2 + alpha |K - K_0| on the scaled columns of ``context``.

    ``physical`` (S, M) is K_0 in physical units, ``details`` are facts about it, ``moments`` those of pairs; ``alpha``
    in the unit of the context. With a LASSO the departure is sparse.
    """
    around = physical * context.scale / context.scale[context.theta.learned_columns][:, None]
    a, y, _, _ = context.scaled(moments, centred=False)
    residual = y - a @ around.T
    weight = context.weight(alpha, unit_weight(a, residual, context.penalty), moments.n_samples)
    fit = penalised(a, residual, weight, context.penalty, context.solver)
    return Unknown(fit.K, weight, fit.rank, fit.gap, details, around)


def departed(context: SplitContext, found: Unknown) -> SplitFit:
    """The map that the departure ``found`` leads to, in the physical units of ``context``."""
    assert found.around is not None
    return SplitFit.of(context, found.around + found.K, found, {})
