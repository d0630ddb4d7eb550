"""Identify an arm from short noisy recordings: output error with unknown initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.models.arm.sight import Sight
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.model import Calibration, ParametrisedArm, check_memory
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.calibration.resting_shapes import RestingShapes
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Internal steps of the integrator in s, and their Radau stages: the error stays far below that of measurements, and
#: friction that turns round is damped.
STEP, STAGES = 0.015, 2
#: Gauss-Newton ends when no free parameter, of order one, changes by more, or the sum of squares falls by a smaller
#: part; and after so many steps.
CONVERGED, UNLIKELIER, STEPS = 5e-3, 1e-4, 30
#: Factors of Marquardt's weight after a step that was taken and one that was not.
EASED, STIFFENED = 0.5, 5.0
#: Standard errors, root mean square over the parameters, that a step may still be long where no step goes downhill.
SETTLED = 0.5
#: Weight above which a short step only says that it was held back.
HELD_BACK = 0.1
#: Smallest slope of misses in an initial state, in parts of the largest: what no sensor sees stays as it is.
UNSEEN = 1e-7
#: Relative change, and number of steps, that end the fit to shapes at rest where that to recordings starts.
SHAPES_DIGITS, SHAPES_STEPS = 1e-3, 20
#: Largest change of a parameter in one step.
TRUSTED = 0.7
#: Change of lag and play, in their typical sizes, by which commands are differentiated.
NUDGE = 1e-3
#: Least standard deviation in m of shapes at rest beside recordings: friction and play leave arms anywhere about there.
LOOSE = 2e-3


def calibrate_from_recordings(
    arm: TendonArm,
    fields: ArrayLike,
    inputs: ArrayLike | Sequence[ArrayLike],
    dt: float,
    position_error: float = 1e-3,
    rotation_error: float = 0.02,
    rate_error: float = 0.05,
    stations: int = 6,
    free: Sequence[str] = ("damping",),
    start: TendonParameters | None = None,
    equilibria: tuple[ArrayLike, ArrayLike] | None = None,
    input_error: float = 0.0,
    actuator: Actuator | None = None,
) -> Calibration:
    """Parameters whose motion looks like noisy recordings, and the initial state of each of them.

    One-step predictions from measured states (``calibrate_from_pairs``) are exact for exact states and biased for noisy
    ones: noise of the velocities makes the arm look less damped. Here the initial state of every recording is
    unknown too, and all of its instants count by the errors of their sensors. Initial states are eliminated from every
    Gauss-Newton step (variable projection: Golub, Pereyra, *The differentiation of pseudo-inverses and nonlinear least
    squares problems whose variables separate*, SIAM J. Numer. Anal. 1973).

    Args:
        fields: measured fields (N, T+1, 24 S) at T+1 instants of N recordings; a few steps each are enough.
        inputs: displacements (N, T+1, m) in m at these instants; they move linearly in between. With an ``actuator``:
            for every recording all commands (D, m) from rest on, the last T+1 of them at its instants.
        dt: time between the instants in s.
        stations: their number S.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
        rate_error: that of curvatures and velocities, in parts of their spread in the recordings.
        arm, free, start: as in ``calibrate_from_pairs``; with an ``actuator`` "lag" and "play" may be free, too.
        equilibria: displacements (M, m) in m and measured fields (M, 24 S) at rest under them: the first guess is
            fitted to them as they are, and they count beside the recordings.
        input_error: standard deviation in m of the displacements, such as an unknown play makes: each recording and
            each equilibrium then has unknown displacements too, the measured ones and a constant.
        actuator: first guess of the servos between commands and displacements.

    ``residual`` of the result is in standard deviations of the measurement. Raises RuntimeError where no recording can
    be simulated, and ``CalibrationError``, which is one, where the steps did not converge, or some recordings could
    not be simulated.
    """
    y = finite_array(fields, "fields", (None, None, N_FIELDS * stations))
    if y.shape[1] < 2:
        raise ValueError("recordings hold one instant; expected two or more")
    check_memory(arm)
    model = ParametrisedArm(arm, start, free, None if actuator is None else checked_actuator(actuator))
    given: Any = inputs
    if actuator is None:
        logs = list(finite_array(given, "inputs", (len(y), y.shape[1], arm.scene.n_inputs)))
    else:
        logs = [finite_array(log, "inputs", (None, arm.scene.n_inputs)) for log in given]
        if len(logs) != len(y) or any(len(log) < y.shape[1] for log in logs):
            raise ValueError(f"inputs are {len(logs)} command logs; expected {len(y)} of {y.shape[1]} rows or more")
    seen = Sight(model.scene, stations)
    play = non_negative(input_error, "input_error", "m")
    motion = _Motion(model, seen, dt, y, logs, seen.errors(y, position_error, rotation_error, rate_error), play)
    first = np.stack([np.concatenate([seen.state(rows[0]), np.zeros(motion.n_offsets)]) for rows in y])
    rest, x = None, model.first
    if equilibria is not None:
        strict = RestingShapes(model, *equilibria, position_error, rotation_error, stations, play)
        x = np.asarray(strict.fit(SHAPES_DIGITS, SHAPES_STEPS).x, dtype=np.float64)
        loose = max(1.0, LOOSE / position_error) if model.rubs else 1.0
        rest = strict.weighed_down(loose)
    problem = _Problem(model, motion, rest)
    best = problem.linearised(x, first)
    if rest is not None:
        tried = problem.linearised(model.first, first)
        if not best.better(tried):  # shapes at rest alone may leave an arm that cannot be moved
            x, best = model.first, tried
    if not best.used:
        raise RuntimeError("no recording could be simulated; check that fields and inputs belong to this arm")
    weight, why = 0.0, f"no end after {STEPS} steps"
    for _ in range(STEPS):
        change = problem.change(x, best, weight)
        start_of = best.moved(first, change)
        tried = problem.linearised(x + change, start_of)
        small = bool(np.abs(change).max() < CONVERGED)
        fell = best.cost - tried.cost
        if tried.better(best):
            still = tried.used == best.used and fell < UNLIKELIER * best.cost
            done = weight <= HELD_BACK and (small or still)
            x, first, best, weight = x + change, start_of, tried, EASED * weight
            if done:
                why = ""
                break
        else:
            weight = max(STIFFENED * weight, 1e-3)
            if small:  # uphill however short the step: the end, where what is left to do is below what data tell
                left = problem.standard_errors_left(x, best)
                if left > SETTLED:
                    uphill = f"the sum of squares {best.cost:.3g} rises by {-fell:.2g} however short the step"
                    why = f"{uphill}, and a whole step would be {left:.2g} standard errors long"
                else:
                    why = ""
                break
    if not why and best.used < len(y):
        why = f"{len(y) - best.used} of {len(y)} recordings could not be simulated"
    residual = float(np.sqrt(best.misses / best.entries))
    return model.result(x, residual, best.used, best.normal, residual, why)


@dataclass(frozen=True)
class _Local:
    """The problem about a point: normal equations of the parameters, initial states eliminated.

    ``backs`` gives each simulated recording its triangle R of the derivative Q R in the initial state, and Q^T of the
    misses and of the derivative in the parameters.
    """

    normal: Array
    right: Array
    cost: float
    misses: float
    entries: int
    backs: Mapping[int, tuple[Array, Array, Array]]

    @property
    def used(self) -> int:
        return len(self.backs)

    def better(self, other: _Local) -> bool:
        """Whether it is no worse, and no recording was lost."""
        return self.used > other.used or (self.used == other.used and self.cost <= other.cost)

    def moved(self, first: Array, change: Array) -> Array:
        """Initial states that go with a change of the parameters."""
        found = first.copy()
        for i, (triangle, miss, slope) in self.backs.items():
            found[i] -= np.linalg.solve(triangle, miss + slope @ change)
        return found


@dataclass(frozen=True)
class _Problem:
    """Misses of recordings and of shapes at rest, and the first guess."""

    model: ParametrisedArm
    motion: _Motion
    rest: RestingShapes | None

    def change(self, x: Array, local: _Local, weight: float) -> Array:
        """A damped Gauss-Newton step from ``x`` (P,) that is not too long and stays above the bounds."""
        model = self.model
        free = np.ones(len(x), dtype=bool)
        for _ in range(len(x)):
            step = np.zeros(len(x))
            normal = local.normal[np.ix_(free, free)]
            step[free] = -np.linalg.solve(normal + weight * np.diag(np.diag(normal)), local.right[free])
            step *= min(1.0, TRUSTED / max(float(np.abs(step).max()), 1e-300))
            outside = free & (x + step < model.low)
            if not outside.any():
                return step
            held = outside & (x <= model.low)
            if not held.any():  # up to the bound, this time
                return np.maximum(x + step, model.low) - x
            free &= ~held
        return np.zeros(len(x))

    def standard_errors_left(self, x: Array, local: _Local) -> float:
        """Length of an undamped step from ``x`` (P,) in standard errors of the parameters, root mean square."""
        step, misfit = self.change(x, local, 0.0), max(1.0, local.misses / local.entries)
        return float(np.sqrt(max(float(step @ local.normal @ step), 0.0) / (misfit * len(x))))

    def linearised(self, x: Array, first: Array) -> _Local:
        """The problem about parameters ``x`` (P,) and initial states ``first`` (N, 2n)."""
        prior, spread = self.model.prior(x), self.model.width
        normal, right = np.diag(1.0 / spread**2), prior / spread
        misses, entries = 0.0, 0
        if self.rest is not None:
            miss, slope = self.rest.misses(x), self.rest.slope(x)
            normal, right = normal + slope.T @ slope, right + slope.T @ miss
            misses, entries = float(miss @ miss), len(miss)
        backs: dict[int, tuple[Array, Array, Array]] = {}
        for i in range(len(first)):
            found = self.motion.linearised(x, first[i], i)
            if found is None:
                continue
            miss, of_state, of_parameters = found
            states = of_state.shape[1] - self.motion.n_offsets
            parts = np.abs(of_state[:, :states]).reshape(len(miss), 2, -1)  # of shapes and of rates
            floor = np.repeat(UNSEEN * parts.max(axis=(0, 2)), states // 2)
            kept = np.diag(np.concatenate([floor, np.zeros(self.motion.n_offsets)]))
            q, triangle = np.linalg.qr(np.vstack([of_state, kept]))
            q = q[: len(miss)]
            left, slopes = miss - q @ (q.T @ miss), of_parameters - q @ (q.T @ of_parameters)
            normal, right = normal + slopes.T @ slopes, right + slopes.T @ left
            misses, entries = misses + float(miss @ miss), entries + len(miss)
            backs[i] = (triangle, q.T @ miss, q.T @ of_parameters)
        return _Local(normal, right, misses + float(prior @ prior), misses, entries, backs)


class _Motion:
    """Misses of simulated recordings and their derivatives."""

    def __init__(
        self,
        model: ParametrisedArm,
        seen: Sight,
        dt: float,
        fields: Array,
        logs: Sequence[Array],
        errors: Array,
        input_error: float,
    ) -> None:
        self.model, self.seen, self.errors, self.input_error = model, seen, errors, input_error
        self.n_offsets = model.m if input_error > 0.0 else 0
        self.fields, self.logs, self.dt = fields[..., seen.rows], logs, positive(dt, "dt", "s")
        self.stepper = model.scene.fast_stepper(self.dt, step=STEP, stages=STAGES)

    def served(self, x: Array, i: int) -> tuple[Array, Array]:
        """Displacements (T+1, m) of recording ``i`` and their derivatives (T+1, m, Q) in the free servo parameters."""
        model, log, kept = self.model, self.logs[i], self.fields.shape[1]
        if model.servo is None:
            return log, np.zeros((*log.shape, 0))
        at = len(model.free)
        found = model.actuator(x).simulate(log, self.dt)[0][-kept:]
        slopes = np.zeros((*found.shape, len(x) - at))
        for k in range(len(x) - at):
            ahead = x.copy()
            ahead[at + k] += NUDGE
            slopes[..., k] = (model.actuator(ahead).simulate(log, self.dt)[0][-kept:] - found) / NUDGE
        return found, slopes

    def linearised(self, x: Array, first: Array, i: int) -> tuple[Array, Array, Array] | None:
        """Misses (K T+K,) of recording ``i`` in standard deviations, and their derivatives in initial state and offsets
        of the displacements, and in free parameters; None where the simulation fails."""
        model, n = self.model, 2 * self.model.scene.n_strains
        own, offset, moves = n + self.n_offsets, first[n:], model.slots["moves"]
        y, (u, of_servo) = self.fields[i], self.served(x, i)
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, moves] = u + (offset if self.n_offsets else 0.0)
        w[:, model.slots[PARAMETERS]] = model.full(x)
        constant = np.concatenate([moves[: self.n_offsets], model.slots[PARAMETERS][model.free]])  # offsets are, too
        servo = slice(n + len(constant), None)
        state, slope = np.concatenate([first[:n], w[0]]), np.zeros((n, own + len(x)))
        slope[:, :n] = np.eye(n)
        misses, slopes = [], []
        for k in range(len(y)):
            if k:
                try:
                    step = self.stepper.sensitivity(state, w[k])
                except RuntimeError:
                    return None
                slope = step.d_state[:n, :n] @ slope
                slope[:, n : servo.start] += step.d_state[:n, n + constant] + step.d_input[:n, constant]
                slope[:, servo] += step.d_state[:n, n + moves] @ of_servo[k - 1] + step.d_input[:n, moves] @ of_servo[k]
                state = step.x
            entries, jacobian = (np.asarray(v) for v in self.seen.function(state[:n]))
            misses.append((entries.ravel() - y[k]) / self.errors)
            slopes.append(jacobian @ slope / self.errors[:, None])
        if self.n_offsets:
            misses.append(offset / self.input_error)
            slopes.append(np.eye(self.n_offsets, slope.shape[1], n) / self.input_error)
        stacked = np.concatenate(slopes)
        return np.concatenate(misses), stacked[:, :own], stacked[:, own:]
