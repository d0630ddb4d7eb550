"""The state of an arm now, from what a few markers showed until now and the commands: no fields, no velocities."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array
from pisplit.models.arm.energy_prior import energy_root, moving_energy
from pisplit.models.arm.kinematic_state import kinematic_state
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.arm.motion_capture import MotionCapture

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Gauss-Newton steps; the change in standard deviations before anything was measured, and the fall of the sum of
#: squares, that end them; factors of the weight that holds a step back.
STEPS, SAME, LITTLE, EASED, STIFFENED = 12, 1e-3, 0.05, 0.2, 5.0
#: Instants, before all of them, that a fit is led through: short motions are nearly linear in their start.
HORIZONS = (3, 5, 9)


@dataclass(frozen=True)
class MarkerState:
    """A state found from markers.

    Attributes:
        state: [xi, xi_t] (2n,) at the last instant.
        residual: root mean square of what the markers are missed by, in standard deviations.
        covariance: (2n, 2n) of the state, by the noise of the markers and what the state was held to.
    """

    state: Array
    residual: float
    covariance: Array


@dataclass(frozen=True)
class _Local:
    """Misses of a motion from a start and their derivative in it; its end, and that in the start."""

    start: Array
    miss: Array
    slope: Array
    end: Array
    onwards: Array


class MarkerFit:
    """Least squares over the state a few instants ago: the arm's own motion from there has to pass the markers.

    What they do not show is held to the shape at rest under the displacements of that time, by energy. A window of
    moving-horizon estimation (Rao, Rawlings, Mayne, IEEE Trans. Automatic Control 48, 2003) with the prior of rest.

    Args:
        arm: what moves.
        capture: its markers.
        dt: time between instants in s.
    """

    def __init__(self, arm: Arm, capture: MotionCapture, dt: float) -> None:
        self.arm, self.sight, self.dt = arm, MarkerSight(arm.scene, capture), dt
        self.energy = moving_energy(arm)

    @cached_property
    def _stepper(self) -> Any:
        return self.arm.scene.fast_stepper(self.dt)

    def __call__(self, columns: Array, moves: Array) -> MarkerState:
        """The state at the last of H+1 instants.

        Args:
            columns: (H+1, K) of the markers; NaN: lost.
            moves: displacements (H+1, m) in m at these instants, linear in between.

        Raises RuntimeError where the arm does not rest under the first displacements, or cannot be moved from there.
        """
        scene = self.arm.scene
        n, found = scene.n_strains, scene.statics().solve(moves[0])
        if not found.success:
            raise RuntimeError(
                f"the arm does not rest under the displacements {moves[0].tolist()} m: no start is known"
            )
        rest = found.state[:n]
        root = energy_root(scene, rest, moves[0], self.energy, self.dt)
        state = kinematic_state(self.sight, columns, self.dt, rest, root)
        mean = np.concatenate([rest, np.zeros(n)])
        held = mean, root
        best = None
        for instants in [*(k for k in HORIZONS if k < len(columns)), len(columns)]:
            best = self._settled(state, columns[:instants], moves, held) or self._settled(
                mean, columns[:instants], moves, held
            )
            if best is None:
                raise RuntimeError("the arm cannot be moved under the displacements before the start")
            state = best.start
        assert best is not None
        miss, slope, end, onwards = best.miss, best.slope, best.end, best.onwards
        covariance = onwards @ np.linalg.inv(slope.T @ slope) @ onwards.T
        entries = max(1, int(np.isfinite(columns).sum()))
        return MarkerState(end, float(np.sqrt(miss @ miss / entries)), np.asarray(covariance))

    def _settled(self, start: Array, columns: Array, moves: Array, held: tuple[Array, Array]) -> _Local | None:
        """Damped Gauss-Newton steps from a ``start``; None where it cannot be moved."""
        root = held[1]
        best, weight = self._linearised(start, columns, moves, held), 0.2
        if best is None:
            return None
        for _ in range(STEPS):
            rows = np.vstack([best.slope, np.sqrt(weight) * root])
            change = np.linalg.lstsq(rows, np.concatenate([-best.miss, np.zeros(len(root))]), rcond=None)[0]
            tried = self._linearised(best.start + change, columns, moves, held)
            fell = -np.inf if tried is None else float(best.miss @ best.miss - tried.miss @ tried.miss)
            if tried is not None and fell >= 0.0:
                best, weight = tried, EASED * weight
            else:
                weight = max(STIFFENED * weight, 0.2)
            if np.linalg.norm(root @ change) < SAME or 0.0 <= fell < LITTLE:
                break
        return best

    def _linearised(self, start: Array, columns: Array, moves: Array, held: tuple[Array, Array]) -> _Local | None:
        """The problem about a ``start`` (2n,), ``held`` to a mean by a root of its precision; None where it fails."""
        mean, root = held
        n = len(mean)
        state, slope = np.concatenate([start, moves[0]]), np.eye(n)
        misses, slopes = [root @ (start - mean)], [root]
        for k, row in enumerate(columns):
            if k:
                try:
                    step = self._stepper.sensitivity(state, moves[k])
                except RuntimeError:
                    return None
                slope, state = step.d_state[:n, :n] @ slope, step.x
            y, of_state, _ = self.sight.look(state[:n])
            weight = np.isfinite(row) / self.sight.sizes
            misses.append(np.where(weight > 0.0, y - row, 0.0) * weight)
            slopes.append(of_state @ slope * weight[:, None])
        return _Local(start, np.concatenate(misses), np.vstack(slopes), state[:n], slope)
