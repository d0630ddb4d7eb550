"""Multi-target regressions K = argmin |A K^T - Y|^2 + penalty: least squares, ridge, LASSO, recursive.

They work on moments that are accumulated in blocks; penalties act on K - prior, ``free`` marks what may differ from it.
"""

from pisplit.regression.lasso import SOLVERS, alpha_max, composed_lasso, lasso, lasso_path
from pisplit.regression.least_squares import composed_ridge, least_squares, ridge
from pisplit.regression.moments import Moments, accumulate, triangular_factor
from pisplit.regression.multi_target import Regression
from pisplit.regression.penalties import PENALTIES, absolute_weight, check_penalty, penalised, unit_weight
from pisplit.regression.recursive import RecursiveRegression
from pisplit.regression.scaling import column_scales

__all__ = [
    "PENALTIES",
    "SOLVERS",
    "Moments",
    "RecursiveRegression",
    "Regression",
    "absolute_weight",
    "accumulate",
    "alpha_max",
    "check_penalty",
    "column_scales",
    "composed_lasso",
    "composed_ridge",
    "lasso",
    "lasso_path",
    "least_squares",
    "penalised",
    "ridge",
    "triangular_factor",
    "unit_weight",
]
