"""Whether inputs act as the model says, the other way round, or in each other's place."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pisplit.checks import Array
from pisplit.lifted.model import LiftedModel

#: Inputs up to which every order of them is tried; pairs that are swapped beyond.
EVERY_ORDER = 3


@dataclass(frozen=True, eq=False)
class InputFault:
    """A way in which wires, motors or tendons are mixed up: the plant takes offset + ``mixing`` (m, m) (u - offset)
    where the model is told u; ``name`` says so."""

    name: str
    mixing: Array

    @property
    def turned(self) -> bool:
        """Whether all inputs act the other way round."""
        return bool((self.mixing == -np.eye(len(self.mixing))).all())

    def acting(self, inputs: Array, offset: Array) -> Array:
        """What acts under ``inputs`` (..., m) about the ``offset`` (m,) of the model."""
        return np.asarray(offset + (inputs - offset) @ self.mixing.T)


def input_faults(model: LiftedModel) -> tuple[InputFault, ...]:
    """The faults of the inputs of a ``model`` that are looked for: all or one of them flipped; two or three in other
    places."""
    names, m = model.input_names, model.n_inputs
    found = [InputFault("the inputs act the other way round: a flipped sign, or wires that were swapped", -np.eye(m))]
    if m == 1:
        return tuple(found)
    for i in range(m):
        found.append(
            InputFault(f"{names[i]} acts the other way round: a flipped sign", np.eye(m) - 2.0 * _unit(i, i, m))
        )
    orders: list[tuple[int, ...]] = []
    if m <= EVERY_ORDER:
        orders = [p for p in itertools.permutations(range(m)) if p != tuple(range(m))]
    else:
        for i, j in itertools.combinations(range(m), 2):
            orders.append(tuple({i: j, j: i}.get(k, k) for k in range(m)))
    for order in orders:
        moved = [i for i in range(m) if order[i] != i]
        places = ", ".join(f"{names[order[i]]} moves what {names[i]} should" for i in moved)
        found.append(InputFault(f"inputs act in each other's place ({places})", np.eye(m)[list(order)]))
    return tuple(found)


def _unit(i: int, j: int, m: int) -> Array:
    e = np.zeros((m, m))
    e[i, j] = 1.0
    return e
