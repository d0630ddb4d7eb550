"""A picture of the trials by which a controller was chosen. Matplotlib is imported when it is drawn, not before."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from pisplit.pictures.figures import MEASURED, WANTED, keep, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.controllers.tuning.tune import Tuned

NUMBERS = (("rate_weight", "rate weight"), ("gain", "gain of the estimate"), ("horizon", "horizon (steps)"))


def plot_trials(tuned: Tuned, path: str | os.PathLike[str] | None) -> Figure:
    """Error of the trials of ``tuned`` over each number that was chosen, the choice in black; written to ``path``."""
    figure = new_figure(11.0, 3.6)
    chosen = tuned.chosen
    for axis, (name, label) in zip(figure.subplots(1, 3, sharey=True), NUMBERS, strict=True):
        tried = [t for t in tuned.trials if np.isfinite(t.error)]
        axis.plot([getattr(t, name) for t in tried], [t.error for t in tried], "o", color=MEASURED, ms=5)
        axis.plot(getattr(chosen, name), chosen.error, "o", color=WANTED, ms=8)
        axis.set(xlabel=label, yscale="log", xscale="linear" if name == "horizon" else "log")
    figure.axes[0].set_ylabel("error of the loops\n(parts of the radius)")
    figure.suptitle("closed loops on the model; the black one was chosen")
    keep(figure, path)
    return figure
