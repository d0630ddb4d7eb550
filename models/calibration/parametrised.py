"""Actuation of an arm with parameters that can be identified: a term of a rod scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, finite_array, positive
from pisplit.models.calibration.parameters import (
    OTHERS,
    REFERENCE_FRICTION,
    REFERENCE_MASS,
    REFERENCE_SLACK,
    REFERENCE_SPEED,
    REFERENCE_STIFFNESS,
    TendonParameters,
)
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.damping import KelvinVoigt
from pisplit.models.rod.terms.disks import Chords, checked_disks, falling, slipping
from pisplit.models.rod.terms.loads import Input, Loads
from pisplit.models.rod.terms.points import add_mass
from pisplit.models.rod.terms.pull import Pull, TendonTerm
from pisplit.models.rod.terms.tendons import turned_angle
from pisplit.smooth import softplus

#: Name of the input that holds the parameters while they are being identified.
PARAMETERS = "parameters"


@dataclass(frozen=True)
class CalibratedTendons(TendonTerm):
    """Straight tendons pulled by displacements u, corrections of the backbone, and a mass at the tip.

    Tendon i runs from r_i(0) to r_i(L) in the section plane and has the path a_i = v + w x r_i + r_i', the unstretched
    length l_i = L_i - s_i - u_i with that of the straight backbone L_i, the stretch int |a_i| ds - l_i and, by Hooke's
    law of what is not pulled in, the tension softplus(k_i L / l_i stretch). It adds tension a_i / |a_i| to the
    internal force and its moment at r_i to the internal moment, as ``rod.Tendons`` do. With disks they run straight
    from hole to hole; with friction the tension falls from the base along the tendon, as it does there.

    Args:
        n_tendons: number of tendons m.
        radius: length in m that offsets are measured in.
        values: parameters (6 m + 6,), see ``TendonParameters.vector``; None makes them an input of the scene.
        backbone: Kelvin-Voigt damping that the damping factor multiplies.
        name: name of the input of the displacements.
        disks: number of disks at equal distances, or their arclengths (n,) in m; None: along the backbone.
        rubs: whether friction is looked at; without, its parameters say nothing.

    Raises ValueError for another number of parameters, and for values that are asked of parameters that are inputs.
    """

    n_tendons: int
    radius: float
    values: tuple[float, ...] | None
    backbone: KelvinVoigt
    name: str = "tendons"
    disks: int | Sequence[float] | None = None
    rubs: bool = False

    def __post_init__(self) -> None:
        count(self.n_tendons, "CalibratedTendons n_tendons")
        positive(self.radius, "CalibratedTendons radius", "m")
        if self.disks is not None:
            object.__setattr__(self, "disks", checked_disks(self.disks))
        if self.values is not None and len(self.values) != 6 * self.n_tendons + OTHERS:
            told = f"{len(self.values)} parameters of {self.n_tendons} tendons"
            raise ValueError(f"{told}; expected 6 each and {OTHERS} more")
        if self.values is not None:
            finite_array(self.values, "CalibratedTendons values", (None,))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The displacements, and the parameters while they are being identified."""
        moves = Input(self.name, self.n_tendons)
        return (moves,) if self.values is not None else (moves, Input(PARAMETERS, 6 * self.n_tendons + OTHERS))

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

    @property
    def friction(self) -> float:
        """Coefficient of friction; 1 while it is being identified: what rubs has no energy."""
        if not self.rubs:
            return 0.0
        return 1.0 if self.values is None else self.parameters.friction

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress. ``motion`` is that of the rod; ``loads`` takes what is added."""
        m, rule = self.n_tendons, motion.rule
        given = loads.inputs[PARAMETERS] if self.values is None else ca.SX(ca.DM(list(self.values)))
        self._correct(motion, loads, given)
        points, shifts = (self.radius * ca.reshape(given[k : k + 2 * m], 2, m) for k in (0, 4 * m + 3))
        over = _OverDisks if self.disks is not None else _AlongBackbone
        paths = over(self, motion, [(points[:, i], shifts[:, i]) for i in range(m)], given)
        tensions = []
        for i, (length, decay, mean) in enumerate(zip(*paths.lengths, strict=True)):
            shortened = REFERENCE_SLACK * given[3 * m + i] + loads.inputs[self.name][i]
            stretch = shortened + length - ca.sqrt(rule.length**2 + ca.sumsqr(shifts[:, i]))
            stiffness = REFERENCE_STIFFNESS * ca.exp(given[2 * m + i]) / (1.0 - shortened / rule.length)
            # The corner is rounded over a stretch, so that the logarithm of the width is a regular parameter.
            width = REFERENCE_SLACK * ca.exp(given[4 * m])
            tensions.append(stiffness * width * softplus(stretch / width, 1.0) / mean * decay)
        moment, force = paths.stress(tensions)
        loads.stress_w += moment
        loads.stress_v += force

    def _correct(self, motion: Motion, loads: Loads, given: ca.SX) -> None:
        """Stiffness and damping of the backbone and the mass at the tip."""
        m, rule = self.n_tendons, motion.rule
        bending, damping = (ca.exp(given[4 * m + k]) for k in (1, 2))
        profile = motion.rod.profile(rule.nodes)
        elastic = ca.DM(profile.stiffness[:3]) * (motion.w - ca.DM(profile.rest[:3]))
        viscous = ca.DM(np.diag([self.backbone.coefficient(c) for c in range(3)])) @ motion.w_t
        loads.stress_w += (bending - 1.0) * elastic + (damping - 1.0) * viscous
        if self.values is None or self.values[6 * m + 3] != 0.0:
            add_mass(motion, loads, rule.length, REFERENCE_MASS * given[6 * m + 3])

    def describe(self, rod: Any) -> str:
        """Number of tendons. ``rod`` is that of the scene."""
        disks = "" if self.disks is None else f" over {len(self.holes(rod.length)) - 1} disks"
        return f"{self.n_tendons} calibrated tendons{disks}, {self.name}"


class _AlongBackbone:
    """Paths a = v + w x r + r' at the nodes; friction as when the tendons are being pulled.

    Args:
        term: the tendons.
        motion: that of the rod.
        points: of every tendon at the base, and by how much it is elsewhere at the tip, (2,) each in m.
        given: all parameters.
    """

    def __init__(self, term: CalibratedTendons, motion: Motion, points: Sequence[tuple[ca.SX, ca.SX]], given: ca.SX):
        rule = motion.rule
        self.routes: list[ca.SX] = []
        self.ways: list[ca.SX] = []
        self.lengths: tuple[list[ca.SX], list[ca.SX], list[ca.SX]] = ([], [], [])
        for base, shift in ((ca.vertcat(a, 0), ca.vertcat(b, 0)) for a, b in points):
            r = ca.repmat(base, 1, rule.n_nodes) + shift @ ca.DM(rule.nodes / rule.length).T
            a = motion.v + columnwise_cross(motion.w, r) + ca.repmat(shift / rule.length, 1, rule.n_nodes)
            norm = ca.sqrt(ca.sum1(a * a))
            decay, mean = ca.SX.ones(1, rule.n_nodes), ca.SX(1)
            if term.rubs:
                friction = REFERENCE_FRICTION * given[6 * term.n_tendons + 4]
                decay = ca.exp(-friction * turned_angle(a, norm, motion, rule.n_nodes))
                mean = decay @ ca.DM(rule.weights / rule.length)
            self.routes.append(r)
            self.ways.append(a / ca.repmat(norm, 3, 1))
            for part, value in zip(self.lengths, (norm @ ca.DM(rule.weights), decay, mean), strict=True):
                part.append(value)

    def stress(self, tensions: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Moments and forces (3, K) at the nodes of ``tensions`` (1, K) there."""
        moment = force = ca.SX(3, tensions[0].numel())
        for r, way, tension in zip(self.routes, self.ways, tensions, strict=True):
            pull = ca.repmat(tension, 3, 1) * way
            moment, force = moment + columnwise_cross(r, pull), force + pull
        return moment, force


class _OverDisks:
    """Chords from hole to hole; friction at the disks both ways in motion, as when they are being pulled at rest.

    Arguments as in ``_AlongBackbone``.
    """

    def __init__(self, term: CalibratedTendons, motion: Motion, points: Sequence[tuple[ca.SX, ca.SX]], given: ca.SX):
        length = motion.rule.length
        places = term.holes(length)
        along = ca.DM(places / length).T
        pairs = [(ca.vertcat(a, 0), ca.vertcat(b, 0)) for a, b in points]
        spots = [ca.repmat(base, 1, len(places)) + shift @ along for base, shift in pairs]
        self.motion, self.chords = motion, Chords(spots, places, motion.rule)
        sizes, angles = self.chords.measure(motion.w, motion.v)
        friction = REFERENCE_FRICTION * given[6 * term.n_tendons + 4]
        slip: ca.SX | float = 1.0
        if term.rubs and motion.rates.nnz():
            speed = REFERENCE_SPEED * ca.exp(given[6 * term.n_tendons + 5])
            slip = slipping(self.chords.rates(motion.w, motion.v, motion.w_t, motion.v_t), speed)
        self.lengths: tuple[list[ca.SX], list[ca.SX], list[ca.SX]] = ([], [], [])
        for i in range(len(points)):
            decay, mean = ca.SX.ones(sizes.shape[0], 1), ca.SX(1)
            if term.rubs:
                decay = falling(angles[:, i], friction, slip if isinstance(slip, float) else slip[:, i])
                mean = ca.dot(decay, ca.DM(self.chords.spacing / length))
            for part, value in zip(self.lengths, (ca.sum1(sizes[:, i]), decay, mean), strict=True):
                part.append(value)

    def stress(self, tensions: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX]:
        """Moments and forces (3, K) at the nodes of ``tensions`` (n, 1) of the chords."""
        return self.chords.stress(self.motion.w, self.motion.v, ca.horzcat(*tensions))
