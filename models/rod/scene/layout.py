"""Where what stands in a state of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple


class Parts(NamedTuple):
    """A state by its parts.

    Attributes:
        strains: free strains xi (..., n), node by node.
        rates: xi_t (..., n) per s.
        inputs: u (..., m) as they act at that moment.
    """

    strains: Any
    rates: Any
    inputs: Any


@dataclass(frozen=True)
class Layout:
    """Order of a state [xi, xi_t, u].

    Attributes:
        n_strains: number n of free strains at all nodes.
        n_inputs: number m of input entries.
    """

    n_strains: int
    n_inputs: int

    @property
    def n_moving(self) -> int:
        """Number of entries [xi, xi_t] that move by themselves; the inputs stand behind them."""
        return 2 * self.n_strains

    @property
    def size(self) -> int:
        """Number of all entries."""
        return self.n_moving + self.n_inputs

    @property
    def strains(self) -> slice:
        """Of xi."""
        return slice(0, self.n_strains)

    @property
    def rates(self) -> slice:
        """Of xi_t."""
        return slice(self.n_strains, 2 * self.n_strains)

    @property
    def moving(self) -> slice:
        """Of all that moves by itself."""
        return slice(0, self.n_moving)

    @property
    def inputs(self) -> slice:
        """Of u."""
        return slice(self.n_moving, self.size)

    def split(self, x: Any) -> Parts:
        """The parts of states ``x``: arrays (..., n_states), or a column (n_states, 1) of CasADi."""
        entries = (self.strains, self.rates, self.inputs)
        return Parts(*(x[s] if hasattr(x, "sparsity") else x[..., s] for s in entries))
