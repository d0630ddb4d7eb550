"""The tendon-driven arm: its scene, table of equilibria, known physics, recordings and phase samples made with it."""

from pisplit.models.arm.physics import ArmPhysics
from pisplit.models.arm.recording import (
    deviations_from_equilibrium,
    make_episodes,
    make_phase_samples,
    random_displacements,
)
from pisplit.models.arm.static_table import EquilibriumTable, OutsideTable, equilibrium_table
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.arm.twin import twin_alone, twin_dictionaries, twin_dictionary

__all__ = [
    "ArmPhysics",
    "EquilibriumTable",
    "OutsideTable",
    "TendonArm",
    "deviations_from_equilibrium",
    "equilibrium_table",
    "make_episodes",
    "make_phase_samples",
    "random_displacements",
    "twin_alone",
    "twin_dictionaries",
    "twin_dictionary",
]
