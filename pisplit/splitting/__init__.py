"""How the known half step K_f and trajectory data make one operator K: Strang, Lie, balanced, hold, two stages.

A splitting takes the three steps of the paper's Algorithm 1 (alg:pi-edmdc): its known part from phase samples, its
unknown part from pairs for a weight alpha, the operator composed of both.
"""

from pisplit.splitting.balanced import Balanced
from pisplit.splitting.base import SplitContext, SplitFit, Splitting, Unknown, known_half_step, pair_moments
from pisplit.splitting.direct import Direct
from pisplit.splitting.lie import Lie
from pisplit.splitting.rows import Rows, free_block
from pisplit.splitting.strang import Strang
from pisplit.splitting.two_stage import TwoStage
from pisplit.splitting.unknown_part import composed_residual_ridge, pulled_back_lasso, unknown_part

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
    "Unknown",
    "composed_residual_ridge",
    "free_block",
    "known_half_step",
    "pair_moments",
    "pulled_back_lasso",
    "unknown_part",
]
