"""Tendons over disks: straight from hole to hole, with capstan friction at each disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.routing import Route, sample

#: Angle in rad between two chords below which friction at a disk sets in smoothly.
WRAP_FLOOR = 1e-4


def checked_disks(disks: int | Sequence[float]) -> int | tuple[float, ...]:
    """A number of ``disks`` from 1 on, or their arclengths in m as an increasing tuple.

    Raises ValueError for anything else.
    """
    if isinstance(disks, int | np.integer):
        return count(disks, "Tendons disks")
    places = tuple(finite_array(disks, "Tendons disks", (None,)).tolist())
    if not places or any(b <= a for a, b in pairwise((0.0, *places))):
        raise ValueError(f"Tendons disks = {places}; expected a number, or increasing arclengths above 0 in m")
    return places


def holes(disks: int | tuple[float, ...], end: float) -> Array:
    """Arclengths (n + 1,) in m of base plate and ``disks``, the last of which is at ``end`` in m.

    Raises ValueError where the last of given arclengths is elsewhere.
    """
    if isinstance(disks, int):
        return end * np.arange(disks + 1) / disks
    if not np.isclose(disks[-1], end, rtol=1e-9, atol=0.0):
        raise ValueError(
            f"Tendons end at s = {end:g} m and their last disk is at {disks[-1]:g} m; give end= there, or a disk"
        )
    return np.array([0.0, *disks[:-1], end])


@dataclass(frozen=True, eq=False)
class Chords:
    """Straight pieces of m tendons between n + 1 holes in a row, as functions of the strains of a rod.

    Hole i of a tendon is at p(s_i) + R(s_i) r(s_i). Its chords have lengths l_k; under tensions tau_k their virtual
    work is sum_k tau_k dl_k, and the load is the exact derivative of the discrete lengths.

    Attributes:
        routes: one a tendon.
        places: arclengths (n + 1,) in m of the holes, the first at the base.
        rod, rule: the rod and its nodes.
    """

    routes: Sequence[Route]
    places: Array
    rod: Rod
    rule: Rule

    @property
    def spacing(self) -> Array:
        """Arclengths (n,) in m between the holes."""
        return np.diff(self.places)

    def measure(self, strains: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Lengths (n, m) in m, wrap angles (n - 1, m) in rad, and unit vectors (3, n m), tendon by tendon.

        ``strains`` (n_strains,) are the free strains. A wrap angle is that between the chords at both sides of a disk,
        rounded over ``WRAP_FLOOR``; at the base plate and at the last disk there is none.
        """
        n, points = len(self.places) - 1, self.places.tolist()
        motion = self._at(strains)
        p, frames = motion.position_at(points), motion.frames_at(points)
        lengths, angles, ways = [], [], []
        for route in self.routes:
            r = sample(route, self.places, self.rod.length)[0]
            place = p + ca.horzcat(*[frame @ ca.SX(ca.DM(x)) for frame, x in zip(frames, r.T, strict=True)])
            chord = place[:, 1:] - place[:, :-1]
            length = ca.sqrt(ca.sum1(chord * chord))
            way = chord / ca.repmat(length, 3, 1)
            turn = columnwise_cross(way[:, :-1], way[:, 1:])
            sine = ca.sqrt(ca.sum1(turn * turn) + WRAP_FLOOR**2) - WRAP_FLOOR
            cosine = ca.sum1(way[:, :-1] * way[:, 1:])
            lengths.append(length.T)
            angles.append(ca.atan2(sine, cosine).T if n > 1 else ca.SX(0, 1))
            ways.append(way)
        return ca.horzcat(*lengths), ca.horzcat(*angles), ca.horzcat(*ways)

    def rates(self, strains: ca.SX, strain_rates: ca.SX) -> ca.SX:
        """Rates (n, m) of the lengths in m/s. ``strains`` and ``strain_rates`` are (n_strains,)."""
        xi, xi_t = ca.SX.sym("xi", strains.numel()), ca.SX.sym("xi_t", strains.numel())
        lengths = self.measure(xi)[0]
        rates = ca.Function("rates", [xi, xi_t], [ca.jtimes(lengths, xi, xi_t)])
        found: ca.SX = rates(strains, strain_rates)
        return found

    def stress(self, strains: ca.SX, tensions: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Body moments and forces (3, K) that the chords add to the stress at the nodes, in N m and N.

        Moments come from the derivative of the lengths with respect to the strains, forces from that with respect to v,
        dl_k = e_k . int R dv between two holes, also where v is not free.

        ``strains`` (n_strains,) are the free strains, ``tensions`` (n, m) those of the chords in N.
        """
        n, free = len(self.places) - 1, self.rod.strain_set
        xi, tau = ca.SX.sym("xi", strains.numel()), ca.SX.sym("tau", *tensions.shape)
        lengths, _, ways = self.measure(xi)
        weights = self.rule.weights
        work = ca.reshape(ca.jtimes(ca.vec(lengths), xi, ca.vec(tau), True), free.n_fields, self.rule.n_nodes)
        moment = ca.SX(3, self.rule.n_nodes)
        for row, component in enumerate(free.free):
            if component < 3:
                moment[component, :] = work[row, :] / ca.DM(weights[None, :])
        pulls = ca.repmat(ca.vec(tau).T, 3, 1) * ways
        pull = sum(ca.horzsplit(pulls, n)[1:], ca.horzsplit(pulls, n)[0])
        shares = np.diff(self.rule.integrate_to(self.places), axis=0) / weights
        force = self._at(xi).to_body(ca.mtimes(pull, ca.DM(shares)))
        moment_of, force_of = ca.Function("stress", [xi, tau], [moment, force])(strains, tensions)
        return moment_of, force_of

    def unloaded(self) -> Array:
        """Lengths (m,) in m of the tendons on the unloaded rod."""
        rest = self.rod.profile(self.rule.nodes).rest[list(self.rod.strain_set.free)].T.ravel()
        return np.asarray(ca.evalf(ca.sum1(self.measure(ca.SX(ca.DM(rest)))[0]))).ravel()

    def _at(self, strains: ca.SX) -> Motion:
        still = ca.SX(*strains.shape)
        return Motion(self.rod, self.rule, strains, still, still)


def falling(angles: ca.SX, friction: float, slip: ca.SX | float) -> ca.SX:
    """Tension of every chord in parts of that at the base (n,): exp(-mu sum of wrap angle times sign of slip).

    Args:
        angles: wrap angles (n - 1,) in rad at the disks.
        friction: coefficient mu.
        slip: sign of slip at every disk (n - 1,), between -1 and 1, positive where the tendon moves to the base.
    """
    turned, decays = ca.SX(1, 1), []
    for k in range(angles.numel()):
        turned = turned + angles[k] * (slip if isinstance(slip, float) else slip[k])
        decays.append(ca.exp(-friction * turned))
    return ca.vertcat(1.0, *decays)
