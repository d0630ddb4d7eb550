"""Inverse statics as an open-loop controller: the baseline of every closed loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.tracking import Move, check_dt, checked_window, start_input, tracked_states
from pisplit.controllers.mpc.limits import input_limits
from pisplit.lifted.model import LiftedModel


class FeedForward:
    """Applies u = inverse(y_ref) to the reference that the coming step ends at, inside box and rate limits.

    ``inverse``: y_ref (p,) -> u (m,), e.g. the inverse statics of the arm; it receives NaN in outputs that the
    reference leaves free. ``model`` gives sizes, time step and output names only: nothing is predicted and nothing is
    fed back. Other arguments as for ``MPC``. A result that is not finite holds the last input and is flagged.
    """

    def __init__(
        self,
        inverse: Callable[[Array], ArrayLike],
        model: LiftedModel,
        u_min: ArrayLike,
        u_max: ArrayLike,
        du_max: ArrayLike,
        track: str | Sequence[int] = "tip",
        axes: Sequence[int] | None = None,
        dt: float | None = None,
    ) -> None:
        if not callable(inverse):
            raise ValueError(f"inverse is a {type(inverse).__name__}; expected a function y_ref (p,) -> u (m,)")
        self.model = model
        self.horizon = 1
        check_dt(model, dt)
        self.track, self.axes, self.tracked = tracked_states(model, track, axes)
        self._inverse = inverse
        self._limits = input_limits(u_min, u_max, du_max, model.n_inputs)
        self._u = np.clip(np.zeros(model.n_inputs), self.u_min, self.u_max)

    @property
    def u_min(self) -> Array:
        """Lower input limits (m,)."""
        return self._limits.u_min

    @property
    def u_max(self) -> Array:
        """Upper input limits (m,)."""
        return self._limits.u_max

    @property
    def du_max(self) -> Array:
        """Largest input change (m,) per step."""
        return self._limits.du_max

    def reset(self, u0: ArrayLike | None = None) -> None:
        """Start anew from the input u0 (m,), zeros if not given."""
        self._u = start_input(u0, self.u_min, self.u_max)

    def step(self, x_measured: ArrayLike, reference_window: ArrayLike) -> Move:
        """The move for the reference (1, p) of step k+1; the measured state (n,) is only checked."""
        wall, cpu = time.perf_counter(), time.thread_time()
        window = checked_window(reference_window, 1, len(self.tracked))
        finite_array(x_measured, "x_measured", (self.model.n_states,))
        wanted = np.asarray(self._inverse(window[0]), dtype=np.float64)
        if wanted.shape != self._u.shape:
            raise ValueError(f"inverse returned shape {wanted.shape}; expected ({len(self._u)},)")
        found = bool(np.isfinite(wanted).all())
        if found:
            self._u = self._limits.project(wanted, self._u)
        return Move(
            u=self._u.copy(),
            status="solved" if found else "inverse not finite",
            fallback=not found,
            iterations=0,
            solve_time=time.perf_counter() - wall,
            cpu_time=time.thread_time() - cpu,
            predicted=window.copy(),
        )
