"""What is known of a tendon arm before any trajectory: its backbone, its statics, where its tendons can act."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from pisplit import Dictionary, PhaseSamples
from pisplit import observables as ob
from pisplit.checks import Array
from pisplit.models.arm.static_table import EquilibriumTable
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod import Scene
from pisplit.models.rod.equations.prestressed import prestressed_acceleration

#: Size of the steps about the rest shape, in parts of 1/L and of the first bending frequency.
TANGENT_STEP = 1e-6


@dataclass(frozen=True)
class ArmPhysics:
    """Dictionary and options for ``PIEDMDc(split="hold")`` on a tendon arm, from its static map.

    The known part f is the backbone with the static load that holds each equilibrium x_eq(u); the unknown part h is
    what the tendons add when the arm leaves it. Parallel tendons act through constant bending stress (two ports) and
    feel mean curvature (two loads): h has four numbers.

    Attributes:
        table: static map of the arm.
        stations: stations of the measured fields.
    """

    table: EquilibriumTable
    stations: int = 6

    @property
    def arm(self) -> TendonArm:
        """The arm."""
        return self.table.arm

    def dictionary(self) -> Dictionary:
        """Rod coordinates as states, the equilibrium under u as input features, now and one step ago."""
        scene = self.arm.scene
        names = scene.field_map(self.stations).names
        return Dictionary(
            ob.Constant(),
            ob.RodCoordinates(scene, self.stations),
            ob.Equilibrium(self.table.function, self.table.names, self.table.quantities, scene.input_names),
            ob.Delays(inputs=1),
            n_states=len(names),
            n_inputs=scene.n_inputs,
            state_names=names,
            input_names=scene.input_names,
        )

    def options(self) -> dict[str, Any]:
        """Options of ``split="hold"`` (:class:`pisplit.splitting.hold.Hold`), found once."""
        return dict(self._options)

    @cached_property
    def _options(self) -> dict[str, Any]:
        scene = self.arm.scene
        n = scene.n_strains
        equilibrium = np.zeros((2 * n, len(self.table.names)))
        equilibrium[:n, : self.table.n_strains] = np.eye(n)
        bending = np.zeros((n, 2))
        for axis in range(2):
            bending[axis :: scene.rod.strain_set.n_fields, axis] = 1.0
        mean = np.tile(scene.rule.weights[:, None] / scene.rod.length, scene.rod.strain_set.n_fields).ravel()
        loads = np.hstack([bending.T * mean, np.zeros((2, n))])
        rest = scene.statics().solve(self.arm.rest_inputs)
        return {
            "tangent": self.tangent_samples(),
            "equilibrium": equilibrium,
            "ports": self.arm.backbone.linearise(_at_rest(self.arm.backbone, rest.strains)).stress_ports @ bending,
            "loads": loads,
        }

    def tangent_samples(self, seed: int = 0) -> PhaseSamples:
        """Phase-space samples of f close to the arm at rest: gEDMD on them is the linearisation of f there.

        Steps come in pairs of opposite sign: second-order terms cancel, which a backbone whose fastest rate is 1e8
        times its slowest needs.

        ``seed`` decides the directions of the steps.
        """
        scene, passive = self.arm.scene, self.arm.backbone
        n, count = scene.n_strains, 16 * scene.n_strains
        rest = scene.statics().solve(self.arm.rest_inputs).state
        rng = np.random.default_rng(seed)
        half = TANGENT_STEP * rng.standard_normal((count // 2, 2 * n))
        steps = np.concatenate([half, -half])
        nominal = scene.nominal_strains
        states = np.tile(rest, (count, 1))
        states[:, : 2 * n] += steps * np.concatenate([nominal, nominal * scene.rod.bending_rate])
        x = ca.MX.sym("x", scene.n_states)
        strains, moving, *hidden = scene.layout.split(x)
        acceleration = prestressed_acceleration(passive)(strains, moving, ca.DM(rest[:n]))
        motion = ca.vertcat(moving, acceleration, *(ca.MX.zeros(part.shape[0]) for part in hidden))
        fields = scene.field_map(self.stations).function(x)
        function = ca.Function("tangent", [x], [fields, ca.jtimes(fields, x, motion)])
        y, velocity = (np.asarray(v).T for v in function.map(count)(states.T))
        return PhaseSamples(y, states[:, scene.layout.inputs], velocity)


def _at_rest(scene: Scene, strains: Array) -> Array:
    return scene.at_rest(strains, np.zeros(scene.n_inputs))
