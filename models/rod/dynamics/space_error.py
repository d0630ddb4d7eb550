"""Are the nodes enough for a motion? Its error in space, by linear dynamics on a finer grid that its defect drives."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from scipy.linalg import expm

from pisplit.checks import Array
from pisplit.models.rod.dynamics.motion_error import POINTS, MotionError
from pisplit.models.rod.dynamics.trajectory import Trajectory
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.loads import NoEffect

if TYPE_CHECKING:
    from pisplit.models.rod.statics.resolution import Resolution

#: Times at which the finer equations are linearised, and change of a scaled unknown by which they are differentiated.
ANCHORS, STEP = 5, 1e-5
#: Retardation in parts of the interval: waves far faster than that fade, whose defects the outputs do not sample.
FADING = 0.01


class SpaceError(Rebuilt):
    """Error of the grid of a motion.

    Strains, rates and accelerations are taken to two more nodes an element, where they leave a defect r(t). The error
    follows M d'' + D d' + S d = -r with the mass, damping and stiffness of the finer grid at a few states of the motion
    (defect correction); r is linear from one output to the next. So phases that drift are seen, not the bend alone.
    The overstress of Maxwell branches deviates with d.

    Args:
        resolution: the grid of the equations that move, and the finer one.
    """

    def __init__(self, resolution: Resolution) -> None:
        self.resolution = resolution
        self.scene, self.finer = resolution.scene, resolution.finer

    def of(self, found: Trajectory) -> MotionError:
        """Estimated distance (T+1,) in m, largest along the rod, of ``found`` from the motion without error in space.

        Infinite where it overflows.
        """
        fine, steps = self.finer.n_strains, len(found.t)
        strains, rates, overstress, inputs = self.scene.layout.split(found.x)
        states = [self.resolution.interpolated(part) for part in (strains, rates)]
        states.append(self.resolution.interpolated(overstress, 0))
        given = tuple(part.T for part in self.scene.layout.arguments(found.x))
        bends = np.asarray(self.scene.acceleration.map(steps)(*given)).T
        motion = np.hstack([*states[:2], self.resolution.interpolated(bends), states[2]])
        defects = np.asarray(self._defect.map(steps)(motion.T, inputs.T)).T
        defects[0] = defects[min(1, steps - 1)]  # what is let go is fast at first, and soon slow
        deviation = np.zeros((steps, fine))
        state = np.concatenate(
            [self.resolution.on_finer(found.x[0])[:fine] - states[0][0], np.zeros(self._free - fine)]
        )
        deviation[0] = state[:fine]
        anchors = np.unique(np.linspace(min(1, steps - 1), steps - 1, ANCHORS).astype(int))
        nearest = np.abs(np.arange(steps)[:, None] - anchors).argmin(axis=1)
        flows = {k: self._flow(motion[k], inputs[k], found.t[1]) for k in anchors}
        for k in range(1, steps):
            flow = flows[anchors[nearest[k]]]
            state = flow @ np.concatenate([state, defects[k - 1], defects[k] - defects[k - 1]])
            deviation[k] = state[:fine]
        here, there = (
            np.asarray(shapes.map(steps)(shape.T, inputs.T)).T.reshape(steps, POINTS, 3)
            for shapes, shape in zip(self.resolution.shapes, (strains, states[0] + deviation), strict=True)
        )
        return MotionError.between(here, there)

    def _flow(self, motion: Array, u: Array, dt: float) -> Array:
        """(q, q + 2 n) from the deviation, the defect and its change over ``dt`` to the deviation ``dt`` later."""
        n, q, (fractions, relaxing) = self.finer.n_strains, self._free, self.finer.relaxation
        branches = self.finer.layout.n_branches
        unit = np.tile(self.finer.nominal_strains, 3) * np.repeat(self._rate ** np.arange(3), n)
        free = self.finer.layout.n_free
        unit = np.append(unit, np.tile(self.finer.nominal_strains[:free], branches))
        probes = STEP * np.vstack([np.eye(len(unit)), -np.eye(len(unit))]) * unit
        after, before = np.split(np.asarray(self._defect.map(len(probes))((motion + probes).T, u)).T, 2)
        slopes = ((after - before) / (2.0 * STEP * unit[:, None])).T
        try:
            of_all = -np.linalg.solve(
                slopes[:, 2 * n : 3 * n], np.hstack([slopes[:, : 2 * n], slopes[:, 3 * n :], np.eye(n)])
            )
        except np.linalg.LinAlgError:
            return np.full((q, q + 2 * n), np.inf)
        generator = np.zeros((q + 2 * n, q + 2 * n))
        generator[:n, n : 2 * n] = np.eye(n)
        generator[n : 2 * n, : q + n] = of_all
        generator[n : 2 * n, n : 2 * n] += FADING * dt * of_all[:, :n]
        generator[2 * n : q, n : 2 * n] = fractions[:, None] * np.tile(np.eye(free, n), (branches, 1))
        generator[2 * n : q, 2 * n : q] = -np.diag(relaxing)
        generator[q : q + n, q + n :] = np.eye(n) / dt
        flow: Array = expm(generator * dt)[:q]
        return flow

    @property
    def _free(self) -> int:
        """Number q of entries of the deviation: of strains, their rates, and overstress."""
        return self.finer.layout.n_moving

    @property
    def _rate(self) -> float:
        """Typical rate in 1/s by which rates and accelerations are scaled."""
        return float(self.finer.rod.bending_rate)

    @cached_property
    def _defect(self) -> ca.Function:
        """``(motion, u) -> residual`` of the finer grid in scaled form.

        ``motion``: strains, rates, accelerations, overstress.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NoEffect)  # said by the scene itself
            xi, xi_t, xi_tt, acting, balance = self.finer.dynamic_balance
        hidden = self.finer.layout.n_overstress
        residual = balance.residual / ca.DM(self.finer.nominal_residual)
        motion = ca.vertcat(xi, xi_t, xi_tt, acting[:hidden, :])  # [:hidden] of one entry is a row
        return ca.Function("defect", [motion, acting[hidden:, :]], [residual])
