"""Spectrum of an identified model: Koopman modes in the units of the states."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.lifted.model import LiftedModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@brief
@dataclass(frozen=True)
class Modes:
    """Eigenvalues of A, slowest decay first, and what each of them does to the states.

    eigenvalues     (M,) of A, one step
    rates           (M,) log(eigenvalue) / dt [1/s]; -inf for eigenvalues that are zero
    frequencies     (M,) [Hz]
    damping         (M,) damping ratio: 1 does not oscillate, 0 does not decay, negative grows
    time_constants  (M,) [s] of the decay; negative for growth, infinite on the unit circle
    shapes          (n, M) Koopman modes C v, in units of the states, for eigenvectors v of length 1
    eigenfunctions  (M, M) rows w with w z -> eigenvalue w z, w v = 1 for the v of the same mode
    condition       condition number of the eigenvectors: large if modes are nearly parallel and cannot be told apart
    """

    eigenvalues: Complex
    rates: Complex
    frequencies: Array
    damping: Array
    time_constants: Array
    shapes: Complex
    eigenfunctions: Complex
    condition: float

    @property
    def radius(self) -> float:
        """Largest magnitude of an eigenvalue: above 1 the model is unstable."""
        return float(np.abs(self.eigenvalues).max())

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues in the unit circle, frequencies and time constants; written to ``path`` where one is given."""
        from pisplit.lifted.pictures import plot_modes

        return plot_modes(self, path)


def modes(model: LiftedModel) -> Modes:
    """Koopman eigenvalues, eigenfunctions and modes of a model (Mezic, Spectral properties of dynamical systems, 2005).

    Of a bilinear model they are those at u = 0. If A is defective the eigenfunctions are those of a pseudo-inverse and
    ``condition`` is huge. Raises ValueError for a re-lifted model, whose A is a part of its step only.
    """
    refuse_relifted(model, "spectrum for all states")
    values, vectors = np.linalg.eig(model.A)
    order = np.lexsort((-values.imag, -np.abs(values)))
    values, vectors = values[order].astype(np.complex128), vectors[:, order].astype(np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.where(values == 0.0, -np.inf, np.log(np.where(values == 0.0, 1.0, values)) / model.dt)
        size = np.abs(rates)
        damping = np.where(np.isfinite(size) & (size > 0.0), -rates.real / size, np.where(size > 0.0, 1.0, 0.0))
        constants = -1.0 / rates.real
    return Modes(
        eigenvalues=values,
        rates=rates,
        frequencies=np.abs(rates.imag) / (2.0 * np.pi),
        damping=damping,
        time_constants=constants,
        shapes=model.C @ vectors,
        eigenfunctions=np.linalg.pinv(vectors),
        condition=float(np.linalg.cond(vectors)),
    )


def refuse_bilinear(model: LiftedModel, what: str) -> None:
    """Raises ValueError, with ``what`` only linear ones have in its line, for a bilinear or re-lifted ``model``."""
    if model.varies:
        kind = "bilinear" if model.relifted is None else "re-lifted"
        raise ValueError(f"the model is {kind}; {what} needs one that is linear in the lifted state and the features")


def refuse_relifted(model: LiftedModel, what: str) -> None:
    """Raises ValueError for a re-lifted ``model``; ``what`` is what it does not have, for the message."""
    if model.relifted is not None:
        raise ValueError(f"the model is re-lifted: its step is not linear in z, and it has no {what}")
