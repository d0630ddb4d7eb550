"""Where slow loading takes a rod: fine paths that share no code with the rod's own statics.

``PlaneElastica`` is for dead loads on a uniform round rod, which stays in the plane of its axis and of the load;
``followed`` is for any scene at rest, by plain Newton steps in small parts of the load.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

from pisplit.models import rod

Array = NDArray[np.float64]
#: Gauss nodes of the plane elastica, and points along a rod at which shapes are compared.
NODES, POINTS = 40, 20
#: Largest change of an angle (rad) in a step of the load, and the smallest step.
STEP, SMALLEST = 0.15, 1e-6


@dataclass(frozen=True)
class PlaneElastica:
    """A rod of length 1 and EI = 1, clamped along z at the origin, under dead loads in the x-z plane.

    EI theta'' = -(p' x n)_y with n(s) = F + w (1 - s) and p' = (1 + n_t / EA) t + n_d / GA d, t = (sin, cos) theta.

    Attributes:
        stretch, shear: EI / (EA L^2) and EI / (GA L^2), zero for a rod that has neither.
    """

    stretch: float = 0.0
    shear: float = 0.0

    @cached_property
    def _rule(self) -> tuple[Array, Array, Array]:
        """Nodes (N,), weights (N,), and the matrix (N, N) of integrals from 0 to each node."""
        x, w = np.polynomial.legendre.leggauss(NODES)
        vander = np.polynomial.legendre.legvander(x, NODES - 1)
        integrals = np.polynomial.legendre.legint(np.eye(NODES), lbnd=-1.0)
        parts = np.polynomial.legendre.legval(x, integrals).T
        return 0.5 * (x + 1.0), 0.5 * w, 0.5 * parts @ np.linalg.inv(vander)

    def _slope(self, theta: Array, force: Array) -> tuple[Array, Array]:
        """(p' (N, 2), (p' x n)_y (N,))."""
        t, d = np.stack([np.sin(theta), np.cos(theta)], 1), np.stack([np.cos(theta), -np.sin(theta)], 1)
        along, across = np.sum(force * t, axis=1), np.sum(force * d, axis=1)
        p = (1.0 + self.stretch * along)[:, None] * t + (self.shear * across)[:, None] * d
        return p, p[:, 1] * force[:, 0] - p[:, 0] * force[:, 1]

    def shape(self, tip: Array, weight: Array, push: Array | None = None) -> Array:
        """Positions (20, 2) along the rod under a tip force (2,) in EI/L^2 and a weight (2,) in EI/L^3.

        With ``push`` (2,), a tip force that is added on the way and taken off at the end: which way a straight rod
        buckles. Raises RuntimeError where the load cannot be followed in steps under which the rod is stable.
        """
        s, w, a = self._rule
        rest = w - a  # integrals from each node to the tip
        full = tip + weight * (1.0 - s)[:, None]
        pushed = full if push is None else full + push
        for largest in (STEP, 0.1 * STEP):
            theta = self._path(pushed, a, rest, largest)
            if push is not None:
                found = self._root(theta, full, a, rest)
                if found is None:
                    continue
                theta = found
            if self._stable(theta, full, a, rest):
                break
        else:
            raise RuntimeError("the elastica is not stable at the end of its path")
        p, _ = self._slope(theta, full)
        at = np.arange(1, POINTS + 1) / POINTS
        return np.asarray(BarycentricInterpolator(np.concatenate([[0.0], s]), np.vstack([np.zeros((1, 2)), a @ p]))(at))

    def _path(self, force: Array, a: Array, rest: Array, largest: float) -> Array:
        """Angles (N,) under the force, grown from nothing in steps that turn no point by more than ``largest``."""
        theta, rate, factor, step = np.zeros(NODES), np.zeros(NODES), 0.0, 1e-3
        while factor < 1.0:
            step = min(step, 1.0 - factor)
            found = self._root(theta + step * rate, (factor + step) * force, a, rest)
            if found is None or np.abs(found - theta).max() > largest:
                step *= 0.5
                if step < SMALLEST:
                    raise RuntimeError(f"the elastica cannot be followed beyond {factor:g} of the load")
                continue
            theta, rate, factor = found, (found - theta) / step, factor + step
            step *= 1.3
        return theta

    def _stable(self, theta: Array, force: Array, a: Array, rest: Array) -> bool:
        """Whether the energy in the plane has a minimum."""
        slope = (self._slope(theta + 1e-6, force)[1] - self._slope(theta - 1e-6, force)[1]) / 2e-6
        return bool(np.linalg.eigvals(np.eye(NODES) - a @ rest * slope).real.min() > 0.0)

    def _root(self, theta: Array, force: Array, a: Array, rest: Array) -> Array | None:
        """theta = A kappa, kappa = int_s^1 (p' x n)_y; Newton with differences of the pointwise slope."""
        for _ in range(8):
            turn = self._slope(theta, force)[1]
            slope = (self._slope(theta + 1e-6, force)[1] - self._slope(theta - 1e-6, force)[1]) / 2e-6
            change = np.linalg.solve(np.eye(NODES) - a @ rest * slope, a @ (rest @ turn) - theta)
            theta = theta + change
            if np.abs(change).max() < 1e-10:
                return theta
            if not np.abs(change).max() < 1.0:
                return None
        return None


@cache
def _residuals(scene: rod.Scene) -> tuple[ca.Function, ca.Function, Array]:
    """Residual and slope of the loaded and of the bare rod in scaled form, and the slope of the bare one at rest."""
    xi, inputs, balance = scene.static_balance
    own, _, elastic = rod.Scene(scene.rod, nodes=scene.element_nodes).static_balance
    parts = [(part.residual / ca.DM(scene.nominal_residual), x) for part, x in ((balance, xi), (elastic, own))]
    loaded = ca.Function("loaded", [xi, inputs], [parts[0][0], ca.jacobian(*parts[0])])
    free = ca.Function("free", [own], [parts[1][0], ca.jacobian(*parts[1])])
    return loaded, free, np.asarray(free(scene.rest_coordinates)[1])


def followed(scene: rod.Scene, u: Array, steps: int = 40) -> tuple[Array | None, float]:
    """State [xi, 0, u] that loading from nothing reaches, and the part of the load up to which it stayed stable.

    None where stability is lost or Newton's method does not go on in the smallest steps. All loads grow in proportion.
    """
    loaded, free, stiffness = _residuals(scene)

    def at(x: Array, factor: float) -> tuple[Array, Array]:
        (r, j), (r0, j0) = loaded(x, u), free(x)
        return (
            factor * np.asarray(r).ravel() + (1.0 - factor) * np.asarray(r0).ravel(),
            factor * np.asarray(j) + (1.0 - factor) * np.asarray(j0),
        )

    x, rate, factor, step = np.array(scene.rest_coordinates), np.zeros(scene.n_strains), 0.0, 1.0 / steps
    while factor < 1.0:
        step = min(step, 1.0 - factor)
        found = _newton(at, x + step * rate, factor + step, scene.nominal_strains)
        if found is None or np.abs((found - x) / scene.nominal_strains).max() > 1.0:
            step *= 0.5
            if step < SMALLEST:
                return None, factor
            continue
        if np.linalg.eigvals(np.linalg.solve(stiffness, at(found, factor + step)[1])).real.min() <= 0.0:
            return None, factor
        x, rate, factor, step = found, (found - x) / step, factor + step, min(1.3 * step, 1.0 / steps)
    return scene.at_rest(x, u), 1.0


def _newton(at: Callable[[Array, float], tuple[Array, Array]], x: Array, factor: float, unit: Array) -> Array | None:
    for _ in range(8):
        r, j = at(x, factor)
        change = np.linalg.solve(j, r)
        x = x - change
        if not np.isfinite(x).all():
            return None
        if np.abs(r).max() < 1e-9 or np.abs(change / unit).max() < 1e-12:  # forces of stiff strains are round
            return x
    return None
