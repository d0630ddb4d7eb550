"""Delay buffers of measured states and applied inputs, as the lifting functions take them, and delay lines."""

from __future__ import annotations

import copy
from collections import deque

import numpy as np

from pisplit.checks import Array, non_negative


class History:
    """The last D + 1 states (D+1, n) and D inputs (D, m), oldest first.

    ``n_delays`` is D, ``n_states`` n and ``u0`` (m,) the input before the first step.

    Before enough is known the first measurement and the first input stand for everything earlier: an arm at rest.
    """

    def __init__(self, n_delays: int, n_states: int, u0: Array) -> None:
        self.states = np.zeros((n_delays + 1, n_states))
        self.inputs = np.tile(u0, (n_delays, 1))
        self.u_previous = np.array(u0)
        self._empty = True

    def copy(self) -> History:
        """A history that goes on apart from this one."""
        other = copy.copy(self)
        other.states, other.inputs = self.states.copy(), self.inputs.copy()
        return other

    def measure(self, x: Array) -> None:
        """Append the state ``x`` (n,) measured now."""
        if self._empty:
            self.states[:] = x
            self._empty = False
        else:
            self.states[:-1] = self.states[1:]
            self.states[-1] = x

    def apply(self, u: Array) -> None:
        """Append the input ``u`` (m,) applied from now on."""
        if len(self.inputs):
            self.inputs[:-1] = self.inputs[1:]
            self.inputs[-1] = u
        self.u_previous = np.array(u)


class Line:
    """A delay line: values come out ``steps`` samples later, fractions by linear interpolation between samples.

    Args:
        steps: delay in samples, zero or more.
        name: what errors call it.
    """

    def __init__(self, steps: float, name: str) -> None:
        self.steps = non_negative(steps, name)
        self._kept: deque[Array] = deque(maxlen=int(self.steps) + 2)

    def fill(self, value: Array) -> None:
        """Begin with ``value`` (p,) at all times."""
        self._kept.extend([value.copy()] * (self._kept.maxlen or 1))

    def __call__(self, value: Array) -> Array:
        """The value ``steps`` samples ago, ``value`` being the present one."""
        self._kept.append(value.copy())
        whole, part = int(self.steps), self.steps - int(self.steps)
        later, earlier = self._kept[-1 - whole], self._kept[-2 - whole]
        return later.copy() if part == 0.0 else (1.0 - part) * later + part * earlier

    def own(self) -> tuple[Array, ...]:
        """What is on the line."""
        return tuple(value.copy() for value in self._kept)

    def take(self, own: tuple[Array, ...]) -> None:
        """Put back what ``own`` gave, one array (p,) a sample."""
        self._kept.clear()
        self._kept.extend(value.copy() for value in own)

    def coming(self) -> Array:
        """What comes out over the next ``int(steps)`` samples whatever goes in, the first of them first."""
        whole, part = int(self.steps), self.steps - int(self.steps)
        kept = np.array(self._kept)
        later, earlier = kept[len(kept) - whole :], kept[len(kept) - whole - 1 : len(kept) - 1]
        return np.asarray((1.0 - part) * later + part * earlier)
