"""The rod's own coordinates from measured fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array
from pisplit.models.rod.analysis.fields import N_FIELDS, station_points
from pisplit.models.rod.kinematics.strains import COMPONENTS
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.base import Base
from pisplit.models.rod.terms.loads import Input

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

_ROTATION, _STRAIN_V, _STRAIN_W, _SPIN = slice(3, 12), slice(12, 15), slice(15, 18), slice(21, 24)


@dataclass(frozen=True)
class StrainCoordinates(Rebuilt):
    """Free strains and their rates [xi, xi_t] (2n,) of a bending and twisting rod from its fields at stations (24 S,).

    Strains are the least-squares polynomial through w at the stations. Rates follow from the world angular velocity
    ``R omega = int R w_t ds``, which is linear in the rates once the strains are known. Exact when the fields come
    from a rod on the same nodes and there are at least as many stations as nodes.

    Attributes:
        scene: the rod.
        points: arclengths (S,) of the stations in m.
    """

    scene: Scene
    points: tuple[float, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates: ``w1[1]`` is the first bending strain at the first node, ``w1_t[1]`` its rate."""
        free = self.scene.rod.strain_set.free
        strains = [f"{COMPONENTS[c]}[{k + 1}]" for k in range(self.scene.nodes) for c in free]
        return (*strains, *(name.replace("[", "_t[") for name in strains))

    @property
    def takes(self) -> tuple[str, ...]:
        """Names of the fields (24 S,), in the order in which ``function`` takes them."""
        return self.scene.field_map(self.points).names

    @property
    def quantities(self) -> tuple[str, ...]:
        """Scaling groups: all strains share one scale, all rates another."""
        return ("strain",) * self.scene.n_strains + ("strain_rate",) * self.scene.n_strains

    @cached_property
    def strain_rows(self) -> Array:
        """Weights (K, S): values at the nodes from values at the stations."""
        rows: Array = np.asarray(np.linalg.pinv(self.scene.rule.interpolate(self.points)), dtype=np.float64)
        rows.flags.writeable = False  # kept and handed out again
        return rows

    @cached_property
    def function(self) -> ca.Function:
        """``fields (24 S,) -> [xi, xi_t] (2n,)``."""
        scene, rule = self.scene, self.scene.rule
        xi = ca.SX.sym("xi", scene.n_strains)
        motion = scene.balance(xi, ca.SX(scene.n_strains, 1), None, ca.SX.sym("u", scene.n_inputs)).motion
        to = rule.integrate_to(self.points)
        axes = [c % 3 for c in scene.rod.strain_set.free]
        blocks = [[float(row[k]) * motion.frames[k][:, axes] for k in range(scene.nodes)] for row in to]
        spin_map = ca.Function("spin_map", [xi], [ca.blockcat(blocks)])

        y = ca.MX.sym("fields", N_FIELDS * len(self.points))
        stations = ca.reshape(y, N_FIELDS, len(self.points))
        strains = ca.vec(ca.mtimes(stations[_STRAIN_W, :][axes, :], ca.DM(self.strain_rows.T)))
        spins = []
        for k in range(len(self.points)):
            frame = ca.reshape(stations[_ROTATION, k], 3, 3).T
            spins.append(frame @ stations[_SPIN, k])
        g = spin_map(strains)
        rates = ca.solve(g.T @ g, g.T @ ca.vertcat(*spins), "qr", {"eps": 1e-30})
        return ca.Function("strain_coordinates", [y], [ca.vertcat(strains, rates)], ["fields"], ["coordinates"])


def strain_coordinates(scene: Scene, stations: int | ArrayLike = 6) -> StrainCoordinates:
    """Coordinates of a scene from its fields at stations.

    Raises ValueError for free shear or stretch, a base that turns or slides, and for fewer stations than nodes.
    """
    if any(c >= 3 for c in scene.rod.strain_set.free):
        raise ValueError(
            f"rod coordinates need a rod without free shear and stretch; strains are {scene.rod.strains!r}"
        )
    bases = [t for t in scene.terms if isinstance(t, Base)]
    if any(t.inputs or isinstance(t.spin, Input) or any(t.spin) for t in bases):
        raise ValueError("rod coordinates need a base that does not turn; this scene has a Base with spin or inputs")
    if scene.n_joint:
        raise ValueError("rod coordinates need a base that is clamped; this scene has a Base with a hinge or slides")
    points = station_points(stations, scene.rod.length)
    if len(points) < scene.nodes:
        raise ValueError(f"{len(points)} stations cannot tell {scene.nodes} nodes apart; give at least {scene.nodes}")
    if np.linalg.matrix_rank(scene.rule.interpolate(points)) < scene.nodes:
        raise ValueError(
            f"stations {points} leave an element of the rod with fewer stations than nodes {scene.element_nodes}"
        )
    return StrainCoordinates(scene, points)
