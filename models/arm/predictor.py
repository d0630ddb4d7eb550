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
from pisplit.models.arm.sight import Sight
from pisplit.models.rod.analysis.fields import N_FIELDS, UNITS

#: Distance of measured points from those of the arm, in parts of its length, beyond which it is another arm's shape.
STRANGE = 0.02


class ArmPredictor:
    """Open-loop predictions of an ``arm``, drawn or calibrated, by its equations of motion.

    Its states are the 24 fields at ``stations``; a prediction starts from the strains and rates that look most like
    what is measured there (``Sight.state``) and moves by large checked steps (``Scene.fast_stepper``). What it is worth
    is what the arm is: with the arm that made the recordings it is as good as its steps, with a drawing as good as the
    drawing. Maxwell branches of the arm start relaxed, for no field shows their stress.

    Args:
        arm: what moves: tendons pulled by displacements, of Kirchhoff strains.
        dt: time step in s of inputs and predictions.
        stations: number of measured points along the arm.
        actuator: servos between the commands, which are the inputs, and the tendons; their state follows from the
            commands.

    Raises ValueError where an ``arm`` has no map from fields to strains, or ``dt`` is not positive.
    """

    def __init__(self, arm: Arm, dt: float, stations: int = 6, actuator: Actuator | None = None) -> None:
        self.arm, self.dt, self.stations = arm, positive(dt, "dt", "s"), stations
        self.actuator = Actuator() if actuator is None else checked_actuator(actuator)
        self._sight = Sight(arm.scene, stations)
        self._stepper: Any = arm.scene.fast_stepper(dt=self.dt, stations=stations)
        found = arm.scene.field_map(stations)
        self.state_names, self.outputs = tuple(found.names), dict(found.outputs)
        self.state_units = tuple(UNITS[q] for q in found.quantities)

    def predict(self, x0: ArrayLike, inputs: ArrayLike, before: ArrayLike | None = None) -> Array:
        """States (T+1, n) under ``inputs`` (T, m) from the fields ``x0`` (n,).

        ``before`` (D, m): the commands up to the start, the last of them the present one, from rest; the arm's rest if
        not given. Warns where the motion fails, at which the states end, and where ``x0`` is no shape of this arm: its
        points are more than 2 % of the length away from those of the strains that fit it best. Raises ValueError for
        other shapes.
        """
        m = self.arm.scene.n_inputs
        u = finite_array(inputs, "inputs", (None, m))
        past = self.arm.rest_inputs[None, :] if before is None else finite_array(before, "before", (None, m))
        if not len(past):
            raise ValueError("before is empty; give the commands up to the start, or leave it out")
        moved, _ = self.actuator.simulate(np.vstack([past, u]), self.dt, ActuatorState.at(past[0]))
        x = finite_array(x0, "x0", (len(self.state_names),))
        hidden = np.zeros(self.arm.scene.layout.n_overstress)
        start = np.concatenate([self._sight.state(x), hidden, moved[len(past) - 1]])
        found = self._stepper.run(moved[len(past) :], start, check=False)
        fields = found.fields(self.stations).reshape(len(found.x), -1)
        points = (fields[0] - x).reshape(-1, N_FIELDS)[:, :3]
        away = float(np.linalg.norm(points, axis=1).max()) / self.arm.scene.rod.length
        if away > STRANGE:
            warnings.warn(
                f"the state at the start is no shape of this arm: off by {100 * away:.2g} % of its length; "
                "give the arm that was measured, and states in its units",
                stacklevel=2,
            )
        if not found.success:
            warnings.warn(f"the motion ends after {len(fields) - 1} of {len(u)} steps: {found.message}", stacklevel=2)
        fields[0] = x
        return np.asarray(fields)

    def score(self, episodes: Episodes, states: str | None = "shape", start: int = 1) -> RolloutErrors:
        """Squared errors of open-loop roll-outs of test ``episodes``, as :func:`pisplit.rollout_errors` gives them.

        ``states``: an output group of the rod, "shape", "tip", ...; all states if None. ``start``: step from whose
        measured state a roll-out starts; earlier commands move the servos. Raises ValueError for episodes of other
        columns or time step.
        """
        check_same_step(episodes.dt, self.dt, "the episodes have", "the predictor")
        scene = self.arm.scene
        data = episodes.arranged(
            self.state_names, scene.input_names, self.state_units, scene.input_units, owner="the arm"
        )
        count(start, "start", 0)
        if states is not None and states not in self.outputs:
            raise ValueError(f"states = {states!r}; expected one of {', '.join(map(repr, self.outputs))}, or None")
        chosen = np.arange(data.n_states) if states is None else np.array(self.outputs[states])
        if min(len(u) for u in data.us) <= start:
            raise ValueError(f"start = {start}; every episode needs more steps than that")
        squared, diverged = [], []
        for x, u in zip(data.xs, data.us, strict=True):
            before = np.vstack([self.arm.rest_inputs, u[:start]])
            found = self.predict(x[start], u[start:], before)
            errors = np.full(len(u) - start, np.inf)
            reached = len(found) - 1
            missed = found[1:, chosen] - x[start + 1 : start + 1 + reached, chosen]
            errors[:reached] = (missed**2).sum(axis=1)
            squared.append(errors)
            diverged.append(reached < len(errors))
        unit = squared_unit([self.state_units[int(i)] for i in chosen])
        return RolloutErrors(tuple(squared), np.array(diverged), unit)
