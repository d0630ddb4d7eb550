"""Identify an arm from short noisy recordings: output error with unknown initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, non_negative, positive
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.calibration.model import Calibration, ParametrisedArm
from pisplit.models.calibration.parameters import TendonParameters
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.calibration.resting_shapes import RestingShapes
from pisplit.models.rod import Scene
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Internal steps of the integrator in s: its error stays far below that of measurements.
STEP = 0.01
#: Gauss-Newton ends when no free parameter, of order one, changes by more, or the sum of squares falls by a smaller
#: part; and after so many steps.
CONVERGED, UNLIKELIER, STEPS = 5e-3, 1e-4, 30
#: Factors of Marquardt's weight after a step that was taken and one that was not.
EASED, STIFFENED = 0.5, 5.0
#: Weight above which a short step only says that it was held back.
HELD_BACK = 0.1
#: Smallest slope of misses in an initial state, in parts of the largest: what no sensor sees stays as it is.
UNSEEN = 1e-7
#: Relative change, and number of steps, that end the fit to shapes at rest where that to recordings starts.
SHAPES_DIGITS, SHAPES_STEPS = 1e-3, 20
#: Largest change of a parameter in one step.
TRUSTED = 0.7
#: Quantities that count, station by station; axial strains of a stiff backbone cannot be measured.
MEASURED = ("p", "R", "w", "q", "omega")


def calibrate_from_recordings(
    arm: TendonArm,
    fields: ArrayLike,
    inputs: ArrayLike,
    dt: float,
    position_error: float = 1e-3,
    rotation_error: float = 0.02,
    rate_error: float = 0.05,
    stations: int = 6,
    free: Sequence[str] = ("damping",),
    start: TendonParameters | None = None,
    equilibria: tuple[ArrayLike, ArrayLike] | None = None,
    input_error: float = 0.0,
) -> Calibration:
    """Parameters whose motion looks like noisy recordings, and the initial state of each of them.

    One-step predictions from measured states (``calibrate_from_pairs``) are exact for exact states and biased for noisy
    ones: noise of the velocities makes the arm look less damped. Here the initial state of every recording is
    unknown too, and all of its instants count by the errors of their sensors. Initial states are eliminated from every
    Gauss-Newton step (variable projection: Golub, Pereyra, *The differentiation of pseudo-inverses and nonlinear least
    squares problems whose variables separate*, SIAM J. Numer. Anal. 1973).

    Args:
        fields: measured fields (N, T+1, 24 S) at T+1 instants of N recordings; a few steps each are enough.
        inputs: displacements (N, T+1, m) in m at these instants; they move linearly in between.
        dt: time between the instants in s.
        stations: their number S.
        position_error, rotation_error: standard deviations of positions in m and of the entries of frames.
        rate_error: that of curvatures and velocities, in parts of their spread in the recordings.
        arm, free, start: as in ``calibrate_from_pairs``.
        equilibria: displacements (M, m) in m and measured fields (M, 24 S) at rest under them, which count too.
        input_error: standard deviation in m of the displacements, such as a play between servo and tendons makes: each
            recording and each equilibrium then has unknown displacements too, the measured ones and a constant.

    ``residual`` of the result is in standard deviations of the measurement. Raises RuntimeError where no recording can
    be simulated; ``success`` is False where the steps did not converge, or some recordings could not be simulated.
    """
    y = finite_array(fields, "fields", (None, None, N_FIELDS * stations))
    u = finite_array(inputs, "inputs", (len(y), y.shape[1], arm.scene.n_inputs))
    if y.shape[1] < 2:
        raise ValueError("recordings hold one instant; expected two or more")
    model = ParametrisedArm(arm, start, free)
    seen = _Sight(model.scene, stations)
    play = non_negative(input_error, "input_error", "m")
    motion = _Motion(model, seen, dt, y, u, seen.errors(y, position_error, rotation_error, rate_error), play)
    first = np.asarray(model.scene.coordinates(stations).function.map(len(y))(y[:, 0].T)).T
    first = np.hstack([first, np.zeros((len(y), motion.n_offsets))])
    rest, x, weight, converged = None, model.start[model.free], 0.0, False
    if equilibria is not None:
        rest = RestingShapes(model, *equilibria, position_error, rotation_error, stations, play)
    problem = _Problem(model, motion, rest)
    best = problem.linearised(x, first)
    if rest is not None:
        resting = np.asarray(rest.fit(SHAPES_DIGITS, SHAPES_STEPS).x, dtype=np.float64)
        tried = problem.linearised(resting, first)
        if tried.better(best):  # shapes at rest alone may leave an arm that cannot be moved
            x, best = resting, tried
    if not best.used:
        raise RuntimeError("no recording could be simulated; check that fields and inputs belong to this arm")
    for _ in range(STEPS):
        damped = best.normal + weight * np.diag(np.diag(best.normal))
        wanted = -np.linalg.solve(damped, best.right)
        change = np.asarray(min(1.0, TRUSTED / max(float(np.abs(wanted).max()), 1e-300)) * wanted, dtype=np.float64)
        start_of = best.moved(first, change)
        tried = problem.linearised(x + change, start_of)
        small = bool(np.abs(change).max() < CONVERGED)
        if tried.better(best):
            still = tried.used == best.used and best.cost - tried.cost < UNLIKELIER * best.cost
            converged = weight <= HELD_BACK and (small or still)
            x, first, best, weight = x + change, start_of, tried, EASED * weight
        else:
            weight = max(STIFFENED * weight, 1e-3)
            if small:  # uphill however short the step: the end, but not one to rely on
                break
        if converged:
            break
    return model.result(x, float(np.sqrt(best.misses / best.entries)), best.used, converged and best.used == len(y))


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

    def linearised(self, x: Array, first: Array) -> _Local:
        """The problem about parameters ``x`` (P,) and initial states ``first`` (N, 2n)."""
        prior, spread = self.model.prior(x), self.model.spread[self.model.free]
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


class _Sight:
    """What sensors see of a state [xi, xi_t], with its derivative; the same entries of measured fields."""

    def __init__(self, scene: Scene, stations: int) -> None:
        self.scene, self.stations = scene, stations
        self.quantities = np.array(scene.field_map(stations).quantities)
        self.rows = np.flatnonzero(np.isin(self.quantities, MEASURED))

    @cached_property
    def function(self) -> ca.Function:
        """state (2n,) -> entries (K,) and d entries / d state (K, 2n)."""
        n, fields = self.scene.n_strains, self.scene.field_map(self.stations).symbolic
        state = ca.SX.sym("state", 2 * n)
        zero, rest = ca.SX.zeros(n), ca.SX.zeros(self.scene.n_inputs)
        entries = fields(state[:n], state[n:], zero, rest)[self.rows.tolist()]
        return ca.Function("sight", [state], [entries, ca.jacobian(entries, state)])

    def errors(self, fields: Array, position: float, rotation: float, rate: float) -> Array:
        """Standard deviation (K,) of every entry; quantities that never move (the clamp's) get that of others."""
        found = np.empty(len(self.quantities))
        for name in MEASURED:
            of = self.quantities == name
            if name in ("p", "R"):
                found[of] = positive(position if name == "p" else rotation, f"error of {name}")
            else:
                values = fields[..., of]
                spread = float(np.sqrt(np.mean((values - values.mean(axis=(0, 1))) ** 2)))
                found[of] = positive(rate, "rate_error") * (spread or 1.0)
        return np.asarray(found[self.rows])


class _Motion:
    """Misses of simulated recordings and their derivatives."""

    def __init__(
        self,
        model: ParametrisedArm,
        seen: _Sight,
        dt: float,
        fields: Array,
        inputs: Array,
        errors: Array,
        input_error: float,
    ) -> None:
        self.model, self.seen, self.errors, self.input_error = model, seen, errors, input_error
        self.n_offsets = model.m if input_error > 0.0 else 0
        self.fields, self.inputs = fields[..., seen.rows], inputs
        self.stepper = model.scene.stepper(positive(dt, "dt", "s"), step=STEP)

    def linearised(self, x: Array, first: Array, i: int) -> tuple[Array, Array, Array] | None:
        """Misses (K T+K,) of recording ``i`` in standard deviations, and their derivatives in initial state and offsets
        of the displacements, and in free parameters; None where the simulation fails."""
        model, n = self.model, 2 * self.model.scene.n_strains
        own, offset = n + self.n_offsets, first[n:]
        y, u = self.fields[i], self.inputs[i]
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, model.slots["moves"]] = u + (offset if self.n_offsets else 0.0)
        w[:, model.slots[PARAMETERS]] = model.full(x)
        parameters = np.concatenate(
            [model.slots["moves"][: self.n_offsets], model.slots[PARAMETERS][model.free]]
        )  # offsets of displacements are constant, too
        state, slope = np.concatenate([first[:n], w[0]]), np.zeros((n, own + len(model.free)))
        slope[:, :n] = np.eye(n)
        misses, slopes = [], []
        for k in range(len(y)):
            if k:
                try:
                    step = self.stepper.sensitivity(state, w[k])
                except RuntimeError:
                    return None
                of_parameters = step.d_state[:n, n + parameters] + step.d_input[:n, parameters]
                slope = step.d_state[:n, :n] @ slope
                slope[:, n:] += of_parameters
                state = step.x
            entries, jacobian = (np.asarray(v) for v in self.seen.function(state[:n]))
            misses.append((entries.ravel() - y[k]) / self.errors)
            slopes.append(jacobian @ slope / self.errors[:, None])
        if self.n_offsets:
            misses.append(offset / self.input_error)
            slopes.append(np.eye(self.n_offsets, slope.shape[1], n) / self.input_error)
        stacked = np.concatenate(slopes)
        return np.concatenate(misses), stacked[:, :own], stacked[:, own:]
