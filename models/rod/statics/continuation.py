"""Finding a solution from afar: along a parameter from 0 to 1."""

from __future__ import annotations

from collections.abc import Callable

from pisplit.checks import Array

FIRST_STEP = 0.125
SMALLEST_STEP = 1e-5


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
