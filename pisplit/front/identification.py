"""``identify``: every model that the data allow, chosen on held-out roll-outs, with a report on itself."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit import Episodes, HorizonErrors, LiftedModel, horizon_errors, predicted_error, rollout_errors
from pisplit.brief import brief
from pisplit.checks import one_of
from pisplit.data.sums import not_episodes
from pisplit.front.candidates import CANDIDATES, Candidate, by_hand, fitted
from pisplit.front.case import CALIBRATE, GROUPS, Case
from pisplit.front.judgement import helps, unfit
from pisplit.front.reach import recorded
from pisplit.front.report import Report, Tried
from pisplit.models.arm import Arm, MotionCapture, fields_from_markers
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.resting import RestShapes
from pisplit.models.calibration import CalibrationChoice
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.front.control import Control

#: Fewest steps that anything can be learned and held out from, and steps of the pieces that a single recording is cut
#: into.
FEWEST, PIECES = 40, 5
#: Steps ahead of which the report tells, as far as recordings reach.
HORIZONS = (1, 3, 10, 30, 100, 300)
#: Name of the calibrated arm among what was tried.
PREDICTOR = "the calibrated arm"
#: A later candidate has to be better than an earlier, simpler one by this part.
MARGIN = 0.05


@brief
@dataclass(frozen=True, eq=False)
class Identified:
    """The model that was chosen, and all that was learned on the way.

    Attributes:
        estimator: the chosen estimator, fitted to all recordings.
        rivals: (name, estimator) of the best candidates, fitted without the held-out recordings, best first.
        case: what it was learned from.
        held: the recordings that were held out from the comparison.
        errors: held-out errors by horizon, by candidate.
        predictor: the arm as it was calibrated by its shapes, behind its servos: it predicts from states and commands,
            but is no model for MPC; None without shapes.
        calibration: how form and numbers of that arm were chosen; None where the drawing explained the shapes.
    """

    estimator: Any
    rivals: tuple[tuple[str, Any], ...]
    case: Case
    held: Episodes
    errors: dict[str, HorizonErrors]
    _report: Report
    predictor: ArmPredictor | None = None
    calibration: CalibrationChoice | None = None

    @property
    def lifted(self) -> LiftedModel:
        """The model, z+ = A z + B phi(u) (+ sum_i u_i N_i z), y = C z; its provenance holds the report."""
        model: LiftedModel = self.estimator.lifted
        told = {"report": self._report.as_dict(), "recorded": recorded(self.case.d1)}
        return replace(model, provenance={**model.provenance, **told})

    def report(self) -> Report:
        """What was tried, errors to expect, what the model is not fit for, what would help, and the code; print it."""
        return self._report

    def __str__(self) -> str:
        return str(self._report)

    def score(self, episodes: Episodes, states: Any = None) -> Any:
        """Errors of open-loop roll-outs of test ``episodes`` (:func:`pisplit.rollout_errors`).

        ``states``: output group, names or indices; those by which models were compared if not given.
        """
        return rollout_errors(self.lifted, episodes, self.case.states if states is None else states)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to the HDF5 file ``path``, with its report: ``pisplit.LiftedModel.load`` reads it."""
        self.lifted.save(path)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Errors by horizon of all candidates, and a held-out recording beside its prediction; written to ``path``."""
        from pisplit.front.pictures import plot_identified

        return plot_identified(self, path)

    def mpc(
        self,
        u_max: ArrayLike | None = None,
        du_max: ArrayLike | None = None,
        u_min: ArrayLike | None = None,
        **settings: Any,
    ) -> Control:
        """A model predictive controller; what is not given is chosen by loops on the models (``Control.of``).

        u_max, u_min   limits of the inputs, numbers or (m,), in their unit; those of the recordings if not given, but
                       ``u_min`` mirrors a given ``u_max`` at rest
        du_max         largest change per step, a number or (m,); that of the recordings if not given
        settings       of :class:`pisplit.controllers.MPC`, such as horizon, track or rate_weight; ``force=True`` tries
                       models whose error of held-out recordings over the horizon is above 0.4 times their spread
        """
        from pisplit.front.control import Control

        return Control.of(self, u_max, du_max, u_min, settings)


@one_blas_thread()
def identify(
    d1: Episodes,
    arm: Arm | None = None,
    shapes: RestShapes | None = None,
    states: str | Sequence[int] | Sequence[str] | None = None,
    candidates: Sequence[str] | None = None,
    progress: bool = True,
    capture: MotionCapture | None = None,
    calibrate: str = CALIBRATE[0],
    disks: Sequence[int | Sequence[float] | None] | None = None,
) -> Identified:
    """Try every model that the data allow and keep the one that rolls held-out recordings out best.

    About a quarter of the recordings is held out from the comparison (a single recording is cut into five pieces); the
    winner is then fitted to all of them. A model that diverges or leaves three times the recorded range is taken only
    where there is no other.

    Args:
        d1: recordings.
        arm: the arm as drawn, if it is one: its statics and dynamics become known physics.
        shapes: shapes at rest, by which the drawing is calibrated (``arm.rest_shapes`` of a simulated arm). Without
            them a twin is used only where ``arm`` itself, as simulated, made the recordings.
        states: outputs by which models are compared: an output group, names or positions; "shape" or "tip" where the
            data have such a group, else all states.
        candidates: names of those to try; all that the data allow if not given.
        progress: whether to show a bar.
        capture: markers, where positions of a few points are all that was recorded: all fields are found from these by
            the equations of the ``arm``, which is calibrated already (``calibrate_from_markers``); models and errors
            are then those of all fields, in the axes of the arm's base.
        calibrate: "auto" calibrates the drawing by its shapes in seconds and, where they or the recordings say that it
            is not that arm, looks for form of the tendons, friction, servos and loads by held-out roll-outs: some two
            minutes of CPU a form with disks, with a bar. "choose" does that always, "shapes" never.
        disks: forms of the tendons to choose from then, the simplest first: None along the backbone, or their number
            (count them: the twin of a robot with ten is not that of one with eight). (None, 8) if not given, and the
            disks of the drawing where it has some.

    Raises ValueError, in one line, for too little data, inputs that never change, and where all candidates diverge.
    """
    _check(d1, arm, shapes)
    one_of(calibrate, "calibrate", CALIBRATE)
    if capture is not None:
        d1 = _seen_by_markers(d1, arm, capture)
    group = states if states is not None else next((g for g in GROUPS if g in (d1.outputs or {})), None)
    training, held = _parted(d1)
    case = Case(d1, arm, shapes, group, progress, calibrate, None if disks is None else tuple(disks))
    part = case.on(training)
    tried: list[Tried] = []
    fits: dict[str, Any] = {}
    for candidate in tqdm(_wanted(candidates), desc="identify", unit="model", disable=not progress):
        reason = candidate.missing(part)
        begin = time.process_time()
        estimator, trouble = (None, f"not tried: {reason}") if reason else fitted(candidate, part)
        error = np.inf
        if estimator is not None:
            error, trouble = _held_out_error(estimator, held, group)
            fits[candidate.name] = estimator
        tried.append(Tried(candidate.name, error, trouble, time.process_time() - begin))
    predictor, row = _predictor(part, held, group)
    tried += row
    order = _ranked([t for t in tried if t.name in fits], fits)
    if not order:
        told = "; ".join(f"{t.name}: {t.note}" for t in tried if not t.note.startswith("not tried"))
        raise ValueError(
            f"no candidate predicts the held-out recordings ({told[:300]}); check columns, units and time step, or "
            "record more"
        )
    best = next(c for c in CANDIDATES if c.name == order[0])
    estimator, trouble = fitted(best, case)
    if estimator is None or getattr(estimator, "bounded_", None) is False:
        estimator = fits[best.name]  # the one that was judged
    ahead = [h for h in HORIZONS if h < min(len(u) for u in held.us) - 8] or [1]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        errors = {n: horizon_errors(fits[n], held, ahead, group, max(1, ahead[-1] // 4)) for n in order}
        report = _report(case, part, best, tried, fits, errors, held)
    rivals = tuple((name, fits[name]) for name in order)
    return Identified(estimator, rivals, case, held, errors, report, predictor, case.chosen)


def _predictor(part: Case, held: Episodes, group: Any) -> tuple[ArmPredictor | None, list[Tried]]:
    """The calibrated arm, and its line among what was tried."""
    begin = time.process_time()
    try:
        found = part.predictor()
        if found is None:
            return None, []
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            errors = found.score(held, group if group in found.outputs else None)
    except (ValueError, RuntimeError) as error:
        return None, [Tried(PREDICTOR, np.inf, " ".join(str(error).split()), time.process_time() - begin)]
    note = "predicts, but is no model for MPC: model.predictor"
    if part.chosen is not None:
        note += f"; {part.chosen.tried[part.chosen.chosen].name}"
    lost = int(errors.diverged.sum())
    if lost:
        return found, [Tried(PREDICTOR, np.inf, f"fails on {lost} of {len(held)} held-out recordings", 0.0)]
    return found, [Tried(PREDICTOR, float(np.sqrt(errors.mean)), note, time.process_time() - begin)]


def _seen_by_markers(d1: Episodes, arm: Arm | None, capture: MotionCapture) -> Episodes:
    """All fields of the ``arm``, from the markers of a ``capture``."""
    if arm is None:
        raise ValueError("markers tell fields only with the equations of an arm; give arm=, calibrated, with capture=")
    return fields_from_markers(arm, d1, capture)


def _check(d1: Any, arm: Any, shapes: Any) -> None:
    if not isinstance(d1, Episodes):
        raise ValueError(not_episodes(d1, "d1", "Episodes, such as Episodes.from_csv or arm.record give"))
    for value, kind, name in ((arm, Arm, "arm"), (shapes, RestShapes, "shapes")):
        if value is not None and not isinstance(value, kind):
            raise ValueError(f"{name} is a {type(value).__name__}; expected {kind.__name__}")
    if shapes is not None and arm is None:
        raise ValueError("shapes say nothing without a drawing; give arm=ps.TendonArm(...)")
    steps = sum(map(len, d1.us))
    if steps < FEWEST:
        raise ValueError(f"the recordings have {steps} steps; expected {FEWEST} or more to learn from and to hold out")
    if d1.n_inputs == 0:
        raise ValueError("the recordings have no inputs; nothing can be controlled with their model: name the inputs")
    if d1.input_subspace()[1].shape[1] == 0:
        raise ValueError("the inputs never change in the recordings; record again with inputs that move the system")
    spread = np.ptp(d1.stacked_states(), axis=0)
    if not (spread > 0.0).any():
        raise ValueError("the states never change in the recordings; check the columns, or the power of the motors")


def _wanted(names: Sequence[str] | None) -> list[Candidate]:
    if names is None:
        return list(CANDIDATES)
    known = {c.name: c for c in CANDIDATES}
    unknown = [n for n in names if n not in known]
    if unknown or not names:
        raise ValueError(f"candidates = {list(names)}; expected some of {', '.join(map(repr, known))}")
    return [known[n] for n in names]


def _parted(d1: Episodes) -> tuple[Episodes, Episodes]:
    """Recordings to learn from and recordings to compare on: about a quarter, the last ones."""
    if len(d1) == 1:
        x, u = d1.xs[0], d1.us[0]
        ends = np.linspace(0, len(u), PIECES + 1).astype(int)
        cut = [(x[a : b + 1], u[a:b]) for a, b in pairwise(ends)]
        d1 = replace(d1, xs=[x for x, _ in cut], us=[u for _, u in cut], extra={})
    out = max(1, round(len(d1) / 4))
    return d1[:-out], d1[-out:]


def _held_out_error(estimator: Any, held: Episodes, group: Any) -> tuple[float, str]:
    """Root mean square error of roll-outs, and what is wrong with the model."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = rollout_errors(estimator, held, group)
        except ValueError as error:
            return np.inf, str(error)
    if found.diverged.any():
        return np.inf, f"diverges on {int(found.diverged.sum())} of {len(held)} held-out recordings"
    unbounded = getattr(estimator, "bounded_", None) is False
    return float(np.sqrt(found.mean)), "leaves three times the recorded range" if unbounded else ""


def _ranked(tried: Sequence[Tried], fits: dict[str, Any]) -> list[str]:
    """Names of usable candidates, best first: bounded ones, then by error; simpler ones within a margin go first."""
    usable = [t for t in tried if np.isfinite(t.error)]
    bounded = [t for t in usable if not t.note] or usable
    if not bounded:
        return []
    least = min(t.error for t in bounded)
    first = next(t for t in bounded if t.error <= (1.0 + MARGIN) * least)
    rest = sorted((t for t in bounded if t is not first), key=lambda t: t.error)
    return [first.name, *(t.name for t in rest)]


def _report(
    case: Case,
    part: Case,
    best: Candidate,
    tried: Sequence[Tried],
    fits: dict[str, Any],
    errors: dict[str, HorizonErrors],
    held: Episodes,
) -> Report:
    d1, found = case.d1, errors[best.name]
    tip = list((d1.outputs or {}).get("tip", ()))
    names = [d1.state_names[i] for i in tip] if d1.state_names else []
    rows = []
    at = [found.names.index(n) for n in names] if names and set(names) <= set(found.names) else []
    factor, unit = (1e3, "mm") if at and found.units[at[0]] == "m" else (1.0, found.units[at[0]] if at else "")
    for h, e, rms in zip(found.horizons, found.normalised, found.rms, strict=True):
        rows.append((float(h * d1.dt), float(e), factor * float(np.linalg.norm(rms[at])) if at else None))
    error = {t.name: t.error for t in tried}
    second = next((n for n in errors if n != best.name), None)
    ahead = f"; next {second}, {error[second] / error[best.name]:.2g} times its error" if second else ""
    units = {d1.units[i] for i in _positions(case)} if d1.units else set()
    return Report(
        chosen=best.name,
        reason=f"best roll-outs of {len(held)} held-out recordings{ahead}",
        tried=tuple(tried),
        unit=units.pop() if len(units) == 1 else "",
        horizons=tuple(rows),
        tip=f"tip in {unit}".strip() if at else "",
        data=f"{len(d1)} recordings, {sum(map(len, d1.us))} steps of {d1.dt:g} s, {d1.n_states} states, "
        f"{d1.n_inputs} inputs; compared by {case.states if isinstance(case.states, str) else 'states'}",
        unfit=unfit(case, fits[best.name], found),
        helps=helps(case, tried, best.name, found, _gain(part, best, held, error[best.name])),
        code=by_hand(case, best),
        predicted=_predicted(fits[best.name], held, case.states, found.horizons),
    )


def _predicted(estimator: Any, held: Episodes, states: Any, horizons: Any) -> str:
    """Root of the median predicted squared error under commands that were not recorded, some horizons ahead."""
    found = predicted_error(estimator, held, states=states)
    ahead = [int(h) for h in horizons if h <= len(found.by_horizon)]
    unit = f" {found.unit.removesuffix('^2')}" if found.unit else ""
    values = [(h * held.dt, float(np.sqrt(found.by_horizon[h - 1]))) for h in ahead]
    told = [f"{e:.2g}{unit} after {t:.3g} s" if np.isfinite(e) else f"lost after {t:.3g} s" for t, e in values]
    return f"under commands that were not recorded: {', '.join(told)} (residuals of held-out pairs, fed back)"


def _positions(case: Case) -> list[int]:
    if isinstance(case.states, str) and case.states in (case.d1.outputs or {}):
        return list((case.d1.outputs or {})[case.states])
    return list(range(case.d1.n_states))


def _gain(part: Case, best: Candidate, held: Episodes, error: float) -> float | None:
    """How many times worse the best candidate is with half of the recordings that it was compared with."""
    if len(part.d1) < 2 or not error > 0.0:
        return None
    half, _ = fitted(best, part.on(part.d1[: len(part.d1) // 2]))
    if half is None:
        return None
    worse = _held_out_error(half, held, part.states)[0]
    return float(worse / error) if np.isfinite(worse) else float("inf")
