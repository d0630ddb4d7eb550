"""Tendons as active stress on the strains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from pisplit.checks import finite_array, positive
from pisplit.models.rod.kinematics import Motion, columnwise_cross
from pisplit.models.rod.loads import Input, Loads


@dataclass(frozen=True)
class Displacement:
    """Each tendon is pulled by a displacement u_i in m (positive pulls): tension from its elastic stretch.

    ``tau_i = max(0, (l_i - l*_i) / (c l*_i))`` with ``l*_i = L_i - u_i`` and the path length ``l_i``; a slack tendon
    carries nothing. The corner at slack is rounded over ``slack_smoothing``.

    Args:
        compliance: c in 1/N, strain of the tendon per newton.
        slack_smoothing: tension in N over which slack sets in; at the corner the tension is off by 0.69 of it.
    """

    compliance: float
    slack_smoothing: float = 0.1

    def __post_init__(self) -> None:
        positive(self.compliance, "Displacement compliance", "1/N")
        positive(self.slack_smoothing, "Displacement slack_smoothing", "N")

    def tension(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """Tension in N of one tendon with path length ``length``, unpulled length ``rest`` and displacement ``u``."""
        unstretched = self.unstretched(length, rest, u)
        return softplus((length - unstretched) / (self.compliance * unstretched), self.slack_smoothing)

    def unstretched(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """Length in m at which the tendon just carries nothing."""
        return rest - u

    def describe(self) -> str:
        """Law and compliance."""
        return f"displacement drive, compliance {self.compliance:g} 1/N"


@dataclass(frozen=True)
class Tension:
    """Each tendon is driven by its tension u_i in N."""

    def tension(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """The input itself."""
        return u

    def unstretched(self, length: ca.SX, rest: float, u: ca.SX) -> ca.SX:
        """The path length: a tendon driven by its tension is never slack."""
        return length

    def describe(self) -> str:
        """Law."""
        return "tension drive"


@dataclass(frozen=True)
class Tendons:
    """Tendons that run parallel to the rod at constant offsets.

    With ``a_i = v + w x r_i`` and ``t_i = a_i / |a_i|``, tendon i adds ``tau_i t_i`` to the internal force and
    ``tau_i r_i x t_i`` to the internal moment; its path length is ``int |a_i| ds``. Distributed load and tip wrench of
    the tendon follow from virtual work (Rucker & Webster, IEEE T-RO 2011, the same load in strong form).

    Args:
        offsets: routing points r_i (n, 2) in m in the section plane.
        drive: ``Displacement(compliance)`` or ``Tension()``.
        name: name of the input with one entry a tendon.
    """

    offsets: Sequence[Sequence[float]]
    drive: Displacement | Tension = field(default_factory=Tension)
    name: str = "tendons"

    def __post_init__(self) -> None:
        offsets = finite_array(np.asarray(self.offsets), "Tendons offsets", (None, 2))
        if len(offsets) == 0:
            raise ValueError("Tendons offsets is empty; give at least one routing point (x, y)")
        object.__setattr__(self, "offsets", tuple(map(tuple, offsets.tolist())))

    @classmethod
    def parallel(
        cls, offset: float, angles_deg: Sequence[float], drive: Displacement | Tension, name: str = "tendons"
    ) -> Tendons:
        """Tendons on a circle of radius ``offset`` in m at ``angles_deg`` in degrees."""
        positive(offset, "Tendons offset", "m")
        angles = np.deg2rad(finite_array(np.asarray(angles_deg), "Tendons angles_deg", (None,)))
        points = offset * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return cls(points.tolist(), drive, name)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """One input with an entry a tendon."""
        return (Input(self.name, len(self.offsets)),)

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Add the active stress of every tendon and offer ``tension``, ``length`` and ``unpulled_length``."""
        u = loads.inputs[self.name]
        readings: dict[str, list[ca.SX]] = {"tension": [], "length": [], "unpulled_length": []}
        for i, (x, y) in enumerate(self.offsets):
            r = ca.repmat(ca.SX(ca.DM([x, y, 0.0])), 1, motion.rule.n_nodes)
            a = motion.v + columnwise_cross(motion.w, r)
            norm = ca.sqrt(ca.sum1(a * a))
            length = motion.total(norm)
            tension = self.drive.tension(length, motion.rule.length, u[i])
            pull = tension * a / ca.repmat(norm, 3, 1)
            loads.stress_v += pull
            loads.stress_w += columnwise_cross(r, pull)
            readings["tension"].append(tension)
            readings["length"].append(length)
            readings["unpulled_length"].append(self.drive.unstretched(length, motion.rule.length, u[i]))
        for name, values in readings.items():
            loads.outputs[name] = ca.vertcat(loads.outputs.get(name, ca.SX(0, 1)), *values)

    def describe(self, rod: Any) -> str:
        """Number, offset and drive."""
        radius = float(np.hypot(*np.asarray(self.offsets).T).mean())
        return f"{len(self.offsets)} parallel tendons, offset {1e3 * radius:g} mm, {self.drive.describe()}"


def softplus(x: ca.SX, width: float) -> ca.SX:
    """``max(0, x)`` with its corner rounded over ``width``; never overflows."""
    return width * ca.log1p(ca.exp(-ca.fabs(x) / width)) + ca.fmax(x, 0.0)
