"""A clamped rod under a dead tip force across it: static codes side by side, and the exact answer by shooting."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq

from benchmarks.rod_peers import SHEAR_FACTOR, Case, scene_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Solve:
    """Error of the tip in parts of L and CPU seconds of one solve by a code in some setting."""

    code: str
    setting: str
    seconds: float
    error: float


def slopes(case: Case, shear: bool) -> Callable[[float, Array], Array]:
    """d/ds of (x, z, angle, moment / EI) of the plane rod; stiff in shear and stretch unless ``shear``."""
    across = case.force / (SHEAR_FACTOR * case.shear_modulus * case.area) if shear else 0.0
    along = case.force / (case.young * case.area) if shear else 0.0

    def rates(s: float, y: Array) -> Array:
        c, sine = np.cos(y[2]), np.sin(y[2])
        stretch, slide = 1.0 + along * sine, across * c
        down = stretch * c - slide * sine
        return np.stack([stretch * sine + slide * c, down, y[3], -case.force / case.bending * down])

    return rates


def exact_tip(case: Case, shear: bool) -> Array:
    """Tip (x, z) in m by shooting with an integrator of order 8 at its tightest tolerance."""
    rates = slopes(case, shear)

    def end(curvature: float) -> Array:
        start = np.array([0.0, 0.0, 0.0, curvature])
        last: Array = solve_ivp(rates, (0.0, case.length), start, "DOP853", rtol=2.3e-14, atol=1e-14).y[:, -1]
        return last

    curvature = brentq(lambda k: end(k)[3], 0.0, 2.0 * case.load / case.length, xtol=1e-14, rtol=1e-14)
    return end(curvature)[:2]


def solve_by_pisplit(case: Case, strains: str, nodes: int, tip: Array) -> Solve:
    """``Statics.solve`` from the straight rod, checks included."""
    statics = scene_of(case, strains, nodes).statics()
    load = np.array([case.force, 0.0, 0.0])
    found = statics.solve(load)
    error = float(np.linalg.norm(found.tip[[0, 2]] - tip)) / case.length if found.success else float("inf")
    plane = ", plane" if "planar" in strains else ""
    return Solve(f"pisplit{plane}", f"{strains}, K={nodes}", _cpu(lambda: statics.solve(load), 30), error)


def solve_by_shooting(case: Case, shear: bool, steps: int, tip: Array) -> Solve:
    """numpy: Runge-Kutta of order 4 in equal steps, secant method on the curvature at the clamp."""
    rates, h = slopes(case, shear), case.length / steps

    def end(curvature: float) -> Array:
        y = np.array([0.0, 0.0, 0.0, curvature])
        for _ in range(steps):
            a = rates(0.0, y)
            b = rates(0.0, y + 0.5 * h * a)
            c = rates(0.0, y + 0.5 * h * b)
            y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(0.0, y + h * c))
        return y

    def shoot() -> Array:
        old, new = case.load / case.length, 0.8 * case.load / case.length
        at_old, at_new = end(old), end(new)
        while abs(new - old) > 1e-12 * abs(new) and at_new[3] != at_old[3]:
            old, new, at_old = new, new - at_new[3] * (new - old) / (at_new[3] - at_old[3]), at_new
            at_new = end(new)
        return at_new[:2]

    error = float(np.linalg.norm(shoot() - tip)) / case.length
    return Solve("numpy shooting (RK4), plane", f"{steps} steps", _cpu(shoot, 5), error)


def solve_by_collocation(case: Case, shear: bool, tolerance: float, tip: Array) -> Solve:
    """``scipy.integrate.solve_bvp`` from the straight rod."""
    rates, s = slopes(case, shear), np.linspace(0.0, case.length, 9)

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], a[1], a[2], b[3]])

    def solve() -> Array:
        guess = np.stack([0.0 * s, s, 0.0 * s, 0.0 * s])
        last: Array = solve_bvp(rates, ends, s, guess, tol=tolerance, max_nodes=100_000).y[:2, -1]
        return last

    error = float(np.linalg.norm(solve() - tip)) / case.length
    return Solve("scipy solve_bvp, plane", f"tol {tolerance:.0e}", _cpu(solve, 3), error)


def _cpu(call: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call in s."""
    seconds = []
    for _ in range(repeats):
        before = time.process_time()
        call()
        seconds.append(time.process_time() - before)
    return float(np.median(seconds))
