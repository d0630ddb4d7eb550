"""Which eigenvalues of a fitted model to believe: residuals of its eigenpairs on pairs that it did not learn from."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pisplit.brief import brief
from pisplit.checks import positive
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, matched, model_of
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import refuse_relifted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative residual in one step from which an eigenpair counts as spurious.
SPURIOUS = 0.1
#: An eigenfunction that varies less than this, in parts of its size, is constant on the pairs.
CONSTANT = 1e-9


@brief
@dataclass(frozen=True, eq=False)
class ModelSpectrum:
    """Eigenpairs phi(z+) = lambda phi(z) + inputs of a fitted model, best residual first.

    Attributes:
        eigenvalues: (M,) of A, one step.
        rates: (M,) log(eigenvalue) / dt in 1/s; -inf for eigenvalues that are zero.
        functions: (M, M) rows w of the eigenfunctions phi = w z, w A = lambda w.
        residuals: (M,) root mean square over the pairs of phi(z+) - lambda phi(z) - what inputs add, in parts of the
            spread of phi: 0 of a function that moves as its eigenvalue says; lambda is an eigenvalue of an operator
            that differs from the true one by no more than this.
        columns: (M,) name of the column with the largest part in phi over the pairs.
        pairs: number of pairs.
        dt: time step in s.
    """

    eigenvalues: Complex
    rates: Complex
    functions: Complex
    residuals: Array
    columns: tuple[str, ...]
    pairs: int
    dt: float

    def spurious(self, tolerance: float = SPURIOUS) -> NDArray[np.bool_]:
        """Eigenpairs (M,) whose residual exceeds the ``tolerance``: of the dictionary or of noise."""
        return np.asarray(self.residuals > positive(tolerance, "tolerance"))

    def report(self, tolerance: float = SPURIOUS) -> str:
        """One line an oscillation or decay with a residual within ``tolerance``, slowest first; how many have none."""
        good = np.flatnonzero(~self.spurious(tolerance) & (self.eigenvalues.imag >= 0.0))
        order = good[np.argsort(-np.abs(self.eigenvalues[good]), kind="stable")]
        lines = [
            f"{int(self.spurious(tolerance).sum())} of {len(self.residuals)} eigenvalues are spurious by {tolerance:g}"
        ]
        for i in order:
            rate = self.rates[i]
            what = f"{abs(rate.imag) / (2.0 * np.pi):.3g} Hz, " if rate.imag else ""
            time = f"{-1.0 / rate.real:.3g} s" if np.isfinite(rate.real) and rate.real else "no decay"
            gone = "one step" if not np.isfinite(rate.real) else time
            lines.append(f"  {what}time constant {gone}, residual {self.residuals[i]:.2g}, mostly {self.columns[i]}")
        return "\n".join(lines)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Eigenvalues in the unit circle by their residuals; written to ``path`` where one is given."""
        from pisplit.evaluation.pictures import plot_model_spectrum

        return plot_model_spectrum(self, path)


def model_spectrum(model: LiftedModel | Fitted, episodes: Episodes) -> ModelSpectrum:
    """Eigenvalues of a fitted model, each with the residual of its eigenfunction on recorded pairs.

    A regression gives as many eigenvalues as its dictionary has columns, and a one-step error or a roll-out does not
    say which of them the system has. The residual does: it is how far the eigenfunction is from moving as the
    eigenvalue says under the recorded inputs. Give recordings that the model did not learn from: on its own pairs,
    where these are few, it misses hardly anything.

    Args:
        model: linear or bilinear, or an estimator that has one; of a bilinear one they are those at u = 0.
        episodes: recordings with its columns.

    Raises ValueError for a re-lifted model, whose step is not linear, and for recordings of another system.

    Source: residual dynamic mode decomposition, Colbrook, Townsend, Comm. Pure Appl. Math. 77 (2024), section 3, here
    for the left eigenvectors of a model with inputs, whose part is taken off.
    """
    found = model_of(model)
    refuse_relifted(found, "eigenvalues to judge")
    pairs = matched(found, episodes).pairs(found.n_delays)
    delays = pairs.n_delays
    z = found.lift(pairs.x_history, pairs.u_history)
    after_x = pairs.states[pairs.row[:, None] + np.arange(1 - delays, 2)]
    after_u = pairs.inputs[pairs.input_row[:, None] + np.arange(1 - delays, 1)]
    missed = found.lift(after_x, after_u) - found.rollout(z, pairs.u[:, None]).z[:, 1]
    values, vectors = np.linalg.eig(found.A.T)
    values, vectors = values.astype(np.complex128), vectors.astype(np.complex128)
    phi = z @ vectors
    size = np.sqrt((np.abs(phi) ** 2).mean(axis=0))
    spread = np.sqrt((np.abs(phi - phi.mean(axis=0)) ** 2).mean(axis=0))
    spread = np.where(spread > CONSTANT * size, spread, size)
    miss = np.sqrt((np.abs(missed @ vectors) ** 2).mean(axis=0))
    residuals = np.where(spread > 0.0, miss / np.where(spread > 0.0, spread, 1.0), np.inf)
    parts = np.abs(vectors) * z.std(axis=0)[:, None]
    order = np.argsort(residuals, kind="stable")
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.where(values == 0.0, -np.inf, np.log(np.where(values == 0.0, 1.0, values)) / found.dt)
    return ModelSpectrum(
        eigenvalues=values[order],
        rates=rates[order],
        functions=vectors.T[order],
        residuals=residuals[order],
        columns=tuple(found.column_names[i] for i in parts.argmax(axis=0)[order]),
        pairs=len(pairs),
        dt=found.dt,
    )
