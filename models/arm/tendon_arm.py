"""The tendon-driven arm of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pisplit.models import rod
from pisplit.models.arm.base import Arm, paper_scene
from pisplit.models.arm.drawing import drawn_scene
from pisplit.models.rod.terms.pull import TendonTerm


@dataclass(frozen=True)
class TendonArm(Arm):
    """An elastic backbone with one group of tendons that are pulled by displacements: a scene, or a drawing of it.

    Raises ValueError where the scene has no tendons, several groups of them, or other inputs, or where pretension or
    amplitude are no lengths; for a drawing that misses a word, has numbers in other units, or does not rest.

    Args:
        scene: backbone, environment and tendons: the arm itself, made from the words below where it is not given.
        pretension: common displacement in m of all tendons at rest; it keeps them taut. A drawn arm has by default what
            gives 1.5 times the tension that holds it bent and against its weight.
        amplitude: usual size in m of differential displacements; of a drawn arm what turns its tip by 0.66 rad.
        length: of the backbone in m.
        radius: of the backbone in m.
        material: "steel", "nitinol", "carbon fibre", "fibreglass", "nylon" or ``rod.Elastic``.
        offset: of the tendons from the axis in m.
        angles_deg: of the tendons about the axis in degrees, from x towards y.
        mass: of backbone and disks together in kg, even along the arm; that of the bare backbone if not given.
        tip_mass: at the tip in kg.
        damping_ratio: of the slowest motion about rest, in parts of critical damping.
        down: where gravity pulls, as seen from the arm, whose straight backbone points along +z from its base:
            "+z" hangs, "-z" stands, "-x" reaches out sideways.
        tendon_stiffness: tension of a tendon per strain (its EA) in N.
        nodes: number of Gauss nodes.
    """

    def __init__(
        self,
        scene: rod.Scene | None = None,
        pretension: float | None = None,
        amplitude: float | None = None,
        *,
        length: float | None = None,
        radius: float | None = None,
        material: str | rod.Elastic | None = None,
        offset: float | None = None,
        angles_deg: Sequence[float] = (0.0, 120.0, 240.0),
        mass: float | None = None,
        tip_mass: float = 0.0,
        damping_ratio: float = 0.05,
        down: str = "+z",
        tendon_stiffness: float = 1e4,
        nodes: int = 5,
    ) -> None:
        words = {"length": length, "radius": radius, "material": material, "offset": offset}
        given = [name for name, value in words.items() if value is not None]
        if scene is None:
            if length is None or radius is None or material is None or offset is None:
                missing = ", ".join(name for name in words if name not in given)
                raise ValueError(f"TendonArm misses {missing}; a drawing says {', '.join(words)}, or give a scene")
            scene, taut, usual = drawn_scene(
                length,
                radius,
                material,
                offset,
                angles_deg,
                mass,
                tip_mass,
                damping_ratio,
                down,
                tendon_stiffness,
                nodes,
            )
            pretension = taut if pretension is None else pretension
            amplitude = usual if amplitude is None else amplitude
        elif given:
            raise ValueError(f"TendonArm has a scene and the words {', '.join(given)}; give one or the other")
        for name, value in (("scene", scene), ("pretension", pretension), ("amplitude", amplitude)):
            if value is None:
                raise ValueError(f"TendonArm {name} is missing; a scene comes with pretension and amplitude in m")
            object.__setattr__(self, name, value)
        self.__post_init__()

    def __post_init__(self) -> None:
        if isinstance(self.scene, rod.Scene) and self.n_sections > 1:
            raise ValueError(
                f"TendonArm has {self.n_sections} groups of tendons; expected one; MultiSectionArm takes several"
            )
        super().__post_init__()

    @classmethod
    def paper(cls, nodes: int = 5) -> TendonArm:
        """The arm of the paper: three tendons at 0, 120 and 240 degrees on a steel backbone of 0.7144 m.

        The paper does not print its numbers; it refers to those of Till, Aloi & Rucker (*Real-time dynamics of soft and
        continuum robots based on Cosserat rod models*, IJRR 2019). These are the parameters of the public tendon-robot
        example that goes with that article: E = 207 GPa, G = E / 2.6, radius 0.675 mm, total mass 0.034 kg, tendon
        offset 15.06 mm, tendon compliance 1e-4 1/N, bending and torsion damping 5e-4 N m^2 s, quadratic drag
        1e-4 N s^2/m^3, gravity 9.81 m/s^2 along -x (the arm points sideways).

        ``nodes`` is the number of Gauss nodes.
        """
        return cls(paper_scene(nodes=nodes), pretension=1e-3, amplitude=10e-3)

    @classmethod
    def prototype(cls, nodes: int = 5) -> TendonArm:
        """A softer arm with weak tendons: 0.5 m of steel wire of 1 mm radius (E = 207 GPa, 8000 kg/m^3).

        Three tendons at 15 mm with 1.6 mm/N, bending and torsion damping 2e-3 N m^2 s, quadratic drag 3e-3 N s^2/m^3,
        gravity along -x, no pretension: under zero-sum displacements of 12 mm some tendons always hang loose.

        ``nodes`` is the number of Gauss nodes.
        """
        length = 0.5
        material = rod.Elastic(young=207e9, shear=207e9 / 2.6, density=8000.0)
        scene = rod.Scene(
            rod.Rod(length=length, section=rod.Circle(1e-3), material=material, strains="kirchhoff"),
            rod.Gravity((-9.81, 0.0, 0.0)),
            rod.KelvinVoigt(bending=2e-3, torsion=2e-3),
            rod.QuadraticDrag(3e-3),
            rod.Tendons.parallel(
                offset=15e-3, angles_deg=(0, 120, 240), drive=rod.Displacement(compliance=1.6e-3 / length)
            ),
            nodes=nodes,
        )
        return cls(scene, pretension=0.0, amplitude=12e-3)

    @property
    def tendons(self) -> TendonTerm:
        """Its tendons, as drawn (``rod.Tendons``) or as identified (``CalibratedTendons``)."""
        return self.groups[0]
