"""EDMDc on a few recorded pairs and on many trajectories of a physical twin, weighed on held-out roll-outs."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import check_same_step, positive
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import Equilibria, Estimator, check_options
from pisplit.regression.kept import Kept
from pisplit.regression.moments import Moments, stacked
from pisplit.regression.scaling import column_scales
from pisplit.splitting import SplitFit, pair_moments
from pisplit.threads import one_blas_thread

Array = NDArray[np.float64]

#: Default grid of alpha="cv": from the data alone to the twin alone.
WEIGHTS = tuple(np.logspace(-8, 4, 13).tolist())
#: Times that mu is made ten times larger in search of a model that stays bounded.
STIFFER = 12


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
    alphas, cv_states, cv_tolerance, cv_horizon, cv_folds, max_radius   as in LinearEDMDc

    After ``fit`` as :class:`pisplit.estimators.base.Estimator`.
    """

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
        cv_horizon: int | None = None,
        cv_folds: int | None = None,
    ) -> None:
        check_options(theta, alpha, scale, alphas, cv_tolerance, max_radius, cv_states, cv_horizon, cv_folds)
        positive(twin_alpha, "twin_alpha")
        self.theta = theta
        self.alpha = alpha
        self.twin_alpha = twin_alpha
        self.scale = scale
        self.omit = omit
        self.alphas = alphas
        self.cv_states = cv_states
        self.cv_tolerance = cv_tolerance
        self.cv_horizon = cv_horizon
        self.cv_folds = cv_folds
        self.max_radius = max_radius

    @one_blas_thread()
    def fit(
        self,
        d1: Episodes | Sequence[Episodes],
        twin: Episodes,
        pairs: Pairs | None = None,
        equilibria: Equilibria | None = None,
        excitation: ArrayLike | str | None = "auto",
    ) -> TwinEDMDc:
        """Fit to trajectories of the twin and to all pairs of the episodes d1, or to ``pairs`` drawn from them.

        ``twin`` has the states, inputs and dt of ``d1``; columns are matched by name. ``equilibria`` and ``excitation``
        as in LinearEDMDc; where the alpha that rolls out best does not stay bounded, larger mu are tried too
        (``twin_alpha_`` is the one that was taken). To fit the twin alone, give its episodes to LinearEDMDc or
        BilinearEDMDc.

        Raises ValueError for a ``twin`` that is no Episodes, and for columns or time steps that differ.
        """
        if not isinstance(twin, Episodes):
            raise ValueError(f"twin is a {type(twin).__name__}; expected Episodes simulated with the physical model")
        d1 = together(d1, "d1")
        d1 = d1 if pairs is not None else d1.arranged(*self.theta.wanted_names, owner="the dictionary")
        check_same_step(twin.dt, d1.dt, "the twin has", "d1")
        names = d1.state_names, d1.input_names, d1.units, d1.input_units
        twin = twin.arranged(*names, owner="d1")
        simulated = twin.pairs(self.theta.n_delays)
        problem = self._problem(d1, pairs, equilibria, excitation, simulated)
        fusion = Fusion(problem.theta, simulated, self.twin_alpha, self.scale, self.omit)
        best = last = self._choose(problem, fusion.fit, WEIGHTS)
        # Where what rolls out best is not bounded, mu grows until something is and the bounded choice is at its best.
        for _ in range(STIFFER):
            if not last.refused:
                break
            fusion = fusion.stiffer()
            last = self._choose(problem, fusion.fit, WEIGHTS)
            if last.rank < best.rank:
                best = last
            elif best.bounded:
                break
        self._keep(problem, best)
        self.twin_alpha_ = float(self.fit_.details["twin_alpha"])
        return self

    def _dictionary(self, d1: Episodes) -> Dictionary:
        return self.theta.named_after(d1)


class Fusion:
    """The regression of :class:`TwinEDMDc`, prepared for the pairs of a twin.

    Rows that stand for the recorded pairs, for the twin's and for the ridge are stacked with the roots of their weights
    and reduced by orthogonal transformations; nothing is squared.

    theta       dictionary with the names of the data
    twin        pairs of the twin
    twin_alpha, scale, omit  as in :class:`TwinEDMDc`
    """

    def __init__(
        self, theta: Dictionary, twin: Pairs, twin_alpha: float, scale: str | None, omit: Sequence[str]
    ) -> None:
        size = theta.n_columns
        moments = pair_moments(theta, twin)
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
        self._prepare()

    def fit(self, moments: Moments, alpha: float) -> SplitFit:
        """K from ``moments`` of recorded pairs, the twin's weighed by ``alpha``."""
        weight = np.sqrt(alpha)
        triangle, target = stacked(self._recorded(moments), (weight * self.prior[0], weight * self.prior[1]))
        k = scipy.linalg.solve_triangular(triangle, target).T
        if self.constant is not None:
            k[:, self.constant] -= k @ self.shift
        details = {"twin_alpha": self.twin_alpha}
        return SplitFit(K=k * self.own[:, None] / self.scale, alpha=alpha, rank=len(triangle), details=details)

    def stiffer(self) -> Fusion:
        """The same with ten times the ridge mu."""
        found = copy(self)
        found.twin_alpha, found.ridge = 10.0 * self.twin_alpha, np.sqrt(10.0) * self.ridge
        found._prepare()
        return found

    def _prepare(self) -> None:
        """Twin and ridge as a triangle; the ridge counts 1 + alpha times, once with the recorded rows."""
        self.prior = self._with_ridge(*self.twin)
        self._reduced: Kept[tuple[Array, Array]] = Kept()

    def _recorded(self, moments: Moments) -> tuple[Array, Array]:
        """The triangle of recorded rows and ridge, the same for every alpha of a search."""
        return self._reduced(moments, lambda: self._with_ridge(*self._means(moments)))

    def _with_ridge(self, a: Array, y: Array) -> tuple[Array, Array]:
        """Triangle (M, M) and its targets (M, r) for rows ``a``, ``y`` under the ridge."""
        return stacked((self.ridge, np.zeros((len(self.ridge), y.shape[1]))), (a, y))

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
