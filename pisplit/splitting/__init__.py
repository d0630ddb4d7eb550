"""How the known half step K_f and trajectory data make one operator K: Strang, Lie, balanced, hold, two stages.

A splitting is built once a fit, gives a solver for a set of pairs, and that a fit for every alpha.
"""

from pisplit.splitting.balanced import Balanced
from pisplit.splitting.base import (
    Direct,
    Lie,
    Rows,
    SplitContext,
    SplitFit,
    Splitting,
    Strang,
    composed_solver,
    pair_moments,
)
from pisplit.splitting.two_stage import TwoStage

__all__ = [
    "Balanced",
    "Direct",
    "Lie",
    "Rows",
    "SplitContext",
    "SplitFit",
    "Splitting",
    "Strang",
    "TwoStage",
    "composed_solver",
    "pair_moments",
]
