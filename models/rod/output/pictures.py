"""Pictures of rods: shapes with tendons coloured by tension, strips over time, energies, animations.

Figures are plain ``matplotlib`` figures: ``figure.savefig(path)`` keeps them. Matplotlib is imported when a picture is
drawn, not before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, real_array
from pisplit.files import replacing
from pisplit.models.rod.terms.gravity import Gravity
from pisplit.models.rod.terms.routing import sample
from pisplit.models.rod.terms.tendons import Tendons
from pisplit.pictures.figures import new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.dynamics.trajectory import Trajectory
    from pisplit.models.rod.scene import Scene

BACKBONE, PLATE, GHOST, PATH = "#2b2b2b", "#b9c2cc", "#9aa7b5", "#c2410c"
TENSIONS = "plasma"
#: Points along the rod at which shapes are drawn.
POINTS = 49
#: Plates that guide the tendons, drawn along the rod to show how it twists.
PLATES = 9
#: Part of the longest side of a picture that every direction keeps, however flat the motion is.
FLATTEST = 0.5
#: Width of a strip of shapes in parts of its height, at least.
STRIP_WIDTH = 3.2


@dataclass(frozen=True)
class Shape:
    """What is drawn of N states.

    Attributes:
        backbone, plates, tendons: lines and rims of plates (N, ..., 3) in mm.
        tensions: (N, tendons) in N.
    """

    backbone: Array
    plates: Array
    tendons: tuple[Array, ...]
    tensions: Array

    def everything(self) -> Array:
        """All points (n, 3) in mm, for the limits of a picture."""
        parts = [self.backbone, self.plates, *self.tendons]
        return np.concatenate([p.reshape(-1, 3) for p in parts])


def tensions(scene: Scene, states: ArrayLike) -> Array:
    """Tendon tensions (N, tendons) in N of ``states`` (N, n_states) of ``scene``."""
    x = np.atleast_2d(real_array(states, "states"))
    xi, u, balance = scene.static_balance
    tension = balance.loads.outputs.get("tension", ca.SX(0, 1))
    read = ca.Function("tension", [xi, u], [tension])
    strains, *_, inputs = scene.layout.split(x)
    found: Array = np.asarray(read.map(len(x))(strains.T, inputs.T), dtype=np.float64).T
    return found.reshape(len(x), tension.numel())


def shape_of(scene: Scene, states: ArrayLike) -> Shape:
    """Backbone, guide plates, tendons and tensions of ``states`` (n_states,) or (N, n_states) of ``scene``.

    Raises ValueError for states of another shape.
    """
    x = finite_array(np.atleast_2d(real_array(states, "states")), "states", (None, scene.n_states))
    s = np.linspace(0.0, scene.rod.length, POINTS)
    p, _ = _placed(scene, x, s)
    bundles = [t for t in scene.terms if isinstance(t, Tendons)]
    lines, radius = [], 4.0 * scene.rod.length
    plates_at = s[np.linspace(0, POINTS - 1, PLATES).round().astype(int)] if bundles else np.zeros(1)
    for bundle in bundles:
        places = s[s <= (scene.rod.length if bundle.end is None else bundle.end) * (1.0 + 1e-12)]
        if bundle.disks is not None:  # straight from hole to hole
            places = plates_at = bundle.holes(scene.rod.length)
        here, turned = _placed(scene, x, places)
        for route in bundle.offsets:
            offset = 1e3 * sample(route, places, scene.rod.length)[0]
            lines.append(here + np.einsum("nsij,js->nsi", turned, offset))
            radius = max(radius, 1.15 * float(np.linalg.norm(offset, axis=0).max()))
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    rim = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    middle, turned = _placed(scene, x, plates_at)
    plates = middle[:, :, None, :] + np.einsum("nsij,ja->nsai", turned, rim)
    return Shape(p, plates, tuple(lines), tensions(scene, x))


def _placed(scene: Scene, x: Array, places: Array) -> tuple[Array, Array]:
    """Positions (N, S, 3) in mm and frames (N, S, 3, 3) at arclengths ``places`` (S,) in m."""
    y = scene.fields(x, places)
    return 1e3 * y[..., :3], y[..., 3:12].reshape(*y.shape[:2], 3, 3)


def upwards(scene: Scene) -> tuple[float, float, float]:
    """Unit vector (3,) against the constant gravity of ``scene``; +z where there is none."""
    pull = [t.acceleration for t in scene.terms if isinstance(t, Gravity) and not t.inputs]
    down = np.sum([np.asarray(g, dtype=float) for g in pull], axis=0) if pull else np.zeros(3)
    size = float(np.linalg.norm(down))
    x, y, z = (-down / size).tolist() if size > 0.0 else (0.0, 0.0, 1.0)
    return x, y, z


def plot_arm(scene: Scene, states: ArrayLike, title: str = "") -> Figure:
    """The arm in 3-D, its tendons coloured by tension.

    Args:
        scene: the arm.
        states: (n_states,) or (N, n_states), of which the last is drawn, with the others as ghosts.
        title: over the picture.
    """
    shape = shape_of(scene, states)
    figure = new_figure(8.0, 7.0)
    axis = figure.add_subplot(projection="3d")
    for line in shape.backbone[:-1]:
        axis.plot(*line.T, color=GHOST, lw=0.9, alpha=0.55)
    if len(shape.backbone) > 2:
        axis.plot(*shape.backbone[:, -1].T, color=PATH, lw=1.0, label="path of the tip")
        axis.legend(loc="upper left", frameon=False)
    colours = _colours(shape.tensions[-1:])
    _draw_arm(axis, shape, len(shape.backbone) - 1, colours)
    frame_3d(axis, shape.everything())
    _colour_bar(figure, axis, colours)
    axis.set_title(title)
    return figure


def plot_strip(trajectory: Trajectory, moments: int = 9, title: str = "") -> Figure:
    """Shapes side by side over time in the plane of most motion, over the path of the tip and the tensions in time.

    Args:
        trajectory: what moves.
        moments: number of shapes, spread evenly over the time.
        title: over the picture.
    """
    scene = trajectory.scene
    chosen = np.unique(np.linspace(0, len(trajectory.x) - 1, count(moments, "moments")).round().astype(int))
    shape = shape_of(scene, trajectory.x[chosen])
    drawn = shape.everything()
    across = int(np.argmax(np.ptp(drawn[:, :2], axis=0)))
    low, high = drawn[:, across].min(), drawn[:, across].max()
    pitch = max(1.12 * float(high - low), STRIP_WIDTH * float(np.ptp(drawn[:, 2])) / len(chosen))
    colours = _colours(tensions(scene, trajectory.x))
    rows = 3 if shape.tendons else 2
    figure = new_figure(11.0, 2.9 + 2.0 * (rows - 1))
    axes = figure.subplots(rows, 1, height_ratios=[1.6, *[1.0] * (rows - 1)])
    strip = axes[0]
    for k in range(len(chosen)):
        shift = np.array([k * pitch, 0.0])
        for i, line in enumerate(shape.tendons):
            strip.plot(*(line[k][:, [across, 2]] + shift).T, color=colours.to_rgba(shape.tensions[k, i]), lw=1.6)
        strip.plot(*(shape.backbone[k][:, [across, 2]] + shift).T, color=BACKBONE, lw=0.9 if shape.tendons else 2.0)
        strip.plot(*(shape.plates[k][0][:, [across, 2]] + shift).T, color=BACKBONE, lw=2.5)
    strip.set_xticks([k * pitch for k in range(len(chosen))], [f"{trajectory.t[k]:.2f} s" for k in chosen])
    strip.set(ylabel="z (mm)", title=title or f"shapes over time, seen along {'yx'[across]}", aspect="equal")
    if upwards(scene)[2] < -0.5:  # an arm that hangs is drawn so
        strip.invert_yaxis()
    _colour_bar(figure, strip, colours)
    tip = 1e3 * trajectory.fields(1)[:, 0, :3]
    for name, values in zip("xyz", tip.T, strict=True):
        axes[1].plot(trajectory.t, values - values[0], label=name, lw=1.3)
    axes[1].set_ylabel("tip motion (mm)")
    axes[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    if shape.tendons:
        for i, values in enumerate(tensions(scene, trajectory.x).T):
            axes[2].plot(trajectory.t, values, label=f"tendon {i + 1}", lw=1.3)
        axes[2].set_ylabel("tension (N)")
        axes[2].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axes[-1].set_xlabel("time (s)")
    tidy(*axes)
    return figure


def plot_energy(t: ArrayLike, energies: Mapping[str, ArrayLike], title: str = "") -> Figure:
    """Energies over time, and beneath them their sum's change, which shows any drift.

    Args:
        t: times (T,) in s.
        energies: (T,) in J by name.
        title: over the picture.

    Raises ValueError for an energy of another length than the times.
    """
    times = finite_array(t, "t", (None,))
    if not energies:
        raise ValueError("energies is empty; give at least one, such as {'kinetic': T}")
    values = {name: finite_array(e, f"energy {name!r}", (len(times),)) for name, e in energies.items()}
    figure = new_figure(9.0, 6.0)
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.0, 1.0])
    for name, e in values.items():
        top.plot(times, e, lw=1.4, label=name)
    total = np.sum(list(values.values()), axis=0)
    top.plot(times, total, "k--", lw=1.2, label="sum")
    top.set(ylabel="energy (J)", title=title)
    top.legend(ncols=min(4, len(values) + 1), frameon=False)
    below.plot(times, total - total[0], color="k", lw=1.2)
    below.set(ylabel="change of the sum (J)", xlabel="time (s)")
    tidy(top, below)
    return figure


def animate_arm(trajectory: Trajectory, path: str | Path, fps: int = 20, title: str = "") -> Path:
    """Write an animation of the arm in real time, with tendons coloured by tension and the path of the tip.

    Args:
        trajectory: what moves.
        path: ``.gif``, or ``.mp4`` where ffmpeg is installed.
        fps: frames per second of the picture and of the motion.
        title: over the picture.
    """
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter

    target = Path(path)
    if target.suffix not in (".gif", ".mp4"):
        raise ValueError(f"animation path ends in {target.suffix!r}; expected .gif or .mp4")
    if target.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise ValueError("an .mp4 needs ffmpeg, which is not installed; write a .gif instead")
    moments = np.arange(0.0, trajectory.t[-1] + 1e-9, 1.0 / count(fps, "fps"))
    frames = np.searchsorted(trajectory.t, moments - 1e-9).clip(max=len(trajectory.t) - 1)
    shape = shape_of(trajectory.scene, trajectory.x[frames])
    tip = 1e3 * trajectory.fields(1)[:, 0, :3]
    colours = _colours(shape.tensions)
    figure = new_figure(6.4, 5.8)
    axis = figure.add_subplot(projection="3d")
    _colour_bar(figure, axis, colours)

    def show(k: int) -> None:
        axis.clear()
        axis.plot(*tip[: frames[k] + 1].T, color=PATH, lw=0.9, alpha=0.8)
        _draw_arm(axis, shape, k, colours)
        frame_3d(axis, shape.everything())
        axis.set_title(f"{title}{', ' if title else ''}t = {trajectory.t[frames[k]]:.2f} s")

    film = FuncAnimation(figure, show, frames=len(frames), init_func=lambda: None)
    writer = (PillowWriter if target.suffix == ".gif" else FFMpegWriter)(fps=fps)
    with replacing(target, make_folders=True) as part:
        film.save(part, writer=writer, dpi=80)
    return target


# Parts of pictures --------------------------------------------------------------------------------------------------


def _colours(values: Array) -> Any:
    """Map from tension in N to colour, from zero to the largest tension drawn."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    most = float(np.max(values, initial=0.0))
    return ScalarMappable(Normalize(0.0, most if most > 0.0 else 1.0), colormaps[TENSIONS])


def _colour_bar(figure: Figure, axis: Any, colours: Any) -> None:
    if colours.norm.vmax != 1.0:
        solid = hasattr(axis, "get_zlim")  # the box of a 3-D axis leaves a margin of its own
        figure.colorbar(colours, ax=axis, shrink=0.6, pad=0.0 if solid else 0.02, label="tension (N)")


def _draw_arm(axis: Any, shape: Shape, k: int, colours: Any) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axis.add_collection3d(
        Poly3DCollection(list(shape.plates[k]), facecolor=PLATE, edgecolor="#6b7785", lw=0.6, alpha=0.5)
    )
    axis.plot(*shape.backbone[k].T, color=BACKBONE, lw=2.6)
    for i, line in enumerate(shape.tendons):
        axis.plot(*line[k].T, color=colours.to_rgba(shape.tensions[k, i]), lw=1.7)


def frame_3d(axis: Any, points: Array) -> None:
    """Equal scales in all directions of a 3-D ``axis``, as tight as the ``points`` (n, 3) in mm allow."""
    from matplotlib.ticker import MaxNLocator

    low, high = points.min(axis=0), points.max(axis=0)
    middle, side = 0.5 * (low + high), np.maximum(high - low, FLATTEST * np.max(high - low)) * 1.05
    for name, m, width in zip("xyz", middle, side, strict=True):
        getattr(axis, f"set_{name}lim")(m - 0.5 * width, m + 0.5 * width)
        getattr(axis, f"set_{name}label")(f"{name} (mm)", labelpad=7.0)
        getattr(axis, f"{name}axis").set_major_locator(MaxNLocator(max(2, round(6 * width / side.max()))))
    axis.set_box_aspect(side, zoom=0.8)
    axis.view_init(elev=20, azim=-62)
