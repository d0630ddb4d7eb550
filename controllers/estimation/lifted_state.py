"""The lifted state behind the measurements of a controller: gaps bridged, stuck sensors and outliers left out."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array
from pisplit.controllers.estimation.disturbance import DisturbanceEstimator, EstimatorState
from pisplit.controllers.estimation.kalman import KalmanFilter
from pisplit.controllers.estimation.stuck import StuckSensors, StuckState
from pisplit.controllers.loop.history import History
from pisplit.lifted.model import LiftedModel

#: Steps in a row in which an entry of the measurement may be rejected; then the model is wrong, and not the sensor.
PATIENCE = 12
#: So many times the repeats after which a reading is stuck are the steps that can be taken in anew.
MEMORY = 3


@dataclass(frozen=True, eq=False)
class Past:
    """What a step began with: ``history``, ``disturbance``, ``readout``, ``doubts`` and ``level`` as in
    :class:`EstimationState`, what was ``measured`` (n,), and the input ``acting`` (m,) after it."""

    history: History
    disturbance: EstimatorState
    readout: Array | None
    doubts: NDArray[np.int64]
    level: float
    measured: Array
    acting: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class EstimationState:
    """An estimation between two steps.

    ``history`` of delays, state of the ``disturbance`` estimator; ``readout`` (n,), what the read-out missed of the
    last measurement, None before it; steps ``blind`` since anything was measured; ``doubts`` (p,), steps for which the
    observer rejected each of its entries; ``level``, size of its innovations of late over what it expects; ``stuck``,
    what is known of sensors that repeat themselves, and the ``past`` steps that are forgotten where they do.
    """

    history: History
    disturbance: EstimatorState
    readout: Array | None
    blind: int
    doubts: NDArray[np.int64]
    level: float
    stuck: StuckState | None
    past: tuple[Past, ...]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a measurement tells: the lifted state ``z`` (M,), None where nothing is known yet, the disturbance ``w``
    (M,) of it, entries ``missing`` and ``rejected``, states that are ``stuck``, and the ``past`` that it began with."""

    z: Array | None
    w: Array
    missing: int
    rejected: int
    stuck: tuple[int, ...]
    past: Past | None


class LiftedStateEstimation:
    """Lifted state and disturbance of a ``model`` from its measured states, step by step.

    Args:
        model: the model.
        observer: a filter of it; without one the lifted state is that of the measurement.
        gain: of the disturbance estimate.
        stuck_after: repeats after which a reading counts as stuck, None trusts all.
        amplitude: half box widths (m,) of the inputs.
    """

    def __init__(
        self,
        model: LiftedModel,
        observer: KalmanFilter | None,
        gain: float,
        stuck_after: int | None,
        amplitude: Array,
    ) -> None:
        self.model, self.observer = model, observer
        self._disturbance = DisturbanceEstimator(model.A, model.B, model.c, gain)
        self._stuck = None if stuck_after is None else StuckSensors(stuck_after, model.state_range, amplitude)
        self._linear = model.linear_in_u
        self._past: deque[Past]
        self.readout: Array | None
        self.reset(np.zeros(model.n_inputs))

    @property
    def disturbance(self) -> Array:
        """The disturbance (M,) estimated now."""
        return self._disturbance.disturbance

    @property
    def gain(self) -> float:
        """Of the disturbance estimate."""
        return self._disturbance.gain

    @property
    def watches(self) -> bool:
        """Whether readings that repeat themselves are looked for."""
        return self._stuck is not None

    def reset(self, u0: Array) -> None:
        """Forget everything; the arm rests under ``u0`` (m,)."""
        self._history = History(self.model.n_delays, self.model.n_states, u0)
        self._disturbance.reset()
        self.readout = None
        self.blind = 0
        if self._stuck is not None:
            self._stuck.reset()
        self._past = deque(maxlen=0 if self._stuck is None else MEMORY * self._stuck.steps)
        self.level = 1.0
        self._doubts = np.zeros(0 if self.observer is None else len(self.observer.measured), dtype=np.int64)

    def remember(self, states: Array, inputs: Array) -> None:
        """Take in the ``states`` (T, n) and the ``inputs`` (T, m) after them of a run, as far as delays reach.

        Where a state was not measured lately, only what came after it is taken in.
        """
        D = self.model.n_delays
        states, inputs = states[max(0, len(states) - D) :], inputs[max(0, len(inputs) - D) :]
        gaps = np.flatnonzero(np.isnan(states).any(axis=1))
        first = int(gaps[-1]) + 1 if len(gaps) else 0
        for k, (x, u) in enumerate(zip(states, inputs, strict=True)):
            if k >= first:
                self._history.measure(x)
            self._history.apply(u)

    def snapshot(self) -> EstimationState:
        """The state from which ``restore`` goes on."""
        return EstimationState(
            copy.deepcopy(self._history),
            self._disturbance.snapshot(),
            None if self.readout is None else self.readout.copy(),
            self.blind,
            self._doubts.copy(),
            self.level,
            None if self._stuck is None else self._stuck.snapshot(),
            tuple(self._past),
        )

    def restore(self, state: EstimationState) -> None:
        """Go on from a ``state`` of an estimation with the same arguments; raises ValueError for other sizes."""
        if state.history.states.shape != self._history.states.shape:
            raise ValueError("the snapshot is of a controller of another model; restore it where it is from")
        self._disturbance.restore(state.disturbance)
        self._history = copy.deepcopy(state.history)
        self.readout = None if state.readout is None else state.readout.copy()
        self.blind, self._doubts, self.level = state.blind, state.doubts.copy(), state.level
        if self._stuck is not None and state.stuck is not None:
            self._stuck.restore(state.stuck)
            self._past = deque(state.past, self._past.maxlen)

    def measured(self, x: Array, commanded: Array) -> Estimate:
        """What the measurement ``x`` (n,), NaN where there is none, tells after the command ``commanded`` (m,)."""
        x, stuck = self._without_stuck(x, commanded)
        past = None if self._stuck is None else self._kept(x)
        missing = int(np.count_nonzero(np.isnan(x)))
        self.blind = self.blind + 1 if missing == len(x) else 0
        z, rejected = self._observed(x)
        w = self._disturbance.disturbance if z is None else self._disturbance.update(z)
        return Estimate(z, w, missing, rejected, stuck, past)

    def applied(self, found: Estimate, acting: Array) -> None:
        """The input ``acting`` (m,) follows what was ``found``."""
        if found.z is not None:
            self._disturbance.predict(found.z, *self._forcing(found.z, acting))
            if found.past is not None:
                self._past.append(replace(found.past, acting=acting))
        self._history.apply(acting)

    def ahead(self, z: Array, w: Array, inputs: Array) -> Array:
        """The lifted state (M,) after ``z`` (M,) under ``inputs`` (T, m) and the disturbance ``w`` (M,)."""
        for u in inputs:
            z = self._disturbance.following(z, w, *self._forcing(z, u))
        return z

    def _forcing(self, z: Array, u: Array) -> tuple[Array, Array | None]:
        """Features (P,) of the input, and what its products with lifted states add (M,), where the model has some."""
        features = u if self._linear else self.model.features(u[None, :])[0]
        return features, self.model.products(z, u) if self.model.varies else None

    def _without_stuck(self, measured: Array, commanded: Array) -> tuple[Array, tuple[int, ...]]:
        """The measurement (n,), NaN where a reading is stuck, and which those are."""
        watch, z = self._stuck, self._disturbance.predicted
        if watch is None:
            return measured, ()
        model, missed = self.model, self.readout

        def predicted(states: NDArray[np.intp]) -> Array:
            assert z is not None and missed is not None
            return np.asarray(model.C[states] @ z + model.d[states] + missed[states])

        known = z is not None and missed is not None and np.isfinite(z).all()
        before = watch.known
        found = watch(measured, commanded, predicted if known else None)
        if not found.any():
            return measured, ()
        new = found & ~before
        if new.any():
            self._unlearn(new, watch.since(new))
        return np.where(found, np.nan, measured), tuple(np.flatnonzero(found).tolist())

    def _unlearn(self, stuck: NDArray[np.bool_], samples: int) -> None:
        """Take the last ``samples`` in anew, without what the ``stuck`` readings (n,) said: they said nothing."""
        again = list(self._past)[-samples:] if samples else []
        for k, past in enumerate(again):
            if k == 0:
                self._history, self.readout = past.history.copy(), past.readout
                self._doubts, self.level = past.doubts, past.level
                self._disturbance.restore(past.disturbance)
            measured = np.where(stuck, np.nan, past.measured)
            kept = self._kept(measured)
            z, _ = self._observed(measured)
            assert z is not None  # as it was before, or predicted
            self._disturbance.update(z)
            self._disturbance.predict(z, *self._forcing(z, past.acting))
            self._history.apply(past.acting)
            self._past[k - len(again)] = replace(kept, acting=past.acting)

    def _kept(self, measured: Array) -> Past:
        """What this step begins with."""
        w = self._disturbance.snapshot()
        return Past(self._history.copy(), w, self.readout, self._doubts, self.level, measured)

    def _observed(self, measured: Array) -> tuple[Array | None, int]:
        """The lifted state (M,), None where nothing is known yet; how many entries of ``measured`` were rejected."""
        history, observer, predicted = self._history, self.observer, self._disturbance.predicted
        if observer is not None and predicted is not None and np.isfinite(predicted).all():
            innovation = observer.innovation(predicted, measured)
            doubted = observer.doubted(innovation, self.level) & (self._doubts < PATIENCE)
            self.level = observer.level(self.level, innovation)
            self._doubts = np.where(doubted, self._doubts + 1, 0)
            self.readout = np.zeros(self.model.n_states)
            return observer.corrected(predicted, np.where(doubted, np.nan, innovation)), int(doubted.sum())
        x = self._bridged(measured)
        if x is None and observer is not None and self.model.relifted is None:
            z = self.model.fixed_point(history.u_previous)
            self.readout = np.zeros(self.model.n_states)
            return observer.corrected(z, observer.innovation(z, measured)), 0
        if x is None:
            return None, 0
        history.measure(x)
        z = self.model.lift(history.states, history.inputs)
        # What the read-out misses of the outputs measured now, it is taken to miss over the horizon too.
        self.readout = x - self.model.read(z) if observer is None else np.zeros(self.model.n_states)
        return z, 0

    def _bridged(self, measured: Array) -> Array | None:
        """The measurement (n,), predicted where it is NaN; None where nothing was measured yet to predict from."""
        absent = np.isnan(measured)
        if not absent.any():
            return measured
        predicted = self._disturbance.predicted
        if predicted is None or self.readout is None or not np.isfinite(predicted).all():
            return None
        return np.where(absent, self.model.read(predicted) + self.readout, measured)
