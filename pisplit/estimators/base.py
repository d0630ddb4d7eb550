"""What all EDMDc estimators share: options, fit, the choice of alpha on held-out roll-outs, prediction, scores."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array, non_negative, one_of, positive
from pisplit.data.columns import in_order
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.noise import noise_margins
from pisplit.data.phase import PhaseSamples
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.alpha_search import AlphaSearch, Choice, Fit, fit_at, fit_with_search
from pisplit.estimators.boundedness import EXCURSION, Excitation, limited
from pisplit.estimators.commands import excitation_inputs
from pisplit.estimators.folds import Fold, fold_moments, make_folds
from pisplit.estimators.instruments import instrumented_moments
from pisplit.estimators.parameters import Parameters
from pisplit.estimators.problem import HeldOut, Problem
from pisplit.evaluation.rollouts import RolloutErrors, rollout_errors
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import lifted_model
from pisplit.regression.moments import Moments
from pisplit.regression.scaling import SCALINGS, column_scales
from pisplit.splitting import SplitFit, pair_moments

Array = NDArray[np.float64]

_E = TypeVar("_E", bound="Estimator")

#: Static solutions of the actuated system: x (N, n) and u (N, m).
Equilibria = tuple[ArrayLike, ArrayLike]

#: Grids of alpha="cv", relative.
GRIDS = {"ridge": tuple(np.logspace(-10, 3, 14).tolist()), "lasso": tuple(np.logspace(-6, -1, 6).tolist())}
#: A bound that takes more than 1 % off the spectral radius changes what the model says: fit warns.
NOTABLE = 1.01


class Estimator(Parameters):
    """Base of the estimators: a subclass names its options in ``__init__`` and says in ``fit`` how K is fitted.

    After ``fit``: ``lifted`` (LiftedModel), ``K_`` (learned rows of the operator, physical units), ``theta_`` (the
    dictionary with the names of the data), ``fit_`` (SplitFit), ``alpha_``, ``cv_`` (None unless alpha="cv") and
    ``bounded_`` (None where boundedness was not tested).
    """

    theta: Dictionary
    alpha: float | str
    scale: str | None
    alphas: Sequence[float] | None
    cv_states: str | Sequence[int] | Sequence[str] | None
    cv_tolerance: float
    cv_horizon: int | None
    cv_folds: int | None
    max_radius: float | None
    instruments: int = 0

    lifted: LiftedModel
    theta_: Dictionary
    fit_: SplitFit
    K_: Array
    alpha_: float
    cv_: AlphaSearch | None
    bounded_: bool | None

    @property
    def n_delays(self) -> int:
        """Steps of history D that a prediction starts from."""
        return self.theta.n_delays

    def predict(self, history: Any, inputs: ArrayLike) -> Array:
        """States x_hat (T+1, n) under inputs (T, m), starting from the history.

        ``history``: x0 (n,) without delays; x_history (D+1, n), newest last, with state delays only; or the two arrays
        (x_history (D+1, n), u_history (D, m)). Warns if the roll-out diverged (states are then held).
        """
        model = self._fitted()
        states, past = _history(history, self.theta_)
        result = model.predict(states, past, inputs)
        if result.diverged:
            warnings.warn(
                f"the roll-out diverged at step {result.diverged_at}; states are held from there", stacklevel=2
            )
        return result.x

    def score(self, episodes: Episodes, states: str | Sequence[int] | Sequence[str] | None = None) -> RolloutErrors:
        """Errors of open-loop roll-outs of test episodes over the chosen states (output group, names or indices).

        They are no single number: searches of scikit-learn want ``scoring=RolloutScore(...)``. Several recordings in a
        list are one.
        """
        return rollout_errors(self._fitted(), together(episodes, "episodes"), states)

    def _dictionary(self, d1: Episodes) -> Dictionary:
        """The dictionary with the names of the data."""
        theta = self.theta.named_after(d1)
        if theta.is_bilinear:
            raise ValueError(f"{type(self).__name__} is linear in z; ob.Bilinear products belong to BilinearEDMDc")
        return theta

    def _problem(
        self,
        d1: Episodes,
        pairs: Pairs | None,
        equilibria: Equilibria | None,
        excitation: ArrayLike | str | None,
        more: PhaseSamples | Pairs | None = None,
    ) -> Problem:
        """The data of a fit, checked; ``more`` are phase samples or pairs of a twin that a read-out may learn from."""
        if pairs is None:
            d1 = d1.arranged(*self.theta.wanted_names, owner="the dictionary")
        theta = self._dictionary(d1)
        chosen = d1.pairs(theta.n_delays) if pairs is None else d1.checked_pairs(pairs, theta.n_delays)
        rest = None if equilibria is None else _resting(equilibria, theta)
        start = max(theta.n_delays, 0 if pairs is None else pairs.n_delays)
        folds: tuple[Fold, ...] = ()
        if self.alpha == "cv":
            folds = make_folds(d1, chosen, theta.n_delays, start, self.cv_horizon, self.cv_folds)
        moments = self._moments(theta, chosen, rest)
        unlearned = np.zeros((len(theta.learned_columns), theta.n_columns))

        def base(pairs: Pairs) -> LiftedModel:
            return lifted_model(theta, unlearned, d1, pairs, {}, more)

        margins = noise_margins(d1)
        whole = base(chosen)
        learned = self._fold_moments(theta, folds, chosen, moments, rest)
        bases = [whole if fold.training is chosen else base(fold.training) for fold in folds]
        return Problem(
            d1=d1,
            theta=theta,
            pairs=chosen,
            n_equilibria=0 if rest is None else len(rest[0]),
            moments=moments,
            scale=column_scales(moments.std[: theta.n_columns], theta.column_quantities, self.scale, margins),
            margins=margins,
            base=whole,
            held=tuple(map(HeldOut, folds, learned, bases)),
            excitation=self._exciting(excitation, theta, d1, chosen, more if isinstance(more, Pairs) else None),
        )

    def _fold_moments(
        self, theta: Dictionary, folds: Sequence[Fold], pairs: Pairs, whole: Moments, rest: tuple[Array, Array] | None
    ) -> list[Moments]:
        """Moments of the training pairs of every fold."""
        if not folds:
            return []
        if self.instruments:
            return [whole if f.training is pairs else self._moments(theta, f.training, rest) for f in folds]
        resting = None if rest is None else pair_moments(theta, pairs.take(np.zeros(len(pairs), dtype=bool)), rest)
        return fold_moments(folds, pairs, whole, lambda part: pair_moments(theta, part), resting)

    def _exciting(
        self, inputs: ArrayLike | str | None, theta: Dictionary, d1: Episodes, pairs: Pairs, simulated: Pairs | None
    ) -> Excitation | None:
        """The excitation, from states of ``pairs``, or of all of ``d1`` where that gives the inputs or alpha."""
        found = excitation_inputs(inputs, theta.is_bilinear, d1, self.cv_horizon)
        if found is None:
            return None
        known = d1.pairs(theta.n_delays) if self.alpha == "cv" or found is not inputs else pairs
        return Excitation.of(found, [known, *([simulated] if simulated is not None else [])], theta.names.quantities)

    def _moments(self, theta: Dictionary, pairs: Pairs, rest: tuple[Array, Array] | None) -> Moments:
        if self.instruments:
            return instrumented_moments(theta, pairs, self.instruments, rest)
        return pair_moments(theta, pairs, rest)

    def _choose(self, problem: Problem, fit: Fit, default: Sequence[float]) -> Choice:
        """``fit`` with the alpha that was given, or that of the grid (``default`` where none was) that is best."""

        def within(moments: Moments, alpha: float) -> SplitFit:
            found = fit(moments, alpha)
            return found if self.max_radius is None else limited(found, problem.theta, problem.scale, self.max_radius)

        if not problem.held:
            return fit_at(problem, within, float(self.alpha))
        grid = default if self.alphas is None else self.alphas
        return fit_with_search(problem, within, grid, self.cv_states, self.cv_tolerance)

    def _keep(self: _E, problem: Problem, choice: Choice) -> _E:
        """Make the model of the choice, with its provenance; warn of what it says against itself. Returns itself."""
        fit = choice.fit
        if choice.bounded is False:
            which = "the model does not stay" if choice.search is None else "no model that was tried stays"
            warnings.warn(
                f"{which} bounded under the excitation (states within {EXCURSION:g} times the data's range); give more "
                "data or a larger alpha, or excitation=None if the plant is unstable",
                stacklevel=3,
            )
        for reason in choice.search.reasons if choice.search else ():
            warnings.warn(reason, stacklevel=3)
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
            "dictionary": problem.theta.fingerprint(),
            "pairs": len(problem.pairs),
            "equilibria": problem.n_equilibria,
            "bounded": choice.bounded,
            "choice": None if choice.search is None else choice.search.facts(),
            "details": dict(fit.details),
            "data": dict(problem.d1.provenance or {}),
        }
        made = problem.model(fit.K)
        self.lifted = replace(made, provenance={**made.provenance, **provenance})
        self.theta_, self.fit_, self.K_ = problem.theta, fit, fit.K
        self.alpha_, self.cv_, self.bounded_ = choice.alpha, choice.search, choice.bounded
        return self

    def _fitted(self) -> LiftedModel:
        if not hasattr(self, "lifted"):
            raise ValueError(f"{type(self).__name__} is not fitted; call fit first")
        return self.lifted


def check_options(
    theta: Any,
    alpha: Any,
    scale: Any,
    alphas: Any,
    cv_tolerance: Any,
    max_radius: Any,
    cv_states: Any = None,
    cv_horizon: Any = None,
    cv_folds: Any = None,
) -> None:
    """Raise ValueError for options that every estimator has and that can be nothing of their kind, in one line.

    ``theta`` is a Dictionary, ``alpha`` a number of at least zero or "cv", ``scale`` "quantity", "column" or None,
    ``alphas`` numbers of at least zero or None, ``cv_tolerance`` a number of at least zero, ``max_radius`` a positive
    number or None, ``cv_states`` a name, names, positions or None, ``cv_horizon`` and ``cv_folds`` whole numbers of at
    least one, or None.
    """
    if not isinstance(theta, Dictionary):
        raise ValueError(f"theta is a {type(theta).__name__}; expected a Dictionary")
    if isinstance(alpha, str | bool) or alpha is None:
        if alpha != "cv":
            raise ValueError(f"alpha = {alpha!r}; expected a number of at least zero, or 'cv'")
    else:
        non_negative(alpha, "alpha")
    if scale is not None:
        one_of(scale, "scale", SCALINGS)
    if alphas is not None:
        if isinstance(alphas, str) or not np.iterable(alphas) or not len(list(alphas)):
            raise ValueError(f"alphas = {alphas!r}; expected numbers to choose alpha from, at least one")
        for i, value in enumerate(alphas):
            non_negative(value, f"alphas[{i}]")
    non_negative(cv_tolerance, "cv_tolerance")
    if max_radius is not None:
        positive(max_radius, "max_radius")
    if not (cv_states is None or isinstance(cv_states, str) or np.iterable(cv_states)):
        raise ValueError(f"cv_states = {cv_states!r}; expected an output group, names or positions of states")
    for value, name in ((cv_horizon, "cv_horizon"), (cv_folds, "cv_folds")):
        if value is not None:
            count(value, name)


def _resting(equilibria: Equilibria, theta: Dictionary) -> tuple[Array, Array]:
    """Equilibria x (N, n) and inputs u (N, m) of this system."""
    if not isinstance(equilibria, tuple | list) or len(equilibria) != 2:
        raise ValueError("equilibria are two arrays: (x (N, n), u (N, m)), states that rest under constant inputs")
    names = theta.names
    x, u = in_order(equilibria[0], names.states, "states"), in_order(equilibria[1], names.inputs, "inputs")
    states = finite_array(x, "x of equilibria", (None, theta.n_states))
    return states, finite_array(u, "u of equilibria", (len(states), theta.n_inputs))


def _history(history: Any, theta: Dictionary) -> tuple[ArrayLike, ArrayLike | None]:
    if isinstance(history, tuple | list) and len(history) == 2 and np.ndim(history[0]) == 2:
        return history[0], history[1]
    if theta.n_delays == 0:
        return history, None
    if theta.input_delays:
        raise ValueError(
            f"the dictionary delays inputs by {theta.input_delays}; give history as two arrays: "
            f"(x_history ({theta.n_delays + 1}, n), u_history ({theta.n_delays}, m))"
        )
    return history, np.zeros((theta.n_delays, theta.n_inputs))
