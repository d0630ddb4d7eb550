"""Outputs over the horizon as an affine map of the moves, at one lifted state and along one plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.mpc.condense import condense
from pisplit.controllers.mpc.latency import Latency
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.controllers.mpc.relinearise import AlongPlan
from pisplit.lifted.model import LiftedModel


class Prediction:
    """y = y_free + S v for the commands u_j = offset + T v_j, with coordinates v (H, r) in mean half box widths.

    A model linear in u has one S. Others are linearised along the plan; bilinear and re-lifted ones are rolled out.

    Args:
        model: the model.
        rows: positions (p,) of the tracked states.
        horizon: H steps.
        limits: of the inputs.
        latency: known delays of commands and measurements.

    Attributes:
        nominal: S (H p, H r) in the middle of the limits.
    """

    def __init__(
        self, model: LiftedModel, rows: tuple[int, ...], horizon: int, limits: InputLimits, latency: Latency
    ) -> None:
        self._model, self._limits, self._latency, self._H = model, limits, latency, horizon
        self.read, self.offset = model.C[list(rows)], model.d[list(rows)]
        self.condensed = condense(model.A, model.B, model.c, self.read, self.offset, horizon)
        self._response = self.condensed.response()
        self._linear = model.linear_in_u
        self.T: Array = limits.basis * limits.amplitude.mean()
        self._along = AlongPlan(model, self.read, self.offset, self.T) if model.varies else None
        H, r = horizon, self.T.shape[1]
        centre = limits.offset + limits.basis @ limits.coordinates(0.5 * (limits.u_min + limits.u_max))
        if self._along is None:
            S, _ = self._linearise(np.tile(centre, (H, 1)), np.zeros((H, r)))
        else:
            D = model.n_delays
            # Products are fitted to the data's range: z = 0 is their mean in a re-lifted model, where x is d.
            known = np.zeros(model.n_states) if model.relifted is None else model.d
            z = model.lift(np.tile(known, (D + 1, 1)), np.tile(centre, (D, 1)))
            S, _ = self._along(z, np.zeros(model.n_lifted), np.tile(centre, (H, 1)))
        self._undelayed = S
        self.nominal = latency.mixed(S, r)
        if self._linear:
            p = len(self.read)
            self._offset_response = self._response.reshape(H * p, -1) @ np.tile(limits.offset, H)

    @property
    def constant(self) -> Array:
        """Outputs (H p,) under no moves of a model linear in u, at z = 0 and w = 0."""
        return self.condensed.constant + self._offset_response

    @property
    def late(self) -> Array:
        """Answer (H p, r) of the outputs to the command before, where delays are no whole steps; else zeros."""
        return self._latency.part * self._undelayed[:, : self.T.shape[1]]

    def __call__(self, z: Array, w: Array, v: Array, v_previous: Array) -> tuple[Array | None, Array]:
        """S (H p, H r), or None where it never changes, and y_free (H p,), at ``z`` (M,) along commands ``v`` (H, r).

        ``w`` (M,): disturbance; ``v_previous`` (r,): the command before, of which a part acts still where delays are no
        whole steps.
        """
        latency, r = self._latency, v.shape[1]
        acting = latency.acting(v, v_previous)
        S, y_free = self._acting_response(z, w, acting)
        if latency.part > 0.0:
            first = (self._undelayed if S is None else S)[:, :r]
            y_free = y_free + latency.part * first @ v_previous
            S = None if S is None else latency.mixed(S, r)
        return S, y_free

    def snapshot(self) -> Any:
        """What the next prediction starts from beside its arguments: derivatives along the last plan, or None."""
        return None if self._along is None else self._along.snapshot()

    def restore(self, kept: Any) -> None:
        """Go on from ``kept``, a snapshot."""
        if self._along is not None:
            self._along.restore(kept)

    def reset(self) -> None:
        """Forget the last plan."""
        self.restore(None)

    def _acting_response(self, z: Array, w: Array, v: Array) -> tuple[Array | None, Array]:
        """The same for inputs v (H, r) that act at once."""
        u = self._limits.offset + v @ self.T.T
        if self._along is not None:
            S, y = self._along(z, w, u)
            return S, y - S @ v.ravel()
        condensed = self.condensed
        y_free = condensed.free @ z + condensed.disturbance @ w + condensed.constant
        if self._linear:
            return None, y_free + self._offset_response
        S, y_features = self._linearise(u, v)
        return S, y_free + y_features

    def _linearise(self, u: Array, v: Array) -> tuple[Array, Array]:
        """S (H p, H r) and the constant part (H p,) of the outputs, for features linearised at u (H, m) = u(v)."""
        H, p, _, P = self._response.shape
        if self._linear:
            JT = np.broadcast_to(self.T, (H, *self.T.shape))
            value = u
        else:
            JT = self._model.feature_jacobian(u) @ self.T
            value = self._model.features(u)
        G = self._response.reshape(H * p, H, P)
        S = np.matmul(G.transpose(1, 0, 2), JT).transpose(1, 0, 2).reshape(H * p, -1)
        return S, self._response.reshape(H * p, H * P) @ value.ravel() - S @ v.ravel()
