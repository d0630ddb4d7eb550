"""Actuation of an arm with parameters that can be identified: a term of a rod scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, count
from pisplit.models.rod.damping import KelvinVoigt
from pisplit.models.rod.kinematics import Motion, columnwise_cross
from pisplit.models.rod.loads import Input, Loads
from pisplit.models.rod.tendons import softplus

#: Name of the input that holds the parameters while they are being identified.
PARAMETERS = "parameters"


@dataclass(frozen=True)
class TendonParameters:
    """Parameters of parallel tendons and of the backbone they bend.

    offset     (m, 2) points in the section plane in m
    stiffness  (m,) tension per stretch in N/m of a tendon of the backbone's length
    slack      (m,) stretch in m of the undisplaced tendon on the straight backbone; negative: it hangs loose
    rounding   width in m over which the corner between slack and taut is rounded
    bending    factor of the elastic moments of the backbone: 1 where its stiffness is what the scene says
    damping    factor of its Kelvin-Voigt damping
    """

    offset: Array
    stiffness: Array
    slack: Array
    rounding: float
    bending: float = 1.0
    damping: float = 1.0

    @property
    def n_tendons(self) -> int:
        """Number of tendons m."""
        return len(self.stiffness)

    def vector(self, radius: float) -> Array:
        """Parameters (4 m + 3,) of order one about zero: offsets in radii, logarithms of all that is positive."""
        return np.concatenate(
            [
                self.offset.ravel() / radius,
                np.log(self.stiffness / REFERENCE_STIFFNESS),
                self.slack / REFERENCE_SLACK,
                np.log([self.rounding / REFERENCE_SLACK, self.bending, self.damping]),
            ]
        )

    @classmethod
    def of_vector(cls, values: Array, radius: float) -> TendonParameters:
        """The inverse of ``vector``."""
        m = (len(values) - 3) // 4
        return cls(
            offset=radius * values[: 2 * m].reshape(m, 2),
            stiffness=REFERENCE_STIFFNESS * np.exp(values[2 * m : 3 * m]),
            slack=REFERENCE_SLACK * values[3 * m : 4 * m],
            rounding=REFERENCE_SLACK * float(np.exp(values[4 * m])),
            bending=float(np.exp(values[4 * m + 1])),
            damping=float(np.exp(values[4 * m + 2])),
        )


REFERENCE_STIFFNESS, REFERENCE_SLACK = 1e4, 1e-3


@dataclass(frozen=True)
class CalibratedTendons:
    """Parallel tendons pulled by displacements u, and corrections of the backbone, as one active stress.

    Tendon i has the path a_i = e3 + w x r_i, the unstretched length l_i = L - s_i - u_i, the stretch
    int |a_i| ds - l_i and, by Hooke's law of what is not pulled in, the tension softplus(k_i L / l_i stretch). It adds
    tension a_i / |a_i| to the internal force and its moment at r_i to the internal moment, as ``rod.Tendons`` do.

    Args:
        n_tendons: number of tendons m.
        radius: length in m that offsets are measured in.
        values: parameters (4 m + 3,), see ``TendonParameters.vector``; None makes them an input of the scene.
        backbone: Kelvin-Voigt damping that the damping factor multiplies.
        name: name of the input of the displacements.
    """

    n_tendons: int
    radius: float
    values: tuple[float, ...] | None
    backbone: KelvinVoigt
    name: str = "tendons"

    def __post_init__(self) -> None:
        count(self.n_tendons, "CalibratedTendons n_tendons")
        if self.values is not None and len(self.values) != 4 * self.n_tendons + 3:
            raise ValueError(f"{len(self.values)} parameters of {self.n_tendons} tendons; expected 4 each and 3 more")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The displacements, and the parameters while they are being identified."""
        moves = Input(self.name, self.n_tendons)
        return (moves,) if self.values is not None else (moves, Input(PARAMETERS, 4 * self.n_tendons + 3))

    @property
    def offsets(self) -> tuple[tuple[float, float], ...]:
        """Identified offsets (m, 2) in m."""
        if self.values is None:
            raise ValueError("the parameters of these tendons are an input; their offsets are not known")
        return tuple(map(tuple, TendonParameters.of_vector(np.array(self.values), self.radius).offset.tolist()))

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress."""
        m, u = self.n_tendons, loads.inputs[self.name]
        given = loads.inputs[PARAMETERS] if self.values is None else ca.SX(ca.DM(list(self.values)))
        offsets = self.radius * ca.reshape(given[: 2 * m], 2, m)
        rounding, bending, damping = (ca.exp(given[4 * m + k]) for k in range(3))
        rule = motion.rule
        for i in range(m):
            r = ca.repmat(ca.vertcat(offsets[:, i], 0), 1, rule.n_nodes)
            a = motion.v + columnwise_cross(motion.w, r)
            norm = ca.sqrt(ca.sum1(a * a))
            shortened = REFERENCE_SLACK * given[3 * m + i] + u[i]
            stretch = shortened + norm @ ca.DM(rule.weights) - rule.length
            stiffness = REFERENCE_STIFFNESS * ca.exp(given[2 * m + i]) / (1.0 - shortened / rule.length)
            # The corner is rounded over a stretch, so that the logarithm of the width is a regular parameter.
            tension = stiffness * REFERENCE_SLACK * rounding * softplus(stretch / (REFERENCE_SLACK * rounding), 1.0)
            pull = tension * a / ca.repmat(norm, 3, 1)
            loads.stress_v += pull
            loads.stress_w += columnwise_cross(r, pull)
        profile = motion.rod.profile(rule.nodes)
        elastic = ca.DM(profile.stiffness[:3]) * (motion.w - ca.DM(profile.rest[:3]))
        viscous = ca.DM(np.diag([self.backbone.coefficient(c) for c in range(3)])) @ motion.w_t
        loads.stress_w += (bending - 1.0) * elastic + (damping - 1.0) * viscous

    def describe(self, rod: Any) -> str:
        """Number of tendons."""
        return f"{self.n_tendons} calibrated tendons, {self.name}"
