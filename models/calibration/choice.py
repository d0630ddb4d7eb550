"""What a choice among calibrations says: what was tried, on held-out roll-outs, and what was kept."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student

from pisplit.brief import brief
from pisplit.checks import Array
from pisplit.data.actuator import Actuator
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.model import Calibration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: What the richer of two candidates has to be better by at least, in parts of the error.
MARGIN = 0.05
#: Times the error of the other that is out of reach of a fit to the last digit, after a rough one.
BEHIND = 3.0
#: Probability that a normal variable is less than one standard deviation above its mean.
ONE_SIGMA = 0.8413


@dataclass(frozen=True, eq=False)
class TriedCalibration:
    """A candidate and what became of it.

    Attributes:
        form: of the tendons, in words.
        free: groups of parameters that were free.
        errors: mean squared distance (R,) in m^2 of every held-out roll-out; infinite where the motion failed.
        gain, spread: mean and standard error over the roll-outs of log(error of the other / error of this) against the
            candidate that it was compared with; NaN where it was not.
        other: number of that candidate in the table, -1 for none.
        note: what went wrong with its fit; empty otherwise.
        seconds: CPU time of fit and roll-outs.
        calibration: its result; None where there is none.
    """

    form: str
    free: tuple[str, ...]
    errors: Array
    gain: float
    spread: float
    other: int
    note: str
    seconds: float
    calibration: Calibration | None

    @property
    def error(self) -> float:
        """Mean squared distance in m^2 over all roll-outs."""
        return float(np.mean(self.errors))

    @property
    def name(self) -> str:
        """Form and free groups."""
        return f"{self.form}: {', '.join(self.free) or 'as told'}"


def compared(this: Array, other: Array, floor: float) -> tuple[float, float]:
    """Mean of log(other / this) over the roll-outs that neither failed, and its spread.

    The spread is the standard error, larger where few roll-outs hardly tell it: by Student's t at the level of one
    standard deviation; a factor of two for a single roll-out.

    Args:
        this, other: errors (R,) in m^2 of the same roll-outs.
        floor: in m^2; differences of errors that are smaller mean nothing.

    Where one of them fails more often the mean is infinite: minus where it is ``this``.
    """
    lost, lost_other = int((~np.isfinite(this)).sum()), int((~np.isfinite(other)).sum())
    if lost != lost_other:
        return (-np.inf if lost > lost_other else np.inf), 0.0
    both = np.isfinite(this) & np.isfinite(other)
    if not both.any():
        return 0.0, 0.0
    ratios = np.log((other[both] + floor) / (this[both] + floor))
    n = len(ratios)
    spread = float(student.ppf(ONE_SIGMA, n - 1) * ratios.std(ddof=1) / np.sqrt(n)) if n > 1 else float(np.log(2.0))
    return float(ratios.mean()), spread


def hopeless(gain: float, spread: float) -> bool:
    """Whether the other of two is so far behind, by this ``gain`` and its ``spread``, that no better fit saves it."""
    return gain > max(3.0 * spread, np.log(BEHIND))


def worse(gain: float, spread: float) -> bool:
    """Whether what has this mean ``gain`` is worse than the other by more than the ``spread``."""
    return gain < -spread


def worth(gain: float, spread: float) -> bool:
    """Whether a mean gain is more than its ``spread``, and more than the margin: what more parameters have to bring."""
    return gain > max(spread, np.log1p(MARGIN))


@brief
@dataclass(frozen=True, eq=False)
class CalibrationChoice:
    """The calibration that predicts held-out recordings best, and all that was tried.

    Attributes:
        calibration: the chosen one.
        tried: all candidates, in the order in which they were fitted.
        chosen: number of the choice among them.
        dt: time step of the recordings in s.
        stations: number of measured points.
        windows: number and steps of the windows that were learned from.
        rollouts: number and steps of the held-out roll-outs.
        doubts: why the form may be wrong all the same, a line each.
    """

    calibration: Calibration
    tried: tuple[TriedCalibration, ...]
    chosen: int
    dt: float
    stations: int
    windows: tuple[int, int]
    rollouts: tuple[int, int]
    doubts: tuple[str, ...] = field(default=())

    @property
    def arm(self) -> TendonArm:
        """The chosen arm."""
        return self.calibration.arm

    @property
    def actuator(self) -> Actuator:
        """Its servos."""
        return self.calibration.actuator

    @property
    def free(self) -> tuple[str, ...]:
        """Groups of parameters that were kept."""
        return self.tried[self.chosen].free

    def predictor(self) -> ArmPredictor:
        """Roll-outs of the chosen arm behind its servos."""
        return ArmPredictor(self.arm, self.dt, self.stations, self.actuator)

    def report(self) -> str:
        """What was tried with its held-out error, the gain over what it was compared with, and what was found."""
        (n, steps), (held, ahead) = self.windows, self.rollouts
        lines = [
            f"chosen   {self.tried[self.chosen].name}",
            f"learned from {n} windows of {steps} steps, chosen by {held} held-out roll-outs of {ahead} steps",
            "",
            "     error of points (mm)   better than     by",
        ]
        for k, t in enumerate(self.tried):
            error = f"{1e3 * np.sqrt(t.error):10.3g}" if np.isfinite(t.error) else f"{'fails':>10}"
            against = f"{t.other + 1:>8}   {_percent(t.gain, t.spread)}" if t.other >= 0 else ""
            mark = "*" if k == self.chosen else " "
            lines.append(f"{mark}{k + 1:>3} {error}           {against:<32} {t.name}")
            if t.note:
                lines.append(f"       {t.note}")
        lines += ["", self.calibration.report()]
        if self.doubts:
            lines += ["", "doubts", *(f"  - {d}" for d in self.doubts)]
        return "\n".join(lines)

    __str__ = report

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Held-out errors of all candidates; written to ``path`` where one is given."""
        from pisplit.models.calibration.pictures import plot_choice

        return plot_choice(self, path)


def _percent(gain: float, spread: float) -> str:
    if not np.isfinite(gain):
        return "fails more often" if gain < 0 else "fails less often"
    return f"{100 * np.expm1(gain):+.3g} % +- {100 * spread:.2g} %"
