"""How well a calibrated arm predicts recordings, and whether sensors explain what it misses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pisplit import Episodes
from pisplit.checks import Array
from pisplit.models.arm.sight import WEAK_CURVATURE
from pisplit.models.calibration.gauss_newton import Fitted
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
class FitEnd:
    """Where a fit ended.

    Attributes:
        x: free parameters (P,).
        normal: half the curvature (P, P) of the sum of squares there.
        residual: root mean square of what is missed, in standard deviations.
        why: it is not to be relied on; empty if it is.
    """

    x: Array
    normal: Array
    residual: float
    why: str = ""

    @classmethod
    def of(cls, found: Fitted) -> FitEnd:
        """The end of the fit ``found``."""
        residual = float(np.sqrt(found.best.misses / max(found.best.entries, 1.0)))
        return cls(found.x, found.best.normal, residual, found.why)

    def drawn(self, number: int, low: Array, rng: np.random.Generator) -> Array:
        """Parameters (number, P) as far from these as they may be, not below ``low`` (P,); ``rng`` draws.

        Where data are missed by more than their errors, the covariance is larger by that, as in standard errors.
        """
        values, vectors = np.linalg.eigh(self.normal)
        kept = values > 1e-12 * values.max()
        size = max(1.0, self.residual) * rng.standard_normal((number, int(kept.sum()))) / np.sqrt(values[kept])
        return np.maximum(self.x + size @ vectors[:, kept].T, low)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out ``recordings`` of the fields of an arm, each from rest, and the ``parts`` of them that are predicted:
    recording, first and last step (:func:`stretches`)."""

    recordings: Episodes
    parts: Sequence[tuple[int, int, int]]

    def rollouts(
        self,
        model: ParametrisedArm,
        found: Calibration,
        like: Ahead | None = None,
        noise: Array | None = None,
        parameters: Array | None = None,
    ) -> Ahead:
        """Roll-outs of a calibrated arm by the steps that calibrations take.

        Args:
            model: the arm with its parameters as inputs.
            found: what they and the servos are.
            like: those of a similar arm, which cost less from there.
            noise: (R, n) that is added to the measured states from which they start; none if not given.
            parameters: (R, P) free parameters of each in the place of those that were found.
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
            servo = found.actuator
            if parameters is not None:
                w0[model.slots[PARAMETERS]], servo = model.full(parameters[k]), model.actuator(parameters[k])
            moved, _ = servo.simulate(np.vstack([model.arm.rest_inputs, u]), dt)
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
        self,
        model: ParametrisedArm,
        found: Calibration,
        told: Ahead,
        sensors: tuple[float, float, float],
        end: FitEnd | None = None,
    ) -> tuple[str, ...]:
        """Why a calibrated arm may be wrong: its roll-outs miss more than sensors and its parameters' errors explain.

        What these explain is found by roll-outs of the arm itself, from starts with another draw of the sensors' noise
        and with parameters drawn from their covariance (parametric bootstrap: Efron and Tibshirani, An Introduction to
        the Bootstrap, 1993), and the noise of the points that are compared. What is left is the form.

        Args:
            model: the arm with its parameters as inputs.
            found: what they and the servos are.
            told: its roll-outs.
            sensors: errors of positions in m, of entries of frames, and of rates in parts of their spread.
            end: where the fit of the parameters ended; they count as exact if not given.
        """
        recordings, rng = self.recordings, np.random.default_rng(0)
        seen = model.sight(recordings.n_states // N_FIELDS)
        moving = np.array(model.scene.field_map(seen.stations).outputs["shape"])
        noise = np.zeros(recordings.n_states)
        noise[seen.rows] = seen.errors(np.concatenate(recordings.xs)[None], *sensors)
        noise[seen.quantities == "w"] /= WEAK_CURVATURE
        drawn = noise * rng.standard_normal((len(self.parts), len(noise)))

        def explained(parameters: Array | None) -> dict[int, float]:
            again = self.rollouts(model, found, told, drawn, parameters).points
            return {
                k: float(((again[k] - points) ** 2).sum(axis=1).mean() + (noise[moving] ** 2).sum())
                for k, points in told.points.items()
                if k in again
            }

        lost = int((~np.isfinite(told.errors)).sum())
        said = [f"{lost} of {len(told.errors)} held-out roll-outs fail"] if lost else []
        if end is not None and end.why:
            said.append(f"the fit did not come to its end: the form may be wrong ({end.why})")
        could = explained(None)
        if not could or not _beyond(told, could):
            return tuple(said)
        missed, read = _size(told.errors[list(could)]), _size(list(could.values()))
        start = f"held-out roll-outs miss the points by {missed:.2g} mm, sensors explain {read:.2g} mm"
        wrong = "the form is wrong (tendons, friction, backbone)"
        if end is None:
            return (*said, f"{start}: {wrong}, or the data are too few for its parameters")
        known = explained(end.drawn(len(self.parts), model.low, rng))
        both = _size(list(known.values())) if known else np.inf
        start += f", with the errors of the parameters {both:.2g} mm"
        if known and _beyond(told, known):
            return (*said, f"{start}: {wrong}")
        return (*said, f"{start}: the data are too few for the parameters; record more")


def _beyond(told: Ahead, explained: Mapping[int, float]) -> bool:
    """Whether roll-outs are off by more than what is ``explained`` of each by its number."""
    return bool(np.median(told.errors[list(explained)]) > DOUBTED * np.median(list(explained.values())))


def _size(squares: Sequence[float] | Array) -> float:
    """Root in mm of the median of ``squares`` in m^2."""
    return 1e3 * float(np.sqrt(np.median(squares)))
