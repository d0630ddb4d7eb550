"""Rows of inputs for a tip that is driven along a path: poses, and the rates that belong to them."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, positive


def tip_commands(dt: float, position: ArrayLike, rotation: ArrayLike | None = None) -> Array:
    """Inputs of ``HeldTip.driven()`` for a path of the tip, rates by a cubic spline that starts and ends at rest.

    Row 0 is where the tip starts (inputs of ``x0``), the others are the commands of a run; the last one may be repeated
    to keep the tip there.

    Args:
        dt: control interval in s.
        position: of the tip (T+1, 3) in m.
        rotation: rotation vectors of the tip (T+1, 3) in rad, of one path: many turns are many times 2 pi. None for a
            tip that is pinned.

    Raises ValueError for paths of other shapes, or of fewer than two rows.
    """
    from scipy.interpolate import CubicSpline  # slow to load, and needed here alone

    step = positive(dt, "dt", "s")
    places = finite_array(position, "position", (None, 3))
    if len(places) < 2:
        raise ValueError(f"position has {len(places)} rows; expected at least two: where the tip starts, and on")
    t = step * np.arange(len(places))
    path = CubicSpline(t, places, bc_type="clamped")
    parts = [places, path(t, 1), _to_rest(path(t, 2))]
    if rotation is not None:
        turns = finite_array(rotation, "rotation", (len(places), 3))
        turning = CubicSpline(t, turns, bc_type="clamped")
        spins = np.asarray(_spin().map(len(t))(turns.T, turning(t, 1).T, _to_rest(turning(t, 2)).T)).T
        parts = [places, turns, parts[1], parts[2], spins[:, :3], spins[:, 3:]]
    return np.hstack(parts)


def _to_rest(accelerations: Array) -> Array:
    """``accelerations`` (T+1, 3), zero in the last row."""
    accelerations[-1] = 0.0
    return accelerations


@cache
def _spin() -> ca.Function:
    """``(r, r_t, r_tt) -> `` angular velocity and its rate (6,) in world axes of exp(hat(r)).

    Its spin is r_t + a r x r_t + b r x (r x r_t), a = (1 - cos t) / t^2, b = (t - sin t) / t^3, t = |r|.
    """
    r, r_t, r_tt = (ca.SX.sym(name, 3) for name in ("r", "r_t", "r_tt"))
    square = ca.dot(r, r)
    angle = ca.sqrt(ca.fmax(square, 1e-8))
    small = square < 1e-8
    a = ca.if_else(small, 0.5 - square / 24.0, (1.0 - ca.cos(angle)) / angle**2)
    b = ca.if_else(small, 1.0 / 6.0 - square / 120.0, (angle - ca.sin(angle)) / angle**3)
    once = ca.cross(r, r_t)
    spin = r_t + a * once + b * ca.cross(r, once)
    rate = ca.jtimes(spin, r, r_t) + ca.jtimes(spin, r_t, r_tt)
    return ca.Function("spin", [r, r_t, r_tt], [ca.vertcat(spin, rate)])
