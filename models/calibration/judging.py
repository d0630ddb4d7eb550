"""How well a calibrated arm predicts recordings, and whether sensors explain what it misses."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from pisplit import Episodes
from pisplit.checks import Array
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.sight import WEAK_CURVATURE, Sight
from pisplit.models.calibration.model import Calibration
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Times that held-out roll-outs may miss more, in squares, than sensors explain, before the form is doubted.
DOUBTED = 4.0


def rollouts(found: Calibration, recordings: Episodes, parts: Sequence[tuple[int, int, int]]) -> Array:
    """Mean squared distance (R,) of all points in m^2 over each of the ``parts``, infinite where the motion fails.

    Args:
        found: a calibrated arm with its servos.
        recordings: of its fields, each from rest.
        parts: recording, first and last step of every roll-out (:func:`stretches`).
    """
    predictor = ArmPredictor(found.arm, recordings.dt, recordings.n_states // N_FIELDS, found.actuator)
    points, errors = np.array(predictor.outputs["shape"]), np.full(len(parts), np.inf)
    rest = found.arm.rest_inputs
    for k, (e, first, last) in enumerate(parts):
        x, u = recordings.xs[e], recordings.us[e]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a motion that ends counts as infinitely wrong
            try:
                ahead = predictor.predict(x[first], u[first:last], np.vstack([rest, u[:first]]))
            except (RuntimeError, np.linalg.LinAlgError):
                continue
        if len(ahead) == last - first + 1 and np.isfinite(ahead).all():
            missed = ahead[1:, points] - x[first + 1 : last + 1, points]
            errors[k] = float((missed**2).sum(axis=1).mean())
    return errors


def doubts(
    found: Calibration,
    recordings: Episodes,
    parts: Sequence[tuple[int, int, int]],
    errors: Array,
    sensors: tuple[float, float, float],
) -> tuple[str, ...]:
    """Why the form of a calibrated arm may be wrong: its roll-outs miss more than sensors explain.

    What sensors explain is found by roll-outs of the arm itself, from starts with and without another draw of their
    noise (parametric bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap, 1993), and the noise of the
    points that are compared. Errors of parameters are not in it: with little data these may be what is missed.

    Args:
        found: the arm with its servos.
        recordings, parts: as in ``rollouts``.
        errors: mean squared distance (R,) in m^2 of those roll-outs.
        sensors: errors of positions in m, of entries of frames, and of rates in parts of their spread.
    """
    predictor = ArmPredictor(found.arm, recordings.dt, recordings.n_states // N_FIELDS, found.actuator)
    points, rest = np.array(predictor.outputs["shape"]), found.arm.rest_inputs
    seen = Sight(found.arm.scene, predictor.stations)
    noise = np.zeros(recordings.n_states)
    noise[seen.rows] = seen.errors(np.concatenate(recordings.xs)[None], *sensors)
    noise[seen.quantities == "w"] /= WEAK_CURVATURE
    rng, explained = np.random.default_rng(0), np.full(len(parts), np.nan)
    for k, (e, first, last) in enumerate(parts):
        if not np.isfinite(errors[k]):
            continue
        x, u = recordings.xs[e], recordings.us[e]
        before = np.vstack([rest, u[:first]])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            told = predictor.predict(x[first], u[first:last], before)
            again = predictor.predict(x[first] + noise * rng.standard_normal(len(noise)), u[first:last], before)
        if len(told) == len(again):
            explained[k] = ((again - told)[1:, points] ** 2).sum(axis=1).mean() + (noise[points] ** 2).sum()
    known = np.isfinite(explained)
    lost = int((~np.isfinite(errors)).sum())
    said = [f"{lost} of {len(errors)} held-out roll-outs fail"] if lost else []
    missed, could = (float(np.sqrt(np.median(v[known]))) if known.any() else np.nan for v in (errors, explained))
    if missed > np.sqrt(DOUBTED) * could:
        said.append(
            f"held-out roll-outs miss the points by {1e3 * missed:.2g} mm, sensors explain {1e3 * could:.2g} mm: the "
            "form is wrong (tendons, friction, backbone), or the data are too few for its parameters"
        )
    return tuple(said)
