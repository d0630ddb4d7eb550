"""A controller in closed loop with a plant, and the log of it."""

from pisplit.controllers.loop.following import LoopStep
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.loop import ClosedLoop
from pisplit.controllers.loop.plant import Plant, PlantStep
from pisplit.controllers.loop.tracking import Controller, Move

__all__ = [
    "ClosedLoop",
    "Controller",
    "LoopLog",
    "LoopStep",
    "Move",
    "Plant",
    "PlantStep",
]
