"""Identify an arm from short noisy recordings: output error with unknown initial states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import finite_array, non_negative
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.models.arm.alignment import aligned
from pisplit.models.arm.marker_sight import marker_array
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.evidence import Evidence
from pisplit.models.calibration.model import Calibration, ParametrisedArm, check_memory
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.rod.analysis.fields import N_FIELDS


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
    errors = position_error, rotation_error, rate_error
    return Evidence(y, logs, dt, *errors, stations, equilibria, play).calibrated(model)
