"""Physics-informed EDMDc: the known part from phase-space samples, the unknown part from trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import non_negative, one_of
from pisplit.data.columns import column_order
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.data.sums import together
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import GRIDS, Equilibria, Estimator, check_options
from pisplit.estimators.problem import Problem
from pisplit.generator import HALF_STEPS, KnownOptions
from pisplit.regression import check_penalty
from pisplit.regression.moments import Moments
from pisplit.splitting import Balanced, Lie, Rows, SplitContext, SplitFit, Splitting, Strang, TwoStage
from pisplit.splitting.options import check_names
from pisplit.splitting.rows import check_rows
from pisplit.threads import one_blas_thread


def _hold(context: SplitContext) -> Splitting[Any]:
    from pisplit.splitting.hold import (
        Hold,  # scipy.optimize, half of the import time of the package, is needed there alone
    )

    return Hold(context)


SPLITS: dict[str, Callable[[SplitContext], Splitting[Any]]] = {
    "strang": Strang,
    "lie": Lie,
    "balanced": Balanced,
    "hold": _hold,
}
TOWARD = ("zero", "identity", "physics")


class PIEDMDc(Estimator):
    """PI-EDMDc (paper, alg:pi-edmdc): K_f from the known f on D2, K_h from the pairs of D1, K = K_f K_h K_f.

    theta            dictionary
    alpha            weight of the penalty on K_h, or "cv": chosen on roll-outs of held-out training episodes
    penalty          "lasso" (paper; pulled-back residual) or "ridge" (composed residual, K_f is never inverted)
    toward           what the penalty pulls K_h to: "zero" (paper) or "identity", which leaves the known physics.
                     "physics" fits the split without a penalty, with h in ``rows`` only, and then all of K toward this
                     map, by ridge or by a sparse departure (LASSO): alpha = 0 is EDMDc, a large alpha the physical map,
                     and alpha="cv" tries both limits (:class:`pisplit.splitting.two_stage.TwoStage`; the hold split is
                     always fitted so)
    split            "strang" (paper), "lie", "balanced": Strang about the equilibrium under u
                     (:class:`pisplit.splitting.balanced.Balanced`), or "hold": both generators in one exponential
                     (:class:`pisplit.splitting.hold.Hold`)
    half_step        of Strang and Lie: "generator" (exponential of the generator), "first-order" (I + dt/2 L_f), "flow"
                     (EDMD on the flow of f) or "auto" (:func:`pisplit.generator.half_step`)
    rows             where K_h may differ from the identity: None everywhere; "inputs" in the input columns only; names
                     of states, columns or quantities, or a mask over learned columns: in these rows only (h is zero in
                     the others, which take K_f twice; paper, "Adjusting the full K_t"); {name: weight}: the same, with
                     weights on the penalty of rows where h is expected to be small
    scale, relative, solver, alphas, cv_states, cv_tolerance, cv_horizon, cv_folds, max_radius   as in LinearEDMDc;
                     ``relative`` is the unit of ``generator_alpha`` too
    generator_alpha  weight of the penalty in the regression that identifies the generator or the flow map
    options          further options of the splitting (balanced, hold: see there)
    generator_penalty  penalty of that regression: "ridge" or "lasso" (paper: a LASSO in every regression)
    known_rows       rows of the generator of f that are known exactly, {column: {column: coefficient}} in units of the
                     columns, per second: {"x": {"v": 1.0}} for x' = v (:class:`pisplit.generator.KnownOptions`)
    past             past of a phase sample, which has none: "absent" (delays take no part in K_f) or "equal" to its
                     present

    With an invertible K_f, alpha = 0 and rows = None it equals EDMDc: K_f cancels.

    The method as the paper prints it: penalty="lasso", relative="samples", alpha=0.01, generator_penalty="lasso",
    generator_alpha=0.01.

    A dictionary with ``ob.Bilinear`` products makes the Strang and Lie splits of a bilinear model: u_i psi moves with f
    as psi does, and rows="inputs" leaves B and N_i to learn, the form of a control-affine h.

    Raises ValueError for options that do not exist, and for those that would have no effect beside the others.
    """

    def __init__(
        self,
        theta: Dictionary,
        alpha: float | str = "cv",
        penalty: str = "lasso",
        toward: str = "zero",
        split: str = "strang",
        half_step: str = "auto",
        rows: Rows = None,
        scale: str | None = "quantity",
        relative: bool | str = True,
        alphas: Sequence[float] | None = None,
        cv_states: str | Sequence[int] | Sequence[str] | None = None,
        cv_tolerance: float = 0.0,
        generator_alpha: float = 0.0,
        options: Mapping[str, Any] | None = None,
        max_radius: float | None = None,
        solver: str = "auto",
        generator_penalty: str = "ridge",
        known_rows: Mapping[str, Mapping[str, float]] | None = None,
        past: str = "absent",
        cv_horizon: int | None = None,
        cv_folds: int | None = None,
    ) -> None:
        check_options(theta, alpha, scale, alphas, cv_tolerance, max_radius, cv_states, cv_horizon, cv_folds)
        self.theta = theta
        self.alpha = alpha
        self.penalty = penalty
        self.toward = toward
        self.split = split
        self.half_step = half_step
        self.rows = rows
        self.scale = scale
        self.relative = relative
        self.alphas = alphas
        self.cv_states = cv_states
        self.cv_tolerance = cv_tolerance
        self.cv_horizon = cv_horizon
        self.cv_folds = cv_folds
        self.max_radius = max_radius
        self.solver = solver
        self.generator_alpha = generator_alpha
        self.options = options
        self.generator_penalty = generator_penalty
        self.known_rows = known_rows
        self.past = past
        self._check_penalties()
        self._check_split()
        self._check_known()

    @one_blas_thread()
    def fit(
        self,
        d1: Episodes | Sequence[Episodes],
        d2: PhaseSamples,
        pairs: Pairs | None = None,
        equilibria: Equilibria | None = None,
        excitation: ArrayLike | str | None = "auto",
    ) -> PIEDMDc:
        """Fit to the phase samples d2 and to all pairs of the episodes d1, or to ``pairs`` drawn from them.

        ``equilibria``: x (N, n) and u (N, m) at which the actuated system rests, fixed points of the whole map; each
        counts as one pair, with the past equal to the present.
        ``excitation`` (E, T, m): input sequences that the model has to stay bounded under, for instance random ones of
        the kind it is made for. Nobody has to record what they do: alpha="cv" passes over models that take a state to
        three times the magnitude of its quantity in the data (:class:`pisplit.estimators.boundedness.Excitation`).
        "data": commands put together from the recorded ones (:func:`pisplit.estimators.commands.resampled_commands`);
        "auto": these for bilinear models, no test of linear ones; None: no test.
        """
        d1 = together(d1, "d1")
        d2 = _matched(d2, d1, self.theta)
        problem = self._problem(d1, pairs, equilibria, excitation, d2)
        split = self._splitting(problem, d2)
        k_f = split.known()  # alg:pi-edmdc, lines 1, 2: L_f = J(X2, U2) Theta(X2, U2)^+, K_f = exp(dt/2 L_f)

        def algorithm(moments: Moments, alpha: float) -> SplitFit:
            k_h = split.unknown(k_f, moments, alpha)  # line 3: min |K_h K_f Theta(X1, U1) - K_f^+ Theta(X1', U1)|
            return split.composed(k_f, k_h)  # line 4: K = K_f K_h K_f

        return self._keep(problem, self._choose(problem, algorithm, getattr(split, "alphas", GRIDS[self.penalty])))

    def _dictionary(self, d1: Episodes) -> Dictionary:
        if self.split in ("balanced", "hold"):
            return super()._dictionary(d1)
        return self.theta.named_after(d1)

    def _splitting(self, problem: Problem, d2: PhaseSamples) -> Splitting[Any]:
        """The splitting that was asked for, with the options of this estimator."""
        context = SplitContext(
            theta=problem.theta,
            scale=problem.scale,
            dt=problem.d1.dt,
            samples=d2,
            penalty=self.penalty,
            solver=self.solver if self.penalty == "lasso" else "auto",
            toward=self.toward,
            half_step=self.half_step,
            rows=self.rows,
            relative=self.relative,
            generator_alpha=self.generator_alpha,
            known=self._known_options(),
            options=self.options or {},
        )
        return TwoStage(context, SPLITS[self.split]) if self.toward == "physics" else SPLITS[self.split](context)

    def _known_options(self) -> KnownOptions:
        lasso = self.generator_penalty == "lasso"
        return KnownOptions(
            penalty=self.generator_penalty,
            solver=self.solver if lasso else "auto",
            relative=self.relative,
            rows=self.known_rows or {},
            past=self.past,
        )

    def _check_penalties(self) -> None:
        either = "lasso" if "lasso" in (self.penalty, self.generator_penalty) else self.penalty
        check_penalty(self.penalty, "auto", self.relative)
        check_penalty(either, self.solver, self.relative)
        non_negative(self.generator_alpha, "generator_alpha")
        if self.generator_penalty == "lasso" and self.generator_alpha == 0.0:
            raise ValueError("generator_penalty='lasso' with generator_alpha = 0 is no penalty; give generator_alpha")

    def _check_split(self) -> None:
        """Raise ValueError for options of the unknown part that the splitting does not have."""
        split, rows, options = one_of(self.split, "split", tuple(SPLITS)), self.rows, self.options or {}
        one_of(self.toward, "toward", TOWARD)
        if not isinstance(options, Mapping):
            raise ValueError(f"options is a {type(options).__name__}; expected a mapping from names to values")
        check_names(options, split)
        check_rows(rows)
        if self.toward == "physics" and split == "hold":
            raise ValueError("split='hold' is always fitted toward its physical map; leave toward out")
        if self.toward == "physics" and rows is None and split != "balanced":
            raise ValueError(
                "toward='physics' needs rows: where h acts in the physical map, for instance rows='inputs'"
            )
        if split in ("strang", "lie"):
            return
        if isinstance(rows, Mapping):
            raise ValueError(f"split={split!r} penalises loads, not rows; give rows without weights")
        if self.toward == "identity":
            raise ValueError(f"toward='identity' is of the kick of Strang and Lie, split={split!r} has none; leave it")
        if isinstance(rows, str) and (split == "balanced" or "equilibrium" in options):
            raise ValueError(f"rows={rows!r} has no effect about an equilibrium, where h depends on the deviation")
        if rows is not None and "ports" in options:
            raise ValueError("options['ports'] and rows both say where h acts; give one of them")

    def _check_known(self) -> None:
        """Raise ValueError for options of the known part that do not exist, or have no effect."""
        one_of(self.half_step, "half_step", HALF_STEPS)
        if self.split in ("balanced", "hold"):
            for name, value, default in (("half_step", self.half_step, "auto"), ("past", self.past, "absent")):
                if value != default:
                    raise ValueError(f"{name}={value!r} is of Strang and Lie; split={self.split!r} exponentiates L_f")
        if self.half_step == "flow" and self.known_rows:
            raise ValueError("known_rows are rows of the generator, half_step='flow' has none; leave one of them out")
        if self._known_options().past == "equal" and self.theta.n_delays == 0:
            raise ValueError("past='equal' without delays in the dictionary; leave it out, or add ob.Delays")


def _matched(d2: PhaseSamples, d1: Episodes, theta: Dictionary) -> PhaseSamples:
    """The phase samples with their columns in the order of the trajectories, found by name.

    Raises ValueError, in one line, for other sizes or names.
    """
    if not isinstance(d2, PhaseSamples):
        raise ValueError(f"d2 is a {type(d2).__name__}; expected PhaseSamples of the known vector field")
    if (d2.n_states, d2.n_inputs) != (d1.n_states, d1.n_inputs):
        raise ValueError(
            f"d2 has {d2.n_states} states and {d2.n_inputs} inputs, d1 {d1.n_states} and {d1.n_inputs}; "
            "give samples of the same system"
        )
    named = theta.wanted_names
    states = column_order(d2.state_names, named[0] or d1.state_names, "states", "d2", "d1")
    inputs = column_order(d2.input_names, named[1] or d1.input_names, "inputs", "d2", "d1")
    if (np.diff(states) > 0).all() and (np.diff(inputs) > 0).all():
        return d2
    return replace(
        d2,
        x=d2.x[:, states],
        u=d2.u[:, inputs],
        xdot=d2.xdot[:, states],
        x_half=None if d2.x_half is None else d2.x_half[:, states],
        state_names=None if d2.state_names is None else [d2.state_names[i] for i in states],
        input_names=None if d2.input_names is None else [d2.input_names[i] for i in inputs],
    )
