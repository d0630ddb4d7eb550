"""Pictures of arms: at rest, their measured shapes, the reach of a table, what a calibration found."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.output.pictures import frame_3d, plot_arm
from pisplit.models.rod.output.results import hung
from pisplit.pictures.figures import MEASURED, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.arm.base import Arm
    from pisplit.models.arm.resting import RestShapes
    from pisplit.models.arm.static_table import EquilibriumTable

Path = str | os.PathLike[str] | None
#: Moves along each axis of a table at which the tip is drawn.
GRID = 25


def plot_at_rest(arm: Arm, u: ArrayLike | None, title: str) -> Figure:
    """Picture of an ``arm`` at rest under ``u`` (m,) or (N, m) in m with a ``title``, down where gravity pulls."""
    inputs = np.atleast_2d(arm.rest_inputs if u is None else np.asarray(u, dtype=float))
    found = arm.scene.statics().solve_many(inputs)
    if not found.success.all():
        bad = int(np.argmin(found.success))
        raise ValueError(f"the arm has no equilibrium under u = {inputs[bad].tolist()}")
    return hung(plot_arm(arm.scene, found.states, title), arm.scene)


def plot_shapes(shapes: RestShapes, path: Path) -> Figure:
    """Measured stations of ``shapes``, one line a shape from the clamp at the origin.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 6.2)
    axis: Any = figure.add_subplot(projection="3d")
    points = 1e3 * shapes.fields.reshape(len(shapes), -1, N_FIELDS)[..., :3]
    for line in points:
        axis.plot(*np.vstack([np.zeros(3), line]).T, "o-", ms=2.5, lw=1.0, alpha=0.8)
    axis.set_title(f"{len(shapes)} shapes at rest")
    frame_3d(axis, np.vstack([np.zeros(3), points.reshape(-1, 3)]))
    return keep(figure, path)


def plot_table(table: EquilibriumTable, path: Path) -> Figure:
    """Where the tip of the arm of a ``table`` gets, coloured by height, and how far it goes by the moves.

    Written to ``path`` where one is given.
    """
    edge = table.half_width
    grid = np.linspace(-edge, edge, GRID) * (1.0 - 1e-9)
    moves = np.array(np.meshgrid(grid, grid, indexing="ij")).reshape(2, -1)
    u = table.arm.rest_inputs + (table.arm.differential_basis @ moves).T
    tip = 1e3 * table.values(u)[:, -3:]
    figure = new_figure(11.0, 4.8)
    axes: Any = figure.subplots(1, 2)
    x, y = (c.reshape(GRID, GRID) for c in tip[:, :2].T)
    for lines in (zip(x, y, strict=True), zip(x.T, y.T, strict=True)):
        for a, b in lines:
            axes[0].plot(a, b, color=MEASURED, lw=0.5, alpha=0.5)
    drawn = axes[0].scatter(*tip[:, :2].T, c=tip[:, 2], s=9, cmap="viridis", zorder=3)
    figure.colorbar(drawn, ax=axes[0], label="z of the tip (mm)")
    axes[0].set(xlabel="x of the tip (mm)", ylabel="y of the tip (mm)", title="reach of the tip", aspect="equal")
    far = np.linalg.norm(tip - tip[len(tip) // 2], axis=1).reshape(GRID, GRID)
    levels = axes[1].contourf(1e3 * grid, 1e3 * grid, far.T, 14, cmap="viridis")
    figure.colorbar(levels, ax=axes[1], label="distance from rest (mm)")
    axes[1].set(xlabel="move along axis 1 (mm)", ylabel="move along axis 2 (mm)", aspect="equal")
    axes[1].set_title(f"inputs; the spline is off by {1e3 * table.error:.2g} mm at most", fontsize=10)
    tidy(axes[0])
    return keep(figure, path)
