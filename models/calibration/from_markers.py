"""Identify an arm from recordings of a few markers: windows of them, commands and all, cut for the fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit import Episodes
from pisplit.checks import Array, count
from pisplit.data.actuator import Actuator
from pisplit.models.arm.marker_sight import read_markers
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.calibration.model import Calibration
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.recordings import calibrate_from_recordings

if TYPE_CHECKING:
    from pisplit.models.arm.tendon_arm import TendonArm


def calibrate_from_markers(
    arm: TendonArm,
    episodes: Episodes,
    capture: MotionCapture,
    free: Sequence[str] = ("tendons", "bending", "damping"),
    start: TendonParameters | None = None,
    shapes: tuple[ArrayLike, ArrayLike] | None = None,
    windows: int = 16,
    steps: int = 12,
    actuator: Actuator | None = None,
    input_error: float = 0.0,
) -> Calibration:
    """Tendons, stiffness and damping of an arm by the positions of a few markers in motion: no other fields.

    Windows spread over the recordings are simulated from unknown initial states and compared with what was seen
    (:func:`calibrate_from_recordings`). What a marker does not show of an initial state is held near the shape at rest
    under the first command, by its energy. Commands are reached linearly over a step, from the arm's rest on.

    Args:
        arm: as drawn: its numbers are the first guess.
        episodes: recordings with the columns of the markers.
        capture: which they are, where they sit, and their noise.
        free: what to identify; see ``calibrate_from_recordings``.
        start: first guess in place of the arm's own tendons.
        shapes: displacements (M, m) in m and marker columns (M, K) at rest under them, if there are any.
        windows: their number.
        steps: of each window; half a period of the slowest motion tells its damping, longer ones are harder to fit.
        actuator: first guess of servos, whose lag and play may be free then.
        input_error: standard deviation in m of unknown constant displacements, such as an unknown play makes.

    The result has a note where the misses are larger than the noise told. Raises ValueError for recordings that are too
    short or have other columns or inputs, and CalibrationError for fits that did not end.
    """
    columns, data = read_markers(episodes, arm, capture)
    y, logs = cut(columns, data.us, arm.rest_inputs, count(windows, "windows"), count(steps, "steps"))
    told: Sequence[Array] = logs if actuator is not None else [log[-(steps + 1) :] for log in logs]
    return calibrate_from_recordings(
        arm,
        y,
        told,
        data.dt,
        free=free,
        start=start,
        equilibria=shapes,
        input_error=input_error,
        actuator=actuator,
        capture=capture,
    )


def cut(
    columns: Sequence[Array], us: Sequence[Array], rest: Array, windows: int, steps: int
) -> tuple[Array, list[Array]]:
    """Windows (N, T+1, K) spread evenly over recordings, and all commands from rest to the end of each.

    Args:
        columns: (T_i+1, K) of every recording.
        us: (T_i, m) its inputs.
        rest: (m,) before them.
        windows: wanted number.
        steps: T of each.

    Raises ValueError where no recording is long enough.
    """
    room = np.array([len(u) - steps for u in us])  # the first window starts after a step, where commands are known
    if room.max() < 1:
        raise ValueError(f"the longest recording has {room.max() + steps} steps; expected {steps + 1} or more")
    usable = np.flatnonzero(room >= 1)
    ends = np.cumsum(room[usable])
    at = (np.arange(windows) + 0.5) * ends[-1] / windows
    which = np.searchsorted(ends, at, side="right")
    first = np.floor(at - np.concatenate([[0], ends])[which]).astype(int) + 1
    y, logs = [], []
    for i, k in zip(usable[which], np.minimum(first, room[usable][which]), strict=True):
        y.append(columns[i][k : k + steps + 1])
        logs.append(np.vstack([rest, us[i][: k + steps]]))
    return np.stack(y), logs
