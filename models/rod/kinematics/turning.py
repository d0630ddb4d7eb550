"""How frames along a rod turn with its strains."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.models.rod.kinematics.rotations import rotation_matrix, turning_coefficients
from pisplit.models.rod.kinematics.strains import rotation_vector, turn_rows

if TYPE_CHECKING:
    from pisplit.models.rod.kinematics.kinematics import Motion


def turn_slopes(motion: Motion, points: Sequence[float]) -> list[ca.SX]:
    """Theta (3, n) with dR R^T = hat(Theta dxi) of the frames of a ``motion`` at arclengths ``points`` in m.

    A step R -> R exp(hat(omega)) adds R dexp(omega) domega (see ``variational.Turn``): exact derivatives of the
    discrete frames.
    """
    n, free, rule = motion.strains.numel(), motion.rod.strain_set.free, motion.rule
    first = _of_base(motion)
    columns = [(c, free.index(c)) for c in range(3) if c in free]

    def spread(blocks: list[tuple[np.ndarray, ca.SX]]) -> ca.SX:
        """Theta of what the strains w at the nodes do by the sum of row (K,) x block (3, 3)."""
        found = ca.SX(3, n)
        for node in range(rule.n_nodes):
            for c, place in columns:
                for row, block in blocks:
                    if row[node]:
                        found[:, node * len(free) + place] += float(row[node]) * block[:, c]
        return found

    if motion.rod.strain_set.planar:
        about = ca.SX(3, 3)
        about[:, 1] = ca.sparsify(rotation_matrix(motion.base.quaternion))[:, 1]
        return [first + spread([(row, about)]) for row in rule.integrate_to(points)]

    def step(start: float, end: float, frame: ca.SX) -> ca.SX:
        rows = turn_rows(rule, start, end)
        turn = frame @ _turning(ca.mtimes(motion.w, ca.DM(rows.T)))
        return spread([(row, turn[:, 3 * k : 3 * k + 3]) for k, row in enumerate(rows)])

    ends = rule.step_ends
    frames = motion.frames_at(ends)
    chain = [first]
    for frame, (start, end) in zip(frames, pairwise(ends), strict=False):
        chain.append(chain[-1] + step(start, end, frame))
    found = []
    for point in points:
        last = int(np.searchsorted(ends, point, side="right")) - 1
        found.append(chain[last] + step(ends[last], point, frames[last]) if point > ends[last] else chain[last])
    return found


def _of_base(motion: Motion) -> ca.SX:
    """Theta (3, n) of the base, of whose joint coordinates its quaternion may be a function."""
    q = motion.base.quaternion
    change = ca.jacobian(q, motion.strains)
    if not change.nnz():
        return ca.SX(3, motion.strains.numel())
    return 2.0 * (q[0] * change[1:, :] - q[1:] @ change[0, :] + ca.skew(q[1:]) @ change[1:, :])


def _turning(parts: ca.SX) -> ca.SX:
    """dexp(omega) domega/dparts (3, 9 or 6) of one step, in the frame before it; ``parts`` are those of omega."""
    symbol = ca.SX.sym("parts", *parts.shape)
    omega = rotation_vector(symbol)
    omega, slope = ca.substitute([omega, ca.jacobian(omega, ca.vec(symbol))], [symbol], [parts])
    square, a, b = turning_coefficients(omega)
    # 1 + a hat(omega) + b hat(omega)^2, where hat(omega)^2 = omega omega^T - |omega|^2
    dexp = (1.0 - b * square) * ca.SX.eye(3) + ca.skew(a * omega) + (b * omega) @ omega.T
    return dexp @ slope
