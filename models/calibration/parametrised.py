"""Actuation of an arm with parameters that can be identified: a term of a rod scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, finite_array, finite_number, positive
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.damping import KelvinVoigt
from pisplit.models.rod.terms.loads import Input, Loads
from pisplit.models.rod.terms.points import add_mass
from pisplit.models.rod.terms.pull import Pull, TendonTerm
from pisplit.smooth import softplus

#: Name of the input that holds the parameters while they are being identified.
PARAMETERS = "parameters"


@dataclass(frozen=True)
class TendonParameters:
    """Parameters of straight tendons and of the backbone they bend.

    offset     (m, 2) points in the section plane at the base in m
    stiffness  (m,) tension per stretch in N/m of a tendon of the backbone's length
    slack      (m,) stretch in m of the undisplaced tendon on the straight backbone; negative: it hangs loose
    rounding   width in m over which the corner between slack and taut is rounded
    shift      (m, 2) by how much the points at the tip differ in m: zero for parallel tendons
    bending    factor of the elastic moments of the backbone: 1 where its stiffness is what the scene says
    damping    factor of its Kelvin-Voigt damping
    tip_mass   mass at the tip in kg beside what the scene has there; negative: the backbone is told too heavy
    """

    offset: Array
    stiffness: Array
    slack: Array
    rounding: float
    shift: Array
    bending: float = 1.0
    damping: float = 1.0
    tip_mass: float = 0.0

    def __post_init__(self) -> None:
        m = len(np.atleast_1d(self.stiffness))
        for name, shape in (("offset", (m, 2)), ("stiffness", (m,)), ("slack", (m,)), ("shift", (m, 2))):
            object.__setattr__(self, name, finite_array(getattr(self, name), f"TendonParameters {name}", shape))
        positive(float(np.min(self.stiffness)), "TendonParameters stiffness", "N/m")
        for name in ("rounding", "bending", "damping"):
            positive(getattr(self, name), f"TendonParameters {name}")
        finite_number(self.tip_mass, "TendonParameters tip_mass")

    @property
    def n_tendons(self) -> int:
        """Number of tendons m."""
        return len(self.stiffness)

    def vector(self, radius: float) -> Array:
        """Parameters (6 m + 4,) of order one about zero: points in radii, logarithms of all that is positive.

        ``radius`` in m.
        """
        return np.concatenate(
            [
                self.offset.ravel() / radius,
                np.log(self.stiffness / REFERENCE_STIFFNESS),
                self.slack / REFERENCE_SLACK,
                np.log([self.rounding / REFERENCE_SLACK, self.bending, self.damping]),
                self.shift.ravel() / radius,
                [self.tip_mass / REFERENCE_MASS],
            ]
        )

    @classmethod
    def of_vector(cls, values: Array, radius: float) -> TendonParameters:
        """The inverse of ``vector``. ``values`` (6 m + 4,), ``radius`` in m."""
        m = (len(values) - 4) // 6
        return cls(
            offset=radius * values[: 2 * m].reshape(m, 2),
            stiffness=REFERENCE_STIFFNESS * np.exp(values[2 * m : 3 * m]),
            slack=REFERENCE_SLACK * values[3 * m : 4 * m],
            rounding=REFERENCE_SLACK * float(np.exp(values[4 * m])),
            bending=float(np.exp(values[4 * m + 1])),
            damping=float(np.exp(values[4 * m + 2])),
            shift=radius * values[4 * m + 3 : 6 * m + 3].reshape(m, 2),
            tip_mass=REFERENCE_MASS * float(values[6 * m + 3]),
        )


REFERENCE_STIFFNESS, REFERENCE_SLACK, REFERENCE_MASS = 1e4, 1e-3, 1e-2


@dataclass(frozen=True)
class CalibratedTendons(TendonTerm):
    """Straight tendons pulled by displacements u, corrections of the backbone, and a mass at the tip.

    Tendon i runs from r_i(0) to r_i(L) in the section plane and has the path a_i = v + w x r_i + r_i', the unstretched
    length l_i = L_i - s_i - u_i with that of the straight backbone L_i, the stretch int |a_i| ds - l_i and, by Hooke's
    law of what is not pulled in, the tension softplus(k_i L / l_i stretch). It adds tension a_i / |a_i| to the
    internal force and its moment at r_i to the internal moment, as ``rod.Tendons`` do.

    Args:
        n_tendons: number of tendons m.
        radius: length in m that offsets are measured in.
        values: parameters (6 m + 4,), see ``TendonParameters.vector``; None makes them an input of the scene.
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
        positive(self.radius, "CalibratedTendons radius", "m")
        if self.values is not None and len(self.values) != 6 * self.n_tendons + 4:
            raise ValueError(f"{len(self.values)} parameters of {self.n_tendons} tendons; expected 6 each and 4 more")
        if self.values is not None:
            finite_array(self.values, "CalibratedTendons values", (None,))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The displacements, and the parameters while they are being identified."""
        moves = Input(self.name, self.n_tendons)
        return (moves,) if self.values is not None else (moves, Input(PARAMETERS, 6 * self.n_tendons + 4))

    @property
    def kept_stiffness(self) -> float:
        """The bending factor where it softens the backbone; 0 while it is being identified."""
        return 0.0 if self.values is None else float(min(1.0, np.exp(self.values[4 * self.n_tendons + 1])))

    @property
    def parameters(self) -> TendonParameters:
        """What was identified."""
        if self.values is None:
            raise ValueError("the parameters of these tendons are an input; they have no values of their own")
        return TendonParameters.of_vector(np.array(self.values), self.radius)

    def points(self, s: float, length: float) -> Array:
        """Points (m, 2) in m of the tendons in the section at arclength ``s`` in m of a rod of ``length`` in m."""
        told = self.parameters
        points: Array = told.offset + s / length * told.shift
        return points

    def pull(self, rod: Rod, rule: Rule) -> Pull:
        """Displacements below what the slack leaves of the length; while parameters are an input, below the length.

        ``rod`` and ``rule``, its nodes, are those of the scene.
        """
        slack = np.zeros(self.n_tendons) if self.values is None else self.parameters.slack
        return Pull(rod.length - slack)

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress. ``motion`` is that of the rod; ``loads`` takes what is added."""
        m, u = self.n_tendons, loads.inputs[self.name]
        given = loads.inputs[PARAMETERS] if self.values is None else ca.SX(ca.DM(list(self.values)))
        bases, shifts = given[: 2 * m], given[4 * m + 3 : 6 * m + 3]
        offsets, shifts = (self.radius * ca.reshape(part, 2, m) for part in (bases, shifts))
        rounding, bending, damping = (ca.exp(given[4 * m + k]) for k in range(3))
        rule = motion.rule
        for i in range(m):
            base, shift = (ca.vertcat(points[:, i], 0) for points in (offsets, shifts))
            r = ca.repmat(base, 1, rule.n_nodes) + shift @ ca.DM(rule.nodes / rule.length).T
            a = motion.v + columnwise_cross(motion.w, r) + ca.repmat(shift / rule.length, 1, rule.n_nodes)
            norm = ca.sqrt(ca.sum1(a * a))
            shortened = REFERENCE_SLACK * given[3 * m + i] + u[i]
            straight = ca.sqrt(rule.length**2 + ca.sumsqr(shift))
            stretch = shortened + norm @ ca.DM(rule.weights) - straight
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
        if self.values is None or self.values[-1] != 0.0:
            add_mass(motion, loads, rule.length, REFERENCE_MASS * given[-1])

    def describe(self, rod: Any) -> str:
        """Number of tendons. ``rod`` is that of the scene."""
        return f"{self.n_tendons} calibrated tendons, {self.name}"
