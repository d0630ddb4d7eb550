"""Identify an arm from short noisy recordings: output error with unknown initial states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, non_negative
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.models.arm.alignment import aligned
from pisplit.models.arm.energy_prior import moving_energy
from pisplit.models.arm.marker_sight import MarkerSight, marker_array
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.sight import Sight
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.model import Calibration, ParametrisedArm, check_memory
from pisplit.models.calibration.motion import Motion
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.problem import Local, Problem
from pisplit.models.calibration.resting_shapes import RestingShapes
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Gauss-Newton ends when no free parameter, of order one, changes by more, or the sum of squares falls by a smaller
#: part; and after so many steps.
CONVERGED, UNLIKELIER, STEPS = 5e-3, 1e-4, 30
#: Factors of Marquardt's weight after a step that was taken and one that was not.
EASED, STIFFENED = 0.5, 5.0
#: Weight from which on steps of initial states are short, too, and rise of the sum of squares that is none: a standard
#: error of one parameter is worth more, and steps that the integrator halves here and not there make as much.
STOPPED, LEVEL = 1e3, 1.0
#: First weight, and factor after a step that was taken, where it holds back initial states too; standard errors, root
#: mean square over the parameters, that a whole step would be long where such a fit ends.
CAREFULLY, QUICKLY, NEAR = 0.03, 0.25, 0.1
#: Standard errors, root mean square over the parameters, that a step may still be long where no step goes downhill.
SETTLED = 0.5
#: Weight above which a short step only says that it was held back.
HELD_BACK = 0.1
#: Relative change, and number of steps, that end the fit to shapes at rest where that to recordings starts.
SHAPES_DIGITS, SHAPES_STEPS = 1e-3, 20
#: Steps of recordings of markers, before the whole, that a fit is led through.
HORIZONS = (3, 6, 12, 24)
#: Factor from one to the next of the sensors' errors on the way from a first guess to markers, the largest that is left
#: out, and steps for each.
LADDER, NOISY, ROUGHLY = 6.0, 2.0, 4
#: Root mean square of misses in standard deviations beyond which the form of the arm, or its sensors, are not as told.
ASTRAY = 1.5
#: Part of its spread before up to which a tilt or twist of the tip counts as seen.
SEEN = 0.5
#: Least standard deviation in m of shapes at rest beside recordings: friction and play leave arms anywhere about there.
LOOSE = 2e-3


def calibrate_from_recordings(
    arm: TendonArm,
    fields: ArrayLike,
    inputs: ArrayLike | Sequence[ArrayLike],
    dt: float,
    position_error: float = 1e-3,
    rotation_error: float = 0.02,
    rate_error: float = 0.05,
    stations: int = 6,
    free: Sequence[str] = ("damping",),
    start: TendonParameters | None = None,
    equilibria: tuple[ArrayLike, ArrayLike] | None = None,
    input_error: float = 0.0,
    actuator: Actuator | None = None,
    capture: MotionCapture | None = None,
) -> Calibration:
    """Parameters whose motion looks like noisy recordings, and the initial state of each of them.

    One-step predictions from measured states (``calibrate_from_pairs``) are exact for exact states and biased for noisy
    ones: noise of the velocities makes the arm look less damped. Here the initial state of every recording is
    unknown too, and all of its instants count by the errors of their sensors. Initial states are eliminated from every
    Gauss-Newton step (variable projection: Golub, Pereyra, *The differentiation of pseudo-inverses and nonlinear least
    squares problems whose variables separate*, SIAM J. Numer. Anal. 1973).

    Args:
        fields: measured fields (N, T+1, 24 S) at T+1 instants of N recordings; a few steps each are enough.
        inputs: displacements (N, T+1, m) in m at these instants; they move linearly in between. With an ``actuator``:
            for every recording all commands (D, m) from rest on, the last T+1 of them at its instants.
        dt: time between the instants in s.
        stations: their number S.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
        rate_error: that of curvatures and velocities, in parts of their spread in the recordings.
        arm, free, start: as in ``calibrate_from_pairs``; with an ``actuator`` "lag" and "play" may be free, too.
        equilibria: displacements (M, m) in m and measured fields (M, 24 S) at rest under them: the first guess is
            fitted to them as they are, and they count beside the recordings.
        input_error: standard deviation in m of the displacements, such as an unknown play makes: each recording and
            each equilibrium then has unknown displacements too, the measured ones and a constant.
        actuator: first guess of the servos between commands and displacements.
        capture: markers, where positions of a few points are all that is measured: ``fields``, and those of
            ``equilibria``, are then their columns (N, T+1, K), NaN where a marker was lost, and the errors above say
            nothing. Initial states are held to the shape at rest under the first displacements by their energy
            (``energy_prior``); with ``pose="estimated"`` the pose of the base is found, too.
            ``calibrate_from_markers`` cuts recordings into such windows.

    ``residual`` of the result is in standard deviations of the measurement. Raises RuntimeError where no recording can
    be simulated, and ``CalibrationError``, which is one, where the steps did not converge, or some recordings could
    not be simulated.
    """
    length, m = arm.scene.rod.length, arm.scene.n_inputs
    if capture is None:
        y = finite_array(fields, "fields", (None, None, N_FIELDS * stations))
    else:
        y = marker_array(fields, capture, length, (-1, -1))
    if y.shape[1] < 2:
        raise ValueError("recordings hold one instant; expected two or more")
    check_memory(arm)
    given: Any = inputs
    if actuator is None:
        logs = list(finite_array(given, "inputs", (len(y), y.shape[1], m)))
    else:
        logs = [finite_array(log, "inputs", (None, m)) for log in given]
        if len(logs) != len(y) or any(len(log) < y.shape[1] for log in logs):
            raise ValueError(f"inputs are {len(logs)} command logs; expected {len(y)} of {y.shape[1]} rows or more")
    if capture is not None and capture.pose == "estimated":
        capture = aligned(arm, capture, np.stack([log[-y.shape[1]] for log in logs]), y[:, 0])
    model = ParametrisedArm(arm, start, free, None if actuator is None else checked_actuator(actuator), capture)
    play = non_negative(input_error, "input_error", "m")
    rest, x = None, model.first
    if equilibria is not None:
        strict = RestingShapes(model, *equilibria, position_error, rotation_error, stations, play)
        x = np.asarray(strict.fit(SHAPES_DIGITS, SHAPES_STEPS).x, dtype=np.float64)
        sharp = position_error if capture is None else capture.noise
        rest = strict.weighed_down(max(1.0, LOOSE / sharp) if model.rubs else 1.0)
    if capture is None:
        seen = Sight(model.scene, stations)
        errors = seen.errors(y, position_error, rotation_error, rate_error)
        motion = Motion(model, seen, dt, y[..., seen.rows], logs, errors, play)
        first = np.stack([np.concatenate([seen.state(rows[0]), np.zeros(motion.n_offsets)]) for rows in y])
    else:
        motion = Motion(model, MarkerSight(model.scene, capture), dt, y, logs, capture.sizes, play, moving_energy(arm))
        first = motion.first_guess(x)
    problem = Problem(model, motion, rest)
    if capture is not None:
        x, first = approached(problem, x, first)
    found = fitted(problem, x, first)
    residual = float(np.sqrt(found.best.misses / max(found.best.entries, 1.0)))
    why, notes = found.why, []
    if not why and found.best.used < len(y):
        why = f"{len(y) - found.best.used} of {len(y)} recordings could not be simulated"
    if capture is not None:
        triangles = {i: back.triangle for i, back in found.best.backs.items()}
        for name, left in zip(("tilt", "twist"), motion.unseen(triangles), strict=True):
            if left > SEEN:
                notes.append(f"{name} of the tip: not seen by these markers ({100 * left:.0f} % of its spread is left)")
        if residual > ASTRAY:
            notes.append(
                f"missed by {residual:.2g} times the noise told: the form of the arm or the noise is another; errors "
                "of the parameters are those of the noise found"
            )
    return model.result(found.x, residual, found.best.used, found.best.normal, residual, why, notes)


@dataclass(frozen=True)
class Fitted:
    """Where a fit ended.

    Attributes:
        x: parameters (P,).
        first: initial states (N, n).
        best: the problem there.
        why: it is not to be relied on, empty if it is.
    """

    x: Array
    first: Array
    best: Local
    why: str


def approached(problem: Problem, x: Array, first: Array) -> tuple[Array, Array]:
    """Parameters and initial states near the end, by recordings of a few steps and then of more of them.

    Before the parameters explain what is seen, initial states that are free to explain it are thrown far off: short
    recordings are nearly linear in them, and sensors are taken for as bad as the first guess makes them, then less.

    Args:
        problem: what is to be small.
        x: first guess (P,).
        first: initial states and offsets (N, 2n + m).
    """
    whole = problem.motion.measured.shape[1] - 1
    for steps in (k for k in HORIZONS if k < whole):
        short = problem.shortened(steps)
        best = short.linearised(x, first)
        factor = float(np.sqrt(best.misses / max(best.entries, 1.0)))
        while factor > NOISY:
            found = fitted(short.weighed_down(factor), x, first, ROUGHLY)
            x, first, factor = found.x, found.first, factor / LADDER
        found = fitted(short, x, first, ROUGHLY)
        x, first = found.x, found.first
    return x, first


def fitted(problem: Problem, x: Array, first: Array, steps: int = STEPS) -> Fitted:
    """Damped Gauss-Newton steps to the end.

    Args:
        problem: what is to be small.
        x: first guess (P,); that of the model where shapes at rest have misled it.
        first: initial states and offsets (N, 2n + m).
        steps: most of them.

    Raises RuntimeError where no recording can be simulated.
    """
    best = problem.linearised(x, first)
    if problem.rest is not None:
        tried = problem.linearised(problem.model.first, first)
        if not best.better(tried):  # shapes at rest alone may leave an arm that cannot be moved
            x, best = problem.model.first, tried
    if not best.used:
        raise RuntimeError("no recording could be simulated; check that fields and inputs belong to this arm")
    states_shown = problem.motion.energy is None
    weight = 0.0 if states_shown else CAREFULLY
    for _ in range(steps):
        change = problem.change(x, best, weight)
        start_of = best.moved(first, change, weight)
        tried = problem.linearised(x + change, start_of)
        small = bool(np.abs(change).max() < CONVERGED)
        fell = best.cost - tried.cost
        if tried.better(best):
            still = tried.used == best.used and fell < UNLIKELIER * best.cost
            done = weight <= HELD_BACK and (small or still)
            x, first, best = x + change, start_of, tried
            weight *= EASED if states_shown else QUICKLY
            if done or (not states_shown and problem.standard_errors_left(x, best) < NEAR):
                return Fitted(x, first, best, "")
        else:
            weight = max(STIFFENED * weight, 1e-3)
            # uphill however short the step: the end, where what is left to do is below what data tell
            if small and (states_shown or weight > STOPPED or -fell < LEVEL):
                left = problem.standard_errors_left(x, best)
                uphill = f"the sum of squares {best.cost:.3g} rises by {-fell:.2g} however short the step"
                why = f"{uphill}, and a whole step would be {left:.2g} standard errors long"
                return Fitted(x, first, best, why if left > SETTLED else "")
    return Fitted(x, first, best, f"no end after {steps} steps")
