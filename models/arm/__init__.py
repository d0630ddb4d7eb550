"""Tendon-driven arms of one section or several: scenes, recordings and phase samples made with them.

Of one section also the table of its equilibria, the known physics and models of a twin.
"""

import importlib as _importlib
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from pisplit.models.arm.base import Arm
from pisplit.models.arm.disk_robot import DiskRobot, disk_robot
from pisplit.models.arm.tendon_arm import TendonArm

if _TYPE_CHECKING:
    from pisplit.models.arm.marker_states import fields_from_markers
    from pisplit.models.arm.motion_capture import MotionCapture
    from pisplit.models.arm.multi_section_arm import MultiSectionArm
    from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples
    from pisplit.models.arm.physics import ArmPhysics
    from pisplit.models.arm.predictor import ArmPredictor
    from pisplit.models.arm.recording import make_episodes, random_displacements
    from pisplit.models.arm.resting import RestShapes
    from pisplit.models.arm.simulated import fit_simulated, simulated_recordings
    from pisplit.models.arm.static_table import EquilibriumTable, OutsideTable, equilibrium_table
    from pisplit.models.arm.twin import twin_alone, twin_dictionaries, twin_dictionary

#: Names by the module that is loaded when one of them is first used.
_PLACES = {
    "pisplit.models.arm.marker_states": "fields_from_markers",
    "pisplit.models.arm.motion_capture": "MotionCapture",
    "pisplit.models.arm.multi_section_arm": "MultiSectionArm",
    "pisplit.models.arm.phase_samples": "deviations_from_equilibrium make_phase_samples",
    "pisplit.models.arm.physics": "ArmPhysics",
    "pisplit.models.arm.predictor": "ArmPredictor",
    "pisplit.models.arm.recording": "make_episodes random_displacements",
    "pisplit.models.arm.resting": "RestShapes",
    "pisplit.models.arm.simulated": "fit_simulated simulated_recordings",
    "pisplit.models.arm.static_table": "EquilibriumTable OutsideTable equilibrium_table",
    "pisplit.models.arm.twin": "twin_alone twin_dictionaries twin_dictionary",
}
_HOME = {name: module for module, names in _PLACES.items() for name in names.split()}

__all__ = [
    "Arm",
    "ArmPhysics",
    "ArmPredictor",
    "DiskRobot",
    "EquilibriumTable",
    "MotionCapture",
    "MultiSectionArm",
    "OutsideTable",
    "RestShapes",
    "TendonArm",
    "deviations_from_equilibrium",
    "disk_robot",
    "equilibrium_table",
    "fields_from_markers",
    "fit_simulated",
    "make_episodes",
    "make_phase_samples",
    "random_displacements",
    "simulated_recordings",
    "twin_alone",
    "twin_dictionaries",
    "twin_dictionary",
]


def __getattr__(name: str) -> _Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(_importlib.import_module(_HOME[name]), name)
    return value
