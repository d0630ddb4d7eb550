"""Figures of the ablation: errors over the number of pairs, and over the level of noise."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from common.drawing import save_figure
from common.protocol import Summary

Table = dict[tuple[str, str, int], Summary]

OURS = "PI twin"
#: Colour of a method, and of its variants by the start of their names; what varies has a marker of its own.
COLOURS = {
    "L-EDMDc": "tab:blue",
    "B-EDMDc": "tab:orange",
    "PI hold": "tab:green",
    OURS: "tab:red",
    "arm itself": "tab:purple",
    "arm simulated": "tab:pink",
    "L-EDMDc, rod + x_eq": "lightsteelblue",
    "B-EDMDc, rod + x_eq": "navajowhite",
    "PI Strang, rod + x_eq": "black",
    "PI balanced": "tab:gray",
    "re-lifted": "tab:brown",
}
MARKERS = {"bounded": "v", "one recording": "^", "no pairs": "*", "tendons from pairs": "D"}
LABELS = {"shape": "squared shape error (m$^2$)", "velocity": "squared tip velocity error (m$^2$/s$^2$)"}


def draw_sizes(table: Table, path: Path, what: str) -> None:
    """One panel a scenario: medians with quartiles over the number of pairs. Scenarios of one size are left out."""
    every = list(dict.fromkeys(law for law, _, _ in table))
    sizes = {name: {size for law, _, size in table if law == name} for name in every}
    names = [name for name in every if len(sizes[name]) > 1] or every
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(6.2 * columns, 4.0 * rows + 0.8), squeeze=False, constrained_layout=True
    )
    labels = list(dict.fromkeys(method for _, method, _ in table))
    finite = [s.median for s in table.values() if np.isfinite(s.median)]
    top = 3.0 * max(finite)
    lines: dict[str, Any] = {}
    for axis, name in zip(axes.ravel(), names, strict=False):
        for label in labels:
            points = sorted((size, s) for (law, method, size), s in table.items() if (law, method) == (name, label))
            if not points:
                continue
            x = np.array([size for size, _ in points])
            median, lower, upper = (
                np.minimum([getattr(s, part) for _, s in points], top) for part in ("median", "lower", "upper")
            )
            look = _look(label)
            lines.setdefault(label, axis.plot(x, median, **look, label=label)[0])
            axis.fill_between(x, lower, upper, color=look["color"], alpha=0.12, lw=0)
            if len(x) == 1:  # no width to fill
                axis.vlines(x, lower, upper, color=look["color"], alpha=0.6)
            gone = np.array([not np.isfinite(s.median) for _, s in points])
            axis.plot(x[gone], median[gone], "X", color=look["color"], ms=9)
        axis.set(xscale="log", yscale="log", title=name, xlabel="recorded pairs", ylim=(None, 1.3 * top))
        axis.set_ylabel(LABELS[what])
        axis.grid(alpha=0.25)
    for axis in axes.ravel()[len(names) :]:
        axis.axis("off")
    below: dict[str, Any] = {"loc": "outside lower center", "ncols": min(5, len(lines)), "frameon": False}
    figure.legend(list(lines.values()), list(lines), **below)
    parts = ("Open-loop roll-outs of 6 s: medians and quartiles", "crosses at the top edge diverge")
    figure.suptitle(("; " if columns > 1 else "\n").join(parts))
    save_figure(figure, path, dpi=110)


def _look(label: str) -> dict[str, Any]:
    """Colour, marker and width of a method's line."""
    variant = next((end for end in MARKERS if label.endswith(end)), "")
    base = label.removesuffix(f", {variant}") if variant else label
    ours = base == OURS
    marker = (
        {"marker": MARKERS[variant], "ms": 9, "ls": "none", "mec": "black"} if variant else {"marker": "o", "ms": 4}
    )
    return {"color": COLOURS[base], "lw": 2.4 if ours else 1.3, "zorder": 4 if ours else 3, **marker}


def draw_noise(tables: Mapping[str, Table], levels: Mapping[str, float], pairs: int, path: Path) -> None:
    """Errors with ``pairs`` pairs over the level of noise: scenarios by their factor of the usual noise."""
    figure, axes = plt.subplots(1, len(tables), figsize=(6.2 * len(tables), 4.6), constrained_layout=True)
    for axis, (what, table) in zip(np.atleast_1d(axes), tables.items(), strict=True):
        noisy = [name for name, factor in levels.items() if factor]
        for label in dict.fromkeys(method for law, method, size in table if law in noisy and size == pairs):
            found = [(f, table[name, label, pairs]) for name, f in levels.items() if (name, label, pairs) in table]
            x = np.array([factor for factor, _ in sorted(found, key=lambda pair: pair[0])])
            points = [point for _, point in sorted(found, key=lambda pair: pair[0])]
            median, lower, upper = (
                np.array([getattr(point, part) for point in points]) for part in ("median", "lower", "upper")
            )
            look = _look(label)
            axis.plot(x, median, **look, label=label)
            axis.fill_between(x, lower, upper, color=look["color"], alpha=0.12, lw=0)
        axis.set_xscale("symlog", linthresh=0.25, linscale=0.5)
        ticks = sorted(set(levels.values()))
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set(yscale="log", xlabel="noise, in parts of 1 mm, 1 degree, 5 % of rates", ylabel=LABELS[what])
        axis.minorticks_off()
        axis.grid(alpha=0.25)
    np.atleast_1d(axes)[0].legend(fontsize=8, frameon=False)
    figure.suptitle(f"Open-loop roll-outs of 6 s after {pairs} noisy pairs: medians and quartiles")
    save_figure(figure, path, dpi=130)
