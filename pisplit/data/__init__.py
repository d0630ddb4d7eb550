"""What was recorded and what is sampled: episodes, snapshot pairs, phase samples, recordings of other tools, files.

Everything a model learns from comes through here and is checked here; files are HDF5, written whole or not at all.
"""

from pisplit.data.episodes import Episodes, Pairs, SimulatedSystem, Start, excited_directions
from pisplit.data.phase import KnownSystem, PhaseSamples
from pisplit.data.units import columns_to_si, to_si

__all__ = [
    "Episodes",
    "KnownSystem",
    "Pairs",
    "PhaseSamples",
    "SimulatedSystem",
    "Start",
    "columns_to_si",
    "excited_directions",
    "to_si",
]
