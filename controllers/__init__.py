"""Linear MPC on a lifted model and closed loops on a plant."""

from . import references
from .condense import Condensed, condense
from .feedforward import FeedForward
from .loop import ClosedLoop, LoopLog
from .mpc import MPC
from .plant import Plant, PlantStep
from .qp import QPSettings
from .references import Reference
from .tracking import Controller, Move

__all__ = [
    "MPC",
    "ClosedLoop",
    "Condensed",
    "Controller",
    "FeedForward",
    "LoopLog",
    "Move",
    "Plant",
    "PlantStep",
    "QPSettings",
    "Reference",
    "condense",
    "references",
]
