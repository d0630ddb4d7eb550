"""What a calibration is told of an arm: recordings in motion and shapes at rest, and the fit to both."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array
from pisplit.models.arm.energy_prior import moving_energy
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.calibration.gauss_newton import DIGITS, STEPS, Fitted, approached, fitted
from pisplit.models.calibration.model import Calibration, ParametrisedArm
from pisplit.models.calibration.motion import Motion
from pisplit.models.calibration.problem import Problem
from pisplit.models.calibration.resting_shapes import RestingShapes

#: Relative change, and number of steps, that end the fit to shapes at rest where that to recordings starts.
SHAPES_DIGITS, SHAPES_STEPS = 1e-3, 20
#: What ends a fit that only has to say whether it is worth another one: see ``fitted``; and the most steps of it.
ROUGH, ROUGH_STEPS = (5e-2, 1e-2), 10
#: Root mean square of misses in standard deviations beyond which the form of the arm, or its sensors, are not as told.
ASTRAY = 1.5
#: Part of its spread before up to which a tilt or twist of the tip counts as seen.
SEEN = 0.5
#: Least standard deviation in m of shapes at rest beside recordings: friction and play leave arms anywhere about there.
LOOSE = 2e-3


@dataclass(frozen=True, eq=False)
class Evidence:
    """Recordings of an arm and its shapes at rest, with the errors of the sensors: see ``calibrate_from_recordings``.

    Attributes:
        measured: (N, T+1, K) fields, or columns of markers.
        logs: commands (D, m) of every recording.
        dt: time step in s.
        position_error, rotation_error, rate_error: of fields; of markers the capture tells them.
        stations: number of measured points.
        equilibria: displacements (N, m) in m and fields, or columns of markers, at rest under them.
        input_error: standard deviation in m of displacements.
    """

    measured: Array
    logs: list[Array]
    dt: float
    position_error: float
    rotation_error: float
    rate_error: float
    stations: int
    equilibria: tuple[ArrayLike, ArrayLike] | None
    input_error: float

    def calibrated(self, model: ParametrisedArm, rough: bool = False) -> Calibration:
        """The ``model`` fitted to it, if ``rough`` to a twentieth; see ``fit`` and ``told``."""
        return self.told(model, self.fit(model, rough))

    def fit(
        self, model: ParametrisedArm, rough: bool = False, restart: bool = False, near: Fitted | None = None
    ) -> Fitted:
        """Where the fit of the ``model`` ends.

        Args:
            model: the arm with its free parameters.
            rough: whether to be content with parameters good to a twentieth.
            restart: whether it starts from a calibrated arm, which shapes at rest would only lead astray.
            near: the fit of a similar model to this evidence: initial states and steps are looked for from there.

        Raises RuntimeError where no recording can be simulated.
        """
        rest, x = None, model.first
        if self.equilibria is not None:
            position, rotation = self.position_error, self.rotation_error
            strict = RestingShapes(model, *self.equilibria, position, rotation, self.stations, self.input_error)
            if not restart:
                x = np.asarray(strict.fit(SHAPES_DIGITS, SHAPES_STEPS).x, dtype=np.float64)
            sharp = position if model.capture is None else model.capture.noise
            rest = strict.weighed_down(max(1.0, LOOSE / sharp) if model.rubs else 1.0)
        motion, first = self._motion(model, x)
        problem = Problem(model, motion, rest)
        if model.capture is not None:
            x, first = approached(problem, x, first)
        if near is not None:
            first = near.first
        known = None if near is None else near.known
        if not rough:
            return fitted(problem, x, first, STEPS, DIGITS, known)
        found = fitted(problem, x, first, ROUGH_STEPS, ROUGH, known)
        return replace(found, why="") if found.unended else found

    def told(self, model: ParametrisedArm, found: Fitted) -> Calibration:
        """What the fit of the ``model`` has ``found``.

        Raises ``CalibrationError`` where it did not end or recordings could not be simulated.
        """
        residual = float(np.sqrt(found.best.misses / max(found.best.entries, 1.0)))
        why, notes, total = found.why, [], len(self.measured)
        if not why and found.best.used < total:
            why = f"{total - found.best.used} of {total} recordings could not be simulated"
        if model.capture is not None:
            triangles = {i: back.triangle for i, back in found.best.backs.items()}
            for name, left in zip(("tilt", "twist"), found.motion.unseen(triangles), strict=True):
                if left > SEEN:
                    notes.append(
                        f"{name} of the tip: not seen by these markers ({100 * left:.0f} % of its spread is left)"
                    )
            if residual > ASTRAY:
                notes.append(
                    f"missed by {residual:.2g} times the noise told: the form of the arm or the noise is another; "
                    "errors of the parameters are those of the noise found"
                )
        return model.result(found.x, residual, found.best.used, found.best.normal, residual, why, notes)

    def _motion(self, model: ParametrisedArm, x: Array) -> tuple[Motion, Array]:
        """Misses of the recordings, and initial states and offsets (N, 2n + m); ``x`` (P,) are free parameters."""
        y, play = self.measured, self.input_error
        if model.capture is not None:
            sight = MarkerSight(model.scene, model.capture)
            motion = Motion(model, sight, self.dt, y, self.logs, model.capture.sizes, play, moving_energy(model.arm))
            return motion, motion.first_guess(x)
        seen = model.sight(self.stations)
        errors = seen.errors(y, self.position_error, self.rotation_error, self.rate_error)
        motion = Motion(model, seen, self.dt, y[..., seen.rows], self.logs, errors, play)
        return motion, np.stack([np.concatenate([seen.state(rows[0]), np.zeros(motion.n_offsets)]) for rows in y])
