"""Pictures of modes, energies and costs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import MEASURED, below, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.analysis.cost import Cost
    from pisplit.models.rod.analysis.energy import EnergyAccount
    from pisplit.models.rod.analysis.modes import NaturalModes

Path = str | os.PathLike[str] | None
#: Modes that are drawn, and points along each.
SHAPES, POINTS = 4, 41


def plot_modes(found: NaturalModes, path: Path) -> Figure:
    """Shapes of the slowest modes of ``found`` where they move most, and frequency and damping of all.

    Written to ``path`` where one is given.
    """
    figure = new_figure(11.0, 4.6)
    axes: Any = figure.subplots(1, 2)
    s = np.linspace(0.0, 1.0, POINTS)
    for k in range(min(SHAPES, len(found.frequency))):
        shape = found.displacements(found.scene.rod.length * s[1:])[k]
        turned = shape * np.exp(-1j * np.angle(shape.reshape(-1)[np.abs(shape).argmax()]))
        most = np.append(0.0, turned.real[:, np.abs(shape).max(axis=0).argmax()])
        size = np.abs(most).max() or 1.0
        axes[0].plot(s, most / size, lw=1.5, label=f"{found.frequency[k]:.3g} Hz, damping {found.damping[k]:.2g}")
    axes[0].set(xlabel="arclength / length", ylabel="displacement / largest one", title="slowest modes")
    below(axes[0], 2)
    resolved = found.resolved
    number = np.arange(1, len(found.frequency) + 1)
    for which, fill, label in ((resolved, MEASURED, "resolved"), (~resolved, "none", "not resolved by the nodes")):
        axes[1].semilogy(number[which], found.frequency[which], "o", color=MEASURED, mfc=fill, ms=5, label=label)
    axes[1].set(xlabel="mode", ylabel="frequency (Hz)", title="all modes")
    below(axes[1], 2)
    tidy(*axes)
    return keep(figure, path)


def plot_account(found: EnergyAccount, path: Path) -> Figure:
    """Stored energies of ``found``, work of the terms and what was lost; beneath it the imbalance.

    Written to ``path`` where one is given.
    """
    figure = new_figure(9.0, 6.0)
    axes: Any = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
    for name in ("kinetic", "elastic", "gravity"):
        values = getattr(found.stored, name)
        axes[0].plot(found.t, values - values[0], lw=1.4, label=f"gain, {name}")
    for name, values in found.work.items():
        axes[0].plot(found.t, values, "--", lw=1.2, label=f"work of {name}")
    axes[0].plot(found.t, found.dissipated, ":", color="k", lw=1.6, label="dissipated")
    axes[0].set(ylabel="energy since the start (J)")
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axes[1].plot(found.t, found.imbalance, color="#b91c1c", lw=1.2)
    axes[1].set(xlabel="time (s)", ylabel="imbalance (J)")
    tidy(*axes)
    return keep(figure, path)


def plot_cost(found: Cost, path: Path) -> Figure:
    """Instructions of residual and Jacobian in motion by term of ``found``.

    Written to ``path`` where one is given.
    """
    rows = [("the rod alone", found.rod), *found.terms, ("the whole scene", found.total)]
    figure = new_figure(9.0, 1.4 + 0.5 * len(rows))
    axis: Any = figure.subplots()
    at = np.arange(len(rows))
    for shift, name in ((-0.18, "residual"), (0.18, "jacobian")):
        axis.barh(at + shift, [getattr(i, name) for _, i in rows], 0.34, label=name)
    axis.set_yticks(at, [text[:60] for text, _ in rows])
    axis.invert_yaxis()
    axis.set(xscale="symlog", xlabel="instructions in motion")
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    tidy(axis)
    return keep(figure, path)
