"""Closed loops on the model itself, whose predicted errors push it: a circle and a jump within reach."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pisplit.checks import Array
from pisplit.controllers.estimation.lifted_state import LiftedStateEstimation
from pisplit.controllers.loop.loop import ClosedLoop
from pisplit.controllers.loop.plant import PlantStep
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.controllers.mpc.mpc import MPC
from pisplit.controllers.plants.commands import DelayedCommands
from pisplit.controllers.plants.modelled import ModelPlant
from pisplit.controllers.references import Reference, from_array
from pisplit.controllers.tuning.innovations import Misses
from pisplit.lifted.model import LiftedModel

#: Part of the box that the references use, points of the circle, and steps of it at least and at most.
PART, POINTS, FASTEST, SLOWEST = 0.5, 16, 60, 200
#: Steps after a jump at least and at most, of which the last third counts.
SHORT, LONG = 60, 120


class PushedModel(ModelPlant):
    """A ``model`` that is pushed at every step by what it missed in recordings, in their order and in proportion to its
    motion: at the speed of the recordings by as much as it missed there. One of these misses pushes it all the time,
    as a load that nobody told.

    ``x_rest`` (n,): measured state where runs start; ``misses``: what was missed.
    """

    def __init__(self, model: LiftedModel, x_rest: ArrayLike, misses: Misses) -> None:
        super().__init__(model, x_rest)
        self._misses, self._lasting, self._step = misses, misses.lasting, 0
        self._last = self.x_rest

    @property
    def lifted(self) -> Array:
        """The lifted state (M,) now."""
        return self._z.copy()

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """As of the model, under ``u0`` (m,)."""
        self._step, self._last = 0, self.x_rest
        return super().reset(u0)

    def step(self, u: ArrayLike) -> PlantStep:
        """As of the model under ``u`` (m,), pushed."""
        after = super().step(u)
        if not after.ok:
            return after
        misses = self._misses
        share = min(1.0, misses.speed_of(after.state - self._last) / misses.speed)
        self._z = self._z + share * misses.lifted[self._step % len(misses.lifted)] + self._lasting
        state = self.model.read(self._z)
        self._last, self._step = state, self._step + 1
        return PlantStep(state)


class KnownState(LiftedStateEstimation):
    """An estimation that is told the lifted state, by the ``moving`` model itself. ``settings`` as for others."""

    def __init__(self, moving: PushedModel, **settings: Any) -> None:
        self._moving = moving
        super().__init__(**settings)

    def _observed(self, measured: Array) -> tuple[Array | None, int]:
        self.readout = np.zeros(self.model.n_states)
        return self._moving.lifted, 0


class InLiftedState(MPC):
    """An MPC that sees the lifted state of the ``moving`` model itself: what a model reads of its states need not lift
    to where it is, and that is no error of the loop. ``args`` and ``settings`` as for an MPC."""

    def __init__(self, moving: PushedModel, *args: Any, **settings: Any) -> None:
        self._moving = moving
        super().__init__(*args, **settings)

    def _estimation_of(self, **settings: Any) -> LiftedStateEstimation:
        return KnownState(self._moving, **settings)


@dataclass(frozen=True, eq=False)
class Trials:
    """Loops on the ``moving`` model from rest under ``u_rest`` (m,) along ``references`` of so many ``steps`` each;
    errors are in parts of ``size``, the radius of the circle, over the samples from ``after`` on. ``delay``: steps
    until a command acts."""

    moving: PushedModel
    delay: float
    u_rest: Array
    references: tuple[Reference, ...]
    steps: tuple[int, ...]
    after: tuple[int, ...]
    size: float

    def error(self, mpc: MPC, enough: float = np.inf) -> float:
        """Root mean square errors summed over the references.

        ``mpc``: the controller; ``enough``: a sum from which on no more is run. Infinite where a loop was lost.
        """
        total = 0.0
        for reference, steps, after in zip(self.references, self.steps, self.after, strict=True):
            total += self._run(mpc, reference, steps, after)
            if total >= enough:
                break
        return total

    def _run(self, mpc: MPC, reference: Reference, steps: int, after: int) -> float:
        plant = DelayedCommands(self.moving, self.delay) if self.delay else self.moving
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            log = ClosedLoop(plant, mpc).run(reference, steps, u0=self.u_rest, progress=False)
        if log.stopped:
            return np.inf
        missed = log.y[after:] - log.reference[after:]
        return float(np.sqrt(np.mean((missed**2).sum(axis=1)))) / self.size


def references_within(
    model: LiftedModel, limits: InputLimits, tracked: Sequence[int], track: str, period: float
) -> tuple[Array, Array, tuple[Reference, ...], tuple[int, ...], tuple[int, ...], float]:
    """Where the model rests in the middle of the ``limits``: state (n,) and input (m,); a circle and a jump of the
    ``tracked`` outputs, named ``track``, which are states of rest under half the box; their steps, the samples from
    which errors count, and the radius.

    The circle takes twelve times ``period`` [steps], or what the rate limits need. Raises ValueError for a model that
    comes to no rest.
    """
    centre = limits.offset + limits.basis @ limits.coordinates(0.5 * (limits.u_min + limits.u_max))
    r = limits.basis.shape[1]
    settle = int(np.clip(6.0 * period, 100, 600))
    reach = PART * _reach(limits, centre)
    angle = 2.0 * np.pi * np.arange(POINTS) / POINTS
    ways = [limits.basis[:, k] * reach[k] for k in range(r)]
    ways = _strongest(model, centre, ways, settle, tracked)
    around = [np.cos(angle), np.sin(angle)]
    u = centre + sum(np.outer(a, w) for a, w in zip(around, ways, strict=False))
    rest = _at_rest(model, np.vstack([centre, u]), settle)
    y = rest[1:, list(tracked)]
    size = float(np.sqrt(np.mean(((y - y.mean(axis=0)) ** 2).sum(axis=1))))
    if not (np.isfinite(rest).all() and size > 0.0):
        raise ValueError("the model comes to no rest under inputs inside the limits: its loops cannot be tried")
    change = np.abs(np.diff(np.vstack([u, u[:1]]), axis=0)) * POINTS / limits.du_max
    N = int(np.clip(max(12.0 * period, 1.5 * float(change.max())), FASTEST, SLOWEST))
    wave = CubicSpline(np.arange(POINTS + 1), np.vstack([y, y[:1]]), bc_type="periodic")
    turn = wave(np.arange(N // 2 + N) / N * POINTS % POINTS)
    circle = from_array(turn, model.dt, track).approached(0.4 * N * model.dt)
    tail = int(np.clip(6.0 * period, SHORT, LONG))
    corner = y[POINTS // 8]
    jump = from_array(np.vstack([rest[0, list(tracked)], *[corner] * tail]), model.dt, track)
    steps = (len(turn) - 1, tail)
    return rest[0], centre, (circle, jump), steps, (N // 2, tail - tail // 3), size


def _reach(limits: InputLimits, centre: Array) -> Array:
    """How far (r,) the inputs can go from the centre along each direction, both ways."""
    with np.errstate(divide="ignore"):
        room = np.minimum(limits.u_max - centre, centre - limits.u_min)[:, None] / np.abs(limits.basis)
    return np.asarray(room.min(axis=0))


def _strongest(
    model: LiftedModel, centre: Array, ways: list[Array], settle: int, tracked: Sequence[int]
) -> list[Array]:
    """Two of the input ``ways`` (m,) that move the outputs at rest most, and differently; one where there is one."""
    rest = _at_rest(model, np.vstack([centre, *[centre + w for w in ways]]), settle)[:, list(tracked)]
    gain = (rest[1:] - rest[0]).T
    _, _, right = np.linalg.svd(np.nan_to_num(gain), full_matrices=False)
    found = []
    for row in right[:2]:
        way = sum(c * w for c, w in zip(row, ways, strict=True))
        found.append(np.asarray(way) / max(1.0, float(np.abs(row).sum())))
    return found


def _at_rest(model: LiftedModel, u: Array, settle: int) -> Array:
    """States (K, n) to which the model comes under constant inputs u (K, m): the mean of the last quarter."""
    D = model.n_delays
    x = np.tile(model.d if model.relifted is not None else np.zeros(model.n_states), (len(u), D + 1, 1))
    z = model.lift(x, np.repeat(u[:, None], D, axis=1))
    run = model.rollout(z, np.repeat(u[:, None], settle, axis=1))
    return np.asarray(run.x[:, -settle // 4 :].mean(axis=1))
