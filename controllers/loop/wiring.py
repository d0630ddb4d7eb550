"""Which column of a plant is which state or input of a model: by name and unit where the plant tells them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array, check_same_step, count, real_array
from pisplit.controllers.loop.plant import Plant
from pisplit.data.columns import column_order, unit_factors
from pisplit.lifted.model import LiftedModel


@dataclass(frozen=True, eq=False)
class Channel:
    """States or inputs of a plant, ``size`` of them, as a model has them: model = factors * plant[order].

    ``order`` (k,) positions in the plant, ``factors`` (k,) from its units to the model's, ``units`` (k,) of the model's
    columns, "" where nobody tells.
    """

    size: int
    order: NDArray[np.int64]
    factors: Array
    units: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Wiring:
    """How the ``states`` and ``inputs`` of a plant are those of a model. Build it with ``wire``."""

    states: Channel
    inputs: Channel

    def measured(self, x: Any) -> Array:
        """State (n,) of the model from what the plant measured, ``x``: a copy, NaN where it is masked.

        Raises ValueError for another shape or what is no real number.
        """
        state = real_array(x, "the plant's measurement")
        if state.shape != (self.states.size,):
            raise ValueError(f"the plant measured an array of shape {state.shape}; expected ({self.states.size},)")
        return np.asarray(self.states.factors * state[self.states.order])

    def applied(self, u: Array) -> Array:
        """Input (m,) for the plant from the model's ``u`` (m,): a copy, which the plant may keep or change."""
        command = np.empty(self.inputs.size)
        command[self.inputs.order] = u / self.inputs.factors
        return command


def wire(plant: Plant, model: LiftedModel) -> Wiring:
    """Match a ``plant`` with a ``model``: by name where both have names, by position otherwise.

    A plant tells names in ``state_names``, ``input_names`` and units in ``state_units``, ``input_units``, all optional;
    numbers in another unit of the same kind are converted. It may measure more than the model knows. Raises ValueError
    on other sizes, names, units or time steps, in one line.
    """
    check_same_step(plant.dt, model.dt, "the plant has", "the model")
    return Wiring(
        _channel(plant, "state", plant.n_states, model.state_names, model.state_units),
        _channel(plant, "input", plant.n_inputs, model.input_names, model.input_units),
    )


def _channel(
    plant: Plant, what: str, plant_size: int, wanted: tuple[str, ...], wanted_units: Sequence[str] | None
) -> Channel:
    size = count(plant_size, f"the plant's n_{what}s", 0)
    names, units = _told(plant, f"{what}_names", size), _told(plant, f"{what}_units", size)
    known = np.arange(size)
    if names is not None and what == "state" and set(wanted) <= set(names):  # what the model does not know is left out
        known = np.array([i for i, name in enumerate(names) if name in wanted], dtype=np.int64)
    if len(known) != len(wanted):
        raise ValueError(
            f"the plant has {size} {what}s, the model {len(wanted)}: a model fitted for another arm; refit it"
        )
    given = None if names is None else [names[i] for i in known]
    order = known if given is None else known[column_order(given, wanted, f"{what}s", "the plant", "the model")]
    told = None if units is None else [units[i] for i in order]
    factors = unit_factors(told, wanted_units, wanted, "the plant", "the model")
    mine = tuple(wanted_units or ("",) * len(wanted))
    joined = mine if told is None else tuple(a or b for a, b in zip(mine, told, strict=True))
    return Channel(size, order, factors, joined)


def _told(plant: Plant, name: str, size: int) -> tuple[str, ...] | None:
    """What the plant tells of itself, or None."""
    value = getattr(plant, name, None)
    if value is None:
        return None
    told = tuple(str(entry) for entry in value)
    if isinstance(value, str) or len(told) != size or (name.endswith("names") and len(set(told)) != size):
        raise ValueError(f"the plant's {name} = {value!r}; expected {size} texts, one a column, no name twice")
    return told
