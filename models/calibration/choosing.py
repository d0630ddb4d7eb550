"""Form of the tendons and free groups of parameters, chosen by roll-outs of held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit import Episodes
from pisplit.checks import check_same_step, count, positive
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.models import rod
from pisplit.models.arm.resting import RestShapes
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.candidates import LATE, OPTIONAL, PLAY, Candidates
from pisplit.models.calibration.choice import CalibrationChoice
from pisplit.models.calibration.model import nominal_parameters
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.windows import FEW, SHORT, Windows
from pisplit.models.rod.analysis.fields import N_FIELDS, UNITS

#: Steps of held-out roll-outs.
AHEAD = 64


def choose_calibration(
    arm: TendonArm,
    recordings: Episodes,
    shapes: RestShapes | None = None,
    held_out: Episodes | None = None,
    disks: Sequence[int | Sequence[float] | None] | None = None,
    groups: Sequence[str] = OPTIONAL,
    spans: ArrayLike | None = None,
    position_error: float | None = None,
    rotation_error: float | None = None,
    rate_error: float = 0.05,
    start: TendonParameters | None = None,
    actuator: Actuator | None = None,
    ahead: int = AHEAD,
    progress: bool = True,
) -> CalibrationChoice:
    """The calibration that predicts held-out recordings best: form of the tendons and groups of free parameters.

    Of every form two candidates are fitted (:func:`calibrate_from_recordings`): tendons, stiffness and damping alone,
    and, started from there, with all ``groups`` too. The form is that of the best of them; these fits are rough, that
    of the best goes on to the end. Groups are then left out again, the least significant first, each fit started from
    the richer one. One scene with the parameters as inputs serves all candidates of a form, for fits and roll-outs.
    Everywhere a richer candidate is kept only where its roll-outs are better by more than the standard error of the
    mean gain, and by 5 %. A fit that fails is a candidate that predicts badly, or none; where the one with all groups
    does, they are tried one by one.

    Args:
        arm: the arm as drawn.
        recordings: of its fields (24 at every station) under commands, each from rest at ``arm.rest_inputs``.
        shapes: shapes at rest, which count beside the recordings.
        held_out: recordings that decide; the last quarter of ``recordings``, which is then not learned from, if not
            given.
        disks: forms to choose from, the simplest first: None along the backbone, a number of disks at equal distances,
            or their arclengths in m. The form of the drawing alone if not given.
        groups: of "lag", "play" (of servos), "friction", "load" (a mass at the tip) and "routing" (points at the tip).
        spans: (K, 3) recording, first and last step of what may be learned from; everything if not given. It is cut
            into windows of up to 64 steps.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames; those of the
            ``shapes``, or 1 mm and 0.02, if not given.
        rate_error: that of curvatures and velocities, in parts of their spread.
        start: first guess in place of the arm's own tendons.
        actuator: servos as far as they are known; lag and play that are not free are taken from it.
        ahead: steps of the roll-outs that decide.
        progress: whether to show a bar.

    Raises ValueError for what does not fit each other, and RuntimeError where no candidate predicts the held-out
    recordings.

    Source: backward elimination with the one-standard-error rule (Hastie, Tibshirani, Friedman, The Elements of
    Statistical Learning, 2009, sections 3.3 and 7.10), here with paired errors.
    """
    unknown = [g for g in groups if g not in OPTIONAL]
    if unknown:
        raise ValueError(f"groups = {list(groups)}; expected some of {', '.join(OPTIONAL)}")
    drawn = arm.tendons
    if disks is not None and not isinstance(drawn, rod.Tendons):
        raise ValueError("disks change tendons as they are drawn; these are calibrated: leave disks out")
    if held_out is None:
        if len(recordings) < 2:
            raise ValueError("one recording cannot be learned from and held out; give held_out, or more recordings")
        out = max(1, round(len(recordings) / 4))
        recordings, held_out = recordings[:-out], recordings[-out:]
    check_same_step(held_out.dt, recordings.dt, "held_out has", "the recordings")
    recordings, held_out = (_fields(arm, data) for data in (recordings, held_out))
    told = (1e-3, 0.02) if shapes is None else (shapes.position_error, shapes.rotation_error)
    errors = [
        value if given is None else positive(given, name)
        for given, value, name in zip(
            (position_error, rotation_error), told, ("position_error", "rotation_error"), strict=True
        )
    ]
    forms = [arm] if disks is None else [over_disks(arm, d) for d in disks]
    if not forms:
        raise ValueError("disks is empty; give one form or more, such as (None, 8)")
    fits = Candidates(
        recordings,
        held_out,
        Windows.of(recordings, spans, arm.rest_inputs, FEW, SHORT),
        Windows.of(recordings, spans, arm.rest_inputs),
        shapes,
        (errors[0], errors[1], positive(rate_error, "rate_error")),
        nominal_parameters(arm) if start is None else start,
        Actuator() if actuator is None else checked_actuator(actuator),
        LATE * arm.amplitude,
        PLAY * arm.amplitude,
        tuple(g for g in OPTIONAL if g in groups),
        count(ahead, "ahead"),
        tqdm(desc="calibrations", unit="fit", disable=not progress),
    )
    best = fits.best_form(forms)
    best = fits.completed(fits.pruned(best))
    fits.bar.close()
    chosen = fits.tried[best]
    if chosen.calibration is None or not np.isfinite(chosen.errors).any():
        why = "; ".join(f"{t.name}: {t.note or 'roll-outs fail'}" for t in fits.tried)
        raise RuntimeError(f"no calibration predicts the held-out recordings ({why[:300]})")
    return CalibrationChoice(
        chosen.calibration,
        tuple(fits.tried),
        best,
        recordings.dt,
        fits.stations,
        (len(fits.whole), fits.whole.steps),
        (len(fits.held.parts), fits.ahead),
        fits.doubts(best),
    )


def _fields(arm: TendonArm, data: Episodes) -> Episodes:
    """The ``data`` with the columns of the arm's fields in their order."""
    stations, over = divmod(data.n_states, N_FIELDS)
    if over:
        raise ValueError(f"the recordings have {data.n_states} states; expected {N_FIELDS} fields at every station")
    found = arm.scene.field_map(stations)
    units = tuple(UNITS[q] for q in found.quantities)
    return data.arranged(tuple(found.names), arm.scene.input_names, units, arm.scene.input_units, owner="the arm")


def over_disks(arm: TendonArm, disks: int | Sequence[float] | None) -> TendonArm:
    """The drawn ``arm`` with its tendons over so many ``disks``, or along the backbone where it is None."""
    drawn = arm.tendons
    if not isinstance(drawn, rod.Tendons):
        raise ValueError("over_disks changes tendons as they are drawn; these are calibrated")
    changed = replace(drawn, disks=disks, slip_speed=None if disks is None else drawn.slip_speed)
    terms = [changed if term is drawn else term for term in arm.scene.terms]
    return replace(arm, scene=rod.Scene(arm.scene.rod, *terms, nodes=arm.scene.nodes))
