"""A robot that is not its twin: disks, friction both ways, servos with lag and play, creep, sensors with noise."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array, count
from pisplit.data.actuator import Actuator
from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.analysis.fields import UNITS

if TYPE_CHECKING:
    from pisplit import Episodes
    from pisplit.models.arm.resting import RestShapes

#: Disks, friction coefficient, lag in s and play in m of the servos, EI and mass as parts of the drawing's, by preset.
PRESETS = {
    1: (8, 0.10, 0.03, 3e-4, 1.00, 1.00),
    2: (10, 0.20, 0.05, 2e-4, 0.92, 1.06),
    3: (6, 0.05, 0.015, 5e-4, 1.08, 0.95),
    4: (8, 0.10, 0.03, 3e-4, 1.00, 1.00),
}
#: The preset that is built as no form of a model has it: one of its disks sits so many m too near to the tip, its
#: stiffness is larger at the base and smaller at the tip by this part, and so is friction at slow slip.
UNEVEN, MISPLACED, VARIES, STICTION = 4, (3, 0.01), 0.15, 0.5
#: Stiffness of the Maxwell branch in parts of the backbone's, and its relaxation time in s, by preset.
CREEP = {1: (0.2, 0.5), 2: (0.3, 1.0), 3: (0.1, 0.2), 4: (0.2, 0.5)}
#: Nodes of the robot's rod (a drawing has 5), and the speed in m/s over which friction turns round.
NODES, SLIP_SPEED = 6, 2e-3
#: Noise by unit, and of frames in rad: a quarter of what is called noise elsewhere in this project.
NOISE = {"m": 2.5e-4, "1/m": 0.0125, "m/s": 5e-3, "rad/s": 0.025}
NOISE_ANGLE = float(np.deg2rad(0.25))


@dataclass(frozen=True)
class UnevenMaterial:
    """A material by arclength whose moduli fall along the rod, as a cosine.

    Attributes:
        mean: its moduli and density in the middle.
        part: by how much moduli are larger at the base and smaller at the tip, in parts.
        length: of the rod in m.
    """

    mean: rod.Elastic
    part: float
    length: float

    def __call__(self, s: float) -> rod.Elastic:
        """The material at arclength ``s`` in m."""
        factor = 1.0 + self.part * float(np.cos(np.pi * s / self.length))
        return replace(self.mean, young=factor * self.mean.young, shear=factor * self.mean.shear)


@dataclass(frozen=True)
class DiskRobot:
    """A simulated robot and the drawing that people have of it, which is wrong in form and in numbers.

    Its tendons run straight from disk to disk and rub there both ways, servos lag and play, sensors are noisy; it moves
    by IDAS on another grid than models of the drawing. Its states are the 24 fields of every station, its inputs the
    commands. If asked for, its backbone creeps (``rod.Maxwell``), which its drawing does not.

    Attributes:
        arm: what moves.
        drawing: what is known of it: tendons along the backbone without friction.
        actuator: its servos.
        noise: standard deviations of measured states by unit; empty for none.
        noise_angle: standard deviation in rad of measured frames.
    """

    arm: TendonArm
    drawing: TendonArm
    actuator: Actuator
    noise: dict[str, float] = field(default_factory=dict)
    noise_angle: float = 0.0

    def record(
        self,
        episodes: int,
        seed: int = 0,
        steps: int = 200,
        dt: float = 0.03,
        stations: int = 6,
        path: str | os.PathLike[str] | None = None,
        workers: int = -1,
        progress: bool = True,
    ) -> Episodes:
        """Recordings from rest under random smooth commands; arguments as in :meth:`Arm.record`.

        Args:
            episodes: their number.
            seed: of commands and noise.
            steps: of each recording.
            dt: time step in s.
            stations: number of measured points.
            path: of an HDF5 file that keeps them; none if not given.
            workers: processes, -1 for one a core.
            progress: whether to show a bar.
        """
        from pisplit.models.arm.recording import make_episodes

        with tempfile.TemporaryDirectory() as folder:
            made = make_episodes(
                self.arm,
                Path(folder) / "episodes.h5",
                episodes,
                steps,
                dt,
                stations=stations,
                seed=seed,
                workers=workers,
                progress=progress,
                actuator=self.actuator,
                method="idas",
            )
        rng = np.random.default_rng(np.random.SeedSequence(count(seed, "seed", 0), spawn_key=(11,)))
        units = np.array(made.units)
        told = {**(made.provenance or {}), "noise": dict(self.noise), "noise_angle": self.noise_angle}
        found = replace(made, xs=[self._measured(x, units, rng) for x in made.xs], extra=None, provenance=told)
        if path is not None:
            found.save(path)
        return found

    def rest_shapes(self, number: int = 16, seed: int = 0, stations: int = 6) -> RestShapes:
        """Shapes at rest under random commands, where play and friction leave the arm, as the cameras see them.

        Args:
            number: of shapes.
            seed: of commands, play and noise.
            stations: number of measured points.

        Raises RuntimeError where too few commands have an equilibrium.
        """
        from pisplit.models.arm.recording import random_targets
        from pisplit.models.arm.resting import RestShapes

        rng = np.random.default_rng(np.random.SeedSequence(count(seed, "seed", 0), spawn_key=(12,)))
        wanted = count(number, "number")
        u = random_targets(self.arm, wanted + 4, rng)
        late = 0.5 * self.actuator.play * rng.uniform(-1.0, 1.0, u.shape)
        solved = self.arm.scene.statics().solve_many(u + late)
        kept = np.flatnonzero(solved.success)[:wanted]
        if len(kept) < wanted:
            raise RuntimeError(f"{len(kept)} of {len(u)} random displacements have an equilibrium")
        y = self.arm.scene.fields(solved.states[kept], stations).reshape(wanted, -1)
        found = self.arm.scene.field_map(stations)
        units = np.array([UNITS[q] for q in found.quantities])
        y = self._measured(y, units, rng)
        return RestShapes(u[kept], y, max(self.noise.get("m", 0.0), 1e-4), max(self.noise_angle, 2e-3))

    def _measured(self, x: Array, units: NDArray[np.str_], rng: np.random.Generator) -> Array:
        """States (T, n) of these ``units`` with noise."""
        from pisplit.models.arm.simulated import seen_with_noise

        return seen_with_noise(x, units, self.noise, self.noise_angle, rng)


def disk_robot(
    preset: int = 1,
    disks: bool = True,
    friction: bool = True,
    servos: bool = True,
    noise: bool = True,
    creep: bool = False,
) -> DiskRobot:
    """The other robot: an arm of the paper's size, built otherwise than it is drawn.

    Args:
        preset: 1, 2, 3 or 4 (:data:`PRESETS`): disks, friction, lag, play, and how far stiffness and mass are off. The
            fourth has what no form of a model here has: a disk out of its place by 10 mm, stiffness that varies by 15 %
            along the arm, and friction that is half as large again at slow slip.
        disks: whether tendons run over disks; along the backbone otherwise.
        friction: whether they rub; at disks both ways, without disks as when they are pulled.
        servos: whether servos lag and play.
        noise: whether sensors are noisy.
        creep: whether the backbone is viscoelastic (:data:`CREEP`); at rest it is as without.

    Raises ValueError for other presets.
    """
    if isinstance(preset, bool) or preset not in PRESETS:
        raise ValueError(f"preset = {preset!r}; expected one of {', '.join(map(str, PRESETS))}")
    number, mu, lag, play, stiffness, mass = PRESETS[preset]
    drawing = TendonArm.paper()
    scene, drawn = drawing.scene, drawing.tendons
    assert isinstance(drawn, rod.Tendons)
    material = scene.rod.material
    assert isinstance(material, rod.Elastic)
    built = rod.Elastic(stiffness * material.young, stiffness * material.shear, mass * material.density)
    along = UnevenMaterial(built, VARIES, scene.rod.length) if preset == UNEVEN else built
    rubs = mu if friction else 0.0
    places: Array = scene.rod.length * np.arange(1, number + 1) / number
    if preset == UNEVEN:
        places[MISPLACED[0]] += MISPLACED[1]
    both_ways = disks and rubs > 0.0
    tendons = replace(
        drawn,
        friction=rubs,
        disks=(tuple(places.tolist()) if preset == UNEVEN else number) if disks else None,
        slip_speed=SLIP_SPEED if both_ways else None,
        stiction=STICTION if preset == UNEVEN and both_ways else 0.0,
    )
    terms = [tendons if term is drawn else term for term in scene.terms]
    terms += [rod.Maxwell(*CREEP[preset])] if creep else []
    arm = TendonArm(
        rod.Scene(replace(scene.rod, material=along), *terms, nodes=NODES), drawing.pretension, drawing.amplitude
    )
    return DiskRobot(
        arm=arm,
        drawing=drawing,
        actuator=Actuator(lag=lag, play=play) if servos else Actuator(),
        noise=dict(NOISE) if noise else {},
        noise_angle=NOISE_ANGLE if noise else 0.0,
    )
