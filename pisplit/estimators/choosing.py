"""``choose``: estimators and dictionaries side by side, judged by the same held-out roll-outs as alpha is."""

from __future__ import annotations

import inspect
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import non_negative
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.bilinear import BilinearEDMDc
from pisplit.estimators.edmdc import LinearEDMDc
from pisplit.estimators.fold_errors import FoldErrors, reasons
from pisplit.evaluation.comparison import MORE
from pisplit.evaluation.matching import States
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Candidate:
    """One of those that were tried.

    name       in the table
    error      median squared error of held-out roll-outs in scaled states, joined over folds; infinite if it diverges
    choice     what it chose for itself: "alpha = 0.01", or a structure
    bounded    whether it stays bounded under the excitation; None if that was not tested
    fits       number of regressions
    seconds    of CPU
    refusal    why it could not be fitted, "" if it could
    """

    name: str
    error: float
    choice: str
    bounded: bool | None
    fits: int
    seconds: float
    refusal: str = ""


@dataclass(frozen=True)
class Chosen:
    """What :func:`choose` found.

    estimator  the best one, fitted to all pairs
    name       of it
    tried      all candidates, in the order in which they were given
    folds      names (F,) of the folds that judged
    reasons    why the choice may be wrong, a line each
    """

    estimator: Any
    name: str
    tried: tuple[Candidate, ...]
    folds: tuple[str, ...]
    reasons: tuple[str, ...]

    def __str__(self) -> str:
        width = max(len(c.name) for c in self.tried)
        lines = [f"{'':<{width}} {'error':>9} {'fits':>6} {'CPU s':>7}  on {len(self.folds)} folds"]
        for c in self.tried:
            note = c.refusal or c.choice + (", does not stay bounded" if c.bounded is False else "")
            mark = " (chosen)" if c.name == self.name else ""
            lines.append(f"{c.name:<{width}} {c.error:>9.2e} {c.fits:>6} {c.seconds:>7.2g}  {note}{mark}")
        return "\n".join([*lines, *self.reasons])

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Errors of the candidates, those that were refused left out; written to ``path`` where one is given."""
        from pisplit.estimators.pictures import plot_chosen

        return plot_chosen(self, path)


@one_blas_thread()
def choose(
    candidates: Sequence[Any] | Mapping[str, Any],
    d1: Episodes | Sequence[Episodes],
    pairs: Pairs | None = None,
    d2: PhaseSamples | None = None,
    twin: Episodes | None = None,
    states: States = None,
    horizon: int | None = None,
    folds: int | None = None,
    excitation: ArrayLike | str | None = "auto",
    tolerance: float = 0.0,
    progress: bool = True,
) -> Chosen:
    """The best of several estimators or dictionaries on roll-outs of held-out recordings, fitted to all pairs.

    Each is searched over its alphas on the same folds, from the same pairs, and judged on the same steps, whatever its
    delays; what diverges on a fold where another does not is out, and what does not stay bounded comes after all that
    do. The cost is that of alpha="cv" for each: alphas times folds regressions, told candidate by candidate.

    candidates  estimators, or dictionaries, which stand for LinearEDMDc (BilinearEDMDc if they hold products) with
                alpha="cv"; a mapping gives them names. In the order of preference, simple ones first
    d1, pairs   training episodes, and pairs drawn from them if not all
    d2, twin    phase samples, and episodes of a twin, for those whose ``fit`` has an argument of that name
    states      output group, names or indices of the states whose errors count (default: all)
    horizon, folds  cv_horizon and cv_folds for all
    excitation  as in ``fit``
    tolerance   the first candidate within this part of the smallest error is taken
    progress    whether to show a bar

    Warns of reasons why the choice may be wrong. Raises ValueError, in one line, for nothing to choose from, what is no
    estimator, and where none can be fitted.
    """
    named, d1 = _named(candidates), together(d1, "d1")
    limit = 1.0 + non_negative(tolerance, "tolerance")
    history = max(e.n_delays for e in named.values())
    used = d1.pairs(history) if pairs is None else d1.checked_pairs(pairs, history)
    options = {"cv_states": states, "cv_horizon": horizon, "cv_folds": folds}
    more = {"d2": d2, "twin": twin, "pairs": used, "excitation": excitation}
    fitted, tried, tables = {}, [], []
    bar = tqdm(named.items(), desc="choose", unit="candidate", disable=not progress)
    for name, estimator in bar:
        bar.set_postfix_str(name)
        begin = time.process_time()
        try:
            model = _fitted(_searching(estimator, options), d1, more)
        except (ValueError, np.linalg.LinAlgError) as error:
            refusal = " ".join(str(error).split())
            tried.append(Candidate(name, np.inf, "", None, 0, time.process_time() - begin, refusal))
            continue
        search = getattr(model, "search_", None) or model.cv_
        fitted[name], spent = model, time.process_time() - begin
        tables.append(search.table.take([search.position]))
        size, choice = len(search.errors) * len(search.table.folds) + 1, _choice(search)
        tried.append(Candidate(name, np.inf, choice, search.bounded, size, spent))
    if not fitted:
        raise ValueError(f"no candidate can be fitted: {'; '.join(f'{c.name}: {c.refusal}' for c in tried)[:300]}")
    names, table = list(fitted), FoldErrors.together(tables)
    errors = table.joint()
    ranked = errors if np.isfinite(errors).any() else table.fallback()
    stays = np.array([fitted[name].bounded_ is not False for name in names])
    ranked = np.where(stays, ranked, np.inf) if np.isfinite(ranked[stays]).any() else ranked
    best = int(np.argmax(ranked <= limit * ranked.min()))
    error_of = dict(zip(names, errors.tolist(), strict=True))
    told = tuple(Candidate(**{**vars(c), "error": error_of.get(c.name, np.inf)}) for c in tried)
    search = getattr(fitted[names[best]], "search_", None) or fitted[names[best]].cv_
    said = dict.fromkeys((*reasons(table, names, best, stays, tolerance), *search.reasons))
    if not stays[best]:
        said[
            "no candidate stays bounded under the excitation; record more, or excitation=None for an unstable plant"
        ] = None
    for reason in said:
        warnings.warn(reason, stacklevel=2)
    where = tuple(fold.name for fold in table.folds)
    return Chosen(fitted[names[best]], names[best], told, where, tuple(said))


def _named(candidates: Sequence[Any] | Mapping[str, Any]) -> dict[str, Any]:
    """Estimators by name."""
    if isinstance(candidates, str) or not np.iterable(candidates) or not len(candidates):
        raise ValueError(f"candidates = {candidates!r}; expected at least one estimator or dictionary")
    given = candidates if isinstance(candidates, Mapping) else dict(enumerate(candidates, start=1))
    made = {}
    for key, value in given.items():
        estimator = value
        if isinstance(value, Dictionary):
            estimator = (BilinearEDMDc if value.is_bilinear else LinearEDMDc)(value, alpha="cv")
        if not hasattr(estimator, "get_params") or "cv_folds" not in estimator.get_params():
            raise ValueError(
                f"candidate {key} is a {type(value).__name__}; expected an estimator with alpha='cv', or a Dictionary"
            )
        made[key if isinstance(candidates, Mapping) else f"{key}: {type(estimator).__name__}"] = estimator
    return {str(key): value for key, value in made.items()}


def _searching(estimator: Any, options: Mapping[str, Any]) -> Any:
    """A fresh copy that chooses on held-out roll-outs, of its one alpha where it has one."""
    params = {**estimator.get_params(), **{k: v for k, v in options.items() if v is not None}}
    if params.get("alpha", "cv") != "cv":
        params |= {"alpha": "cv", "alphas": [params["alpha"]]}
    return type(estimator)(**params)


def _fitted(estimator: Any, d1: Episodes, more: Mapping[str, Any]) -> Any:
    asked = [name for name in more if name in inspect.signature(estimator.fit).parameters]
    for name in asked:
        if name in MORE and more[name] is None:
            raise ValueError(f"{type(estimator).__name__} learns from {MORE[name]} too; give {name}")
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # what matters of it is told of the choice
        return estimator.fit(d1, **{name: more[name] for name in asked})


def _choice(search: Any) -> str:
    return str(search.chosen) if hasattr(search, "tried") else f"alpha = {search.chosen:.3g}"
