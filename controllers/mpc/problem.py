"""The condensed tracking problem: cost, limits and their values at one step, for the QP solver."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.controllers.mpc.qp import QP, QPResult, QPSettings

MILLIMETRES = 1e3  # per metre: output errors are weighed in mm


@dataclass(frozen=True)
class Weights:
    """Stage cost: output (p,) and slack per mm^2 of error, rate and input per half-box-width^2 of (change of) input."""

    output: Array
    rate: float
    input: float
    slack: float


class TrackingProblem:
    """minimise sum_j |y_j - r_j|^2_Q + |u_j - u_{j-1}|^2_R + |u_j - u_offset|^2_I + w s_j^2 over H stages.

    Inputs u_j = offset + T v_j with coordinates v (H, r) in units of the mean half box width; outputs y = y_free + S v
    with p outputs a stage. Box and rate rows are hard, output rows share one slack s_j >= 0 a stage, which exists only
    when an output limit is finite. Rows are scaled: inputs by the half box width, outputs by their reach max |S|.
    A reference entry of NaN leaves that output free.
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
        H, p, r = self._H, self._p, self._r
        amplitude = limits.amplitude
        self.scale = float(amplitude.mean())
        self.T = limits.basis * self.scale  # (m, r): du/dv

        per_amplitude = self.T / amplitude[:, None]
        self._rate_hessian = weights.rate * per_amplitude.T @ per_amplitude
        difference = np.eye(H) - np.eye(H, k=-1)
        self._input_hessian = np.kron(difference.T @ difference, self._rate_hessian)
        self._input_hessian += np.kron(np.eye(H), weights.input * per_amplitude.T @ per_amplitude)

        self._Q = np.tile(weights.output * MILLIMETRES**2, H)
        self._outputs_low, self._outputs_high = np.isfinite(y_min), np.isfinite(y_max)
        self._y_min, self._y_max = y_min[self._outputs_low], y_max[self._outputs_high]
        n_low, n_high = len(self._y_min), len(self._y_max)
        self._soft = n_low + n_high > 0
        self._reach = float(np.abs(response).sum(axis=1).max()) or 1.0
        self._slack_hessian = weights.slack * (MILLIMETRES * self._reach) ** 2
        self.n_moves = H * r
        self.n_variables = self.n_moves + (H if self._soft else 0)

        # An input that the basis does not move has constant rows, which say nothing.
        moving = np.abs(per_amplitude).max(axis=1) > 1e-9
        rows = per_amplitude[moving]
        k = len(rows)
        self._rate_rows = rows
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
        self._rate_limit = (limits.du_max / amplitude)[moving]
        self._lower[rate], self._upper[rate] = -np.tile(self._rate_limit, H), np.tile(self._rate_limit, H)
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

        self._specified = np.ones(H * p, dtype=bool)
        self._set_response(response)
        P = self._hessian()
        # Cost per mean curvature: absolute tolerances of the solver then mean the same for every arm and weight.
        self._normalise = 1.0 / (float(np.diag(P)[: self.n_moves].mean()) or 1.0)
        P_pattern = np.zeros_like(P, dtype=bool)
        P_pattern[: self.n_moves, : self.n_moves] = True
        P_pattern |= np.eye(self.n_variables, dtype=bool)
        self._qp = QP(self._normalise * P, self._A, P_pattern, pattern, settings)
        self._shift_moves = np.concatenate(
            [_next_stage(H, r), self.n_moves + _next_stage(H, 1)] if self._soft else [_next_stage(H, r)]
        )
        self._shift_rows = np.concatenate(
            [a + _next_stage(H, g) for a, g in zip(first[:-1], groups, strict=True)]
        ).astype(int)

    def restart(self) -> None:
        """Forget the iterates of the solver."""
        self._qp.restart()

    def hold(self, v_previous: Array) -> Array:
        """The variables (n_variables,) of a plan that keeps the input at v_previous (r,)."""
        x = np.zeros(self.n_variables)
        x[: self.n_moves] = np.tile(v_previous, self._H)
        return x

    def shift(self, x: Array) -> Array:
        """The same plan one step later, its last move repeated."""
        return x[self._shift_moves]

    def moves(self, x: Array) -> Array:
        """Coordinates v (H, r) of the planned inputs."""
        return x[: self.n_moves].reshape(self._H, self._r)

    def outputs(self, y_free: Array, x: Array) -> Array:
        """Predicted outputs (H, p) of a plan."""
        return (y_free + self._S @ x[: self.n_moves]).reshape(self._H, self._p)

    def solve(
        self, y_free: Array, reference: Array, v_previous: Array, x0: Array, response: Array | None = None
    ) -> QPResult:
        """One QP. y_free, reference (H p,) with NaN = free; v_previous (r,); x0 (n_variables,) the shifted last plan.

        ``response`` (H p, H r) replaces S: it is given at every step when the features are nonlinear in the input.
        """
        if not np.isfinite(y_free).all():  # before anything is kept of this step
            return QPResult("prediction not finite", None, 0, np.inf)
        P = A = None
        specified = ~np.isnan(reference)
        if response is not None:
            self._set_response(response)
            A = self._A if self._soft else None
        if response is not None or not np.array_equal(specified, self._specified):
            self._specified = specified
            P = self._normalise * self._hessian()
        error = np.where(specified, y_free - reference, 0.0)
        q = np.zeros(self.n_variables)
        q[: self.n_moves] = (self._weights() * error) @ self._S
        q[: self._r] -= self._rate_hessian @ v_previous
        q *= self._normalise
        anchor = self._rate_rows @ v_previous
        self._lower[self._first_rate] = anchor - self._rate_limit
        self._upper[self._first_rate] = anchor + self._rate_limit
        if self._soft:
            free = y_free.reshape(self._H, self._p)
            below, above, _ = self._groups[2:]
            self._lower[below] = ((self._y_min - free[:, self._outputs_low]) / self._reach).ravel()
            self._upper[above] = ((self._y_max - free[:, self._outputs_high]) / self._reach).ravel()
        y0 = self._qp.multipliers[self._shift_rows]
        return self._qp.solve(q, self._lower, self._upper, P, A, x0, y0)

    def _set_response(self, S: Array) -> None:
        self._S = S
        if self._soft:
            H, p = self._H, self._p
            stages = S.reshape(H, p, self.n_moves) / self._reach
            below, above, _ = self._groups[2:]
            self._A[below, : self.n_moves] = stages[:, self._outputs_low].reshape(-1, self.n_moves)
            self._A[above, : self.n_moves] = stages[:, self._outputs_high].reshape(-1, self.n_moves)

    def _hessian(self) -> Array:
        P = np.zeros((self.n_variables, self.n_variables))
        P[: self.n_moves, : self.n_moves] = self._S.T @ (self._weights()[:, None] * self._S) + self._input_hessian
        slack = np.arange(self.n_moves, self.n_variables)
        P[slack, slack] = self._slack_hessian
        return P

    def _weights(self) -> Array:
        return np.where(self._specified, self._Q, 0.0)


def _next_stage(H: int, size: int) -> Array:
    """Indices that move every stage block of ``size`` entries one stage ahead and repeat the last."""
    index = np.arange(H * size).reshape(H, size)
    return np.concatenate([index[1:], index[-1:]]).ravel()
