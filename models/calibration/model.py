"""What a calibration identifies: the backbone with parametrised tendons, which parameters are free, the result."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from pisplit.brief import brief
from pisplit.checks import Array, positive
from pisplit.data.actuator import Actuator
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.sight import MEASURED, Sight
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.estimates import Estimate, estimates
from pisplit.models.calibration.followed import FollowedShapes
from pisplit.models.calibration.parameters import REFERENCE_MASS, REFERENCE_SPEED, TendonParameters
from pisplit.models.calibration.parametrised import PARAMETERS, CalibratedTendons
from pisplit.models.rod import Displacement, KelvinVoigt, PointMass, Scene, Tendons
from pisplit.models.rod.dynamics.exact import ExactCollocation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.dynamics.fast import FastStepper

#: What can be identified: parallel tendons; factors of the backbone's stiffness and damping; the routing, by how much
#: every tendon's point at the tip differs from that at the base; a mass at the tip; friction of the tendons.
GROUPS = ("tendons", "bending", "damping", "routing", "load", "friction")
#: Parameters of servos, which recordings alone tell, and their typical size: lag in s, play in m.
SERVO = {"lag": 0.03, "play": 3e-4}
SERVO_UNITS = {"lag": "s", "play": "m"}
#: Pose of the base in the axes of markers, and how far its first guess may be off: in parts of the length, and in rad.
POSE_NAMES = ("base_x", "base_y", "base_z", "turn_x", "turn_y", "turn_z")
POSE_SHIFT, POSE_TURN = 0.1, 0.3
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


class CalibrationError(RuntimeError):
    """A calibration that is not to be relied on: what failed and by how much.

    Args:
        message: that in words.
        calibration: where it ended, to look at.
    """

    def __init__(self, message: str, calibration: Calibration) -> None:
        super().__init__(message)
        self.calibration = calibration


@brief
@dataclass(frozen=True)
class Calibration:
    """Identified arm.

    arm         the arm with the identified tendons, to simulate (``make_episodes``) or to solve
    parameters  what was identified
    residual    root mean square of the residuals: parts of EI/L (equilibria), standard deviations of the measurement
                (shapes), or parts of the coordinates' spread (pairs)
    samples     number of equilibria or pairs that were used; a pair whose simulation fails does not count
    actuator    servos between commands and displacements, as they were told or identified
    estimates   value and standard error of every free parameter, and whether the data identify it
    capture     the markers it was identified from, with the pose that was found; None where fields were measured
    notes       what the data do not tell, one line each
    """

    arm: TendonArm
    parameters: TendonParameters
    residual: float
    samples: int
    actuator: Actuator = field(default_factory=Actuator)
    estimates: tuple[Estimate, ...] = ()
    capture: MotionCapture | None = None
    notes: tuple[str, ...] = ()

    def report(self) -> str:
        """One line a parameter: value, standard error, unit, and "not identified" where data say nothing of it."""
        head = f"{self.samples} samples, missed by {self.residual:.3g}"
        return "\n".join([head, *map(str, self.estimates), *self.notes])

    def with_damping(self, factor: float) -> Calibration:
        """The same with another factor of the backbone's damping."""
        parameters = replace(self.parameters, damping=positive(factor, "factor"))
        term = self.arm.tendons
        assert isinstance(term, CalibratedTendons)  # the result of a calibration has those
        changed = replace(term, values=tuple(parameters.vector(term.radius).tolist()))
        scene = self.arm.passive + changed
        return replace(self, arm=replace(self.arm, scene=scene), parameters=parameters)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Where the tendons run, their stiffness and slack; written to ``path`` where one is given."""
        from pisplit.models.calibration.pictures import plot_calibration

        return plot_calibration(self, path)


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
    stiffness = 1.0 / (tendons.drive.compliance * (arm.scene.rod.length + tendons.drive.outside))
    return TendonParameters(
        offset=np.array([np.asarray(o, float) for o in tendons.offsets]),
        stiffness=np.full(m, stiffness),
        slack=np.zeros(m),
        rounding=1e-4,
        shift=np.zeros((m, 2)),
        friction=tendons.friction,
        slip_speed=tendons.slip_speed or REFERENCE_SPEED,
    )


def carried(arm: TendonArm) -> float:
    """Mass in kg that the scene of an ``arm`` has at its tip: what an identified one may take away."""
    length = arm.scene.rod.length
    masses = [t.mass for t in arm.scene.terms if isinstance(t, PointMass) and np.isclose(t.s, length)]
    return float(sum(masses))


def check_memory(arm: TendonArm) -> None:
    """Raise ValueError for an ``arm`` with Maxwell branches: where its recordings start, their stress is unknown."""
    if arm.scene.branches:
        raise ValueError(
            "the arm has Maxwell branches, whose stress no measured state tells: calibrate its shapes at rest, or give "
            "an arm whose scene is scene.without(rod.Maxwell)"
        )


class ParametrisedArm:
    """The backbone with parametrised tendons, and which parameters are free.

    Args:
        arm: the arm.
        start: first guess; the arm's own tendons when not given.
        free: parts of ``GROUPS``, of ``SERVO`` too with a ``servo``.
        servo: first guess of what stands between commands and displacements.
        capture: markers, where these are all that is measured; their pose may be free.
        like: one of the same arm, whose functions serve this one too; where it rubs and this one does not, they are
            evaluated without friction.
    """

    def __init__(
        self,
        arm: TendonArm,
        start: TendonParameters | None,
        free: Sequence[str],
        servo: Actuator | None = None,
        capture: MotionCapture | None = None,
        like: ParametrisedArm | None = None,
    ) -> None:
        known = GROUPS if servo is None else (*GROUPS, *SERVO)
        unknown = [name for name in free if name not in known]
        if unknown or not free:
            raise ValueError(f"free = {list(free)}; expected some of {', '.join(known)}")
        first = nominal_parameters(arm) if start is None else start
        arm.check_one_section("calibration")
        self.arm, self.m = arm, first.n_tendons
        if self.m != arm.scene.n_inputs:
            raise ValueError(f"start has {self.m} tendons; the arm has {arm.scene.n_inputs} inputs")
        self.name = arm.tendons.name
        distance = positive(np.hypot(*first.offset.T).mean(), "mean distance of the tendons from the axis", "m")
        self.radius: float = distance if like is None else like.radius
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
        #: Servo parameters come after those of the scene in every vector of free parameters.
        self.servo_free = [name for name in SERVO if name in free]
        told = np.array([getattr(servo, name) / SERVO[name] for name in self.servo_free], dtype=float)
        #: The pose of the base in the axes of the markers comes last, as changes of the given one.
        self.capture = capture
        self.n_pose = 6 if capture is not None and capture.pose == "estimated" else 0
        self.pose_unit = np.repeat([POSE_SHIFT * arm.scene.rod.length, POSE_TURN], 3)
        self.first = np.concatenate([self.start[self.free], told, np.zeros(self.n_pose)])
        self.width = np.concatenate([self.spread[self.free], np.ones(len(told) + self.n_pose)])
        low = np.full(len(self.start), -np.inf)
        low[6 * m + 4] = 0.0
        low[6 * m + 3] = -carried(arm) / REFERENCE_MASS
        self.low = np.concatenate([low[self.free], np.zeros(len(told)), np.full(self.n_pose, -np.inf)])
        self.servo = servo
        self.rubs = "friction" in free or first.friction > 0.0
        self._steppers: dict[tuple[float, float, int], FastStepper] = {} if like is None else like._steppers
        self._sights: dict[tuple[int, tuple[str, ...]], Sight] = {} if like is None else like._sights
        self._shapes: dict[int, FollowedShapes] = {} if like is None else like._shapes
        self.scene: Scene = self._scene(None) if like is None else like.scene
        self.slots = {"moves": np.arange(m), PARAMETERS: np.arange(m, m + len(self.start))}

    def stepper(self, dt: float, step: float, stages: int) -> FastStepper:
        """Motion over steps of ``dt`` in s by internal ones of ``step`` and so many ``stages``: made once."""
        key = (dt, step, stages)
        if key not in self._steppers:
            made = self.scene.fast_stepper(dt, step=step, stages=stages)
            same = [known for (_, _, other), known in self._steppers.items() if other == stages]
            # the functions of a step do not depend on its length
            scheme = same[0].collocation if same else ExactCollocation(made.equations, stages, "radau")
            made.__dict__["collocation"] = scheme
            self._steppers[key] = made
        return self._steppers[key]

    def shapes(self, number: int) -> FollowedShapes:
        """A ``number`` of shapes at rest, which follow the parameters: made once."""
        if number not in self._shapes:
            self._shapes[number] = FollowedShapes(self.scene, number)
        return self._shapes[number]

    def sight(self, stations: int, names: Sequence[str] = MEASURED) -> Sight:
        """What sensors at so many ``stations`` see of the quantities ``names``: made once."""
        key = (stations, tuple(names))
        if key not in self._sights:
            self._sights[key] = Sight(self.scene, stations, names)
        return self._sights[key]

    def starts(self) -> list[Array]:
        """First guesses: tendons that are slack push nothing and leave a fit in the lurch, so several are tried."""
        found = []
        m = self.m
        for stiffness in (0.0, -2.0, 2.0):
            for slack in (0.0, 1.0):
                values = self.start.copy()
                values[2 * m : 3 * m] += stiffness
                values[3 * m : 4 * m] += slack
                found.append(np.maximum(np.concatenate([values[self.free], self.first[len(self.free) :]]), self.low))
        return found

    def full(self, x: Array) -> Array:
        """All parameters, from the free ones. ``x`` (P,) are these."""
        values = self.start.copy()
        values[self.free] = x[: len(self.free)]
        return values

    def actuator(self, x: Array) -> Actuator:
        """The servo of free parameters ``x`` (P,)."""
        found = Actuator() if self.servo is None else self.servo
        told = {name: SERVO[name] * float(x[k]) for name, k in zip(self.servo_free, self.servo_entries, strict=True)}
        return replace(found, **told)

    @property
    def servo_entries(self) -> range:
        """Positions of the servo parameters among the free ones."""
        return range(len(self.free), len(self.free) + len(self.servo_free))

    def pose(self, x: Array) -> Array:
        """Position in m and rotation vector in rad (6,) of the base for the markers, by free parameters ``x`` (P,)."""
        if self.capture is None:
            return np.zeros(6)
        given = np.array([*np.asarray(self.capture.position), *np.asarray(self.capture.turn)])
        return given + self.pose_unit * x[-6:] if self.n_pose else given

    def prior(self, x: Array) -> Array:
        """Distance from the first guess in standard deviations. ``x`` (P,) are the free parameters."""
        return (x - self.first) / self.width

    @property
    def prior_slope(self) -> Array:
        """d prior / dx."""
        return np.diag(1.0 / self.width)

    def result(
        self,
        x: Array,
        residual: float,
        samples: int,
        normal: Array,
        misfit: float,
        why: str = "",
        notes: Sequence[str] = (),
    ) -> Calibration:
        """The identified arm.

        Args:
            x: its free parameters (P,).
            residual, samples: as in ``Calibration``.
            normal: half the curvature (P, P) of the sum of squares there, with that of the prior.
            misfit: root mean square of the residuals in standard deviations.
            why: it is not to be relied on; empty if it is.
            notes: what else is to be said of it.

        Raises CalibrationError where there is a reason ``why`` not to rely on it.
        """
        values = self.full(x)
        scene = self._scene(tuple(values.tolist()))
        arm = TendonArm(scene, self.arm.pretension, self.arm.amplitude)
        parameters = TendonParameters.of_vector(values, self.radius)
        actuator = self.actuator(x)
        covariance = np.asarray(max(1.0, misfit) ** 2 * np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
        pose = self.pose(x)
        base = zip(POSE_NAMES, pose, self.pose_unit, ("m",) * 3 + ("rad",) * 3, strict=True)
        extra = [(name, float(getattr(actuator, name)), SERVO[name], SERVO_UNITS[name]) for name in self.servo_free]
        extra += [(name, float(v), float(unit), told) for name, v, unit, told in base] if self.n_pose else []
        told = estimates(parameters, self.radius, self.free.tolist(), extra, covariance, self.width)
        capture = self.capture.placed(pose[:3], pose[3:]) if self.capture is not None and self.n_pose else self.capture
        found = Calibration(arm, parameters, residual, samples, actuator, told, capture, tuple(notes))
        if why:
            raise CalibrationError(f"calibration failed: {why}; {len(x)} parameters, residual {residual:.3g}", found)
        return found

    def _scene(self, values: tuple[float, ...] | None) -> Scene:
        backbone = self.arm.passive
        damping = [t for t in backbone.terms if isinstance(t, KelvinVoigt)]
        total = KelvinVoigt(
            *(sum(getattr(t, name) for t in damping) for name in ("bending", "torsion", "shear", "stretch"))
        )
        disks = self.arm.tendons.disks
        return backbone + CalibratedTendons(self.m, self.radius, values, total, self.name, disks, self.rubs)
