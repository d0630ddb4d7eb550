"""How well a calibrated arm predicts recordings, and whether sensors explain what it misses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pisplit import Episodes
from pisplit.checks import Array
from pisplit.models.arm.sight import WEAK_CURVATURE
from pisplit.models.calibration.model import Calibration, ParametrisedArm
from pisplit.models.calibration.motion import HALVINGS, SLOW, STAGES, STEP, TOLERANCE
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.dynamics.march import Hint, March

#: Times that held-out roll-outs may miss more, in squares, than sensors explain, before the form is doubted.
DOUBTED = 4.0


@dataclass(frozen=True, eq=False)
class Ahead:
    """Roll-outs of an arm.

    Attributes:
        points: (T, 3 S) in m of each that did not fail, by its number.
        errors: mean squared distance (R,) of all points in m^2, infinite where the motion fails.
        hints: steps of each by instants, from which those of a similar arm are looked for.
    """

    points: Mapping[int, Array]
    errors: Array
    hints: Mapping[int, list[list[Hint]]]


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out ``recordings`` of the fields of an arm, each from rest, and the ``parts`` of them that are predicted:
    recording, first and last step (:func:`stretches`)."""

    recordings: Episodes
    parts: Sequence[tuple[int, int, int]]

    def rollouts(
        self, model: ParametrisedArm, found: Calibration, like: Ahead | None = None, noise: Array | None = None
    ) -> Ahead:
        """Roll-outs of a calibrated arm by the steps that calibrations take.

        Args:
            model: the arm with its parameters as inputs.
            found: what they and the servos are.
            like: those of a similar arm, which cost less from there.
            noise: (R, n) that is added to the measured states from which they start; none if not given.
        """
        dt, m, n = self.recordings.dt, model.m, 2 * model.scene.n_strains
        stepper, seen = model.stepper(dt, STEP, STAGES), model.sight(self.recordings.n_states // N_FIELDS)
        sight = model.sight(seen.stations, ("p",))
        moving = np.array(model.scene.field_map(seen.stations).outputs["shape"])
        shown, w0 = np.isin(sight.rows, moving), np.zeros(model.scene.n_inputs)
        w0[model.slots[PARAMETERS]] = found.parameters.vector(model.radius)
        points, hints, errors = {}, {}, np.full(len(self.parts), np.inf)
        for k, (e, first, last) in enumerate(self.parts):
            x, u = self.recordings.xs[e], self.recordings.us[e][:last]
            moved, _ = found.actuator.simulate(np.vstack([model.arm.rest_inputs, u]), dt)
            w = np.tile(w0, (len(moved), 1))
            w[:, model.slots["moves"][:m]] = moved
            state = seen.state(x[first] if noise is None else x[first] + noise[k])
            march, rows, steps = March(stepper.collocation, TOLERANCE, SLOW, HALVINGS), [], []
            known = like.hints.get(k, []) if like is not None else []
            try:
                for i in range(first, last):
                    hint = known[i - first] if i - first < len(known) else ()
                    pieces = march.interval(state, w[i], w[i + 1], dt, stepper.substeps, hint)
                    state = pieces[-1].end
                    steps.append([Hint(p.z, p.h, p.inverse) for p in pieces])
                    rows.append(sight.look(state[:n])[0][shown])
            except (RuntimeError, np.linalg.LinAlgError):
                continue
            if np.isfinite(rows).all():
                points[k], hints[k] = np.array(rows), steps
                errors[k] = float(((points[k] - x[first + 1 : last + 1, moving]) ** 2).sum(axis=1).mean())
        return Ahead(points, errors, hints)

    def doubts(
        self, model: ParametrisedArm, found: Calibration, told: Ahead, sensors: tuple[float, float, float]
    ) -> tuple[str, ...]:
        """Why the form of a calibrated arm may be wrong: its roll-outs miss more than sensors explain.

        What sensors explain is found by roll-outs of the arm itself, from starts with and without another draw of their
        noise (parametric bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap, 1993), and the noise of the
        points that are compared. Errors of parameters are not in it: with little data these may be what is missed.

        Args:
            model: the arm with its parameters as inputs.
            found: what they and the servos are.
            told: its roll-outs.
            sensors: errors of positions in m, of entries of frames, and of rates in parts of their spread.
        """
        recordings = self.recordings
        seen = model.sight(recordings.n_states // N_FIELDS)
        moving = np.array(model.scene.field_map(seen.stations).outputs["shape"])
        noise = np.zeros(recordings.n_states)
        noise[seen.rows] = seen.errors(np.concatenate(recordings.xs)[None], *sensors)
        noise[seen.quantities == "w"] /= WEAK_CURVATURE
        drawn = noise * np.random.default_rng(0).standard_normal((len(self.parts), len(noise)))
        again = self.rollouts(model, found, told, drawn)
        both = [k for k in told.points if k in again.points]
        explained = [
            float(((again.points[k] - told.points[k]) ** 2).sum(axis=1).mean() + (noise[moving] ** 2).sum())
            for k in both
        ]
        lost = int((~np.isfinite(told.errors)).sum())
        said = [f"{lost} of {len(told.errors)} held-out roll-outs fail"] if lost else []
        if both and np.median(told.errors[both]) > DOUBTED * np.median(explained):
            missed, could = (1e3 * float(np.sqrt(np.median(v))) for v in (told.errors[both], explained))
            said.append(
                f"held-out roll-outs miss the points by {missed:.2g} mm, sensors explain {could:.2g} mm: the form is "
                "wrong (tendons, friction, backbone), or the data are too few for its parameters"
            )
        return tuple(said)
