"""Does a model stay bounded? A bound on its spectral radius, and roll-outs under the inputs it is made for.

The bound leaves the exact rows of an operator, delays and the constant, as they are. Excitations need no recording of
the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array
from pisplit.data.episodes import Pairs
from pisplit.dictionary.dictionary import Dictionary
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.operators import operators, state_range
from pisplit.lifted.radius import limited_blocks
from pisplit.splitting import SplitFit

Array = NDArray[np.float64]

#: Learned rows reach a mode if its left vectors, of length one, keep this much of it on them.
REACHED = 1e-6
#: What rounding may add to the radius.
SLACK = 1e-9
#: A model that takes a state so many times as far as the data of its quantity reach is not bounded: inputs of the
#: recorded kind do not move a stable system there, and a model that goes so far is on its way to where it diverges.
EXCURSION = 3.0
#: Roll-outs side by side.
BATCH = 16


@dataclass(frozen=True)
class Excitation:
    """Roll-outs that a model has to survive: E input sequences from states of the data.

    inputs     (E, T, m)
    x_history  (E, D+1, n) and u_history (E, D, m), where each begins: the pair of the data with the most similar input
    limit      (n,) magnitude that no state may exceed
    """

    inputs: Array
    x_history: Array
    u_history: Array
    limit: Array

    @classmethod
    def of(cls, inputs: ArrayLike, data: Sequence[Pairs], quantities: Sequence[str]) -> Excitation:
        """Input sequences (E, T, m) beginning in the largest of ``data``; limits from all of them.

        ``quantities`` (n,) are those of the states: states of one quantity share a limit.

        Raises ValueError for inputs of another shape.
        """
        sequences = finite_array(inputs, "excitation", (None, None, data[0].inputs.shape[1]))
        if 0 in sequences.shape:
            raise ValueError(f"excitation has the shape {sequences.shape}; expected input sequences (E, T, m)")
        starts = max(data, key=len)
        u = starts.u
        nearest = starts.take([int(np.argmin(((u - first) ** 2).sum(axis=1))) for first in sequences[:, 0]])
        return cls(
            inputs=sequences,
            x_history=nearest.x_history,
            u_history=nearest.u_history,
            limit=EXCURSION * np.max([state_range(pairs, quantities) for pairs in data], axis=0),
        )

    def bounds(self, model: LiftedModel) -> bool:
        """True if no state of any roll-out of ``model`` exceeds its limit."""
        starts = [model.lift(x, u) for x, u in zip(self.x_history, self.u_history, strict=True)]
        for first in range(0, len(starts), BATCH):  # most models that are not bounded show it at once
            part = slice(first, first + BATCH)
            found = model.rollout(np.stack(starts[part]), self.inputs[part])
            if np.any(found.diverged) or np.any(np.abs(found.x) > self.limit):
                return False
        return True


def limited(fit: SplitFit, theta: Dictionary, scale: Array, bound: float) -> SplitFit:
    """``fit`` with the spectral radius of A at most ``bound``; ``details`` keep the radius before.

    ``theta`` is its dictionary of M columns, ``scale`` (M,) are their units.
    """
    if not np.isfinite(fit.K).all():
        return fit
    before = transition_radius(theta, fit.K)
    if before <= bound * (1.0 + SLACK):
        return fit
    return replace(fit, K=limited_rows(theta, fit.K, scale, bound), details={**fit.details, "unbounded_radius": before})


def transition_radius(theta: Dictionary, k: Array) -> float:
    """Spectral radius of A for the learned rows ``k`` (S, M) of ``theta``.

    The constant (its eigenvalue is 1) and past inputs (theirs are 0) are left out.
    """
    moving = _moving(theta)
    values = np.linalg.eigvals(operators(theta, k)["A"][np.ix_(moving, moving)])
    return float(np.abs(values).max(initial=0.0))


def limited_rows(theta: Dictionary, k: Array, scale: Array, bound: float) -> Array:
    """Learned rows (S, M) whose A has a spectral radius of at most ``bound``, close to ``k``.

    Close is meant in columns of ``theta`` divided by ``scale`` (M,).

    W (left Schur vectors of the modes outside, in scaled columns) obeys W^T A = T W^T. Adding F W^T to the learned
    rows E makes T + W^T E F of T and changes no other eigenvalue, nor what motions in the other modes do. F is the
    smallest one that scales the diagonal blocks of T onto the circle. With state delays the learned rows may be too few
    to move all modes so (W^T E singular): then all eigenvalues shrink alike, A_j to r^(j+1) A_j for the j-th delay.
    """
    learned, moving = theta.learned_columns, _moving(theta)
    unit = scale[moving]
    a = operators(theta, k)["A"][np.ix_(moving, moving)] * unit / unit[:, None]
    triangle, basis, count = scipy.linalg.schur(a.T, output="real", sort=lambda re, im: np.hypot(re, im) > bound)
    left, block = basis[:, :count], triangle[:count, :count]
    reach = left[: len(learned)].T
    if np.linalg.svd(reach, compute_uv=False).min(initial=1.0) > REACHED and len(reach) <= len(learned):
        gain = np.linalg.pinv(reach) @ (limited_blocks(block, bound) - block).T
        found = k.copy()
        found[:, moving] += (gain @ left.T) * scale[learned][:, None] / unit
        if transition_radius(theta, found) <= bound * (1.0 + SLACK):
            return found
    return _shrunk(theta, k, bound / transition_radius(theta, k))


def _moving(theta: Dictionary) -> NDArray[np.int64]:
    """Learned columns, then past states: the part of psi that has dynamics of its own."""
    past = np.arange(theta.n_present, theta.n_present + theta.state_delays * theta.n_states)
    return np.concatenate([theta.learned_columns, past])


def _shrunk(theta: Dictionary, k: Array, r: float) -> Array:
    """Rows for which every eigenvalue of A is r times what it was."""
    factors = np.ones(theta.n_columns)
    factors[theta.learned_columns] = r
    for j in range(theta.state_delays):
        first = theta.n_present + j * theta.n_states
        factors[first : first + theta.n_states] = r ** (j + 2)
    return np.asarray(k * factors)
