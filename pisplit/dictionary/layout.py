"""Which columns Theta(x, u) has: their order, names, physical quantities and positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pisplit.dictionary.compiled import Part
from pisplit.observables import Bilinear, Names

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """What the columns alone do not say: delays, and which plain columns the dictionary holds.

    state_delays, input_delays  numbers of past states, and of past values of phi, among the columns of psi
    constant, states, inputs    True if the column 1, all states, all inputs are columns
    """

    state_delays: int
    input_delays: int
    constant: bool
    states: bool
    inputs: bool


class Layout:
    """Order and names of the columns: psi (present, then past states, then past phi), phi, their products.

    n_states, n_inputs      n and m
    names                   of the states and inputs, and the physical quantity of each
    structure               delays and plain columns
    state_part, input_part  columns that are functions of x_k and of u_k, compiled
    products                positions (J,) of the columns of psi that are multiplied by every input
    """

    n_states: int
    n_inputs: int
    names: Names
    structure: Structure
    state_part: Part
    input_part: Part
    products: NDArray[np.int64]

    def lay_out(
        self,
        names: Names,
        structure: Structure,
        state_part: Part,
        input_part: Part,
        products: NDArray[np.int64] | None = None,
    ) -> None:
        """Set all of the above, once: ``names``, ``structure``, ``state_part``, ``input_part``.

        ``products`` default to none.
        """
        self.n_states, self.n_inputs = len(names.states), len(names.inputs)
        self.names, self.structure = names, structure
        self.state_part, self.input_part = state_part, input_part
        self.products = np.empty(0, dtype=np.int64) if products is None else products

    @property
    def state_delays(self) -> int:
        """Number of past states among the columns of psi."""
        return self.structure.state_delays

    @property
    def input_delays(self) -> int:
        """Number of past values of phi among the columns of psi."""
        return self.structure.input_delays

    @property
    def is_bilinear(self) -> bool:
        """True if Theta holds products of inputs and lifted columns."""
        return len(self.products) > 0

    @property
    def n_delays(self) -> int:
        """Steps of history that a lift needs, D = max(state delays, input delays)."""
        return max(self.state_delays, self.input_delays)

    @property
    def n_present(self) -> int:
        """Columns of psi that are functions of x_k; they come first."""
        return len(self.state_part.names)

    @property
    def n_lifted(self) -> int:
        """M_z, columns of psi."""
        return self.n_present + self.state_delays * self.n_states + self.input_delays * self.n_features

    @property
    def n_features(self) -> int:
        """P, columns of phi."""
        return len(self.input_part.names)

    @property
    def n_columns(self) -> int:
        """M = M_z + P (+ m times the multiplied columns), columns of Theta."""
        return self.n_lifted + self.n_features + self.n_inputs * len(self.products)

    @cached_property
    def column_names(self) -> tuple[str, ...]:
        """Names of all columns of Theta: psi, then phi, then their products with the inputs."""
        plain = self._plain_names()
        return (*plain, *(f"{u}*{plain[j]}" for u in self.names.inputs for j in self.products))

    @cached_property
    def column_quantities(self) -> tuple[str, ...]:
        """Physical quantity of every column: columns of one quantity share one scale."""
        plain = self._plain_quantities()
        return (*plain, *(f"{u}*{plain[j]}" for u in self.names.input_quantities for j in self.products))

    @property
    def lifted_names(self) -> tuple[str, ...]:
        """Names of the columns of psi."""
        return self._plain_names()[: self.n_lifted]

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the columns of phi."""
        return self.input_part.names

    @property
    def constant_column(self) -> int | None:
        """Position of the column 1, or None."""
        return self.state_part.names.index("1") if self.structure.constant else None

    @cached_property
    def learned_columns(self) -> NDArray[np.int64]:
        """Columns of psi whose dynamics are identified: all present ones but the constant (delays shift exactly)."""
        return np.array([i for i in range(self.n_present) if i != self.constant_column], dtype=np.int64)

    @cached_property
    def state_columns(self) -> NDArray[np.int64] | None:
        """Positions of the states among the present columns, or None if they are not there."""
        if not self.structure.states:
            return None
        names = self.state_part.names
        return np.array([names.index(name) for name in self.names.states], dtype=np.int64)

    @property
    def invert(self) -> Array | None:
        """C (n, M_z) with x = C psi, exact, when every state is a column; else None."""
        if self.state_columns is None:
            return None
        selection = np.zeros((self.n_states, self.n_lifted))
        selection[np.arange(self.n_states), self.state_columns] = 1.0
        return selection

    def multiplied(self, product: Bilinear) -> NDArray[np.int64]:
        """Positions of the lifted columns that ``product`` multiplies by the inputs: none where there are no inputs.

        Raises ValueError for names that are neither of a column nor of a quantity.
        """
        plain = range(self.n_lifted)
        if self.n_inputs == 0:
            return np.empty(0, dtype=np.int64)
        if product.columns is None:
            skipped = self.constant_column if self.structure.inputs else None
            return np.array([i for i in plain if i != skipped], dtype=np.int64)
        labels = list(zip(self._plain_names(), self._plain_quantities(), strict=True))[: self.n_lifted]
        unknown = [name for name in product.columns if not any(name in label for label in labels)]
        if unknown or not product.columns:
            raise ValueError(f"Bilinear names {unknown[:3]}; expected names or quantities of lifted columns")
        return np.array([i for i in plain if any(name in labels[i] for name in product.columns)], dtype=np.int64)

    def _plain_names(self) -> tuple[str, ...]:
        """Names of psi and phi, without products."""
        # The past of u1*u2 is not u1 times the past of u2, which a bilinear dictionary may hold beside it.
        past = [f"({name})" if "*" in name else name for name in self.input_part.names]
        labels = self._labels(self.state_part.names, self.names.states, past, "{}[k-{}]")
        return (*labels[: len(labels) - len(past)], *self.input_part.names)

    def _plain_quantities(self) -> tuple[str, ...]:
        return self._labels(self.state_part.quantities, self.names.quantities, self.input_part.quantities, "{}")

    def _labels(
        self, present: Sequence[str], states: Sequence[str], features: Sequence[str], form: str
    ) -> tuple[str, ...]:
        delayed = [form.format(label, j) for j in range(1, self.state_delays + 1) for label in states]
        past = [form.format(label, j) for j in range(1, self.input_delays + 1) for label in features]
        return (*present, *delayed, *past, *features)
