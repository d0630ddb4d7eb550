"""The input under which the model comes to rest nearest to a wanted output, under the limits."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.mpc.growth import spectral_radius
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.controllers.mpc.qp import QP, QPSettings
from pisplit.lifted.model import LiftedModel

#: Gauss-Newton steps for features that are not linear in the input, and the change in half boxes that ends them.
STEPS, CHANGE = 8, 1e-6
#: Price of a distance of one half box from the present input, in squared output scales: it decides what outputs do not.
STAY = 1e-6
#: The program has a handful of variables: it is solved to the end.
EXACTLY = QPSettings(eps=1e-8, max_iterations=20000, first_max_iterations=20000)


class SteadyTarget:
    """minimise |(y - r)/scale|^2_weight over the inputs inside the limits, y being the outputs at rest under u:
    z = A z + B phi(u) + sum_i u_i N_i z + c + w,  y = read z + offset.

    ``model``: the model; ``read`` (p, M), ``offset`` (p,): rows of the tracked outputs; ``limits`` of the inputs;
    ``weight``, ``scale`` (p,): of the outputs.

    ``exists`` is False for models that have no single state of rest, or do not come to it by themselves: re-lifted
    ones, and those with a mode that does not decay.

    Source: Rawlings, Mayne and Diehl, Model Predictive Control (2017), section 1.5.
    """

    def __init__(
        self, model: LiftedModel, read: Array, offset: Array, limits: InputLimits, weight: Array, scale: Array
    ) -> None:
        self._model, self._read, self._offset, self._limits = model, read, offset, limits
        self._root = np.sqrt(weight) / scale
        self._free = np.ones(model.n_lifted, dtype=bool)
        if "1" in model.column_names:
            one = model.column_names.index("1")
            self._free[one] = not np.array_equal(model.A[one], np.eye(model.n_lifted)[one])
        block = model.A[np.ix_(self._free, self._free)]
        centre = limits.offset + limits.basis @ limits.coordinates(0.5 * (limits.u_min + limits.u_max))
        if model.relifted is None and model.N is not None:
            block = model.transition(centre)[np.ix_(self._free, self._free)]
        self.exists = model.relifted is None and spectral_radius(block) < 1.0
        self._adjoint = None
        if self.exists and model.N is None:  # rows of read (I - A)^-1, once
            self._adjoint = np.linalg.solve((np.eye(len(block)) - block).T, read[:, self._free].T).T
        self._T = limits.basis * limits.amplitude.mean()

    @property
    def weight(self) -> Array:
        """Weights (p,) of squared output errors, in output units."""
        return self._root**2

    def affine(self) -> tuple[Array, Array, Array]:
        """Outputs at rest of a model linear in u: those (p,) at no moves, their gain (p, r) and push (p, M) by w."""
        found = self._at(self._limits.offset, np.zeros(self._model.n_lifted))
        assert found is not None and self._adjoint is not None
        push = np.zeros((len(self._read), self._model.n_lifted))
        push[:, self._free] = self._adjoint
        return found[0], found[1] @ self._T, push

    def __call__(self, r: Array, w: Array, missed: Array, u: Array) -> Array | None:
        """The input (m,) for the outputs ``r`` (p,), NaN where free, under the disturbance ``w`` (M,).

        ``missed`` (p,): what the read-out misses; ``u`` (m,): the present input. None where there is no such input.
        """
        wanted = ~np.isnan(r)
        if not self.exists or not (np.isfinite(w).all() and np.isfinite(missed).all()):
            return None
        limits, T = self._limits, self._T
        v = limits.coordinates(u) / limits.amplitude.mean()
        rows = T / limits.amplitude[:, None]
        low, high = (limits.u_min - limits.offset) / limits.amplitude, (limits.u_max - limits.offset) / limits.amplitude
        for _ in range(1 if self._model.linear_in_u and self._model.N is None else STEPS):
            found = self._at(limits.offset + T @ v, w)
            if found is None:
                return None
            y, slope = found
            S = (self._root[:, None] * slope @ T)[wanted]
            error = (self._root * (y + missed - r))[wanted] - S @ v
            P = S.T @ S + STAY * rows.T @ rows
            size = float(np.diag(P).max())
            q = S.T @ error - STAY * rows.T @ (rows @ v)
            solved = QP(P / size, rows, settings=EXACTLY).solve(q / size, low, high)
            if solved.x is None:
                return None
            change, v = float(np.abs(solved.x - v).max()), solved.x
            if change < CHANGE:
                break
        return np.asarray(limits.offset + T @ v)

    def _at(self, u: Array, w: Array) -> tuple[Array, Array] | None:
        """Outputs (p,) at rest under u (m,) and their derivative (p, m); None where they are not finite."""
        model, free = self._model, self._free
        still = np.where(free, 0.0, 1.0)
        forcing = model.B @ model.features(u[None, :])[0] + model.c + w
        by_input = model.B @ model.feature_jacobian(u[None, :])[0]
        matrix = model.A if model.N is None else model.transition(u)
        forcing = (forcing + matrix @ still)[free]
        if self._adjoint is None:
            assert model.N is not None
            block = np.eye(int(free.sum())) - matrix[np.ix_(free, free)]
            try:
                z = still.copy()
                z[free] = np.linalg.solve(block, forcing)
                slope = self._read[:, free] @ np.linalg.solve(block, (by_input + (model.N @ z).T)[free])
            except np.linalg.LinAlgError:
                return None
            y = self._read @ z
        else:
            y, slope = self._adjoint @ forcing + self._read @ still, self._adjoint @ by_input[free]
        y = y + self._offset
        return (y, slope) if np.isfinite(y).all() and np.isfinite(slope).all() else None
