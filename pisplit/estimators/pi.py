"""Physics-informed EDMDc: the known part from phase-space samples, the unknown part from trajectories."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import non_negative, one_of, positive
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.base import Equilibria, Estimator
from pisplit.generator.generator import HALF_STEPS
from pisplit.regression import check_penalty
from pisplit.splitting.balanced import Balanced
from pisplit.splitting.base import Lie, Rows, SplitContext, Splitting, Strang
from pisplit.splitting.two_stage import TwoStage

Array = NDArray[np.float64]


def _hold(context: SplitContext) -> Splitting:
    from pisplit.splitting.hold import (
        Hold,  # scipy.optimize, half of the import time of the package, is needed there alone
    )

    return Hold(context)


SPLITS: dict[str, Callable[[SplitContext], Splitting]] = {
    "strang": Strang,
    "lie": Lie,
    "balanced": Balanced,
    "hold": _hold,
}
TOWARD = ("zero", "identity", "physics")


class PIEDMDc(Estimator):
    """PI-EDMDc (paper, Algorithm 1): K_f from the known f on D2, K_h from the pairs of D1, K = K_f K_h K_f.

    theta            dictionary
    alpha            weight of the penalty on K_h, or "cv": chosen on roll-outs of held-out training episodes
    penalty          "lasso" (paper; pulled-back residual) or "ridge" (composed residual, K_f is never inverted)
    toward           what the penalty pulls K_h to: "zero" (paper) or "identity", which leaves the known physics.
                     "physics" fits the split without a penalty, with h in ``rows`` only, and then all of K toward this
                     map: alpha = 0 is EDMDc, a large alpha the physical map, and alpha="cv" tries both limits
                     (:class:`pisplit.splitting.two_stage.TwoStage`; the hold split is always fitted so)
    split            "strang" (paper), "lie", "balanced": Strang about the equilibrium under u
                     (:class:`pisplit.splitting.balanced.Balanced`), or "hold": both generators in one exponential
                     (:class:`pisplit.splitting.hold.Hold`)
    half_step        "generator" (exponential of the generator), "flow" (EDMD on the flow of f) or "auto"
    rows             where K_h may differ from the identity: None everywhere; "inputs" in the input columns only; names
                     of states, columns or quantities, or a mask over learned columns: in these rows only (h is zero in
                     the others, which take K_f twice); {name: weight}: the same, with weights on the penalty of rows
                     where h is expected to be small
    scale, relative, solver, alphas, cv_states, cv_tolerance, max_radius   as in LinearEDMDc
    generator_alpha  ridge of the regression that identifies the generator or flow map, relative to its Gram diagonal
    options          further options of the splitting (balanced, hold: see there)

    With an invertible K_f, alpha = 0 and rows = None it equals EDMDc: K_f cancels.

    A dictionary with ``ob.Bilinear`` products makes the Strang and Lie splits of a bilinear model: u_i psi moves with f
    as psi does, and rows="inputs" leaves B and N_i to learn, the form of a control-affine h.
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
    ) -> None:
        check_penalty(penalty, solver, relative)
        one_of(toward, "toward", TOWARD)
        one_of(split, "split", tuple(SPLITS))
        if isinstance(rows, Mapping) and split in ("balanced", "hold"):
            raise ValueError(f"split={split!r} penalises loads, not rows; give rows without weights")
        if toward == "physics" and split == "hold":
            raise ValueError("split='hold' is always fitted toward its physical map; leave toward out")
        if toward == "physics" and rows is None and split != "balanced":
            raise ValueError(
                "toward='physics' needs rows: where h acts in the physical map, for instance rows='inputs'"
            )
        one_of(half_step, "half_step", HALF_STEPS)
        non_negative(cv_tolerance, "cv_tolerance")
        if max_radius is not None:
            positive(max_radius, "max_radius")
        non_negative(generator_alpha, "generator_alpha")
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
        self.max_radius = max_radius
        self.solver = solver
        self.generator_alpha = generator_alpha
        self.options = options

    def fit(
        self,
        d1: Episodes,
        d2: PhaseSamples,
        pairs: Pairs | None = None,
        equilibria: Equilibria | None = None,
        excitation: ArrayLike | None = None,
    ) -> PIEDMDc:
        """Fit to the phase samples d2 and to all pairs of the episodes d1, or to ``pairs`` drawn from them.

        ``equilibria``: x (N, n) and u (N, m) at which the actuated system rests, fixed points of the whole map; each
        counts as one pair, with the past equal to the present.
        ``excitation`` (E, T, m): input sequences that the model has to stay bounded under, for instance random ones of
        the kind it is made for. Nobody has to record what they do: alpha="cv" passes over models that take a state to
        three times the magnitude of its quantity in the data (:class:`pisplit.estimators.excitation.Excitation`).
        """
        if not isinstance(d2, PhaseSamples):
            raise ValueError(f"d2 is a {type(d2).__name__}; expected PhaseSamples of the known vector field")
        self._fit(d1, d2, pairs, equilibria, excitation=excitation)
        return self

    def _dictionary(self, d1: Episodes) -> Dictionary:
        if self.split in ("balanced", "hold"):
            return super()._dictionary(d1)
        return self.theta.named_after(d1)

    def _splitting(self, context: SplitContext) -> Splitting:
        splitting = SPLITS[self.split]
        return TwoStage(context, splitting) if self.toward == "physics" else splitting(context)

    def _context(self, theta: Dictionary, scale: Array, dt: float, samples: PhaseSamples | None) -> SplitContext:
        _check_names(theta, samples)
        return SplitContext(
            theta=theta,
            scale=scale,
            dt=dt,
            samples=samples,
            penalty=self.penalty,
            toward=self.toward,
            half_step=self.half_step,
            rows=self.rows,
            relative=self.relative,
            solver=self.solver,
            generator_alpha=self.generator_alpha,
            options=self.options or {},
        )


def _check_names(theta: Dictionary, samples: PhaseSamples | None) -> None:
    """Raise ValueError if the phase samples name other states or inputs than the trajectories."""
    if samples is None:
        return
    for given, wanted, what in (
        (samples.state_names, theta.names.states, "states"),
        (samples.input_names, theta.names.inputs, "inputs"),
    ):
        if given is not None and tuple(given) != wanted:
            raise ValueError(
                f"d2 names its {what} {tuple(given)[:4]}, d1 {wanted[:4]}; give both the same names in the same order"
            )
