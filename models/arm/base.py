"""What arms with tendons have in common, whatever the number of their sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array, finite_number, non_negative
from pisplit.models import rod
from pisplit.models.rod.terms.pull import TendonTerm


@dataclass(frozen=True)
class Arm:
    """An elastic backbone with groups of tendons that are pulled by displacements, each group up to its own end.

    A group bends all of the backbone up to its end, and a section lies between two ends. Raises ValueError where the
    scene has no tendons or other inputs, where ends of groups do not increase in the order of the scene, or where
    pretension or amplitude are no lengths.

    Attributes:
        scene: backbone, environment and tendons: the arm itself.
        pretension: common displacement in m of all tendons at rest; it keeps them taut.
        amplitude: usual size in m of differential displacements, of what bends one section.
    """

    scene: rod.Scene
    pretension: float
    amplitude: float

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if not isinstance(self.scene, rod.Scene):
            raise ValueError(f"{kind} scene = {self.scene!r}; expected a rod.Scene with tendons")
        if not self.groups:
            raise ValueError(f"{kind} has 0 groups of tendons; expected one or more, such as rod.Tendons")
        told = {i.name for i in self.scene.inputs}
        if told != {group.name for group in self.groups}:
            names = ", ".join(i.name for i in self.scene.inputs)
            raise ValueError(f"{kind} has the inputs {names}; expected those of its tendons alone")
        if any(b <= a for a, b in zip(self.ends, self.ends[1:], strict=False)):
            found = ", ".join(f"{end:g}" for end in self.ends)
            raise ValueError(f"{kind} has groups of tendons that end at {found} m; expected ends that increase")
        finite_number(self.pretension, f"{kind} pretension")
        non_negative(self.amplitude, f"{kind} amplitude", "m")

    @property
    def passive(self) -> rod.Scene:
        """The arm without its tendons: the known part f."""
        return self.scene.without(TendonTerm)

    @property
    def groups(self) -> tuple[TendonTerm, ...]:
        """Its groups of tendons from base to tip, as drawn (``rod.Tendons``) or as identified."""
        return tuple(t for t in self.scene.terms if isinstance(t, TendonTerm))

    @property
    def ends(self) -> tuple[float, ...]:
        """Arclength in m at which each group ends, and with it a section."""
        return tuple(self.scene.rod.length if g.end is None else g.end for g in self.groups)

    @property
    def n_sections(self) -> int:
        """Number S of sections that are bent one by one."""
        return len(self.groups)

    @property
    def tendon_angles(self) -> Array:
        """Angle (m,) of each tendon about the backbone at its base in rad."""
        return np.arctan2(*np.concatenate(self._points()).T[::-1])

    @property
    def tendon_sections(self) -> Array:
        """Number (m,) of the section, from 0, at whose end each tendon ends."""
        return np.repeat(np.arange(self.n_sections), [len(points) for points in self._points()])

    @property
    def shares(self) -> Array:
        """(m, S): displacement of each tendon per displacement of the tendons of a section that bends alone.

        What bends a section changes the paths of the tendons that pass through it as well: by the ratio of their
        distance from the axis to that of its own tendons. Those that end before it are not concerned.
        """
        radius = np.array([np.hypot(*points.T).mean() for points in self._points()])
        own = self.tendon_sections
        ratio = radius[own, None] / radius[None, :]
        return np.where(own[:, None] >= np.arange(self.n_sections), ratio, 0.0)

    @property
    def differential_basis(self) -> Array:
        """Orthonormal basis (m, 2 S) of the displacements that bend the sections.

        Of one section cosine and sine over the tendon angles; of several those of the first and all that pass through
        it, then the next.
        """
        angles = self.tendon_angles
        bends = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        columns = [share[:, None] * bends for share in self.shares.T]
        return np.linalg.qr(np.hstack(columns))[0]

    @property
    def rest_inputs(self) -> Array:
        """Displacements (m,) of the pretensioned arm at rest."""
        return np.full(self.scene.n_inputs, self.pretension)

    def check_one_section(self, what: str) -> None:
        """Raise ValueError where ``what`` is for arms of one section and this one has several."""
        if self.n_sections > 1:
            raise ValueError(f"{what} takes an arm of one section; this one has {self.n_sections}")

    def _points(self) -> list[Array]:
        return [group.points(0.0, self.scene.rod.length) for group in self.groups]


def paper_scene(sections: int = 1, tendons: int = 3, nodes: int = 5) -> rod.Scene:
    """The backbone of the paper's arm in its environment (:meth:`TendonArm.paper`), in so many equal ``sections``.

    Each has its group of ``tendons`` at equal angles, which ends with it; a group stands turned against the one before
    it, so that none runs into another. Groups of several are named section1, section2, ...

    ``nodes`` is the number of Gauss nodes of every section.
    """
    length, radius = 0.7144, 0.675e-3
    section = rod.Circle(radius)
    material = rod.Elastic(young=207e9, shear=207e9 / 2.6, density=0.034 / (length * section.area))
    groups = [
        rod.Tendons.parallel(
            offset=15.06e-3,
            angles_deg=[360.0 * (i + k / sections) / tendons for i in range(tendons)],
            drive=rod.Displacement(compliance=1e-4),
            name="tendons" if sections == 1 else f"section{k + 1}",
            end=None if k == sections - 1 else length * (k + 1) / sections,
        )
        for k in range(sections)
    ]
    elements = () if sections == 1 else (length / sections,) * sections
    return rod.Scene(
        rod.Rod(length=length, section=section, material=material, strains="kirchhoff", elements=elements),
        rod.Gravity((-9.81, 0.0, 0.0)),
        rod.KelvinVoigt(bending=5e-4, torsion=5e-4),
        rod.QuadraticDrag(1e-4),
        *groups,
        nodes=nodes,
    )
