"""The known half step K_f(dt/2): generator EDMD and its exponential, or EDMD on the flow of f.

Generator EDMD after Klus, Nueske, Peitz et al., Physica D 406 (2020); paper, eq. cont_koopman_solve.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import one_of
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.generator.spectrum import Spectrum, spectrum
from pisplit.regression import ridge
from pisplit.regression.moments import Moments, accumulate
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]

HALF_STEPS = ("generator", "flow", "auto")
SPURIOUS_GROWTH = 1.1
SINGULAR = 1e12
#: A half step that misses more than this part of the movement of the flow does not follow it.
INCONSISTENT = 0.5
#: A sample rests if its columns move less than this part of their scale in a half step.
AT_REST = 1e-6
#: Largest movement of a resting sample, in scales of the columns, that goes without a warning.
DRIFT = 0.01
OR_RIDGE = ", or else penalty='ridge', which never inverts K_f"


@dataclass(frozen=True)
class HalfStep:
    """K_f(dt/2) (M, M) on columns divided by their scales, identity on the constant, on delays and on inputs.

    kind       "generator" or "flow"
    reason     why this kind was taken
    generator  L (M, M) on scaled columns [1/s], or None if the flow was asked for
    growth     spectral radius of K_f
    max_real   largest real part among the eigenvalues of L [1/s], or None
    condition  condition number of K_f
    spectrum   eigenpairs of L with their residuals, or None if the flow was asked for
    errors     part of the movement of the flow over dt/2 that each kind misses on the samples, where they hold it
    drift      largest movement, in scales of the columns, of samples at which f vanishes; None if there are none
    """

    K: Array
    kind: str
    reason: str
    generator: Array | None
    growth: float
    max_real: float | None
    condition: float
    spectrum: Spectrum | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    drift: float | None = None


def half_step(
    theta: Dictionary,
    samples: PhaseSamples,
    dt: float,
    scale: Array,
    kind: str = "auto",
    alpha: float = 0.0,
    inverted: bool = True,
) -> HalfStep:
    """Learn the half step of the known f from phase-space samples (paper, Algorithm 1, lines 1 and 2).

    ``scale`` (M,) are the column scales, ``alpha`` the ridge of this regression relative to the mean diagonal of its
    Gram matrix. "auto" takes the generator unless its eigenvalues are spurious (a half step grows by more than 10 %)
    and the flow grows less, or unless its half step misses more than half of the movement of the flow, of which the
    flow map misses less. Warns where K_f is singular to working precision (``inverted``: the regression of K_h will
    invert it, which matters to the advice) or moves a known equilibrium of f.
    Raises ValueError if the flow is asked for and the samples hold none, or one of another time step.
    """
    one_of(kind, "half_step", HALF_STEPS)
    _check(theta, samples)
    known: dict[str, Array] = {}
    generator: Array | None = None
    found: Spectrum | None = None
    if kind != "flow":
        moments = _generator_moments(theta, samples, scale)
        generator = _known_rows(theta, moments, alpha, np.zeros(theta.n_columns))
        known["generator"] = _exponential(theta, 0.5 * dt * generator)
        found = _spectrum(theta, generator, moments, scale)
    flow = None
    if kind == "flow" or (samples.x_half is not None and _same_step(samples, dt)):
        flow = _flow_moments(theta, samples, dt, scale)
        known["flow"] = _known_rows(theta, flow, alpha, np.ones(theta.n_columns))
    overflows = "generator" in known and not np.isfinite(known["generator"]).all()
    if overflows:
        assert found is not None
        fastest = f"it has eigenvalues up to {found.values.real.max():.1e} 1/s"
        if flow is None or kind == "generator":
            raise ValueError(
                f"the half step of the generator overflows: {fastest} over dt/2 = {0.5 * dt:g} s; take samples closer "
                "together, give d2 the flow (x_half) for half_step='flow', or use split='hold'"
            )
        del known["generator"]
    errors = {} if flow is None else {name: _miss(theta, matrix, flow) for name, matrix in known.items()}
    if overflows:
        taken, reason = "flow", f"the generator's half step overflows: {fastest}"
    else:
        taken, reason = (kind, "asked for") if kind != "auto" else _choose(theta, known, errors)
    matrix = known[taken]
    condition = _condition(theta, matrix)
    if condition > SINGULAR:
        warnings.warn(
            f"cond(K_f) = {condition:.1e}: f damps some columns to nothing in half a step, where K_f K_h K_f cannot "
            f"act; use split='hold'{OR_RIDGE if inverted else ''}",
            stacklevel=2,
        )
    drift = equilibrium_drift(theta, samples, dt, scale, matrix)
    if drift is not None and drift > DRIFT:
        warnings.warn(
            f"K_f moves an equilibrium of f by {drift:.2g} of the data's deviation in a half step; "
            "give d2 more samples about it, or a dictionary closer to closed under f",
            stacklevel=2,
        )
    return HalfStep(
        K=matrix,
        kind=taken,
        reason=reason,
        generator=generator,
        growth=_growth(theta, matrix),
        max_real=None if found is None else float(found.values.real.max()),
        condition=condition,
        spectrum=found,
        errors=errors,
        drift=drift,
    )


def generator_edmd(theta: Dictionary, samples: PhaseSamples, scale: Array, alpha: float = 0.0) -> Array:
    """L (M, M) with L Theta ~ J_x Theta . f on scaled columns (paper, eq. cont_koopman_solve) [1/s].

    f acts on the present: delays, inputs and the constant have zero rows, delays also zero columns. Inputs that do not
    vary over the samples have zero columns, because a constant input cannot be told from the constant.
    """
    _check(theta, samples)
    return _known_rows(theta, _generator_moments(theta, samples, scale), alpha, np.zeros(theta.n_columns))


def generator_spectrum(
    theta: Dictionary, samples: PhaseSamples, scale: Array | None = None, alpha: float = 0.0
) -> Spectrum:
    """Eigenvalues and eigenfunctions of the generator of f on the span of the dictionary, with residuals.

    ``scale`` (M,): column scales; default those of the samples, one a quantity. ``alpha`` as in :func:`half_step`.
    Delays take no part: they do not move with f.
    """
    _check(theta, samples)
    if scale is None:
        plain = _generator_moments(theta, samples, np.ones(theta.n_columns))
        used = _used(theta)
        scale = np.ones(theta.n_columns)
        scale[used] = column_scales(plain.std[: len(used)], [theta.column_quantities[i] for i in used])
    moments = _generator_moments(theta, samples, scale)
    generator = _known_rows(theta, moments, alpha, np.zeros(theta.n_columns))
    return _spectrum(theta, generator, moments, scale)


def flow_map(theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array, alpha: float = 0.0) -> Array:
    """K_f(dt/2) (M, M) by EDMD on the flow of f over dt/2 (paper, "Practical considerations"), on scaled columns."""
    _check(theta, samples)
    return _known_rows(theta, _flow_moments(theta, samples, dt, scale), alpha, np.ones(theta.n_columns))


def equilibrium_drift(theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array, matrix: Array) -> float | None:
    """Largest root-mean-square movement, in scales of the columns, that K_f gives to samples at which f vanishes.

    None if no sample rests. An exact half step keeps every equilibrium of f.
    """
    used, learned = _used(theta), theta.learned_columns
    worst = None
    for part in samples.blocks():
        speed = np.abs(theta.present_derivative(part.x, part.xdot)[:, learned] / scale[learned]).max(
            axis=1, initial=0.0
        )
        rest = np.flatnonzero(0.5 * dt * speed <= AT_REST)
        if len(rest) == 0:
            continue
        now = np.hstack([theta.present(part.x[rest]), theta.features(part.u[rest])]) / scale[used]
        moved = now @ matrix[np.ix_(learned, used)].T - now[:, learned]
        worst = max(worst or 0.0, float(np.sqrt((moved**2).mean(axis=1)).max()))
    return worst


def spectral_radius(matrix: Array) -> float:
    """Largest magnitude of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def _choose(theta: Dictionary, known: Mapping[str, Array], errors: Mapping[str, float]) -> tuple[str, str]:
    """Generator or flow map, and why."""
    growth = _growth(theta, known["generator"])
    if "flow" not in known:
        if growth <= SPURIOUS_GROWTH:
            return "generator", f"its half step grows by {growth:.3g} at most"
        warnings.warn(
            f"half_step='auto': the generator's half step grows by {growth:.3g} and the phase samples hold no flow "
            "over dt/2; add x_half or raise generator_alpha",
            stacklevel=3,
        )
        return "generator", "the samples hold no flow"
    flow_growth = _growth(theta, known["flow"])
    misses = f"the generator misses {errors['generator']:.2g} of the flow's movement, the flow map {errors['flow']:.2g}"
    if growth > SPURIOUS_GROWTH:
        if flow_growth < growth:
            return "flow", f"the generator's half step grows by {growth:.3g}"
        return "generator", "the flow grows more"
    sound = flow_growth <= max(growth, SPURIOUS_GROWTH)
    if errors["generator"] > INCONSISTENT and errors["flow"] < 0.5 * errors["generator"] and sound:
        return "flow", misses
    return "generator", f"its half step grows by {growth:.3g} at most; {misses}"


def _check(theta: Dictionary, samples: PhaseSamples) -> None:
    if (samples.n_states, samples.n_inputs) != (theta.n_states, theta.n_inputs):
        raise ValueError(
            f"phase samples have {samples.n_states} states and {samples.n_inputs} inputs; "
            f"the dictionary expects {theta.n_states} and {theta.n_inputs}"
        )
    if theta.is_bilinear:
        raise ValueError("the known half step is linear in Theta; leave ob.Bilinear to BilinearEDMDc")


def _used(theta: Dictionary) -> NDArray[np.int64]:
    """Columns that a phase sample has: the present ones and the input features, no delays."""
    return np.concatenate([np.arange(theta.n_present), np.arange(theta.n_lifted, theta.n_columns)])


def _exponential(theta: Dictionary, matrix: Array) -> Array:
    """exp of a generator: the identity on delays, which no other column depends on."""
    used = _used(theta)
    result = np.eye(len(matrix))
    with np.errstate(over="ignore", invalid="ignore"):
        result[np.ix_(used, used)] = scipy.linalg.expm(matrix[np.ix_(used, used)])
    return result


def _growth(theta: Dictionary, matrix: Array) -> float:
    """Spectral radius of a half step, of its block without delays, which are the identity."""
    used = _used(theta)
    radius = spectral_radius(matrix[np.ix_(used, used)])
    return max(radius, 1.0) if len(used) < len(matrix) else radius


def _condition(theta: Dictionary, matrix: Array) -> float:
    used = _used(theta)
    values = np.linalg.svd(matrix[np.ix_(used, used)], compute_uv=False)
    if len(used) < len(matrix):
        values = np.append(values, 1.0)
    return float(values.max() / values.min()) if values.min() > 0.0 else np.inf


def _generator_moments(theta: Dictionary, samples: PhaseSamples, scale: Array) -> Moments:
    """Moments of [present | features | derivative of present], scaled."""

    def rows(part: PhaseSamples) -> Array:
        return np.hstack(
            [theta.present(part.x), theta.features(part.u), theta.present_derivative(part.x, part.xdot)],
        )

    return _scaled(theta, weighted_moments((part.weights, rows(part)) for part in samples.blocks()), scale)


def _flow_moments(theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array) -> Moments:
    """Moments of [present | features | present after dt/2], scaled."""
    if samples.x_half is None or samples.dt is None:
        raise ValueError("half_step='flow' needs phase samples with x_half; make them with flow=True and dt")
    if not _same_step(samples, dt):
        raise ValueError(f"x_half is the flow over half of dt = {samples.dt:g} s; the trajectories have dt = {dt:g} s")

    def rows(part: PhaseSamples) -> Array:
        assert part.x_half is not None
        return np.hstack([theta.present(part.x), theta.features(part.u), theta.present(part.x_half)])

    return _scaled(theta, weighted_moments((part.weights, rows(part)) for part in samples.blocks()), scale)


def _same_step(samples: PhaseSamples, dt: float) -> bool:
    return samples.dt is not None and abs(samples.dt - dt) <= 1e-9 * dt


def _scaled(theta: Dictionary, moments: Moments, scale: Array) -> Moments:
    return moments.scaled(np.concatenate([scale[_used(theta)], scale[: theta.n_present]]))


def weighted_moments(blocks: Iterator[tuple[Array | None, Array]]) -> Moments:
    """Moments of rows (N_i, k) that arrive in blocks with weights (N_i,), or with None for equal weights."""
    first = next(blocks, None)
    parts = blocks if first is None else chain([first], blocks)
    if first is None or first[0] is None:
        return accumulate(rows for _, rows in parts)
    plain = accumulate(
        np.sqrt(weights)[:, None] * np.hstack([np.ones((len(rows), 1)), rows])
        for weights, rows in parts
        if weights is not None
    )
    # Orthogonal to the weighted column of ones, the rest is the factor about the weighted mean.
    triangle = np.asarray(np.linalg.qr(plain.rows(centred=False), mode="r"))
    total = float(triangle[0, 0] ** 2)
    return Moments(
        n_samples=plain.n_samples,
        mean=triangle[0, 1:] / triangle[0, 0],
        factor=triangle[1:, 1:] * np.sqrt(plain.n_samples / total),
    )


def _spectrum(theta: Dictionary, generator: Array, moments: Moments, scale: Array) -> Spectrum:
    used = _used(theta)
    data = moments.rows(centred=False)
    lie = np.zeros((len(data), len(used)))
    lie[:, : theta.n_present] = data[:, len(used) :]
    names = [theta.column_names[i] for i in used]
    found = spectrum(generator[np.ix_(used, used)], data[:, : len(used)], lie, scale[used], names, moments.n_samples)
    functions = np.zeros((len(found.values), theta.n_columns), dtype=np.complex128)
    functions[:, used] = found.functions
    return replace(found, functions=functions)


def _miss(theta: Dictionary, matrix: Array, flow: Moments) -> float:
    """Part of the movement over dt/2 that a half step misses on the samples."""
    used, learned = _used(theta), theta.learned_columns
    data = flow.rows(centred=False)
    now, after = data[:, : len(used)], data[:, len(used) + learned]
    movement = float(np.linalg.norm(after - now[:, learned]))
    miss = float(np.linalg.norm(after - now @ matrix[np.ix_(learned, used)].T))
    return miss / movement if movement > 0.0 else 0.0


def _known_rows(theta: Dictionary, moments: Moments, alpha: float, diagonal: Array) -> Array:
    """Regress the learned columns' targets on the present columns and the inputs; other rows are ``diagonal``."""
    present, learned, used = theta.n_present, theta.learned_columns, _used(theta)
    varies = np.concatenate([np.ones(present, dtype=bool), _varying(moments, present, theta.n_features)])
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
