"""Extended dynamic mode decomposition with control by one regression, linear in the lifted state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from numpy.typing import ArrayLike

from pisplit.checks import count, one_of
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import GRIDS, Equilibria, Estimator, check_options
from pisplit.regression import check_penalty
from pisplit.splitting import Direct, SplitContext
from pisplit.threads import one_blas_thread

#: What the penalty pulls K to.
TOWARD = ("zero", "identity")

_D = TypeVar("_D", bound="DirectEDMDc")


class DirectEDMDc(Estimator):
    """K = argmin |K Theta(X, U) - psi(X')|^2 + alpha |K - prior| (paper, eq. discrete-time-koop), from pairs alone.

    theta      dictionary
    alpha      weight of the penalty, or "cv": chosen on roll-outs of held-out training episodes
    penalty    "ridge" (squared Frobenius norm) or "lasso"
    scale      column scales: "quantity", "column" or None
    relative   what alpha is relative to: True = the data (the mean diagonal of the Gram matrix for ridge, the smallest
               alpha with an all-zero answer for LASSO), "samples" = the number of pairs (the paper's 0.01 N), False =
               nothing
    solver     of a LASSO: "auto", "active-set" or "cvxpy" (:func:`pisplit.regression.lasso`)
    alphas     grid for alpha="cv"
    cv_states  states (output group, names or indices) whose roll-out error chooses alpha; default all
    cv_tolerance  alpha="cv" takes the largest alpha whose error is within this fraction of the smallest. A few tenths
               make models for control, where margins count more than the last percent of a roll-out (in the spirit of
               the one-standard-error rule, Breiman et al., Classification and Regression Trees, 1984)
    max_radius  bound on the spectral radius of A (the constant apart), that of the undriven model if it is bilinear:
               modes outside move onto the circle, others and delays stay
               (:func:`pisplit.estimators.boundedness.limited_rows`)
    cv_horizon  steps of the roll-outs that choose alpha; None: to the end of recordings. Give a few steps, as many as a
               controller looks ahead, where the plant is unstable: small errors grow there whatever the model
    cv_folds   number of folds (:func:`pisplit.estimators.folds.make_folds`). None: fewer than ten recordings are held
               out in turn (with ``cv_horizon`` each half of them), more in five folds, one recording in five stretches
               of time; where four or more recordings hold no pair, these alone. 1: held out once, the cheapest
    instruments  number of earlier samples that serve as instrumental variables: noise on the states then no longer
               pulls eigenvalues toward zero; 0 is ordinary least squares, 3 a good number where states are noisy
               (:func:`pisplit.estimators.instruments.instrumented_moments` says when it helps)
    toward     what the penalty pulls K to: "zero", or "identity", "nothing moves": every learned column stays as it is.
               The step of a slow system is close to it whatever the data say
    """

    def __init__(
        self,
        theta: Dictionary,
        alpha: float | str = 0.0,
        penalty: str = "ridge",
        scale: str | None = "quantity",
        relative: bool | str = True,
        alphas: Sequence[float] | None = None,
        cv_states: str | Sequence[int] | Sequence[str] | None = None,
        cv_tolerance: float = 0.0,
        max_radius: float | None = None,
        solver: str = "auto",
        instruments: int = 0,
        cv_horizon: int | None = None,
        cv_folds: int | None = None,
        toward: str = "zero",
    ) -> None:
        check_options(theta, alpha, scale, alphas, cv_tolerance, max_radius, cv_states, cv_horizon, cv_folds)
        check_penalty(penalty, solver, relative)
        count(instruments, "instruments", minimum=0)
        one_of(toward, "toward", TOWARD)
        self.theta = theta
        self.alpha = alpha
        self.penalty = penalty
        self.scale = scale
        self.relative = relative
        self.alphas = alphas
        self.cv_states = cv_states
        self.cv_tolerance = cv_tolerance
        self.cv_horizon = cv_horizon
        self.cv_folds = cv_folds
        self.max_radius = max_radius
        self.solver = solver
        self.instruments = instruments
        self.toward = toward

    @one_blas_thread()
    def fit(
        self: _D,
        d1: Episodes | Sequence[Episodes],
        pairs: Pairs | None = None,
        equilibria: Equilibria | None = None,
        excitation: ArrayLike | str | None = "auto",
    ) -> _D:
        """Fit to all pairs of the episodes ``d1``, or to ``pairs`` drawn from them. Returns itself.

        ``equilibria``: x (N, n) and u (N, m) at which the actuated system rests, fixed points of the whole map; each
        counts as one pair, with the past equal to the present.
        ``excitation`` (E, T, m): input sequences that the model has to stay bounded under, for instance random ones of
        the kind it is made for. Nobody has to record what they do: alpha="cv" passes over models that take a state to
        three times the magnitude of its quantity in the data (:class:`pisplit.estimators.boundedness.Excitation`).
        "data": commands put together from the recorded ones (:func:`pisplit.estimators.commands.resampled_commands`);
        "auto": these for bilinear models, no test of linear ones; None: no test.
        """
        d1 = together(d1, "d1")
        problem = self._problem(d1, pairs, equilibria, excitation)
        context = SplitContext(
            theta=problem.theta,
            scale=problem.scale,
            dt=d1.dt,
            penalty=self.penalty,
            solver=self.solver,
            relative=self.relative,
            toward=self.toward,
        )
        return self._keep(problem, self._choose(problem, Direct(context).fit, GRIDS[self.penalty]))


class LinearEDMDc(DirectEDMDc):
    """L-EDMDc: z+ = A z + B phi(u) with Theta = [Theta_x; u] (paper, eq. l_edmdc_dict), by :class:`DirectEDMDc`.

    Korda and Mezic, Automatica 93, 2018. Inputs stay linear; with u out of Theta_x it is the block form of the paper,
    eq. hilbert_split. Options: :class:`DirectEDMDc`.
    """
