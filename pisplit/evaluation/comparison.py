"""Several models side by side, and errors over the amount of data."""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.checks import count
from pisplit.data.episodes import Episodes
from pisplit.data.pairs import Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.evaluation.horizon import HorizonErrors, horizon_errors
from pisplit.evaluation.matching import States, model_of
from pisplit.evaluation.rollouts import RolloutErrors, rollout_errors
from pisplit.lifted.model import LiftedModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: What a ``fit`` may ask for beside d1, by the name of its argument.
MORE = {"d2": "phase samples", "twin": "episodes of a twin"}


class Estimator(Protocol):
    """What is compared: an estimator with parameters and, once fitted, a lifted model."""

    @property
    def n_delays(self) -> int:
        """Steps of history that it needs."""

    @property
    def lifted(self) -> LiftedModel:
        """The fitted model."""

    def get_params(self) -> dict[str, Any]:
        """Constructor arguments by name."""

    def score(self, episodes: Episodes, states: States = None) -> RolloutErrors:
        """Errors of open-loop roll-outs of ``episodes`` over ``states`` (output group, names or indices)."""


@brief
@dataclass(frozen=True)
class Comparison:
    """Open-loop errors of several models on the same episodes.

    errors    roll-out errors by model
    horizons  errors by horizon by model; empty unless some were asked for
    """

    errors: Mapping[str, RolloutErrors]
    horizons: Mapping[str, HorizonErrors]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """JSON-able figures by model; an error that divergence makes infinite is None."""
        table: dict[str, dict[str, Any]] = {}
        for name, found in self.errors.items():
            low, high = found.quartiles
            row = {"median": found.median, "lower quartile": low, "upper quartile": high, "mean": found.mean}
            table[name] = {k: _finite(v) for k, v in row.items()} | {"diverged": found.diverged_fraction}
            if name in self.horizons:
                steps, values = self.horizons[name].horizons, self.horizons[name].normalised
                table[name]["normalised"] = {int(h): _finite(v) for h, v in zip(steps, values, strict=True)}
        return table

    def __str__(self) -> str:
        width = max(map(len, self.errors))
        ahead = [int(h) for h in next(iter(self.horizons.values())).horizons] if self.horizons else []
        head = f"{'':<{width}} {'median':>9} {'quartiles':>21} {'mean':>9} {'diverged':>9}"
        unit = next(iter(self.errors.values())).unit
        lines = [f"squared errors in {unit}"] if unit else []
        lines.append(head + "".join(f"{f'{h} steps':>12}" for h in ahead))
        for name, found in self.errors.items():
            low, high = found.quartiles
            line = f"{name:<{width}} {found.median:>9.2e} {low:>10.2e} {high:>10.2e} {found.mean:>9.2e}"
            line += f" {100.0 * found.diverged_fraction:>7.1f} %"
            if name in self.horizons:
                line += "".join(f"{value:>12.3g}" for value in self.horizons[name].normalised)
            lines.append(line)
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Median and quartiles by model, and errors by horizon if there are; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_comparison

        return plot_comparison(self, path)


def compare(
    models: Mapping[str, Estimator | LiftedModel],
    test: Episodes,
    states: States = None,
    horizons: Sequence[int] = (),
    stride: int = 1,
) -> Comparison:
    """Roll every fitted estimator or model of ``models`` out over the ``test`` episodes, columns matched by name.

    ``states``: output group, names or indices (default: all). ``horizons`` (steps) add normalised errors of roll-outs
    that start at every ``stride``-th step. Raises ValueError for no models, one not fitted, or data that do not fit.
    """
    if not models:
        raise ValueError("models is empty; give at least one fitted estimator or LiftedModel")
    lifted = {name: model_of(model, repr(name)) for name, model in models.items()}
    return Comparison(
        errors={name: rollout_errors(model, test, states) for name, model in lifted.items()},
        horizons={name: horizon_errors(m, test, horizons, states, stride) for name, m in lifted.items()}
        if len(horizons)
        else {},
    )


@brief
@dataclass(frozen=True)
class LearningCurve:
    """Median squared roll-out errors over the number of training pairs, one for every draw of pairs.

    sizes     (G,) numbers of pairs
    seeds     (R,) of the draws
    errors    by estimator, (G, R); infinite where the roll-outs diverged or the fit was refused
    diverged  by estimator, (G, R) fraction of test episodes that diverged
    refusals  (estimator, size, seed, message) of the fits that raised ValueError
    """

    sizes: tuple[int, ...]
    seeds: tuple[int, ...]
    errors: Mapping[str, Array]
    diverged: Mapping[str, Array]
    refusals: tuple[tuple[str, int, int, str], ...]

    def quantile(self, name: str, q: float) -> Array:
        """Quantile ``q`` in [0, 1] (G,) of estimator ``name`` over the seeds.

        It is the lower neighbour: no interpolation with infinity.
        """
        return np.asarray(np.quantile(self.errors[name], q, axis=1, method="lower"))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able medians and quartiles by estimator; None stands for infinite."""
        rows = {"lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75}
        found: dict[str, Any] = {"sizes": list(self.sizes), "seeds": list(self.seeds)}
        for name in self.errors:
            found[name] = {row: [_finite(v) for v in self.quantile(name, q)] for row, q in rows.items()}
            found[name]["diverged"] = [float(v) for v in self.diverged[name].mean(axis=1)]
        return found

    def __str__(self) -> str:
        width = max(map(len, ("pairs", *self.errors)))
        lines = [f"{'pairs':<{width}}" + "".join(f"{size:>31}" for size in self.sizes)]
        for name in self.errors:
            low, middle, high = (self.quantile(name, q) for q in (0.25, 0.5, 0.75))
            cells = [f"{b:.2e} [{a:.2e}, {c:.2e}]" for a, b, c in zip(low, middle, high, strict=True)]
            lines.append(f"{name:<{width}}" + "".join(f"{cell:>31}" for cell in cells))
        for name in self.errors:
            said = [message for who, _, _, message in self.refusals if who == name]
            if said:
                lines.append(f"{name}: {len(said)} of {self.errors[name].size} fits refused: {said[0]}")
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Median and quartiles over the number of pairs; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_learning

        return plot_learning(self, path)


def learning_curve(
    estimators: Mapping[str, Estimator],
    d1: Episodes,
    test: Episodes,
    sizes: Sequence[int],
    seeds: Sequence[int] = (0, 1, 2, 3, 4),
    d2: PhaseSamples | None = None,
    states: States = None,
    twin: Episodes | None = None,
) -> LearningCurve:
    """Fit a fresh copy of every estimator to ``sizes`` pairs drawn from d1 with each of ``seeds``; errors on ``test``.

    estimators  by name: any with ``n_delays``, ``get_params`` and ``fit(d1, ..., pairs=...)``
    d1, test    training episodes, and those that are rolled out: columns are matched by name
    sizes       numbers of pairs
    seeds       of the draws; estimators of one number of delays see the same pairs
    d2, twin    phase samples, and episodes of a twin, for estimators whose ``fit`` has an argument of that name
    states      output group, names or indices of the states whose errors count (default: all)

    A fit that raises ValueError is recorded among the ``refusals``. Raises ValueError for nothing to fit, and for more
    pairs than there are.
    """
    chosen, draws = tuple(count(size, "sizes") for size in sizes), tuple(int(seed) for seed in seeds)
    if not estimators or not chosen or not draws:
        raise ValueError("estimators, sizes and seeds must each hold at least one entry")
    shape = (len(chosen), len(draws))
    errors = {name: np.full(shape, np.inf) for name in estimators}
    diverged = {name: np.ones(shape) for name in estimators}
    refusals: list[tuple[str, int, int, str]] = []
    for name, estimator in estimators.items():
        pairs = d1.pairs(estimator.n_delays)
        for i, size in enumerate(chosen):
            for j, seed in enumerate(draws):
                drawn = pairs.sample(size, seed)
                try:
                    found = _fitted(estimator, d1, drawn, {"d2": d2, "twin": twin}).score(test, states)
                except ValueError as error:
                    refusals.append((name, size, seed, str(error)))
                    continue
                errors[name][i, j], diverged[name][i, j] = found.median, found.diverged_fraction
    return LearningCurve(chosen, draws, errors, diverged, tuple(refusals))


def _fitted(estimator: Any, d1: Episodes, pairs: Pairs, more: Mapping[str, Any]) -> Estimator:
    """A fresh copy of the estimator, fitted to these pairs and to what else its ``fit`` asks for by name."""
    fresh = type(estimator)(**estimator.get_params())
    asked = [name for name in more if name in inspect.signature(fresh.fit).parameters]
    for name in asked:
        if more[name] is None:
            raise ValueError(f"{type(estimator).__name__} learns from {MORE[name]} too; give {name}")
    fitted: Estimator = fresh.fit(d1, pairs=pairs, **{name: more[name] for name in asked})
    return fitted


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
