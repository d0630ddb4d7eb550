"""What sensors see of a state of an arm, with its derivative, and the state that looks most like what they saw."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from pisplit.checks import Array, positive
from pisplit.models.rod import Scene

#: Quantities that count in motion, station by station; axial strains of a stiff backbone cannot be measured.
MEASURED = ("p", "R", "w", "q", "omega")
#: Factor on the errors of curvatures at points: forms and grids differ there first, and frames say them already.
WEAK_CURVATURE = 3.0
#: Gauss-Newton steps to a state, the change of typical strains that ends them, and how much the curvatures hold it.
STEPS, SAME, FAITH = 8, 1e-9, 1e-3
#: Typical rate of strains, in parts of typical strains a second.
RATE = 10.0


class Sight:
    """What sensors see of a state [xi, xi_t], and the same entries of measured fields.

    Args:
        scene: the arm.
        stations: number S of measured points.
        names: quantities that count.
    """

    def __init__(self, scene: Scene, stations: int, names: Sequence[str] = MEASURED) -> None:
        self.scene, self.stations, self.names = scene, stations, tuple(names)
        self.quantities = np.array(scene.field_map(stations).quantities)
        self.rows = np.flatnonzero(np.isin(self.quantities, self.names))

    @cached_property
    def function(self) -> ca.Function:
        """state (2n,) -> entries (K,) and d entries / d state (K, 2n)."""
        n, fields = self.scene.n_strains, self.scene.field_map(self.stations).symbolic
        state = ca.SX.sym("state", 2 * n)
        zero, rest = ca.SX.zeros(n), ca.SX.zeros(self.scene.layout.n_acting)
        entries = fields(state[:n], state[n:], zero, rest)[self.rows.tolist()]
        return ca.Function("sight", [state], [entries, ca.jacobian(entries, state)])

    def look(self, state: Array, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """Entries (K,) of a ``state`` (2n,), their derivatives (K, 2n) in it and (K, 6) in the ``pose`` of the base.

        Fields are measured in the axes of the base: nothing depends on a pose.
        """
        y, slope = (np.asarray(v, dtype=np.float64) for v in self.function(state))
        return y.ravel(), slope, np.zeros((len(slope), 6))

    def errors(self, fields: Array, position: float, rotation: float, rate: float = 0.05) -> Array:
        """Standard deviation (K,) of every entry; quantities that never move (the clamp's) get that of others.

        Args:
            fields: measured fields (..., 24 S).
            position, rotation: of positions in m and of the entries of frames.
            rate: of other quantities, in parts of their spread.
        """
        found = np.empty(len(self.quantities))
        for name in self.names:
            of = self.quantities == name
            if name in ("p", "R"):
                found[of] = positive(position if name == "p" else rotation, f"error of {name}")
            else:
                values = fields[..., of]
                spread = float(np.sqrt(np.mean((values - values.mean(axis=(0, 1))) ** 2)))
                found[of] = positive(rate, "rate_error") * (spread or 1.0) * (WEAK_CURVATURE if name == "w" else 1.0)
        return np.asarray(found[self.rows])

    def state(self, fields: Array) -> Array:
        """The state [xi, xi_t] (2n,) that looks most like measured ``fields`` (24 S,), by least squares.

        Positions, frames and velocities decide; curvatures at points, which say what the strains between them are only
        where the grid of the scene is that of the arm, keep what they do not see. Gauss-Newton steps from the state
        whose strains are the curvatures.
        """
        start = np.asarray(self.scene.coordinates(self.stations).function(fields)).ravel()
        error, seen, state = self._relative, fields[self.rows], start
        for _ in range(STEPS):
            entries, slope = (np.asarray(v) for v in self.function(state))
            miss = np.concatenate([(entries.ravel() - seen) / error, FAITH * (state - start) / self._size])
            slopes = np.vstack([slope / error[:, None], np.diag(FAITH / self._size)])
            change = np.linalg.lstsq(slopes, miss, rcond=None)[0]
            state = state - change
            if np.abs(change / self._size).max() < SAME:
                break
        return np.asarray(state)

    @cached_property
    def _size(self) -> Array:
        """Typical strains and rates (2n,)."""
        return np.concatenate([self.scene.nominal_strains] * 2) * np.repeat([1.0, RATE], self.scene.n_strains)

    @cached_property
    def _relative(self) -> Array:
        """Errors (K,) of the entries that mean the same bend: lengths, angles, curvatures, and their rates."""
        length = self.scene.rod.length
        sizes = {"p": length, "R": 3.0, "w": 30.0 / length, "q": RATE * length, "omega": 3.0 * RATE}
        return np.array([1e-3 * sizes[name] for name in self.quantities[self.rows]])
