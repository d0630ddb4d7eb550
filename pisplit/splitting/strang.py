"""Strang splitting: the paper's PI-EDMDc."""

from __future__ import annotations

from pisplit.generator import HalfStep
from pisplit.regression.moments import Moments
from pisplit.splitting.base import SplitContext, SplitFit, Unknown, facts, known_half_step
from pisplit.splitting.unknown_part import unknown_part


class Strang:
    """K = K_f(dt/2) K_h(dt) K_f(dt/2) for x' = f + h, of second order in dt.

    Paper, eq. koopman_strang_splitting and alg:pi-edmdc; f and h are those of its eq. linearly_separable_diffeq.

    context  what it may use (:class:`pisplit.splitting.SplitContext`)
    """

    def __init__(self, context: SplitContext) -> None:
        self.context = context

    def known(self) -> HalfStep:
        """K_f(dt/2) from phase samples (paper, eq. cont_koopman_solve and eq. matrix_exp)."""
        return known_half_step(self.context)

    def unknown(self, k_f: HalfStep, moments: Moments, alpha: float) -> Unknown:
        """K_h(dt) between two half steps ``k_f``, from ``moments`` of pairs (paper, eq. full_kth); ``alpha`` weighs."""
        return unknown_part(self.context, k_f.K, k_f.K, moments, alpha)

    def composed(self, k_f: HalfStep, k_h: Unknown) -> SplitFit:
        """K_f K_h K_f of the half step ``k_f`` and the kick ``k_h`` (paper, eq. koopman_strang_splitting)."""
        k = k_f.K @ k_h.K @ k_f.K
        return SplitFit.of(self.context, k[self.context.theta.learned_columns], k_h, facts(k_f))
