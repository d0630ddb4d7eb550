"""Figures without the state of pyplot. Matplotlib is imported when something is drawn, not before."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pisplit.files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours of what is measured or best, of what is wanted, and of what stands behind.
MEASURED, WANTED, BEHIND = "#1b6ca8", "#2b2b2b", "#9aa7b5"
#: Most lines that are told apart by colour in one panel.
LINES = 6


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of ``width`` and ``height`` in inches, without the state of pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", dpi=130)
    FigureCanvasAgg(figure)
    return figure


def keep(figure: Figure, path: str | os.PathLike[str] | None) -> Figure:
    """Write ``figure`` to ``path``, whole or not at all; nothing where it is None. The figure."""
    if path is not None:
        place = Path(path)
        with replacing(place) as part:
            figure.savefig(part, dpi=130, format=place.suffix.lstrip(".") or "png")
    return figure


def tidy(*axes: Any) -> None:
    """A light grid and no upper or right border on the ``axes``."""
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)


def below(axis: Any, columns: int = 3) -> None:
    """The legend of ``axis`` under it in so many ``columns``, where it covers no data."""
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=columns, frameon=False)


def labelled(name: str, unit: str) -> str:
    """The ``name`` of an axis with its ``unit`` where there is one."""
    return f"{name} ({unit})" if unit else name
