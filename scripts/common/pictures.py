"""Pictures of closed loops on the arm: tracking, shapes over time, animation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from common.drawing import save_figure
from pisplit.controllers import LoopLog
from pisplit.files import replacing
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.output.pictures import frame_3d

Array = NDArray[np.float64]

#: Frames a second of animations.
RATE = 15
#: Points of a circle that statics are solved for.
AROUND = 25
COLOURS = {"feed-forward": "#999999", "L-EDMDc": "#d95f02", "PI-EDMDc": "#1b6ca8", "PI-EDMDc LASSO": "#2a9d5c"}
plt.rcParams.update({"font.size": 10, "axes.grid": True, "grid.alpha": 0.25, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False, "savefig.dpi": 130})


def draw_tracking(runs: dict[str, dict[str, LoopLog]], path: Path) -> None:
    """Tip path, tip error and displacements of every controller, one row a task; the legend below covers no data."""
    figure, axes = plt.subplots(len(runs), 3, figsize=(15.0, 4.6 * len(runs)), constrained_layout=True, squeeze=False)
    styles = {"tendon 1": "-", "tendon 2": "--", "tendon 3": ":"}
    for row, (task, logs) in zip(axes, runs.items(), strict=True):
        wanted = 1e3 * next(iter(logs.values())).reference
        row[0].plot(wanted[:, 0], wanted[:, 1], "k--", lw=1.0)
        row[0].plot(*wanted[-1, :2], "k+", ms=9)
        for name, log in logs.items():
            colour = COLOURS[name]
            row[0].plot(1e3 * log.y[:, 0], 1e3 * log.y[:, 1], color=colour, lw=1.3)
            row[1].semilogy(log.t[1:], np.maximum(1e3 * log.error[1:], 1e-4), color=colour, lw=1.2)
            if name != "feed-forward":
                for k, line in enumerate(styles.values()):
                    row[2].plot(log.t[1:], 1e3 * log.u[:, k], line, color=colour, lw=1.1)
        row[0].set(xlabel="tip x (mm)", ylabel="tip y (mm)", title=f"{task}: tip path", aspect="equal")
        row[1].set(xlabel="time (s)", ylabel="tip error in x, y (mm)", title=f"{task}: error")
        row[2].set(xlabel="time (s)", ylabel="tendon displacement (mm)", title=f"{task}: inputs")
    entries = {"reference": Line2D([], [], color="k", ls="--", lw=1.0)}
    entries |= {name: Line2D([], [], color=COLOURS[name], lw=2.0) for name in next(iter(runs.values()))}
    entries |= {name: Line2D([], [], color="k", ls=line, lw=1.1) for name, line in styles.items()}
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=len(entries))
    save_figure(figure, path)


def draw_aim(arm: TendonArm, middle: Array, radius: float, target: Array, path: Path) -> None:
    """The arm at rest and as it holds the set-point, tendons coloured by tension, and the circle, by statics.

    ``middle`` (3,) of the circle of a ``radius`` and the ``target`` (3,) are in m; their heights are free.
    """
    statics = arm.scene.statics()
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND)
    free = np.full(AROUND, np.nan)
    circle = np.column_stack([middle[0] + radius * np.cos(angles), middle[1] + radius * np.sin(angles), free])
    held, u = [], arm.rest_inputs
    for point in np.vstack([circle, target]):
        found = statics.inverse(point, start=u)
        if found.success:
            u = found.u
            held.append((u, 1e3 * found.equilibrium.tip))
    if not held:
        raise ValueError("statics reach no point of the circle; give a smaller --radius")
    figure = arm.plot([arm.rest_inputs, held[-1][0]], "what the tip is to follow")
    axis: Any = figure.axes[0]
    tips = np.array([tip for _, tip in held])
    axis.plot(*tips[:-1].T, "k--", lw=1.0, label="circle")
    axis.plot(*tips[-1:].T, "k+", ms=10, mew=1.6, label="set-point")
    axis.legend(loc="upper left", frameon=False)
    save_figure(figure, path)


def shapes(log: LoopLog, stations: int) -> Array:
    """Backbone points (T+1, S+1, 3) in m, clamp included."""
    points = log.x.reshape(len(log.x), stations, -1)[..., :3]
    return np.concatenate([np.zeros((len(points), 1, 3)), points], axis=1)


def smooth_backbone(points: Array, n: int = 40) -> Array:
    """Cubic spline (n, 3) through the points of one shape."""
    from scipy.interpolate import CubicSpline

    s = np.linspace(0.0, 1.0, len(points))
    return np.asarray(CubicSpline(s, points)(np.linspace(0.0, 1.0, n)))


def draw_shapes(log: LoopLog, stations: int, path: Path, title: str) -> None:
    """Shapes of the arm over time, coloured by time, with the path of the tip."""
    backbone = shapes(log, stations)
    figure = plt.figure(figsize=(7.0, 7.5), constrained_layout=True)
    axis = figure.add_subplot(projection="3d")
    colours = plt.get_cmap("viridis")
    chosen = np.linspace(0, len(backbone) - 1, 24).astype(int)
    for k in chosen:
        line = 1e3 * smooth_backbone(backbone[k])
        axis.plot(*line.T, color=colours(k / len(backbone)), lw=1.6, alpha=0.9)
    tip = 1e3 * backbone[:, -1]
    axis.plot(*tip.T, color="k", lw=0.9, label="tip")
    frame_3d(axis, 1e3 * backbone.reshape(-1, 3))
    axis.set_title(title)
    axis.legend(loc="upper left")
    scale = plt.cm.ScalarMappable(cmap=colours, norm=plt.Normalize(0.0, float(log.t[-1])))
    figure.colorbar(scale, ax=axis, shrink=0.6, label="time (s)")
    save_figure(figure, path)


def animate(log: LoopLog, stations: int, path: Path, title: str, frames: int = 80) -> None:
    """GIF of the arm following the reference, at half of real time or faster; axes are drawn once for all frames."""
    backbone = 1e3 * shapes(log, stations)
    chosen = np.linspace(0, len(backbone) - 1, frames).astype(int)
    figure = Figure(figsize=(4.4, 5.6), dpi=80)
    canvas = FigureCanvasAgg(figure)
    axis: Any = figure.add_axes((0.0, 0.02, 0.9, 0.95), projection="3d")
    frame_3d(axis, backbone.reshape(-1, 3))
    wanted = 1e3 * log.reference
    height = np.where(np.isnan(wanted[:, 2]), backbone[:, -1, 2], wanted[:, 2])
    axis.plot(wanted[:, 0], wanted[:, 1], height, "k--", lw=0.8)
    (line,) = axis.plot([], [], [], color="#1b6ca8", lw=3.0)
    (trace,) = axis.plot([], [], [], color="#1b6ca8", lw=0.9, alpha=0.6)
    said = figure.text(0.5, 0.96, "", ha="center")
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)  # drawn before there was data to move
    pages = []
    for k in tqdm(chosen, desc="animation", unit="frame"):
        canvas.restore_region(still)
        line.set_data_3d(*smooth_backbone(backbone[k]).T)
        trace.set_data_3d(*backbone[: k + 1, -1].T)
        said.set_text(f"{title}, t = {log.t[k]:.2f} s")
        for artist in (line, trace, said):
            figure.draw_artist(artist)
        pages.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    colours = pages[-1].quantize(128)  # the last one shows all there is
    pages = [page.quantize(palette=colours, dither=Image.Dither.NONE) for page in pages]
    with replacing(path) as part, open(part, "wb") as file:
        pages[0].save(file, "GIF", save_all=True, append_images=pages[1:], duration=round(1e3 / RATE), loop=0)
