"""Inverse statics: inputs that bring the tip of a scene to a place."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pisplit.brief import brief
from pisplit.checks import Array, finite_array, positive, real_array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.statics.equilibrium import Equilibrium
    from pisplit.models.rod.statics.statics import Statics

MAX_ITERATIONS = 60
#: Largest shift of the tip in parts of the length that one step asks of the linear model.
TRUST = 0.1
#: Distance of two tips in parts of the length up to which they are one.
SAME = 1e-6


@brief
@dataclass(frozen=True)
class InverseSolution:
    """Inputs for a tip position.

    Attributes:
        u: (n_inputs,), within the limits.
        equilibrium: the equilibrium under ``u``.
        error: distance in m from the coordinates asked for.
        success: whether ``error`` is within the tolerance; message: why not, or that ``loaded`` is another place.
        iterations: Gauss-Newton steps.
        loaded: distance in m from ``equilibrium``, which the inputs reach from ``start``, to the tip that loading the
            rod from nothing to ``u`` reaches; 0 where these are one, NaN where that is not known.
    """

    u: Array
    equilibrium: Equilibrium
    error: float
    success: bool
    message: str
    iterations: int
    loaded: float = 0.0

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """The shape under ``u``; written to ``path`` where one is given."""
        return self.equilibrium.plot(path)


def inverse(
    statics: Statics,
    target: ArrayLike,
    limits: ArrayLike | None = None,
    start: ArrayLike | None = None,
    tolerance: float = 1e-8,
) -> InverseSolution:
    """Inputs near ``start`` that bring the tip of the scene of ``statics`` to ``target`` (3,) in m.

    ``limits`` and ``tolerance`` as in ``Statics.inverse``, which raises and flags what this does.
    """
    scene = statics.scene
    length, m = scene.rod.length, scene.n_inputs
    goal = real_array(target, "target")
    if goal.shape != (3,) or not np.any(np.isfinite(goal)) or np.any(np.isinf(goal)):
        raise ValueError(f"target = {goal.tolist()}; expected three coordinates in m, NaN for those that are free")
    if m == 0:
        raise ValueError("the scene has no inputs; inverse statics needs tendons or another input")
    asked = np.isfinite(goal)
    least, most = scene.input_limits
    low, high = (np.clip(limit, least, most) for limit in _limits(limits, m))
    u = np.clip(np.zeros(m) if start is None else finite_array(start, "start", (m,)), low, high)
    reach = positive(tolerance, "inverse tolerance") * length
    equilibrium = statics.solve(u)
    if not equilibrium.success:
        return InverseSolution(u, equilibrium, np.inf, False, f"no start: {equilibrium.message}", 0)

    def miss(at: Equilibrium) -> Array:
        return (goal - at.tip)[asked]

    away, message, taken = miss(equilibrium), "", 0
    while np.linalg.norm(away) > reach:
        if taken == MAX_ITERATIONS:
            message = f"no convergence in {MAX_ITERATIONS} steps"
            break
        slope = statics.sensitivity(equilibrium.state).jacobian[:3][asked]
        wanted = away * min(1.0, TRUST * length / float(np.linalg.norm(away)))
        change = _bounded_step(slope, wanted, low - u, high - u)
        share = 2.0
        for _ in range(12):
            share *= 0.5
            trial = statics.solve(np.clip(u + share * change, low, high), guess=equilibrium.state)
            if trial.success and np.linalg.norm(miss(trial)) < (1.0 - 1e-3 * share) * np.linalg.norm(away):
                break
        else:
            message = "out of reach within the limits"
            break
        u, equilibrium, taken = trial.state[-m:].copy(), trial, taken + 1
        away = miss(equilibrium)
    error = float(np.linalg.norm(away))
    if message:
        message = f"{message}: the tip stays {1e3 * error:.3g} mm away"
        return InverseSolution(u, equilibrium, error, False, message, taken)
    loaded = _loaded(statics, equilibrium, u)
    if loaded > max(10.0 * reach, SAME * length):
        message = (
            f"there by moving the inputs from start to u; loading from nothing to u ends {1e3 * loaded:.3g} mm away"
        )
    elif np.isnan(loaded):
        message = "there by moving the inputs from start to u; where loading from nothing to u ends is not known"
    return InverseSolution(u, equilibrium, error, True, message, taken, loaded)


def _loaded(statics: Statics, found: Equilibrium, u: Array) -> float:
    """Distance in m from the tip that was ``found`` to that under ``u`` (n_inputs,) loaded from nothing."""
    if found.branch == "unique":
        return 0.0
    again = statics.solve(u)
    return float(np.linalg.norm(again.tip - found.tip)) if again.success else float("nan")


def _limits(limits: ArrayLike | None, m: int) -> tuple[Array, Array]:
    """Lower and upper limits (m,) each, from None, (2,) or (2, m)."""
    if limits is None:
        return np.full(m, -np.inf), np.full(m, np.inf)
    both = real_array(limits, "limits")
    if np.isnan(both).any():
        raise ValueError(
            f"limits have {np.isnan(both).sum()} masked or NaN entries; give infinite ones where there is no limit"
        )
    if both.shape not in ((2,), (2, m)) or np.any(both[0] > both[1]):
        raise ValueError(f"limits have shape {both.shape}; expected (low, high) or (2, {m}) with low <= high")
    low, high = (np.broadcast_to(row, (m,)).astype(np.float64) for row in both)
    return low, high


def _bounded_step(slope: Array, wanted: Array, low: Array, high: Array) -> Array:
    """Smallest change of the inputs with ``slope @ change = wanted``, or as near as the bounds allow.

    Inputs that would leave their bounds are put there and the others solved again.
    """
    m = slope.shape[1]
    change, free = np.zeros(m), np.ones(m, dtype=bool)
    for _ in range(m):
        change[free] = np.linalg.lstsq(slope[:, free], wanted - slope[:, ~free] @ change[~free], rcond=1e-9)[0]
        outside = free & ((change < low) | (change > high))
        if not np.any(outside):
            break
        change[outside] = np.clip(change[outside], low[outside], high[outside])
        free &= ~outside
    return change
