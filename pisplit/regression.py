"""Multi-target linear regression Y ~ A K^T: least squares, ridge, LASSO, and ridge through a known left factor.

A (N, M) holds one sample a row, Y (N, S) its targets; K (S, M) is the operator of the paper, K a ~ y. Penalties act on
K - prior. ``free`` (S, M) marks the entries that may differ from the prior; the others are fixed to it.
"""

from pisplit.lasso import alpha_max, lasso, lasso_path
from pisplit.least_squares import composed_ridge, least_squares, ridge
from pisplit.multi_target import Regression

PENALTIES = ("ridge", "lasso")

__all__ = [
    "PENALTIES",
    "Regression",
    "alpha_max",
    "composed_ridge",
    "lasso",
    "lasso_path",
    "least_squares",
    "ridge",
]
