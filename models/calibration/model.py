"""What a calibration identifies: the backbone with parametrised tendons, which parameters are free, the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pisplit.checks import Array, positive
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.parameters import REFERENCE_SPEED, TendonParameters
from pisplit.models.calibration.parametrised import PARAMETERS, CalibratedTendons
from pisplit.models.rod import Displacement, KelvinVoigt, Scene, Tendons

#: What can be identified: parallel tendons; factors of the backbone's stiffness and damping; the routing, by how much
#: every tendon's point at the tip differs from that at the base; a mass at the tip; friction of the tendons.
GROUPS = ("tendons", "bending", "damping", "routing", "load", "friction")
#: Spread of every parameter about its first guess that regularises the fit: offsets by half a radius, stiffness and
#: slack by a factor of e^3 and 1 mm, rounding by e, stiffness and damping of the backbone by e^0.3 and e, points at
#: the tip by half a radius, a mass there by 10 g, friction by 0.1 and the speed over which it turns round by e.
SPREAD = {
    "offset": 0.5,
    "stiffness": 3.0,
    "slack": 1.0,
    "rounding": 1.0,
    "bending": 0.3,
    "damping": 1.0,
    "shift": 0.5,
    "tip_mass": 1.0,
    "friction": 1.0,
    "slip_speed": 1.0,
}


@dataclass(frozen=True)
class Calibration:
    """Identified arm.

    arm         the arm with the identified tendons, to simulate (``make_episodes``) or to solve
    parameters  what was identified
    residual    root mean square of the residuals: parts of EI/L (equilibria), standard deviations of the measurement
                (shapes), or parts of the coordinates' spread (pairs)
    samples     number of equilibria or pairs that were used; a pair whose simulation fails does not count
    success     False if the least squares stopped before they converged
    """

    arm: TendonArm
    parameters: TendonParameters
    residual: float
    samples: int
    success: bool

    def with_damping(self, factor: float) -> Calibration:
        """The same with another factor of the backbone's damping."""
        parameters = replace(self.parameters, damping=positive(factor, "factor"))
        term = self.arm.tendons
        assert isinstance(term, CalibratedTendons)  # the result of a calibration has those
        changed = replace(term, values=tuple(parameters.vector(term.radius).tolist()))
        scene = self.arm.passive + changed
        return replace(self, arm=replace(self.arm, scene=scene), parameters=parameters)


def nominal_parameters(arm: TendonArm) -> TendonParameters:
    """Parameters of the arm's own tendons: where its drawing has them, with the stiffness and friction it says.

    Those of a calibrated arm are what was identified. Raises ValueError for tendons that are not parallel or not pulled
    by displacements.
    """
    arm.check_one_section("calibration")
    tendons = arm.tendons
    if isinstance(tendons, CalibratedTendons):
        return tendons.parameters
    if (
        not isinstance(tendons, Tendons)
        or not isinstance(tendons.drive, Displacement)
        or any(callable(o) for o in tendons.offsets)
    ):
        raise ValueError("calibration takes parallel tendons with a displacement drive; give start for others")
    m = len(tendons.offsets)
    stiffness = 1.0 / (tendons.drive.compliance * arm.scene.rod.length)
    return TendonParameters(
        offset=np.array([np.asarray(o, float) for o in tendons.offsets]),
        stiffness=np.full(m, stiffness),
        slack=np.zeros(m),
        rounding=1e-4,
        shift=np.zeros((m, 2)),
        friction=tendons.friction,
        slip_speed=tendons.slip_speed or REFERENCE_SPEED,
    )


class ParametrisedArm:
    """The backbone with parametrised tendons, and which parameters are free.

    Args:
        arm: the arm.
        start: first guess; the arm's own tendons when not given.
        free: parts of ``GROUPS``.
    """

    def __init__(self, arm: TendonArm, start: TendonParameters | None, free: Sequence[str]) -> None:
        unknown = [name for name in free if name not in GROUPS]
        if unknown or not free:
            raise ValueError(f"free = {list(free)}; expected some of {', '.join(GROUPS)}")
        first = nominal_parameters(arm) if start is None else start
        arm.check_one_section("calibration")
        self.arm, self.m = arm, first.n_tendons
        if self.m != arm.scene.n_inputs:
            raise ValueError(f"start has {self.m} tendons; the arm has {arm.scene.n_inputs} inputs")
        self.name = arm.tendons.name
        self.radius = positive(np.hypot(*first.offset.T).mean(), "mean distance of the tendons from the axis", "m")
        self.start = first.vector(self.radius)
        m = self.m
        parts = {
            "offset": 2 * m,
            "stiffness": m,
            "slack": m,
            "rounding": 1,
            "bending": 1,
            "damping": 1,
            "shift": 2 * m,
            "tip_mass": 1,
            "friction": 1,
            "slip_speed": 1,
        }
        self.spread = np.concatenate([np.full(size, SPREAD[name]) for name, size in parts.items()])
        groups = np.repeat(GROUPS, [4 * m + 1, 1, 1, 2 * m, 1, 2])
        self.free = np.flatnonzero(np.isin(groups, list(free)))
        self.rubs = "friction" in free or first.friction > 0.0
        self.scene = self._scene(None)
        self.slots = {"moves": np.arange(m), PARAMETERS: np.arange(m, m + len(self.start))}

    def starts(self) -> list[Array]:
        """First guesses: tendons that are slack push nothing and leave a fit in the lurch, so several are tried."""
        found = []
        m = self.m
        for stiffness in (0.0, -2.0, 2.0):
            for slack in (0.0, 1.0):
                values = self.start.copy()
                values[2 * m : 3 * m] += stiffness
                values[3 * m : 4 * m] += slack
                found.append(values[self.free])
        return found

    def full(self, x: Array) -> Array:
        """All parameters, from the free ones. ``x`` (P,) are these."""
        values = self.start.copy()
        values[self.free] = x
        return values

    def prior(self, x: Array) -> Array:
        """Distance from the first guess in standard deviations. ``x`` (P,) are the free parameters."""
        return (x - self.start[self.free]) / self.spread[self.free]

    @property
    def prior_slope(self) -> Array:
        """d prior / dx."""
        return np.diag(1.0 / self.spread[self.free])

    def result(self, x: Array, residual: float, samples: int, success: bool) -> Calibration:
        """The identified arm.

        ``x`` (P,) are its free parameters; ``residual``, ``samples`` and ``success`` as in ``Calibration``.
        """
        values = self.full(x)
        scene = self._scene(tuple(values.tolist()))
        arm = TendonArm(scene, self.arm.pretension, self.arm.amplitude)
        return Calibration(arm, TendonParameters.of_vector(values, self.radius), residual, samples, success)

    def _scene(self, values: tuple[float, ...] | None) -> Scene:
        backbone = self.arm.passive
        damping = [t for t in backbone.terms if isinstance(t, KelvinVoigt)]
        total = KelvinVoigt(
            *(sum(getattr(t, name) for t in damping) for name in ("bending", "torsion", "shear", "stretch"))
        )
        disks = self.arm.tendons.disks
        return backbone + CalibratedTendons(self.m, self.radius, values, total, self.name, disks, self.rubs)
