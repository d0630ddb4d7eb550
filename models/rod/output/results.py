"""Pictures of what a scene answers: equilibria, errors of motions."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.models.rod.output.pictures import PATH, plot_arm, upwards
from pisplit.pictures.figures import MEASURED, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.dynamics.motion_error import MotionError
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.equilibrium import Equilibrium, EquilibriumBatch
    from pisplit.models.rod.statics.fixed_tip import FixedTipEquilibrium

Path = str | os.PathLike[str] | None
#: Shapes of a batch that are drawn as ghosts.
GHOSTS = 40


def hung(figure: Figure, scene: Scene) -> Figure:
    """The picture of ``scene`` in ``figure`` turned so that gravity pulls down."""
    up = np.array(upwards(scene))
    axis = int(np.abs(up).argmax())
    drawn: Any = figure.axes[0]
    drawn.view_init(elev=18, azim=-60, vertical_axis="xyz"[axis])
    if up[axis] < 0.0:
        getattr(drawn, f"invert_{'xyz'[axis]}axis")()
    # Aspects are those of the axes as they stand: they have to be told anew once another one is vertical.
    sides = [abs(np.ptp(limits)) for limits in (drawn.get_xlim3d(), drawn.get_ylim3d(), drawn.get_zlim3d())]
    drawn.set_box_aspect(sides, zoom=0.85)
    return figure


def plot_equilibrium(found: Equilibrium, path: Path) -> Figure:
    """The shape of ``found``, its tendons coloured by tension; the title says whether it is one.

    Written to ``path`` where one is given.
    """
    said = f"{found.branch} equilibrium" if found.success else f"no equilibrium: {found.message}"
    return keep(hung(plot_arm(found.scene, found.state, said), found.scene), path)


def plot_batch(found: EquilibriumBatch, path: Path) -> Figure:
    """Shapes of ``found``: the last one with its tendons, up to 40 of the others as ghosts, failures left out.

    Raises ValueError where none succeeded.

    Written to ``path`` where one is given.
    """
    good = np.flatnonzero(found.success)
    if not len(good):
        raise ValueError("no row has an equilibrium: there is nothing to draw")
    chosen = np.unique(np.append(good[np.linspace(0, len(good) - 1, GHOSTS).astype(int)], good[-1]))
    title = f"{len(good)} of {len(found.success)} equilibria"
    return keep(hung(plot_arm(found.scene, found.states[chosen], title), found.scene), path)


def plot_fixed_tip(found: FixedTipEquilibrium, path: Path) -> Figure:
    """The shape of ``found`` and the force at its tip.

    Written to ``path`` where one is given.
    """
    figure = plot_arm(found.scene, found.state, f"force {np.linalg.norm(found.force):.3g} N at the tip")
    size = float(np.linalg.norm(found.force))
    if size > 0.0:
        tip = 1e3 * found.scene.fields(found.state, 1)[0, :3]
        arrow = 250.0 * found.scene.rod.length * found.force / size
        drawn: Any = figure.axes[0]
        drawn.quiver(*(tip - arrow), *arrow, color=PATH, lw=1.6, arrow_length_ratio=0.2)
    return keep(hung(figure, found.scene), path)


def plot_motion_error(found: MotionError, path: Path) -> Figure:
    """Distance of ``found`` from the finer motion over the steps.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.0)
    axis: Any = figure.subplots()
    axis.plot(1e3 * found.distance, color=MEASURED, lw=1.4)
    title = f"largest {1e3 * found.largest:.3g} mm, {found.of_travel:.2g} of the travel"
    axis.set(xlabel="step", ylabel="distance from the finer motion (mm)", title=title, ylim=(0.0, None))
    tidy(axis)
    return keep(figure, path)
