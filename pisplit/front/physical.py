"""An arm's own equations as a model for MPC: nothing is fitted, so that what was identified acts at once."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, positive
from pisplit.front.planned import PlannedOutputs
from pisplit.lifted.model import LiftedModel
from pisplit.mapping import Buffered
from pisplit.models.arm import Arm
from pisplit.models.rod.analysis.fields import UNITS
from pisplit.models.rod.dynamics.fast import FastStepper

#: Steps of a recording that tells the ranges of the states.
RANGE_STEPS = 60


class PhysicalStep:
    """One step of an ``arm`` in the place of a re-lifted term: z+ = g(z, u), z = [strains, rates, u before, fields].

    Args:
        arm: what moves: tendons pulled by displacements, of Kirchhoff strains.
        dt: time step in s.
        stations: number of measured points.

    Attributes:
        weights, basis: shapes by which a model checks it; there are no products.
    """

    def __init__(self, arm: Arm, dt: float, stations: int) -> None:
        self.arm, self.dt, self.stations = arm, positive(dt, "dt", "s"), stations
        scene = arm.scene
        self.n, self.m = 2 * scene.n_strains, scene.n_inputs
        self.names = tuple(scene.field_map(stations).names)
        M = self.n + self.m + len(self.names)
        self.weights, self.basis = np.zeros((M, 0)), np.zeros((0, M + self.m))

    def __call__(self, z: Array, u: Array) -> Array:
        """g (M,) at a lifted state ``z`` (M,) under an input ``u`` (m,); or many at once, (..., M) and (..., m)."""
        if z.ndim > 1:
            rows = [self(a, b) for a, b in zip(z.reshape(-1, z.shape[-1]), u.reshape(-1, self.m), strict=True)]
            return np.reshape(rows, z.shape)
        return self._next(u, self.stepper.integrate(z[: self.n + self.m], u[None])[0][-1])

    def jacobian(self, z: Array, u: Array) -> tuple[Array, Array]:
        """dg/dz (M, M) and dg/du (M, m) at one ``z`` (M,) and ``u`` (m,)."""
        step, n, m, M = self.stepper.sensitivity(z[: self.n + self.m], u), self.n, self.m, len(z)
        of_fields = np.asarray(self._fields_slope(step.x[:n]))
        by_state, by_input = np.zeros((M, M)), np.zeros((M, m))
        by_state[:n, : n + m], by_input[:n] = step.d_state[:n], step.d_input[:n]
        by_input[n : n + m] = np.eye(m)
        by_state[n + m :, : n + m] = of_fields @ step.d_state[:n]
        by_input[n + m :] = of_fields @ step.d_input[:n]
        return by_state, by_input

    def along(self, read: Array, offset: Array, T: Array) -> PlannedOutputs:
        """Outputs with rows ``read`` (p, M) of C and ``offset`` (p,) of d along plans u = T v, T (m, r)."""
        return PlannedOutputs(self, read, offset, T)

    def _next(self, u: Array, x: Array) -> Array:
        return np.concatenate([x[: self.n], u, *self._fields_at(x[: self.n])])

    @cached_property
    def stepper(self) -> FastStepper:
        """What moves the arm."""
        return self.arm.scene.fast_stepper(dt=self.dt, stations=self.stations)

    @cached_property
    def measured(self) -> tuple[ca.SX, ca.SX]:
        """[xi, xi_t] (n,) and the fields at rest inputs that are measured there."""
        n, fields = self.n, self.arm.scene.field_map(self.stations).symbolic
        x = ca.SX.sym("x", n)
        return x, fields(x[: n // 2], x[n // 2 :], ca.SX.zeros(n // 2), ca.SX.zeros(self.m))

    @cached_property
    def _fields_at(self) -> Buffered:
        x, y = self.measured
        return Buffered(ca.Function("fields", [x], [ca.densify(y)]))

    @cached_property
    def _fields_slope(self) -> ca.Function:
        x, y = self.measured
        return ca.Function("slope", [x], [ca.densify(ca.jacobian(y, x))])

    def __getstate__(self) -> dict[str, Any]:
        return {"arm": self.arm, "dt": self.dt, "stations": self.stations}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]


def physical_model(arm: Arm, dt: float, stations: int = 6) -> LiftedModel:
    """The equations of an ``arm`` as a model that MPC linearises along its plan, once a step.

    It is re-lifted: lifted states are strains and their rates, found from measured curvatures and velocities, the
    displacements before, and all fields. Inputs move in the directions that bend the arm. Nothing is learned: it is as
    good as the arm, drawn, calibrated or identified again. It is no file: keep the arm.

    Args:
        arm: drawn or identified; tendons pulled by displacements, of Kirchhoff strains.
        dt: time step in s.
        stations: number of measured points.

    Raises ValueError where the scene has no map from fields to strains.
    """
    step, scene = PhysicalStep(arm, dt, stations), arm.scene
    seen = arm.record(1, 0, RANGE_STEPS, dt, stations, workers=1, progress=False)
    found, coordinates = scene.field_map(stations), scene.coordinates(stations).function
    names, n, m = step.names, step.n, step.m
    at_rest = scene.statics().solve(arm.rest_inputs).state[:n]
    step(np.concatenate([at_rest, arm.rest_inputs, np.zeros(len(names))]), arm.rest_inputs)  # its functions are built
    size, M = len(names), step.n + step.m + len(step.names)
    x, v, u = ca.MX.sym("x", size, 2), ca.MX.sym("v", m, 1), ca.MX.sym("u", m)
    lifted = ca.vertcat(coordinates(x[:, 1]), v, x[:, 1])
    own = [f"{what}{k}" for what in ("xi", "xi_t") for k in range(n // 2)]
    C = np.zeros((size, M))
    C[:, n + m :] = np.eye(size)
    return LiftedModel(
        A=np.zeros((M, M)),
        B=np.zeros((M, m)),
        c=np.zeros(M),
        C=C,
        d=np.zeros(size),
        dt=dt,
        lift_function=ca.Function("lift", [x, v], [lifted]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=1,
        state_names=names,
        input_names=scene.input_names,
        column_names=(*own, *(f"{name}[k-1]" for name in scene.input_names), *names),
        feature_names=scene.input_names,
        input_offset=arm.rest_inputs,
        input_basis=arm.differential_basis,
        state_range=np.abs(np.concatenate(seen.xs)).max(axis=0),
        outputs=dict(found.outputs),
        provenance={"model": "equations of the arm", "scene": scene.fingerprint(stations)},
        relifted=step,  # type: ignore[arg-type]
        state_units=tuple(UNITS[q] for q in found.quantities),
        input_units=seen.input_units,
    )
