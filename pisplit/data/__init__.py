"""What was recorded and what is sampled: episodes, snapshot pairs, phase samples, recordings of other tools, files.

Everything a model learns from comes through here and is checked here; files are HDF5, written whole or not at all.
"""

from pisplit.data.actuator import Actuator, ActuatorState
from pisplit.data.columns import column_order, unit_factors
from pisplit.data.episodes import Episodes, SimulatedSystem
from pisplit.data.latency import Latency, find_latency
from pisplit.data.pairs import Pairs, Start
from pisplit.data.phase import KnownSystem, PhaseSamples
from pisplit.data.report import Column, DataReport
from pisplit.data.units import columns_to_si, to_si

__all__ = [
    "Actuator",
    "ActuatorState",
    "Column",
    "DataReport",
    "Episodes",
    "KnownSystem",
    "Latency",
    "Pairs",
    "PhaseSamples",
    "SimulatedSystem",
    "Start",
    "column_order",
    "columns_to_si",
    "find_latency",
    "to_si",
    "unit_factors",
]
