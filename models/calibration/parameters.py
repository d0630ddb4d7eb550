"""Parameters of an arm that can be identified, and their vector of numbers of order one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array, finite_array, finite_number, non_negative, positive

#: Units of the vector: stiffness in N/m, slack in m, mass in kg, coefficient of friction, speed in m/s.
REFERENCE_STIFFNESS, REFERENCE_SLACK, REFERENCE_MASS = 1e4, 1e-3, 1e-2
REFERENCE_FRICTION, REFERENCE_SPEED = 0.1, 2e-3
#: Entries of the vector that are not six a tendon.
OTHERS = 6


@dataclass(frozen=True)
class TendonParameters:
    """Parameters of straight tendons and of the backbone they bend.

    offset     (m, 2) points in the section plane at the base in m
    stiffness  (m,) tension per stretch in N/m of a tendon of the backbone's length
    slack      (m,) stretch in m of the undisplaced tendon on the straight backbone; negative: it hangs loose
    rounding   width in m over which the corner between slack and taut is rounded
    shift      (m, 2) by how much the points at the tip differ in m: zero for parallel tendons
    bending    factor of the elastic moments of the backbone: 1 where its stiffness is what the scene says
    damping    factor of its Kelvin-Voigt damping
    tip_mass   mass at the tip in kg beside what the scene has there
    friction   coefficient of capstan friction, not negative
    slip_speed speed in m/s over which friction at disks turns round (``rod.Tendons``); without disks it says nothing
    """

    offset: Array
    stiffness: Array
    slack: Array
    rounding: float
    shift: Array
    bending: float = 1.0
    damping: float = 1.0
    tip_mass: float = 0.0
    friction: float = 0.0
    slip_speed: float = REFERENCE_SPEED

    def __post_init__(self) -> None:
        m = len(np.atleast_1d(self.stiffness))
        for name, shape in (("offset", (m, 2)), ("stiffness", (m,)), ("slack", (m,)), ("shift", (m, 2))):
            object.__setattr__(self, name, finite_array(getattr(self, name), f"TendonParameters {name}", shape))
        positive(float(np.min(self.stiffness)), "TendonParameters stiffness", "N/m")
        for name in ("rounding", "bending", "damping", "slip_speed"):
            positive(getattr(self, name), f"TendonParameters {name}")
        finite_number(self.tip_mass, "TendonParameters tip_mass")
        non_negative(self.friction, "TendonParameters friction")

    @property
    def n_tendons(self) -> int:
        """Number of tendons m."""
        return len(self.stiffness)

    def vector(self, radius: float) -> Array:
        """Parameters (6 m + 6,) of order one about zero: points in radii, logarithms of all that is positive.

        ``radius`` in m.
        """
        return np.concatenate(
            [
                self.offset.ravel() / radius,
                np.log(self.stiffness / REFERENCE_STIFFNESS),
                self.slack / REFERENCE_SLACK,
                np.log([self.rounding / REFERENCE_SLACK, self.bending, self.damping]),
                self.shift.ravel() / radius,
                [self.tip_mass / REFERENCE_MASS, self.friction / REFERENCE_FRICTION],
                [np.log(self.slip_speed / REFERENCE_SPEED)],
            ]
        )

    @classmethod
    def of_vector(cls, values: Array, radius: float) -> TendonParameters:
        """The inverse of ``vector``. ``values`` (6 m + 6,), ``radius`` in m."""
        m = (len(values) - OTHERS) // 6
        return cls(
            offset=radius * values[: 2 * m].reshape(m, 2),
            stiffness=REFERENCE_STIFFNESS * np.exp(values[2 * m : 3 * m]),
            slack=REFERENCE_SLACK * values[3 * m : 4 * m],
            rounding=REFERENCE_SLACK * float(np.exp(values[4 * m])),
            bending=float(np.exp(values[4 * m + 1])),
            damping=float(np.exp(values[4 * m + 2])),
            shift=radius * values[4 * m + 3 : 6 * m + 3].reshape(m, 2),
            tip_mass=REFERENCE_MASS * float(values[6 * m + 3]),
            friction=REFERENCE_FRICTION * float(values[6 * m + 4]),
            slip_speed=REFERENCE_SPEED * float(np.exp(values[6 * m + 5])),
        )
