"""What is applied where no program was solved, in the order in which it is tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.mpc.limits import InputLimits

PLAN, TARGET, HOLD, REST = "shifted plan", "steady target", "hold", "return to rest"
#: Horizons in which the return to rest crosses a half box.
SLOWLY = 10.0
#: Half boxes from the steady target at which it is reached.
THERE = 1e-9


@dataclass(frozen=True)
class FallbackState:
    """Moves ``left`` of the last good plan, steps ``idle`` after them, input ``rest`` (m,) of the start."""

    left: int
    idle: int
    rest: Array


class Fallback:
    """Moves without a solution: the rest of the last plan, shifted; then, for a horizon, towards the steady target (the
    input under which the model rests nearest to the reference); for another horizon the input is held; then it returns
    slowly to where the run began, by half a box in ten horizons. All are inside the limits.

    ``horizon``: H steps; ``limits`` of the inputs.
    """

    def __init__(self, horizon: int, limits: InputLimits) -> None:
        self._H, self._limits = horizon, limits
        self.reset(np.clip(np.zeros(len(limits.u_min)), limits.u_min, limits.u_max))

    def reset(self, rest: Array) -> None:
        """Begin anew from the input ``rest`` (m,)."""
        self._state = FallbackState(0, 0, rest.copy())

    def solved(self) -> None:
        """A new plan was found."""
        self._state = FallbackState(self._H - 1, 0, self._state.rest)

    def snapshot(self) -> FallbackState:
        """What the next moves depend on."""
        return self._state

    def restore(self, state: FallbackState) -> None:
        """Go on from the ``state`` of a ``snapshot``."""
        self._state = state

    def __call__(self, planned: Array, target: Callable[[], Array | None], u: Array) -> tuple[Array, str]:
        """The input (m,) to apply after ``u`` (m,), and its name.

        ``planned`` (m,): the next move of the last plan; ``target`` () -> the steady target (m,), None without one.
        """
        state, limits = self._state, self._limits
        if state.left > 0:
            self._state = FallbackState(state.left - 1, 0, state.rest)
            return limits.project(planned, u), PLAN
        self._state = FallbackState(0, state.idle + 1, state.rest)
        goal = target() if state.idle < self._H else None
        if goal is not None:
            there = float(np.max(np.abs(goal - u) / limits.amplitude)) < THERE
            return (u.copy() if there else limits.project(goal, u)), TARGET
        way = state.rest - u
        if state.idle < 2 * self._H or not way.any():
            return u.copy(), HOLD
        share = float(np.max(np.abs(way) / limits.amplitude)) * SLOWLY * self._H
        return limits.project(u + way / max(1.0, share), u), REST
