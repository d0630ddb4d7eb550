"""Eigenvalues and eigenfunctions of a generator, with a residual that tells the spurious ones."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.generator.generator import (
    PLAIN,
    KnownOptions,
    check_samples,
    generator_moments,
    regressed_generator,
    static_columns,
)
from pisplit.regression.moments import Moments
from pisplit.regression.scaling import column_scales

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative residual from which an eigenpair counts as spurious.
SPURIOUS_RESIDUAL = 0.1
#: Rates below this part of the fastest are rounding.
RATE_FLOOR = 1e-9
#: A function this small on all samples, relative to its coefficients, is zero.
VANISHING = 1e-10


@brief
@dataclass(frozen=True)
class Spectrum:
    """Eigenpairs L phi_i = lambda_i phi_i of a generator on the span of Theta, best residual first.

    values     (K,) lambda [1/s]
    functions  (K, M) coefficients of phi_i = functions[i] Theta(x, u), mean square 1 over the samples
    absolute   (K,) |L phi - lambda phi| / |phi| over the samples [1/s]: lambda is an eigenvalue of an operator that
               differs from the true one by no more than that (Colbrook and Townsend, Comm. Pure Appl. Math. 77, 2024)
    residuals  (K,) the same relative to |L phi| / |phi| + |lambda|: 0 for an eigenfunction, at most 1
    columns    (K,) name of the column with the largest part in phi_i
    """

    values: Complex
    functions: Complex
    absolute: Array
    residuals: Array
    columns: tuple[str, ...]

    def spurious(self, tolerance: float = SPURIOUS_RESIDUAL) -> NDArray[np.bool_]:
        """Eigenpairs (K,) whose relative residual exceeds the tolerance: products of the projection, not of f."""
        return np.asarray(self.residuals > tolerance)

    def report(self, tolerance: float = SPURIOUS_RESIDUAL) -> tuple[str, ...]:
        """One text for every eigenpair that is spurious by ``tolerance``, the fastest growing first."""
        found = np.flatnonzero(self.spurious(tolerance))
        order = found[np.argsort(-self.values[found].real, kind="stable")]
        return tuple(
            f"{_text(self.values[i])} 1/s with residual {self.residuals[i]:.2g}, mostly {self.columns[i]}"
            for i in order
        )

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues coloured by residual; written to ``path`` where one is given."""
        from pisplit.generator.pictures import plot_spectrum

        return plot_spectrum(self, path)


def generator_spectrum(
    theta: Dictionary,
    samples: PhaseSamples,
    scale: Array | None = None,
    alpha: float = 0.0,
    options: KnownOptions = PLAIN,
) -> Spectrum:
    """Eigenvalues and eigenfunctions of the generator of f on the span of the dictionary, with residuals.

    ``theta``: dictionary of M columns; ``samples``: D2; ``scale`` (M,): column scales, default those of the samples,
    one a quantity; ``alpha`` and ``options`` as in :func:`pisplit.generator.generator_edmd`. Delays take no part where
    the samples have no past: they do not move with f.
    """
    check_samples(theta, samples)
    used = static_columns(theta, options)
    if scale is None:
        plain = generator_moments(theta, samples, np.ones(theta.n_columns), options)
        scale = np.ones(theta.n_columns)
        scale[used] = column_scales(plain.std[: len(used)], [theta.column_quantities[i] for i in used])
    moments = generator_moments(theta, samples, scale, options)
    return spectrum_on(theta, regressed_generator(theta, moments, scale, alpha, options), moments, scale, options)


def spectrum_on(theta: Dictionary, generator: Array, moments: Moments, scale: Array, options: KnownOptions) -> Spectrum:
    """Eigenpairs of ``generator`` (M, M) on columns of ``theta`` divided by ``scale`` (M,).

    Residuals are those on the samples of ``moments`` (:func:`pisplit.generator.generator.generator_moments`), in whose
    columns, the static ones of ``options``, eigenfunctions are sought.
    """
    used = static_columns(theta, options)
    data = moments.rows(centred=False)
    lie = np.zeros((len(data), len(used)))
    lie[:, : theta.n_present] = data[:, len(used) :]
    names = [theta.column_names[i] for i in used]
    found = spectrum(generator[np.ix_(used, used)], data[:, : len(used)], lie, scale[used], names, moments.n_samples)
    functions = np.zeros((len(found.values), theta.n_columns), dtype=np.complex128)
    functions[:, used] = found.functions
    return replace(found, functions=functions)


def spectral_radius(matrix: Array) -> float:
    """Largest magnitude of an eigenvalue of ``matrix`` (M, M)."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def spectrum(
    generator: Array, theta: Array, lie: Array, scale: Array, names: Sequence[str], n_samples: int
) -> Spectrum:
    """Eigenpairs of ``generator`` (M, M), which maps scaled columns, with residuals on data.

    ``names`` (M,) are those of the columns, ``n_samples`` is the number of samples behind the rows.

    theta (r, M) and lie (r, M) are Theta / scale and J Theta . f / scale, a sample a row, or a triangular factor of
    both side by side: with G = Theta^T Theta, A = Theta^T (J Theta f), L = (J Theta f)^T (J Theta f) the squared
    residual is phi* (L - conj(lambda) A - lambda A^T + |lambda|^2 G) phi / phi* G phi. The factor gives it without
    forming L, whose condition number is the square of that of the data.
    """
    values, vectors = np.linalg.eig(generator.T)
    values, vectors = values.astype(np.complex128), vectors.astype(np.complex128)
    function, derivative = theta @ vectors, lie @ vectors
    size = np.linalg.norm(function, axis=0)
    miss = np.linalg.norm(derivative - values * function, axis=0)
    vanishing = size <= VANISHING * float(np.linalg.norm(theta)) * np.linalg.norm(vectors, axis=0)
    size = np.where(vanishing, 1.0, size)
    absolute = np.where(vanishing, np.inf, miss / size)
    speed = np.linalg.norm(derivative, axis=0) / size + np.abs(values)
    floor = max(RATE_FLOOR * float(np.abs(values).max(initial=0.0)), np.finfo(float).tiny)
    residuals = np.where(vanishing, 1.0, miss / size / np.maximum(speed, floor))
    order = np.argsort(residuals, kind="stable")
    functions = (vectors / scale[:, None] * (np.sqrt(n_samples) / size))[:, order].T
    largest = np.abs(vectors).argmax(axis=0)[order]
    return Spectrum(
        values=values[order],
        functions=functions,
        absolute=absolute[order],
        residuals=residuals[order],
        columns=tuple(names[i] for i in largest),
    )


def _text(value: complex) -> str:
    return f"{value.real:.3g}{value.imag:+.3g}j" if value.imag else f"{value.real:.3g}"
