"""Finding a solution from afar: along a parameter from 0 to 1, or by sinking into a state of rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pisplit.checks import Array

FIRST_STEP = 0.125
SMALLEST_STEP = 1e-5
#: Pseudo-time of the first step of a relaxation, the largest change of an unknown in one step, and how many there are.
FIRST_PACE, LONGEST_PACE, MOST_PACES = 1e-2, 1.0, 400


def follow(solve: Callable[[float, Array], Array | None], start: Array) -> tuple[Array, float]:
    """Solution at the end of the way and how much of it was gone (1 when all).

    ``solve(t, guess)`` gives the solution at parameter ``t``, or None. Guesses lie on the line through the last two
    solutions, the first at ``start`` (n,), the solution at 0; a step that fails is halved, after two that succeed the
    next one is twice as long.
    """
    t, x, step, good = 0.0, start, FIRST_STEP, 0
    slope = 0.0 * start
    while t < 1.0:
        following = min(1.0, t + step)
        found = solve(following, x + (following - t) * slope)
        if found is None and good == 0:
            found = solve(following, x)
        if found is None:
            step, good = 0.5 * step, 0
            if step < SMALLEST_STEP:
                break
            continue
        slope, t, x, good = (found - x) / (following - t), following, found, good + 1
        if good >= 2:
            step, good = 2.0 * step, 0
    return x, t


def relax(residual: Callable[[Array], Array], slope: Callable[[Array], Array], start: Array, to: float) -> Array:
    """State of rest of x' = residual(x) near ``start``, or the nearest to rest that was found.

    Implicit Euler steps that grow as the residual falls (pseudo-transient continuation: Kelley & Keyes, SIAM J. Numer.
    Anal. 1998): the rod sinks as through a thick fluid, past folds at which load continuation ends. ``slope(x)`` is the
    derivative of the residual; the search ends where no residual exceeds ``to``.
    """
    x, r = start, residual(start)
    step, size = FIRST_PACE, float(np.linalg.norm(r))
    best, least = x, size
    for _ in range(MOST_PACES):
        if not np.isfinite(size) or np.abs(r).max() <= to:
            break
        try:
            change = np.linalg.solve(np.eye(len(x)) / step - slope(x), r)
        except np.linalg.LinAlgError:
            step *= 0.25
            continue
        longest = float(np.abs(change).max())
        if not longest <= LONGEST_PACE:
            step *= 0.25
            continue
        x = x + change
        before, r = size, residual(x)
        size = float(np.linalg.norm(r))
        step = min(step * min(2.0, before / size if size else 2.0), 1e12) if size < 2.0 * before else 0.5 * step
        if size < least:
            best, least = x, size
    return best
