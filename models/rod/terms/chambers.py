"""Internal pressure chambers as active stress on the strains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import positive
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion, columnwise_cross
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.terms.idle import idle_on_the_axis
from pisplit.models.rod.terms.loads import Input, Loads
from pisplit.models.rod.terms.routing import (
    Route,
    check_routes,
    checked_routes,
    nodes_before,
    on_circle,
    sample,
)


@dataclass(frozen=True)
class Chambers:
    """Chambers along the rod, each filled with a pressure of its own (an input in Pa above that outside).

    A chamber of cross-section A (across the rod) with its centre at r(s) has the volume V = A int e3 . (v + w x r) ds;
    the work p dV adds -p A e3 to the internal force and -p A r x e3 to the internal moment. Chambers push: a positive
    pressure bends the rod away from them and stretches it where stretch is free. Walls that bulge are not modelled: A
    does not change.

    Args:
        area: A in m^2.
        offsets: one entry a chamber: centre (x, y) in m, or a function of arclength in m that returns one.
        name: name of the input with one entry a chamber.
        end: arclength in m of their far end, the tip when not given; an element must end there.
    """

    area: float
    offsets: Sequence[Route]
    name: str = "pressures"
    end: float | None = None

    def __post_init__(self) -> None:
        positive(self.area, "Chambers area", "m^2")
        object.__setattr__(self, "offsets", checked_routes(self.offsets, "Chambers"))

    @classmethod
    def parallel(
        cls,
        area: float,
        offset: float,
        angles_deg: Sequence[float],
        name: str = "pressures",
        end: float | None = None,
    ) -> Chambers:
        """Chambers of area ``area`` in m^2 on a circle of radius ``offset`` in m at ``angles_deg`` in degrees.

        ``name`` and ``end`` as in the class.
        """
        return cls(area, [tuple(p) for p in on_circle(offset, angles_deg, "Chambers")], name, end)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """One input with an entry a chamber."""
        return (Input(self.name, len(self.offsets)),)

    def jumps(self, rod: Rod) -> list[float]:
        """Where the load of the ``rod`` jumps: at their end."""
        return [] if self.end is None else [self.end]

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError for chambers that end within an element or would bend a planar rod out of its plane.

        ``rod`` and ``rule``, its nodes, are those of the scene.
        """
        n = nodes_before(self.end, rule, "Chambers")
        check_routes(self.offsets, rule, n, rod.length, "Chambers")
        if rod.strain_set.planar and any(np.any(sample(o, rule.nodes, rod.length)[0][1]) for o in self.offsets):
            raise ValueError("a planar rod takes chambers in its plane only; offsets must have y = 0")

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress of every chamber. ``motion`` is that of the rod; ``loads`` takes what is added."""
        pressure, n = loads.inputs[self.name], nodes_before(self.end, motion.rule, "Chambers")
        axis = ca.sparsify(ca.SX(ca.DM(np.outer([0.0, 0.0, 1.0], np.arange(motion.rule.n_nodes) < n))))
        for i, route in enumerate(self.offsets):
            r = ca.SX(ca.DM(sample(route, motion.rule.nodes, motion.rod.length)[0]))
            push = self.area * pressure[i] * axis
            loads.stress_v -= push
            loads.stress_w -= columnwise_cross(r, push)

    def idle(self, rod: Rod, terms: tuple[Any, ...]) -> str | None:
        """Why some act on nothing, if so: chambers about the axis of a rod that does not stretch.

        ``rod`` and ``terms`` are those of the scene.
        """
        return idle_on_the_axis(self.offsets, rod)

    def describe(self, rod: Any) -> str:
        """Number and area. ``rod`` is that of the scene."""
        return f"{len(self.offsets)} pressure chambers, {1e6 * self.area:g} mm^2 each"
