"""Simulated recordings against measured ones: misses and their derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array, positive
from pisplit.models.arm.energy_prior import energy_root
from pisplit.models.arm.kinematic_state import kinematic_state
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.arm.sight import Sight
from pisplit.models.calibration.followed import FollowedShapes
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.parametrised import PARAMETERS
from pisplit.models.rod.dynamics.march import Hint, March, Piece

#: Internal steps of the integrator in s, and their Radau stages: the error stays far below that of measurements, and
#: friction that turns round is damped.
STEP, STAGES = 0.015, 2
#: The same for markers, whose noise of tenths of a millimetre shows where a step was halved.
FINE_STEP, FINE_STAGES = 0.02, 3
#: Corrections of strains, in parts of typical ones, that end the iterations of a step: far below any sensor.
TOLERANCE = 1e-8
#: Contraction of the iterations of a step beyond which a new matrix is cheaper.
SLOW = 0.5
#: How often a step is halved before the motion counts as failed: parameters under which it takes more are given up.
HALVINGS = 6
#: Change of lag and play, in their typical sizes, by which commands are differentiated.
NUDGE = 1e-3


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording as it was simulated, and what its derivatives are made of.

    Attributes:
        point: initial state and offsets, free parameters (2n + offsets + P,).
        misses: (K T+K,) in standard deviations, those of the initial state and of offsets beside them.
        intervals: steps of the integrator between the instants.
        seen: columns, their derivatives in the state and in the pose at every instant (``Sight.look``).
        of_servo: derivatives (T+1, m, Q) of the displacements in the free servo parameters.
        of_rest: those (n, Q + P) of the shape at rest that the initial state is told from; empty where it is not.
    """

    point: Array
    misses: Array
    intervals: tuple[list[Piece], ...]
    seen: tuple[tuple[Array, Array, Array], ...]
    of_servo: Array
    of_rest: Array


@dataclass(frozen=True, eq=False)
class Nearby:
    """A recording as it was simulated, ``found``, and the derivatives of every step of it in its ``point``.

    ``of_steps``: of the accelerations (s, n, 2n + offsets + P) of each step between the instants, and the inverse of
    its matrix.
    """

    found: Simulated
    of_steps: tuple[list[tuple[Array, Array]], ...]

    def hints(self, point: Array) -> list[list[Hint]]:
        """What to expect of every step from another ``point``, to first order."""
        change = point - self.found.point
        return [
            [
                Hint(piece.z + (d_z @ change).T, piece.h, inverse)
                for piece, (d_z, inverse) in zip(pieces, slopes, strict=True)
            ]
            for pieces, slopes in zip(self.found.intervals, self.of_steps, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Known:
    """Steps of a recording under other parameters, ``steps`` by instants: where those nearby are looked for first."""

    steps: list[list[Hint]]

    @classmethod
    def of(cls, found: Simulated, of_steps: Sequence[Sequence[tuple[Array, Array]]]) -> Known:
        """Those of a recording as it was ``found``, with the inverse matrices ``of_steps``."""
        return cls(
            [
                [Hint(piece.z, piece.h, inverse) for piece, (_, inverse) in zip(pieces, slopes, strict=True)]
                for pieces, slopes in zip(found.intervals, of_steps, strict=True)
            ]
        )

    def hints(self, point: Array) -> list[list[Hint]]:
        """The same wherever the ``point`` is."""
        return self.steps


class Motion:
    """Misses of simulated recordings and their derivatives.

    Args:
        model: the arm with its free parameters.
        seen: what is measured.
        dt: time between the instants in s.
        measured: (N, T+1, K) columns of ``seen``; NaN: lost.
        logs: commands (D, m) of every recording, the last T+1 of them at its instants.
        errors: standard deviations (K,) of the columns.
        input_error: that of constant offsets of the displacements in m, 0 for none.
        energy: in J of every mode about the shape at rest under the first displacements, which initial states are then
            told from and held to; None: they are states, and the columns tell them whole.
    """

    def __init__(
        self,
        model: ParametrisedArm,
        seen: Sight | MarkerSight,
        dt: float,
        measured: Array,
        logs: Sequence[Array],
        errors: Array,
        input_error: float,
        energy: float | None = None,
    ) -> None:
        self.model, self.seen, self.errors, self.input_error = model, seen, errors, input_error
        self.n_offsets = model.m if input_error > 0.0 else 0
        self.measured, self.logs, self.dt = measured, logs, positive(dt, "dt", "s")
        step, stages = (STEP, STAGES) if energy is None else (FINE_STEP, FINE_STAGES)
        self.stepper = model.stepper(self.dt, step, stages)
        self.energy, self._followed = energy, FollowedShapes(model.scene, len(measured))
        self.roots: dict[int, Array] = {}

    def resting(self, x: Array, first: Array, i: int) -> tuple[Array, Array] | None:
        """Shape at rest (n,) under the first displacements of recording ``i`` and its derivative (n, Q + P) in offsets
        and free parameters; None where there is none. ``first`` (2n + offsets,): the initial
        state from it, and offsets; ``x`` (P,) are the free parameters."""
        model, n = self.model, 2 * self.model.scene.n_strains
        u, of_servo = self.served(x, i)
        w = np.zeros(model.scene.n_inputs)
        w[model.slots["moves"]] = u[0] + (first[n:] if self.n_offsets else 0.0)
        w[model.slots[PARAMETERS]] = model.full(x)
        found = self._followed.solved(i, w)
        if found is None:
            return None
        strains, of_w = found
        moves = of_w[:, model.slots["moves"]]
        blocks = [moves[:, : self.n_offsets], of_w[:, model.slots[PARAMETERS]][:, model.free], moves @ of_servo[0]]
        if i not in self.roots and self.energy is not None:
            self.roots[i] = energy_root(model.scene, strains, w, self.energy, self.dt)
        return strains, np.hstack([*blocks, np.zeros((len(strains), model.n_pose))])

    def first_guess(self, x: Array) -> Array:
        """(N, 2n + offsets) from where the markers are and go at first, told from rest; ``x`` (P,) free parameters.

        Raises RuntimeError where the arm does not rest under the first displacements of a recording.
        """
        assert isinstance(self.seen, MarkerSight)
        found = np.zeros((len(self.measured), 2 * self.model.scene.n_strains + self.n_offsets))
        for i, rows in enumerate(self.measured):
            rest = self.resting(x, found[i], i)
            if rest is None:
                raise RuntimeError(f"the arm as drawn does not rest under the first displacements of recording {i}")
            strains, n = rest[0], 2 * len(rest[0])
            state = kinematic_state(self.seen, rows, self.dt, strains, self.roots[i], self.model.pose(x))
            found[i, :n] = state - np.concatenate([strains, np.zeros(len(strains))])
        return found

    def weighed_down(self, factor: float) -> Motion:
        """The same recordings with sensors whose errors are larger by a ``factor``."""
        found = copy(self)
        found.errors = factor * self.errors
        return found

    def shortened(self, steps: int) -> Motion:
        """The first ``steps`` of the same recordings."""
        found, less = copy(self), self.measured.shape[1] - 1 - steps
        found.measured = self.measured[:, : steps + 1]
        found.logs = [log[: len(log) - less] for log in self.logs]
        return found

    def held(self, i: int) -> Array:
        """(2n + offsets) squared: energy of recording ``i`` at the start, by which long steps of it are held back."""
        n = 2 * self.model.scene.n_strains
        found = np.zeros((n + self.n_offsets,) * 2)
        if i in self.roots:
            found[:n, :n] = self.roots[i].T @ self.roots[i]
        return found

    def counted(self, i: int, miss: Array, triangle: Array) -> tuple[float, float]:
        """Sum of squares of what is measured of recording ``i``, and how many numbers that is.

        Where an initial state is held to rest, what the columns tell of it is taken off: it is fitted to them.
        ``miss``: all misses; ``triangle``: as in ``Back``.
        """
        if i not in self.roots:
            return float(miss @ miss), float(len(miss))
        n = len(self.roots[i])
        told = n - float(np.linalg.norm(self.roots[i] @ np.linalg.inv(triangle)[:n]) ** 2)
        return float(miss[n:] @ miss[n:]), float(np.isfinite(self.measured[i]).sum()) - told

    def unseen(self, triangles: Mapping[int, Array]) -> tuple[float, float]:
        """Parts of the prior spread of the tip's tilt and of its twist at the start that the columns leave.

        ``triangles``: of the derivatives in the initial states (``Back``), by recording.
        """
        scene, n = self.model.scene, self.model.scene.n_strains
        kinds = np.array([[c == axis for c in scene.rod.strain_set.free] for axis in range(3)], dtype=float)
        turns = np.array(
            [np.kron(scene.rule.weights, kind) for kind in kinds]
        )  # of the tip, where it is nearly straight

        def spread(roots: Iterable[Array]) -> Array:
            each = [np.linalg.norm(turns @ np.linalg.inv(root)[:n], axis=1) for root in roots]
            return np.asarray(np.sqrt(np.mean(np.square(each), axis=0)))

        before, after = spread(self.roots[i] for i in triangles), spread(triangles.values())
        left = after / np.where(before > 0.0, before, np.inf)
        return float(left[:2].max()), float(left[2])

    def served(self, x: Array, i: int) -> tuple[Array, Array]:
        """Displacements (T+1, m) of recording ``i`` and their derivatives (T+1, m, Q) in the free servo parameters,
        which are part of ``x`` (P,)."""
        model, log, kept = self.model, self.logs[i], self.measured.shape[1]
        if model.servo is None:
            return log, np.zeros((*log.shape, 0))
        found = model.actuator(x).simulate(log, self.dt)[0][-kept:]
        slopes = np.zeros((*found.shape, len(model.servo_entries)))
        for k, at in enumerate(model.servo_entries):
            ahead = x.copy()
            ahead[at] += NUDGE
            slopes[..., k] = (model.actuator(ahead).simulate(log, self.dt)[0][-kept:] - found) / NUDGE
        return found, slopes

    def simulated(self, x: Array, first: Array, i: int, near: Nearby | Known | None = None) -> Simulated | None:
        """Recording ``i`` from its initial state and offsets of the displacements, ``first`` (2n + offsets,), under
        free parameters ``x`` (P,), looked for from one ``near``; None where the motion fails."""
        model, n = self.model, 2 * self.model.scene.n_strains
        moves, (u, of_servo), pose = model.slots["moves"], self.served(x, i), model.pose(x)
        w = np.zeros((len(u), model.scene.n_inputs))
        w[:, moves] = u + (first[n:] if self.n_offsets else 0.0)
        w[:, model.slots[PARAMETERS]] = model.full(x)
        state, rest, of_rest = first[:n].copy(), [], np.zeros((0, 0))
        if self.energy is not None:
            found = self.resting(x, first, i)
            if found is None:
                return None
            strains, of_rest = found
            state[: n // 2] += strains
            rest = [self.roots[i] @ first[:n]]
        hints = None if near is None else near.hints(np.concatenate([first, x]))
        march, intervals, seen = March(self.stepper.collocation, TOLERANCE, SLOW, HALVINGS), [], []
        for k, y in enumerate(self.measured[i]):
            if k:
                try:
                    known = hints[k - 1] if hints else ()
                    pieces = march.interval(state, w[k - 1], w[k], self.dt, self.stepper.substeps, known)
                except RuntimeError:
                    return None
                intervals.append(pieces)
                state = pieces[-1].end
            seen.append(self.seen.look(state[:n], pose))
            weights = np.isfinite(y) / self.errors
            rest.append(np.where(weights > 0.0, seen[-1][0] - y, 0.0) * weights)
        if self.n_offsets:
            rest.append(first[n:] / self.input_error)
        return Simulated(
            np.concatenate([first, x]), np.concatenate(rest), tuple(intervals), tuple(seen), of_servo, of_rest
        )

    def linearised(self, found: Simulated, size: int, i: int) -> tuple[Array, Array, Nearby]:
        """Derivatives of the misses of recording ``i``, which moved as it was ``found``, in its initial state and
        offsets, (K T+K, 2n + offsets), and in the ``size`` free parameters, (K T+K, P); those of its steps."""
        model, n = self.model, 2 * self.model.scene.n_strains
        own, m = n + self.n_offsets, model.scene.n_inputs
        slope, d_inputs = np.zeros((n, own + size)), np.zeros((len(found.seen), m, own + size))
        slope[:, :n] = np.eye(n)
        d_inputs[:, model.slots["moves"][: self.n_offsets], range(n, own)] = 1.0
        d_inputs[:, model.slots[PARAMETERS][model.free], range(own, own + len(model.free))] = 1.0
        servo = own + len(model.free)
        d_inputs[:, model.slots["moves"], servo : servo + found.of_servo.shape[2]] = found.of_servo
        slopes, of_steps = [], []
        if self.energy is not None:
            slope[: n // 2, n:] = found.of_rest
            slopes.append(np.hstack([self.roots[i], np.zeros((n, slope.shape[1] - n))]))
        for k, (_, jacobian, of_pose) in enumerate(found.seen):
            time, of_pieces = 0.0, []
            for piece in found.intervals[k - 1] if k else ():
                parts = np.array([time, time + piece.h]) / self.dt
                ends = d_inputs[k - 1] + parts[:, None, None] * (d_inputs[k] - d_inputs[k - 1])
                slope, d_z, inverse = self.stepper.carried(piece, slope, ends)
                time += piece.h
                of_pieces.append((d_z, inverse))
            if k:
                of_steps.append(of_pieces)
            seen = jacobian @ slope
            if model.n_pose:
                seen[:, -model.n_pose :] = of_pose * model.pose_unit
            slopes.append(seen * (np.isfinite(self.measured[i, k]) / self.errors)[:, None])
        if self.n_offsets:
            slopes.append(np.eye(self.n_offsets, slope.shape[1], n) / self.input_error)
        stacked = np.concatenate(slopes)
        return stacked[:, :own], stacked[:, own:], Nearby(found, tuple(of_steps))
