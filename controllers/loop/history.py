"""Delay buffers of measured states and applied inputs, as the lifting functions take them."""

from __future__ import annotations

import numpy as np

from pisplit.checks import Array


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
