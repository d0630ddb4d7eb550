"""What data say of every identified parameter: its value, its standard error, and whether they say anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.models.calibration.parameters import (
    REFERENCE_FRICTION,
    REFERENCE_MASS,
    REFERENCE_SLACK,
    TendonParameters,
)

#: A parameter is identified where data leave less than this part of the spread that it had before.
IDENTIFIED = 0.5


@dataclass(frozen=True)
class Estimate:
    """One identified parameter.

    Attributes:
        name: as in ``TendonParameters``, tendons counted from 1: "stiffness[2]", "offset_x[1]"; "lag", "play".
        value: what was found.
        error: its standard error, by the curvature of the sum of squares and, where the data are missed by more than
            their errors, by how much.
        unit: of both; empty for factors and coefficients.
        identified: whether the data leave less than half of the spread that it had before; else the first guess
            decides.
    """

    name: str
    value: float
    error: float
    unit: str
    identified: bool

    def __str__(self) -> str:
        said = "" if self.identified else "   not identified"
        return f"{self.name:<14} {self.value:>12.5g} +- {self.error:<9.2g} {self.unit}{said}"


def estimates(
    parameters: TendonParameters,
    radius: float,
    free: Sequence[int],
    extra: Sequence[tuple[str, float, float, str]],
    covariance: Array,
    width: Array,
) -> tuple[Estimate, ...]:
    """Estimates of all free parameters.

    Args:
        parameters: what was found; ``radius`` in m as in ``TendonParameters.vector``.
        free: entries of the vector that were free.
        extra: name, value, size and unit of the free parameters that come after those: of servos, of a pose.
        covariance: of the free parameters (P, P), in parts of the vector.
        width: their standard deviations before (P,).
    """
    m = parameters.n_tendons
    known: list[tuple[str, float, float, str]] = []  # name, value, its change with the entry of the vector, unit
    for name, points in (("offset", parameters.offset), ("shift", parameters.shift)):
        for i, point in enumerate(points.tolist(), 1):
            known += [(f"{name}_{axis}[{i}]", v, radius, "m") for axis, v in zip("xy", point, strict=True)]
    offsets, shifts = known[: 2 * m], known[2 * m :]
    stiffness = [(f"stiffness[{i}]", v, v, "N/m") for i, v in enumerate(parameters.stiffness.tolist(), 1)]
    slack = [(f"slack[{i}]", v, REFERENCE_SLACK, "m") for i, v in enumerate(parameters.slack.tolist(), 1)]
    p = parameters
    factors = [("rounding", p.rounding, p.rounding, "m"), ("bending", p.bending, p.bending, "")]
    factors += [("damping", p.damping, p.damping, "")]
    others = [("tip_mass", p.tip_mass, REFERENCE_MASS, "kg"), ("friction", p.friction, REFERENCE_FRICTION, "")]
    others += [("slip_speed", p.slip_speed, p.slip_speed, "m/s")]
    every = [*offsets, *stiffness, *slack, *factors, *shifts, *others]
    rows = [every[k] for k in free] + list(extra)
    spread = np.sqrt(np.diag(covariance))
    return tuple(
        Estimate(name, value, float(sd * size), unit, bool(sd < IDENTIFIED * before))
        for (name, value, size, unit), sd, before in zip(rows, spread, width, strict=True)
    )
