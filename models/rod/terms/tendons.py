"""Tendons as active stress on the strains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.section.texts import OPTION, brief
from pisplit.models.rod.terms.disks import Chords, checked_disks, falling, slipping
from pisplit.models.rod.terms.idle import idle_on_the_axis
from pisplit.models.rod.terms.loads import Input, Loads
from pisplit.models.rod.terms.pull import Pull, TendonTerm
from pisplit.models.rod.terms.routing import (
    Helix,
    Line,
    Route,
    check_routes,
    checked_routes,
    nodes_before,
    on_circle,
    sample,
)
from pisplit.smooth import softplus

#: Strain of a displaced tendon over which slack sets in when no tension is given: 0.1 N on the paper's arm.
SLACK_STRAIN = 1e-5
#: Turning over the length of the rod in rad below which capstan friction sets in smoothly.
TURN_FLOOR = 1e-6
#: What tendons over disks offer for reading.
READINGS = ("tension", "length", "unpulled_length", "chord_tension")
#: Offsets in m that are rounding, such as the sine of 180 degrees.
IN_PLANE = 1e-12


@dataclass(frozen=True)
class Displacement:
    """Each tendon is pulled by a displacement u_i in m (positive pulls): tension from its elastic stretch.

    ``tau_i = max(0, (l_i - l*_i) / (c (l*_i + o)))`` with ``l*_i = L_i - u_i``, the path length ``l_i``, and the length
    o outside the rod; a slack tendon carries nothing. The corner at slack is rounded.

    Args:
        compliance: c in 1/N, strain of the tendon per newton.
        slack_smoothing: tension in N over which slack sets in; at the corner the tension is off by 0.69 of it. When not
            given, that of a strain of 1e-5, which suits tendons of any stiffness.
        outside: length o in m of each tendon between motor and base, which stretches too; without friction.
    """

    compliance: float
    slack_smoothing: float | None = None
    outside: float = 0.0

    def __post_init__(self) -> None:
        positive(self.compliance, "Displacement compliance", "1/N")
        if self.slack_smoothing is not None:
            positive(self.slack_smoothing, "Displacement slack_smoothing", "N")
        non_negative(self.outside, "Displacement outside", "m")

    def tension(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """Tension in N of one tendon with path length ``length``, unpulled length ``rest`` and displacement ``u``."""
        unstretched = self.unstretched(length, rest, u)
        smoothing = SLACK_STRAIN / self.compliance if self.slack_smoothing is None else self.slack_smoothing
        return softplus((length - unstretched) / (self.compliance * (unstretched + self.outside)), smoothing)

    def unstretched(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """Length in m at which the tendon just carries nothing.

        ``rest`` is the unpulled length in m, ``u`` the displacement in m; the path ``length`` in m does not matter.
        """
        return rest - u

    def describe(self) -> str:
        """Law, compliance and length outside the rod."""
        beyond = f", {self.outside:g} m outside the rod" if self.outside else ""
        return f"displacement drive, compliance {self.compliance:g} 1/N{beyond}"


@dataclass(frozen=True)
class Tension:
    """Each tendon is driven by its tension u_i in N, which is not negative: tendons do not push."""

    def tension(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """The input itself. ``u`` is the tension in N; path ``length`` and unpulled ``rest`` in m do not matter."""
        return u

    def unstretched(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """The path length: a tendon driven by its tension is never slack.

        Path ``length`` in m; unpulled length ``rest`` and tension ``u`` do not matter.
        """
        return length

    def describe(self) -> str:
        """Law."""
        return "tension drive"


@dataclass(frozen=True, repr=False)
class Tendons(TendonTerm):
    """Tendons that run along the rod at any offsets r_i(s) in the section plane.

    With ``a_i = v + w x r_i + r_i'`` and ``t_i = a_i / |a_i|``, tendon i adds ``tau_i t_i`` to the internal force and
    ``tau_i r_i x t_i`` to the internal moment; its path length is ``int |a_i| ds``. Distributed load and termination
    wrench of the tendon follow from virtual work (Rucker & Webster, IEEE T-RO 2011, the same load in strong form).

    Args:
        offsets: one entry a tendon: a point (x, y) in m (parallel), or a function of arclength s in m that returns one,
            such as ``Helix`` and ``Line``; it must be smooth within each element.
        drive: ``Displacement(compliance)`` or ``Tension()``.
        name: name of the input with one entry a tendon.
        end: arclength in m at which the tendons are fixed to the rod, the tip when not given. The load jumps there, so
            an element must end there: then path and load stop exactly.
        friction: coefficient mu of capstan friction: the tension falls from the base by exp(-mu phi) with the angle phi
            in rad by which the path has turned, as when the tendon is being pulled. The drive acts at the base; with a
            displacement drive the stretch is that of the mean tension. Friction the other way, on
            release, is not modelled without disks.
        disks: number of disks at equal distances, or their arclengths (n,) in m; none when not given. The tendons then
            run straight from hole to hole, from the base plate at s = 0 to the last disk, which is where they ``end``:
            their length is that of the chords, they load the rod at the disks, and the angle phi of friction is that
            between the chords at both sides of each disk. Many disks tend to tendons without them, with the square of
            the distance. An element from disk to disk resolves the bending between them; disks have no mass here
            (``PointMass.disc``).
        slip_speed: speed in m/s over which friction at the disks turns round, by tanh of the speed at which the tendon
            slides through each; at rest it holds nothing then, and rods creep at that speed. Statics, and motion when
            it is not given: as when the tendon is being pulled.
        stiction: by how much friction at slow slip exceeds that at fast slip, in parts of it, below five times the
            ``slip_speed`` (Stribeck's curve); in motion alone.

    Raises ValueError for offsets that are none, and for friction at disks where there are no disks.
    """

    offsets: Sequence[Route]
    drive: Displacement | Tension = field(default_factory=Tension)
    name: str = "tendons"
    end: float | None = field(default=None, metadata=OPTION)
    friction: float = field(default=0.0, metadata=OPTION)
    disks: int | Sequence[float] | None = field(default=None, metadata=OPTION)
    slip_speed: float | None = field(default=None, metadata=OPTION)
    stiction: float = field(default=0.0, metadata=OPTION)

    def __post_init__(self) -> None:
        object.__setattr__(self, "offsets", checked_routes(self.offsets, "Tendons"))
        if self.end is not None:
            positive(self.end, "Tendons end", "m")
        non_negative(self.friction, "Tendons friction")
        if self.disks is not None:
            object.__setattr__(self, "disks", checked_disks(self.disks))
        if self.slip_speed is not None:
            positive(self.slip_speed, "Tendons slip_speed", "m/s")
            if self.disks is None:
                raise ValueError("Tendons slip_speed is that of friction at disks; give disks= too, or leave it out")
        if non_negative(self.stiction, "Tendons stiction") and self.slip_speed is None:
            raise ValueError("Tendons stiction is that of slow slip at disks; give slip_speed= too, or leave it out")

    __repr__ = brief

    @classmethod
    def parallel(
        cls,
        offset: float,
        angles_deg: Sequence[float],
        drive: Displacement | Tension,
        name: str = "tendons",
        end: float | None = None,
        friction: float = 0.0,
        disks: int | Sequence[float] | None = None,
        slip_speed: float | None = None,
    ) -> Tendons:
        """Tendons on a circle of radius ``offset`` in m at ``angles_deg`` in degrees.

        ``drive``, ``name``, ``end``, ``friction``, ``disks`` and ``slip_speed`` as in the class.
        """
        points = on_circle(offset, angles_deg, "Tendons")
        return cls([tuple(p) for p in points], drive, name, end, friction, disks, slip_speed)

    @classmethod
    def helical(
        cls,
        offset: float,
        pitch: float,
        angles_deg: Sequence[float],
        drive: Displacement | Tension,
        name: str = "tendons",
        end: float | None = None,
        friction: float = 0.0,
        disks: int | Sequence[float] | None = None,
        slip_speed: float | None = None,
    ) -> Tendons:
        """Tendons on helices of radius ``offset`` and ``pitch`` in m that start at ``angles_deg`` in degrees.

        ``drive``, ``name``, ``end``, ``friction``, ``disks`` and ``slip_speed`` as in the class.
        """
        phases = np.deg2rad(finite_array(angles_deg, "Tendons angles_deg", (None,)))
        routes = [Helix(offset, pitch, phase) for phase in phases.tolist()]
        return cls(routes, drive, name, end, friction, disks, slip_speed)

    @classmethod
    def converging(
        cls,
        start: float,
        end_offset: float,
        length: float,
        angles_deg: Sequence[float],
        drive: Displacement | Tension,
        name: str = "tendons",
        end: float | None = None,
        friction: float = 0.0,
        disks: int | Sequence[float] | None = None,
        slip_speed: float | None = None,
    ) -> Tendons:
        """Tendons at ``angles_deg`` with an offset from ``start`` at the base to ``end_offset`` at ``length``; in m.

        ``drive``, ``name``, ``end``, ``friction``, ``disks`` and ``slip_speed`` as in the class.
        """
        directions = on_circle(1.0, angles_deg, "Tendons")
        lines = [Line((start * x, start * y), (end_offset * x, end_offset * y), length) for x, y in directions]
        return cls(lines, drive, name, end, friction, disks, slip_speed)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """One input with an entry a tendon."""
        return (Input(self.name, len(self.offsets)),)

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress of every tendon ; offers ``tension`` (at the base), ``length``, ``unpulled_length``.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """
        if self.disks is not None:
            self._apply_over_disks(motion, loads)
            return
        u, k = loads.inputs[self.name], motion.rule.n_nodes
        unpulled = self.unpulled_lengths(motion.rod, motion.rule)
        n = self._n_loaded(motion.rule)
        weights = ca.DM(motion.rule.weights[:n])
        readings: dict[str, list[ca.SX]] = {"tension": [], "length": [], "unpulled_length": []}
        for i, route in enumerate(self.offsets):
            r, slope = (ca.SX(ca.DM(x)) for x in sample(route, motion.rule.nodes[:n], motion.rod.length))
            a = motion.v[:, :n] + columnwise_cross(motion.w[:, :n], r) + slope
            norm = ca.sqrt(ca.sum1(a * a))
            length = norm @ weights
            tension = self.drive.tension(length, float(unpulled[i]), u[i])
            along: ca.SX = tension
            if self.friction > 0.0:
                decay = ca.exp(-self.friction * turned_angle(a, norm, motion, n))
                if isinstance(self.drive, Displacement):
                    outside, inside = self.drive.outside, float(np.sum(motion.rule.weights[:n]))
                    tension = tension * (inside + outside) / (decay @ weights + outside)
                along = ca.repmat(tension * decay, 3, 1)
            pull = ca.horzcat(along * a / ca.repmat(norm, 3, 1), ca.SX(3, k - n))
            loads.stress_v += pull
            loads.stress_w += columnwise_cross(ca.horzcat(r, ca.SX(3, k - n)), pull)
            readings["tension"].append(tension)
            readings["length"].append(length)
            readings["unpulled_length"].append(self.drive.unstretched(length, float(unpulled[i]), u[i]))
        for name, values in readings.items():
            loads.outputs[name] = ca.vertcat(loads.outputs.get(name, ca.SX(0, 1)), *values)

    def _apply_over_disks(self, motion: Motion, loads: Loads) -> None:
        """The same for chords between disks; offers the ``chord_tension`` too, tendon by tendon."""
        u, chords = loads.inputs[self.name], self._chords(motion.rod, motion.rule)
        lengths, angles = chords.measure(motion.w, motion.v)
        unpulled, rubs = chords.unloaded(motion.profile.rest), self.friction > 0.0
        slip: ca.SX | float = 1.0
        if rubs and self.slip_speed is not None and motion.rates.nnz():
            rates = chords.rates(motion.w, motion.v, motion.w_t, motion.v_t)
            slip = slipping(rates, self.slip_speed, self.stiction)
        tensions, readings = [], {name: loads.outputs.get(name, ca.SX(0, 1)) for name in READINGS}
        for i in range(len(self.offsets)):
            length = ca.sum1(lengths[:, i])
            at_base = tension = self.drive.tension(length, float(unpulled[i]), u[i])
            along = ca.repmat(tension, lengths.shape[0], 1)
            if rubs:
                decay = falling(angles[:, i], self.friction, slip if isinstance(slip, float) else slip[:, i])
                if isinstance(self.drive, Displacement):
                    outside, inside = self.drive.outside, float(chords.spacing.sum())
                    at_base = tension * (inside + outside) / (ca.dot(decay, ca.DM(chords.spacing)) + outside)
                along = at_base * decay
            tensions.append(along)
            slack_at = self.drive.unstretched(length, float(unpulled[i]), u[i])
            for name, value in zip(READINGS, (at_base, length, slack_at, along), strict=True):
                readings[name] = ca.vertcat(readings[name], value)
        moment, force = chords.stress(motion.w, motion.v, ca.horzcat(*tensions))
        loads.stress_w += moment
        loads.stress_v += force
        loads.outputs |= readings

    def _chords(self, rod: Rod, rule: Rule) -> Chords:
        return Chords.of_routes(self.offsets, self.holes(rod.length), rod.length, rule)

    def unpulled_lengths(self, rod: Rod, rule: Rule) -> Array:
        """Path length (m,) in m of every tendon on the unloaded rod, by the quadrature of ``rule`` or of its chords."""
        if self.disks is not None:
            return self._chords(rod, rule).unloaded(rod.profile(rule.nodes).rest)
        n = self._n_loaded(rule)
        rest = rod.profile(rule.nodes[:n]).rest
        straight = not np.any(rest[:3])
        lengths = []
        for route in self.offsets:
            if straight and not callable(route):
                lengths.append(rod.length if self.end is None else self.end)
            else:
                r, slope = sample(route, rule.nodes[:n], rod.length)
                a = rest[3:] + np.cross(rest[:3], r, axis=0) + slope
                lengths.append(float(np.linalg.norm(a, axis=0) @ rule.weights[:n]))
        return np.array(lengths)

    def jumps(self, rod: Rod) -> list[float]:
        """Where the load of the ``rod`` jumps: at their end; at disks it does everywhere, see ``disks``."""
        return [] if self.end is None else [self.end]

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError where the tendons do not fit a rod.

        ``rod`` and ``rule``, its nodes, are those of the scene.
        """
        n = self._n_loaded(rule)
        if rod.kinks and (self.disks is not None or self.friction):
            raise ValueError(
                "Tendons with disks or friction do not pass the kinks of a Rod; give disks=None, friction=0"
            )
        check_routes(self.offsets, rule, n, rod.length, "Tendons")
        places = rule.nodes[:n] if self.disks is None else self.holes(rod.length)
        for route in self.offsets:
            r, slope = sample(route, places, rod.length)
            if rod.strain_set.planar and max(np.abs(r[1]).max(), np.abs(slope[1]).max() * rod.length) > IN_PLANE:
                raise ValueError("a planar rod takes tendons in its plane only; offsets must have y = 0")

    def idle(self, rod: Rod, terms: tuple[Any, ...]) -> str | None:
        """Why some act on nothing, if so: tendons along the axis of a rod that does not stretch.

        ``rod`` and ``terms`` are those of the scene.
        """
        return idle_on_the_axis(self.offsets, rod)

    def points(self, s: float, length: float) -> Array:
        """Points (m, 2) in m of the tendons in the section at arclength ``s`` in m of a rod of ``length`` in m."""
        return np.array([sample(route, np.array([s]), length)[0][:2, 0] for route in self.offsets])

    def pull(self, rod: Rod, rule: Rule) -> Pull:
        """Displacements below the unpulled lengths, or tensions that are not negative.

        ``rod`` and ``rule``, its nodes, are those of the scene.
        """
        return Pull(self.unpulled_lengths(rod, rule) if isinstance(self.drive, Displacement) else None)

    def _n_loaded(self, rule: Rule) -> int:
        return nodes_before(self.end, rule, "Tendons")

    def describe(self, rod: Any) -> str:
        """Number, offset and drive. ``rod`` is that of the scene."""
        parallel = not any(callable(route) for route in self.offsets)
        radius = float(np.hypot(*self.points(0.0, rod.length).T).mean())
        end = "" if self.end is None else f", to s = {self.end:g} m"
        friction = f", friction {self.friction:g}" if self.friction else ""
        kind = "parallel" if parallel else "routed"
        disks = "" if self.disks is None else f", {len(self.holes(rod.length)) - 1} disks"
        how = f"{self.drive.describe()}{end}{friction}{disks}"
        return f"{len(self.offsets)} {kind} tendons, offset {1e3 * radius:g} mm, {how}"


def turned_angle(a: ca.SX, norm: ca.SX, motion: Motion, n: int) -> ca.SX:
    """Angle (1, n) in rad by which a path with body tangent ``a`` (3, n) has turned between base and node.

    The world tangent R a / |a| turns by |a x (a' + w x a)| / |a|^2 a metre; a' is that of the polynomial through the
    nodes. Rounded over ``TURN_FLOOR`` / L where the path is straight.

    ``norm`` (1, n) is |a|; ``motion`` is that of the rod.
    """
    rule = motion.rule
    rate = a @ ca.DM(rule.differentiation[:n, :n].T) + columnwise_cross(motion.w[:, :n], a)
    turn = columnwise_cross(a, rate) / ca.repmat(norm**2, 3, 1)
    floor = TURN_FLOOR / rule.length
    speed = ca.sqrt(ca.sum1(turn * turn) + floor**2) - floor
    return speed @ ca.DM(rule.integration[:n, :n].T)
