"""Cosserat-rod scenes in CasADi: statics by rootfinding, dynamics by IDAS.

A scene is a rod and terms that act on it::

    arm = rod.Scene(rod.Rod(...), rod.Gravity((-9.81, 0, 0)), rod.Tendons.parallel(...))
    arm.statics().solve(u)      arm.simulator(dt=0.03).run(U)      arm.fields(states, stations=6)
"""

from pisplit.models.rod.base import Base
from pisplit.models.rod.body import Rod
from pisplit.models.rod.buoyancy import Buoyancy
from pisplit.models.rod.chambers import Chambers
from pisplit.models.rod.damping import KelvinVoigt, Retardation
from pisplit.models.rod.distributed import DistributedWrench
from pisplit.models.rod.drag import AnisotropicDrag, LinearDrag, QuadraticDrag
from pisplit.models.rod.gravity import Gravity
from pisplit.models.rod.loads import Input
from pisplit.models.rod.material import Elastic, Stiffness
from pisplit.models.rod.points import PointMass, PointWrench, Spring
from pisplit.models.rod.routing import Helix, Line
from pisplit.models.rod.scene import Scene
from pisplit.models.rod.section import Circle, GeneralSection, Tapered, Tube
from pisplit.models.rod.strains import StrainSet
from pisplit.models.rod.tendons import Displacement, Tendons, Tension
from pisplit.models.rod.wrench import TipWrench

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
    "Helix",
    "Input",
    "KelvinVoigt",
    "Line",
    "LinearDrag",
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
]
