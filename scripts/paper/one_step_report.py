"""Table, attribution and figure of the one-step reading."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm

from common.report import Report
from paper.figures import COLOURS, MARKERS
from paper.one_step import AHEAD, METHODS
from pisplit.files import replacing

Row = dict[str, Any]
UNITS = {"shape": "m^2", "velocity": "m^2/s^2"}
#: Errors beyond this are drawn at the upper edge: nothing of the arm is left.
LARGEST = 10.0


def printed(rows: Sequence[Row]) -> str:
    """Medians, shape / tip velocity, as text."""
    width = max(len(m) for m in METHODS)
    heads = [f"{label(a):>17}" for a in AHEAD]
    lines = [f"{'method':<{width}} {'|D1|':>7} {'|D2|':>7} {''.join(heads)}   shape [m^2] / velocity [m^2/s^2]"]
    for row in rows:
        cells = [f"{row[f'shape median {a}']:.1e} / {row[f'velocity median {a}']:.1e}".rjust(17) for a in AHEAD]
        lines.append(f"{row['method']:<{width}} {row['n1']:>7} {row['n2']:>7} {' '.join(cells)}")
    return "\n".join(lines)


def label(ahead: int) -> str:
    """Of a number of steps ahead."""
    return "open loop" if ahead == 0 else f"{ahead} step{'s' if ahead > 1 else ''}"


def record(report: Report, rows: Sequence[Row], targets: bool) -> None:
    """All medians, and who has which part of the gain at the smallest |D1|; ``targets``: hold them to those known."""
    n2 = max(row["n2"] for row in rows)
    n1 = min(row["n1"] for row in rows if row["n2"] == n2)
    for row in rows:
        for ahead in AHEAD:
            for what, unit in UNITS.items():
                name = f"{row['method']}, |D1| = {row['n1']}, |D2| = {row['n2']}, {label(ahead)}, squared {what} error"
                report.figure(name, row[f"{what} median {ahead}"], unit)
    first = {row["method"]: row for row in rows if (row["n1"], row["n2"]) == (n1, n2)}
    linear, toward, split = (first[METHODS[i]] for i in (0, 2, 3))
    for ahead in AHEAD:
        plain, near, best = (row[f"shape median {ahead}"] for row in (linear, toward, split))
        at = f"{n1} pairs, {label(ahead)}"
        report.figure(f"gain, {at}: L-EDMDc over PI-EDMDc", plain / best, "times")
        report.figure(f"gain, {at}: of it toward the identity", plain / near, "times")
        report.figure(f"gain, {at}: of it kinematics", near / best, "times")
    if targets and n1 == 64:
        for row, known in ((linear, 1.1e-3), (split, 2.3e-6)):
            apart = abs(np.log2(row["shape median 1"] / known))
            report.figure(f"{row['method']}, 64 pairs, one step: halvings from {known:g} m^2", apart, "", ("<=", 1.0))


def draw(rows: Sequence[Row], title: str, path: Path) -> None:
    """(a, b) one step over |D1|, (c) roll-outs over |D1|, (d, e) PI-EDMDc over |D1| x |D2|, (f) by steps ahead."""
    n2 = max(row["n2"] for row in rows)
    curves = [row for row in rows if row["n2"] == n2]
    figure, axes = plt.subplots(2, 3, figsize=(17, 9.6), layout="constrained")
    _over_pairs(axes[0, 0], curves, "shape", 1, "(a) squared shape error one step ahead")
    _over_pairs(axes[0, 1], curves, "velocity", 1, "(b) squared tip velocity error one step ahead")
    _over_pairs(axes[0, 2], curves, "shape", 0, "(c) squared shape error of roll-outs of 6 s")
    grid = [row for row in rows if row["method"] == METHODS[3]]
    for axis, what, letter in zip(axes[1], UNITS, "de", strict=False):
        _over_both(axis, grid, what, f"({letter}) {METHODS[3]}, median squared {what} error one step ahead")
    _by_horizon(axes[1, 2], curves)
    axes[0, 0].legend(fontsize=9)
    figure.suptitle(f"{title}\nLines: medians over all test steps of all draws; bands: quartiles.", fontsize=11)
    for suffix in (".png", ".pdf"):
        with replacing(path.with_suffix(suffix), make_folders=True) as part:
            figure.savefig(part)
    plt.close(figure)


def _over_pairs(axis: Any, rows: Sequence[Row], what: str, ahead: int, title: str) -> None:
    for k, method in enumerate(METHODS):
        mine = sorted((r for r in rows if r["method"] == method), key=lambda r: r["n1"])
        low, mid, high = (
            np.minimum([r[f"{what} {name} {ahead}"] for r in mine], LARGEST) for name in ("lower", "median", "upper")
        )
        n1 = [r["n1"] for r in mine]
        axis.fill_between(n1, low, high, color=COLOURS[k], alpha=0.12, lw=0)
        # B-EDMDc lies on L-EDMDc: a marker without a face shows both
        face = "none" if method == METHODS[1] else COLOURS[k]
        axis.plot(n1, mid, MARKERS[k], ls="-", color=COLOURS[k], mfc=face, ms=5 + 4 * (k == 1), lw=1.5, label=method)
    axis.set_xscale("log", base=2)
    axis.set_yscale("log")
    axis.set(xlabel="|D1|, training pairs", ylabel=f"[${UNITS[what]}$]", title=title)


def _over_both(axis: Any, rows: Sequence[Row], what: str, title: str) -> None:
    n2s = sorted({row["n2"] for row in rows})
    n1s = sorted({row["n1"] for row in rows if row["n2"] == n2s[0]})
    values = np.full((len(n2s), len(n1s)), np.nan)
    for row in rows:
        if row["n1"] in n1s:
            i, j = n2s.index(row["n2"]), n1s.index(row["n1"])
            values[i, j] = row[f"{what} median 1"]
            axis.text(j, i, f"{values[i, j]:.1e}", ha="center", va="center", fontsize=9)
    low, high = np.nanmin(values), np.nanmax(values)
    norm = LogNorm(low / 3.0, high * 3.0)  # what hardly differs looks alike
    axis.imshow(values, origin="lower", aspect="auto", cmap="viridis_r", norm=norm, alpha=0.6)
    axis.grid(False)
    axis.set_xticks(range(len(n1s)), n1s)
    axis.set_yticks(range(len(n2s)), n2s)
    axis.set(xlabel="|D1|, training pairs", ylabel="|D2|, phase-space samples", title=title)


def _by_horizon(axis: Any, rows: Sequence[Row]) -> None:
    n1 = min(row["n1"] for row in rows)
    for k, method in enumerate(METHODS):
        (row,) = (r for r in rows if r["method"] == method and r["n1"] == n1)
        values = np.minimum([row[f"shape median {a}"] for a in AHEAD], LARGEST)
        axis.plot(range(len(AHEAD)), values, MARKERS[k], ls="-", color=COLOURS[k], mfc="none" if k == 1 else None)
    axis.set_yscale("log")
    axis.set_xticks(range(len(AHEAD)), [label(a) for a in AHEAD])
    axis.set(title=f"(f) squared shape error ahead, {n1} pairs", ylabel="[$m^2$]")
