"""What was recorded and what is sampled: episodes, snapshot pairs, phase samples, recordings of other tools, files.

Everything a model learns from comes through here and is checked here; files are HDF5, written whole or not at all.
"""

import importlib as _importlib
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

if _TYPE_CHECKING:
    from pisplit.data.actuator import Actuator, ActuatorState
    from pisplit.data.columns import column_order, unit_factors
    from pisplit.data.episodes import Episodes, SimulatedSystem
    from pisplit.data.latency import Latency, find_latency
    from pisplit.data.pairs import Pairs, Start
    from pisplit.data.phase import KnownSystem, PhaseSamples
    from pisplit.data.report import Column, DataReport
    from pisplit.data.units import columns_to_si, to_si
    from pisplit.data.unrounding import unrounded

#: Names by the module that is loaded when one of them is first used.
_PLACES = {
    "pisplit.data.actuator": "Actuator ActuatorState",
    "pisplit.data.columns": "column_order unit_factors",
    "pisplit.data.episodes": "Episodes SimulatedSystem",
    "pisplit.data.latency": "Latency find_latency",
    "pisplit.data.pairs": "Pairs Start",
    "pisplit.data.phase": "KnownSystem PhaseSamples",
    "pisplit.data.report": "Column DataReport",
    "pisplit.data.units": "columns_to_si to_si",
    "pisplit.data.unrounding": "unrounded",
}
_HOME = {name: module for module, names in _PLACES.items() for name in names.split()}

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
    "unrounded",
]


def __getattr__(name: str) -> _Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(_importlib.import_module(_HOME[name]), name)
    return value
