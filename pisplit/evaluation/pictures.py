"""Pictures of errors: over time, by horizon, of several models, over the amount of data."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array
from pisplit.pictures.figures import MEASURED, below, keep, labelled, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.evaluation.comparison import Comparison, LearningCurve
    from pisplit.evaluation.eigenpairs import ModelSpectrum
    from pisplit.evaluation.horizon import HorizonErrors
    from pisplit.evaluation.predicted import PredictedError
    from pisplit.evaluation.rollouts import RolloutErrors

Path = str | os.PathLike[str] | None


def plot_rollouts(found: RolloutErrors, path: Path) -> Figure:
    """Squared errors of ``found`` over the steps of the roll-outs, one line an episode, with their median.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    lost = 0
    for k, (values, gone) in enumerate(zip(found.squared, found.diverged, strict=True)):
        lost += int(gone)
        axis.plot(*_finite(values), lw=0.9, alpha=0.6, color=MEASURED, label="an episode" if k == 0 else None)
    shortest = min(map(len, found.squared))
    middle = np.quantile(np.stack([v[:shortest] for v in found.squared]), 0.5, axis=0, method="lower")
    axis.plot(*_finite(middle), color="k", lw=1.8, label="median")
    title = f"{len(found.squared)} roll-outs" + (f", {lost} diverge (drawn up to there)" if lost else "")
    axis.set(yscale="log", xlabel="steps ahead", ylabel=labelled("squared error", found.unit), title=title)
    below(axis)
    tidy(axis)
    return keep(figure, path)


def plot_predicted(found: PredictedError, path: Path) -> Figure:
    """Median and quartiles of the squared distances of ``found`` over the time ahead.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    low, middle, high = (np.quantile(found.squared, q, axis=0, method="lower") for q in (0.25, 0.5, 0.75))
    known = np.isfinite(middle)
    t = found.dt * np.arange(1, len(middle) + 1)
    whole = known & np.isfinite(high)
    axis.fill_between(t[whole], low[whole], high[whole], color=MEASURED, alpha=0.2, lw=0, label="quartiles")
    axis.plot(t[known], middle[known], color=MEASURED, lw=1.6, label="median")
    lost = "" if known.all() else f", half of them lost after {found.dt * (np.argmin(known) + 1):.3g} s"
    axis.set(yscale="log", xlabel="time ahead (s)", ylabel=labelled("squared error", found.unit))
    axis.set_title(f"predicted under commands that were not recorded{lost}", fontsize=10)
    below(axis)
    tidy(axis)
    return keep(figure, path)


def plot_horizons(found: HorizonErrors, path: Path) -> Figure:
    """Errors of ``found`` by horizon in parts of the spread: all states together, and the six worst alone.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    parts = found.rms / np.where(found.spread > 0.0, found.spread, np.inf)
    worst = np.argsort(-np.where(np.isfinite(parts), parts, 0.0).max(axis=0))[:6]
    for i in worst:
        axis.plot(found.horizons, _shown(parts[:, i]), "o-", ms=2.5, lw=0.9, alpha=0.8, label=found.names[i])
    axis.plot(found.horizons, _shown(found.normalised), "ko-", ms=3, lw=1.8, label="all states")
    axis.axhline(1.0, color="k", lw=0.8, ls=":")
    axis.set(xscale="log", yscale="log", xlabel="steps ahead", ylabel="RMS error / spread of the state")
    axis.set_title(f"{found.starts} roll-outs; 1 is as bad as predicting the mean", fontsize=10)
    below(axis, 4)
    tidy(axis)
    return keep(figure, path)


def plot_comparison(found: Comparison, path: Path) -> Figure:
    """Median and quartiles of every model of ``found``, and normalised errors by horizon where there are some.

    Written to ``path`` where one is given.
    """
    figure = new_figure(11.0 if found.horizons else 6.5, 1.6 + 0.45 * len(found.errors) + 1.2 * bool(found.horizons))
    axes: Any = figure.subplots(1, 2 if found.horizons else 1, squeeze=False)[0]
    for k, errors in enumerate(found.errors.values()):
        _span(axes[0], errors.quartiles, errors.median, k)
    unit = next(iter(found.errors.values())).unit
    axes[0].set_yticks(range(len(found.errors)), list(found.errors))
    axes[0].set_ylim(len(found.errors) - 0.5, -0.5)
    axes[0].set(xscale="log", xlabel=labelled("squared error, median and quartiles", unit))
    if found.horizons:
        for name, ahead in found.horizons.items():
            axes[1].plot(ahead.horizons, _shown(ahead.normalised), "o-", ms=3, label=name)
        axes[1].axhline(1.0, color="k", lw=0.8, ls=":")
        axes[1].set(xscale="log", yscale="log", xlabel="steps ahead", ylabel="normalised error")
        below(axes[1], 2)
    tidy(*axes)
    return keep(figure, path)


def plot_learning(found: LearningCurve, path: Path) -> Figure:
    """Median over the draws of ``found`` with quartiles, over the number of pairs; gaps where the median diverges.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.6)
    axis = figure.subplots()
    for k, name in enumerate(found.errors):
        low, middle, high = (found.quantile(name, q) for q in (0.25, 0.5, 0.75))
        (line,) = axis.plot(found.sizes, _shown(middle), "o-", ms=4, label=name)
        whole = np.isfinite(low) & np.isfinite(high)
        axis.fill_between(
            np.array(found.sizes)[whole], low[whole], high[whole], color=line.get_color(), alpha=0.15, lw=0
        )
        gone = [size for size, value in zip(found.sizes, middle, strict=True) if not np.isfinite(value)]
        axis.plot(
            gone, np.full(len(gone), 1.0 - 0.03 * k), "x", color=line.get_color(), transform=axis.get_xaxis_transform()
        )
    axis.set(xscale="log", yscale="log", xlabel="recorded pairs", ylabel="median squared error")
    axis.set_title(f"{len(found.seeds)} draws; a cross at the top: half of them diverge", fontsize=10)
    below(axis, 2)
    tidy(axis)
    return keep(figure, path)


def _span(axis: Any, ends: Sequence[float], middle: float, row: int) -> None:
    if np.isfinite(middle):
        high = ends[1] if np.isfinite(ends[1]) else middle
        axis.plot([ends[0], high], [row, row], color=MEASURED, lw=5, alpha=0.35, solid_capstyle="butt")
        axis.plot(middle, row, "o", color=MEASURED, ms=6)
    else:
        axis.text(0.98, row, "diverges", transform=axis.get_yaxis_transform(), ha="right", va="center", color="#b91c1c")


def _finite(values: Array) -> tuple[Any, Any]:
    """Steps and values up to the divergence."""
    steps = np.flatnonzero(np.isfinite(values))
    return steps + 1, values[steps]


def _shown(values: Iterable[float]) -> Array:
    found = np.array(list(values), dtype=np.float64)
    return np.where(np.isfinite(found), found, np.nan)


def plot_model_spectrum(found: ModelSpectrum, path: Path) -> Figure:
    """Eigenvalues of ``found`` in the unit circle by their residuals: light ones are of the dictionary or of noise.

    Written to ``path`` where one is given.
    """
    figure = new_figure(6.4, 5.0)
    axis: Any = figure.subplots()
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    axis.plot(np.cos(angle), np.sin(angle), color="k", lw=0.8)
    order = np.argsort(-found.residuals)
    values, residuals = found.eigenvalues[order], np.clip(found.residuals[order], 1e-6, 1.0)
    drawn = axis.scatter(
        values.real, values.imag, c=np.log10(residuals), cmap="viridis", vmin=-6.0, vmax=0.0, s=26, lw=0
    )
    figure.colorbar(drawn, ax=axis, label="log10 of the residual (low: an eigenfunction)")
    bad = int(found.spurious().sum())
    title = f"eigenvalues of the model: {bad} of {len(values)} spurious on {found.pairs} pairs"
    axis.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    axis.set_title(title, fontsize=10)
    tidy(axis)
    return keep(figure, path)
