"""The known half step K_f(dt/2): generator EDMD and its exponential, or EDMD on the flow of f."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import one_of
from pisplit.dictionary import Dictionary
from pisplit.moments import Moments, accumulate
from pisplit.phase import PhaseSamples
from pisplit.regression import ridge

Array = NDArray[np.float64]

HALF_STEPS = ("generator", "flow", "auto")
SPURIOUS_GROWTH = 1.1
SINGULAR = 1e12


@dataclass(frozen=True)
class HalfStep:
    """K_f(dt/2) (M, M) on columns divided by their scales, identity on the constant, on delays and on inputs.

    kind       "generator" or "flow"
    reason     why this kind was taken
    generator  L (M, M) on scaled columns [1/s], or None if the flow was asked for
    growth     spectral radius of K_f
    max_real   largest real part among the eigenvalues of L [1/s], or None
    condition  condition number of K_f
    """

    K: Array
    kind: str
    reason: str
    generator: Array | None
    growth: float
    max_real: float | None
    condition: float


def half_step(
    theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array, kind: str = "auto", alpha: float = 0.0
) -> HalfStep:
    """Learn the half step of the known f from phase-space samples (paper, Algorithm 1, lines 1 and 2).

    ``scale`` (M,) are the column scales, ``alpha`` the ridge of this regression relative to the mean diagonal of its
    Gram matrix. "auto" takes the generator unless its eigenvalues are spurious (a half step grows by more than 10 %)
    and the flow grows less.
    Raises ValueError if the flow is asked for and the samples hold none, or one of another time step.
    """
    one_of(kind, "half_step", HALF_STEPS)
    if (samples.n_states, samples.n_inputs) != (theta.n_states, theta.n_inputs):
        raise ValueError(
            f"phase samples have {samples.n_states} states and {samples.n_inputs} inputs; "
            f"the dictionary expects {theta.n_states} and {theta.n_inputs}"
        )
    if kind == "flow":
        return _finish(flow_map(theta, samples, dt, scale, alpha), "flow", "asked for", None)
    generator = generator_edmd(theta, samples, scale, alpha)
    by_generator = scipy.linalg.expm(0.5 * dt * generator)
    if kind == "generator":
        return _finish(by_generator, "generator", "asked for", generator)
    growth = spectral_radius(by_generator)
    if growth <= SPURIOUS_GROWTH:
        return _finish(by_generator, "generator", f"its half step grows by {growth:.3g} at most", generator)
    if samples.x_half is None:
        warnings.warn(
            f"half_step='auto': the generator's half step grows by {growth:.3g} and the phase samples hold no flow; "
            "add x_half or raise generator_alpha",
            stacklevel=2,
        )
        return _finish(by_generator, "generator", "the samples hold no flow", generator)
    by_flow = flow_map(theta, samples, dt, scale, alpha)
    if spectral_radius(by_flow) < growth:
        return _finish(by_flow, "flow", f"the generator's half step grows by {growth:.3g}", generator)
    return _finish(by_generator, "generator", "the flow grows more", generator)


def generator_edmd(theta: Dictionary, samples: PhaseSamples, scale: Array, alpha: float = 0.0) -> Array:
    """L (M, M) with L Theta ~ J_x Theta . f on scaled columns (paper, eq. cont_koopman_solve) [1/s].

    f acts on the present: delays, inputs and the constant have zero rows, delays also zero columns. Inputs that do not
    vary over the samples have zero columns, because a constant input cannot be told from the constant.
    """

    def blocks() -> Iterator[tuple[Array, Array, Array]]:
        for part in samples.blocks():
            yield theta.present(part.x), theta.features(part.u), theta.present_derivative(part.x, part.xdot)

    return _known_rows(theta, blocks(), scale, alpha, np.zeros(theta.n_columns))


def flow_map(theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array, alpha: float = 0.0) -> Array:
    """K_f(dt/2) (M, M) by EDMD on the flow of f over dt/2 (paper, "Practical considerations"), on scaled columns."""
    if samples.x_half is None or samples.dt is None:
        raise ValueError("half_step='flow' needs phase samples with x_half; make them with flow=True and dt")
    if abs(samples.dt - dt) > 1e-9 * dt:
        raise ValueError(f"x_half is the flow over half of dt = {samples.dt:g} s; the trajectories have dt = {dt:g} s")

    def blocks() -> Iterator[tuple[Array, Array, Array]]:
        for part in samples.blocks():
            assert part.x_half is not None
            yield theta.present(part.x), theta.features(part.u), theta.present(part.x_half)

    return _known_rows(theta, blocks(), scale, alpha, np.ones(theta.n_columns))


def spectral_radius(matrix: Array) -> float:
    """Largest magnitude of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def _known_rows(
    theta: Dictionary, blocks: Iterator[tuple[Array, Array, Array]], scale: Array, alpha: float, diagonal: Array
) -> Array:
    """Regress the learned columns' targets on the present columns and the inputs; other rows are ``diagonal``."""
    present, learned = theta.n_present, theta.learned_columns
    features = np.arange(theta.n_lifted, theta.n_columns)
    moments = accumulate(np.hstack(block) for block in blocks)
    used = np.concatenate([np.arange(present), features])
    target_scale = scale[:present]
    moments = moments.scaled(np.concatenate([scale[used], target_scale]))
    varies = np.concatenate([np.ones(present, dtype=bool), _varying(moments, present, len(features))])
    matrix = np.diag(diagonal)
    matrix[learned] = 0.0
    columns, rows = np.flatnonzero(varies), len(used) + learned
    constant = theta.constant_column
    if constant is not None:
        columns = columns[columns != constant]
    data = moments.rows(centred=constant is not None)
    a, y = data[:, columns], data[:, rows]
    fit = ridge(a, y, alpha * float((a**2).sum()) / a.shape[1]).K
    matrix[np.ix_(learned, used[columns])] = fit
    if constant is not None:
        matrix[learned, constant] = (moments.mean[rows] - fit @ moments.mean[columns]) / moments.mean[constant]
    return matrix


def _varying(moments: Moments, first: int, size: int) -> NDArray[np.bool_]:
    part = slice(first, first + size)
    return np.asarray(moments.std[part] > 1e-10 * np.maximum(np.abs(moments.mean[part]), 1e-10))


def _finish(matrix: Array, kind: str, reason: str, generator: Array | None) -> HalfStep:
    condition = float(np.linalg.cond(matrix))
    if condition > SINGULAR:
        warnings.warn(
            f"cond(K_f) = {condition:.1e}: K_f^+ of the printed algorithm is meaningless; use penalty='ridge', which "
            "minimises the residual of the composed map",
            stacklevel=3,
        )
    max_real = None if generator is None else float(np.linalg.eigvals(generator).real.max())
    return HalfStep(matrix, kind, reason, generator, spectral_radius(matrix), max_real, condition)
