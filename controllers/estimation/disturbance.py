"""Disturbance estimate from one-step residuals of the lifted state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, finite_number
from pisplit.dictionary.products import Transition


@dataclass(frozen=True)
class EstimatorState:
    """The ``disturbance`` w (M,) and the lifted state (M,) ``predicted`` for the next measurement, None before it."""

    disturbance: Array
    predicted: Array | None


class DisturbanceEstimator:
    """Constant disturbance w of z+ = A z + B phi + c + w, from measured states: w += gain (z - z_predicted).

    At rest the residual can vanish only when the disturbed model has the plant's own equilibrium, so an MPC that
    predicts with w tracks constant references without offset: the disturbance sits where the residual is measured, in
    the lifted state, and not on the output. ``gain`` 0 switches it off, 1 is a dead-beat observer that amplifies noise.

    A (M, M), B (M, P) and c (M,) are the model's. Raises ValueError for other shapes and a gain outside 0 .. 1.

    Source: Pannocchia and Rawlings, AIChE Journal 49 (2003), disturbance models for offset-free MPC.
    """

    def __init__(self, A: Array, B: Array, c: Array, gain: float) -> None:
        self.gain = finite_number(gain, "estimator_gain")
        if not 0.0 <= self.gain <= 1.0:
            raise ValueError(f"estimator_gain = {self.gain:g}; expected a number from 0 (off) to 1 (dead-beat)")
        self._B = finite_array(B, "B", (None, None))
        M = self._B.shape[0]
        self._transition = Transition(finite_array(A, "A", (M, M)))
        self._c = finite_array(c, "c", (M,))
        self.reset()

    @property
    def disturbance(self) -> Array:
        """The estimate w (M,), added to z at every step."""
        return self._w

    @property
    def predicted(self) -> Array | None:
        """The lifted state (M,) predicted for the coming measurement; None before the first and once it is used."""
        return self._predicted

    def reset(self) -> None:
        """Forget the estimate and the last prediction."""
        self._w = np.zeros(len(self._c))
        self._predicted: Array | None = None

    def snapshot(self) -> EstimatorState:
        """The state from which ``restore`` goes on."""
        return EstimatorState(self._w.copy(), None if self._predicted is None else self._predicted.copy())

    def restore(self, state: EstimatorState) -> None:
        """Go on from a ``state`` of an estimator of the same size."""
        self._w = state.disturbance.copy()
        self._predicted = None if state.predicted is None else state.predicted.copy()

    def update(self, z: ArrayLike) -> Array:
        """Correct the estimate with the measured lifted state z (M,) and return it; without a prediction, keep it."""
        if self._predicted is not None and self.gain > 0.0:
            residual = np.asarray(z) - self._predicted
            if np.isfinite(residual).all():
                self._w = self._w + self.gain * residual
        self._predicted = None
        return self._w

    def predict(self, z: Array, features: Array, bilinear: Array | None = None) -> Array:
        """The lifted state (M,) after z (M,) under the applied input ``features`` (P,); ``update`` compares with it.

        ``bilinear`` (M,): what products of inputs and lifted states add, in a bilinear model.
        """
        self._predicted = self.following(z, self._w, features, bilinear)
        return self._predicted

    def following(self, z: Array, w: Array, features: Array, bilinear: Array | None = None) -> Array:
        """As ``predict`` of ``z``, ``features``, ``bilinear``, under a disturbance ``w`` (M,); nothing is kept."""
        z_next = self._transition(z) + self._B @ features
        if bilinear is not None:
            z_next += bilinear
        z_next += self._c
        z_next += w
        return np.asarray(z_next)
