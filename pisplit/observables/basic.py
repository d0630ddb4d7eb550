"""The plain columns: constant, states, inputs, and their past."""

from __future__ import annotations

from dataclasses import dataclass

from pisplit.checks import count
from pisplit.observables.columns import Base, Columns, Combining, Names, Symbol


@dataclass(frozen=True)
class Constant(Base):
    """The column 1, which carries the constant part of an affine model."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return Columns(type(x).ones(1), ("1",), ("1",))


@dataclass(frozen=True)
class States(Base):
    """The states x_k themselves."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return Columns(x, names.states, names.quantities)


@dataclass(frozen=True)
class Inputs(Base):
    """The inputs u_k themselves."""

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        return Columns(u, names.inputs, names.input_quantities)


@dataclass(frozen=True)
class Identity(Base):
    """States and inputs as they are (:class:`States` and :class:`Inputs`)."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return States().state_columns(x, names)

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        return Inputs().input_columns(u, names)


@dataclass(frozen=True)
class Delays(Combining):
    """Past states x_{k-1}..x_{k-states}, and the input part of the dictionary at u_{k-1}..u_{k-inputs}.

    Delayed states need the states themselves in the dictionary, because x_{k-1} is the next value's x_k.
    """

    states: int = 0
    inputs: int = 0

    def __post_init__(self) -> None:
        count(self.states, "states", minimum=0)
        count(self.inputs, "inputs", minimum=0)


@dataclass(frozen=True)
class Bilinear(Combining):
    """Products u_i z_j of every input with lifted columns (paper, eq. of B-EDMDc; for ``BilinearEDMDc``).

    ``columns``: names or physical quantities of the lifted columns that are multiplied, delayed ones by their names
    ("x1[k-1]"). Default: all of them, the constant only where the inputs themselves are no columns: u_i * 1 = u_i.
    """

    columns: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.columns is not None:
            names = (self.columns,) if isinstance(self.columns, str) else tuple(str(c) for c in self.columns)
            object.__setattr__(self, "columns", names)
