"""Strain sets: which strains of the rod are free, and how frames follow from them.

The free strains at the Gauss nodes are the generalised coordinates. Strains that a set does not free keep
their rest values, as exact zeros and ones in the graph, so that CasADi folds away everything that depends on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from pisplit.models.rod.kinematics.gauss import Array, Rule
from pisplit.models.rod.kinematics.rotations import compose, exponential, rotation_about_y, rotation_matrix

#: Order of the six strain components: bending about body axes 1 and 2, torsion, shear along 1 and 2, stretch.
COMPONENTS = ("w1", "w2", "w3", "v1", "v2", "v3")

#: Arclengths in m and the rotation vectors in rad by which the rod turns there, in the axes of the section before.
Kinks = Sequence[tuple[float, Sequence[float]]]

#: Nodes of an element from which on its frames take steps of sixth order.
SIXTH_ORDER = 6


@dataclass(frozen=True)
class StrainSet:
    """Free strain components of a rod, by index into ``COMPONENTS``, in increasing order.

    Args:
        name: for tables and messages.
        free: the indices.

    Raises ValueError for indices that are none or do not increase.
    """

    name: str
    free: tuple[int, ...]

    def __post_init__(self) -> None:
        free = tuple(self.free)
        if not free or list(free) != sorted(set(free)) or not set(free) <= set(range(len(COMPONENTS))):
            raise ValueError(
                f"StrainSet free = {self.free!r}; expected increasing indices from 0 to 5 into {COMPONENTS}"
            )
        object.__setattr__(self, "free", free)

    @property
    def n_fields(self) -> int:
        """Number of free strain components."""
        return len(self.free)

    @property
    def planar(self) -> bool:
        """Whether the rod only bends about body axis 2, in the x-z plane."""
        return not {0, 2, 4} & set(self.free)

    def split(self, values: ca.SX, rest: Sequence[float]) -> tuple[ca.SX, ca.SX]:
        """Strains (w, v), each (3,), from the free components and the rest values of the others."""
        full = ca.SX(ca.DM(list(rest)))
        for row, component in enumerate(self.free):
            full[component] = values[row]
        return full[:3], full[3:]

    def steps(self, w_nodes: ca.SX, rule: Rule, base: ca.SX, kinks: Kinks = ()) -> list[ca.SX]:
        """Quaternions (4,) at ``rule.step_ends`` from the strains ``w`` at the nodes (3, K) and that of the base.

        Magnus steps from node to node, see ``rotation_vector``. Planar rods need none.

        ``w_nodes`` are these strains; the rod turns by the ``kinks`` at ends of its elements, beyond which they count.
        """
        ends = [base]
        if not self.planar:
            for start, end in pairwise(rule.step_ends):
                turned = compose(ends[-1], _turn(w_nodes, rule, start, end))
                for place, vector in kinks:
                    if abs(end - place) < 1e-9 * rule.length:
                        turned = compose(turned, exponential(ca.SX(ca.DM(list(vector)))))
                ends.append(turned)
        return ends

    def frames(
        self, w_nodes: ca.SX, rule: Rule, s: Sequence[float], steps: Sequence[ca.SX], kinks: Kinks = ()
    ) -> list[ca.SX]:
        """Rotation matrices at arclengths ``s`` from ``steps``, the quaternions at ``rule.step_ends``.

        Planar rods integrate the angle exactly. Otherwise one more Magnus step leads from the last node to each
        arclength, so that a frame does not depend on which others are asked for.

        ``w_nodes`` (3, K) are the strains w at the nodes, ``kinks`` those of ``steps``.
        """
        if self.planar:
            base = ca.sparsify(rotation_matrix(steps[0]))
            angles = [ca.mtimes(ca.DM(row[None, :]), w_nodes[1, :].T) for row in rule.integrate_to(s)]
            for place, vector in kinks:
                angles = [
                    a + vector[1] if p > place - 1e-9 * rule.length else a for a, p in zip(angles, s, strict=True)
                ]
            return [base @ rotation_about_y(angle) for angle in angles]
        ends = rule.step_ends
        frames = []
        for point in s:
            last = int(np.searchsorted(ends, point, side="right")) - 1
            frame = steps[last]
            if point > ends[last]:
                frame = compose(frame, _turn(w_nodes, rule, ends[last], point))
            frames.append(rotation_matrix(frame))
        return frames


def turn_rows(rule: Rule, start: float, end: float) -> Array:
    """Rows (2 or 3, K) over nodal strains w for one step from ``start`` to ``end`` in m: W, B (and C).

    See ``rotation_vector``. The step lies within one element of ``rule``; three rows from ``SIXTH_ORDER`` nodes of this
    element on, so that frames and strains are resolved alike: with fewer the strains decide.
    """
    h = end - start
    whole = rule.integrate_to([end])[0] - rule.integrate_to([start])[0]
    nodes = rule.nodes_around(start + 0.5 * h)
    x, weights = np.polynomial.legendre.leggauss(2 if nodes < SIXTH_ORDER else nodes // 2 + 2)
    rows = rule.interpolate(start + 0.5 * h * (1.0 + x))
    linear, quadratic = (0.5 * h * (weights * (0.5 * x) ** k) @ rows for k in (1, 2))
    return np.stack([whole, linear] if nodes < SIXTH_ORDER else [whole, linear, 180.0 * quadratic - 15.0 * whole])


def rotation_vector(parts: ca.SX) -> ca.SX:
    """Omega (3,) with R(end) = R(start) exp(hat(Omega)) for R' = R hat(w) over a step h, to fourth or sixth order.

    Magnus expansion from moments of w about the middle of the step (Blanes, Casas, Oteo & Ros, *The Magnus expansion
    and some of its applications*, Physics Reports 470 (2009), section 5.6):

        W = int w ds,  B = int x w ds,  C = int (180 x^2 - 15) w ds,  x = (s - middle) / h
        fourth order:  Omega = W + W x B
        sixth order:   Omega = W + (20 A + C + D) x (B + A x (2 C - D) / 720) / 20,  A = W - C / 12,  D = 12 A x B

    Where the axis of bending does not turn, Omega = W is exact.

    ``parts`` are W and B, for sixth order also C, a column each.
    """
    whole, linear, *rest = ca.horzsplit(parts)
    if not rest:
        return whole + ca.cross(whole, linear)
    quadratic = rest[0]
    middle = whole - quadratic / 12.0
    turning = 12.0 * ca.cross(middle, linear)
    second = ca.cross(middle, 2.0 * quadratic - turning) / 720.0
    return whole + ca.cross(20.0 * middle + quadratic + turning, linear + second) / 20.0


def _turn(w_all: ca.SX, rule: Rule, start: float, end: float) -> ca.SX:
    """Quaternion of one step."""
    return exponential(rotation_vector(ca.mtimes(w_all, ca.DM(turn_rows(rule, start, end).T))))


STRAIN_SETS = {
    "cosserat": StrainSet("cosserat", (0, 1, 2, 3, 4, 5)),
    "kirchhoff": StrainSet("kirchhoff", (0, 1, 2)),
    "extensible": StrainSet("extensible", (0, 1, 2, 5)),
    "planar": StrainSet("planar", (1,)),
    "planar-cosserat": StrainSet("planar-cosserat", (1, 3, 5)),
}
