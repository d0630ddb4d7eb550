"""Pictures of references."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import positive
from pisplit.pictures.figures import LINES, below, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.controllers.references import Reference

MOMENTS = 600


def plot_reference(
    reference: Reference, path: str | os.PathLike[str] | None, duration: float, y0: ArrayLike | None
) -> Figure:
    """Coordinates of a ``reference`` over ``duration`` s from ``y0`` (width,); written to ``path`` if not None."""
    start = np.zeros(reference.width) if y0 is None else np.asarray(y0, dtype=np.float64)
    t = np.linspace(0.0, positive(duration, "duration", "s"), MOMENTS)
    y = reference.starting_at(start)(t)
    figure = new_figure(7.0, 4.2)
    axis: Any = figure.subplots()
    asked = np.flatnonzero(np.isfinite(y).any(axis=0))
    for i in asked[:LINES]:
        axis.plot(t, y[:, i], lw=1.5, label=f"coordinate {i}")
    free = ", ".join(str(i) for i in range(reference.width) if i not in asked)
    title = f"free: {free}" if free else "all coordinates are given"
    axis.set(xlabel="time (s)", ylabel=f"reference of {reference.track or 'the outputs'}", title=title)
    if len(asked):
        below(axis, LINES)
    tidy(axis)
    return keep(figure, path)
