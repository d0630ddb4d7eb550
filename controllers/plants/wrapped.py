"""A plant around a plant: names, units and sizes of the inner one, its true states kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.plant import Measurement, Plant, PlantStep

#: What a plant may tell of its columns.
TOLD = ("state_names", "state_units", "input_names", "input_units")


@dataclass(frozen=True)
class WrappedState:
    """What the next steps of a wrapped plant depend on: the inner plant's ``snapshot``, its ``own`` and true states."""

    inner: Any
    own: Any
    states: tuple[Array, ...]


class WrappedPlant:
    """A plant whose commands and measurements pass through a device; on its own it changes nothing.

    Names, units, sizes and time step are those of ``plant``. Devices that draw random numbers begin anew at every
    ``reset``: a run repeats to the last bit. Wrapped plants can be wrapped again, the outermost device sees the command
    first and the measurement last. A subclass writes ``_begin``, ``_command`` and ``_measured``.

    Args:
        plant: the inner plant.

    Raises ValueError for what is no plant.
    """

    def __init__(self, plant: Plant) -> None:
        for name in ("dt", "n_inputs", "n_states", "reset", "step"):
            if not hasattr(plant, name):
                raise ValueError(f"{type(plant).__name__} has no {name}; expected a plant: dt, sizes, reset and step")
        self.plant = plant
        self._states: list[Array] = []

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return float(self.plant.dt)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.plant.n_inputs)

    @property
    def n_states(self) -> int:
        """Number of measured states."""
        return int(self.plant.n_states)

    def __getattr__(self, name: str) -> Any:
        if name in TOLD:
            return getattr(self.plant, name)
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    @property
    def true_states(self) -> Array:
        """States (T+1, n_states) of the innermost plant since the last ``reset``, before any device measured them."""
        if isinstance(self.plant, WrappedPlant):
            return self.plant.true_states
        return np.array(self._states).reshape(len(self._states), self.n_states)

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """Back to rest under ``u0`` (n_inputs,), zeros if not given; what is measured there (n_states,)."""
        u = np.zeros(self.n_inputs) if u0 is None else finite_array(u0, "u0", (self.n_inputs,))
        state = self._copied(self.plant.reset(u.copy()))
        self._states = [state]
        self._begin(u, state)
        return self._measured(state.copy())

    def step(self, u: ArrayLike) -> Measurement:
        """Apply ``u`` (n_inputs,) over one time step and measure. A step that fails is handed on as it is."""
        given, before = finite_array(u, "u", (self.n_inputs,)).copy(), self._own()
        try:
            after = self.plant.step(self._command(given))
        except BaseException:
            self._take(before)  # the command was not carried out
            raise
        if not after.ok:
            self._take(before)
            return after
        state = self._copied(after.state)
        self._states.append(state)
        return PlantStep(self._measured(state.copy()), True, after.message)

    def snapshot(self) -> WrappedState:
        """What ``restore`` needs to go on from here to the last bit; the inner plant must have both methods."""
        inner: Any = self.plant
        return WrappedState(inner.snapshot(), self._own(), tuple(self._states))

    def restore(self, snapshot: WrappedState) -> None:
        """Go on from where ``snapshot`` was taken, of this plant or of one made alike."""
        inner: Any = self.plant
        inner.restore(snapshot.inner)
        self._take(snapshot.own)
        self._states = list(snapshot.states)

    def _copied(self, state: ArrayLike) -> Array:
        """The inner plant's states: its own buffers may be used again; NaN is handed on."""
        return np.array(state, dtype=np.float64)

    def _begin(self, u: Array, state: Array) -> None:
        """Start at rest under ``u`` (n_inputs,) with ``state`` (n_states,)."""

    def _command(self, u: Array) -> Array:
        """What reaches the inner plant of the command ``u`` (n_inputs,)."""
        return u

    def _measured(self, state: Array) -> Array:
        """What is measured of the inner plant's ``state`` (n_states,), at rest first and then once a step."""
        return state

    def _own(self) -> Any:
        """What the device remembers, a copy."""
        return None

    def _take(self, own: Any) -> None:
        """Remember what ``_own`` gave."""
