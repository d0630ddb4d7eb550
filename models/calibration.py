"""Identify the tendons of an arm from a few equilibria or a few recorded pairs; the result is an arm to simulate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from pisplit.checks import Array, finite_array, positive
from pisplit.models.calibrated import PARAMETERS, CalibratedTendons, TendonParameters
from pisplit.models.rod import KelvinVoigt, Scene, Tendons
from pisplit.models.rod.fields import N_FIELDS
from pisplit.models.tendon_arm import TendonArm

#: What can be identified: the tendons, and factors of the backbone's stiffness and damping.
GROUPS = ("tendons", "bending", "damping")
#: Spread of every parameter about its first guess that regularises the fit: offsets by half a radius, stiffness and
#: slack by a factor of e^3 and 1 mm, rounding by e, stiffness and damping of the backbone by e^0.3 and e.
SPREAD = {"offset": 0.5, "stiffness": 3.0, "slack": 1.0, "rounding": 1.0, "bending": 0.3, "damping": 1.0}
#: Residuals that count as one standard deviation: of static moments, as parts of EI/L, and of one-step predictions, as
#: parts of the spread of the recorded coordinates.
STATIC_ERROR, STEP_ERROR = 1e-3, 1e-3
#: Error of a pair whose simulation fails for the parameters of the moment: a step there is no progress.
LOST = 10.0
#: Steps of central differences of simulated pairs; their integrator has a tolerance of 1e-6.
DIFFERENCE = 3e-3
SIMULATION_RTOL = 1e-6


@dataclass(frozen=True)
class Calibration:
    """Identified arm.

    arm         the arm with the identified tendons, to simulate (``make_episodes``) or to solve
    parameters  what was identified
    residual    root mean square of the residuals: parts of EI/L (equilibria), standard deviations of the measurement
                (shapes), or parts of the coordinates' spread (pairs)
    samples     number of equilibria or pairs that were used; a pair whose simulation fails does not count
    success     False if the least squares stopped before they converged
    """

    arm: TendonArm
    parameters: TendonParameters
    residual: float
    samples: int
    success: bool

    def with_damping(self, factor: float) -> Calibration:
        """The same with another factor of the backbone's damping."""
        parameters = replace(self.parameters, damping=positive(factor, "factor"))
        term = next(t for t in self.arm.scene.terms if isinstance(t, CalibratedTendons))
        changed = replace(term, values=tuple(parameters.vector(term.radius).tolist()))
        scene = self.arm.scene.without(CalibratedTendons) + changed
        return replace(self, arm=replace(self.arm, scene=scene), parameters=parameters)


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
    xi = finite_array(np.asarray(coordinates, dtype=float)[:, :n], "coordinates", (len(u), n))
    model = _Model(arm, start, free)
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
            max_nfev=500,
            ftol=1e-6,
            xtol=1e-6,
        )
        fits.append(fit)
    found = min(fits, key=lambda fit: float(fit.cost))
    r = STATIC_ERROR * values(found.x)[0]
    return model.result(found.x, float(np.sqrt(np.mean(r**2))), len(u), found.status > 0)


def calibrate_from_shapes(
    arm: TendonArm,
    inputs: ArrayLike,
    fields: ArrayLike,
    position_error: float = 1e-3,
    rotation_error: float = 0.02,
    stations: int = 6,
    free: Sequence[str] = ("tendons", "bending"),
    start: TendonParameters | None = None,
) -> Calibration:
    """Tendons whose equilibria look like measured ones: least squares on positions and frames of solved statics.

    The balance of forces at a measured shape (``calibrate_from_equilibria``) is exact for exact shapes and lost for
    noisy ones: stiff tendons turn the noise of curvatures into tensions, and the fit takes their offsets to zero.
    Shapes that are solved for carry the noise of the camera alone.

    Args:
        inputs: displacements (N, m) in m.
        fields: measured fields (N, 24 S) at rest under them, of which positions and frames count.
        position_error, rotation_error: standard deviations of the measured positions in m and frames in rad.
        arm, free, start: as in ``calibrate_from_equilibria``.
    """
    u = finite_array(inputs, "inputs", (None, arm.scene.n_inputs))
    measured = finite_array(fields, "fields", (len(u), N_FIELDS * stations)).reshape(len(u), stations, N_FIELDS)
    if "damping" in free:
        raise ValueError("equilibria say nothing of damping; leave it out of free, or use calibrate_from_pairs")
    model = _Model(arm, start, free)
    statics, slots = model.scene.statics(), model.slots
    error = np.repeat([positive(position_error, "position_error"), positive(rotation_error, "rotation_error")], [3, 9])

    def misses(x: Array) -> Array:
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, slots["moves"]] = u
        w[:, slots[PARAMETERS]] = model.full(x)
        solved = statics.solve_many(w)
        shapes = model.scene.fields(np.nan_to_num(solved.states), stations)[..., :12]
        missed = (shapes - measured[..., :12]) / error
        missed[~solved.success] = LOST / position_error * arm.scene.rod.length
        return missed.reshape(-1)

    def residual(x: Array) -> Array:
        return np.concatenate([misses(x), model.prior(x)])

    first = model.start[model.free]
    found = least_squares(
        residual, first, jac=_central(residual), x_scale=model.spread[model.free], max_nfev=100, ftol=1e-6, xtol=1e-6
    )
    return model.result(found.x, float(np.sqrt(np.mean(misses(found.x) ** 2))), len(u), found.status > 0)


def calibrate_from_pairs(
    arm: TendonArm,
    before: ArrayLike,
    after: ArrayLike,
    inputs: ArrayLike,
    dt: float,
    free: Sequence[str] = GROUPS,
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
    """
    n, m = arm.scene.n_strains, arm.scene.n_inputs
    positive(dt, "dt", "s")
    x0 = finite_array(before, "before", (None, 2 * n))
    x1 = finite_array(after, "after", (len(x0), 2 * n))
    u = finite_array(inputs, "inputs", (len(x0), 2, m))
    model = _Model(arm, start, free)
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

    used = predicted(model.start[model.free])[1]
    if not used.any():
        raise RuntimeError("no pair could be simulated; check that before, after and inputs belong to this arm")
    x0, x1, u = x0[used], x1[used], u[used]

    def residual(x: Array) -> Array:
        return np.concatenate([predicted(x)[0].ravel() / STEP_ERROR, model.prior(x)])

    scale = model.spread[model.free]
    found = least_squares(
        residual, model.start[model.free], jac=_central(residual), x_scale=scale, max_nfev=evaluations
    )
    r = predicted(found.x)[0]
    return model.result(found.x, float(np.sqrt(np.mean(r**2))), len(x0), found.status > 0)


def _central(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Jacobian by central differences with absolute steps: logarithms start at zero."""

    def slope(x: Array) -> Array:
        steps = DIFFERENCE * np.eye(len(x))
        return np.stack([(function(x + d) - function(x - d)) / (2.0 * DIFFERENCE) for d in steps], axis=1)

    return slope


def nominal_parameters(arm: TendonArm) -> TendonParameters:
    """Parameters of the arm's own tendons: where its drawing has them, with the stiffness it says."""
    tendons = _tendons(arm)
    compliance = getattr(tendons.drive, "compliance", None)
    if compliance is None or any(callable(o) for o in tendons.offsets):
        raise ValueError("calibration takes parallel tendons with a displacement drive; give start for others")
    m = len(tendons.offsets)
    stiffness = 1.0 / (float(compliance) * arm.scene.rod.length)
    return TendonParameters(
        offset=np.array([np.asarray(o, float) for o in tendons.offsets]),
        stiffness=np.full(m, stiffness),
        slack=np.zeros(m),
        rounding=1e-4,
    )


class _Model:
    """The backbone with parametrised tendons, and which parameters are free."""

    def __init__(self, arm: TendonArm, start: TendonParameters | None, free: Sequence[str]) -> None:
        unknown = [name for name in free if name not in GROUPS]
        if unknown or not free:
            raise ValueError(f"free = {list(free)}; expected some of {', '.join(GROUPS)}")
        first = nominal_parameters(arm) if start is None else start
        self.arm, self.m = arm, first.n_tendons
        if self.m != arm.scene.n_inputs:
            raise ValueError(f"start has {self.m} tendons; the arm has {arm.scene.n_inputs} inputs")
        self.name = _tendons(arm).name
        self.radius = float(np.hypot(*first.offset.T).mean())
        self.start = first.vector(self.radius)
        m = self.m
        parts = {"offset": 2 * m, "stiffness": m, "slack": m, "rounding": 1, "bending": 1, "damping": 1}
        self.spread = np.concatenate([np.full(size, SPREAD[name]) for name, size in parts.items()])
        groups = np.repeat(["tendons", "bending", "damping"], [4 * m + 1, 1, 1])
        self.free = np.flatnonzero(np.isin(groups, list(free)))
        self.scene = self._scene(None)
        self.slots = {"moves": np.arange(m), PARAMETERS: np.arange(m, m + len(self.start))}

    def starts(self) -> list[Array]:
        """First guesses: tendons that are slack push nothing and leave a fit in the lurch, so several are tried."""
        found = []
        m = self.m
        for stiffness in (0.0, -2.0, 2.0):
            for slack in (0.0, 1.0):
                values = self.start.copy()
                values[2 * m : 3 * m] += stiffness
                values[3 * m : 4 * m] += slack
                found.append(values[self.free])
        return found

    def full(self, x: Array) -> Array:
        """All parameters, from the free ones."""
        values = self.start.copy()
        values[self.free] = x
        return values

    def prior(self, x: Array) -> Array:
        """Distance from the first guess in standard deviations."""
        return (x - self.start[self.free]) / self.spread[self.free]

    @property
    def prior_slope(self) -> Array:
        """d prior / dx."""
        return np.diag(1.0 / self.spread[self.free])

    def result(self, x: Array, residual: float, samples: int, success: bool) -> Calibration:
        """The identified arm."""
        values = self.full(x)
        scene = self._scene(tuple(values.tolist()))
        arm = TendonArm(scene, self.arm.pretension, self.arm.amplitude)
        return Calibration(arm, TendonParameters.of_vector(values, self.radius), residual, samples, success)

    def _scene(self, values: tuple[float, ...] | None) -> Scene:
        backbone = self.arm.scene.without(Tendons)
        damping = [t for t in backbone.terms if isinstance(t, KelvinVoigt)]
        total = KelvinVoigt(
            *(sum(getattr(t, name) for t in damping) for name in ("bending", "torsion", "shear", "stretch"))
        )
        return backbone + CalibratedTendons(self.m, self.radius, values, total, self.name)


def _tendons(arm: TendonArm) -> Tendons:
    return next(t for t in arm.scene.terms if isinstance(t, Tendons))
