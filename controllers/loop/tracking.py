"""Which states a controller tracks, and the checks its arguments share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.lifted.model import LiftedModel


@dataclass(frozen=True, eq=False)
class Move:
    """What a controller answers to one measurement.

    u (m,): input to apply over the coming step, inside all limits. ``status``: the solver's word, or why there was no
    solve. ``fallback``: True if u comes from the last good plan instead. ``solve_time``: wall time of the whole step
    [s]; ``cpu_time``: CPU time of this thread in it [s]. ``predicted`` (H, p): outputs expected under the plan.
    """

    u: Array
    status: str
    fallback: bool
    iterations: int
    solve_time: float
    cpu_time: float
    predicted: Array


class Controller(Protocol):
    """What a closed loop needs of a controller."""

    @property
    def model(self) -> LiftedModel:
        """The model, for sizes, names, time step and admissible range."""

    @property
    def track(self) -> str:
        """Name of the tracked outputs."""

    @property
    def axes(self) -> tuple[int, ...]:
        """Which coordinates of the named group are tracked."""

    @property
    def tracked(self) -> tuple[int, ...]:
        """Indices of the tracked states."""

    @property
    def horizon(self) -> int:
        """Number of reference samples that ``step`` looks at."""

    @property
    def u_min(self) -> Array:
        """Lower input limits (m,)."""

    @property
    def u_max(self) -> Array:
        """Upper input limits (m,)."""

    @property
    def du_max(self) -> Array:
        """Largest input change (m,) per step."""

    def reset(self, u0: ArrayLike | None = None) -> None:
        """Start anew from rest under u0 (m,)."""

    def step(self, x_measured: ArrayLike, reference_window: ArrayLike) -> Move:
        """The move for the measured state (n,) and the reference (horizon, p) of the coming steps."""


def tracked_states(
    model: LiftedModel, track: str | Sequence[int], axes: Sequence[int] | None
) -> tuple[str, tuple[int, ...], tuple[int, ...]]:
    """Name, axes and state indices of the tracked outputs: a named group of the model or a list of states.

    ``axes`` picks coordinates within the group, e.g. (0, 1) for x and y of a tip. Raises ValueError otherwise.
    """
    if isinstance(track, str):
        if track not in model.outputs:
            known = ", ".join(map(repr, model.outputs)) or "none"
            raise ValueError(f"track = {track!r} names no output of the model; it has {known} (or give state indices)")
        name, group = track, tuple(model.outputs[track])
    else:
        name, group = "states", tuple(int(i) for i in track)
    chosen = tuple(range(len(group))) if axes is None else tuple(int(i) for i in axes)
    if not chosen or any(not 0 <= i < len(group) for i in chosen) or len(set(chosen)) < len(chosen):
        raise ValueError(f"axes = {axes} of {name!r}; expected different numbers from 0 to {len(group) - 1}")
    states = tuple(group[i] for i in chosen)
    if any(not 0 <= i < model.n_states for i in states):
        raise ValueError(f"track = {track}; expected state indices from 0 to {model.n_states - 1}")
    return name, chosen, states


def check_dt(model: LiftedModel, dt: float | None) -> None:
    """Raise ValueError if a wanted time step is not the model's."""
    if dt is not None and not np.isclose(dt, model.dt, rtol=1e-6, atol=0.0):
        raise ValueError(f"dt = {dt:g} s, but the model steps {model.dt:g} s; fit a model at the control interval")


def checked_window(window: ArrayLike, horizon: int, n_outputs: int) -> Array:
    """The window as float (H, p); NaN entries are free outputs. Raises ValueError on another shape or infinities."""
    r = np.asarray(window, dtype=np.float64)
    if r.shape != (horizon, n_outputs):
        raise ValueError(f"reference_window has shape {r.shape}; expected ({horizon}, {n_outputs}): steps k+1 .. k+H")
    if np.isinf(r).any():
        raise ValueError("reference_window has infinite entries; give numbers, or NaN where an output is free")
    return r


def start_input(u0: ArrayLike | None, u_min: Array, u_max: Array) -> Array:
    """u0 (m,), zeros if not given. Raises ValueError outside the box."""
    u = np.zeros(len(u_min)) if u0 is None else finite_array(u0, "u0", (len(u_min),)).copy()
    if (u < u_min).any() or (u > u_max).any():
        raise ValueError(f"u0 = {u} is outside u_min .. u_max; start the loop from an input inside the box")
    return u
