"""What happens to commands on their way: networks delay them, drives round them, servos lag and play."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.history import Line
from pisplit.controllers.loop.plant import Plant
from pisplit.controllers.plants.wrapped import WrappedPlant
from pisplit.data.actuator import Actuator, ActuatorState, checked_actuator


class DelayedCommands(WrappedPlant):
    """Commands arrive ``steps`` samples late; before the first, the input of ``reset`` holds.

    A fraction of a step mixes two commands: the mean over the step of a command that is held, and the end of the step
    of one that is reached linearly.

    Args:
        plant: the inner plant.
        steps: delay in samples, fractions allowed.
    """

    def __init__(self, plant: Plant, steps: float) -> None:
        super().__init__(plant)
        self._line = Line(steps, "delay of commands")

    def _begin(self, u: Array, state: Array) -> None:
        self._line.fill(u)

    def _command(self, u: Array) -> Array:
        return self._line(u)

    def _own(self) -> Any:
        return self._line.own()

    def _take(self, own: Any) -> None:
        self._line.take(own)


class QuantisedCommands(WrappedPlant):
    """Commands are rounded to whole multiples of ``unit``, as drives with encoders and logs with few decimals do.

    Args:
        plant: the inner plant.
        unit: smallest change, a number or one an input (n_inputs,), in the unit of the input; zero rounds nothing.

    Raises ValueError for units below zero.
    """

    def __init__(self, plant: Plant, unit: ArrayLike) -> None:
        super().__init__(plant)
        given = np.broadcast_to(np.asarray(unit), (self.n_inputs,)) if np.ndim(unit) == 0 else unit
        self.unit = finite_array(given, "unit", (self.n_inputs,)).copy()
        if (self.unit < 0.0).any():
            raise ValueError(f"unit = {self.unit.tolist()}; expected zero or positive numbers")

    def _command(self, u: Array) -> Array:
        unit = np.where(self.unit > 0.0, self.unit, 1.0)
        return np.where(self.unit > 0.0, np.round(u / unit) * unit, u)


class ActuatedPlant(WrappedPlant):
    """Servos with lag, play and a rate limit stand between the commands and the inner plant.

    Args:
        plant: the inner plant.
        actuator: the servos, all alike.
        inputs: whether the inner plant reaches a command linearly over its step ("ramp", as displacements of rod scenes
            do) or holds it from its beginning ("step"); the servo gets its command in the same way.
    """

    def __init__(self, plant: Plant, actuator: Actuator, inputs: str = "ramp") -> None:
        super().__init__(plant)
        self.actuator, self.inputs = checked_actuator(actuator), inputs
        self._state = ActuatorState.at(np.zeros(self.n_inputs))
        actuator.simulate(np.zeros((0, self.n_inputs)), self.dt, self._state, inputs)  # refuses what it does not know

    @property
    def actuator_state(self) -> ActuatorState:
        """Where the servos are."""
        return self._state

    def _begin(self, u: Array, state: Array) -> None:
        self._state = ActuatorState.at(u)

    def _command(self, u: Array) -> Array:
        found, self._state = self.actuator.simulate(u[None, :], self.dt, self._state, self.inputs)
        return found[0]

    def _own(self) -> Any:
        return self._state

    def _take(self, own: Any) -> None:
        self._state = own
