"""Measured shapes of an arm at rest, against the equilibria of its parametrised model."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares

from pisplit.checks import Array, finite_array, positive
from pisplit.models.arm.sight import Sight
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.statics.search import TOLERANCE

#: Error, in parts of what is measured, where the simulation fails for the parameters of the moment: a step there is no
#: progress.
LOST = 10.0
#: Steps of central differences of simulations, which have tolerances of 1e-6 and below.
DIFFERENCE = 3e-3
#: Newton steps from a known shape to that of other parameters, and the largest of them in scaled strains.
NEWTON, LONGEST = 12, 1.0


class RestingShapes:
    """Misses of solved equilibria in standard deviations of the measurement.

    Every shape is loaded from nothing once. For other parameters Newton's method starts from the shape last known and
    its derivative, which is that of the implicit function; what is found counts if it is stable. Where that fails the
    parameters are moved slowly from the last shape to the new one (``Branches.of_state``).

    Args:
        model: the arm with its free parameters.
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S), of which positions and frames count.
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
        measured = finite_array(fields, "fields", (len(self.u), N_FIELDS * stations))
        errors = positive(position_error, "position_error"), positive(rotation_error, "rotation_error")
        self.sight = Sight(model.scene, stations, ("p", "R"))
        self.error = self.sight.errors(measured, *errors)
        self.measured = measured[:, self.sight.rows]
        self.search, self.branches = model.scene.statics().search, model.scene.statics().branches
        self._known: list[tuple[Array, Array] | None] = [None] * len(self.u)
        self._last: tuple[Array, Array, Array] | None = None
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
        of_scene = self._whitened(self._solved(x)[1][:, :, model.slots[PARAMETERS][model.free]])
        found = np.zeros((of_scene.shape[0] * of_scene.shape[1], len(x)))
        found[:, : len(model.free)] = of_scene.reshape(len(found), -1)
        return found

    def _whitened(self, values: Array) -> Array:
        return values if self.root is None else np.asarray(np.linalg.solve(self.root, values), dtype=np.float64)

    def _solved(self, x: Array) -> tuple[Array, Array]:
        """Misses (N, K) in parts of the sensors' errors and their derivatives (N, K, n_inputs) in all inputs."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1:]
        model, scene, search = self.model, self.model.scene, self.search
        n = scene.n_strains
        w = np.zeros(scene.n_inputs)
        w[model.slots[PARAMETERS]] = model.full(x)
        missed = np.full((len(self.u), len(self.error)), LOST * scene.rod.length / self.error[0])
        slopes = np.zeros((*missed.shape, scene.n_inputs))
        for i, moves in enumerate(self.u):
            w[model.slots["moves"]] = moves
            shape = self._shape(i, w)
            if shape is None:
                continue
            self._known[i] = shape, w.copy()
            of_x, of_u = (np.asarray(v) for v in search.slopes(shape, w))
            state = np.concatenate([search.strains(shape), np.zeros(n)])
            entries, jacobian = (np.asarray(v) for v in self.sight.function(state))
            missed[i] = (entries.ravel() - self.measured[i]) / self.error
            of_shape = jacobian[:, :n] * scene.nominal_strains / self.error[:, None]
            slopes[i] = -of_shape @ np.linalg.solve(of_x, of_u)
        self._last = x.copy(), missed, slopes
        return missed, slopes

    def _shape(self, i: int, w: Array) -> Array | None:
        """Scaled strains (n,) of shape ``i`` under inputs ``w`` (n_inputs,); None where there is none to be found."""
        search, branches, known = self.search, self.branches, self._known[i]
        if known is None:
            found, _, _ = search.find(w, np.zeros(self.model.scene.n_strains), branches.unique(w))
            verdict = branches.of_root(found, w, search.worst(found, w) <= TOLERANCE)
        else:
            start, before = known
            near = self._newton(start + search.along(start, before, w - before), w)
            if near is not None and branches.near(near, w).stable:
                return near
            verdict = branches.of_state(start, w, start, before, False)
        rests = verdict.branch != "unverified" and search.worst(verdict.x, w) <= TOLERANCE
        return verdict.x if rests else None

    def _newton(self, x: Array, w: Array) -> Array | None:
        """The root next to ``x`` (n,), None where the steps grow long or do not end."""
        for _ in range(NEWTON):
            if self.search.worst(x, w) <= 1e-2 * TOLERANCE:
                return x
            try:
                step = np.linalg.solve(np.asarray(self.search.slopes(x, w)[0]), self.search.residual(x, w))
            except np.linalg.LinAlgError:
                return None
            if not np.abs(step).max() <= LONGEST:
                return None
            x = x - step
        return x if self.search.worst(x, w) <= TOLERANCE else None

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
