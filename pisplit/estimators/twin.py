"""EDMDc on a few recorded pairs and on many trajectories of a physical twin, weighed on held-out roll-outs."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import non_negative, positive
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import Equilibria, Estimator
from pisplit.regression.moments import Moments
from pisplit.regression.scaling import column_scales
from pisplit.splitting.base import Solver, SplitContext, SplitFit, Splitting, pair_moments

Array = NDArray[np.float64]


class TwinEDMDc(Estimator):
    """PI-EDMDc whose known part is simulated: a twin (the known f with an identified h) makes trajectories D2.

        K = argmin 1/N_1 sum_D1 |K Theta - psi'|^2 + alpha/N_2 sum_D2 |K Theta - psi'|^2 + (1 + alpha) mu |K|^2

    in scaled columns: EDMDc on the recorded pairs D1 where alpha is small, on the twin's where it is large. The twin
    moves f and h together, so nothing is split and no K_f is inverted; what the twin gets wrong, data repair in the
    directions that they show. Unlike a ridge toward the twin's operator, departures cost what they change on the
    twin's trajectories: combinations of columns that never occur carry no prior.

    theta         dictionary; with :class:`pisplit.observables.Bilinear` the model is bilinear
    alpha         weight of the twin, or "cv": chosen on roll-outs of held-out training episodes
    twin_alpha    mu, relative to the mean variance of the twin's columns; the constant carries no penalty
    scale         column scales by the spread of the twin's data: "quantity", "column" or None
    omit          names or quantities of columns that predict nothing (they are predicted): digits that no twin gets
                  right and no sensor reads, such as the axial strain of a backbone that hardly stretches, tell a model
                  of the twin everything
    alphas, cv_states, cv_tolerance, max_radius   as in LinearEDMDc

    After ``fit`` as :class:`pisplit.estimators.base.Estimator`.
    """

    penalty = "ridge"
    twin_alpha_: float

    def __init__(
        self,
        theta: Dictionary,
        alpha: float | str = "cv",
        twin_alpha: float = 1e-7,
        scale: str | None = "quantity",
        omit: Sequence[str] = (),
        alphas: Sequence[float] | None = None,
        cv_states: str | Sequence[int] | Sequence[str] | None = None,
        cv_tolerance: float = 0.0,
        max_radius: float | None = None,
    ) -> None:
        positive(twin_alpha, "twin_alpha")
        non_negative(cv_tolerance, "cv_tolerance")
        if max_radius is not None:
            positive(max_radius, "max_radius")
        self.theta = theta
        self.alpha = alpha
        self.twin_alpha = twin_alpha
        self.scale = scale
        self.omit = omit
        self.alphas = alphas
        self.cv_states = cv_states
        self.cv_tolerance = cv_tolerance
        self.max_radius = max_radius

    def fit(
        self,
        d1: Episodes,
        twin: Episodes,
        pairs: Pairs | None = None,
        equilibria: Equilibria | None = None,
        excitation: ArrayLike | None = None,
    ) -> TwinEDMDc:
        """Fit to trajectories of the twin and to all pairs of the episodes d1, or to ``pairs`` drawn from them.

        ``twin`` has the states, inputs and dt of ``d1``. ``equilibria`` and ``excitation`` as in LinearEDMDc; where the
        alpha that rolls out best does not stay bounded, larger mu are tried too (``twin_alpha_`` is the one that was
        taken). To fit the twin alone, give its episodes to LinearEDMDc or BilinearEDMDc.
        """
        if not isinstance(twin, Episodes):
            raise ValueError(f"twin is a {type(twin).__name__}; expected Episodes simulated with the physical model")
        if isinstance(d1, Episodes):
            _check_alike(d1, twin)
        self._twin = twin.pairs(self.theta.n_delays)
        try:
            self._fit(d1, None, pairs, equilibria, self._twin, excitation)
        finally:
            del self._twin  # a fitted model keeps none of its data
        self.twin_alpha_ = float(self.fit_.details["twin_alpha"])
        return self

    def _dictionary(self, d1: Episodes) -> Dictionary:
        return self.theta.named_after(d1)

    def _splitting(self, context: SplitContext) -> Splitting:
        return Fusion(context, self._twin, self.twin_alpha, self.scale, self.omit)

    def _context(self, theta: Dictionary, scale: Array, dt: float, samples: PhaseSamples | None) -> SplitContext:
        return SplitContext(
            theta=theta,
            scale=scale,
            dt=dt,
            samples=None,
            penalty="ridge",
            toward="zero",
            half_step="auto",
            rows=None,
            relative=True,
            generator_alpha=0.0,
        )


class Fusion:
    """The regression of :class:`TwinEDMDc`, prepared for the pairs of a twin.

    Rows that stand for the recorded pairs, for the twin's and for the ridge are stacked with the roots of their weights
    and reduced by orthogonal transformations; nothing is squared.
    """

    #: Default grid of alpha="cv": from the data alone to the twin alone.
    alphas = tuple(np.logspace(-8, 4, 13).tolist())

    def __init__(
        self, context: SplitContext, twin: Pairs, twin_alpha: float, scale: str | None, omit: Sequence[str]
    ) -> None:
        theta, size = context.theta, context.theta.n_columns
        moments = pair_moments(theta, twin)
        self.context = context
        self.scale = column_scales(moments.std[:size], theta.column_quantities, scale)
        self.omitted = _omitted(theta, omit)
        self.own = self.scale[theta.learned_columns]
        self.constant = theta.constant_column
        self.shift = moments.mean[:size] / self.scale
        if self.constant is None:
            self.shift[:] = 0.0
        else:
            self.shift[self.constant] = 0.0
        self.twin = self._means(moments)
        variance = float(np.mean((moments.std[:size] / self.scale)[~self.omitted] ** 2))
        self.twin_alpha = twin_alpha
        self.ridge = np.sqrt(twin_alpha * (variance or 1.0)) * np.eye(size)
        if self.constant is not None:
            self.ridge[self.constant] = 0.0

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        a, y = self._means(self.context.moments(pairs))
        a_twin, y_twin = self.twin
        nothing = np.zeros((len(self.ridge), y.shape[1]))

        def solve(alpha: float) -> SplitFit:
            weight, ridge = np.sqrt(alpha), np.sqrt(1.0 + alpha)
            rows = np.vstack([a, weight * a_twin, ridge * self.ridge])
            q, triangle = scipy.linalg.qr(rows, mode="economic")
            target = q.T @ np.vstack([y, weight * y_twin, nothing])
            k = scipy.linalg.solve_triangular(triangle, target).T
            if self.constant is not None:
                k[:, self.constant] -= k @ self.shift
            details = {"twin_alpha": self.twin_alpha}
            return SplitFit(K=k * self.own[:, None] / self.scale, alpha=alpha, rank=len(triangle), details=details)

        return solve

    def stiffer(self) -> Fusion:
        """The same with ten times the ridge mu."""
        found = copy(self)
        found.twin_alpha, found.ridge = 10.0 * self.twin_alpha, np.sqrt(10.0) * self.ridge
        return found

    def _means(self, moments: Moments) -> tuple[Array, Array]:
        """Rows of scaled columns about the twin's mean, and of their successors, whose squares are means of samples."""
        size = len(self.scale)
        rows = moments.scaled(np.concatenate([self.scale, self.own])).rows(centred=False) / np.sqrt(moments.n_samples)
        a = rows[:, :size].copy()
        if self.constant is not None:
            a -= np.outer(a[:, self.constant], self.shift)
        a[:, self.omitted] = 0.0
        return a, rows[:, size:]


def _omitted(theta: Dictionary, omit: Sequence[str]) -> NDArray[np.bool_]:
    """Whether each column (M,) is of a quantity in ``omit``, or has a name there."""
    unknown = sorted(set(omit) - set(theta.column_quantities) - set(theta.column_names))
    if unknown:
        raise ValueError(f"omit names {unknown[:3]}; expected names or quantities of columns")
    labels = zip(theta.column_names, theta.column_quantities, strict=True)
    return np.array([name in omit or quantity in omit for name, quantity in labels], dtype=bool)


def _check_alike(d1: Episodes, twin: Episodes) -> None:
    if not np.isclose(d1.dt, twin.dt, rtol=1e-9):
        raise ValueError(f"d1 has dt = {d1.dt:g} s, the twin {twin.dt:g} s; simulate the twin with the dt of d1")
    for what, given, wanted in (
        ("states", twin.state_names, d1.state_names),
        ("inputs", twin.input_names, d1.input_names),
    ):
        if given != wanted:
            raise ValueError(
                f"the twin names its {what} {list(given or ())[:4]}, d1 {list(wanted or ())[:4]}; expected the same"
            )
