"""How a rod looks over time, for pages: backbone, tendons and tensions of states or of measured fields."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, real_array
from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.output.pictures import shape_of, tensions, upwards
from pisplit.pictures import Chart, Outline, Page
from pisplit.pictures.figures import labelled

if TYPE_CHECKING:
    from pisplit.models.rod.dynamics.trajectory import Trajectory
    from pisplit.models.rod.scene import Scene

#: Every second of the points of a picture does in a page.
EVERY = 2


def outline_of(scene: Scene, states: ArrayLike) -> Outline:
    """Outline of ``states`` (T, n_states) of ``scene``; moments with a NaN are left empty."""
    x = np.atleast_2d(real_array(states, "states"))
    good = np.isfinite(x).all(axis=1)
    shape = shape_of(scene, x[good])

    def whole(line: Array) -> Array:
        kept = np.unique(np.append(np.arange(0, line.shape[1], EVERY), line.shape[1] - 1))
        placed = np.full((len(x), len(kept), 3), np.nan)
        placed[good] = 1e-3 * line[:, kept]
        return placed

    pull = np.zeros((len(x), shape.tensions.shape[1]))
    pull[good] = shape.tensions
    return Outline(whole(shape.backbone), tuple(map(whole, shape.tendons)), pull, upwards(scene))


def outline_of_fields(scene: Scene, fields: ArrayLike, inputs: ArrayLike) -> Outline:
    """Outline of ``scene`` from measured ``fields`` (T, 24 S) at equally spaced stations and ``inputs`` (T, n_inputs).

    Raises ValueError for other sizes, and where the fields do not tell the strains (``Scene.coordinates``).
    """
    y, u = real_array(fields, "fields"), real_array(inputs, "inputs")
    if y.ndim != 2 or y.shape[1] % N_FIELDS or not y.shape[1]:
        raise ValueError(f"fields have the shape {y.shape}; expected {N_FIELDS} columns a station")
    if u.shape != (len(y), scene.n_inputs):
        raise ValueError(f"inputs have the shape {u.shape}; expected ({len(y)}, {scene.n_inputs})")
    read = scene.coordinates(y.shape[1] // N_FIELDS).function.map(len(y))
    return outline_of(scene, np.hstack([np.asarray(read(y.T)).T, u]))


def write_page(motion: Trajectory, path: str | os.PathLike[str], ghost: Trajectory | None) -> None:
    """Write a ``motion``, with another one as ``ghost`` behind it if given, to the HTML file ``path``.

    Raises ValueError for a ghost of other times.
    """
    if ghost is not None and (ghost.t.shape != motion.t.shape or not np.allclose(ghost.t, motion.t)):
        raise ValueError(
            f"the ghost has {len(ghost.t)} moments up to {ghost.t[-1]:g} s, the motion {len(motion.t)} up to "
            f"{motion.t[-1]:g} s; give one over the same times"
        )
    scene, tip = motion.scene, 1e3 * motion.fields(1)[:, 0, :3]
    charts = [Chart("motion of the tip (mm)", ("x", "y", "z"), (tip - tip[0]).T)]
    if ghost is not None:
        apart = np.linalg.norm(1e3 * ghost.fields(1)[:, 0, :3] - tip, axis=1)
        charts.append(Chart("distance of the tips (mm)", ("distance",), apart))
    pull = tensions(scene, motion.x)
    if pull.shape[1]:
        charts.append(Chart("tensions (N)", [f"tendon {i + 1}" for i in range(pull.shape[1])], pull.T))
    if scene.n_inputs:
        inputs = np.vstack([motion.x[:1, scene.layout.inputs], motion.u]).T
        unit = scene.input_units[0] if len(set(scene.input_units)) == 1 else ""
        shown, factor = ("mm", 1e3) if unit == "m" else (unit, 1.0)
        charts.append(Chart(labelled("inputs", shown), scene.input_names, factor * inputs))
    stopped = f"\nended early: {motion.message}" if motion.message else ""
    Page(
        title="pisplit motion",
        t=motion.t,
        charts=charts,
        summary=f"{len(motion.u)} steps, {motion.t[-1]:.2f} s\n\n{scene}{stopped}",
        arm=outline_of(scene, motion.x),
        ghost=None if ghost is None else outline_of(ghost.scene, ghost.x).backbone,
        ghost_name="other motion",
    ).write(path)
