"""Pictures of generators: which eigenvalues to believe, what the known half step does."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import MEASURED, below, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.generator.half_step import HalfStep
    from pisplit.generator.spectrum import Spectrum

Path = str | os.PathLike[str] | None


def plot_spectrum(found: Spectrum, path: Path) -> Figure:
    """Eigenvalues of ``found`` by their residuals: light ones are of the dictionary, not of the system.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.2, 4.6)
    axis: Any = figure.subplots()
    on_plane(figure, axis, found)
    return keep(figure, path)


def on_plane(figure: Any, axis: Any, found: Spectrum) -> None:
    """Eigenvalues of ``found`` by their residuals on an ``axis`` of a ``figure``."""
    order = np.argsort(-found.residuals)
    values, residuals = found.values[order], found.residuals[order]
    size = float(np.quantile(np.abs(found.values), 0.5)) or 1.0
    drawn = axis.scatter(values.real, values.imag, c=residuals, cmap="viridis", vmin=0.0, vmax=1.0, s=26, lw=0)
    figure.colorbar(drawn, ax=axis, label="residual (0: an eigenfunction)")
    if np.abs(found.values).max() > 100.0 * size:
        axis.set_xscale("symlog", linthresh=size)
        axis.set_yscale("symlog", linthresh=size)
    axis.axvline(0.0, color="k", lw=0.8)
    bad = int(found.spurious().sum())
    axis.set(xlabel="real part (1/s)", ylabel="imaginary part (1/s)")
    axis.set_title(f"eigenvalues of the generator: {bad} of {len(values)} spurious", fontsize=10)
    tidy(axis)


def plot_half_step(found: HalfStep, path: Path) -> Figure:
    """Eigenvalues of K_f of ``found`` beside those of its generator, where it has one.

    Written to ``path`` where one is given.
    """
    figure = new_figure(11.0 if found.spectrum is not None else 5.5, 4.6)
    axes: Any = figure.subplots(1, 2 if found.spectrum is not None else 1, squeeze=False)[0]
    values = np.linalg.eigvals(found.K)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    axes[0].plot(np.cos(angle), np.sin(angle), color="k", lw=0.8, label="unit circle")
    axes[0].plot(values.real, values.imag, "o", ms=4, mfc="none", color=MEASURED, label="eigenvalues of K_f")
    axes[0].set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    axes[0].set_title(
        f"half step by {found.kind}: growth {found.growth:.3g}, condition {found.condition:.2g}", fontsize=10
    )
    below(axes[0], 2)
    tidy(axes[0])
    if found.spectrum is not None:
        on_plane(figure, axes[1], found.spectrum)
    return keep(figure, path)
