"""What a closed loop needs of a plant: a simulator or the real arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from numpy.typing import ArrayLike

from pisplit.checks import Array


@dataclass(frozen=True)
class PlantStep:
    """``state`` (n_states,) measured after one step. ``ok`` False: the step failed, and ``message`` says why."""

    state: Array
    ok: bool = True
    message: str = ""


class Measurement(Protocol):
    """What a plant returns after a step: the entries of ``PlantStep``, in a class of its own if it likes."""

    @property
    def state(self) -> Array:
        """Measured state (n_states,)."""

    @property
    def ok(self) -> bool:
        """Whether the step succeeded."""

    @property
    def message(self) -> str:
        """Why it failed; empty on success."""


class Plant(Protocol):
    """A system that is stepped with inputs (n_inputs,) over ``dt`` seconds and measures states (n_states,).

    Optional: ``state_names``, ``input_names``, ``state_units``, ``input_units``, tuples of texts by which a closed loop
    matches the plant with a model whatever the order of its columns; ``snapshot()``, whose answer tells all that the
    next steps depend on, and ``restore(snapshot)``, by which a loop goes on from there to the last bit; ``send(u)``,
    which returns at once, and ``measure()`` -> PlantStep, which a loop in real time calls instead of ``step``, one at
    the beginning of a time step and the other at its end.
    Arrays that it returns are copied, and those it is given are its own: it may use one buffer for all steps.
    """

    @property
    def dt(self) -> float:
        """Time step [s]."""

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""

    @property
    def n_states(self) -> int:
        """Number of measured states."""

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """Back to rest, in equilibrium under ``u0`` (n_inputs,), zeros if not given; the measured state (n_states,)."""

    def step(self, u: Array) -> Measurement:
        """Apply ``u`` (n_inputs,) over one time step."""
