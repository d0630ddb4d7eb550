"""Prediction of a bilinear or re-lifted model along a plan, and its derivative by the planned inputs."""

from __future__ import annotations

from typing import Any

import numpy as np

from pisplit.checks import Array
from pisplit.dictionary.products import Transition
from pisplit.lifted.model import LiftedModel


class AlongPlan:
    """Outputs y = C z + d along a plan, and their derivative; z+ = A z + B phi(u) + sum_i u_i N_i z + g(z, u) + c + w.

    ``model``: a bilinear or re-lifted one; ``read`` (p, M) and ``offset`` (p,) are the rows of C and d that are
    tracked, T (m, r) = du/dv.
    """

    def __init__(self, model: LiftedModel, read: Array, offset: Array, T: Array) -> None:
        if not model.varies:
            raise ValueError("the model is not bilinear; condense it once")
        self._model = model
        self._transition = Transition(model.A)
        self._read, self._offset, self._T = read, offset, T
        along = getattr(model.relifted, "along", None)
        self._own = None if along is None else along(read, offset, T)  # that of the term itself

    def __call__(self, z: Array, w: Array, u: Array) -> tuple[Array, Array]:
        """S (H p, H r) = dy/dv and y (H p,) at steps k+1 .. k+H from z_k (M,) under u (H, m), disturbance w (M,)."""
        if self._own is not None:
            try:
                return self._own(z, w, u)
            except RuntimeError:  # a step that nothing solves: the problem says so
                H, p = len(u), len(self._read)
                return np.full((H * p, H * self._T.shape[1]), np.nan), np.full(H * p, np.nan)
        if self._model.relifted is not None:
            return self._step_by_step(z, w, u)
        model, term, T = self._model, self._model.bilinear_term, self._T
        assert term is not None
        H, p, r = len(u), len(self._read), T.shape[1]
        forcing = model.features(u) @ model.B.T + (model.c + w)
        by_features = model.B @ (model.feature_jacobian(u) @ T)  # (H, M, r)
        S, y = np.zeros((H, p, H * r)), np.empty((H, p))
        sensitivity = np.zeros((model.n_lifted, 0))
        for j in range(H):
            grown = np.empty((model.n_lifted, (j + 1) * r))
            if j:
                grown[:, :-r] = self._transition(sensitivity)
                grown[term.rows, :-r] += term.matrix(u[j]) @ sensitivity[term.columns]
            grown[:, -r:] = by_features[j]
            grown[term.rows, -r:] += term.slopes(z) @ T
            following = self._transition(z) + forcing[j]
            following[term.rows] += term(z, u[j])
            z, sensitivity = following, grown
            S[j, :, : (j + 1) * r] = self._read @ sensitivity
            y[j] = self._read @ z + self._offset
        return S.reshape(H * p, H * r), y.ravel()

    def snapshot(self) -> Any:
        """What the next call starts from, None where it starts from nothing."""
        return None if self._own is None else self._own.snapshot()

    def restore(self, kept: Any) -> None:
        """Go on from ``kept``, a snapshot, or None: from nothing."""
        if self._own is not None:
            self._own.restore(kept)

    def _step_by_step(self, z: Array, w: Array, u: Array) -> tuple[Array, Array]:
        """The same for a re-lifted model: every step has a Jacobian of its own."""
        model, T = self._model, self._T
        H, p, r = len(u), len(self._read), T.shape[1]
        S, y = np.zeros((H, p, H * r)), np.empty((H, p))
        sensitivity = np.zeros((model.n_lifted, 0))
        for j in range(H):
            if not np.isfinite(z).all():  # the products have overflown: the problem says so, no exception
                S[j:], y[j:] = np.nan, np.nan
                break
            by_state, by_input = model.jacobian(z, u[j])
            sensitivity = np.hstack([by_state @ sensitivity, by_input @ T])
            z = model.step(z, u[j]) + w
            S[j, :, : (j + 1) * r] = self._read @ sensitivity
            y[j] = self._read @ z + self._offset
        return S.reshape(H * p, H * r), y.ravel()
