"""An arm identified again from the log of its loop: tip mass and stiffness, and the model that follows from them."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import count, one_of
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.reidentify import NewModel
from pisplit.data.actuator import Actuator
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted
from pisplit.front.physical import physical_model
from pisplit.lifted.model import LiftedModel
from pisplit.models.arm import TendonArm
from pisplit.models.arm.resting import RestShapes
from pisplit.models.calibration import (
    Calibration,
    TendonParameters,
    calibrate_from_recordings,
    calibrate_from_shapes,
    nominal_parameters,
)
from pisplit.models.rod.analysis.fields import N_FIELDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Windows of the log and their steps: longer ones of violent motion jump between solutions.
WINDOWS, STEPS = 16, 6
#: Windows and steps of a first fit, from whose parameters all others are followed: single steps are nearly linear,
#: where longer windows of a limit cycle jump between solutions far from the parameters, and a fit to them does not end.
FEW, SHORT = 8, 1
#: One of so many stretches is calm.
CALM = 4
#: Misses in standard deviations of the sensors from which on what was freed does not explain the log.
UNEXPLAINED = 3.0
#: Mass at the tip in kg with which a fit to shapes at rest begins.
FIRST_MASS = 5e-3
#: What a change may be, by the parameters that it frees.
CAUSES = {"payload": "load", "stiffness": "bending", "damping": "damping", "play": "play"}
#: Two causes are told apart where one leaves misses so many times as large as the other.
APART = 1.5

Rebuild = Callable[[TendonArm, float, int], LiftedModel | Fitted]


@dataclass(frozen=True)
class ArmIdentifier:
    """For :meth:`pisplit.controllers.ClosedLoop.reidentify`: an arm's tip mass and stiffness from its loop.

    From windows of the log by output error with unknown initial states (``calibrate_from_recordings``), or from
    ``shapes`` at rest where they are given; then the model is made anew by ``rebuild``. Standard errors are in the
    notes of the result, its ``found`` is the :class:`Calibration`, whose ``arm`` is the arm of the next identification.

    Args:
        arm: as it was known, drawn or calibrated.
        free: what is identified: "load" (a mass at the tip), "bending", "damping", "tendons", "routing", "friction".
        shapes: fields at rest, measured since the change.
        position_error, rotation_error, rate_error: standard deviations of positions in m, of the entries of frames, and
            of curvatures and velocities in parts of their spread.
        windows, steps: number of windows of the log, and their steps.
        rebuild: (arm, dt, stations) -> model; :func:`physical_model` if not given.

    Raises ValueError in use where the log holds too little, another arm's states, or does not identify what is free;
    :class:`CalibrationError` where the fit fails.
    """

    arm: TendonArm
    free: Sequence[str] = ("load", "bending")
    shapes: RestShapes | None = None
    position_error: float = 1e-4
    rotation_error: float = 2e-3
    rate_error: float = 0.05
    rebuild: Rebuild | None = None
    windows: int = WINDOWS
    steps: int = STEPS

    def __call__(self, log: LoopLog) -> NewModel:
        """Identify the arm from the end of a ``log`` and make its model anew."""
        start = time.perf_counter()
        found = self.calibrated(log)
        fitted = time.perf_counter() - start
        stations = log.x.shape[1] // N_FIELDS
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = (self.rebuild or physical_model)(found.arm, log.dt, stations)
        rebuilt = time.perf_counter() - start - fitted
        told = [" ".join(str(estimate).split()) for estimate in found.estimates]
        what = "windows" if self.shapes is None else "shapes at rest"
        notes = (
            f"identified again from {found.samples} {what} in {fitted:.1f} s, missed by {found.residual:.2g} standard "
            f"deviations; the model made anew in {rebuilt:.1f} s",
            *told,
        )
        return NewModel(model, notes, whole_stretch(log), found)

    def calibrated(self, log: LoopLog) -> Calibration:
        """What the end of a ``log``, or the shapes, say of the arm; raises ValueError where they do not say it."""
        found = self._fit(log, self.free, None)
        unknown = [estimate.name for estimate in found.estimates if not estimate.identified]
        if unknown:
            raise ValueError(
                f"the {'windows of the log' if self.shapes is None else 'shapes'} identify no {', '.join(unknown)}: "
                "move the arm more, leave it out of free, or give other shapes at rest"
            )
        if found.residual > UNEXPLAINED:
            raise ValueError(
                f"{', '.join(self.free)} do not explain what was measured: missed by {found.residual:.2g} standard "
                "deviations; free something else, see causes(log), or correct the errors of the sensors"
            )
        return found

    def causes(self, log: LoopLog, names: Sequence[str] = tuple(CAUSES)) -> Causes:
        """How well each of the causes in ``names`` alone explains the end of a ``log``.

        "payload", "stiffness", "damping", "play": one number is fitted for each. A force or a contact is none of them.
        """
        missed = {}
        for name in names:
            one_of(name, "cause", tuple(CAUSES))
            try:
                fit = self._fit(log, (CAUSES[name],), Actuator() if name == "play" else None)
                missed[name] = fit.residual, " ".join(str(fit.estimates[0]).split())
            except RuntimeError as error:
                missed[name] = np.inf, str(error)
        return Causes(missed)

    def _fit(self, log: LoopLog, free: Sequence[str], servo: Actuator | None) -> Calibration:
        if self.shapes is not None and servo is None:
            s, known = self.shapes, nominal_parameters(self.arm)
            if "load" in free:  # a search that begins on its bound, no mass, stays there
                known = replace(known, tip_mass=known.tip_mass + FIRST_MASS)
            return calibrate_from_shapes(
                self.arm, s.inputs, s.fields, s.position_error, s.rotation_error, s.stations, free, known
            )
        start: TendonParameters | None = None
        if servo is None and self.windows > FEW and self.steps > SHORT:
            with suppress(RuntimeError, ValueError):  # then from the arm as it was known
                start = self._followed(log, free, FEW, SHORT, None, None).parameters
        return self._followed(log, free, self.windows, self.steps, servo, start)

    def _followed(
        self,
        log: LoopLog,
        free: Sequence[str],
        windows: int,
        steps: int,
        servo: Actuator | None,
        start: TendonParameters | None,
    ) -> Calibration:
        """The fit to so many ``windows`` of the ``log`` of so many ``steps``, from ``start``."""
        fields, moves = cut(log, self.arm, windows, steps, servo is not None)
        errors = self.position_error, self.rotation_error, self.rate_error
        return calibrate_from_recordings(
            self.arm,
            fields,
            moves,
            log.dt,
            *errors,
            stations=fields.shape[2] // N_FIELDS,
            free=free,
            start=start,
            actuator=servo,
        )


@dataclass(frozen=True)
class Causes:
    """``missed``: by cause, root mean square of the misses in standard deviations, and what was fitted."""

    missed: dict[str, tuple[float, str]]

    @property
    def verdict(self) -> str:
        """The cause that explains the log, "none of them", or those that are not told apart."""
        ranked = sorted(self.missed, key=lambda name: self.missed[name][0])
        least = self.missed[ranked[0]][0]
        if least > UNEXPLAINED:
            return "none of them: a force, a contact, several causes at once, or another arm"
        near = [name for name in ranked if self.missed[name][0] <= APART * max(least, 1.0)]
        return near[0] if len(near) == 1 else f"not told apart: {', '.join(near)}"

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """What each cause leaves unexplained; written to ``path`` where one is given."""
        from pisplit.front.pictures import plot_causes

        return plot_causes(self, UNEXPLAINED, path)

    def __str__(self) -> str:
        rows = [f"{name:<10} missed by {size:.3g}   {text}" for name, (size, text) in self.missed.items()]
        return "\n".join([self.verdict, *rows])


def cut(log: LoopLog, arm: TendonArm, number: int, steps: int, commands: bool = False) -> Any:
    """Short windows of a ``log``: fields (N, steps+1, n), and displacements (N, steps+1, m) in m.

    They are spread evenly over the calmer quarter of what was measured whole: simulations of violent motion, a limit
    cycle for instance, jump between solutions where they begin with wrong parameters. ``number`` of them, of so many
    ``steps``; ``arm``: whose fields these should be. With ``commands`` the second are lists of all inputs of the log up
    to the end of each window. Raises ValueError where the states are not the fields of the arm, or nothing was measured
    for so many steps.
    """
    stations, rest = divmod(log.x.shape[1], N_FIELDS)
    names = tuple(arm.scene.field_map(stations).names) if stations and not rest else ()
    if names != tuple(log.state_names):
        raise ValueError("the states of the log are not the fields of the arm at its stations; nothing is identified")
    inputs = np.vstack([log.u0, log.u])
    gaps = np.count_nonzero(np.isnan(log.x), axis=1)
    size = count(steps, "steps") + 1
    starts = [k for k in range(len(gaps) - size + 1) if not gaps[k : k + size].any()]
    if len(starts) < 2:
        raise ValueError(f"no {size} samples in a row are measured in the log of {len(log.u)} steps; run it longer")
    if len(starts) > CALM * count(number, "number"):
        moved = np.diff(log.x, axis=0) / np.maximum(np.nanmax(np.abs(log.x), axis=0), 1e-12)
        motion = np.array([float((moved[k : k + size - 1] ** 2).mean()) for k in starts])
        starts = [starts[i] for i in np.sort(np.argsort(motion)[: len(starts) // CALM])]
    chosen = [starts[int(i)] for i in np.unique(np.linspace(0, len(starts) - 1, number).astype(int))]
    fields = np.stack([log.x[k : k + size] for k in chosen])
    if commands:
        return fields, [inputs[: k + size] for k in chosen]
    return fields, np.stack([inputs[k : k + size] for k in chosen])


def whole_stretch(log: LoopLog) -> Episodes:
    """The longest stretch of a ``log`` in which everything was measured, as recordings."""
    gaps = np.flatnonzero(np.isnan(log.x).any(axis=1))
    ends = np.concatenate([[-1], gaps, [len(log.x)]])
    k = int(np.argmax(np.diff(ends)))
    first, last = int(ends[k]) + 1, int(ends[k + 1]) - 1
    names: dict[str, Any] = {"state_names": log.state_names, "input_names": log.input_names}
    if any(log.state_units) and any(log.input_units):
        names |= {"units": log.state_units, "input_units": log.input_units}
    return Episodes([log.x[first : last + 1]], [log.u[first:last]], log.dt, **names)
