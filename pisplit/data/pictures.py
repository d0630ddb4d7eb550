"""The picture of recordings. Matplotlib is imported when it is drawn, not before."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.pictures.figures import LINES, keep, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.data.report import DataReport


def plot_report(report: DataReport, path: str | os.PathLike[str] | None) -> Figure:
    """The longest episode of ``report``, its inputs against one another, and the scan of the delay.

    Written to ``path`` if it is not None.
    """
    figure = new_figure(13.0, 7.0)
    (states, plane), (inputs, scan) = figure.subplots(2, 2, width_ratios=[2.2, 1.0])
    episodes = report.drawn
    longest = int(np.argmax(report.steps))
    t = report.dt * np.arange(report.steps[longest] + 1)
    _lines(states, t, episodes.xs[longest], episodes.state_names, "states, each over its own range")
    _lines(inputs, t[:-1], episodes.us[longest], episodes.input_names, "inputs, each over its own range", steps=True)
    _plane(plane, episodes)
    _delays(scan, report)
    figure.suptitle(f"{report.episodes} episodes, {report.duration:.4g} s; the longest: {report.steps[longest]} steps")
    tidy(states, plane, inputs, scan)
    return keep(figure, path)


def _lines(axis: Any, t: Any, values: Any, names: Any, title: str, steps: bool = False) -> None:
    for k in range(min(LINES, values.shape[1])):
        low, high = values[:, k].min(), values[:, k].max()
        line = (values[:, k] - low) / (high - low if high > low else 1.0) + 1.15 * k
        axis.plot(t, line, lw=1.0, drawstyle="steps-post" if steps else "default")
        axis.annotate(f"{names[k]} [{low:.3g}, {high:.3g}]", (t[0], 1.15 * k + 1.02), fontsize=7)
    more = f" ({values.shape[1] - LINES} more)" if values.shape[1] > LINES else ""
    axis.set(xlabel="time (s)", yticks=[], title=title + more)


def _plane(axis: Any, episodes: Any) -> None:
    """Which pairs of the first two inputs, or states, were visited."""
    u = episodes.stacked_inputs()
    values, names = (u, episodes.input_names) if u.shape[1] > 1 else (episodes.stacked_states(), episodes.state_names)
    thin = max(1, len(values) // 5000)
    second = min(1, values.shape[1] - 1)
    axis.plot(values[::thin, 0], values[::thin, second], ".", ms=2, alpha=0.5)
    axis.set(xlabel=names[0], ylabel=names[second], title="where the recordings have been")


def _delays(axis: Any, report: DataReport) -> None:
    tried = report.latency.tried
    axis.plot(1e3 * tried[:, 0], tried[:, 1], lw=1.2)
    if report.latency.delay is not None:
        axis.axvline(1e3 * report.latency.delay, color="k", lw=0.8, ls=":")
    axis.set(xlabel="delay of the motion after commands (ms)", ylabel="one-step residual", ylim=(0.0, None))
    axis.set_title(str(report.latency), fontsize=8)
