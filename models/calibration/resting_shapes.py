"""Measured shapes of an arm at rest, against the equilibria of its parametrised model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares

from pisplit.checks import Array, finite_array, positive
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.statics.equilibrium import EquilibriumBatch

#: Error, in parts of what is measured, where the simulation fails for the parameters of the moment: a step there is no
#: progress.
LOST = 10.0
#: Steps of central differences of simulations, which have tolerances of 1e-6 and below.
DIFFERENCE = 3e-3
#: Step in m of differences in the displacements.
NUDGE = 1e-4
#: Entries of the fields of a station that count: positions and frames.
POSE = 12


class RestingShapes:
    """Misses of solved equilibria in standard deviations of the measurement.

    Args:
        model: the arm with its free parameters.
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S), of which positions and frames count.
        stations: their number S.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
        input_error: that of displacements in m. What it does to the shapes is taken to first order about the first
            guess, and misses are divided by the root of their whole covariance.
    """

    def __init__(
        self,
        model: ParametrisedArm,
        inputs: ArrayLike,
        fields: ArrayLike,
        position_error: float,
        rotation_error: float,
        stations: int,
        input_error: float = 0.0,
    ) -> None:
        self.model, self.stations = model, stations
        self.u = finite_array(inputs, "inputs", (None, model.m))
        measured = finite_array(fields, "fields", (len(self.u), N_FIELDS * stations))
        self.measured = measured.reshape(len(self.u), stations, N_FIELDS)[..., :POSE]
        errors = positive(position_error, "position_error"), positive(rotation_error, "rotation_error")
        self.error = np.repeat(errors, [3, POSE - 3])
        self.statics = model.scene.statics()
        self.root: Array | None = None
        if input_error > 0.0:
            self.root = self._root_of_covariance(input_error)

    def misses(self, x: Array, near: Array | None = None) -> Array:
        """Misses (N * 12 S,) for the free parameters ``x`` (P,).

        ``near`` (N, n_states) are states at rest under about these parameters: then nothing is loaded from nothing.
        """
        missed = self._missed(x, self.u, near)
        if self.root is not None:
            missed = np.asarray(np.linalg.solve(self.root, missed[..., None])[..., 0], dtype=np.float64)
        return np.asarray(missed.reshape(-1))

    def _root_of_covariance(self, input_error: float) -> Array:
        """Lower triangles (N, 12 S, 12 S) of the covariance of the misses, 1 from sensors and that from inputs."""
        x = self.model.start[self.model.free]
        steps = NUDGE * np.eye(self.u.shape[1])
        near = self._solved(x, self.u).states
        slopes = [
            (self._missed(x, self.u + d, near) - self._missed(x, self.u - d, near)) / (2.0 * NUDGE) for d in steps
        ]
        of_inputs = input_error * np.stack(slopes, axis=-1)
        covariance = np.eye(of_inputs.shape[1]) + of_inputs @ of_inputs.transpose(0, 2, 1)
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    def _solved(self, x: Array, u: Array, near: Array | None = None) -> EquilibriumBatch:
        """Equilibria (N rows) under displacements ``u``."""
        model = self.model
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, model.slots["moves"]] = u
        w[:, model.slots[PARAMETERS]] = model.full(x)
        return self.statics.solve_many(w, near=None if near is None else np.nan_to_num(near))

    def _missed(self, x: Array, u: Array, near: Array | None = None) -> Array:
        """Misses (N, 12 S) in parts of the sensors' errors."""
        model, solved = self.model, self._solved(x, u, near)
        shapes = model.scene.fields(np.nan_to_num(solved.states), self.stations)[..., :POSE]
        missed = (shapes - self.measured) / self.error
        missed[~solved.success] = LOST / self.error[0] * model.arm.scene.rod.length
        return np.asarray(missed.reshape(len(u), -1))

    def slope(self, x: Array) -> Array:
        """Derivative of the misses in the free parameters. ``x`` (P,) are these."""
        near = self._solved(x, self.u).states
        return central_slope(lambda y: self.misses(y, near))(x)

    def fit(self, digits: float = 1e-6, steps: int = 100) -> OptimizeResult:
        """Least squares over the free parameters, with the first guess as prior: scipy's result.

        It ends at a relative change below ``digits``, or after so many ``steps``.
        """
        model = self.model

        def residual(x: Array) -> Array:
            return np.concatenate([self.misses(x), model.prior(x)])

        def slope(x: Array) -> Array:
            return np.vstack([self.slope(x), central_slope(model.prior)(x)])

        return least_squares(
            residual,
            model.start[model.free],
            jac=slope,
            x_scale=model.spread[model.free],
            max_nfev=steps,
            ftol=digits,
            xtol=digits,
        )


def central_slope(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Jacobian by central differences with absolute steps: logarithms start at zero. ``function`` maps (P,) to (M,)."""

    def slope(x: Array) -> Array:
        steps = DIFFERENCE * np.eye(len(x))
        return np.stack([(function(x + d) - function(x - d)) / (2.0 * DIFFERENCE) for d in steps], axis=1)

    return slope
