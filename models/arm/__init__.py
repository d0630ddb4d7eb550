"""Tendon-driven arms of one section or several: scenes, recordings and phase samples made with them.

Of one section also the table of its equilibria, the known physics and models of a twin.
"""

from pisplit.models.arm.base import Arm
from pisplit.models.arm.disk_robot import DiskRobot, disk_robot
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.multi_section_arm import MultiSectionArm
from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples
from pisplit.models.arm.physics import ArmPhysics
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.recording import make_episodes, random_displacements
from pisplit.models.arm.resting import RestShapes
from pisplit.models.arm.static_table import EquilibriumTable, OutsideTable, equilibrium_table
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.arm.twin import twin_alone, twin_dictionaries, twin_dictionary

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
    "make_episodes",
    "make_phase_samples",
    "random_displacements",
    "twin_alone",
    "twin_dictionaries",
    "twin_dictionary",
]
