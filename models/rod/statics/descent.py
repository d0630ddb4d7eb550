"""Downhill to a shape at rest, as through a thick fluid, and how a shape is told to be stable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.whitened import Way

#: Stiffness, in parts of the elastic one, down to which a shape passes for stable: rotations that cost nothing do.
NEUTRAL = 1e-3
#: Longest step of a descent [rad, root mean square] and largest share of it that the next force may gainsay.
LONGEST, GAINSAID = 0.5, 0.5
#: First pseudo-time of a descent, the least one, and how many steps it may take.
FIRST_PACE, LEAST_PACE, MOST_STEPS = 0.1, 1e-8, 600
#: Force at which a descent is at rest.
AT_REST = 1e-3
#: Force that counts as none, how far a shape in unstable balance is pushed off it [rad], and how often.
BALANCED, PUSH, PUSHES = 1e-9, 1e-2, 3


@dataclass(frozen=True)
class Judge:
    """Tells stable shapes by their stiffness H (n, n).

    Attributes:
        has_energy: whether the loads have one, so that H is symmetric up to the error of the grid.
    """

    has_energy: bool

    def stable(self, stiffness: Array) -> bool:
        """Whether no deformation goes on by itself under ``stiffness`` (n, n)."""
        if not np.isfinite(stiffness).all():
            return False
        if not self.has_energy:
            return bool(np.linalg.eigvals(stiffness).real.min() > -NEUTRAL)
        return definite(stiffness, NEUTRAL)

    def kept(self, now: Array, before: Array, share: float, slack: float) -> bool:
        """Whether the stiffness ``now`` keeps a ``share`` of the one ``before`` in every direction, up to ``slack``."""
        if not self.has_energy:
            return self.stable(now)
        return bool(np.isfinite(now).all()) and definite(now - share * before, slack)

    def size(self, step: Array) -> float:
        """Length of a ``step`` (n,) of the strains [rad, root mean square]."""
        return float(np.linalg.norm(step))

    def drag(self, n: int) -> Array:
        """What resists the motion of each of ``n`` unknowns in a descent, (n,)."""
        return np.ones(n)

    def uphill(self, force: Array, ahead: Array, step: Array) -> bool:
        """Whether a ``step`` (n,) between the forces ``force`` and ``ahead`` (n,) gains energy."""
        return self.has_energy and 0.5 * float((force + ahead) @ step) < -1e-9

    def softest(self, stiffness: Array) -> tuple[float, Array]:
        """Least eigenvalue, in parts of the elastic stiffness, and its direction (n,) of length 1."""
        if not self.has_energy:
            values, vectors = np.linalg.eig(stiffness)
            k = int(values.real.argmin())
            direction = vectors[:, k].real
            return float(values[k].real), direction / np.linalg.norm(direction)
        values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
        return float(values[0]), vectors[:, 0]


def definite(stiffness: Array, shift: float) -> bool:
    """Whether the symmetric part of ``stiffness`` (n, n), with ``shift`` added, is positive definite."""
    lower = 0.5 * (stiffness + stiffness.T)
    lower.flat[:: len(lower) + 1] += shift
    from scipy.linalg.lapack import dpotrf  # slow to load, for descents alone

    return bool(dpotrf(lower, lower=1, clean=0)[1] == 0)


def solved(stiffness: Array, force: Array) -> Array:
    """The deformation (n,) that balances ``force`` (n,); the least one where ``stiffness`` (n, n) is singular."""
    from scipy.linalg.lapack import dgesv  # slow to load, for descents alone

    _, _, found, info = dgesv(stiffness, force)
    if info == 0:
        return np.asarray(found)
    return np.asarray(np.linalg.lstsq(stiffness, force, rcond=1e-12)[0])


def descend(way: Way, y: Array, t: float, judge: Judge) -> tuple[Array, bool]:
    """Where a rod with the strains ``y`` (n,) sinks to, and whether it came to a stable rest there.

    y' = g(y) at the point ``t`` of the ``way`` by linearly implicit Euler steps under error control. Where loads
    have an energy no step goes uphill: its change is the work of the mean force. The ``judge`` tells stable shapes.
    A shape in balance that is not stable, as a strut that was turned but not bent, is pushed its softest way.
    """
    force, stiffness, _ = way(y, t)
    pace, drag, pushed = FIRST_PACE, judge.drag(len(y)), 0
    for _ in range(MOST_STEPS):
        if np.abs(force).max() < AT_REST:
            if judge.stable(stiffness):
                return y, True
            if np.abs(force).max() < BALANCED and pushed < PUSHES:
                y, pace, pushed = y + PUSH * judge.softest(stiffness)[1], FIRST_PACE, pushed + 1
                force, stiffness, _ = way(y, t)
                continue
        damped = stiffness + np.diag(drag / pace)
        if not judge.stable(damped):
            pace *= 0.5
            continue
        step = solved(damped, force)
        length = judge.size(step)
        if not length <= LONGEST:
            pace *= max(0.2, 0.7 * LONGEST / length) if np.isfinite(length) else 0.2
            continue
        ahead, stiffness_ahead, _ = way(y + step, t)
        error = float(np.linalg.norm(ahead - drag * step / pace)) / max(length / pace, BALANCED)
        if not error <= GAINSAID or judge.uphill(force, ahead, step):
            if pace < LEAST_PACE:
                break
            pace *= 0.4
            continue
        y, force, stiffness = y + step, ahead, stiffness_ahead
        pace = min(pace * (2.0 if error < 0.5 * GAINSAID else 1.1), 1e9)
    return y, False
