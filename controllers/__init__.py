"""Linear MPC on a lifted model and closed loops on a plant."""

from pisplit.controllers import plants, references
from pisplit.controllers.estimation.kalman import KalmanFilter
from pisplit.controllers.estimation.watch import InnovationWatch
from pisplit.controllers.feedforward import FeedForward
from pisplit.controllers.learning import environment
from pisplit.controllers.loop.following import LoopStep
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.loop import ClosedLoop
from pisplit.controllers.loop.plant import Plant, PlantStep
from pisplit.controllers.loop.reidentify import Identifier, NewModel
from pisplit.controllers.loop.tracking import Controller, Move
from pisplit.controllers.mpc.condense import Condensed, condense
from pisplit.controllers.mpc.mpc import MPC
from pisplit.controllers.mpc.qp import QPSettings
from pisplit.controllers.mpc.reach import within_reach
from pisplit.controllers.references import Reference
from pisplit.controllers.tuning import Tuned, tune

__all__ = [
    "MPC",
    "ClosedLoop",
    "Condensed",
    "Controller",
    "FeedForward",
    "Identifier",
    "InnovationWatch",
    "KalmanFilter",
    "LoopLog",
    "LoopStep",
    "Move",
    "NewModel",
    "Plant",
    "PlantStep",
    "QPSettings",
    "Reference",
    "Tuned",
    "condense",
    "environment",
    "plants",
    "references",
    "tune",
    "within_reach",
]
