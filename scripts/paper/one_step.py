"""A reading of the paper under which its figure appears: errors one step ahead, slow inputs, SI units, K_h toward I.

What the paper does not print is inferred here from what reproduces its picture; nothing of it is the authors' word. The
methods are the package's estimators.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from common.data import DT, Scale
from common.protocol import HISTORY, all_pairs, pairs_at, random_pairs, squared_error
from paper.methods import UNKNOWN, dictionary
from paper.till import implicit_episodes, implicit_origin
from pisplit import BilinearEDMDc, Episodes, LiftedModel, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit.models.arm.blocks import unordered
from pisplit.models.arm.phase_samples import make_phase_samples, phase_origin, strain_rates
from pisplit.models.arm.recording import check_origin
from pisplit.models.arm.tendon_arm import TendonArm

Array = NDArray[np.float64]

#: From so many episodes on, machine code saves more time than its compilation takes.
WORTH_COMPILING = 64
#: Steps ahead at which errors are taken; 0 stands for the whole roll-out of a test episode, all steps of it.
AHEAD = (1, 5, 20, 0)
#: Weights of the LASSO on sums of squares: "fixed" is the printed 0.01 N at 64 pairs, whatever the number of pairs.
PENALTIES: Mapping[str, dict[str, Any]] = {
    "fixed": {"alpha": 0.64, "relative": False},
    "printed": {"alpha": 0.01, "relative": "samples"},
}
GENERATOR_ALPHA = 0.01
METHODS = ("L-EDMDc", "B-EDMDc", "L-EDMDc toward I", "PI-EDMDc", "PI-EDMDc, forces of f too")
#: Pairs from which on B-EDMDc, 2880 columns, is left out: its products of states with millimetres stay unused here.
MOST_BILINEAR = 4096


@dataclass(frozen=True)
class Reading:
    """What decides the data and the fits of a run.

    hold     steps between random targets of the inputs
    penalty  "fixed" or "printed" (:data:`PENALTIES`)
    """

    arm: TendonArm
    folder: Path
    scale: Scale
    hold: int = 64
    penalty: str = "fixed"
    law: str = "zero-sum"
    seed: int = 0
    workers: int = -1

    def data(self) -> tuple[Episodes, Episodes, PhaseSamples]:
        """Training and test episodes by BDF2, and phase samples of the passive arm; made where they are not there."""
        name = f"{self.law}-hold{self.hold}-{self.scale}"
        path = self.folder / f"d1-{name}-seed{self.seed}.h5"
        number = self.scale.training + self.scale.test
        if path.exists():
            episodes = Episodes.load(path)
            check_origin(path, episodes.provenance, implicit_origin(self.arm, self.scale.steps, DT, *self._drawn))
        else:
            episodes = implicit_episodes(
                self.arm,
                path,
                number,
                self.scale.steps,
                DT,
                *self._drawn[:2],
                workers=self.workers,
                law=self.law,
                compiled=number >= WORTH_COMPILING,
            )
        training = episodes[: self.scale.training]
        rates = strain_rates(self.arm, training)
        path = self.folder / f"d2-{name}-{self.scale.samples}-seed{self.seed}.h5"
        if path.exists():
            samples = PhaseSamples.load(path)
            check_origin(path, samples.provenance, phase_origin(self.arm, rates, seed=self.seed, law=self.law))
        else:
            samples = make_phase_samples(
                self.arm, path, self.scale.samples, rates, seed=self.seed, workers=self.workers, law=self.law
            )
        return training, episodes[self.scale.training :], samples

    @property
    def _drawn(self) -> tuple[int, int, str]:
        return self.hold, self.seed, self.law


@dataclass(frozen=True)
class Fit:
    """One fit: a method on ``n1`` pairs of a ``seed`` and the first ``n2`` phase samples."""

    method: str
    n1: int
    n2: int
    seed: int


@dataclass(frozen=True)
class Fits:
    """Fits of a run by their numbers, as a task of :func:`pisplit.models.arm.blocks.unordered`."""

    reading: Reading
    fits: tuple[Fit, ...]

    def __call__(self, k: int) -> dict[int, tuple[Array, Array]]:
        """Squared errors of shape and tip velocity (steps,) by the steps ahead of the fit ``k``."""
        training, test, kinematic, whole = _data(self.reading)
        fit = self.fits[k]
        samples = whole if fit.method == METHODS[4] else kinematic
        model = fitted(fit.method, training, _first(samples, fit.n2), fit.n1, fit.seed, self.reading.penalty)
        return {ahead: errors_ahead(model, test, ahead) for ahead in AHEAD}


def kinematic_part(samples: PhaseSamples, quantities: Sequence[str]) -> PhaseSamples:
    """The same samples of an f that moves p, R, v and w alone, the rows that nothing unknown acts on: q' = omega' = 0.

    ``quantities`` are those of the states.
    """
    xdot = samples.xdot.copy()
    xdot[:, np.isin(quantities, UNKNOWN)] = 0.0
    return replace(samples, xdot=xdot)


def estimator(method: str, data: Episodes, n2: int, penalty: str = "fixed") -> Any:
    """The estimator of a method of :data:`METHODS`, on the states as they are: SI units, no constant column."""
    theta = dictionary(data)
    options: dict[str, Any] = {"penalty": "lasso", "solver": "active-set", "scale": None, **PENALTIES[penalty]}
    if method == "L-EDMDc":
        return LinearEDMDc(theta, **options)
    if method == "B-EDMDc":
        return BilinearEDMDc(theta, **options)
    if method == "L-EDMDc toward I":
        return LinearEDMDc(theta, toward="identity", **options)
    known = GENERATOR_ALPHA * (n2 if options["relative"] is False else 1)  # 0.01 |D2| either way
    return PIEDMDc(
        theta,
        toward="identity",
        half_step="first-order",
        generator_penalty="lasso",
        generator_alpha=known,
        **options,
    )


def fitted(method: str, data: Episodes, samples: PhaseSamples, n1: int, seed: int, penalty: str) -> LiftedModel:
    """The model of a method, fitted to ``n1`` pairs drawn from ``data`` with ``seed``, and to phase ``samples``."""
    pairs = pairs_at(data, random_pairs(data, n1, seed), HISTORY)
    made = estimator(method, data, len(samples), penalty)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # models that fail are what is measured here
        if isinstance(made, PIEDMDc):
            made.fit(data, samples, pairs, excitation=None)
        else:
            made.fit(data, pairs, excitation=None)
    return made.lifted


def errors_ahead(model: LiftedModel, test: Episodes, ahead: int) -> tuple[Array, Array]:
    """Squared errors of shape and tip velocity ``ahead`` steps after true histories, one history every ``ahead`` steps.

    ``ahead`` = 0: all steps of roll-outs of whole episodes; what is not finite is infinite. The first begins at step 4.
    """
    steps = len(test.us[0])
    horizon = ahead or steps - HISTORY
    starts = np.arange(HISTORY, steps - horizon + 1, horizon)
    x, u = np.stack(test.xs), np.stack(test.us)

    def windows(rows: Array, first: int, last: int) -> Array:
        """(E S, last - first, k): rows ``first`` to ``last`` about every start."""
        at = starts[:, None] + np.arange(first, last)
        return rows[:, at].reshape(len(rows) * len(starts), last - first, rows.shape[2])

    z = model.lift(windows(x, -model.n_delays, 1), windows(u, -model.n_delays, 0))
    with np.errstate(over="ignore", invalid="ignore"):
        found = model.rollout(z, windows(u, 0, horizon)).x[:, 1:]
        truth = windows(x, 1, horizon + 1)
        kept = slice(-1, None) if ahead else slice(None)
        groups = (list((test.outputs or {})[name]) for name in ("shape", "tip_velocity"))
        errors = [np.ravel(squared_error(truth[:, kept][..., g], found[:, kept][..., g])) for g in groups]
    shape, velocity = (np.where(np.isfinite(e), e, np.inf) for e in errors)
    return shape, velocity


def run_fits(reading: Reading, fits: Sequence[Fit], workers: int, progress: bool = True) -> list[dict[str, Any]]:
    """One row for every method, |D1| and |D2|: medians, quartiles over all test steps of all draws, by steps ahead."""
    _data(reading)  # made once, before others ask for them
    task, found = Fits(reading, tuple(sorted(fits, key=lambda f: -f.n1))), {}
    jobs = unordered(task, range(len(task.fits)), workers)
    for k, errors in tqdm(jobs, desc="one-step reading", total=len(fits), unit="fit", disable=not progress):
        found[task.fits[k]] = errors
    groups: dict[tuple[str, int, int], list[dict[int, tuple[Array, Array]]]] = {}
    for fit in fits:
        groups.setdefault((fit.method, fit.n1, fit.n2), []).append(found[fit])
    return [
        {"method": method, "n1": n1, "n2": n2, "draws": len(parts), **_summary(parts)}
        for (method, n1, n2), parts in groups.items()
    ]


def planned(sizes: Mapping[int, int], grid: Mapping[int, int], n2s: Sequence[int], most: int) -> list[Fit]:
    """Fits of all methods at ``sizes`` (|D1|: draws; 0: all ``most`` pairs) with the last |D2|, of PI over a grid."""
    fits: dict[Fit, None] = {}
    for counts, chosen, samples in ((sizes, METHODS, n2s[-1:]), (grid, METHODS[3:4], n2s)):
        for n, draws in counts.items():
            n1 = n or most
            names = [m for m in chosen if m != METHODS[1] or n1 <= MOST_BILINEAR] if n < most else []
            fits |= dict.fromkeys(Fit(m, n1, n2, seed) for m in names for n2 in samples for seed in range(draws))
    return list(fits)


def largest(reading: Reading) -> int:
    """Number of training pairs."""
    return all_pairs(_data(reading)[0])


def _summary(parts: Sequence[dict[int, tuple[Array, Array]]]) -> dict[str, float]:
    found = {}
    for ahead in AHEAD:
        for i, what in enumerate(("shape", "velocity")):
            values = np.concatenate([part[ahead][i] for part in parts])
            for q, name in ((0.25, "lower"), (0.5, "median"), (0.75, "upper")):
                found[f"{what} {name} {ahead}"] = float(np.quantile(values, q, method="lower"))
    return found


@lru_cache(maxsize=1)
def _data(reading: Reading) -> tuple[Episodes, Episodes, PhaseSamples, PhaseSamples]:
    training, test, whole = reading.data()
    return training, test, kinematic_part(whole, training.quantities or ()), whole


@lru_cache(maxsize=16)
def _first(samples: PhaseSamples, count: int) -> PhaseSamples:
    """The first ``count`` samples, the same object every time: their moments are remembered with them."""
    return samples if count == len(samples) else samples.take(np.arange(count))
