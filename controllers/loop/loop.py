"""A controller closed on a plant."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from pisplit.checks import Array, count, positive
from pisplit.controllers.loop.following import Callback, Follower, LoopStep
from pisplit.controllers.loop.log import INTERRUPTED, LoopLog
from pisplit.controllers.loop.pacing import Pace
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.loop.recorder import Recorder
from pisplit.controllers.loop.reidentify import Identifier, NewModel, changed
from pisplit.controllers.loop.swinging import swinging
from pisplit.controllers.loop.tracking import Controller, Move, start_input
from pisplit.controllers.loop.wiring import wire
from pisplit.controllers.references import Reference
from pisplit.lifted.rollout import DIVERGENCE_FACTOR

#: The run that last used a plant or a controller: another loop must not go on with what it left.
_LAST: WeakKeyDictionary[Any, object] = WeakKeyDictionary()
FAR = 3.0  # times the training range beyond which a reference is taken for one in another unit
#: Parts of the recorded range by which a reference may leave it before that is said.
ROOM = 0.1


@dataclass(frozen=True, eq=False)
class LoopState:
    """A loop between two steps: what plant and controller gave as their snapshots, and the record of the run."""

    plant: Any
    controller: Any
    record: Recorder


class ClosedLoop:
    """A ``plant`` and a ``controller`` that fit: sizes, time step, and the names and units that the plant tells.

    States and inputs are matched by name where plant and model have names, so that their order does not matter; the log
    has the order of the model. Raises ValueError, in one line, where they do not fit.
    """

    def __init__(self, plant: Plant, controller: Controller) -> None:
        self._wiring = wire(plant, controller.model)
        self.plant = plant
        self.controller = controller
        self._record: Recorder | None = None
        self._turn = object()

    @property
    def log(self) -> LoopLog:
        """What was run so far, during a run and after it, however it ended. Raises ValueError before the first run."""
        return self._recorded().log(float(self.plant.dt), self.controller, self._wiring)

    def run(
        self,
        reference: Reference,
        steps: int,
        u0: ArrayLike | None = None,
        progress: bool = True,
        log_file: str | os.PathLike[str] | None = None,
        callbacks: Sequence[Callback] = (),
        realtime: bool = False,
    ) -> LoopLog:
        """Run ``steps`` steps from rest under ``u0`` (m,), zeros if not given, along the ``reference``.

        The reference has the coordinates of the whole tracked group in its own order, or those of the tracked axes.
        A plant that fails, leaves 1e3 times the range of the training data or measures infinities ends the run; so do
        an exception in plant or controller and a keyboard interrupt: the log of what was run is returned, and its
        ``message`` says why (``log`` has it too). NaN is taken for not measured: the controller bridges it, counted in
        the log. A loop that swings between its rate limits is warned of, once. Raises ValueError if reference and
        controller do not fit. ``progress``: show a bar. A reference beyond
        three times the range of the training data is warned of, and where the model knows what was recorded (that of
        ``pisplit.identify`` does), one that leaves it by a tenth.

        ``log_file``: HDF5 file to which the log is written about once a second while it runs, and whole at the end;
        after a kill ``LoopLog.load`` reads what was flushed. A disk that is full ends no run, and is noted.
        ``realtime``: run by the clock, a step every dt: the loop sleeps until the next measurement is due, ``jitter``
        of the log tells how late it was, and ``overruns`` counts those later than a tenth of a step (the clock goes on
        from there). A plant with ``send(u)`` and ``measure()`` is commanded at the beginning and measured at the end of
        a step; one with ``step`` alone must wait itself for its next sample, or be a simulation.
        ``callbacks``: functions that are told every step (a :class:`LoopStep`) after it; a text that one returns ends
        the run, and so does an exception: both stand in ``message``; a Warning that one returns is noted.
        """
        N = count(steps, "steps")
        plant, controller = self.plant, self.controller
        if controller.track and reference.track != controller.track:
            raise ValueError(f"the reference is for {reference.track!r}, the controller tracks {controller.track!r}")
        start = start_input(u0, controller.u_min, controller.u_max)
        controller.reset(start)
        x0 = self._wiring.measured(plant.reset(self._wiring.applied(start)))
        self._take_turn()
        problem = _fault(x0, controller)
        if not problem and np.isnan(x0).any() and not getattr(controller, "estimates", False):
            problem = f"measured {np.count_nonzero(np.isnan(x0))} states that are NaN"
        if problem:
            raise ValueError(f"the plant at rest {problem}; check the model's units and the plant")
        bound = _bound(reference, controller, x0)
        self._record = Recorder(bound, np.zeros((0, len(controller.tracked))), start, [x0])
        self._record.notes += getattr(controller, "notes", ())
        self._look_ahead(N)
        self._warn_if_far()
        return self._go_on(N, progress, realtime, log_file, callbacks)

    def reidentify(self, identify: Identifier, seconds: float = 60.0) -> NewModel:
        """Identify the system again from the last ``seconds`` of the log, and go on with the new model.

        ``identify``: takes a :class:`LoopLog` and gives a :class:`NewModel`, as
        :class:`pisplit.front.ArmIdentifier` does for tendon arms. The controller is replaced by the same one on the new
        model, with the history of the run, so that ``resume`` goes on and ``run`` begins anew; what was identified is
        noted in the log. Where identification raises, the loop stays as it was.

        Raises ValueError without a run, after one that ended amid a step, for a controller without ``with_model``, and
        for a model of other states and inputs.
        """
        record, dt = self._recorded(), float(self.plant.dt)
        if record.message:
            raise ValueError(f"the run ended amid a step ({record.message}); run anew, then reidentify")
        first = max(0, len(record.u) - count(round(positive(seconds, "seconds", "s") / dt), "seconds / dt"))
        log = record.log(dt, self.controller, self._wiring, first)
        new = identify(log)
        controller = changed(self.controller, new, log)
        self._wiring, self.controller = wire(self.plant, controller.model), controller
        record.notes += [f"t = {log.t[-1]:.2f} s: {note}" for note in new.notes]
        self._take_turn()
        return new

    def resume(
        self,
        steps: int,
        progress: bool = True,
        log_file: str | os.PathLike[str] | None = None,
        callbacks: Sequence[Callback] = (),
        realtime: bool = False,
    ) -> LoopLog:
        """Go on for another ``steps`` steps after a run that ended by itself, or after ``restore``; the whole log.

        The same, to the last bit, as one longer run. ``progress``, ``log_file``, ``callbacks`` and ``realtime`` as in
        ``run``. Raises ValueError without a run, after one that was stopped, amid a step, and after plant or controller
        were used in another loop.
        """
        N, record = count(steps, "steps"), self._recorded()
        if record.message:
            raise ValueError(f"the run ended amid a step ({record.message}); restore a snapshot or start anew")
        for part in (self.plant, self.controller):
            if isinstance(part, Hashable) and _LAST.get(part, self._turn) is not self._turn:
                raise ValueError(
                    f"{type(part).__name__} was used in another loop since; take snapshots, and restore one to go on"
                )
        self._look_ahead(N)
        return self._go_on(N, progress, realtime, log_file, callbacks)

    def snapshot(self) -> LoopState:
        """Plant, controller and log between two steps: picklable if plant and reference are; for ``restore``.

        Raises ValueError without a run, after one that was stopped, and for a plant or controller without the methods
        ``snapshot()`` and ``restore(snapshot)``.
        """
        record = self._recorded()
        if record.message:
            raise ValueError(
                f"the run ended amid a step ({record.message}); take snapshots of runs that end by themselves"
            )
        return LoopState(_able(self.plant).snapshot(), _able(self.controller).snapshot(), record.copy())

    def restore(self, state: LoopState) -> None:
        """Put plant and controller into the ``state`` of a ``snapshot``; ``resume`` goes on from there.

        Raises ValueError for a plant or controller without ``restore``, or of other sizes.
        """
        plant, controller = _able(self.plant), _able(self.controller)
        controller.restore(state.controller)
        plant.restore(state.plant)
        self._record = state.record.copy()
        self._take_turn()

    def _take_turn(self) -> None:
        self._turn = object()
        for part in (self.plant, self.controller):
            with suppress(TypeError):  # what cannot be hashed is not watched
                _LAST[part] = self._turn

    def _recorded(self) -> Recorder:
        if self._record is None:
            raise ValueError("nothing was run yet; call run(reference, steps)")
        return self._record

    def _look_ahead(self, steps: int) -> None:
        """Samples of the reference for ``steps`` more steps and the horizon after them; those known stay."""
        record, controller = self._recorded(), self.controller
        total = len(record.u) + steps + controller.horizon + 1
        t = float(self.plant.dt) * np.arange(len(record.wanted), total, dtype=np.float64)
        wanted = record.reference(t)
        if record.reference.width == len(controller.group):
            wanted = wanted[:, list(controller.axes)]
        record.wanted = np.vstack([record.wanted, wanted])

    def _go_on(
        self,
        steps: int,
        progress: bool,
        realtime: bool,
        log_file: str | os.PathLike[str] | None,
        callbacks: Sequence[Callback],
    ) -> LoopLog:
        record, dt = self._recorded(), float(self.plant.dt)
        follower = Follower(callbacks, log_file, lambda first: record.log(dt, self.controller, self._wiring, first))
        pace = Pace(dt) if realtime else None
        first = len(record.u)
        where, k = "the controller", first
        try:
            for k in tqdm(range(first, first + steps), disable=not progress, desc="closed loop", unit="step"):
                where = "the controller"
                window = record.wanted[k + 1 : k + 1 + self.controller.horizon].copy()
                move = self.controller.step(record.x[-1].copy(), window)
                u = np.array(move.u, dtype=np.float64)
                where = "the plant"
                after, spent, late = self._advanced(u, pace)
                if not (hasattr(after, "ok") and hasattr(after, "state")):
                    raise TypeError(f"step() returned {type(after).__name__}; expected PlantStep(state)")
                if not after.ok:
                    problem = f"failed: {after.message or 'no reason given'}"
                else:
                    state = self._wiring.measured(after.state)
                    problem = _fault(state, self.controller)
                self._name_stuck(move, k * dt)
                if getattr(move, "warning", ""):
                    record.notes.append(f"t = {k * dt:.2f} s: {move.warning}")
                    warnings.warn(record.notes[-1], stacklevel=3)
                if problem:  # the input that broke the plant belongs to no completed step
                    record.message = _at(k, first + steps, dt) + f"the plant {problem}"
                    break
                record.add(move, u, spent, late, state, self.controller)
                if note := swinging(record, self.controller, dt):
                    record.notes.append(note)
                    warnings.warn(note, stacklevel=3)
                follower.write_if_due()
                where = "a callback"
                step = LoopStep(k, (k + 1) * dt, state.copy(), record.wanted[k + 1].copy(), u.copy(), move)
                end = follower.tell(step)
                record.notes += follower.warned
                follower.warned.clear()
                if end:
                    record.message = _at(k, first + steps, dt) + f"ended by a callback: {end}"
                    break
        except KeyboardInterrupt:
            record.message = _at(k, first + steps, dt) + INTERRUPTED
        except Exception as error:
            reason = " ".join(str(error).split())
            record.message = _at(k, first + steps, dt) + f"{where} raised {type(error).__name__}: {reason}"
            warnings.warn(record.message, stacklevel=3)
        except BaseException as error:  # the end of the program: kept in ``log``, not swallowed
            record.message = _at(k, first + steps, dt) + f"{where} raised {type(error).__name__}"
            raise
        finally:
            follower.finish()
            if follower.fault:
                record.notes.append(follower.fault)
        return self.log

    def _advanced(self, u: Array, pace: Pace | None) -> tuple[Any, float, float]:
        """The plant's answer to the input u (m,), the time it took and how late it came [s], NaN without a clock."""
        plant: Any = self.plant
        apart = pace is not None and hasattr(plant, "send") and hasattr(plant, "measure")
        begin = time.perf_counter()
        after = (plant.send if apart else plant.step)(self._wiring.applied(u))
        spent = time.perf_counter() - begin
        late = np.nan if pace is None else pace.wait()
        if apart:
            begin = time.perf_counter()
            after = plant.measure()
            spent += time.perf_counter() - begin
        return after, spent, late

    def _name_stuck(self, move: Move, t: float) -> None:
        """A note on sensors that the controller found stuck for the first time."""
        record = self._recorded()
        new = [i for i in move.stuck if i not in record.stuck]
        if new:
            record.stuck.update(new)
            names = [self.controller.model.state_names[i] for i in new]
            more = f" and {len(names) - 6} more" if len(names) > 6 else ""
            note = (
                f"stuck sensors at t = {t:.2f} s: {', '.join(names[:6])}{more} repeated one value while the inputs "
                "moved; taken as not measured until they change"
            )
            record.notes.append(note)
            warnings.warn(note, stacklevel=4)

    def _warn_if_far(self) -> None:
        """A reference far outside the training data is probably in another unit."""
        record, controller = self._recorded(), self.controller
        model, tracked = controller.model, list(controller.tracked)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # an output that is free throughout
            reach = np.nanmax(np.abs(record.wanted), axis=0)
        left = _left(record.wanted, model, tracked, self._wiring.states.units)
        if left and not (reach > FAR * model.state_range[tracked]).any():
            record.notes.append(left)
            warnings.warn(left, stacklevel=3)
        for i, size, known in zip(tracked, reach, model.state_range[tracked], strict=True):
            if size > FAR * known:
                unit = f" {self._wiring.states.units[i]}".rstrip()
                note = (
                    f"the reference reaches {size:.3g} for {model.state_names[i]}, {size / known:.3g} times the range "
                    f"of the training data ({known:.3g}{unit}): is it in another unit, or out of reach?"
                )
                record.notes.append(note)
                warnings.warn(note, stacklevel=3)


def _left(wanted: Array, model: Any, tracked: list[int], units: Sequence[str]) -> str:
    """Which outputs ``wanted`` (T, p) leave the recordings of the model, in words; nothing where it does not know."""
    found = model.provenance.get("recorded") if hasattr(model, "provenance") else None
    if not found:
        return ""
    parts = []
    for column, i in enumerate(tracked):
        low, high = found["states"][0][i], found["states"][1][i]
        asked = wanted[:, column][~np.isnan(wanted[:, column])]
        room = ROOM * (high - low)
        if len(asked) and (asked.min() < low - room or asked.max() > high + room):
            unit = f" {units[i]}".rstrip()
            span = f"{asked.min():.3g} .. {asked.max():.3g}"
            parts.append(f"{model.state_names[i]} is to go {span}{unit}, recorded {low:.3g} .. {high:.3g}{unit}")
    return (
        f"the reference leaves what was recorded, where the model is a guess: {'; '.join(parts)}; a smaller path, or "
        "recordings that go there, are safer"
        if parts
        else ""
    )


def _at(k: int, steps: int, dt: float) -> str:
    return f"step {k + 1} of {steps} (t = {(k + 1) * dt:.3f} s): "


def _able(part: Any) -> Any:
    """A plant or controller, which must be able to tell and take its state."""
    if not (hasattr(part, "snapshot") and hasattr(part, "restore")):
        raise ValueError(
            f"{type(part).__name__} has no snapshot() and restore(snapshot), which tell and set its state; give it both"
        )
    return part


def _fault(x: Array, controller: Controller) -> str:
    """What is wrong with a measured state, or an empty text."""
    if np.isinf(x).any():
        return f"measured {np.count_nonzero(np.isinf(x))} states that are infinite"
    tracked = list(controller.tracked)
    y, reach = np.abs(x[tracked]), DIVERGENCE_FACTOR * controller.model.state_range[tracked]
    if (y > reach).any():  # False where nothing was measured
        i = int(np.nanargmax(y / reach))
        return f"diverged: {controller.model.state_names[tracked[i]]} = {y[i]:.3g} left 1e3 times the training range"
    return ""


def _bound(reference: Reference, controller: Controller, x0: Array) -> Reference:
    """The reference from the measured start, for the whole group or for the tracked outputs."""
    for states in (controller.group, controller.tracked):
        if reference.width == len(states):
            return reference.starting_at(x0[list(states)])
    raise ValueError(
        f"the reference has {reference.width} coordinates, the controller tracks {len(controller.tracked)} outputs"
    )
