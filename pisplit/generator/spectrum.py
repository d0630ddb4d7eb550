"""Eigenvalues and eigenfunctions of a generator, with a residual that tells the spurious ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative residual from which an eigenpair counts as spurious.
SPURIOUS_RESIDUAL = 0.1
#: Rates below this part of the fastest are rounding.
RATE_FLOOR = 1e-9
#: A function this small on all samples, relative to its coefficients, is zero.
VANISHING = 1e-10


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
        """One text for every spurious eigenpair, the fastest growing first."""
        found = np.flatnonzero(self.spurious(tolerance))
        order = found[np.argsort(-self.values[found].real, kind="stable")]
        return tuple(
            f"{_text(self.values[i])} 1/s with residual {self.residuals[i]:.2g}, mostly {self.columns[i]}"
            for i in order
        )


def spectrum(
    generator: Array, theta: Array, lie: Array, scale: Array, names: Sequence[str], n_samples: int
) -> Spectrum:
    """Eigenpairs of ``generator`` (M, M), which maps scaled columns, with residuals on data.

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
