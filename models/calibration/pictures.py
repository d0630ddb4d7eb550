"""Pictures of calibrations: tendons that were found, candidates that were tried."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import MEASURED, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.calibration.choice import CalibrationChoice
    from pisplit.models.calibration.model import Calibration
    from pisplit.models.calibration.ring_down import FoundDamping


def plot_calibration(found: Calibration, path: str | os.PathLike[str] | None) -> Figure:
    """Where the tendons of ``found`` run at the base and at the tip, and their stiffness and slack.

    Written to ``path`` where one is given.
    """
    p = found.parameters
    figure = new_figure(11.0, 4.4)
    axes: Any = figure.subplots(1, 3, width_ratios=[1.3, 1.0, 1.0])
    at, to = 1e3 * p.offset, 1e3 * (p.offset + p.shift)
    for i, (a, b) in enumerate(zip(at, to, strict=True)):
        axes[0].plot(*np.stack([a, b]).T, color=MEASURED, lw=1.0)
        axes[0].annotate(f"{i + 1}", a, xytext=(6, 6), textcoords="offset points")
    axes[0].plot(*at.T, "o", color=MEASURED, ms=7, label="at the base")
    axes[0].plot(*to.T, "x", color="#d95f02", ms=7, label="at the tip")
    axes[0].plot(0.0, 0.0, "k+", ms=9)
    axes[0].set(xlabel="body axis 1 (mm)", ylabel="body axis 2 (mm)", title="section", aspect="equal")
    axes[0].margins(0.25)
    axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, frameon=False)
    number = np.arange(1, p.n_tendons + 1)
    axes[1].bar(number, p.stiffness, color=MEASURED)
    axes[1].set(xlabel="tendon", ylabel="stiffness (N/m)", title="stiffness", xticks=number)
    axes[2].bar(number, 1e3 * p.slack, color=MEASURED)
    axes[2].set(xlabel="tendon", ylabel="slack (mm)", title="slack", xticks=number)
    figure.suptitle(f"{found.samples} samples, residual {found.residual:.3g}", fontsize=10)
    tidy(*axes)
    return keep(figure, path)


def plot_choice(found: CalibrationChoice, path: str | os.PathLike[str] | None) -> Figure:
    """Held-out errors of all candidates of ``found``, a dot a roll-out; those that fail at the right border.

    Written to ``path`` where one is given.
    """
    figure = new_figure(9.0, 1.2 + 0.42 * len(found.tried))
    axis = figure.subplots()
    for k, tried in enumerate(found.tried):
        good = np.isfinite(tried.errors)
        colour = "#b91c1c" if k == found.chosen else MEASURED
        axis.plot(1e3 * np.sqrt(tried.errors[good]), np.full(good.sum(), k), "o", ms=4, alpha=0.5, color=colour)
        if good.any():
            axis.plot(1e3 * np.sqrt(tried.errors[good].mean()), k, "|", ms=18, mew=2.2, color=colour)
        lost = np.full((~good).sum(), 0.98)
        axis.plot(lost, np.full((~good).sum(), k), "x", color=colour, transform=axis.get_yaxis_transform())
    axis.set(
        xscale="log",
        xlabel="root mean square distance of points on held-out roll-outs (mm)",
        yticks=range(len(found.tried)),
        yticklabels=[t.name for t in found.tried],
    )
    axis.invert_yaxis()
    tidy(axis)
    return keep(figure, path)


def plot_damping(found: FoundDamping, path: str | os.PathLike[str] | None) -> Figure:
    """Free decay of the slowest motion over eight periods, and its envelope within two standard errors of ``found``.

    Written to ``path`` where one is given.
    """
    figure = new_figure(8.0, 3.6)
    axis = figure.subplots()
    periods = np.linspace(0.0, 8.0, 801)
    spread = 2.0 * found.ratio * found.error / found.bending
    low, high = (np.exp(-2.0 * np.pi * max(found.ratio + s, 0.0) * periods) for s in (spread, -spread))
    seconds = periods / found.frequency
    told = f"damping ratio {found.ratio:.3g} +- {spread:.1g}"
    axis.fill_between(seconds, low, high, color="#d95f02", alpha=0.35, lw=0.0, label=f"envelope, {told}")
    decay = np.exp(-2.0 * np.pi * found.ratio * periods) * np.cos(2.0 * np.pi * periods)
    axis.plot(seconds, decay, color=MEASURED, label=f"slowest motion, {found.frequency:.3g} Hz")
    axis.set(xlabel="time (s)", ylabel="displacement / that at the release", title=f"{found.bending:.3g} N m$^2$ s")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=2, frameon=False)
    tidy(axis)
    return keep(figure, path)
