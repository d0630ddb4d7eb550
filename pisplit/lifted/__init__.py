"""The identified model z+ = A z + B phi(u) (+ sum u_i N_i z), y = C z, and what is done with it.

Roll-outs, operators in physical units, export to other tools, spectral radius, modes, reduction, sensitivities.
"""

from pisplit.lifted.formats import to_c_header, to_control, to_numpy, to_state_space
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import Modes, modes
from pisplit.lifted.radius import limited_radius, stabilised
from pisplit.lifted.reduction import Reduction, balanced_truncation
from pisplit.lifted.rollout import Rollout
from pisplit.lifted.sensitivity import input_jacobian, rollout_jacobian

__all__ = [
    "LiftedModel",
    "Modes",
    "Reduction",
    "Rollout",
    "balanced_truncation",
    "input_jacobian",
    "limited_radius",
    "modes",
    "rollout_jacobian",
    "stabilised",
    "to_c_header",
    "to_control",
    "to_numpy",
    "to_state_space",
]
