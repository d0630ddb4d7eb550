"""The least-squares problem of a calibration from recordings, linearised, initial states eliminated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pisplit.checks import Array
from pisplit.models.calibration.model import ParametrisedArm
from pisplit.models.calibration.motion import Known, Motion, Nearby, Simulated
from pisplit.models.calibration.resting_shapes import RestingShapes

#: Smallest slope of misses in an initial state, in parts of the largest: what no sensor sees stays as it is.
UNSEEN = 1e-7
#: Largest change of a parameter in one step.
TRUSTED = 0.7
#: Rise of the sum of squares beyond which it does not matter how much it rises.
ENOUGH = 10.0
#: Weight by which states are held back, in parts of their energy, beside that of the parameters.
STATES = 1e3


@dataclass(frozen=True)
class Back:
    """What is kept of one recording to go back to its initial state.

    Attributes:
        triangle: R of the derivative Q R of its misses in the initial state.
        miss: Q^T of the misses; slope: Q^T of their derivative in the parameters.
        held: (n, n) by which a long step of the state is held back; zero where the linear problem says all.
    """

    triangle: Array
    miss: Array
    slope: Array
    held: Array

    def change(self, change: Array, weight: float) -> Array:
        """Of the initial state, with a ``change`` (P,) of the parameters, held back by ``weight``."""
        right = self.miss + self.slope @ change
        if weight == 0.0:
            return -np.asarray(np.linalg.solve(self.triangle, right))
        r = self.triangle
        return -np.asarray(np.linalg.solve(r.T @ r + weight * self.held, r.T @ right))

    def kept(self, weight: float) -> tuple[Array, Array]:
        """What holding the state back by ``weight`` leaves to the parameters, beyond equations with a free state."""
        r = self.triangle
        free = np.linalg.solve(r.T @ r + weight * self.held, r.T)
        rest = np.eye(len(r)) - r @ free
        return self.slope.T @ rest @ self.slope, self.slope.T @ rest @ self.miss


@dataclass(frozen=True, eq=False)
class Missed:
    """What is missed at a point: parameters and initial states.

    Attributes:
        prior: distance (P,) of the parameters from the first guess, in standard deviations.
        rest: misses of shapes at rest; empty without.
        motions: each recording that could be simulated.
        lost: number of those that could not.
    """

    prior: Array
    rest: Array
    motions: Mapping[int, Simulated]
    lost: int

    @cached_property
    def cost(self) -> float:
        """Sum of squares of all that is to be small."""
        parts = [self.prior, self.rest, *(found.misses for found in self.motions.values())]
        return sum(float(part @ part) for part in parts)

    def better(self, other: Missed) -> bool:
        """Whether it is no worse than the ``other``, and no recording was lost."""
        return self.lost < other.lost or (self.lost == other.lost and self.cost <= other.cost)


@dataclass(frozen=True)
class Local:
    """The problem about a point: normal equations of the parameters, initial states eliminated.

    Attributes:
        normal, right: matrix (P, P) and right side (P,).
        missed: what is missed there.
        misses, entries: sum of squares of what was measured, and how many numbers that is.
        backs: each simulated recording.
        nearby: steps of each of them, from which those of others are looked for.
    """

    normal: Array
    right: Array
    missed: Missed
    misses: float
    entries: float
    backs: Mapping[int, Back]
    nearby: Mapping[int, Nearby]

    @property
    def used(self) -> int:
        """Number of recordings that could be simulated."""
        return len(self.backs)

    def damped(self, weight: float) -> tuple[Array, Array]:
        """Matrix (P, P) and right side (P,) of a step that is held back, with the initial states, by ``weight``."""
        normal, right = self.normal + weight * np.diag(np.diag(self.normal)), self.right
        for back in self.backs.values() if weight > 0.0 else ():
            if back.held.any():
                more, beside = back.kept(STATES * weight)
                normal, right = normal + more, right + beside
        return normal, right

    def moved(self, first: Array, change: Array, weight: float) -> Array:
        """Initial states ``first`` (N, n), moved with a ``change`` (P,) of the parameters, held back by ``weight``."""
        found = first.copy()
        for i, back in self.backs.items():
            found[i] += back.change(change, STATES * weight if back.held.any() else 0.0)
        return found


@dataclass(frozen=True)
class Problem:
    """Misses of recordings (``motion``) and of shapes at rest (``rest``), and the first guess of the ``model``."""

    model: ParametrisedArm
    motion: Motion
    rest: RestingShapes | None

    def weighed_down(self, factor: float) -> Problem:
        """The same with sensors whose errors are larger by a ``factor``."""
        rest = None if self.rest is None else self.rest.weighed_down(factor)
        return replace(self, motion=self.motion.weighed_down(factor), rest=rest)

    def shortened(self, steps: int) -> Problem:
        """The same with the first ``steps`` of every recording alone."""
        return replace(self, motion=self.motion.shortened(steps))

    def change(self, x: Array, local: Local, weight: float) -> Array:
        """A damped Gauss-Newton step from ``x`` (P,), where the problem is ``local``, not too long and above bounds.

        ``weight`` holds it back.
        """
        model = self.model
        free, (matrix, right) = np.ones(len(x), dtype=bool), local.damped(weight)
        for _ in range(len(x)):
            step = np.zeros(len(x))
            step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], right[free])
            step *= min(1.0, TRUSTED / max(float(np.abs(step).max()), 1e-300))
            outside = free & (x + step < model.low)
            if not outside.any():
                return step
            held = outside & (x <= model.low)
            if not held.any():  # up to the bound, this time
                return np.maximum(x + step, model.low) - x
            free &= ~held
        return np.zeros(len(x))

    def standard_errors_left(self, x: Array, local: Local) -> float:
        """Length of an undamped step from ``x`` (P,), where the problem is ``local``, in standard errors of the
        parameters, root mean square."""
        step, misfit = self.change(x, local, 0.0), max(1.0, local.misses / local.entries)
        return float(np.sqrt(max(float(step @ local.normal @ step), 0.0) / (misfit * len(x))))

    def missed(
        self, x: Array, first: Array, near: Local | None = None, known: Mapping[int, Known] | None = None
    ) -> Missed:
        """What is missed by parameters ``x`` (P,) and initial states ``first`` (N, 2n).

        It is looked for from a point ``near``, or from steps that are ``known``. What is worse than the point ``near``
        is not looked at to the end: recordings are simulated until one more is lost than there, or until the sum of
        squares is larger.
        """
        steps: Mapping[int, Nearby | Known] = (known or {}) if near is None else near.nearby
        rest = np.zeros(0) if self.rest is None else self.rest.misses(x)
        found = Missed(self.model.prior(x), rest, {}, 0)
        allowed, limit = len(first), np.inf
        if near is not None:
            allowed = near.missed.lost
            limit = near.missed.cost + ENOUGH if allowed == 0 else np.inf
        motions: dict[int, Simulated] = {}
        lost, cost = 0, found.cost
        for i, start in enumerate(first):
            moved = self.motion.simulated(x, start, i, steps.get(i))
            if moved is None:
                lost += 1
            else:
                motions[i] = moved
                cost += float(moved.misses @ moved.misses)
            if lost > allowed or cost > limit:
                break
        return replace(found, motions=motions, lost=lost)

    def linearised(self, x: Array, missed: Missed) -> Local:
        """The problem about parameters ``x`` (P,), and initial states, by which so much is ``missed``."""
        spread = self.model.width
        normal, right = np.diag(1.0 / spread**2), missed.prior / spread
        misses, entries = 0.0, 0.0
        if self.rest is not None:
            slope = self.rest.slope(x)
            normal, right = normal + slope.T @ slope, right + slope.T @ missed.rest
            misses, entries = float(missed.rest @ missed.rest), float(len(missed.rest))
        backs: dict[int, Back] = {}
        nearby: dict[int, Nearby] = {}
        for i, found in missed.motions.items():
            miss = found.misses
            of_state, of_parameters, nearby[i] = self.motion.linearised(found, len(x), i)
            states = of_state.shape[1] - self.motion.n_offsets
            parts = np.abs(of_state[:, :states]).reshape(len(miss), 2, -1)  # of shapes and of rates
            floor = np.repeat(UNSEEN * parts.max(axis=(0, 2)), states // 2)
            kept = np.diag(np.concatenate([floor, np.zeros(self.motion.n_offsets)]))
            q, triangle = np.linalg.qr(np.vstack([of_state, kept]))
            q = q[: len(miss)]
            left, slopes = miss - q @ (q.T @ miss), of_parameters - q @ (q.T @ of_parameters)
            normal, right = normal + slopes.T @ slopes, right + slopes.T @ left
            seen, taken = self.motion.counted(i, miss, triangle)
            misses, entries = misses + seen, entries + taken
            backs[i] = Back(triangle, q.T @ miss, q.T @ of_parameters, self.motion.held(i))
        return Local(normal, right, missed, misses, entries, backs, nearby)
