"""Where what stands in a state of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple


class Parts(NamedTuple):
    """A state by its parts.

    Attributes:
        strains: free strains xi (..., n), node by node, and joint coordinates behind them.
        rates: xi_t (..., n) per s.
        overstress: sigma (..., b k) of b Maxwell branches, branch by branch, each as the k free strains.
        inputs: u (..., m) as they act at that moment.
    """

    strains: Any
    rates: Any
    overstress: Any
    inputs: Any


@dataclass(frozen=True)
class Layout:
    """Order of a state [xi, xi_t, sigma, u]; scenes without Maxwell branches have no sigma.

    Attributes:
        n_strains: number n of free strains at all nodes and of joint coordinates.
        n_inputs: number m of input entries.
        n_branches: number b of Maxwell branches.
        n_joint: number of joint coordinates of the base.
    """

    n_strains: int
    n_inputs: int
    n_branches: int = 0
    n_joint: int = 0

    @property
    def n_free(self) -> int:
        """Number of free strains at all nodes, without joint coordinates."""
        return self.n_strains - self.n_joint

    @property
    def n_overstress(self) -> int:
        """Number of entries of sigma."""
        return self.n_branches * self.n_free

    @property
    def n_moving(self) -> int:
        """Number of entries [xi, xi_t, sigma] that move by themselves; the inputs stand behind them."""
        return 2 * self.n_strains + self.n_overstress

    @property
    def n_acting(self) -> int:
        """Number of entries [sigma, u] that act on a motion beside its strains and their rates."""
        return self.n_overstress + self.n_inputs

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
    def joint(self) -> slice:
        """Of the joint coordinates, in xi."""
        return slice(self.n_strains - self.n_joint, self.n_strains)

    @property
    def joint_rates(self) -> slice:
        """Of their rates, in xi_t."""
        return slice(2 * self.n_strains - self.n_joint, 2 * self.n_strains)

    @property
    def overstress(self) -> slice:
        """Of sigma."""
        return slice(2 * self.n_strains, self.n_moving)

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
        return Parts(*(_entries(x, s) for s in (self.strains, self.rates, self.overstress, self.inputs)))

    def arguments(self, x: Any) -> tuple[Any, Any, Any]:
        """States ``x`` as functions of a motion take them: xi, xi_t and [sigma, u]; see ``split``."""
        acting = slice(2 * self.n_strains, self.size)
        return _entries(x, self.strains), _entries(x, self.rates), _entries(x, acting)


def _entries(x: Any, where: slice) -> Any:
    return x[where] if hasattr(x, "sparsity") else x[..., where]
