"""The picture of an identification."""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING

import numpy as np

from pisplit.front.identification import Identified
from pisplit.pictures.figures import MEASURED, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.front.control import Control
    from pisplit.front.reidentification import Causes


def plot_identified(found: Identified, path: str | os.PathLike[str] | None) -> Figure:
    """Errors by horizon of the candidates of ``found`` and one held-out recording; written to ``path`` if not None."""
    figure = new_figure(12.0, 4.6)
    ahead, one = figure.subplots(1, 2)
    best = found.report().chosen
    for name, errors in found.errors.items():
        good = np.isfinite(errors.normalised)
        style = {"lw": 2.2, "zorder": 3} if name == best else {"lw": 1.0, "alpha": 0.8}
        ahead.loglog(found.held.dt * errors.horizons[good], errors.normalised[good], "o-", ms=3, label=name, **style)
    ahead.axhline(1.0, color="k", lw=0.8, ls=":")
    ahead.set(xlabel="time ahead (s)", ylabel="error (1 = predicting the mean)", title="held-out roll-outs")
    ahead.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=3, frameon=False)
    model = dict(found.rivals)[best].lifted
    start = found.held.start(0, model.n_delays)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        x = model.predict(start.x_history, start.u_history, start.inputs).x
    moved = np.argsort(-np.ptp(start.states, axis=0), kind="stable")[:3]  # those that move most tell most
    group = model.outputs.get("tip") or [int(i) for i in np.sort(moved)]
    t = model.dt * np.arange(len(x))
    for i in group:
        (line,) = one.plot(t, start.states[:, i], lw=1.0, label=model.state_names[i])
        one.plot(t, x[:, i], "--", color=line.get_color(), lw=1.4)
    unit = model.units[next(iter(group))]
    one.set(
        xlabel="time (s)", ylabel=f"state ({unit})" if unit else "state", title="a held-out recording, predicted dashed"
    )
    one.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=3, frameon=False)
    return keep(figure, path)


def plot_control(found: Control, path: str | os.PathLike[str] | None) -> Figure:
    """Errors of the trials of ``found`` by rate weight; those that were lost at the top. ValueError without trials.

    Written to ``path`` where one is given.
    """
    if not found.trials:
        raise ValueError("the rate weight was given: there were no trials to draw")
    weights, errors = np.array(sorted(found.trials)).T
    known = np.isfinite(errors)
    figure = new_figure(6.0, 4.0)
    axis = figure.subplots()
    axis.loglog(weights[known], errors[known], "o-", color=MEASURED)
    axis.plot(weights[~known], np.full((~known).sum(), 0.97), "rx", transform=axis.get_xaxis_transform())
    axis.plot(*found.trials[0], "o", ms=13, mfc="none", mec="#b91c1c", mew=1.6)
    axis.set(xlabel="rate weight", ylabel="error of the worst loop (range of outputs)", title="trials on the models")
    tidy(axis)
    return keep(figure, path)


def plot_causes(found: Causes, limit: float, path: str | os.PathLike[str] | None) -> Figure:
    """Misses of each cause of ``found`` as bars, the ``limit`` dashed; written to ``path`` if not None."""
    figure = new_figure(6.0, 3.2)
    axis = figure.subplots()
    names = list(found.missed)
    sizes = np.array([found.missed[name][0] for name in names])
    known = np.isfinite(sizes)
    top = 2.0 * max([limit, *sizes[known]])
    axis.barh(names, np.where(known, sizes, top), color=[MEASURED if k else "0.8" for k in known])  # grey: no fit
    axis.axvline(limit, color="k", lw=0.8, ls="--")
    axis.set(xscale="log", xlabel="misses (standard deviations of the sensors)", title=found.verdict.split(":")[0])
    return keep(figure, path)
