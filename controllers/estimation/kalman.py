"""The lifted state from any of the measured states, with noise, gaps and outliers: a steady-state Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, matched, model_of, state_indices
from pisplit.lifted.model import LiftedModel

#: Doublings of the Riccati iteration, and the relative change of the covariance at which it has converged.
DOUBLINGS, CONVERGED = 40, 1e-9
#: Least noise of a measurement, in parts of the state's range: what is exact gets this.
EXACT = 1e-6
#: Part of the misses that is process noise at least; times them, from which on noise cannot have been in recordings;
#: and part of the largest that tells of a direction.
LEAST, ABSENT, RESOLVED = 0.1, 2.0, 1e-9
#: Mean of |x| over its standard deviation of a normal variable, and the part of a step in the mean size of innovations.
MEAN_SIZE, NEWEST = 0.8, 0.125
#: Times their mean size for which an innovation counts at most.
CLIPPED = 3.0


class KalmanFilter:
    """Steady-state Kalman filter of z+ = A z + B phi(u) (+ sum_i u_i N_i z) + c + process noise,
    y = C z + d + measurement noise.

    Of the prediction z it makes z + L (y - C z - d), y being those states that ``measured`` names. An entry that was
    not measured, or that lies more than ``gate`` of its standard deviations away, changes nothing (its innovation is
    set to zero), so that one gain serves all steps. Predictions of a bilinear or re-lifted model follow its own steps;
    its gain is that of the transition at the mean input of the training data, and at the mean state of a re-lifted one.

    Innovations that are larger than expected in all entries, for several steps, are the model's error and no outliers:
    the gate is so many times wider as their mean size of late, the ``level``, is above the expected one. Deaf to its
    own error a filter goes on with a prediction, and the loop swings.

    Args:
        model: the model, linear in z, bilinear or re-lifted; or an estimator that was fitted.
        process: covariance (M, M) of what the model misses in a step of the lifted state.
        std: noise of the measured states, a number, one each (p,), or {unit: standard deviation}.
        measured: the states that are measured, an output of the model, or names or positions; all if not given.
        gate: innovations beyond so many standard deviations are rejected; None rejects nothing.

    Attributes:
        measured: positions (p,) of the measured states; gain: L (M, p); innovation_std: (p,) expected of innovations.

    Raises ValueError for other shapes and negative noise.

    Source: Anderson and Moore, *Optimal Filtering* (1979), chapter 4; the doubling iteration for the Riccati equation
    is in section 6.7.
    """

    _noisy = False

    def __init__(
        self,
        model: LiftedModel | Fitted,
        process: ArrayLike,
        std: ArrayLike | Mapping[str, float],
        measured: str | Sequence[int] | Sequence[str] | None = None,
        gate: float | None = 5.0,
    ) -> None:
        self.model = found = model_of(model, "model")
        self.measured: NDArray[np.int64] = state_indices(found, measured)
        self.gate = None if gate is None else positive(gate, "gate")
        M = found.n_lifted
        Q = finite_array(process, "process", (M, M))
        self._C, self._d = found.C[self.measured], found.d[self.measured]
        self._std = std
        noise: Array = np.maximum(_noise(found, self.measured, std), EXACT * found.state_range[self.measured])
        P = predicted_covariance(_transition(found), self._C, 0.5 * (Q + Q.T), noise**2)
        S = self._C @ P @ self._C.T + np.diag(noise**2)
        self.gain: Array = np.asarray(np.linalg.solve(S, self._C @ P).T, dtype=np.float64)
        self.innovation_std: Array = np.sqrt(np.diag(S))

    @classmethod
    def from_data(
        cls,
        model: LiftedModel | Fitted,
        episodes: Episodes,
        std: ArrayLike | Mapping[str, float],
        measured: str | Sequence[int] | Sequence[str] | None = None,
        gate: float | None = 5.0,
        noisy: bool = False,
    ) -> KalmanFilter:
        """The filter whose process noise is what the model misses in one step of recorded ``episodes``.

        model, std, measured, gate  as for the filter itself
        episodes                    recordings with the states and inputs of the model, found by name
        noisy                       whether they were made with the noise ``std``: the model misses it twice a step, and
                                    what it adds to the misses, which is none of the process, is taken off

        Raises ValueError for episodes of other names, units or time step, or too short for the model's delays.
        """
        found = model_of(model, "model")
        data = matched(found, episodes)
        rows = state_indices(found, measured)
        noise, rng = np.zeros(found.n_states), np.random.default_rng(0)
        noise[rows] = _noise(found, rows, std)
        total = np.zeros((found.n_lifted, found.n_lifted))
        added, steps = np.zeros_like(total), 0
        for x, u in zip(data.xs, data.us, strict=True):
            if len(u) <= found.n_delays:
                continue
            missed = _missed(found, x, u)
            total += missed.T @ missed
            steps += len(missed)
            if noisy:
                more = _missed(found, x + noise * rng.standard_normal(x.shape), u) - missed
                added += more.T @ more
        if not steps:
            raise ValueError(f"no episode is longer than the {found.n_delays} delays of the model: give longer ones")
        process = (_without(total, added) if noisy else total) / steps
        made = cls(found, 0.5 * (process + process.T), std, measured, gate)
        made._noisy = noisy
        return made

    def of_model(self, model: LiftedModel, episodes: Episodes) -> KalmanFilter:
        """A filter of another ``model`` with the same states, sensors and gate; process noise of its ``episodes``."""
        return KalmanFilter.from_data(model, episodes, self._std, self.measured.tolist(), self.gate, self._noisy)

    def innovation(self, predicted: Array, x: Array) -> Array:
        """y - C z - d (p,) of z = ``predicted`` (M,) and the state ``x`` (n,), NaN where it was not measured."""
        return np.asarray(x[self.measured] - self._C @ predicted - self._d)

    def doubted(self, innovation: Array, level: float = 1.0) -> NDArray[np.bool_]:
        """Which entries (p,) of an ``innovation`` (p,) are too far away to be believed at their ``level`` of late."""
        if self.gate is None:
            return np.zeros(len(innovation), dtype=bool)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(innovation) > self.gate * max(1.0, level) * self.innovation_std)

    def level(self, before: float, innovation: Array) -> float:
        """Size of innovations of late in parts of the expected one, after the ``innovation`` (p,), ``before`` until it.

        A mean over some eight steps of entries that were measured; one is 1 on average, and counts for no more than
        three times the mean, so that it takes many steps or many entries to open the gate.
        """
        size = np.abs(innovation[~np.isnan(innovation)] / self.innovation_std[~np.isnan(innovation)])
        if not len(size):
            return before
        seen = float(np.minimum(size, CLIPPED * max(1.0, before)).mean()) / MEAN_SIZE
        return before + NEWEST * (seen - before)

    def corrected(self, predicted: Array, innovation: Array) -> Array:
        """z + L innovation (M,) of z = ``predicted`` (M,); NaN in the ``innovation`` (p,) counts as zero."""
        return np.asarray(predicted + self.gain @ np.nan_to_num(innovation, nan=0.0))


def predicted_covariance(A: Array, C: Array, Q: Array, r: Array) -> Array:
    """P (M, M), the covariance of predictions: P = A (P - P C^T (C P C^T + R)^-1 C P) A^T + Q with R = diag(r).

    A (M, M), C (p, M), Q (M, M) symmetric, r (p,) positive. Doubling: after k iterations it is the covariance 2^k steps
    after a state known exactly. Raises ValueError where it does not converge: a mode that grows and is not measured.
    """
    a, g, h = A.T.copy(), C.T @ (C / r[:, None]), Q.copy()
    scale = max(float(np.abs(Q).max()), 1e-300)
    for _ in range(DOUBLINGS):
        w = np.eye(len(A)) + g @ h
        both = np.linalg.solve(w, np.hstack([a, g]))
        aw, gw = both[:, : len(A)], both[:, len(A) :]
        step = a.T @ h @ aw
        g = g + a @ gw @ a.T
        a = a @ aw
        h = h + 0.5 * (step + step.T)
        g = 0.5 * (g + g.T)
        scale = max(scale, float(np.abs(h).max()))
        if not np.isfinite(h).all():
            break
        if np.abs(step).max() <= CONVERGED * scale:
            return h
    raise ValueError(
        "the covariance of predictions grows without bound: the model has a mode that does not decay and that the "
        "measured states do not show; measure more, or bound the model with max_radius"
    )


def _missed(model: LiftedModel, x: Array, u: Array) -> Array:
    """What the model misses in a step (N, M) of the lifted states along ``x`` (T + 1, n) under ``u`` (T, m)."""
    D = model.n_delays
    at = np.arange(D, len(u))
    z = model.lift(x[at[:, None] + np.arange(-D, 1)], u[at[:, None] + np.arange(-D, 0)])
    after = model.lift(x[at[:, None] + np.arange(1 - D, 2)], u[at[:, None] + np.arange(1 - D, 1)])
    return np.asarray(after - model.rollout(z, u[at][:, None]).z[:, 1])


def _without(total: Array, added: Array) -> Array:
    """``total`` (M, M) less what noise ``added`` (M, M) to it, direction by direction, down to a tenth of itself.

    Directions in which noise of that size would have made far more than there is are left: it has no part in them, as
    that of single entries of a frame.
    """
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    total, added = (m / size[:, None] / size for m in (total, added))
    values, vectors = np.linalg.eigh(total)
    seen = values > RESOLVED * values[-1]
    root = vectors[:, seen] * np.sqrt(values[seen])
    white = vectors[:, seen] / np.sqrt(values[seen])
    noise, turned = np.linalg.eigh(white.T @ added @ white)
    taken = root @ turned
    kept = np.where(noise > ABSENT, 0.0, np.clip(noise, 0.0, 1.0 - LEAST))
    return np.asarray((total - (taken * kept) @ taken.T) * size[:, None] * size)


def _transition(model: LiftedModel) -> Array:
    """A step's derivative (M, M) in the lifted state, in the middle of the training data."""
    if model.relifted is None:
        return model.transition(model.input_offset)
    D, u = model.n_delays, model.input_offset
    z = model.lift(np.tile(model.d, (D + 1, 1)), np.tile(u, (D, 1)))  # x is d at z = 0, the mean
    return model.jacobian(z, u)[0]


def _noise(model: LiftedModel, measured: NDArray[np.int64], std: ArrayLike | Mapping[str, float]) -> Array:
    """Standard deviations (p,) of the measured states."""
    if isinstance(std, Mapping):
        units = [model.units[i] for i in measured]
        unknown = sorted(set(std) - set(model.units))
        if unknown:
            raise ValueError(f"no state of the model has the unit {unknown[0]!r}; it has {sorted(set(model.units))}")
        return np.array([non_negative(std.get(unit, 0.0), f"std of {unit!r}") for unit in units])
    given = np.full(len(measured), non_negative(std, "std")) if np.ndim(std) == 0 else std
    found = finite_array(given, "std", (len(measured),))
    if (found < 0.0).any():
        raise ValueError("std has negative entries; expected standard deviations")
    return found
