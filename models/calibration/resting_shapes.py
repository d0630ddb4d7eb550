"""Measured shapes of an arm at rest, against the equilibria of its parametrised model."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares

from pisplit.checks import Array, finite_array, positive
from pisplit.models.arm.marker_sight import MarkerSight, marker_array
from pisplit.models.arm.sight import Sight
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Error, in parts of what is measured, where the simulation fails for the parameters of the moment: a step there is no
#: progress.
LOST = 10.0
#: Steps of central differences of simulations, which have tolerances of 1e-6 and below.
DIFFERENCE = 3e-3


class RestingShapes:
    """Misses of solved equilibria in standard deviations of the measurement.

    Shapes follow the parameters (:class:`FollowedShapes`).

    Args:
        model: the arm with its free parameters.
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S), of which positions and frames count; the columns (N, K) of the markers where
            the ``model`` has some, NaN where one was lost.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
        stations: their number S.
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
        self.model = model
        self.u = finite_array(inputs, "inputs", (None, model.m))
        self.sight: Sight | MarkerSight
        if model.capture is not None:
            self.sight = MarkerSight(model.scene, model.capture)
            self.measured = marker_array(fields, model.capture, model.scene.rod.length, (len(self.u),))
            self.error = self.sight.sizes
        else:
            measured = finite_array(fields, "fields", (len(self.u), N_FIELDS * stations))
            errors = positive(position_error, "position_error"), positive(rotation_error, "rotation_error")
            self.sight = model.sight(stations, ("p", "R"))
            self.error = self.sight.errors(measured, *errors)
            self.measured = measured[:, self.sight.rows]
        self._followed = model.shapes(len(self.u))
        self._last: tuple[Array, Array, Array, Array] | None = None
        self.root: Array | None = None
        if input_error > 0.0:
            self._of_inputs = input_error * self._solved(model.first)[1][:, :, model.slots["moves"]]
            self._factorise()

    def weighed_down(self, factor: float) -> RestingShapes:
        """The same shapes with sensors whose errors are larger by a ``factor``."""
        found = copy(self)
        found.error, found._last = factor * self.error, None
        if self.root is not None:
            found._of_inputs = self._of_inputs / factor
            found._factorise()
        return found

    def _factorise(self) -> None:
        """Root of the covariance of the misses: 1 from sensors, and that from inputs."""
        covariance = np.eye(len(self.error)) + self._of_inputs @ self._of_inputs.transpose(0, 2, 1)
        self.root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)

    def misses(self, x: Array) -> Array:
        """Misses (N * 12 S,) for the free parameters ``x`` (P,)."""
        return self._whitened(self._solved(x)[0][..., None]).reshape(-1)

    def slope(self, x: Array) -> Array:
        """Derivative (N * 12 S, P) of the misses in the free parameters ``x`` (P,); none in those of servos."""
        model = self.model
        _, of_inputs, of_pose = self._solved(x)
        found = np.zeros((*of_inputs.shape[:2], len(x)))
        found[..., : len(model.free)] = of_inputs[:, :, model.slots[PARAMETERS][model.free]]
        if model.n_pose:
            found[..., -model.n_pose :] = of_pose * model.pose_unit
        return self._whitened(found).reshape(-1, len(x))

    def _whitened(self, values: Array) -> Array:
        return values if self.root is None else np.asarray(np.linalg.solve(self.root, values), dtype=np.float64)

    def _solved(self, x: Array) -> tuple[Array, Array, Array]:
        """Misses (N, K) in parts of the sensors' errors and their derivatives (N, K, n_inputs) in all inputs and
        (N, K, 6) in the pose of the base."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1:]
        model, scene = self.model, self.model.scene
        n, pose = scene.n_strains, model.pose(x)
        w = np.zeros(scene.n_inputs)
        w[model.slots[PARAMETERS]] = model.full(x)
        missed = np.full((len(self.u), len(self.error)), LOST * scene.rod.length / self.error[0])
        slopes, of_pose = np.zeros((*missed.shape, scene.n_inputs)), np.zeros((*missed.shape, 6))
        for i, moves in enumerate(self.u):
            w[model.slots["moves"]] = moves
            found = self._followed.solved(i, w)
            if found is None:
                continue
            strains, of_w = found
            entries, jacobian, turned = self.sight.look(np.concatenate([strains, np.zeros(n)]), pose)
            seen = np.isfinite(self.measured[i])
            missed[i] = np.where(seen, entries - self.measured[i], 0.0) / self.error
            slopes[i] = jacobian[:, :n] @ of_w * (seen / self.error)[:, None]
            of_pose[i] = turned * (seen / self.error)[:, None]
        self._last = x.copy(), missed, slopes, of_pose
        return missed, slopes, of_pose

    def fit(self, digits: float = 1e-6, steps: int = 100) -> OptimizeResult:
        """Least squares over the free parameters, with the first guess as prior: scipy's result.

        It ends at a relative change below ``digits``, or after so many ``steps``.
        """
        model = self.model
        return least_squares(
            lambda x: np.concatenate([self.misses(x), model.prior(x)]),
            model.first,
            jac=lambda x: np.vstack([self.slope(x), model.prior_slope]),
            bounds=(model.low, np.inf),
            x_scale=model.width,
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
