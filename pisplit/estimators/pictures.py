"""Pictures of what estimators found beside the model."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import MEASURED, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.estimators.actuator_scan import FoundActuator
    from pisplit.estimators.choosing import Chosen


def plot_actuator(found: FoundActuator, path: str | os.PathLike[str] | None) -> Figure:
    """Residuals of ``found`` over the lags and plays that were tried; the chosen one ringed.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.6)
    axis: Any = figure.subplots()
    order = np.argsort(-found.tried[:, 2])
    lag, play, residual = found.tried[order].T
    drawn = axis.scatter(1e3 * lag, play, c=np.log10(residual), cmap="viridis", s=46, lw=0)
    figure.colorbar(drawn, ax=axis, label="log10 of the one-step residual")
    chosen = found.actuator
    axis.plot(1e3 * chosen.lag, chosen.play, "o", ms=13, mfc="none", mec="#b91c1c", mew=1.6)
    axis.set(xlabel="lag (ms)", ylabel="play (units of the command)")
    axis.set_title(f"residual {found.residual:.3g}, without an actuator {found.without:.3g}", fontsize=10)
    tidy(axis)
    return keep(figure, path)


def plot_chosen(found: Chosen, path: str | os.PathLike[str] | None) -> Figure:
    """Errors of the candidates of ``found`` on the folds, the chosen one filled; a word where there is no error.

    Written to ``path`` where one is given.
    """
    figure = new_figure(8.0, 1.4 + 0.45 * len(found.tried))
    axis: Any = figure.subplots()
    for k, candidate in enumerate(found.tried):
        if np.isfinite(candidate.error):
            fill = MEASURED if candidate.name == found.name else "none"
            axis.plot(candidate.error, k, "o", ms=8, color=MEASURED, mfc=fill)
        else:
            axis.text(0.98, k, "no error", transform=axis.get_yaxis_transform(), ha="right", va="center")
    axis.set_yticks(range(len(found.tried)), [c.name for c in found.tried])
    axis.set(xscale="log", xlabel=f"held-out error on {len(found.folds)} folds", ylim=(len(found.tried) - 0.5, -0.5))
    tidy(axis)
    return keep(figure, path)
