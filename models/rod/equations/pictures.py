"""The picture of linear dynamics."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import MEASURED, below, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.equations.linear import Linearisation

Path = str | os.PathLike[str] | None


def plot_linearisation(found: Linearisation, path: Path) -> Figure:
    """Eigenvalues of ``found`` in the complex plane; those that grow in red.

    Written to ``path`` where one is given.
    """
    figure = new_figure(6.0, 4.6)
    axis: Any = figure.subplots()
    values = found.eigenvalues
    grows = values.real > 0.0
    axis.plot(values[~grows].real, values[~grows].imag, "o", mfc="none", color=MEASURED, label="decay")
    if grows.any():
        axis.plot(values[grows].real, values[grows].imag, "x", color="#b91c1c", label=f"{grows.sum()} grow")
    slow = float(np.abs(values).min()) or 1.0
    axis.set_xscale("symlog", linthresh=slow)
    axis.set_yscale("symlog", linthresh=slow)
    axis.axvline(0.0, color="k", lw=0.8)
    axis.set(xlabel="real part (1/s)", ylabel="imaginary part (1/s)", title="eigenvalues of the linear dynamics")
    below(axis, 2)
    tidy(axis)
    return keep(figure, path)
