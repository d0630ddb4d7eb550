"""Which columns of the data are which states of a model: found by name, never by position."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import check_same_step
from pisplit.data.episodes import Episodes
from pisplit.lifted.model import LiftedModel

States = str | Sequence[int] | Sequence[str] | None


class Fitted(Protocol):
    """What was fitted and holds a model: any estimator."""

    @property
    def lifted(self) -> LiftedModel:
        """The fitted model."""


def model_of(model: LiftedModel | Fitted, name: str = "the estimator") -> LiftedModel:
    """``model`` itself, or that of an estimator, ``name`` in errors. Raises ValueError if that is not fitted."""
    if isinstance(model, LiftedModel):
        return model
    if not hasattr(model, "lifted"):
        raise ValueError(f"{name} is not fitted; call fit first")
    return model.lifted


def matched(model: LiftedModel, episodes: Episodes, states: States = None) -> Episodes:
    """The ``episodes`` with their columns in the order and units of the ``model``, found by name.

    ``states`` as in :func:`state_indices`. Raises ValueError, in one line, for another time step, other sizes, names or
    units, and for an output group ``states`` that both have, of different states.
    """
    check_same_step(episodes.dt, model.dt, "the episodes have", "the model")
    if (episodes.n_states, episodes.n_inputs) != (model.n_states, model.n_inputs):
        raise ValueError(
            f"the episodes have {episodes.n_states} states and {episodes.n_inputs} inputs; "
            f"the model {model.n_states} and {model.n_inputs}"
        )
    found = episodes.arranged(model.state_names, model.input_names, model.state_units, model.input_units)
    theirs, mine = (found.outputs or {}).get(str(states)), model.outputs.get(str(states))
    if theirs and mine and sorted(theirs) != sorted(mine):
        names = [[model.state_names[i] for i in group][:4] for group in (theirs, mine)]
        raise ValueError(f"{states!r} are the states {names[0]} in the data, {names[1]} in the model; give their names")
    return found


def state_indices(model: LiftedModel, states: States) -> NDArray[np.int64]:
    """Indices in a ``model`` of an output group, of named states, or of states given by index; all states for None."""
    if states is None:
        return np.arange(model.n_states)
    if isinstance(states, str):
        if states in model.outputs:
            return np.array(model.outputs[states], dtype=np.int64)
        states = [states]
    names = {name: i for i, name in enumerate(model.state_names)}
    indices = [names.get(s, -1) if isinstance(s, str) else int(s) for s in states]
    if not indices or any(not 0 <= i < model.n_states for i in indices):
        known = ", ".join([*model.outputs, *model.state_names][:8])
        raise ValueError(f"states = {states!r}; expected an output group, state names or indices ({known}, ...)")
    return np.array(indices, dtype=np.int64)
