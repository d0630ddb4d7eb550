"""Loads per length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import finite_array
from pisplit.models.rod.kinematics.gauss import Rule
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.section.body import Rod
from pisplit.models.rod.section.jumps import jumps
from pisplit.models.rod.terms.idle import idle_wrench
from pisplit.models.rod.terms.loads import Input, Loads, Vector, checked_vector

#: Three numbers, an ``Input`` of size 3, or a function of arclength s in m that returns three numbers.
Density = Vector | Callable[[float], Sequence[float]]


@dataclass(frozen=True)
class DistributedWrench:
    """Force per length in N/m and moment per length in N along the whole rod.

    Args:
        force, moment: each three numbers, an ``Input`` of size 3 (the same all along the rod), or a function s -> (3,)
            of the arclength in m, smooth within each element; components in world axes (a dead load) or,
            with ``follower=True``, in the axes of each cross-section.
    """

    force: Density = (0.0, 0.0, 0.0)
    moment: Density = (0.0, 0.0, 0.0)
    follower: bool = False

    def __post_init__(self) -> None:
        for name in ("force", "moment"):
            value = getattr(self, name)
            if not callable(value):
                object.__setattr__(self, name, checked_vector(value, f"DistributedWrench {name}"))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Those of force and moment that are inputs."""
        return tuple(v for v in (self.force, self.moment) if isinstance(v, Input))

    def check(self, rod: Rod, rule: Rule) -> None:
        """Raise ValueError where a function does not return three finite numbers.

        ``rod`` and ``rule``, its nodes, are those of the scene.
        """
        for name in ("force", "moment"):
            value = getattr(self, name)
            if callable(value):
                _sampled(value, rule.nodes.tolist(), f"DistributedWrench {name}")

    def jumps(self, rod: Rod) -> list[float]:
        """Where its functions jump along the ``rod``."""
        found: list[float] = []
        for value in (self.force, self.moment):
            if callable(value):
                found += jumps(_in_parts(value, rod.length), 0.0, rod.length)
        return found

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the loads at every node. ``motion`` is that of the rod; ``loads`` takes what is added."""
        force, moment = self._at_nodes(self.force, motion, loads), self._at_nodes(self.moment, motion, loads)
        if self.follower:
            force, moment = motion.to_world(force), motion.to_world(moment)
        loads.force += force
        loads.moment += moment

    def _at_nodes(self, value: Density, motion: Motion, loads: Loads) -> ca.SX:
        nodes = motion.rule.nodes.tolist()
        if callable(value):
            return ca.sparsify(ca.SX(ca.DM(_sampled(value, nodes, "DistributedWrench"))))
        return ca.repmat(loads.read(value), 1, len(nodes))

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Why it acts on nothing, if so: all of it is across the plane of a planar ``rod``.

        ``rod`` and ``terms`` are those of the scene.
        """
        if callable(self.force) or callable(self.moment):
            return None
        return idle_wrench(self.force, self.moment, rod, terms)

    def describe(self, rod: Any) -> str:
        """Force and moment per length. ``rod`` is that of the scene."""
        kind = "follower" if self.follower else "dead"
        force, moment = ("f(s)" if callable(v) else v for v in (self.force, self.moment))
        return f"{kind} distributed wrench, force {force} N/m, moment {moment} N"


def _sampled(value: Callable[[float], Sequence[float]], nodes: list[float], name: str) -> np.ndarray:
    return np.array([finite_array(value(s), f"{name} at s = {s:g} m", (3,)) for s in nodes]).T


def _in_parts(value: Callable[[float], Sequence[float]], length: float) -> Callable[[float], np.ndarray]:
    """``value`` in parts of what is largest along ``length``."""
    size = float(np.abs(_sampled(value, np.linspace(0.0, length, 17)[1:-1].tolist(), "DistributedWrench")).max())
    return lambda s: np.asarray(value(s), dtype=float) / max(size, 1e-300)
