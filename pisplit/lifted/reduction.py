"""Smaller models: balanced truncation with its error bound."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from pisplit.brief import brief
from pisplit.checks import count, finite_array
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import refuse_bilinear

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: Modes that decay slower than this per step are kept as they are: a constant has the eigenvalue 1.
SLOW = 1.0 - 1e-9
DOUBLINGS = 60


@brief
@dataclass(frozen=True)
class Reduction:
    """A reduced model and how much it may differ.

    model            LiftedModel with r lifted states
    singular_values  (M - kept,) Hankel singular values of the decaying part, in decreasing order
    bound            twice the sum of those left out: the largest gain of the error at any frequency, from the features
                     (and the constant) to the states divided by ``state_range`` (Enns 1984; discrete time: Al-Saggaf,
                     Franklin 1987)
    kept             modes on or outside the unit circle, which are kept exactly
    """

    model: LiftedModel
    singular_values: Array
    bound: float
    kept: int

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Hankel singular values, kept and left out; written to ``path`` where one is given."""
        from pisplit.lifted.pictures import plot_reduction

        return plot_reduction(self, path)


def balanced_truncation(model: LiftedModel, r: int, starts: ArrayLike | None = None) -> Reduction:
    """The model with ``r`` lifted states, by square-root balanced truncation.

    States count relative to ``state_range``. ``starts`` (E, M) are lifted states from which roll-outs begin: they count
    as inputs that act before the first step; without them only what inputs excite is kept. Modes that do not decay are
    split off and kept exactly. Raises ValueError if r is above M or below the number of such modes, and for a model
    without inputs if no ``starts`` are given: nothing would be excited.
    """
    refuse_bilinear(model, "balanced truncation")
    size = model.n_lifted
    if count(r, "r") > size:
        raise ValueError(f"r = {r}; the model has {size} lifted states")
    if starts is None and model.n_inputs == 0:
        raise ValueError("the model has no inputs, so that nothing but its start moves it; give starts (E, M)")
    # Real Schur form with the modes that decay last; a Sylvester equation separates them from the others.
    schur, basis, kept = scipy.linalg.schur(model.A, sort=lambda re, im: np.hypot(re, im) > SLOW)
    if r < kept:
        raise ValueError(f"r = {r}; {kept} modes do not decay and are kept: give r >= {kept}, or fit a stable model")
    coupling = np.zeros((kept, size - kept))
    if 0 < kept < size:
        coupling = scipy.linalg.solve_sylvester(schur[:kept, :kept], -schur[kept:, kept:], -schur[:kept, kept:])
    right = basis @ np.block([[np.eye(kept), coupling], [np.zeros((size - kept, kept)), np.eye(size - kept)]])
    left = np.block([[np.eye(kept), -coupling], [np.zeros((size - kept, kept)), np.eye(size - kept)]]) @ basis.T
    inner = schur[kept:, kept:]
    drives = [model.B, model.c[:, None]]
    if starts is not None:
        points = finite_array(starts, "starts", (None, size))
        drives.append(points.T / np.sqrt(max(len(points), 1)))
    reach = _factor(inner, left[kept:] @ np.hstack(drives))
    observe = _factor(inner.T, (model.C / model.state_range[:, None] @ right[:, kept:]).T)
    u, values, vt = np.linalg.svd(observe.T @ reach, full_matrices=False)
    rank = int((values > np.finfo(float).eps * values.max(initial=0.0) * size).sum())
    order = min(r - kept, rank)
    weight = 1.0 / np.sqrt(values[:order])
    down = np.vstack([left[:kept], (weight[:, None] * (u[:, :order].T @ observe.T)) @ left[kept:]])
    up = np.hstack([right[:, :kept], right[:, kept:] @ (reach @ vt[:order].T * weight)])
    return Reduction(
        model=_projected(model, down, up),
        singular_values=values,
        bound=2.0 * float(values[order:].sum()),
        kept=int(kept),
    )


def _projected(model: LiftedModel, down: Array, up: Array) -> LiftedModel:
    """The model of w = down z, with z ~ up w."""
    delays = model.n_delays
    x = ca.MX.sym("x_history", model.n_states, delays + 1)
    u = ca.MX.sym("u_history", model.n_inputs, delays)
    lift = ca.Function("lift", [x, u], [ca.mtimes(ca.DM(down), model.lift_function(x, u))])
    return replace(
        model,
        A=down @ model.A @ up,
        B=down @ model.B,
        c=down @ model.c,
        C=model.C @ up,
        lift_function=lift,
        column_names=tuple(f"w{i + 1}" for i in range(len(down))),
        provenance={**model.provenance, "reduced_from": model.n_lifted},
    )


def _factor(a: Array, b: Array) -> Array:
    """S with S S^T = sum_k A^k B B^T (A^T)^k, by doubling; the Gramian itself would square the range of S."""
    factor, power = _compressed(b), a
    for _ in range(DOUBLINGS):
        added = power @ factor
        if np.linalg.norm(added) <= 1e-16 * np.linalg.norm(factor):
            break
        factor = _compressed(np.hstack([factor, added]))
        power = power @ power
    return factor


def _compressed(s: Array) -> Array:
    """The same Gramian with the fewest columns, to rounding."""
    u, values, _ = np.linalg.svd(s, full_matrices=False)
    kept = values > 1e-15 * values.max(initial=0.0)
    return np.asarray(u[:, kept] * values[kept])
