"""A controller for an identified model whose weight is chosen by closed loops on the models themselves."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import Array, finite_array
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, LoopLog, references
from pisplit.controllers.loop.tracking import tracked_states
from pisplit.controllers.mpc.carried import check_carried
from pisplit.controllers.plants import ModelPlant
from pisplit.front.doubted import DoubtedPlant
from pisplit.front.reach import beyond, limits
from pisplit.models.arm import Arm
from pisplit.threads import one_blas_thread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.front.identification import Identified
    from pisplit.lifted.model import LiftedModel

#: Weights of the input rate, the cautious one first: one that is worse already is not tried any further. Where the
#: least of them is the best, it goes on by this factor as long as that helps, down to this weight.
RATE_WEIGHTS = (0.1, 0.02, 1.0)
LESS, LEAST = 0.2, 1e-6
#: Times the least error of held-out recordings up to which the second best model stands in for the system.
AHEAD = 3.0
#: Steps of a trial that follow the reference, and those at its end in which it has to come to rest.
MOVING, RESTING = 70, 30
HORIZON = 20
#: Error of the trials, in parts of the range of the outputs, from which on the controller says that it is poor.
POOR = 0.2
#: Noise of a state, in parts of its spread, from which on measurements are filtered.
NOISY = 0.003
#: Times by which recorded motion is slowed down to make a reference that can be followed.
SLOWER = 2


@dataclass(frozen=True, eq=False)
class Control:
    """A model predictive controller and where it starts from.

    Attributes:
        controller: the controller; use it with any :class:`pisplit.controllers.ClosedLoop`.
        rest: inputs (m,) at rest, where runs start.
        stations: number of stations of the model's rod fields, for the simulator of an arm.
        trials: (rate weight, error) of the loops on the models by which the weight was chosen; empty where it was
            given. The error is in parts of the range of the tracked outputs; infinite where a loop was lost.
        notes: what was chosen, in words.
    """

    controller: MPC
    rest: Array
    stations: int
    trials: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]

    @classmethod
    @one_blas_thread()
    def of(
        cls,
        found: Identified,
        u_max: ArrayLike | None,
        du_max: ArrayLike | None,
        u_min: ArrayLike | None,
        settings: Mapping[str, Any],
    ) -> Control:
        """The controller of an identification ``found``; what ``settings`` of :class:`MPC` leave open is chosen.

        The rate weight is the one whose loops go best when the plant is another model: each of the two best candidates,
        fitted without the held-out recordings; the best alone, off at every step by what it misses of them
        (``DoubtedPlant``), where it is far ahead. Their reference is a held-out recording at half its speed that ends
        at rest. Limits ``u_max``, ``u_min`` and ``du_max`` as in :class:`MPC`, those of the recordings where they are
        not given; limits far outside these are warned of.

        A model whose predictions of the held-out recordings are off by more than 0.4 times the spread of the tracked
        outputs at the end of the horizon is refused; with ``force`` among the settings it is warned of.

        Raises ValueError where limits or settings do not fit, for such a model, and where it cannot hold any of those
        loops.
        """
        model, rest = found.lifted, found.case.rest
        low, high, change = limits(found.case.d1, rest, u_max, u_min, du_max)
        given = {"horizon": HORIZON, "u_min": low, "u_max": high, "du_max": change, **settings}
        if "track" not in given:
            given["track"] = "tip" if "tip" in model.outputs else [model.state_names[0]]
        force = bool(given.pop("force", False))
        shown = given.pop("recordings", found.held)
        estimator = found.rivals[0][1] if found.rivals and "recordings" not in settings else model
        rows = tracked_states(model, given["track"], given.get("axes")).states
        doubt = check_carried(estimator, shown, given["horizon"], rows, force)
        seen = {} if "observer" in given else _filtered(found, model)
        given |= seen
        notes = [
            f"limits {_text(low)} .. {_text(high)}, {_text(np.asarray(change))} a step",
            f"horizon {given['horizon']}",
            *([doubt] if doubt else []),
            *(["Kalman filter, told the noise of the recordings"] if seen else []),
        ]
        if far := beyond(found.case.d1, rest, low, high):
            notes.append(far)
            warnings.warn(far, stacklevel=3)
        trials: list[tuple[float, float]] = []
        if "rate_weight" in given:
            controller = MPC(model, **given)
        else:
            controller, trials, on = _chosen(found, model, given)
            notes.append(f"rate weight {trials[0][0]:g}, chosen by loops on {on}")
            if trials[0][1] > POOR:
                told = (
                    f"the best loop on the identified models misses its reference by {trials[0][1]:.2g} of the "
                    "range of the data: expect no better of the system; see model.report() for what would help"
                )
                notes.append(told)
                warnings.warn(told, stacklevel=3)
        return cls(controller, rest, found.case.stations, tuple(trials), tuple(notes))

    def run(
        self,
        plant: Any,
        reference: references.Reference,
        steps: int,
        u0: ArrayLike | None = None,
        progress: bool = True,
    ) -> LoopLog:
        """Close the loop on a ``plant`` for so many ``steps`` along the ``reference``; the log of the run.

        The page of the log shows tendons of an arm coloured by tension, and as a ghost what the model predicted a
        horizon before.
        ``plant``: an arm, which is simulated, or any :class:`pisplit.controllers.Plant`. ``u0``: inputs (m,) at the
        start; those at rest if not given. ``progress``: whether to show a bar.
        """
        arm = plant if isinstance(plant, Arm) else None
        if arm is not None:
            plant = arm.scene.fast_stepper(dt=self.controller.model.dt, stations=self.stations)
        start = np.clip(self.rest, self.controller.u_min, self.controller.u_max) if u0 is None else u0
        loop = ClosedLoop(plant=plant, controller=self.controller)
        log = loop.run(_named(reference, self.controller), steps, u0=start, progress=progress)
        with suppress(ValueError):  # the states are not all fields of a rod: the page shows what there is
            log = log if arm is None else log.drawn(arm)
        return log.beside(self.controller.model, self.controller.horizon) if len(log.u) else log

    def __str__(self) -> str:
        lines = [*self.notes, *(f"  rate weight {w:g}: error {e:.3g} of the range" for w, e in self.trials)]
        return "\n".join(lines)

    __repr__ = __str__

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Errors of the trials by rate weight; written to ``path`` where one is given. ValueError without trials."""
        from pisplit.front.pictures import plot_control

        return plot_control(self, path)


def _named(reference: references.Reference, controller: MPC) -> references.Reference:
    """The reference under the controller's name of its outputs where it says "tip" by default and there is none."""
    from dataclasses import replace

    if not controller.track and reference.track == "tip":
        return replace(reference, track="")
    return reference


def _chosen(found: Identified, model: LiftedModel, given: dict[str, Any]) -> tuple[MPC, list[tuple[float, float]], str]:
    """The controller with the rate weight whose worst loop is best, all trials, best first, and what they were on."""
    plants = _plants(found, MPC(model, rate_weight=RATE_WEIGHTS[0], **given), "observer" in given)
    trials: list[tuple[float, float]] = []
    best, least, weights = None, np.inf, list(RATE_WEIGHTS)
    for weight in tqdm(weights, desc="rate weights", unit="weight", disable=not found.case.progress):
        controller = MPC(model, rate_weight=weight, **given)
        worst = 0.0
        for plant, path, steps in plants:
            worst = max(worst, _trial(controller, plant, found, path, steps))
            if worst > least:
                break
        trials.append((weight, worst))
        if worst < least:
            best, least = controller, worst
        smaller = LESS * min(weights)
        if len(trials) == len(weights) and min(trials, key=lambda t: t[1])[0] == min(weights) and smaller >= LEAST:
            weights.append(smaller)
    if best is None:
        raise ValueError(
            "no rate weight holds a loop on the identified models themselves: widen u_max or du_max, track other "
            "outputs, or give more recordings"
        )
    alone = isinstance(plants[0][0], DoubtedPlant)
    on = "the best model and what it misses of held-out recordings" if alone else f"{len(plants)} models"
    return best, sorted(trials, key=lambda t: t[1]), on


def _plants(found: Identified, cautious: MPC, noisy: bool) -> list[tuple[ModelPlant, Array, int]]:
    """Stand-ins of the system, the outputs along which trials go on them, and their steps.

    They are the two best candidates, and a held-out recording at half its speed. Where the second is much worse than
    the first, what it does would be its own errors: it is the first alone then, off by what it misses of the held-out
    recordings, and goes where a ``cautious`` controller took it. Not where recordings are ``noisy``: averages of what
    is missed know nothing of that.
    """
    x, errors = found.held.xs[0][0], {t.name: t.error for t in found.report().tried}
    path, (best, *others) = _slowed(found, cautious), found.rivals[:2]
    if noisy or any(errors[name] <= AHEAD * errors[best[0]] for name, _ in others):
        return [(ModelPlant(estimator.lifted, x), path, len(path) + RESTING) for _, estimator in found.rivals[:2]]
    plant = DoubtedPlant(best[1].lifted, x, found.held)
    log = _loop(cautious, plant, found, path, len(path) + RESTING)
    return [(plant, path if log.stopped else log.y, len(path) + RESTING)]


def _slowed(found: Identified, controller: MPC) -> Array:
    """Tracked outputs (T, p) of a held-out recording at half its speed, and then at rest."""
    recorded = found.held.xs[0][: MOVING // SLOWER + 1, list(controller.tracked)]
    fine = np.arange(0.0, len(recorded) - 1 + 1e-9, 1.0 / SLOWER)
    return np.stack([np.interp(fine, np.arange(len(recorded)), c) for c in recorded.T], axis=1)


def _trial(controller: MPC, plant: ModelPlant, found: Identified, path: Array, steps: int) -> float:
    """Error of a loop on a stand-in of the system, in parts of the range of the outputs: while it moves, and where it
    should rest."""
    log = _loop(controller, plant, found, path, steps)
    if log.stopped:
        return float("inf")
    scale = found.lifted.state_range[list(controller.tracked)]
    missed = np.linalg.norm((log.y - log.reference) / scale, axis=1)
    restless = np.linalg.norm(np.diff(log.y[-RESTING // 2 :], axis=0) / scale, axis=1)
    return float(np.sqrt(np.mean(missed[5:] ** 2)) + restless.mean())


def _loop(controller: MPC, plant: ModelPlant, found: Identified, y: Array, steps: int) -> LoopLog:
    """A loop along outputs ``y`` (T, p), at rest behind their end."""
    start = np.clip(found.held.us[0][0], controller.u_min, controller.u_max)
    reference = references.from_array(y, plant.dt, track=controller.track)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return ClosedLoop(plant, controller).run(reference, steps, u0=start, progress=False)


def _filtered(found: Identified, model: LiftedModel) -> dict[str, Any]:
    """A filter as ``observer`` of the ``model`` where the recordings have noise to speak of, else nothing."""
    d1, std = found.case.d1, found.case.noise
    if not (std > NOISY * d1.stacked_states().std(axis=0)).any():
        return {}
    with suppress(ValueError, RuntimeError, np.linalg.LinAlgError):
        return {"observer": KalmanFilter.from_data(model, d1, std)}
    return {}


def _text(values: Array) -> str:
    numbers = finite_array(np.atleast_1d(values), "limits", (None,))
    return f"{numbers[0]:.3g}" if np.ptp(numbers) < 1e-12 else "(" + ", ".join(f"{v:.3g}" for v in numbers) + ")"
