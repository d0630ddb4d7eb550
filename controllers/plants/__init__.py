"""Plants around a plant: what sensors, servos, networks and logs do to measurements and commands."""

from pisplit.controllers.plants.commands import ActuatedPlant, DelayedCommands, QuantisedCommands
from pisplit.controllers.plants.frozen import FrozenMeasurements
from pisplit.controllers.plants.markers import Markers
from pisplit.controllers.plants.measurements import DelayedMeasurements, LostMeasurements, NoisyMeasurements, Outliers
from pisplit.controllers.plants.modelled import ModelPlant
from pisplit.controllers.plants.remote import SocketPlant, serve
from pisplit.controllers.plants.wrapped import WrappedPlant

__all__ = [
    "ActuatedPlant",
    "DelayedCommands",
    "DelayedMeasurements",
    "FrozenMeasurements",
    "LostMeasurements",
    "Markers",
    "ModelPlant",
    "NoisyMeasurements",
    "Outliers",
    "QuantisedCommands",
    "SocketPlant",
    "WrappedPlant",
    "serve",
]
