"""Damping of an arm from one free decay, seen by a few markers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pisplit import Episodes
from pisplit.brief import brief
from pisplit.checks import positive
from pisplit.models.arm.drawing import slowest
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.calibration.from_markers import calibrate_from_markers
from pisplit.models.calibration.model import Calibration
from pisplit.models.rod import KelvinVoigt

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.arm.tendon_arm import TendonArm

#: Change of the inputs, in parts of the arm's usual displacement, up to which they count as held.
HELD = 1e-3


@brief
@dataclass(frozen=True)
class FoundDamping:
    """Material damping of the backbone.

    Attributes:
        bending: Kelvin-Voigt coefficient of bending in N m^2 s.
        error: its standard error.
        ratio: damping ratio of the slowest motion about rest, by all that damps the arm.
        frequency: of that motion in Hz.
        calibration: the fit, with the arm so damped.
    """

    bending: float
    error: float
    ratio: float
    frequency: float
    calibration: Calibration

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The slowest motion as the damping found has it, with two standard errors; written to ``path`` if given."""
        from pisplit.models.calibration.pictures import plot_damping

        return plot_damping(self, path)


def calibrate_damping(
    arm: TendonArm, recording: Episodes, capture: MotionCapture, windows: int = 4, steps: int = 12
) -> FoundDamping:
    """Damping from recordings of an arm that swings freely while its tendons are held, by markers alone.

    The same least squares as ``calibrate_from_markers``, with all but the damping as the ``arm`` has it: calibrate
    stiffness and tendons before. All damping of a motion is laid to the material but what the scene says of air.

    Args:
        arm: with its first guess of the damping.
        recording: one or more free decays, from after the arm was let go.
        capture: its markers, with a given pose.
        windows: number of stretches that are compared.
        steps: of each.

    Raises ValueError where inputs move or the arm has no Kelvin-Voigt damping to scale, and RuntimeError where the
    motion does not tell the damping: its standard error is above half of the first guess's spread.
    """
    moved = max(float(np.ptp(u, axis=0).max()) for u in recording.us)
    if moved > HELD * positive(arm.amplitude, "amplitude of the arm", "m"):
        raise ValueError(
            f"the inputs move by {moved:.2g} m; a ring-down holds them: cut the recording after the release"
        )
    told = sum(t.bending for t in arm.passive.terms if isinstance(t, KelvinVoigt))
    if not told > 0.0:
        raise ValueError("the arm has no Kelvin-Voigt damping; give it a guess: rod.KelvinVoigt, or damping_ratio=")
    found = calibrate_from_markers(arm, recording, capture, ("damping",), windows=windows, steps=steps)
    (damping,) = found.estimates
    if not damping.identified:
        raise RuntimeError(
            f"these decays do not tell the damping: factor {damping.value:.2g} +- {damping.error:.2g}; give longer "
            "ones, of larger motion"
        )
    frequency, ratio = slowest(found.arm.scene, recording.us[0][0])
    return FoundDamping(told * damping.value, told * damping.error, ratio, frequency / (2.0 * np.pi), found)
