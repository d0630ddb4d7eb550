"""Identify the tendons of an arm from a few equilibria or a few recorded pairs; the result is an arm to simulate."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.models.arm.alignment import aligned
from pisplit.models.arm.marker_sight import marker_array
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.model import Calibration, ParametrisedArm, check_memory, nominal_parameters
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.calibration.resting_shapes import LOST, RestingShapes, central_slope

__all__ = [
    "Calibration",
    "calibrate_from_equilibria",
    "calibrate_from_pairs",
    "calibrate_from_shapes",
    "nominal_parameters",
]

#: Residuals that count as one standard deviation: of static moments, as parts of EI/L, and of one-step predictions, as
#: parts of the spread of the recorded coordinates.
STATIC_ERROR, STEP_ERROR = 1e-3, 1e-3
#: Tolerance of simulated pairs.
SIMULATION_RTOL = 1e-6
#: Relative change of parameters or cost that ends a fit to simulated steps: below are digits of the integrator.
SIMULATED_DIGITS = 1e-4


def calibrate_from_equilibria(
    arm: TendonArm,
    inputs: ArrayLike,
    coordinates: ArrayLike,
    free: Sequence[str] = ("tendons", "bending"),
    start: TendonParameters | None = None,
) -> Calibration:
    """Tendons whose moments hold the backbone in measured equilibria, by least squares on the static balance.

    Args:
        arm: its backbone is the known part; its tendons are the first guess (see ``nominal_parameters``).
        inputs: displacements (N, m) in m.
        coordinates: strains (N, n) or rod coordinates (N, 2n) at rest under them (``scene.coordinates``).
        free: parts of ``GROUPS`` to identify; equilibria say nothing of damping.
        start: first guess in place of the arm's own tendons.

    No recording in motion is needed. Raises ValueError for arrays of the wrong shape or unknown groups.
    """
    n = arm.scene.n_strains
    u = finite_array(inputs, "inputs", (None, arm.scene.n_inputs))
    xi = finite_array(coordinates, "coordinates", (len(u), None))[:, :n]
    model = ParametrisedArm(arm, start, free)
    if "damping" in free:
        raise ValueError("equilibria say nothing of damping; leave it out of free, or use calibrate_from_pairs")
    shape, given, balance = model.scene.static_balance
    slots = model.slots
    residual = ca.Function("residual", [shape, given], [balance.residual, ca.jacobian(balance.residual, given)])
    mapped = residual.map(len(u))
    unit = STATIC_ERROR * model.scene.nominal_residual

    def values(x: Array) -> tuple[Array, Array]:
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, slots["moves"]] = u
        w[:, slots[PARAMETERS]] = model.full(x)
        r, j = (np.asarray(v) for v in mapped(xi.T, w.T))
        slopes = j.reshape(n, len(u), -1).transpose(1, 0, 2)[:, :, slots[PARAMETERS]][:, :, model.free]
        return (r.T / unit).ravel(), (slopes / unit[:, None]).reshape(-1, len(model.free))

    fits = []
    for first in model.starts():
        fit = least_squares(
            lambda x: np.concatenate([values(x)[0], model.prior(x)]),
            first,
            jac=lambda x: np.vstack([values(x)[1], model.prior_slope]),
            x_scale="jac",
            bounds=(model.low, np.inf),
            max_nfev=500,
            ftol=1e-6,
            xtol=1e-6,
        )
        fits.append(fit)
    found = min(fits, key=lambda fit: float(fit.cost))
    misfit = float(np.sqrt(np.mean(values(found.x)[0] ** 2)))
    why, normal = unfinished(found), found.jac.T @ found.jac
    return model.result(found.x, STATIC_ERROR * misfit, len(u), normal, misfit, why)


def calibrate_from_shapes(
    arm: TendonArm,
    inputs: ArrayLike,
    fields: ArrayLike,
    position_error: float = 1e-3,
    rotation_error: float = 0.02,
    stations: int = 6,
    free: Sequence[str] = ("tendons", "bending"),
    start: TendonParameters | None = None,
    input_error: float = 0.0,
    capture: MotionCapture | None = None,
) -> Calibration:
    """Tendons whose equilibria look like measured ones: least squares on positions and frames of solved statics.

    The balance of forces at a measured shape (``calibrate_from_equilibria``) is exact for exact shapes and lost for
    noisy ones: stiff tendons turn the noise of curvatures into tensions, and the fit takes their offsets to zero.
    Shapes that are solved for carry the noise of the camera alone.

    Args:
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S) at rest under them, of which positions and frames count.
        position_error, rotation_error: standard deviations of the measured positions in m and frames in rad.
        stations: their number S.
        arm, free, start: as in ``calibrate_from_equilibria``.
        input_error: standard deviation in m of the displacements, such as a play between servo and tendons makes.
        capture: markers, where positions of a few points are all that is measured: ``fields`` are then their columns
            (N, K), NaN where one was lost, and the errors and stations above say nothing.

    Raises ValueError where damping is to be found, of which shapes at rest say nothing.
    """
    if capture is not None:
        u = finite_array(inputs, "inputs", (None, arm.scene.n_inputs))
        y = marker_array(fields, capture, arm.scene.rod.length, (len(u),))
        capture = aligned(arm, capture, u, y) if capture.pose == "estimated" else capture
    model = ParametrisedArm(arm, start, free, capture=capture)
    if "damping" in free:
        raise ValueError("equilibria say nothing of damping; leave it out of free, or use calibrate_from_recordings")
    play = non_negative(input_error, "input_error", "m")
    shapes = RestingShapes(model, inputs, fields, position_error, rotation_error, stations, play)

    found = shapes.fit()
    misfit = float(np.sqrt(np.mean(shapes.misses(found.x) ** 2)))
    normal = found.jac.T @ found.jac
    return model.result(found.x, misfit, len(shapes.u), normal, misfit, unfinished(found))


def calibrate_from_pairs(
    arm: TendonArm,
    before: ArrayLike,
    after: ArrayLike,
    inputs: ArrayLike,
    dt: float,
    free: Sequence[str] = ("tendons", "bending", "damping"),
    start: TendonParameters | None = None,
    evaluations: int = 8,
) -> Calibration:
    """Tendons, stiffness and damping that predict recorded pairs best: least squares on simulated steps.

    Args:
        arm: its backbone is the known part; its tendons are the first guess.
        before, after: rod coordinates [xi, xi_t] (N, 2n) at the beginning and the end of a step
            (``scene.coordinates``).
        inputs: displacements (N, 2, m) in m at the beginning and the end of each step; they move linearly.
        dt: length of the step in s.
        free, start: as in ``calibrate_from_equilibria``.
        evaluations: largest number of Gauss-Newton steps; each simulates every pair once for every parameter.

    Raises CalibrationError where these are too few and predictions are still off by 1e-3 of the spread, and
    RuntimeError where no pair could be simulated.
    """
    check_memory(arm)
    n, m = arm.scene.n_strains, arm.scene.n_inputs
    positive(dt, "dt", "s")
    x0 = finite_array(before, "before", (None, 2 * n))
    x1 = finite_array(after, "after", (len(x0), 2 * n))
    u = finite_array(inputs, "inputs", (len(x0), 2, m))
    model = ParametrisedArm(arm, start, free)
    simulator = model.scene.simulator(dt=dt, rtol=SIMULATION_RTOL)
    slots = model.slots
    spread = np.repeat([np.sqrt(np.mean((part - part.mean(axis=0)) ** 2)) for part in (x1[:, :n], x1[:, n:])], n)
    spread[spread == 0.0] = 1.0

    def predicted(x: Array) -> tuple[Array, Array]:
        """Errors of all pairs in parts of the spread, and whether they could be simulated."""
        w = np.zeros((2, model.scene.n_inputs))
        w[:, slots[PARAMETERS]] = model.full(x)
        errors, done = np.full((len(x0), 2 * n), LOST), np.zeros(len(x0), dtype=bool)
        for i in range(len(x0)):
            w[:, slots["moves"]] = u[i]
            step = simulator.run(w[1:], np.concatenate([x0[i], w[0]]))
            if step.success:
                errors[i], done[i] = (step.x[-1, : 2 * n] - x1[i]) / spread, True
        return errors, done

    used = predicted(model.first)[1]
    if not used.any():
        raise RuntimeError("no pair could be simulated; check that before, after and inputs belong to this arm")
    x0, x1, u = x0[used], x1[used], u[used]

    def residual(x: Array) -> Array:
        return np.concatenate([predicted(x)[0].ravel() / STEP_ERROR, model.prior(x)])

    found = least_squares(
        residual,
        model.first,
        jac=central_slope(residual),
        x_scale=model.width,
        max_nfev=evaluations,
        ftol=SIMULATED_DIGITS,
        xtol=SIMULATED_DIGITS,
    )
    missed = float(np.sqrt(np.mean(predicted(found.x)[0] ** 2)))
    why = unfinished(found) if missed > STEP_ERROR else ""  # below are digits of the integrator
    return model.result(found.x, missed, len(x0), found.jac.T @ found.jac, missed / STEP_ERROR, why)


def unfinished(found: OptimizeResult) -> str:
    """Why a fit ``found`` by scipy is not to be relied on; empty if it is."""
    if found.status > 0:
        return ""
    return f"no end after {found.nfev} evaluations, the sum of squares still falls ({found.message.lower()})"
