"""An arm's own equations as predictor: no lift, no regression, one large step a control interval."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit import Episodes, RolloutErrors
from pisplit.checks import Array, check_same_step, count, finite_array, positive
from pisplit.data.actuator import Actuator, ActuatorState, checked_actuator
from pisplit.evaluation.rollouts import squared_unit
from pisplit.models.arm.base import Arm
from pisplit.models.arm.marker_fit import MarkerFit
from pisplit.models.arm.marker_sight import marker_array, read_markers
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.sight import Sight
from pisplit.models.rod.analysis.fields import N_FIELDS, UNITS

#: Distance of measured points from those of the arm, in parts of its length, beyond which it is another arm's shape.
STRANGE = 0.02
#: Root mean square of what markers are missed by before a prediction, in standard deviations, beyond which it is said.
MISSED = 3.0


class ArmPredictor:
    """Open-loop predictions of an ``arm``, drawn or calibrated, by its equations of motion.

    Its states are the 24 fields at ``stations``; a prediction starts from the strains and rates that look most like
    what is measured there (``Sight.state``) and moves by large checked steps (``Scene.fast_stepper``). What it is worth
    is what the arm is: with the arm that made the recordings it is as good as its steps, with a drawing as good as the
    drawing. Maxwell branches of the arm start relaxed, for no field shows their stress. With a ``capture`` its states
    are the columns of the markers alone; it then starts from the state whose motion passes them best over the last
    instants (``MarkerFit``).

    Args:
        arm: what moves: tendons pulled by displacements, of Kirchhoff strains.
        dt: time step in s of inputs and predictions.
        stations: number of measured points along the arm.
        actuator: servos between the commands, which are the inputs, and the tendons; their state follows from the
            commands.
        capture: markers, where these are all that is measured; their pose has to be given (``Calibration.capture``).
        history: number of instants before the start that a prediction from markers looks at, where there are so many.

    Raises ValueError where an ``arm`` has no map from fields to strains, ``dt`` is not positive, or a pose is unknown.
    """

    def __init__(
        self,
        arm: Arm,
        dt: float,
        stations: int = 6,
        actuator: Actuator | None = None,
        capture: MotionCapture | None = None,
        history: int = 8,
    ) -> None:
        self.arm, self.dt, self.stations = arm, positive(dt, "dt", "s"), stations
        self.actuator = Actuator() if actuator is None else checked_actuator(actuator)
        self._stepper: Any = arm.scene.fast_stepper(dt=self.dt, stations=stations)
        self.capture, self.history = capture, count(history, "history", 0)
        if capture is not None:
            if capture.pose != "given":
                raise ValueError(
                    "the pose of the base is unknown; take the capture of a calibration, which has found it"
                )
            if arm.scene.branches:
                raise ValueError(
                    "the arm has Maxwell branches, whose stress no marker tells; leave them out (rod.Maxwell)"
                )
            self._fit, at = MarkerFit(arm, capture, self.dt), capture.positions
            self.state_names, self.outputs = capture.names, {"tip": at[-3:], "shape": at}
            self.state_units = tuple("m" if i in at else "1" for i in range(capture.n_columns))
            return
        self._sight = Sight(arm.scene, stations)
        found = arm.scene.field_map(stations)
        self.state_names, self.outputs = tuple(found.names), dict(found.outputs)
        self.state_units = tuple(UNITS[q] for q in found.quantities)

    def predict(self, x0: ArrayLike, inputs: ArrayLike, before: ArrayLike | None = None) -> Array:
        """States (T+1, n) under ``inputs`` (T, m) from the fields ``x0`` (n,).

        With a ``capture``: from markers ``x0`` (H+1, n) of the last instants, or (n,) of the last one alone, which says
        nothing of velocities; NaN: lost. ``before`` (D, m): the commands up to the start, the last of them the present
        one, from rest; the arm's rest if not given. Warns where the motion fails, at which the states end, and where
        ``x0`` is no shape of this arm: its points are more than 2 % of the length away from those of the strains that
        fit it best, or markers by more than three times their noise. Raises ValueError for other shapes.
        """
        m = self.arm.scene.n_inputs
        u = finite_array(inputs, "inputs", (None, m))
        past = self.arm.rest_inputs[None, :] if before is None else finite_array(before, "before", (None, m))
        if not len(past):
            raise ValueError("before is empty; give the commands up to the start, or leave it out")
        moved, _ = self.actuator.simulate(np.vstack([past, u]), self.dt, ActuatorState.at(past[0]))
        x, state = self._start(x0, moved[: len(past)])
        hidden = np.zeros(self.arm.scene.layout.n_overstress)
        start = np.concatenate([state, hidden, moved[len(past) - 1]])
        found = self._stepper.run(moved[len(past) :], start, check=False)
        if self.capture is None:
            seen = found.fields(self.stations).reshape(len(found.x), -1)
        else:
            seen = np.stack([self._fit.sight.look(row[: len(state)])[0] for row in found.x])
        self._doubt(seen[0], x)
        if not found.success:
            warnings.warn(f"the motion ends after {len(seen) - 1} of {len(u)} steps: {found.message}", stacklevel=2)
        seen[0] = np.where(np.isfinite(x), x, seen[0])
        return np.asarray(seen)

    def _start(self, x0: ArrayLike, moved: Array) -> tuple[Array, Array]:
        """What is measured at the start (n,) and the state [xi, xi_t] then; ``moved`` (D, m) displacements up to it."""
        n = len(self.state_names)
        if self.capture is None:
            x = finite_array(x0, "x0", (n,))
            return x, self._sight.state(x)
        rows = np.atleast_2d(np.asarray(x0, dtype=np.float64))
        y = marker_array(rows, self.capture, self.arm.scene.rod.length, (-1,))
        if len(y) > len(moved):
            raise ValueError(f"x0 has {len(y)} instants, before {len(moved)} commands; give those at all instants")
        found = self._fit(y, moved[-len(y) :])
        if found.residual > MISSED:
            warnings.warn(
                f"the markers before the start are missed by {found.residual:.2g} times their noise: they are those of "
                "another arm, or the noise is larger than told",
                stacklevel=3,
            )
        return y[-1], found.state

    def _doubt(self, seen: Array, x: Array) -> None:
        """Warn where ``x`` (n,) is no shape of this arm: ``seen`` is what looks most like it."""
        if self.capture is not None:
            return
        points = (seen - x).reshape(-1, N_FIELDS)[:, :3]
        away = float(np.linalg.norm(points, axis=1).max()) / self.arm.scene.rod.length
        if away > STRANGE:
            warnings.warn(
                f"the state at the start is no shape of this arm: off by {100 * away:.2g} % of its length; "
                "give the arm that was measured, and states in its units",
                stacklevel=3,
            )

    def score(self, episodes: Episodes, states: str | None = "shape", start: int = 1) -> RolloutErrors:
        """Squared errors of open-loop roll-outs of test ``episodes``, as :func:`pisplit.rollout_errors` gives them.

        ``states``: an output group of the rod, "shape", "tip", ...; all states if None. ``start``: step from whose
        measured state a roll-out starts; earlier commands move the servos, and earlier markers tell the state. Raises
        ValueError for episodes of other columns or time step.
        """
        check_same_step(episodes.dt, self.dt, "the episodes have", "the predictor")
        scene = self.arm.scene
        if self.capture is None:
            data = episodes.arranged(
                self.state_names, scene.input_names, self.state_units, scene.input_units, owner="the arm"
            )
            xs = list(data.xs)
        else:
            xs, data = read_markers(episodes, self.arm, self.capture)
        count(start, "start", 0)
        if states is not None and states not in self.outputs:
            raise ValueError(f"states = {states!r}; expected one of {', '.join(map(repr, self.outputs))}, or None")
        chosen = np.arange(len(self.state_names)) if states is None else np.array(self.outputs[states])
        if min(len(u) for u in data.us) <= start:
            raise ValueError(f"start = {start}; every episode needs more steps than that")
        squared, diverged = [], []
        for x, u in zip(xs, data.us, strict=True):
            before = np.vstack([self.arm.rest_inputs, u[:start]])
            known = x[start] if self.capture is None else x[max(0, start - self.history) : start + 1]
            found = self.predict(known, u[start:], before)
            errors = np.full(len(u) - start, np.inf)
            reached = len(found) - 1
            missed = found[1:, chosen] - x[start + 1 : start + 1 + reached, chosen]
            errors[:reached] = (missed**2).sum(axis=1)
            squared.append(errors)
            diverged.append(reached < len(errors))
        unit = squared_unit([self.state_units[int(i)] for i in chosen])
        return RolloutErrors(tuple(squared), np.array(diverged), unit)
