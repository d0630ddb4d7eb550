"""The known half step K_f(dt/2): exponential of the generator, its first order, or EDMD on the flow of f."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.checks import check_same_step, one_of, same_step
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.generator.generator import (
    PLAIN,
    KnownOptions,
    check_samples,
    generator_moments,
    regressed_generator,
    regressed_rows,
    static_columns,
    static_moments,
    static_rows,
)
from pisplit.generator.spectrum import Spectrum, spectral_radius, spectrum_on
from pisplit.regression.moments import Moments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

HALF_STEPS = ("generator", "first-order", "flow", "auto")
SPURIOUS_GROWTH = 1.1
SINGULAR = 1e12
#: A half step that misses more than this part of the movement of the flow does not follow it.
INCONSISTENT = 0.5
#: A sample rests if its columns move less than this part of their scale in a half step.
AT_REST = 1e-6
#: Largest movement of a resting sample, in scales of the columns, that goes without a warning.
DRIFT = 0.01
OR_RIDGE = ", or else penalty='ridge', which never inverts K_f"


@brief
@dataclass(frozen=True)
class HalfStep:
    """The known half step, on columns divided by their scales.

    K          K_f(dt/2) (M, M), identity on the constant, on delays and on inputs
    kind       "generator", "first-order" or "flow"
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

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues of K_f beside those of its generator; written to ``path`` where one is given."""
        from pisplit.generator.pictures import plot_half_step

        return plot_half_step(self, path)


def half_step(
    theta: Dictionary,
    samples: PhaseSamples,
    dt: float,
    scale: Array,
    kind: str = "auto",
    alpha: float = 0.0,
    inverted: bool = True,
    options: KnownOptions = PLAIN,
) -> HalfStep:
    """Learn the half step of the known f from phase-space samples (paper, alg:pi-edmdc, lines 1 and 2).

    ``theta``: dictionary of M columns; ``samples``: D2; ``dt`` [s]: the whole step; ``scale`` (M,): column scales;
    ``alpha``: weight of the penalty of this regression, by default a ridge relative to the mean diagonal of its Gram
    matrix; ``options``: other penalties, rows of f that are known.

    ``kind``: "generator" (its exponential), "first-order" (I + dt/2 L), "flow" (EDMD on the flow of f, which the
    samples then must hold), or "auto": the generator unless its eigenvalues are spurious (a half step grows by more
    than 10 %) and the flow grows less, or unless its half step misses more than half of the movement of the flow, of
    which the flow map misses less. Known rows are of the generator: no flow map stands beside them.

    Warns where K_f is singular to working precision (``inverted``: the regression of K_h will invert it, which matters
    to the advice) or moves a known equilibrium of f. Raises ValueError if the flow is asked for and the samples hold
    none, or one of another time step, and where an exponential overflows with no flow to take its place.
    """
    one_of(kind, "half_step", HALF_STEPS)
    check_samples(theta, samples)
    if kind == "flow" and options.rows:
        raise ValueError("known rows are rows of the generator, half_step='flow' has none; leave one of them out")
    known: dict[str, Array] = {}
    generator, found, flow = None, None, None
    if kind != "flow":
        moments = generator_moments(theta, samples, scale, options)
        generator = regressed_generator(theta, moments, scale, alpha, options)
        found = spectrum_on(theta, generator, moments, scale, options)
        if kind == "first-order":
            known["first-order"] = np.eye(theta.n_columns) + 0.5 * dt * generator
        else:
            known["generator"] = exponential(theta, 0.5 * dt * generator, options)
    if kind == "flow" or (
        not options.rows and samples.x_half is not None and samples.dt is not None and same_step(samples.dt, dt)
    ):
        flow = _flow_moments(theta, samples, dt, scale, options)
        if kind != "first-order":
            known["flow"] = regressed_rows(theta, flow, alpha, np.ones(theta.n_columns), options)
    errors = {} if flow is None else {name: _miss(theta, matrix, flow, options) for name, matrix in known.items()}
    taken, reason = _taken(theta, known, errors, kind, dt, found, options)
    matrix = known[taken]
    condition, drift = _condition(theta, matrix, options), equilibrium_drift(theta, samples, dt, scale, matrix, options)
    _warn(condition, drift, inverted)
    return HalfStep(
        K=matrix,
        kind=taken,
        reason=reason,
        generator=generator,
        growth=_growth(theta, matrix, options),
        max_real=None if found is None else float(found.values.real.max()),
        condition=condition,
        spectrum=found,
        errors={name: error for name, error in errors.items() if np.isfinite(error)},
        drift=drift,
    )


def exponential(theta: Dictionary, matrix: Array, options: KnownOptions = PLAIN) -> Array:
    """K = e^(t L) (M, M) of ``matrix`` t L by scaling and squaring (paper, eq. matrix_exp; Al-Mohy and Higham, 2009).

    It is the identity on delays of ``theta``, which no other column depends on where ``options`` have no past.
    """
    used = static_columns(theta, options)
    result = np.eye(len(matrix))
    with np.errstate(over="ignore", invalid="ignore"):
        result[np.ix_(used, used)] = scipy.linalg.expm(matrix[np.ix_(used, used)])
    return result


def flow_map(
    theta: Dictionary,
    samples: PhaseSamples,
    dt: float,
    scale: Array,
    alpha: float = 0.0,
    options: KnownOptions = PLAIN,
) -> Array:
    """K_f(dt/2) (M, M) by EDMD on the flow of f over dt/2 (paper, "Evaluation of K_f"), on scaled columns.

    ``theta``: dictionary; ``samples``: D2 with x_half; ``dt`` [s]; ``scale`` (M,); ``alpha`` and ``options``: the
    penalty. Raises ValueError for samples without a flow, or with one of another time step.
    """
    check_samples(theta, samples)
    return regressed_rows(
        theta, _flow_moments(theta, samples, dt, scale, options), alpha, np.ones(theta.n_columns), options
    )


def equilibrium_drift(
    theta: Dictionary,
    samples: PhaseSamples,
    dt: float,
    scale: Array,
    matrix: Array,
    options: KnownOptions = PLAIN,
) -> float | None:
    """Largest root-mean-square movement, in scales of the columns, that K_f gives to samples at which f vanishes.

    ``matrix`` is K_f (M, M) over half of ``dt`` [s] on columns of ``theta`` divided by ``scale`` (M,), ``options``
    those it was made with. None if none of the ``samples`` rests. An exact half step keeps every equilibrium of f.
    """
    used, learned = static_columns(theta, options), theta.learned_columns
    worst = None
    for part in samples.blocks():
        speed = np.abs(theta.present_derivative(part.x, part.xdot)[:, learned] / scale[learned]).max(
            axis=1, initial=0.0
        )
        rest = np.flatnonzero(0.5 * dt * speed <= AT_REST)
        if len(rest) == 0:
            continue
        now = static_rows(theta, part.take(rest), options) / scale[used]
        moved = now @ matrix[np.ix_(learned, used)].T - now[:, learned]
        worst = max(worst or 0.0, float(np.sqrt((moved**2).mean(axis=1)).max()))
    return worst


def _taken(
    theta: Dictionary,
    known: Mapping[str, Array],
    errors: Mapping[str, float],
    kind: str,
    dt: float,
    found: Spectrum | None,
    options: KnownOptions,
) -> tuple[str, str]:
    """The kind of half step that serves, and why; raises ValueError where none does."""
    if "generator" in known and not np.isfinite(known["generator"]).all():
        assert found is not None
        fastest = f"it has eigenvalues up to {found.values.real.max():.1e} 1/s"
        if "flow" in known and kind == "auto":
            return "flow", f"the generator's half step overflows: {fastest}"
        raise ValueError(
            f"the half step of the generator overflows: {fastest} over dt/2 = {0.5 * dt:g} s; take samples closer "
            "together, give d2 the flow (x_half) for half_step='flow', or use split='hold'"
        )
    if kind != "auto":
        return kind, "asked for"
    growth = _growth(theta, known["generator"], options)
    if "flow" not in known:
        if growth > SPURIOUS_GROWTH:
            warnings.warn(
                f"half_step='auto': the generator's half step grows by {growth:.3g} and the phase samples hold no flow "
                "over dt/2; add x_half or raise generator_alpha",
                stacklevel=4,
            )
            return "generator", "the samples hold no flow"
        return "generator", f"its half step grows by {growth:.3g} at most"
    return _better(growth, _growth(theta, known["flow"], options), errors)


def _better(growth: float, flow_growth: float, errors: Mapping[str, float]) -> tuple[str, str]:
    """Generator or flow map by their growth and by what they miss, and why."""
    misses = f"the generator misses {errors['generator']:.2g} of the flow's movement, the flow map {errors['flow']:.2g}"
    if growth > SPURIOUS_GROWTH:
        if flow_growth < growth:
            return "flow", f"the generator's half step grows by {growth:.3g}"
        return "generator", "the flow grows more"
    sound = flow_growth <= max(growth, SPURIOUS_GROWTH)
    if errors["generator"] > INCONSISTENT and errors["flow"] < 0.5 * errors["generator"] and sound:
        return "flow", misses
    return "generator", f"its half step grows by {growth:.3g} at most; {misses}"


def _warn(condition: float, drift: float | None, inverted: bool) -> None:
    """Warn of a K_f that is singular, or that moves an equilibrium of f."""
    if condition > SINGULAR:
        warnings.warn(
            f"cond(K_f) = {condition:.1e}: f damps some columns to nothing in half a step, where K_f K_h K_f cannot "
            f"act; use split='hold'{OR_RIDGE if inverted else ''}",
            stacklevel=3,
        )
    if drift is not None and drift > DRIFT:
        warnings.warn(
            f"K_f moves an equilibrium of f by {drift:.2g} of the data's deviation in a half step; "
            "give d2 more samples about it, or a dictionary closer to closed under f",
            stacklevel=3,
        )


def _flow_moments(theta: Dictionary, samples: PhaseSamples, dt: float, scale: Array, options: KnownOptions) -> Moments:
    """Moments of [static columns | present columns after dt/2], scaled."""
    if samples.x_half is None or samples.dt is None:
        raise ValueError("half_step='flow' needs phase samples with x_half; make them with flow=True and dt")
    check_same_step(samples.dt, dt, "the flow x_half of the phase samples has", "the trajectories")

    def after(part: PhaseSamples) -> Array:
        assert part.x_half is not None
        return theta.present(part.x_half)

    return static_moments(theta, samples, scale, options, "flow", after)


def _growth(theta: Dictionary, matrix: Array, options: KnownOptions) -> float:
    """Spectral radius of a half step, of its block of static columns; the others are the identity."""
    used = static_columns(theta, options)
    radius = spectral_radius(matrix[np.ix_(used, used)])
    return max(radius, 1.0) if len(used) < len(matrix) else radius


def _condition(theta: Dictionary, matrix: Array, options: KnownOptions) -> float:
    used = static_columns(theta, options)
    values = np.linalg.svd(matrix[np.ix_(used, used)], compute_uv=False)
    if len(used) < len(matrix):
        values = np.append(values, 1.0)
    return float(values.max() / values.min()) if values.min() > 0.0 else np.inf


def _miss(theta: Dictionary, matrix: Array, flow: Moments, options: KnownOptions) -> float:
    """Part of the movement over dt/2 that a half step misses on the samples; infinite for one that overflows."""
    if not np.isfinite(matrix).all():
        return np.inf
    used, learned = static_columns(theta, options), theta.learned_columns
    data = flow.rows(centred=False)
    now, after = data[:, : len(used)], data[:, len(used) + learned]
    movement = float(np.linalg.norm(after - now[:, learned]))
    miss = float(np.linalg.norm(after - now @ matrix[np.ix_(learned, used)].T))
    return miss / movement if movement > 0.0 else 0.0
