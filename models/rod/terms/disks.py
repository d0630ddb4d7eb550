"""Tendons over disks: straight from hole to hole, with capstan friction at each disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.kinematics.gauss import GaussRule, Rule
from pisplit.models.rod.kinematics.rotations import compose, exponential, rotation_matrix
from pisplit.models.rod.kinematics.strains import rotation_vector, turn_rows
from pisplit.models.rod.terms.routing import Route, sample

#: Angle in rad between two chords below which friction at a disk sets in smoothly.
WRAP_FLOOR = 1e-6
#: Nodes of a piece of the rod over which a chord's pose is integrated: good to the sixth power of its angle.
PIECE = GaussRule(1.0, 3)
#: Speed above which Stribeck friction is that of fast slip, in speeds over which it turns round.
STRIBECK = 5.0


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

    Each chord depends on the strains between its two holes alone, in whose frames it is measured: the pose of one hole
    as seen from that before it is integrated from the strains, frames and positions alike, so that chords are as
    accurate as the strains are. Under tensions tau_k their virtual work is sum_k tau_k dl_k, and the load is the exact
    derivative of the discrete lengths.

    Attributes:
        points: one a tendon, (3, n + 1): where it passes base plate and disks in their sections, in m.
        places: arclengths (n + 1,) in m of the holes, the first at the base.
        rule: the nodes of the rod.
    """

    points: Sequence[ca.SX]
    places: Array
    rule: Rule

    @classmethod
    def of_routes(cls, routes: Sequence[Route], places: Array, length: float, rule: Rule) -> Chords:
        """Chords of ``routes`` on a rod of ``length`` in m; ``places`` and ``rule`` as in the class."""
        return cls([ca.SX(ca.DM(sample(route, places, length)[0])) for route in routes], places, rule)

    @property
    def spacing(self) -> Array:
        """Arclengths (n,) in m between the holes."""
        return np.diff(self.places)

    def measure(self, w: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Lengths (n, m) in m and wrap angles (n - 1, m) in rad under strains ``w`` and ``v`` (3, K) at the nodes.

        A wrap angle is that between the chords at both sides of a disk, rounded over ``WRAP_FLOOR``; at the base plate
        and at the last disk there is none.
        """
        poses, lengths, angles = self._poses(w, v), [], []
        for points in self.points:
            r = ca.horzsplit(points)
            chords = [p + frame @ there - here for (frame, p), here, there in zip(poses, r, r[1:], strict=False)]
            sizes = [ca.norm_2(chord) for chord in chords]
            ways = [chord / size for chord, size in zip(chords, sizes, strict=True)]
            turned = []
            for k, (frame, _) in enumerate(poses[:-1]):
                arrives, leaves = frame.T @ ways[k], ways[k + 1]  # in the section of the disk
                turn = ca.cross(arrives, leaves)
                sine = ca.sqrt(ca.sumsqr(turn) + WRAP_FLOOR**2) - WRAP_FLOOR
                turned.append(ca.atan2(sine, ca.dot(arrives, leaves)))
            lengths.append(ca.vertcat(*sizes))
            angles.append(ca.vertcat(ca.SX(0, 1), *turned))
        return ca.horzcat(*lengths), ca.horzcat(*angles)

    def rates(self, w: ca.SX, v: ca.SX, w_t: ca.SX, v_t: ca.SX) -> ca.SX:
        """Rates (n, m) of the lengths in m/s under strains ``w``, ``v`` and their rates ``w_t``, ``v_t`` (3, K)."""
        strains, lengths, points = self._lengths
        way = ca.SX.sym("way", strains.numel())
        rates = ca.Function("rates", [strains, points, way], [ca.jtimes(ca.vec(lengths), strains, way)])
        found: ca.SX = rates(_stacked(w, v), self._points, _stacked(w_t, v_t))
        return ca.reshape(found, len(self.places) - 1, len(self.points))

    def stress(self, w: ca.SX, v: ca.SX, tensions: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Body moments and forces (3, K) that the chords add to the stress at the nodes, in N m and N.

        The derivatives of the lengths with respect to the strains ``w`` and ``v`` (3, K), also of those that are not
        free, times ``tensions`` (n, m) of the chords in N.
        """
        strains, lengths, points = self._lengths
        tau = ca.SX.sym("tau", lengths.numel())
        work = ca.jtimes(ca.vec(lengths), strains, tau, True)
        acting = ca.Function("stress", [strains, points, tau], [work])(_stacked(w, v), self._points, ca.vec(tensions))
        moment, force = ca.vertsplit(acting, 3 * self.rule.n_nodes)
        weights = ca.repmat(ca.DM(self.rule.weights[None, :]), 3, 1)
        return ca.reshape(moment, *weights.shape) / weights, ca.reshape(force, *weights.shape) / weights

    def unloaded(self, rest: Array) -> Array:
        """Lengths (m,) in m of tendons at known points under the strains ``rest`` (6, K) of the unloaded rod."""
        strains = ca.SX(ca.DM(rest))
        return np.asarray(ca.evalf(ca.sum1(self.measure(strains[:3, :], strains[3:, :])[0]))).ravel()

    @property
    def _points(self) -> ca.SX:
        return ca.vertcat(*[ca.vec(points) for points in self.points])

    @cached_property
    def _lengths(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols of all nodal strains (6 K,), w before v; lengths (n, m); symbols of the points of the tendons."""
        holes_of, nodes = len(self.places), self.rule.n_nodes
        strains, points = ca.SX.sym("strains", 6 * nodes), ca.SX.sym("points", 3 * holes_of * len(self.points))
        w, v = (ca.reshape(part, 3, nodes) for part in ca.vertsplit(strains, 3 * nodes))
        own = [ca.reshape(part, 3, holes_of) for part in ca.vertsplit(points, 3 * holes_of)]
        return strains, Chords(own, self.places, self.rule).measure(w, v)[0], points

    def _poses(self, w: ca.SX, v: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
        """Rotation (3, 3) and position (3,) of every hole's section as seen from that of the hole before."""
        found = []
        for start, end in pairwise(self.places.tolist()):
            frame, p = ca.SX(ca.DM([1.0, 0.0, 0.0, 0.0])), ca.SX(3, 1)
            for a, b in pairwise(_cuts(self.rule, start, end)):
                rows = ca.DM(self.rule.interpolate(a + (b - a) * PIECE.nodes).T)
                turn, step = _piece()(w @ rows, v @ rows, b - a)
                p = p + rotation_matrix(frame) @ step
                frame = compose(frame, turn)
            found.append((rotation_matrix(frame), p))
        return found


def _stacked(w: ca.SX, v: ca.SX) -> ca.SX:
    return ca.vertcat(ca.vec(ca.densify(w)), ca.vec(ca.densify(v)))


def _cuts(rule: Rule, start: float, end: float) -> list[float]:
    """Ends of pieces from ``start`` to ``end`` in m: within one element, and no longer than its nodes are apart."""
    borders = [b for b in rule.borders if start < b < end and min(b - start, end - b) > 1e-9 * rule.length]
    cuts = [start]
    for a, b in pairwise([start, *borders, end]):
        middle = 0.5 * (a + b)
        apart = next(y - x for x, y in pairwise(rule.borders) if x <= middle <= y) / rule.nodes_around(middle)
        number = max(1, int(np.ceil((b - a) / apart - 1e-9)))
        cuts += np.linspace(a, b, number + 1)[1:].tolist()
    return cuts


@cache
def _piece() -> ca.Function:
    """``(w, v, h) -> quaternion (4,), position (3,)`` of the end of a piece of length h as seen from its start.

    w and v (3, 3) are the strains at the nodes of ``PIECE``; positions by its quadrature, frames by Magnus steps.
    """
    w, v, h = ca.SX.sym("w", 3, PIECE.n_nodes), ca.SX.sym("v", 3, PIECE.n_nodes), ca.SX.sym("h")
    turns = [
        exponential(rotation_vector(h * ca.mtimes(w, ca.DM(turn_rows(PIECE, 0.0, c).T))))
        for c in (*PIECE.nodes.tolist(), 1.0)
    ]
    p = sum((b * rotation_matrix(q) @ v[:, k] for k, (b, q) in enumerate(zip(PIECE.weights, turns, strict=False))), 0)
    return ca.Function("piece", [w, v, h], [turns[-1], h * p])


def slipping(rates: ca.SX, speed: ca.SX | float, stiction: float = 0.0) -> ca.SX:
    """Sign of slip (n - 1, m) at the disks, by tanh of the speed at which each tendon slides through.

    Args:
        rates: of the lengths of the chords (n, m) in m/s.
        speed: over which the sign turns round, in m/s.
        stiction: by how much friction at slow slip exceeds that at fast slip, in parts of it: the sign is larger by as
            much below five times the ``speed``, with the square of the speed in an exponential. Source: Stribeck's
            curve in Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
    """
    beyond = ca.cumsum(rates[::-1, :])[::-1, :][1:, :]  # of the way from each disk to the end
    sign = ca.tanh(-beyond / speed)
    return sign * (1.0 + stiction * ca.exp(-((beyond / (STRIBECK * speed)) ** 2))) if stiction else sign


def falling(angles: ca.SX, friction: ca.SX | float, slip: ca.SX | float) -> ca.SX:
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
