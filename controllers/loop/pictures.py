"""A picture of a closed loop. Matplotlib is imported when it is drawn, not before."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.loop.log import LoopLog, shown_unit
from pisplit.pictures.figures import LINES, MEASURED, WANTED, below, keep, labelled, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Smallest distance that a logarithmic axis shows, in parts of the largest.
FLOOR = 1e-5


def plot_log(log: LoopLog, path: str | os.PathLike[str] | None) -> Figure:
    """The path of the outputs in the plane of most motion, or outputs over time; their distance; the inputs.

    ``log`` is drawn, and written to ``path`` if it is not None. Raises ValueError for a log without a step.
    """
    if not len(log.u):
        raise ValueError(f"nothing was run: there is nothing to draw ({log.message})")
    figure = new_figure(13.0, 4.4)
    path_axis, error, inputs = figure.subplots(1, 3)
    _outputs(path_axis, log)
    _distance(error, log)
    unit, factor = shown_unit(log.input_units[0])
    for k, name in enumerate(log.input_names[:LINES]):
        inputs.step(log.t, factor * np.append(log.u0[k], log.u[:, k]), lw=1.1, label=name)
    inputs.set(xlabel="time (s)", ylabel=labelled("input", unit), title="inputs")
    for axis in (path_axis, inputs):
        below(axis)
    if log.stopped:
        figure.suptitle(f"stopped: {log.message}", color="#b91c1c", fontsize=9, wrap=True)
    return keep(figure, path)


def _outputs(axis: Any, log: LoopLog) -> None:
    unit, factor = shown_unit(log.output_units[0])
    y, wanted = factor * log.y, factor * log.reference
    asked = np.flatnonzero(np.isfinite(wanted).any(axis=0))
    if len(asked) >= 2 and len(set(log.output_units)) == 1:
        i, j = sorted(asked[np.argsort(-np.ptp(y[:, asked], axis=0))[:2]])
        axis.plot(y[:, i], y[:, j], color=MEASURED, lw=1.4, label="measured")
        axis.plot(wanted[:, i], wanted[:, j], color=WANTED, lw=1.0, ls="--", label="reference")
        axis.plot(*y[0, [i, j]], "o", color=MEASURED, ms=4, label="start")
        axis.set(xlabel=labelled(log.output_names[i], unit), ylabel=labelled(log.output_names[j], unit))
        axis.set_aspect("equal", adjustable="datalim")
    else:
        for k in asked[:LINES]:
            (line,) = axis.plot(log.t, y[:, k], lw=1.4, label=log.output_names[k])
            axis.plot(log.t, wanted[:, k], color=line.get_color(), lw=1.0, ls="--")
        axis.set(xlabel="time (s)", ylabel=labelled("output", unit))
    axis.set_title("outputs, reference dashed")


def _distance(axis: Any, log: LoopLog) -> None:
    units = dict.fromkeys(log.output_units)
    for unit in units:
        label, factor = shown_unit(unit)
        of = [i for i, u in enumerate(log.output_units) if u == unit]
        missed: Array = factor * np.sqrt(np.nansum((log.y - log.reference)[:, of] ** 2, axis=1))
        axis.semilogy(log.t, np.maximum(missed, FLOOR * (missed.max() or 1.0)), color=MEASURED, lw=1.2)
        axis.set_ylabel(labelled("distance from the reference", label))
    axis.set(xlabel="time (s)", title="error")
