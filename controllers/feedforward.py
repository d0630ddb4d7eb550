"""Inverse statics as an open-loop controller: the baseline of every closed loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.tracking import (
    Move,
    check_dt,
    checked_measurement,
    checked_window,
    start_input,
    tracked_states,
)
from pisplit.controllers.mpc.limits import input_limits
from pisplit.lifted.model import LiftedModel


class FeedForward:
    """Applies u = inverse(y_ref) to the reference that the coming step ends at, inside box and rate limits.

    ``inverse``: y_ref (p,) -> u (m,), e.g. the inverse statics of the arm; it receives NaN in outputs that the
    reference leaves free. ``model`` gives sizes, time step and names only: nothing is predicted, nothing is fed back.
    u_min, u_max, du_max: numbers or (m,), in input units, du_max per step. ``track``: an output name of the model, or a
    list of state names or indices; ``axes`` picks coordinates of it in any order. ``dt``: if given, must be the
    model's. A result that is not finite holds the last input and is flagged. Raises ValueError on arguments that do not
    fit the model. Can be pickled and copied if ``inverse`` can.
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
        target = tracked_states(model, track, axes)
        self.track, self.group, self.axes, self.tracked = target.name, target.group, target.axes, target.states
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
        """Start anew from the input ``u0`` (m,), zeros if not given."""
        self._u = start_input(u0, self.u_min, self.u_max)

    def snapshot(self) -> Array:
        """The last input (m,), all that the next step depends on beside the arguments."""
        return self._u.copy()

    def restore(self, state: ArrayLike) -> None:
        """Go on from the ``state`` (m,) of a ``snapshot``; raises ValueError for another shape."""
        self._u = finite_array(state, "state", self._u.shape).copy()

    def step(self, x_measured: ArrayLike, reference_window: ArrayLike) -> Move:
        """The move for the ``reference_window`` (1, p) of step k+1; ``x_measured`` (n,) is only checked."""
        wall, cpu = time.perf_counter(), time.thread_time()
        window = checked_window(reference_window, 1, len(self.tracked))
        x = checked_measurement(x_measured, self.model.n_states)
        wanted = np.array(self._inverse(window[0].copy()), dtype=np.float64)
        if wanted.shape != self._u.shape:
            raise ValueError(f"inverse returned shape {wanted.shape}; expected ({len(self._u)},)")
        found = bool(np.isfinite(wanted).all())
        if found:
            self._u = self._limits.project(wanted, self._u)
        return Move(
            u=self._u.copy(),
            status="solved" if found else "inverse not finite",
            fallback=not found,
            action="" if found else "hold",
            iterations=0,
            solve_time=time.perf_counter() - wall,
            cpu_time=time.thread_time() - cpu,
            predicted=window.copy(),
            missing=int(np.count_nonzero(np.isnan(x))),
        )
