"""The four panels of the paper's result figure: errors over |D1|, and over |D1| x |D2|."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import FuncFormatter, LogLocator

from paper.tables import Row
from pisplit.files import replacing

COLOURS = ("#d95f02", "#7570b3", "#1b6ca8", "#1b9e77", "#e7298a", "#66a61e", "#a6761d", "#666666")
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
KINDS = (("shape", "squared shape error", "m^2"), ("velocity", "squared distal velocity error", "m^2/s^2"))
NOTE = (
    "Lines: median over all steps of all test roll-outs and draws; bands: quartiles. "
    "Open markers on the upper edge: the median roll-out diverged; %: roll-outs that diverged."
)
plt.rcParams.update({"font.size": 10, "axes.grid": True, "grid.alpha": 0.25, "savefig.dpi": 130})
plt.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False})


def draw_panels(
    rows: Sequence[Row],
    law: str,
    methods: Sequence[str],
    grid_method: str,
    title: str,
    path: Path,
    d2: str = "phase-space samples",
) -> None:
    """Panels (a, b) of all methods with the largest D2, (c, d) of ``grid_method``; PNG and PDF beside it.

    ``d2``: what |D2| counts."""
    mine = [row for row in rows if row["law"] == law]
    most = max(row["n2"] for row in mine)
    figure, axes = plt.subplots(2, 2, figsize=(13.5, 10.5))
    figure.subplots_adjust(left=0.07, right=0.98, bottom=0.06, top=0.86, wspace=0.16, hspace=0.3)
    for axis, (what, label, unit), letter in zip(axes[0], KINDS, "ab", strict=True):
        curves = [row for row in mine if row["n2"] == most]
        _draw_curves(axis, curves, methods, what, unit)
        axis.set_title(f"({letter}) {label}, |D2| = {most}", pad=12)  # clear of markers on the upper edge
        axis.set_ylabel(f"{label} [${unit}$]")
    grid = [row for row in mine if row["method"] == grid_method]
    for axis, (what, label, unit), letter in zip(axes[1], KINDS, "cd", strict=True):
        _draw_grid(axis, grid, what, f"${unit}$")
        axis.set_ylabel(f"|D2|, {d2}")
        axis.set(title=f"({letter}) median {label}, {grid_method}")
    figure.suptitle(title, y=0.985)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=min(len(methods), 6), bbox_to_anchor=(0.5, 0.965))
    figure.text(0.5, 0.905, NOTE, ha="center", fontsize=9)
    _save(figure, path)


def _draw_curves(axis: Any, rows: Sequence[Row], methods: Sequence[str], what: str, unit: str) -> None:
    """Medians with quartile bands; infinite medians stand on the top edge with the part that diverged."""
    finite = [v for row in rows for q in ("lower quartile", "median") if np.isfinite(v := row[f"{what} {q} [{unit}]"])]
    low, high = (min(finite), max(finite)) if finite else (1e-6, 1.0)
    bottom, top = 0.5 * low, 30.0 * high
    sizes = sorted({row["n1"] for row in rows})
    # A size close below the next one keeps its marker; labels would lie on each other.
    labelled = [a for a, b in zip(sizes, [*sizes[1:], np.inf], strict=True) if b > 1.5 * a]
    for i, method in enumerate(methods):
        mine = sorted((row for row in rows if row["method"] == method), key=lambda row: row["n1"])
        if not mine:
            continue
        n1 = np.array([row["n1"] for row in mine], dtype=float)
        lower, median, upper = (
            np.array([row[f"{what} {q} [{unit}]"] for row in mine])
            for q in ("lower quartile", "median", "upper quartile")
        )
        diverged = np.array([row["diverged"] for row in mine])
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        shown = np.minimum(median, top)
        axis.fill_between(n1, np.minimum(lower, top), np.minimum(upper, top), color=colour, alpha=0.15, lw=0)
        axis.plot(n1, shown, color=colour, lw=1.6)
        axis.plot([], [], marker, ls="-", color=colour, label=method)
        fine = np.isfinite(median)
        axis.plot(n1[fine], median[fine], marker, color=colour, ms=6)
        axis.plot(n1[~fine], shown[~fine], marker, mfc="white", mec=colour, mew=1.6, ms=9, clip_on=False, zorder=5)
        for x, y, part in zip(n1, shown, diverged, strict=True):
            if part > 0.0 and x in labelled:
                offset = (0, -13 - 11 * i) if y >= top else (0, 7 if i % 2 else -15)
                axis.annotate(
                    f"{100 * part:.0f} %",
                    (x, y),
                    xytext=offset,
                    textcoords="offset points",
                    ha="center",
                    fontsize=8,
                    color=colour,
                )
    axis.set_xscale("log", base=2)
    axis.set_yscale("log")
    axis.set_ylim(bottom, top)
    axis.set_xticks(labelled, [_size(size) for size in labelled])
    axis.minorticks_off()
    axis.set_xlabel("|D1|, training pairs")


def _draw_grid(axis: Any, rows: Sequence[Row], what: str, unit: str) -> None:
    """Medians by colour and number; where the median diverged, the fraction of divergent roll-outs and when."""
    n2s = sorted({row["n2"] for row in rows})
    n1s = sorted({row["n1"] for row in rows if row["n2"] == n2s[0]})
    rows = [row for row in rows if row["n1"] in n1s]
    key = next(name for name in rows[0] if name.startswith(f"{what} median"))
    values = np.full((len(n2s), len(n1s)), np.nan)
    for row in rows:
        i, j = n2s.index(row["n2"]), n1s.index(row["n1"])
        values[i, j] = row[key] if np.isfinite(row[key]) else np.nan
        part = f"{100 * row['diverged']:.0f} % diverged"
        text = f"{row[key]:.1e}" if np.isfinite(row[key]) else "infinite"
        if row["diverged"] > 0.0:
            text += f"\n{part}\nat step {row['median step of divergence']:.0f}"
        axis.text(j, i, text, ha="center", va="center", fontsize=8)
    axis.set_facecolor("#eeeeee")
    axis.grid(False)
    norm = LogNorm(*_range(values))
    image = axis.imshow(values, origin="lower", aspect="auto", cmap="viridis_r", norm=norm, alpha=0.6)
    axis.set_xticks(range(len(n1s)), [_size(n) for n in n1s])
    axis.set_yticks(range(len(n2s)), [_size(n) for n in n2s])
    axis.set_xlabel("|D1|, training pairs")
    if np.isfinite(values).any():
        bar = axis.figure.colorbar(image, ax=axis)
        bar.ax.set_title(f"[{unit}]", fontsize=9)  # beside the bar it would run into the next panel
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0e}"))
        bar.ax.minorticks_off()


def _range(values: Any) -> tuple[float, float]:
    if not np.isfinite(values).any():
        return 0.1, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    wider = max(1.0, np.sqrt(30.0 * low / high))  # small differences keep similar colours, ticks are powers of ten
    return low / wider, high * wider


def _size(n: int) -> str:
    power = int(n).bit_length() - 1
    return f"$2^{{{power}}}$" if n == 1 << power else f"{n}"


def _save(figure: Any, path: Path) -> None:
    for suffix in (".png", ".pdf"):
        with replacing(path.with_suffix(suffix), make_folders=True) as part:
            figure.savefig(part)
    plt.close(figure)
