"""What a simulated arm shows: recordings of its motion, its shapes at rest, a picture."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pisplit import Episodes
from pisplit.brief import brief
from pisplit.checks import Array, count, finite_array, non_negative, positive
from pisplit.models.arm.base import Arm
from pisplit.models.arm.recording import make_episodes, random_targets
from pisplit.models.rod.analysis.fields import N_FIELDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Steps from which on several processes pay.
SEVERAL = 600


@brief
@dataclass(frozen=True)
class RestShapes:
    """Shapes of an arm at rest: all that is asked of a robot before it moves.

    Raises ValueError for shapes that do not fit each other and for errors that are not positive.

    Attributes:
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S) under them, of which positions and frames count.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
    """

    inputs: Array
    fields: Array
    position_error: float = 1e-4
    rotation_error: float = 2e-3

    def __post_init__(self) -> None:
        u = finite_array(self.inputs, "RestShapes inputs", (None, None))
        y = finite_array(self.fields, "RestShapes fields", (len(u), None))
        if y.shape[1] % N_FIELDS:
            raise ValueError(f"RestShapes fields have {y.shape[1]} columns; expected {N_FIELDS} a station")
        for name, value in (("inputs", u), ("fields", y)):
            object.__setattr__(self, name, value)
        positive(self.position_error, "RestShapes position_error", "m")
        positive(self.rotation_error, "RestShapes rotation_error")

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def stations(self) -> int:
        """Number S of points along the arm."""
        return self.fields.shape[1] // N_FIELDS

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The measured stations in 3-D, one line a shape; written to ``path`` where one is given."""
        from pisplit.models.arm.pictures import plot_shapes

        return plot_shapes(self, path)


def recorded(
    arm: Arm,
    episodes: int,
    seed: int,
    steps: int,
    dt: float,
    stations: int,
    path: str | os.PathLike[str] | None,
    workers: int | None,
    progress: bool,
    law: str,
) -> Episodes:
    """Episodes of :func:`make_episodes` without a file where ``path`` is None.

    arm, episodes, seed, steps, dt, stations, workers, progress, law  see :meth:`Arm.record`
    """
    if workers is None:
        workers = -1 if count(episodes, "episodes") * count(steps, "steps") >= SEVERAL else 1
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "episodes.h5" if path is None else path
        return make_episodes(
            arm,
            place,
            episodes,
            steps,
            dt,
            stations=stations,
            seed=seed,
            workers=workers,
            progress=progress,
            law=law,
        )


def rest_shapes(
    arm: Arm, number: int, seed: int, stations: int, position_noise: float, angle_noise: float
) -> RestShapes:
    """Solved equilibria with the noise of a camera; arguments and meaning as in :meth:`Arm.rest_shapes`.

    arm, number, seed, stations, position_noise, angle_noise  see there

    Raises RuntimeError where too few displacements have an equilibrium.
    """
    rng = np.random.default_rng(np.random.SeedSequence(count(seed, "seed", 0), spawn_key=(3,)))
    wanted = count(number, "number")
    u = random_targets(arm, 2 * wanted, rng)
    found = arm.scene.statics().solve_many(u)
    if np.count_nonzero(found.success) < wanted:
        raise RuntimeError(f"{np.count_nonzero(found.success)} of {len(u)} random displacements have an equilibrium")
    kept = np.flatnonzero(found.success)[:wanted]
    y = arm.scene.fields(found.states[kept], stations)
    std, angle = non_negative(position_noise, "position_noise", "m"), non_negative(angle_noise, "angle_noise", "rad")
    y[..., :3] += std * rng.standard_normal(y[..., :3].shape)
    y[..., 3:12] = turned(y[..., 3:12], angle, rng)
    return RestShapes(u[kept], y.reshape(wanted, -1), max(std, 1e-4), max(angle, 2e-3))


def turned(frames: Array, angle: float, rng: np.random.Generator) -> Array:
    """``frames`` (..., 9), row by row, each turned at random: standard deviation ``angle`` in rad about every axis.

    ``rng`` draws; rotations stay rotations.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and needed here alone

    turns = Rotation.from_rotvec(angle * rng.standard_normal((frames[..., 0].size, 3))).as_matrix()
    return np.asarray((frames.reshape(-1, 3, 3) @ turns).reshape(frames.shape))
