"""Cosserat-rod scenes in CasADi: statics by rootfinding, dynamics by IDAS.

A scene is a rod and terms that act on it::

    arm = rod.Scene(rod.Rod(...), rod.Gravity((-9.81, 0, 0)), rod.Tendons.parallel(...))
    arm.statics().solve(u)      arm.simulator(dt=0.03).run(U)      arm.fields(states, stations=6)
"""

from pisplit.models.rod.answers import Unresolved
from pisplit.models.rod.dynamics.driven import tip_commands
from pisplit.models.rod.kinematics.strains import StrainSet
from pisplit.models.rod.scene import Scene
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.section.material import Elastic, Stiffness
from pisplit.models.rod.section.section import Circle, GeneralSection, Tapered, Tube
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.buoyancy import Buoyancy
from pisplit.models.rod.terms.chambers import Chambers
from pisplit.models.rod.terms.damping import KelvinVoigt, Retardation
from pisplit.models.rod.terms.distributed import DistributedWrench
from pisplit.models.rod.terms.drag import AnisotropicDrag, LinearDrag, QuadraticDrag
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.held import HeldTip
from pisplit.models.rod.terms.loads import Input, NoEffect
from pisplit.models.rod.terms.maxwell import Maxwell
from pisplit.models.rod.terms.points import PointMass, PointWrench, Spring
from pisplit.models.rod.terms.routing import Helix, Line
from pisplit.models.rod.terms.tendons import Displacement, Tendons, Tension
from pisplit.models.rod.terms.wrench import TipWrench

__all__ = [
    "AnisotropicDrag",
    "Base",
    "Buoyancy",
    "Chambers",
    "Circle",
    "Displacement",
    "DistributedWrench",
    "Elastic",
    "GeneralSection",
    "Gravity",
    "HeldTip",
    "Helix",
    "Input",
    "KelvinVoigt",
    "Line",
    "LinearDrag",
    "Maxwell",
    "NoEffect",
    "PointMass",
    "PointWrench",
    "QuadraticDrag",
    "Retardation",
    "Rod",
    "Scene",
    "Spring",
    "Stiffness",
    "StrainSet",
    "Tapered",
    "Tendons",
    "Tension",
    "TipWrench",
    "Tube",
    "Unresolved",
    "tip_commands",
]
