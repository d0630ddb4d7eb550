"""The condensed tracking problem: cost, limits and their values at one step, for the QP solver."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array
from pisplit.controllers.mpc.active_set import ActiveSetQP
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.controllers.mpc.qp import QP, QPResult, QPSettings, QPState

RESCALE = 2.0  # change of the mean curvature, or of the reach, from which the problem is scaled anew


@dataclass(frozen=True)
class Weights:
    """Stage cost: output (p,) and slack per squared output scale, rate and input per half-box-width^2 of (change of)
    input. ``scale`` (p,): size of each output, in output units."""

    output: Array
    rate: float
    input: float
    slack: float
    scale: Array


@dataclass(frozen=True)
class ProblemState:
    """What the next solve depends on: the state ``qp`` of the solver, the response S (H p, H r), which outputs are
    ``specified`` (H p,), the factors ``normalise`` of the cost and ``reach`` of the rows, and the ``multipliers`` (k,)
    in units that these do not change."""

    qp: QPState
    S: Array
    specified: NDArray[np.bool_]
    normalise: float
    reach: float
    multipliers: Array


class TrackingProblem:
    """minimise sum_j |(y_j - r_j)/scale|^2_Q + |u_j - u_{j-1}|^2_R + |u_j - u_offset|^2_I + w s_j^2 over H stages.

    Inputs u_j = offset + T v_j with coordinates v (H, r) in units of the mean half box width; outputs y = y_free + S v
    with p outputs a stage. Box and rate rows are hard, output rows y_min - scale s_j <= y_j <= y_max + scale s_j share
    one slack s_j >= 0 a stage, which exists only when an output limit is finite. Rows are scaled: inputs by the half
    box width, outputs by their reach, the largest sum of |S/scale| over a row; the cost by its mean curvature.
    A reference entry of NaN leaves that output free.

    ``horizon`` H; ``limits`` of the inputs; ``weights`` of the stage cost; ``y_min``, ``y_max`` (p,) in output units,
    infinite where absent; ``response`` S (H p, H r); ``settings`` of the solver.
    """

    def __init__(
        self,
        horizon: int,
        limits: InputLimits,
        weights: Weights,
        y_min: Array,
        y_max: Array,
        response: Array,
        settings: QPSettings,
    ) -> None:
        self.limits = limits
        self._H, self._p, self._r = horizon, len(weights.output), limits.basis.shape[1]
        H, r = self._H, self._r
        amplitude = limits.amplitude
        self.scale = float(amplitude.mean())
        self.T = limits.basis * self.scale  # (m, r): du/dv

        per_amplitude = self.T / amplitude[:, None]
        self.rate_hessian = weights.rate * per_amplitude.T @ per_amplitude
        difference = np.eye(H) - np.eye(H, k=-1)
        self.input_hessian: Array = np.asarray(np.kron(difference.T @ difference, self.rate_hessian), dtype=np.float64)
        self.input_hessian += np.kron(np.eye(H), weights.input * per_amplitude.T @ per_amplitude)

        self._Q = np.tile(weights.output / weights.scale**2, H)
        self._slack_weight, self._size = weights.slack, np.tile(weights.scale, H)
        self._outputs_low, self._outputs_high = np.isfinite(y_min), np.isfinite(y_max)
        self._y_min, self._y_max = y_min[self._outputs_low], y_max[self._outputs_high]
        n_low, n_high = len(self._y_min), len(self._y_max)
        self._soft = n_low + n_high > 0
        self.n_moves = H * r
        self.n_variables = self.n_moves + (H if self._soft else 0)

        # An input that the basis does not move has constant rows, which say nothing.
        moving = np.abs(per_amplitude).max(axis=1) > 1e-9
        rows = per_amplitude[moving]
        k = len(rows)
        self.rate_rows = rows
        groups = [k, k] + ([n_low, n_high, 1] if self._soft else [])  # rows a stage
        first = np.cumsum([0, *[H * g for g in groups]])
        self._groups = [slice(int(a), int(b)) for a, b in itertools.pairwise(first)]
        self._A = np.zeros((int(first[-1]), self.n_variables))
        self._lower, self._upper = np.full(first[-1], -np.inf), np.full(first[-1], np.inf)
        pattern = np.zeros(self._A.shape, dtype=bool)
        box, rate = self._groups[:2]
        self._A[box, : self.n_moves] = np.kron(np.eye(H), rows)
        self._A[rate, : self.n_moves] = np.kron(difference, rows)
        self._lower[box] = np.tile(((limits.u_min - limits.offset) / amplitude)[moving], H)
        self._upper[box] = np.tile(((limits.u_max - limits.offset) / amplitude)[moving], H)
        self.rate_limit = (limits.du_max / amplitude)[moving]
        self._lower[rate], self._upper[rate] = -np.tile(self.rate_limit, H), np.tile(self.rate_limit, H)
        self._first_rate = slice(rate.start, rate.start + k)
        if self._soft:
            below, above, slack = self._groups[2:]
            causal = np.kron(np.tril(np.ones((H, H), dtype=bool)), np.ones((1, r), dtype=bool))
            for group, count, sign in ((below, n_low, 1.0), (above, n_high, -1.0)):
                pattern[group, : self.n_moves] = np.repeat(causal, count, axis=0)
                self._A[group, self.n_moves :] = sign * np.kron(np.eye(H), np.ones((count, 1)))
            self._A[slack, self.n_moves :] = np.eye(H)
            self._lower[slack] = 0.0
        pattern |= self._A != 0.0

        self._shift_moves = np.concatenate(
            [_next_stage(H, r), self.n_moves + _next_stage(H, 1)] if self._soft else [_next_stage(H, r)]
        )
        self._shift_rows = np.concatenate(
            [a + _next_stage(H, g) for a, g in zip(first[:-1], groups, strict=True)]
        ).astype(int)
        self._S, self._specified = response, np.ones(H * self._p, dtype=bool)
        self._normalise, self._reach, self._multipliers = 0.0, 0.0, np.zeros(int(first[-1]))
        P = self._scaled()
        self._qp: QP | ActiveSetQP
        if settings.solver == "daqp":
            self._qp = ActiveSetQP(P, self._A, settings)
            self._beginning = self.snapshot()
            return
        P_pattern = np.zeros((self.n_variables, self.n_variables), dtype=bool)
        P_pattern[: self.n_moves, : self.n_moves] = True
        P_pattern |= np.eye(self.n_variables, dtype=bool)
        self._qp = QP(P, self._A, P_pattern, pattern, settings)
        self._beginning = self.snapshot()

    @property
    def box(self) -> tuple[Array, Array]:
        """Bounds (H k,) of the k moving inputs, stage by stage, in half box widths about the offset."""
        rows = self._groups[0]
        return self._lower[rows], self._upper[rows]

    @property
    def weights_of_outputs(self) -> Array:
        """Weights (H p,) of squared output errors, in output units."""
        return self._Q

    def restart(self) -> None:
        """Forget what was solved: the next solve counts as the first."""
        self.restore(self._beginning)

    def snapshot(self) -> ProblemState:
        """The state from which ``restore`` goes on to the last bit."""
        kept = (self._S.copy(), self._specified.copy(), self._normalise, self._reach, self._multipliers.copy())
        return ProblemState(self._qp.snapshot(), *kept)

    def restore(self, state: ProblemState) -> None:
        """Go on from a ``state`` of a problem of the same sizes; raises ValueError for others."""
        self._qp.restore(state.qp)
        self._S, self._specified, self._multipliers = state.S.copy(), state.specified.copy(), state.multipliers.copy()
        self._normalise, self._reach = state.normalise, state.reach
        self._place_response()

    def hold(self, v_previous: Array) -> Array:
        """The variables (n_variables,) of a plan that keeps the input at v_previous (r,): moves, then slacks."""
        x = np.zeros(self.n_variables)
        x[: self.n_moves] = np.tile(v_previous, self._H)
        return x

    def shift(self, x: Array) -> Array:
        """The plan x (n_variables,) one step later, its last move repeated."""
        return x[self._shift_moves]

    def moves(self, x: Array) -> Array:
        """Coordinates v (H, r) of the inputs of a plan x (n_variables,)."""
        return x[: self.n_moves].reshape(self._H, self._r)

    def outputs(self, y_free: Array, x: Array) -> Array:
        """Predicted outputs (H, p) of a plan x (n_variables,); y_free (H p,) are those of v = 0."""
        return (y_free + self._S @ x[: self.n_moves]).reshape(self._H, self._p)

    def solve(
        self, y_free: Array, reference: Array, v_previous: Array, x0: Array, response: Array | None = None
    ) -> QPResult:
        """One QP. y_free, reference (H p,) with NaN = free; v_previous (r,); x0 (n_variables,) the shifted last plan.

        ``response`` (H p, H r) replaces S: it is given at every step when the features are nonlinear in the input.
        """
        finite = np.isfinite(y_free).all() and (response is None or np.isfinite(response).all())
        if not finite:  # before anything is kept of this step
            return QPResult("prediction not finite", None, 0, np.inf)
        P = A = None
        specified = ~np.isnan(reference)
        if response is not None or not np.array_equal(specified, self._specified):
            self._S = self._S if response is None else response
            self._specified = specified
            P = self._scaled()
            A = self._A if self._soft else None
        error = np.where(specified, y_free - reference, 0.0)
        q = np.zeros(self.n_variables)
        q[: self.n_moves] = (self._weights() * error) @ self._S
        q[: self._r] -= self.rate_hessian @ v_previous
        q *= self._normalise
        anchor = self.rate_rows @ v_previous
        self._lower[self._first_rate] = anchor - self.rate_limit
        self._upper[self._first_rate] = anchor + self.rate_limit
        if self._soft:
            free, size = y_free.reshape(self._H, self._p), self._size.reshape(self._H, self._p) * self._reach
            below, above, _ = self._groups[2:]
            low, high = self._outputs_low, self._outputs_high
            self._lower[below] = ((self._y_min - free[:, low]) / size[:, low]).ravel()
            self._upper[above] = ((self._y_max - free[:, high]) / size[:, high]).ravel()
        # Plan and multipliers are kept in units that a change of the scaling does not touch.
        by_variable, by_row = self._factors()
        y0 = self._multipliers[self._shift_rows] * by_row
        result = self._qp.solve(q, self._lower, self._upper, P, A, x0 / by_variable, y0)
        self._multipliers = self._qp.multipliers / by_row
        return result if result.x is None else replace(result, x=result.x * by_variable)

    def _factors(self) -> tuple[Array, Array]:
        """Units of the solver's variables (n_variables,), and of its multipliers (k,)."""
        by_variable, by_row = np.ones(self.n_variables), np.full(len(self._lower), self._normalise)
        by_variable[self.n_moves :] = self._reach
        by_row[self._groups[1].stop :] *= self._reach
        return by_variable, by_row

    def _scaled(self) -> Array:
        """The Hessian per mean curvature, and the output rows per reach, which come into A.

        Absolute tolerances of the solver then mean the same for every arm, weight and, where the response changes with
        the state, at every state: both factors follow when they are off by more than ``RESCALE``.
        """
        reach = float(np.abs(self._S / self._size[:, None]).sum(axis=1).max()) or 1.0
        if not 1.0 / RESCALE <= reach / (self._reach or np.inf) <= RESCALE:
            self._reach = reach
        P = self._hessian()
        curvature = float(np.diag(P)[: self.n_moves].mean()) or 1.0
        if not 1.0 / RESCALE <= curvature * self._normalise <= RESCALE:
            self._normalise = 1.0 / curvature
        self._place_response()
        return self._normalise * P

    def _place_response(self) -> None:
        if self._soft:
            H, p = self._H, self._p
            stages = (self._S / (self._size * self._reach)[:, None]).reshape(H, p, self.n_moves)
            below, above, _ = self._groups[2:]
            self._A[below, : self.n_moves] = stages[:, self._outputs_low].reshape(-1, self.n_moves)
            self._A[above, : self.n_moves] = stages[:, self._outputs_high].reshape(-1, self.n_moves)

    def _hessian(self) -> Array:
        P = np.zeros((self.n_variables, self.n_variables))
        P[: self.n_moves, : self.n_moves] = self._S.T @ (self._weights()[:, None] * self._S) + self.input_hessian
        slack = np.arange(self.n_moves, self.n_variables)
        P[slack, slack] = self._slack_weight * self._reach**2
        return P

    def _weights(self) -> Array:
        return np.where(self._specified, self._Q, 0.0)


def _next_stage(H: int, size: int) -> Array:
    """Indices that move every stage block of ``size`` entries one stage ahead and repeat the last."""
    index = np.arange(H * size).reshape(H, size)
    return np.concatenate([index[1:], index[-1:]]).ravel()
