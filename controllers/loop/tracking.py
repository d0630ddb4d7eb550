"""Which states a controller tracks, and the checks its arguments share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, check_same_step, count, finite_array, real_array
from pisplit.lifted.model import LiftedModel


@dataclass(frozen=True, eq=False)
class Move:
    """What a controller answers to one measurement.

    u (m,): input to apply over the coming step, inside all limits. ``status``: the solver's word, or why there was no
    solve, after so many ``iterations``. ``fallback``: True if u comes from elsewhere: ``action`` says from where, in
    the order "shifted plan", "steady target", "hold", "return to rest". ``solve_time``:
    wall time of the whole step [s]; ``cpu_time``: CPU time of this thread in it [s]. ``predicted`` (H, p): outputs
    expected under the plan. ``missing``: entries of the measurement that were not there (NaN), for which the model's
    prediction stood; ``rejected``: those that an observer did not believe. ``stuck``: states whose sensors repeat
    themselves while the arm must have moved; they count as missing. ``warning``: what the controller has to say, empty
    otherwise; loops note it. ``acting`` (m,): what the controller takes to act on its model over the step, behind the
    delays and servos that it knows; u if not given.
    """

    u: Array
    status: str
    fallback: bool
    iterations: int
    solve_time: float
    cpu_time: float
    predicted: Array
    missing: int = 0
    rejected: int = 0
    stuck: tuple[int, ...] = ()
    action: str = ""
    warning: str = ""
    acting: Array | None = None


class Controller(Protocol):
    """What a closed loop needs of a controller."""

    @property
    def model(self) -> LiftedModel:
        """The model, for sizes, names, time step and admissible range."""

    @property
    def track(self) -> str:
        """Name of the tracked group of outputs, "" for a list of states."""

    @property
    def group(self) -> tuple[int, ...]:
        """Indices of the states of the whole group."""

    @property
    def axes(self) -> tuple[int, ...]:
        """Which coordinates of the group are tracked, in their order."""

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
        """The move for ``x_measured`` (n,), NaN where nothing was measured.

        ``reference_window`` (horizon, p): outputs wanted at the coming steps.
        """


@dataclass(frozen=True)
class Target:
    """What is tracked: ``axes`` of a ``group`` of states, in the order of ``axes``.

    ``name``: of the group in the model, "" for a list of states.
    """

    name: str
    group: tuple[int, ...]
    axes: tuple[int, ...]

    @property
    def states(self) -> tuple[int, ...]:
        """Indices of the tracked states."""
        return tuple(self.group[i] for i in self.axes)


def tracked_states(model: LiftedModel, track: str | Sequence[int | str], axes: Sequence[int] | None) -> Target:
    """The tracked states: a named group of the ``model``, or a list of state names or indices, given by ``track``.

    ``axes`` picks coordinates within the group in any order, e.g. (0, 1) for x and y of a tip. Raises ValueError
    otherwise, and for a model without inputs: nothing could be done to track.
    """
    if model.n_inputs == 0:
        raise ValueError("the model has no inputs: nothing can be controlled; fit it to recordings with inputs")
    if isinstance(track, str):
        if track not in model.outputs:
            known = ", ".join(map(repr, model.outputs)) or "none"
            raise ValueError(f"track = {track!r} names no output of the model; it has {known} (or give state indices)")
        name, group = track, tuple(int(i) for i in model.outputs[track])
    else:
        name, group = "", tuple(_state(model, entry) for entry in track)
    if axes is None:
        chosen = tuple(range(len(group)))
    else:
        chosen = tuple(count(i, "axes", 0) for i in axes)
    if not chosen or any(i >= len(group) for i in chosen) or len(set(chosen)) < len(chosen):
        raise ValueError(f"axes = {axes} of {name or track!r}; expected different numbers from 0 to {len(group) - 1}")
    target = Target(name, group, chosen)
    if len(set(target.states)) < len(chosen):
        raise ValueError(f"track = {track!r} names a state twice; give every state once")
    return target


def _state(model: LiftedModel, entry: int | str) -> int:
    """Index of a state given by name or index."""
    if isinstance(entry, str):
        if entry not in model.state_names:
            near = ", ".join(get_close_matches(entry, model.state_names)) or ", ".join(model.state_names[:6])
            raise ValueError(f"track names {entry!r}, which is no state of the model; near it: {near}")
        return model.state_names.index(entry)
    i = count(entry, "track", 0)
    if i >= model.n_states:
        raise ValueError(f"track = {i}; expected state names, or indices from 0 to {model.n_states - 1}")
    return i


def check_dt(model: LiftedModel, dt: float | None) -> None:
    """Raise ValueError if a wanted time step ``dt`` [s] is not that of the ``model``."""
    if dt is not None:
        check_same_step(dt, model.dt, "the loop is asked for", "the model has")


def checked_measurement(x: ArrayLike, n_states: int) -> Array:
    """The measured state ``x`` as float (``n_states``,); NaN entries were not measured.

    Raises ValueError on another shape or infinities.
    """
    state = real_array(x, "x_measured")
    if state.shape != (n_states,):
        raise ValueError(f"x_measured has shape {state.shape}; expected ({n_states},): the states of the model")
    if np.isinf(state).any():
        raise ValueError("x_measured has infinite entries; give numbers, or NaN where nothing was measured")
    return state


def checked_window(window: ArrayLike, horizon: int, n_outputs: int) -> Array:
    """The ``window`` as float (``horizon``, ``n_outputs``); NaN entries are free outputs.

    Raises ValueError on another shape or infinities.
    """
    r = real_array(window, "reference_window")
    if r.shape != (horizon, n_outputs):
        raise ValueError(f"reference_window has shape {r.shape}; expected ({horizon}, {n_outputs}): steps k+1 .. k+H")
    if np.isinf(r).any():
        raise ValueError("reference_window has infinite entries; give numbers, or NaN where an output is free")
    return r


def start_input(u0: ArrayLike | None, u_min: Array, u_max: Array) -> Array:
    """``u0`` (m,), zeros if not given. Raises ValueError outside the box ``u_min`` .. ``u_max`` (m,)."""
    u = np.zeros(len(u_min)) if u0 is None else finite_array(u0, "u0", (len(u_min),)).copy()
    if (u < u_min).any() or (u > u_max).any():
        raise ValueError(f"u0 = {u} is outside u_min .. u_max; start the loop from an input inside the box")
    return u
