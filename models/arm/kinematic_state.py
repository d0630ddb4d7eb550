"""A state of an arm from what its markers show at once: the shape from where they are, its rates from where they go."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array
from pisplit.models.arm.marker_sight import MarkerSight

#: Gauss-Newton steps to a shape; the change, in standard deviations of what it is held to, that ends them, and the
#: longest.
STEPS, SAME, LONGEST = 30, 1e-6, 0.5
#: Instants whose positions are taken for a parabola in time.
INSTANTS = 5


def kinematic_state(
    sight: MarkerSight, columns: Array, dt: float, strains: Array, root: Array, pose: Array | None = None
) -> Array:
    """The state [xi, xi_t] (2n,) at the first of some instants that looks most like the markers then and soon after.

    Args:
        sight: the markers.
        columns: (T+1, K) what they show; NaN: lost.
        dt: time between the instants in s.
        strains: shape at rest (n,) that what the markers do not show is held to.
        root: (2n, 2n) of the precision by which it is (``energy_root``).
        pose: (6,) of the base; the given one where it is left out.

    No equation of motion is used: it is where fits of the motion start.
    """
    n = len(strains)
    shape, rates = root[:n, :n], root[n:, n:]
    xi = strains.copy()
    weight = np.isfinite(columns[0]) / sight.sizes
    seen = np.nan_to_num(columns[0])
    slope = np.zeros((len(weight), n))
    for _ in range(STEPS):
        y, of_state, _ = sight.look(np.concatenate([xi, np.zeros(n)]), pose)
        slope = of_state[:, :n]
        miss = np.concatenate([(y - seen) * weight, shape @ (xi - strains)])
        change = np.linalg.lstsq(np.vstack([slope * weight[:, None], shape]), miss, rcond=None)[0]
        size = float(np.linalg.norm(shape @ change))
        xi = xi - min(1.0, LONGEST / max(size, 1e-300)) * change
        if size < SAME:
            break
    velocity, error = _velocities(columns[:INSTANTS], dt, sight.sizes)
    certain = np.isfinite(error) / np.where(np.isfinite(error), error, 1.0)
    rows, right = np.vstack([slope * certain[:, None], rates]), np.concatenate([velocity * certain, np.zeros(n)])
    return np.concatenate([xi, np.linalg.lstsq(rows, right, rcond=None)[0]])


def _velocities(columns: Array, dt: float, sizes: Array) -> tuple[Array, Array]:
    """Slope (K,) at the first instant of parabolas through ``columns`` (I, K) and its standard deviation, inf: none."""
    k = columns.shape[1]
    velocity, error = np.zeros(k), np.full(k, np.inf)
    time = dt * np.arange(len(columns))
    for column in range(k):
        seen = np.isfinite(columns[:, column])
        if seen.sum() < 2:
            continue
        basis = np.vander(time[seen], min(3, int(seen.sum())), increasing=True)
        inverse = np.linalg.pinv(basis)
        velocity[column] = inverse[1] @ columns[seen, column]
        error[column] = sizes[column] * float(np.linalg.norm(inverse[1]))
    return velocity, error
