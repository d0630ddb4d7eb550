"""Linear MPC on a lifted model: condensed QP, state-residual disturbance estimate, reference preview."""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import Array, count, non_negative, positive, real_array
from pisplit.controllers.estimation.disturbance import DisturbanceEstimator
from pisplit.controllers.estimation.kalman import KalmanFilter
from pisplit.controllers.estimation.stuck import StuckSensors
from pisplit.controllers.loop.history import History, Line
from pisplit.controllers.loop.tracking import (
    Move,
    check_dt,
    checked_measurement,
    checked_window,
    start_input,
    tracked_states,
)
from pisplit.controllers.mpc.condense import condense
from pisplit.controllers.mpc.fallback import PLAN, Fallback
from pisplit.controllers.mpc.growth import warn_of_growth
from pisplit.controllers.mpc.latency import Latency
from pisplit.controllers.mpc.limits import directions, input_limits
from pisplit.controllers.mpc.problem import TrackingProblem, Weights
from pisplit.controllers.mpc.qp import QPResult, QPSettings
from pisplit.controllers.mpc.relinearise import AlongPlan
from pisplit.controllers.mpc.state import MPCState, Past
from pisplit.controllers.mpc.steady import SteadyTarget
from pisplit.data.columns import in_order
from pisplit.data.input_subspace import combination
from pisplit.evaluation.matching import Fitted, model_of
from pisplit.lifted.model import LiftedModel
from pisplit.threads import one_blas_thread

GAIN = 0.3  # of the disturbance estimate, where there is no delay
#: Steps in a row in which an entry of the measurement may be rejected; then the model is wrong, and not the sensor.
PATIENCE = 12
#: So many times the repeats after which a reading is stuck are the steps that can be taken in anew.
MEMORY = 3


class MPC:
    """Model predictive control of z+ = A z + B phi(u) (+ sum_i u_i N_i z) + c + w, y = C z + d over ``horizon`` steps.

    minimise  sum_j  output_weight |(y_j - r_j)/e|^2  +  rate_weight |(u_j - u_{j-1})/a|^2
                     +  input_weight |(u_j - u_offset)/a|^2  +  output_slack_weight s_j^2
    subject to  u_min <= u_j <= u_max,  |u_j - u_{j-1}| <= du_max,  y_min - e s_j <= y_j <= y_max + e s_j.

    ``model``: the identified model, with at least one input; ``horizon``: H steps.
    u_min, u_max, du_max: numbers or (m,), in input units, du_max per step; a = (u_max - u_min)/2 of each input. They
    hold exactly for every applied input, and u stays in input_offset + span(input_basis) of the model, the directions
    that its recordings excite; ``input_basis`` (m, r), if given, replaces them (np.eye(m): every direction). ``notes``
    say which directions are kept and which are held, where not all of them are free by themselves.
    ``track``: an output name of the model, or a list of state names or indices; ``axes`` picks coordinates of it in any
    order, e.g. (0, 1): outputs, weights, limits and predictions have the order of ``axes``.
    ``output_scale`` e: sizes of the outputs, a number or (p,) in output units; the range of each in the training data
    if not given (``state_range`` of the model). Weights are relative to it and to a, so that they depend on no unit.
    ``output_weight``: a number or one per tracked output. A stiff arm with a model linear in u wants a
    ``rate_weight`` near 0.02, a soft arm near 2e-4. y_min, y_max: numbers or (p,) in output units, infinite or None
    where absent; soft, so that the problem always has a solution; ``output_slack_weight`` (1e3 if not given) prices
    their excess s_j. ``estimator_gain``: 0 (no disturbance estimate) to 1; if not given 0.3, divided by one plus
    the delays in steps. ``dt``: if given, must be the model's. ``qp``: settings of the solver, :class:`QPSettings`:
    OSQP, or DAQP where it is installed.

    The disturbance estimate makes predictions of the lifted state unbiased; where outputs are read from it by
    regression, the residual of the read-out at the measured state is added to all predicted outputs.

    ``observer``: a :class:`KalmanFilter` of the model, for measurements with noise or of some of the states only;
    without it the lifted state is that of the measurement. Its corrections drive the disturbance estimate, and entries
    that it rejects are counted (``Move.rejected``).

    ``command_delay``, ``measurement_delay``: known delays in steps, fractions allowed, between a command and its
    action and between a state and its measurement; the prediction starts where commands can still change something.
    For models of the plant without these delays: one that was fitted to recordings with them has them inside. The
    ``horizon`` attribute, the samples of the reference that ``step`` takes, grows by what the delay of commands needs.

    ``stuck_after``: a reading that repeats itself exactly so many times, while the inputs moved and the model predicts
    that it changed, is taken for not measured until it changes (``Move.stuck`` names it); None trusts all readings.

    A model that is nonlinear in u is linearised along the shifted last plan, one SQP step per move; a bilinear or
    re-lifted model is rolled out along it and condensed anew. Raises ValueError on arguments that do not fit the model,
    and on settings that would have no effect. Controllers can be pickled and copied, also between steps: a copy goes on
    to the last bit as the original would; so does one that took a ``snapshot`` by ``restore``.

    Source: Rawlings, Mayne and Diehl, Model Predictive Control (2017), chapter 1; Korda and Mezic, Automatica 93
    (2018).
    """

    def __init__(
        self,
        model: LiftedModel | Fitted,
        horizon: int,
        u_min: ArrayLike,
        u_max: ArrayLike,
        du_max: ArrayLike,
        track: str | Sequence[int | str] = "tip",
        axes: Sequence[int] | None = None,
        output_weight: ArrayLike = 1.0,
        rate_weight: float = 0.02,
        input_weight: float = 0.0,
        estimator_gain: float | None = None,
        dt: float | None = None,
        y_min: ArrayLike | None = None,
        y_max: ArrayLike | None = None,
        output_slack_weight: float | None = None,
        output_scale: ArrayLike | None = None,
        qp: QPSettings | None = None,
        input_basis: ArrayLike | None = None,
        observer: KalmanFilter | None = None,
        command_delay: float = 0.0,
        measurement_delay: float = 0.0,
        stuck_after: int | None = 5,
    ) -> None:
        self.model = model = model_of(model, "model")
        self._H = count(horizon, "horizon")
        self._latency = Latency(command_delay, measurement_delay)
        self.horizon = self._H + self._latency.preview
        check_dt(model, dt)
        target = tracked_states(model, track, axes)
        self.track, self.group, self.axes, self.tracked = target.name, target.group, target.axes, target.states
        basis = model.input_basis if input_basis is None else directions(input_basis, model.n_inputs)
        self._limits = input_limits(u_min, u_max, du_max, model.n_inputs, model.input_offset, basis)
        self.notes = _held_directions(model, basis, input_basis is not None)
        p, H = len(self.tracked), self._H
        rows = list(self.tracked)
        self._read, self._read_offset = model.C[rows], model.d[rows]
        self._condensed = condense(model.A, model.B, model.c, self._read, self._read_offset, H)
        warn_of_growth(model.A, H)
        self._history: History
        self._readout: Array | None
        self._wanted: Array | None
        self._past: deque[Past]
        if observer is not None and observer.model is not model:
            raise ValueError("the observer is of another model; make it with KalmanFilter.from_data(model, ...)")
        self._observer = observer
        gain = GAIN / (1.0 + self._latency.total) if estimator_gain is None else estimator_gain
        self._estimator = DisturbanceEstimator(model.A, model.B, model.c, gain)
        self._response = self._condensed.response()
        self._linear = model.linear_in_u
        scale = model.state_range[rows] if output_scale is None else _each_output(output_scale, "output_scale", p)
        if not (np.isfinite(scale).all() and (scale > 0.0).all()):
            raise ValueError(f"output_scale = {scale}; expected a positive size of every output, in its own unit")
        weights = Weights(
            output=_each_output(output_weight, "output_weight", p),
            rate=non_negative(rate_weight, "rate_weight"),
            input=non_negative(input_weight, "input_weight"),
            slack=positive(1e3 if output_slack_weight is None else output_slack_weight, "output_slack_weight"),
            scale=scale,
        )
        if not (weights.output.any() and (weights.output >= 0.0).all() and np.isfinite(weights.output).all()):
            raise ValueError(f"output_weight = {output_weight!r}; expected finite weights, none negative, one positive")
        low = np.full(p, -np.inf) if y_min is None else _each_output(y_min, "y_min", p)
        high = np.full(p, np.inf) if y_max is None else _each_output(y_max, "y_max", p)
        if (low >= high).any():
            raise ValueError(f"y_min = {low} is not below y_max = {high}; give every output a range")
        if output_slack_weight is not None and not (np.isfinite(low).any() or np.isfinite(high).any()):
            raise ValueError(
                "output_slack_weight has no effect without y_min or y_max; give one of them or leave it out"
            )
        limits = self._limits
        self.output_scale = scale
        self.steady = SteadyTarget(model, self._read, self._read_offset, limits, weights.output, scale)
        self._fallback = Fallback(H, limits)
        self._stuck = None if stuck_after is None else StuckSensors(stuck_after, model.state_range, limits.amplitude)
        self._T = limits.basis * limits.amplitude.mean()
        self._along = AlongPlan(model, self._read, self._read_offset, self._T) if model.varies else None
        centre = limits.offset + limits.basis @ limits.coordinates(0.5 * (limits.u_min + limits.u_max))
        if self._along is None:
            S, _ = self._linearise(np.tile(centre, (H, 1)), np.zeros((H, self._T.shape[1])))
        else:
            D = model.n_delays
            # Products are fitted to the data's range: z = 0 is their mean in a re-lifted model, where x is d.
            known = np.zeros(model.n_states) if model.relifted is None else model.d
            z = model.lift(np.tile(known, (D + 1, 1)), np.tile(centre, (D, 1)))
            S, _ = self._along(z, np.zeros(model.n_lifted), np.tile(centre, (H, 1)))
        self._undelayed = S
        S = self._latency.mixed(S, self._T.shape[1])
        self._problem = TrackingProblem(H, limits, weights, low, high, S, qp or QPSettings())
        if self._linear:
            self._offset_response = self._response.reshape(H * p, -1) @ np.tile(limits.offset, H)
        self._start(np.clip(np.zeros(model.n_inputs), limits.u_min, limits.u_max))

    @property
    def u_min(self) -> Array:
        """Lower input limits (m,)."""
        return self._limits.u_min

    @property
    def u_max(self) -> Array:
        """Upper input limits (m,)."""
        return self._limits.u_max

    @property
    def du_max(self) -> Array:
        """Largest input change (m,) per step."""
        return self._limits.du_max

    @property
    def estimates(self) -> bool:
        """Whether an observer finds states that are not measured."""
        return self._observer is not None

    @property
    def disturbance(self) -> Array:
        """Current disturbance estimate w (M,) of the lifted state, per step."""
        return self._estimator.disturbance.copy()

    def reset(self, u0: ArrayLike | None = None) -> None:
        """Forget history, plan and disturbance; the arm rests under ``u0`` (m,), zeros if not given."""
        self._start(start_input(u0, self.u_min, self.u_max))
        self._estimator.reset()
        self._problem.restart()

    def snapshot(self) -> MPCState:
        """What the next step depends on beside the arguments of the controller; ``restore`` goes on from there."""
        plan = None if self._plan is None else self._plan.copy()
        readout = None if self._readout is None else self._readout.copy()
        parts = self._estimator.snapshot(), self._problem.snapshot()
        wanted = None if self._wanted is None else self._wanted.copy()
        counts = self._blind, self._doubts.copy()
        line, commanded = self._line.own(), self._commanded.copy()
        stuck = None if self._stuck is None else self._stuck.snapshot()
        return MPCState(
            copy.deepcopy(self._history),
            plan,
            *parts,
            readout,
            *counts,
            line,
            commanded,
            wanted,
            stuck,
            tuple(self._past),
            self._fallback.snapshot(),
        )

    def restore(self, state: MPCState) -> None:
        """Go on, to the last bit, from a ``state`` that a controller with the same arguments took by ``snapshot``.

        Raises ValueError for the state of a controller of other sizes.
        """
        if state.history.states.shape != self._history.states.shape:
            raise ValueError("the snapshot is of a controller of another model; restore it where it is from")
        self._problem.restore(state.problem)
        self._estimator.restore(state.estimator)
        self._history = copy.deepcopy(state.history)
        self._plan = None if state.plan is None else state.plan.copy()
        self._readout = None if state.readout is None else state.readout.copy()
        self._blind, self._doubts = state.blind, state.doubts.copy()
        self._line.take(state.line)
        self._commanded = state.commanded.copy()
        self._fallback.restore(state.fallback)
        self._wanted = None if state.wanted is None else state.wanted.copy()
        if self._stuck is not None and state.stuck is not None:
            self._stuck.restore(state.stuck)
            self._past = deque(state.past, self._past.maxlen)

    @one_blas_thread()
    def step(self, x_measured: ArrayLike, reference_window: ArrayLike) -> Move:
        """The move after measuring ``x_measured`` (n,), with the ``reference_window`` (``horizon``, p) of k+1 on.

        NaN in the reference is a free output, NaN in the measurement was not measured: the model's prediction stands
        for it. After a whole horizon without any measurement the last plan goes on to its steady end.

        Where no accepted solution exists the last good plan goes on, shifted; at its end the input goes to the steady
        target, is held, and returns slowly to where it began, each for a horizon: ``Move.action`` says which.
        Raises ValueError on wrong shapes and on infinite measurements.
        """
        wall, cpu = time.perf_counter(), time.thread_time()
        window = checked_window(reference_window, self.horizon, len(self.tracked))
        r = self._latency.wanted(window, window[0] if self._wanted is None else self._wanted).ravel()
        measured = checked_measurement(in_order(x_measured, self.model.state_names, "states"), self.model.n_states)
        measured, stuck = self._without_stuck(measured)
        problem, limits, history = self._problem, self._limits, self._history
        kept = None if self._stuck is None else self._kept(measured)
        missing = int(np.count_nonzero(np.isnan(measured)))
        self._blind = self._blind + 1 if missing == len(measured) else 0

        self._wanted = window[0].copy()
        v_previous = limits.coordinates(self._commanded) / problem.scale
        plan = problem.hold(v_previous) if self._plan is None else problem.shift(self._plan)
        with np.errstate(over="ignore", invalid="ignore"):  # a lift that overflows ends as a status, not as a warning
            z, rejected = self._observed(measured)
            if z is None:  # nothing is known yet: the arm rests
                result = QPResult("not measured yet", None, 0, np.inf)
                predicted = np.full((self._H, len(self.tracked)), np.nan)
            else:
                w = self._estimator.update(z)
                S, y_free = self._response_along(self._ahead(z, w), w, problem.moves(plan), v_previous)
                assert self._readout is not None
                y_free += np.tile(self._readout[list(self.tracked)], self._H)
                if self._blind > self._H:
                    result = QPResult("blind for more than the horizon", None, 0, np.inf)
                else:
                    result = problem.solve(y_free, r, v_previous, plan, S)
            self._plan = plan if result.x is None else result.x
            planned, action = limits.offset + self._T @ problem.moves(self._plan)[0], ""
            if result.x is not None:
                self._fallback.solved()
                u = limits.project(planned, self._commanded)
            else:
                u, action = self._fallback(planned, lambda: self._at_rest(r, z), self._commanded)
                if action != PLAN:
                    self._plan = problem.hold(limits.coordinates(u) / problem.scale)
            acting = self._line(u)
            if z is not None:
                self._estimator.predict(z, *self._forcing(z, acting))
                if kept is not None:
                    self._past.append(replace(kept, acting=acting))
                predicted = problem.outputs(y_free, self._plan)
        self._commanded = u.copy()
        history.apply(acting)
        return Move(
            u=u,
            status=result.status,
            fallback=result.x is None,
            action=action,
            iterations=result.iterations,
            solve_time=time.perf_counter() - wall,
            cpu_time=time.thread_time() - cpu,
            predicted=predicted,
            missing=missing,
            rejected=rejected,
            stuck=stuck,
        )

    def _without_stuck(self, measured: Array) -> tuple[Array, tuple[int, ...]]:
        """The measurement (n,), NaN where a reading is stuck, and which those are."""
        watch, z = self._stuck, self._estimator.predicted
        if watch is None:
            return measured, ()
        model, missed = self.model, self._readout

        def predicted(states: NDArray[np.intp]) -> Array:
            assert z is not None and missed is not None
            return np.asarray(model.C[states] @ z + model.d[states] + missed[states])

        known = z is not None and missed is not None and np.isfinite(z).all()
        before = watch.known
        found = watch(measured, self._commanded, predicted if known else None)
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
                self._history, self._readout, self._doubts = past.history.copy(), past.readout, past.doubts
                self._estimator.restore(past.estimator)
            measured = np.where(stuck, np.nan, past.measured)
            kept = self._kept(measured)
            z, _ = self._observed(measured)
            assert z is not None  # as it was before, or predicted
            self._estimator.update(z)
            self._estimator.predict(z, *self._forcing(z, past.acting))
            self._history.apply(past.acting)
            self._past[k - len(again)] = replace(kept, acting=past.acting)

    def _kept(self, measured: Array) -> Past:
        """What this step begins with."""
        return Past(self._history.copy(), self._estimator.snapshot(), self._readout, self._doubts, measured)

    def _observed(self, measured: Array) -> tuple[Array | None, int]:
        """The lifted state (M,), None where nothing is known yet; how many entries of ``measured`` were rejected."""
        history, observer, predicted = self._history, self._observer, self._estimator.predicted
        if observer is not None and predicted is not None and np.isfinite(predicted).all():
            innovation = observer.innovation(predicted, measured)
            doubted = observer.doubted(innovation) & (self._doubts < PATIENCE)
            self._doubts = np.where(doubted, self._doubts + 1, 0)
            self._readout = np.zeros(self.model.n_states)
            return observer.corrected(predicted, np.where(doubted, np.nan, innovation)), int(doubted.sum())
        x = self._bridged(measured)
        if x is None and observer is not None:
            z = self.model.fixed_point(history.u_previous)
            self._readout = np.zeros(self.model.n_states)
            return observer.corrected(z, observer.innovation(z, measured)), 0
        if x is None:
            return None, 0
        history.measure(x)
        z = self.model.lift(history.states, history.inputs)
        # What the read-out misses of the outputs measured now, it is taken to miss over the horizon too.
        self._readout = x - self.model.read(z) if observer is None else np.zeros(self.model.n_states)
        return z, 0

    def _bridged(self, measured: Array) -> Array | None:
        """The measurement (n,), predicted where it is NaN; None where nothing was measured yet to predict from."""
        absent = np.isnan(measured)
        if not absent.any():
            return measured
        predicted = self._estimator.predicted
        if predicted is None or self._readout is None or not np.isfinite(predicted).all():
            return None
        return np.where(absent, self.model.read(predicted) + self._readout, measured)

    def _start(self, u0: Array) -> None:
        self._history = History(self.model.n_delays, self.model.n_states, u0)
        self._line = Line(self._latency.total, "command_delay + measurement_delay")
        self._line.fill(u0)
        self._commanded = np.array(u0)
        self._fallback.reset(u0)
        self._wanted = None
        self._plan = None
        self._readout = None
        self._blind = 0
        if self._stuck is not None:
            self._stuck.reset()
        self._past = deque(maxlen=0 if self._stuck is None else MEMORY * self._stuck.steps)
        self._doubts = np.zeros(0 if self._observer is None else len(self._observer.measured), dtype=np.int64)

    def _at_rest(self, r: Array, z: Array | None) -> Array | None:
        """The input (m,) under which the model rests nearest to the next sample of r (H p,); None before z is known."""
        if z is None or self._readout is None:
            return None
        missed = self._readout[list(self.tracked)]
        return self.steady(r[: len(self.tracked)], self._estimator.disturbance, missed, self._commanded)

    def _ahead(self, z: Array, w: Array) -> Array:
        """The lifted state (M,) once the commands on their way have acted, from ``z`` (M,) as measured now."""
        for u in self._line.coming():
            z = self._estimator.following(z, w, *self._forcing(z, u))
        return z

    def _response_along(self, z: Array, w: Array, v: Array, v_previous: Array) -> tuple[Array | None, Array]:
        """S (H p, H r), or None where it never changes, and y_free (H p,) for commands v (H, r): y = y_free + S v.

        ``v_previous`` (r,): the command before them, of which a part acts still where delays are no whole steps.
        """
        latency, r = self._latency, v.shape[1]
        acting = latency.acting(v, v_previous)
        S, y_free = self._acting_response(z, w, acting)
        if latency.part > 0.0:
            first = (self._undelayed if S is None else S)[:, :r]
            y_free = y_free + latency.part * first @ v_previous
            S = None if S is None else latency.mixed(S, r)
        return S, y_free

    def _acting_response(self, z: Array, w: Array, v: Array) -> tuple[Array | None, Array]:
        """As ``_response_along``, for inputs v (H, r) that act at once."""
        u = self._limits.offset + v @ self._T.T
        if self._along is not None:
            S, y = self._along(z, w, u)
            return S, y - S @ v.ravel()
        y_free = self._condensed.free @ z + self._condensed.disturbance @ w + self._condensed.constant
        if self._linear:
            return None, y_free + self._offset_response
        S, y_features = self._linearise(u, v)
        return S, y_free + y_features

    def _forcing(self, z: Array, u: Array) -> tuple[Array, Array | None]:
        """Features (P,) of the input, and what its products with lifted states add (M,), where the model has some."""
        features = u if self._linear else self.model.features(u[None, :])[0]
        return features, self.model.products(z, u) if self.model.varies else None

    def _linearise(self, u: Array, v: Array) -> tuple[Array, Array]:
        """S (H p, H r) and the constant part (H p,) of the outputs, for features linearised at u (H, m) = u(v)."""
        H, p, _, P = self._response.shape
        if self._linear:
            JT = np.broadcast_to(self._T, (H, *self._T.shape))
            value = u
        else:
            JT = self.model.feature_jacobian(u) @ self._T
            value = self.model.features(u)
        G = self._response.reshape(H * p, H, P)
        S = np.matmul(G.transpose(1, 0, 2), JT).transpose(1, 0, 2).reshape(H * p, -1)
        return S, self._response.reshape(H * p, H * P) @ value.ravel() - S @ v.ravel()


def _each_output(value: ArrayLike, name: str, n_outputs: int) -> Array:
    array = real_array(value, name).copy()
    if array.ndim == 0:
        array = np.full(n_outputs, array)
    if array.shape != (n_outputs,) or np.isnan(array).any():
        raise ValueError(f"{name} = {value!r}; expected a number or {n_outputs} numbers, one a tracked output")
    return array


def _held_directions(model: LiftedModel, basis: Array, given: bool) -> tuple[str, ...]:
    """Lines on the directions in which inputs may move, where the recordings or the user leave some of them out."""
    known = model.provenance.get("input_directions", [])
    if given:
        return (f"inputs move in {basis.shape[1]} of {model.n_inputs} directions, as given in input_basis", *known)
    if basis.shape[1] == model.n_inputs:
        return ()
    if not known:
        held = np.linalg.svd(basis, full_matrices=True)[0][:, basis.shape[1] :].T
        known = [f"{combination(row, model.input_names)}: held" for row in held]
    return ("inputs move in the directions that the recordings excite; input_basis overrides", *known)
