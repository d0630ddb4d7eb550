"""Candidates for the calibration of an arm, fitted and judged on the same data, each from a simpler or richer one."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from tqdm import tqdm

from pisplit import Episodes
from pisplit.data.actuator import Actuator
from pisplit.models.arm.resting import RestShapes
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.choice import TriedCalibration, compared, hopeless, worse, worth
from pisplit.models.calibration.estimates import Estimate
from pisplit.models.calibration.evidence import Evidence
from pisplit.models.calibration.gauss_newton import Fitted
from pisplit.models.calibration.judging import Ahead, FitEnd, HeldOut
from pisplit.models.calibration.model import Calibration, CalibrationError, ParametrisedArm
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.windows import Windows, stretches
from pisplit.models.rod.analysis.fields import N_FIELDS

#: What every candidate identifies, and what it may identify besides, in the order in which groups are tried one by one.
ALWAYS: tuple[str, ...] = ("tendons", "bending", "damping")
OPTIONAL: tuple[str, ...] = ("lag", "play", "friction", "load", "routing")
#: Parameters of each optional group, as estimates name them.
NAMES = {"lag": "lag", "play": "play", "friction": "friction", "load": "tip_mass", "routing": "shift"}
#: First guesses of a group that becomes free: lag in time steps, play in usual displacements, friction, the speed in
#: m/s over which it turns round.
LAG, PLAY, FRICTION, SLIP_SPEED = 0.5, 0.015, 0.05, 5e-3
#: Standard deviation of displacements that nobody knows, in usual displacements.
LATE = 0.01
#: Standard errors below which a group is the first to be left out.
SIGNIFICANT = 2.0
#: Distance of points, in parts of their measuring error, below which errors of roll-outs are equally good.
EQUAL = 0.1


@dataclass
class Candidates:
    """Candidates on the same data: fitted, judged, compared.

    Attributes:
        recordings: what windows are cut from.
        held_out: what roll-outs are compared with.
        windows: what candidates are compared by.
        whole: what the chosen one is fitted to at last; the same where data are few.
        shapes: shapes at rest beside them.
        errors: of positions in m, of entries of frames, of rates in parts of their spread.
        start: what is told of the tendons, the first guess.
        told: what is told of the servos.
        late: standard deviation in m of displacements that nobody knows.
        play: first guess of an unknown play in m.
        groups: optional groups to choose from.
        ahead: steps of roll-outs.
        bar: of progress.
        tried: all candidates so far.
        arms: their forms.
        ahead_of: roll-outs of those that have a calibration.
    """

    recordings: Episodes
    held_out: Episodes
    windows: Windows
    whole: Windows
    shapes: RestShapes | None
    errors: tuple[float, float, float]
    start: TendonParameters
    told: Actuator
    late: float
    play: float
    groups: tuple[str, ...]
    ahead: int
    bar: tqdm[None]
    tried: list[TriedCalibration] = field(default_factory=list)
    arms: list[TendonArm] = field(default_factory=list)
    ahead_of: dict[int, Ahead] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.stations = self.windows.fields.shape[2] // N_FIELDS
        self.held = HeldOut(self.held_out, stretches(self.held_out, self.ahead))
        self.evidence = self.evidence_of(self.windows)
        self.models: dict[int, ParametrisedArm] = {}
        self.ends: dict[int, Fitted] = {}
        points = 3 * (self.stations - 1)
        self.floor = points * (EQUAL * self.errors[0]) ** 2

    def evidence_of(self, windows: Windows) -> Evidence:
        """The ``windows``, and shapes at rest beside them."""
        shapes = self.shapes
        rest = None if shapes is None else (shapes.inputs, shapes.fields)
        logs, dt = list(windows.logs), self.recordings.dt
        return Evidence(windows.fields, logs, dt, *self.errors, self.stations, rest, self.late)

    def best_form(self, forms: Sequence[TendonArm]) -> int:
        """Number of the best candidate with none or all of the groups, of any of the ``forms``.

        They are fitted roughly, the best of them to the end. Where all groups together made that form no better, they
        are tried one by one.
        """
        best, alone = -1, False
        for arm in forms:
            mine, worse_together = self.fitted(arm, (), -1), False
            if self.groups:
                rich = self.fitted(arm, self.groups, mine)
                if worth(self.tried[rich].gain, self.tried[rich].spread):
                    mine = rich
                else:
                    worse_together = bool(self.tried[rich].note) or self.tried[rich].gain < 0.0
            if best < 0 or worth(*self.gain(mine, best)):
                best, alone = mine, worse_together
        return self.finished(self.grown(self.arms[best], best) if alone else best)

    def finished(self, best: int) -> int:
        """The rough candidate ``best``, fitted to the end in its place."""
        done_already = best in self.ends and self.ends[best].settled
        if self.tried[best].calibration is not None and not done_already:
            done = self.fitted(self.arms[best], self.optional(best), best, False)
            self.replaced(best, done)
        return best

    def replaced(self, number: int, done: int) -> None:
        """Candidate ``done``, the last one, takes the place of the one of this ``number``."""
        assert done == len(self.tried) - 1
        before, new = self.tried[number], self.tried.pop()
        self.arms.pop()
        self.ahead_of[number] = self.ahead_of.pop(done, self.ahead_of[number])
        if done in self.ends:
            self.ends[number] = self.ends.pop(done)
        gain = spread = np.nan
        if before.other >= 0:
            gain, spread = compared(new.errors, self.tried[before.other].errors, self.floor)
        told = replace(new, gain=gain, spread=spread, other=before.other, seconds=new.seconds + before.seconds)
        self.tried[number] = told

    def completed(self, best: int) -> int:
        """The candidate ``best``, fitted to all that may be learned from, in its place if that is better."""
        if len(self.whole) * self.whole.steps > len(self.windows) * self.windows.steps:
            self.evidence = self.evidence_of(self.whole)
            self.ends.clear()
            done = self.fitted(self.arms[best], self.optional(best), best, False)
            if worse(*self.gain(done, best)):
                self.tried.pop()
                self.arms.pop()
            else:
                self.replaced(best, done)
        return best

    def grown(self, arm: TendonArm, best: int) -> int:
        """The candidate ``best``, of the form ``arm``, with those groups, one after the other, that make it better."""
        for group in self.groups:
            more = self.fitted(arm, (*self.optional(best), group), best)
            if worth(self.tried[more].gain, self.tried[more].spread):
                best = more
        return best

    def pruned(self, best: int) -> int:
        """The candidate ``best`` without the groups that do not make it better by more than the spread."""
        while kept := self.optional(best):
            size = self.significance(best)
            weak = [g for g in kept if size[g] < SIGNIFICANT]
            least = min(kept, key=lambda g: size[g])
            for out in ([weak] if len(weak) > 1 else []) + [[least]]:
                less = self.fitted(self.arms[best], [g for g in kept if g not in out], best)
                if hopeless(*self.gain(best, less)):
                    continue
                if not worth(*self.gain(best, self.finished(less))):
                    break
            else:
                return best
            best = less
        return best

    def optional(self, number: int) -> tuple[str, ...]:
        """Optional groups of the candidate of this ``number``."""
        return tuple(g for g in self.tried[number].free if g in OPTIONAL)

    def gain(self, this: int, other: int) -> tuple[float, float]:
        """Mean log gain of candidate ``this`` over the ``other``, and its standard error."""
        return compared(self.tried[this].errors, self.tried[other].errors, self.floor)

    def significance(self, number: int) -> dict[str, float]:
        """How many standard errors every optional group of candidate ``number`` is away from what is told."""
        found = self.tried[number].calibration
        assert found is not None  # a candidate without one is never kept
        return {g: _away(found.estimates, g, self.start, self.told) for g in self.optional(number)}

    def fitted(self, arm: TendonArm, extra: Sequence[str], origin: int, rough: bool = True) -> int:
        """Number of the candidate of the form ``arm`` with ``extra`` groups, fitted from the result of ``origin``.

        ``rough``: not to the last digit.
        """
        begin = time.process_time()
        found = None if origin < 0 else self.tried[origin].calibration
        first = self.start if found is None else found.parameters
        servo = self.told if found is None else found.actuator
        before = () if origin < 0 else self.optional(origin)
        first, servo = self.guess(first, servo, tuple(extra), before)
        model = self.model(arm, first, (*ALWAYS, *extra), servo)
        same = found is not None and self.arms[origin] is arm
        restart = same and set(extra) <= set(before)
        calibration, note = self.calibrated(model, restart, rough, self.ends.get(origin) if same else None)
        errors = np.full(len(self.held.parts), np.inf)
        if calibration is not None:
            ahead = self.held.rollouts(model, calibration, self.ahead_of.get(origin) if restart else None)
            errors, self.ahead_of[len(self.tried)] = ahead.errors, ahead
        gain = spread = np.nan
        if origin >= 0:
            gain, spread = compared(errors, self.tried[origin].errors, self.floor)
        over = arm.tendons.disks
        form = (
            "along the backbone" if over is None else f"over {len(arm.tendons.holes(arm.scene.rod.length)) - 1} disks"
        )
        seconds = time.process_time() - begin
        free = (*ALWAYS, *extra)
        self.tried.append(TriedCalibration(form, free, errors, gain, spread, origin, note, seconds, calibration))
        self.arms.append(arm)
        self.bar.update()
        return len(self.tried) - 1

    def model(self, arm: TendonArm, first: TendonParameters, free: tuple[str, ...], servo: Actuator) -> ParametrisedArm:
        """The form ``arm`` with the groups ``free``, ``first`` guess and ``servo``: one scene serves all groups."""
        if id(arm) not in self.models:
            self.models[id(arm)] = ParametrisedArm(arm, first, (*ALWAYS, *self.groups), servo)
        return ParametrisedArm(arm, first, free, servo, like=self.models[id(arm)])

    def doubts(self, number: int) -> tuple[str, ...]:
        """Why the form of the candidate of this ``number`` may be wrong."""
        found = self.tried[number].calibration
        assert found is not None  # a candidate without one is never chosen
        model = self.model(self.arms[number], found.parameters, self.tried[number].free, found.actuator)
        end = FitEnd.of(self.ends[number]) if number in self.ends else None
        return self.held.doubts(model, found, self.ahead_of[number], self.errors, end)

    def guess(
        self, first: TendonParameters, servo: Actuator, extra: tuple[str, ...], before: tuple[str, ...]
    ) -> tuple[TendonParameters, Actuator]:
        """First guesses: groups that become free begin off zero, those that are left out are as they were told.

        ``first`` and ``servo`` are the result with the groups ``before``; ``extra`` ones are free now.
        """
        start, told = self.start, self.told
        new = {
            "lag": told.lag or LAG * self.recordings.dt,
            "play": told.play or self.play,
        }
        for name, value in new.items():
            if (name in extra) != (name in before):
                servo = replace(servo, **{name: value if name in extra else getattr(told, name)})
        if "friction" not in extra:
            first = replace(first, friction=start.friction, slip_speed=start.slip_speed)
        elif "friction" not in before:
            first = replace(first, friction=start.friction or FRICTION, slip_speed=SLIP_SPEED)
        if "load" not in extra:
            first = replace(first, tip_mass=start.tip_mass)
        if "routing" not in extra:
            first = replace(first, shift=start.shift)
        return first, servo

    def calibrated(
        self, model: ParametrisedArm, restart: bool, rough: bool, near: Fitted | None
    ) -> tuple[Calibration | None, str]:
        """The fit of a ``model`` and what went wrong with it; ``restart``, ``rough`` and ``near`` as ``Evidence`` takes
        them."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of motions under parameters that are given up again
            try:
                found = self.evidence.fit(model, rough, restart, near)
                self.ends[len(self.tried)] = found
                return self.evidence.told(model, found), ""
            except CalibrationError as error:
                return error.calibration, str(error)
            except (RuntimeError, np.linalg.LinAlgError) as error:
                return None, str(error)


def _away(estimates: Sequence[Estimate], group: str, start: TendonParameters, told: Actuator) -> float:
    """Largest distance of a group's estimates from what is told, in standard errors."""
    neutral = {"lag": told.lag, "play": told.play, "friction": start.friction, "tip_mass": start.tip_mass}
    shifts = {
        f"shift_{axis}[{i}]": v for i, p in enumerate(start.shift.tolist(), 1) for axis, v in zip("xy", p, strict=True)
    }
    sizes = [
        abs(e.value - (neutral | shifts)[e.name]) / max(e.error, 1e-300)
        for e in estimates
        if e.name.split("_x")[0].split("_y")[0] == NAMES[group]
    ]
    return max(sizes, default=0.0)
