"""Linear MPC on a lifted model: condensed QP, limits, OSQP, re-linearisation along the plan."""

from pisplit.controllers.mpc.condense import Condensed, condense
from pisplit.controllers.mpc.mpc import MPC
from pisplit.controllers.mpc.qp import QPSettings
from pisplit.controllers.mpc.reach import within_reach

__all__ = [
    "MPC",
    "Condensed",
    "QPSettings",
    "condense",
    "within_reach",
]
