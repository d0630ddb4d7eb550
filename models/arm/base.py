"""What arms with tendons have in common, whatever the number of their sections."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array, finite_number, non_negative
from pisplit.models import rod
from pisplit.models.rod.terms.pull import TendonTerm

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from pisplit import Episodes
    from pisplit.models.arm.resting import RestShapes
    from pisplit.observables import Slip, Tension
    from pisplit.pictures import Outline


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

    @cached_property
    def passive(self) -> rod.Scene:
        """The arm without its tendons: the known part f."""
        return self.scene.without(TendonTerm)

    @cached_property
    def backbone(self) -> rod.Scene:
        """The same without Maxwell branches, whose stress no measured field shows: a function of strains and rates."""
        return self.passive.without(rod.Maxwell)

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

    def to_scene(self) -> rod.Scene:
        """The rod scene of the arm, to add terms to it or to leave some out; ``replace(arm, scene=...)`` is an arm."""
        return self.scene

    def record(
        self,
        episodes: int,
        seed: int = 0,
        steps: int = 200,
        dt: float | None = None,
        stations: int = 6,
        path: str | os.PathLike[str] | None = None,
        workers: int | None = None,
        progress: bool = True,
        law: str = "zero-sum",
    ) -> Episodes:
        """Recordings of the simulated arm from rest under random smooth displacements (``make_episodes``).

        Args:
            episodes: their number.
            seed: of the displacements.
            steps: of each recording.
            dt: time step in s; about a twentieth of the slowest period if not given (``time_step``).
            stations: number of points along the arm whose 24 fields are recorded.
            path: of an HDF5 file that keeps them; none if not given.
            workers: processes, -1 for one a core; chosen by the amount of work if not given.
            progress: whether to show a bar.
            law: of the inputs, "zero-sum" or "independent".
        """
        from pisplit.models.arm.resting import recorded

        step = self.time_step if dt is None else dt
        return recorded(self, episodes, seed, steps, step, stations, path, workers, progress, law)

    def tension(self, stations: int = 6) -> Tension:
        """What its tendons feel of the fields at so many ``stations``: ``ReliftedEDMDc(tension=arm.tension())``.

        Raises ValueError for arms of several sections and those on joints.
        """
        from pisplit.models.arm.stretch import tension

        return tension(self, stations)

    def slip(self, stations: int = 6) -> Slip:
        """How fast its tendons slide, by the fields at so many ``stations``: ``ReliftedEDMDc(slip=arm.slip())``.

        Raises ValueError for arms of several sections and those on joints.
        """
        from pisplit.models.arm.stretch import slip

        return slip(self, stations)

    def rest_shapes(
        self, number: int = 16, seed: int = 0, stations: int = 6, position_noise: float = 0.0, angle_noise: float = 0.0
    ) -> RestShapes:
        """Shapes of the simulated arm at rest under random displacements: what a few photographs of a robot give.

        Args:
            number: of shapes.
            seed: of displacements and noise.
            stations: number of points along the arm.
            position_noise: standard deviation in m of positions.
            angle_noise: standard deviation in rad of frames.
        """
        from pisplit.models.arm.resting import rest_shapes

        return rest_shapes(self, number, seed, stations, position_noise, angle_noise)

    @cached_property
    def time_step(self) -> float:
        """Time step in s for recordings and control, to one digit, between 1 ms and 0.1 s.

        It is 1/21.5 of the slowest period at rest, or longer where the usual moves of recordings, of 16 steps, would
        accelerate the tip by more than half of gravity: tendons of a faster arm hang loose, and nothing is learned of
        it. That of the paper's arm is 0.03 s by either rule.
        """
        from pisplit.models.arm.drawing import slowest, usual_move

        period = 2.0 * np.pi / slowest(self.scene, self.rest_inputs)[0]
        step = float(np.clip(max(period / 21.5, usual_move(self) / 16.0), 1e-3, 0.1))
        digit = 10.0 ** np.floor(np.log10(step))
        return round(round(step / digit) * digit, 6)

    def plot(self, u: ArrayLike | None = None, title: str = "") -> Figure:
        """The arm at rest under displacements ``u`` (m,) or (N, m) in m, in 3-D and the way it hangs.

        ``u`` is that of the arm at rest if not given; of several the last is drawn, the others as ghosts. ``title``
        stands over the picture. Raises ValueError where it does not rest.
        """
        from pisplit.models.arm.pictures import plot_at_rest

        return plot_at_rest(self, u, title)

    def outline(self, fields: ArrayLike, inputs: ArrayLike) -> Outline:
        """How the arm looks in every of T moments, for :meth:`pisplit.controllers.LoopLog.drawn`.

        Args:
            fields: (T, 24 S) measured fields at equally spaced stations, NaN where nothing was measured.
            inputs: (T, m) displacements in m then.

        Raises ValueError for other fields, and for arms whose fields do not tell their strains (free shear or stretch,
        fewer stations than nodes).
        """
        from pisplit.models.rod.output.outline import outline_of_fields

        return outline_of_fields(self.scene, fields, inputs)

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
