"""Linear MPC on a lifted model: condensed QP, state-residual disturbance estimate, reference preview."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, non_negative, positive, real_array
from pisplit.controllers.estimation.kalman import KalmanFilter
from pisplit.controllers.estimation.lifted_state import LiftedStateEstimation
from pisplit.controllers.loop.history import Line
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.tracking import (
    Move,
    check_dt,
    checked_measurement,
    checked_window,
    start_input,
    tracked_states,
)
from pisplit.controllers.mpc.carried import check_carried
from pisplit.controllers.mpc.fallback import PLAN, Fallback
from pisplit.controllers.mpc.growth import warn_of_growth
from pisplit.controllers.mpc.latency import Latency
from pisplit.controllers.mpc.limits import directions, held_directions, input_limits
from pisplit.controllers.mpc.prediction import Prediction
from pisplit.controllers.mpc.problem import TrackingProblem, Weights
from pisplit.controllers.mpc.qp import QPResult, QPSettings
from pisplit.controllers.mpc.servos import Servos
from pisplit.controllers.mpc.state import MPCState
from pisplit.controllers.mpc.steady import SteadyTarget
from pisplit.data.actuator import Actuator
from pisplit.data.columns import in_order
from pisplit.data.episodes import Episodes
from pisplit.evaluation.matching import Fitted, model_of
from pisplit.files import write_text
from pisplit.lifted.model import LiftedModel
from pisplit.threads import one_blas_thread

GAIN = 0.3  # of the disturbance estimate, where there is no delay
#: Innovations, in parts of what the observer expects, that are too large, and steps in a row until that is said.
LOUD, BORNE = 3.0, 8
#: Arguments that a controller on other limits or another model does not share.
OWN = ("self", "model", "observer", "recordings", "force", "__class__")


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
    that it rejects are counted (``Move.rejected``). Where they are three times as large as it expects for eight steps
    in a row, ``Move.warning`` says so, once a run: the model does not carry what it is asked for, and may swing.

    ``command_delay``, ``measurement_delay``: known delays in steps, fractions allowed, between a command and its
    action and between a state and its measurement; the prediction starts where commands can still change something.
    For models of the plant without these delays: one that was fitted to recordings with them has them inside. The
    ``horizon`` attribute, the samples of the reference that ``step`` takes, grows by what the delay of commands needs.

    ``actuator``: servos between the commands and what the model takes, for models of positions: those fitted to
    ``episodes.through(actuator)``, or equations of an arm. Limits are those of commands, the lag is predicted, and the
    play is taken out of what is sent (:class:`Servos`), but for two standard errors ``play_error`` of it (15 % of the
    play if not given): too little of it costs less than too much. ``actuator_inputs``: how a command is reached, "ramp"
    or "step".

    ``recordings``: of the plant, best such that the model did not learn from; a model whose predictions of them are off
    by more than 0.4 times the spread of the tracked outputs at the end of the horizon is refused, with ``force`` only
    warned of and noted. :meth:`pisplit.Identified.mpc` gives those that it held out.

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
        actuator: Actuator | None = None,
        actuator_inputs: str = "ramp",
        play_error: float | None = None,
        recordings: Episodes | None = None,
        force: bool = False,
    ) -> None:
        self._arguments = {k: v for k, v in locals().items() if k not in OWN}
        self.model = model = model_of(model, "model")
        self._H = count(horizon, "horizon")
        self._latency = Latency(command_delay, measurement_delay)
        self.horizon = self._H + self._latency.preview
        check_dt(model, dt)
        target = tracked_states(model, track, axes)
        self.track, self.group, self.axes, self.tracked = target.name, target.group, target.axes, target.states
        basis = model.input_basis if input_basis is None else directions(input_basis, model.n_inputs)
        self._limits = input_limits(u_min, u_max, du_max, model.n_inputs, model.input_offset, basis)
        self.notes = held_directions(model, basis, input_basis is not None)
        p, H = len(self.tracked), self._H
        rows = list(self.tracked)
        if recordings is not None and (told := check_carried(model, recordings, H, rows, force)):
            self.notes = (*self.notes, told)
        warn_of_growth(model.A, H)
        self._wanted: Array | None
        self._plan: Array | None
        if observer is not None and observer.model is not model:
            raise ValueError("the observer is of another model; make it with KalmanFilter.from_data(model, ...)")
        gain = GAIN / (1.0 + self._latency.total) if estimator_gain is None else estimator_gain
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
        self._prediction = Prediction(model, self.tracked, H, limits, self._latency)
        read, offset = self._prediction.read, self._prediction.offset
        self.steady = SteadyTarget(model, read, offset, limits, weights.output, scale)
        self._fallback = Fallback(H, limits)
        self._estimation = self._estimation_of(
            model=model, observer=observer, gain=gain, stuck_after=stuck_after, amplitude=limits.amplitude
        )
        self._servos = Servos(actuator, model.dt, actuator_inputs, limits, H, play_error)
        S = self._servos.response(self._prediction.nominal)
        self._problem = TrackingProblem(H, limits, weights, low, high, S, qp or QPSettings())
        self._line = Line(self._latency.total, "command_delay + measurement_delay")
        self.reset(np.clip(np.zeros(model.n_inputs), limits.u_min, limits.u_max))

    def _estimation_of(self, **settings: Any) -> LiftedStateEstimation:
        return LiftedStateEstimation(**settings)

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
        return self._estimation.observer is not None

    @property
    def disturbance(self) -> Array:
        """Current disturbance estimate w (M,) of the lifted state, per step."""
        return self._estimation.disturbance.copy()

    def reset(self, u0: ArrayLike | None = None) -> None:
        """Forget history, plan and disturbance; the arm rests under ``u0`` (m,), zeros if not given."""
        start = start_input(u0, self.u_min, self.u_max)
        self._estimation.reset(start)
        self._problem.restart()
        self._prediction.reset()
        self._fallback.reset(start)
        self._line.fill(start)
        self._servos.reset(np.array(start))
        self._commanded = np.array(start)
        self._wanted = None
        self._plan = None
        self._loud = 0

    def limit(
        self, u_min: ArrayLike | None = None, u_max: ArrayLike | None = None, du_max: ArrayLike | None = None
    ) -> None:
        """Other input limits from the next step on, those not given as they were; the run goes on.

        ``u_min``, ``u_max``, ``du_max``: numbers or (m,), as for the controller. What was estimated and the plan are
        kept. Rate and input weights are relative to the new box, as ever. Raises ValueError, and changes nothing, for
        limits that do not fit, and for a box that the present input is not in: go inside first.
        """
        given = {"u_min": u_min, "u_max": u_max, "du_max": du_max}
        arguments = self._arguments | {name: value for name, value in given.items() if value is not None}
        other = type(self)(self.model, **arguments, observer=self._estimation.observer)
        outside = (self._commanded < other.u_min) | (self._commanded > other.u_max)
        if outside.any():
            i = int(np.argmax(outside))
            raise ValueError(
                f"the present input {i} is {self._commanded[i]:.4g}, outside the new box {other.u_min[i]:.4g} .. "
                f"{other.u_max[i]:.4g}; bring it inside first"
            )
        state = self.snapshot()
        if self._plan is not None:
            planned = self._limits.offset + self._problem.moves(self._plan) @ self._problem.T.T
            moves = [other._limits.coordinates(u) / other._problem.scale for u in planned]
            plan = other._problem.hold(moves[0])
            plan[: other._problem.n_moves] = np.ravel(moves)
            state = replace(state, plan=plan)
        rest = np.clip(state.fallback.rest, other.u_min, other.u_max)
        fallback = replace(state.fallback, rest=rest)
        other.restore(replace(state, fallback=fallback, problem=other._problem.snapshot()))
        self.__dict__ = other.__dict__

    def with_model(self, model: LiftedModel | Fitted, log: LoopLog, episodes: Episodes | None = None) -> MPC:
        """The same controller on another ``model`` of the same states and inputs, in the midst of the run of ``log``.

        Arguments are those of this controller, ``output_scale`` in numbers, so that weights mean the same. Measurements
        and inputs at the end of the log are its history; what was learned of disturbances is forgotten. An observer
        gets the process noise of ``episodes``. Raises ValueError where one is needed and there are none, and for a
        model of other sizes.
        """
        found, observer = model_of(model, "model"), self._estimation.observer
        if (found.n_states, found.n_inputs) != (self.model.n_states, self.model.n_inputs):
            raise ValueError(
                f"the model has {found.n_states} states and {found.n_inputs} inputs, the controller "
                f"{self.model.n_states} and {self.model.n_inputs}"
            )
        if observer is not None:
            if episodes is None:
                raise ValueError("the observer needs recordings of what the new model describes: give episodes")
            observer = observer.of_model(found, episodes)
        other = type(self)(found, **self._arguments | {"output_scale": self.output_scale}, observer=observer)
        other.reset(log.u[-1] if len(log.u) else log.u0)
        other._fallback.restore(replace(other._fallback.snapshot(), rest=self._fallback.snapshot().rest))
        other._line.fill(log.u0)
        acting = [other._line(other._servos.sent(u)) for u in log.u]
        other._commanded = other._servos.command
        other._estimation.remember(log.x[:-1], np.reshape(acting, log.u.shape))
        other._wanted = None if self._wanted is None else self._wanted.copy()
        return other

    def to_c(self, path: str | os.PathLike[str], name: str = "mpc") -> None:
        """Write the whole step to ``path`` as one C99 header without allocation: estimate, program, fallback.

        With ``name`` = NAME it defines ``name_state``, ``name_reset(state, u0)`` and ``name_step(state, x, r, u)``,
        which returns NAME_SOLVED or what stood in for a solution; the head of the file says the rest. The program is
        solved exactly, by the dual active-set method of Goldfarb and Idnani. A bilinear model is
        rolled out and condensed along the plan in C too; its steady target is not known there: a run without solutions
        goes from the plan to the hold, and a filter begins with the first whole measurement.

        Raises ValueError for models that are neither linear nor bilinear, fractions of a step of delay of a bilinear
        one, output limits, ``stuck_after`` that is not None, and a name that is no identifier.
        """
        from pisplit.controllers.mpc.c_code import c_step

        write_text(path, c_step(self, name))

    def snapshot(self) -> MPCState:
        """What the next step depends on beside the arguments of the controller; ``restore`` goes on from there."""
        return MPCState(
            self._estimation.snapshot(),
            self._problem.snapshot(),
            self._fallback.snapshot(),
            None if self._plan is None else self._plan.copy(),
            self._line.own(),
            self._commanded.copy(),
            None if self._wanted is None else self._wanted.copy(),
            self._servos.snapshot(),
            self._prediction.snapshot(),
            self._loud,
        )

    def restore(self, state: MPCState) -> None:
        """Go on, to the last bit, from a ``state`` that a controller with the same arguments took by ``snapshot``.

        Raises ValueError for the state of a controller of other sizes.
        """
        self._estimation.restore(state.estimation)
        self._problem.restore(state.problem)
        self._fallback.restore(state.fallback)
        self._plan = None if state.plan is None else state.plan.copy()
        self._line.take(state.line)
        self._commanded = state.commanded.copy()
        self._wanted = None if state.wanted is None else state.wanted.copy()
        self._prediction.restore(state.prediction)
        self._loud = state.loud
        self._servos.restore(state.servos)

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
        problem, limits, estimation = self._problem, self._limits, self._estimation
        self._wanted = window[0].copy()
        v_previous = limits.coordinates(self._commanded) / problem.scale
        plan = problem.hold(v_previous) if self._plan is None else problem.shift(self._plan)
        with np.errstate(over="ignore", invalid="ignore"):  # a lift that overflows ends as a status, not as a warning
            found = estimation.measured(measured, self._commanded)
            z = found.z
            if z is None:  # nothing is known yet: the arm rests
                result = QPResult("not measured yet", None, 0, np.inf)
                predicted = np.full((self._H, len(self.tracked)), np.nan)
            else:
                ahead = estimation.ahead(z, found.w, self._line.coming())
                planned_moves, scale = problem.moves(plan), problem.scale
                before = limits.coordinates(self._servos.position) / scale
                S, y_free = self._prediction(ahead, found.w, self._servos.planned(planned_moves, scale), before)
                S, y_free = self._servos.by_commands(S, y_free, self._prediction.nominal, scale)
                assert estimation.readout is not None
                y_free += np.tile(estimation.readout[list(self.tracked)], self._H)
                if estimation.blind > self._H:
                    result = QPResult("blind for more than the horizon", None, 0, np.inf)
                else:
                    result = problem.solve(y_free, r, v_previous, plan, S)
            self._plan = plan if result.x is None else result.x
            planned, action = limits.offset + problem.T @ problem.moves(self._plan)[0], ""
            if result.x is not None:
                self._fallback.solved()
                u = limits.project(planned, self._commanded)
            else:
                u, action = self._fallback(planned, lambda: self._at_rest(r, z), self._commanded)
                if action != PLAN:
                    self._plan = problem.hold(limits.coordinates(u) / problem.scale)
            u, position = self._servos.send(u, self._ahead())
            acting = self._line(position)
            estimation.applied(found, acting)
            if z is not None:
                predicted = problem.outputs(y_free, self._plan)
        self._commanded = np.array(self._servos.command)
        return Move(
            u=u,
            status=result.status,
            fallback=result.x is None,
            action=action,
            iterations=result.iterations,
            solve_time=time.perf_counter() - wall,
            cpu_time=time.thread_time() - cpu,
            predicted=predicted,
            missing=found.missing,
            rejected=found.rejected,
            stuck=found.stuck,
            warning=self._doubted(),
            acting=acting,
        )

    def _ahead(self) -> Array:
        """Positions (H, m) along the plan."""
        problem, limits = self._problem, self._limits
        assert self._plan is not None
        moves = self._servos.planned(problem.moves(self._plan), problem.scale)
        return np.asarray(limits.offset + moves @ problem.T.T)

    def _doubted(self) -> str:
        """That innovations are too large, in words, when it is said for the first time; empty otherwise."""
        level = self._estimation.level
        if self._loud <= BORNE:
            self._loud = self._loud + 1 if level > LOUD else 0
        if self._loud != BORNE:
            return ""
        self._loud = BORNE + 1
        return (
            f"innovations are {level:.2g} times as large as the observer expects: the model does not carry this "
            "motion, or an unknown load acts; a larger rate_weight or a smaller estimator_gain is safer"
        )

    def _at_rest(self, r: Array, z: Array | None) -> Array | None:
        """The input (m,) under which the model rests nearest to the next sample of r (H p,); None before z is known."""
        estimation = self._estimation
        if z is None or estimation.readout is None:
            return None
        missed = estimation.readout[list(self.tracked)]
        return self.steady(r[: len(self.tracked)], estimation.disturbance, missed, self._commanded)


def _each_output(value: ArrayLike, name: str, n_outputs: int) -> Array:
    array = real_array(value, name).copy()
    if array.ndim == 0:
        array = np.full(n_outputs, array)
    if array.shape != (n_outputs,) or np.isnan(array).any():
        raise ValueError(f"{name} = {value!r}; expected a number or {n_outputs} numbers, one a tracked output")
    return array
