"""What all EDMDc estimators share: options, fit, the choice of alpha on held-out roll-outs, prediction, scores."""

from __future__ import annotations

import inspect
import warnings
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array, non_negative
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.alpha_search import AlphaSearch, Choice, Trial, choose, hold_out, state_weights
from pisplit.estimators.boundedness import bounded
from pisplit.estimators.excitation import EXCURSION, Excitation
from pisplit.evaluation.rollouts import RolloutErrors, rollout_errors
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import lifted_model
from pisplit.regression.scaling import column_scales
from pisplit.splitting.base import Solver, SplitContext, SplitFit, Splitting, Stiffening, pair_moments

Array = NDArray[np.float64]

_E = TypeVar("_E", bound="Estimator")

#: Static solutions of the actuated system: x (N, n) and u (N, m).
Equilibria = tuple[ArrayLike, ArrayLike]

GRIDS = {"ridge": np.logspace(-10, 1, 12), "lasso": np.logspace(-6, -1, 6)}
#: A bound that takes more than 1 % off the spectral radius changes what the model says: fit warns.
NOTABLE = 1.01
#: Times that a splitting is made stiffer in search of a model that stays bounded.
STIFFER = 12


class Estimator(ABC):
    """Base of the estimators: a subclass names its options in ``__init__`` and says how K is fitted in ``_splitting``.

    After ``fit``: ``lifted`` (LiftedModel), ``K_`` (learned rows of the operator, physical units), ``theta_`` (the
    dictionary with the names of the data), ``fit_`` (SplitFit), ``alpha_``, ``cv_`` (None unless alpha="cv") and
    ``bounded_`` (None unless an excitation was given).
    """

    theta: Dictionary
    alpha: float | str
    penalty: str
    scale: str | None
    relative: bool | str
    alphas: Sequence[float] | None
    cv_states: str | Sequence[int] | Sequence[str] | None
    cv_tolerance: float
    max_radius: float | None

    lifted: LiftedModel
    theta_: Dictionary
    fit_: SplitFit
    K_: Array
    alpha_: float
    cv_: AlphaSearch | None
    bounded_: bool | None

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The options the estimator was made with (``deep`` is scikit-learn's, and changes nothing here)."""
        return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

    def set_params(self: _E, **params: Any) -> _E:
        """Change options, with the checks of the constructor; what was fitted stays until the next fit."""
        known = self.get_params()
        unknown = sorted(set(params) - set(known))
        if unknown:
            raise ValueError(f"{type(self).__name__} has no option {unknown[0]!r}; it has {', '.join(known)}")
        replacement = type(self)(**{**known, **params})
        for name in known:
            setattr(self, name, getattr(replacement, name))
        return self

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in self.get_params().items())})"

    def predict(self, history: Any, inputs: ArrayLike) -> Array:
        """States x_hat (T+1, n) under inputs (T, m), starting from the history.

        ``history``: x0 (n,) without delays; x_history (D+1, n), newest last, with state delays only; or the two arrays
        (x_history (D+1, n), u_history (D, m)). Warns if the roll-out diverged (states are then held).
        """
        model = self._fitted()
        states, past = _history(history, self.theta_)
        result = model.predict(states, past, finite_array(inputs, "U", (None, model.n_inputs)))
        if result.diverged:
            warnings.warn(
                f"the roll-out diverged at step {result.diverged_at}; states are held from there", stacklevel=2
            )
        return result.x

    def score(self, episodes: Episodes, states: str | Sequence[int] | Sequence[str] | None = None) -> RolloutErrors:
        """Errors of open-loop roll-outs of test episodes over the chosen states (output group, names or indices)."""
        return rollout_errors(self._fitted(), episodes, states)

    @abstractmethod
    def _splitting(self, context: SplitContext) -> Splitting:
        """The splitting that fits K."""

    @abstractmethod
    def _context(self, theta: Dictionary, scale: Array, dt: float, samples: PhaseSamples | None) -> SplitContext:
        """The options of this estimator as the splitting wants them."""

    def _dictionary(self, d1: Episodes) -> Dictionary:
        """The dictionary with the names of the data."""
        theta = self.theta.named_after(d1)
        if theta.is_bilinear:
            raise ValueError(f"{type(self).__name__} is linear in z; ob.Bilinear products belong to BilinearEDMDc")
        return theta

    def _fit(
        self,
        d1: Episodes,
        samples: PhaseSamples | None,
        pairs: Pairs | None,
        equilibria: Equilibria | None,
        simulated: Pairs | None = None,
        excitation: ArrayLike | None = None,
    ) -> None:
        if not isinstance(d1, Episodes):
            raise ValueError(f"d1 is a {type(d1).__name__}; expected Episodes")
        theta = self._dictionary(d1)
        chosen = d1.pairs(theta.n_delays) if pairs is None else _checked(pairs, d1, theta)
        rest = None if equilibria is None else _resting(equilibria, theta)
        held = hold_out(d1, chosen, theta.n_delays) if self.alpha == "cv" else None
        exciting = _exciting(excitation, theta, chosen, held, simulated)
        moments = pair_moments(theta, chosen, rest)
        scale = column_scales(moments.std[: theta.n_columns], theta.column_quantities, self.scale)
        context = self._context(theta, scale, d1.dt, samples)
        splitting = self._splitting(replace(context, equilibria=rest, known=(chosen, moments)))
        more = samples if simulated is None else simulated
        unlearned = np.zeros((len(theta.learned_columns), theta.n_columns))
        base = lifted_model(theta, unlearned, d1, chosen, {}, more)
        learning = base if held is None or held[0] is chosen else lifted_model(theta, unlearned, d1, held[0], {}, more)
        trial = Trial(theta, scale, chosen, base, held, learning, exciting)
        choice = self._stiffened(splitting, trial)
        if choice.bounded is False:
            warnings.warn(
                f"no model that was tried stays bounded under the excitation (states within {EXCURSION:g} times the "
                "data's range); give more data or a larger alpha",
                stacklevel=3,
            )
        fit, search = choice.fit, choice.search
        radius = float(fit.details.get("unbounded_radius", 0.0))
        if self.max_radius is not None and radius > NOTABLE * self.max_radius:
            warnings.warn(
                f"the data ask for a spectral radius of {radius:.4g}; max_radius = {self.max_radius:g} cuts it down",
                stacklevel=3,
            )
        provenance = {
            "estimator": type(self).__name__,
            "options": {k: v for k, v in self.get_params().items() if isinstance(v, str | int | float | None)},
            "alpha": choice.alpha,
            "dictionary": theta.fingerprint(),
            "pairs": len(chosen),
            "equilibria": 0 if rest is None else len(rest[0]),
            "bounded": choice.bounded,
            "details": dict(fit.details),
            "data": dict(d1.provenance or {}),
        }
        self.lifted = replace(trial.model(fit.K), provenance=provenance)
        self.theta_, self.fit_, self.K_ = theta, fit, fit.K
        self.alpha_, self.cv_, self.bounded_ = choice.alpha, search, choice.bounded

    def _stiffened(self, splitting: Splitting, trial: Trial) -> Choice:
        """The choice; where what rolls out best does not stay bounded, splittings that can be stiffer are tried too.

        They are made stiffer as long as nothing is bounded, or the bounded choice still gets better by it.
        """
        best = self._chosen(splitting, trial)
        last = best
        for _ in range(STIFFER):
            if not last.refused or not isinstance(splitting, Stiffening):
                break
            splitting = splitting.stiffer()
            last = self._chosen(splitting, trial)
            if last.rank < best.rank:
                best = last
            elif best.bounded:
                break
        return best

    def _chosen(self, splitting: Splitting, trial: Trial) -> Choice:
        """alpha, and the fit to all pairs."""
        solve = self._solver(splitting, trial, trial.pairs)
        search = self._search(splitting, solve, trial) if trial.held else None
        alpha = search.chosen if search else non_negative(self.alpha, "alpha")
        fit = solve(alpha)
        if search and trial.learning is trial.base:  # that is the model which was rolled out
            return Choice(fit, alpha, search, search.bounded)
        return Choice(fit, alpha, search, trial.bounds(fit.K) if trial.excitation else None)

    def _solver(self, splitting: Splitting, trial: Trial, pairs: Pairs) -> Solver:
        solve = splitting.solver(pairs)
        return cache(solve if self.max_radius is None else bounded(solve, trial.theta, trial.scale, self.max_radius))

    def _search(self, splitting: Splitting, solve: Solver, trial: Trial) -> AlphaSearch:
        """Fit on all but a few training episodes, roll these out, choose alpha by the median error."""
        assert trial.held is not None
        training, held, names = trial.held
        default = getattr(splitting, "alphas", GRIDS[self.penalty])
        grid = np.array(default if self.alphas is None else self.alphas, dtype=np.float64)
        if training is not trial.pairs:
            trial, solve = replace(trial, base=trial.learning), self._solver(splitting, trial, training)
        weights = state_weights(trial.theta, trial.pairs)
        errors = np.array([self._held_out_error(trial, solve(a).K, held, weights) for a in grid.tolist()])
        asked = None if trial.excitation is None else lambda alpha: trial.bounds(solve(alpha).K)
        return choose(grid, errors, self.cv_tolerance, names, asked)

    def _held_out_error(self, trial: Trial, k: Array, held: Episodes, weights: Array) -> float:
        """Median error of roll-outs of held-out episodes with the dynamics ``k``."""
        if not np.isfinite(k).all():
            return np.inf
        return rollout_errors(trial.model(k), held, self.cv_states, weights).median

    def _fitted(self) -> LiftedModel:
        if not hasattr(self, "lifted"):
            raise ValueError(f"{type(self).__name__} is not fitted; call fit first")
        return self.lifted


def _checked(pairs: Pairs, d1: Episodes, theta: Dictionary) -> Pairs:
    """``pairs`` of these episodes with the history that the dictionary needs."""
    if pairs.states.shape != d1.stacked_states().shape or pairs.inputs.shape != d1.stacked_inputs().shape:
        raise ValueError("pairs are not from these episodes; make them with d1.pairs(...)")
    if len(pairs) == 0 or int(pairs.index.min()) < theta.n_delays:
        raise ValueError(f"pairs need {theta.n_delays} steps of history; make them with d1.pairs({theta.n_delays})")
    return replace(pairs, n_delays=theta.n_delays)


def _resting(equilibria: Equilibria, theta: Dictionary) -> tuple[Array, Array]:
    """Equilibria x (N, n) and inputs u (N, m) of this system."""
    if not isinstance(equilibria, tuple | list) or len(equilibria) != 2:
        raise ValueError("equilibria are two arrays: (x (N, n), u (N, m)), states that rest under constant inputs")
    states = finite_array(equilibria[0], "x of equilibria", (None, theta.n_states))
    return states, finite_array(equilibria[1], "u of equilibria", (len(states), theta.n_inputs))


def _exciting(
    inputs: ArrayLike | None,
    theta: Dictionary,
    pairs: Pairs,
    held: tuple[Pairs, Episodes, tuple[int, ...]] | None,
    simulated: Pairs | None,
) -> Excitation | None:
    """The excitation, from states of all data that this fit may know."""
    if inputs is None:
        return None
    data = [pairs, *([held[1].pairs(theta.n_delays)] if held else []), *([simulated] if simulated is not None else [])]
    return Excitation.of(inputs, data, theta.names.quantities)


def _history(history: Any, theta: Dictionary) -> tuple[Array, Array | None]:
    if isinstance(history, tuple | list) and len(history) == 2 and np.ndim(history[0]) == 2:
        return np.asarray(history[0], dtype=np.float64), np.asarray(history[1], dtype=np.float64)
    states = np.asarray(history, dtype=np.float64)
    if theta.n_delays == 0:
        return states, None
    if theta.input_delays:
        raise ValueError(
            f"the dictionary delays inputs by {theta.input_delays}; give history as two arrays: "
            f"(x_history ({theta.n_delays + 1}, n), u_history ({theta.n_delays}, m))"
        )
    return states, np.zeros((theta.n_delays, theta.n_inputs))
