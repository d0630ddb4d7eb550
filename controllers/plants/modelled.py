"""A lifted model in the place of a plant: closed loops without the system, to choose weights by."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array
from pisplit.controllers.loop.plant import PlantStep
from pisplit.lifted.model import LiftedModel

#: Times the range of the training data beyond which the model says nothing of the system.
LOST = 30.0


class ModelPlant:
    """A plant that moves as a lifted ``model`` predicts, from rest at ``x_rest``.

    What a loop does on it is what it does where the model is right; a loop whose controller uses another model of the
    same system, fitted to other recordings, shows what the differences between models do.

    Args:
        model: what moves; its time step, names and units are those of the plant.
        x_rest: measured state (n,) at rest, where runs start.
    """

    def __init__(self, model: LiftedModel, x_rest: ArrayLike) -> None:
        self.model = model
        self.x_rest = finite_array(x_rest, "x_rest", (model.n_states,)).copy()
        self.dt = model.dt
        self.n_states, self.n_inputs = model.n_states, model.n_inputs
        self.state_names, self.input_names = model.state_names, model.input_names
        self.state_units, self.input_units = model.units, tuple(model.input_units or ())
        self._z = np.zeros(model.n_lifted)

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """The state at rest (n,), as it has been under ``u0`` (m,), zeros if not given, for as long as delays reach."""
        model, delays = self.model, self.model.n_delays
        u = np.zeros(self.n_inputs) if u0 is None else finite_array(u0, "u0", (self.n_inputs,))
        self._z = model.lift(np.tile(self.x_rest, (delays + 1, 1)), np.tile(u, (delays, 1)))
        return self.x_rest.copy()

    def step(self, u: ArrayLike) -> PlantStep:
        """The predicted state after one step under ``u`` (m,); not ok where it is 30 times the training range."""
        with np.errstate(over="ignore", invalid="ignore"):
            self._z = self.model.step(self._z, u)
            state = self.model.read(self._z)
        inside = np.isfinite(state).all() and (np.abs(state) <= LOST * self.model.state_range + 1e-12).all()
        return PlantStep(state, bool(inside), "" if inside else "the model leaves 30 times the range of its data")

    def snapshot(self) -> Array:
        """The lifted state (M,)."""
        return self._z.copy()

    def restore(self, snapshot: Array) -> None:
        """Go on from a ``snapshot`` (M,)."""
        self._z = finite_array(snapshot, "snapshot", (self.model.n_lifted,)).copy()
