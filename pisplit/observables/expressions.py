"""Columns that the user writes: CasADi expressions, and functions of states or of inputs."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import casadi as ca

from pisplit.data.columns import column_order
from pisplit.observables.columns import Base, Columns, Names, Symbol, column_names
from pisplit.observables.own_errors import is_of_casadi


@dataclass(frozen=True)
class Expression(Base):
    """Any columns ``function(x, u)`` written in CasADi operations, of the state alone or of the input alone.

    ``name`` is one text, or one for each column; ``quantity`` the scaling group (default: each column its own).
    A function that Python cannot pickle, such as a lambda, travels between processes as the columns it gave for the
    numbers of states and inputs that it has met. Raises ValueError if the columns depend on both x and u.
    """

    function: Callable[[Symbol, Symbol], Symbol]
    name: str | Sequence[str] = field(kw_only=True)
    quantity: str | None = field(default=None, kw_only=True)
    _met: set[tuple[int, int]] = field(default_factory=set, init=False, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        try:
            pickle.dumps(self.function)
        except (pickle.PicklingError, AttributeError, TypeError):  # the three ways in which pickle says no
            state["function"] = _Written({sizes: _written(self._values, *sizes) for sizes in sorted(self._met)})
        return state

    def __copy__(self) -> Expression:
        return self  # never changed

    def __deepcopy__(self, memo: Any) -> Expression:
        return self

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        u = type(x).sym("u", len(names.inputs))
        values, of_state, of_input = self._evaluate(x, u)
        return self._columns(values) if of_state or not of_input else None

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        x = type(u).sym("x", len(names.states))
        values, of_state, of_input = self._evaluate(x, u)
        return self._columns(values) if of_input and not of_state else None

    def _evaluate(self, x: Symbol, u: Symbol) -> tuple[Symbol, bool, bool]:
        values = self._values(x, u)
        self._met.add((x.numel(), u.numel()))
        of_state, of_input = bool(ca.depends_on(values, x)), bool(ca.depends_on(values, u))
        if of_state and of_input:
            raise ValueError(
                f"Expression {self.name!r} depends on x and on u; a linear model takes functions of one of them "
                "(products of both belong to BilinearEDMDc)"
            )
        return values, of_state, of_input

    def _values(self, x: Symbol, u: Symbol) -> Symbol:
        result = self.function(x, u)
        return ca.vec(ca.vertcat(*result) if isinstance(result, list | tuple) else type(x)(result))

    def _columns(self, values: Symbol) -> Columns:
        names = column_names(self.name, values.shape[0])
        return Columns(values, names, (self.quantity,) * len(names) if self.quantity else names)


@dataclass(frozen=True)
class _Written:
    """What a function x, u -> columns gave, as CasADi Functions by the numbers of states and inputs."""

    functions: dict[tuple[int, int], ca.Function]

    def __call__(self, x: Symbol, u: Symbol) -> Symbol:
        sizes = (x.numel(), u.numel())
        if sizes not in self.functions:
            raise ValueError(
                f"an Expression from another process is asked for {sizes[0]} states and {sizes[1]} inputs; "
                f"it knows {sorted(self.functions)}: write it anew, or give it a function that pickle takes"
            )
        return self.functions[sizes](x, u)


def _written(values: Callable[[Symbol, Symbol], Symbol], n: int, m: int) -> ca.Function:
    """``values`` as a CasADi Function of n states and m inputs, in SX where it can be."""

    def written(kind: Any) -> ca.Function:
        x, u = kind.sym("x", n), kind.sym("u", m)
        return ca.Function("expression", [x, u], [values(x, u)])

    try:
        return written(ca.SX)
    except (RuntimeError, NotImplementedError) as error:
        if not is_of_casadi(error):
            raise
        return written(ca.MX)  # CasADi's ways to say that a Function inside takes no SX


@dataclass(frozen=True)
class StateMap(Base):
    """Columns ``function(x)`` of a CasADi Function x (n,) -> (p,), for instance a robot's own coordinates.

    ``names`` and ``quantities`` have p entries (quantities default to the names: each column its own scale).
    ``takes`` (n,) names the states that the function takes, in its order: data may then have theirs in any other order,
    and those with other names are refused; None takes them as they come.
    """

    function: ca.Function
    names: str | Sequence[str] = "map"
    quantities: Sequence[str] | None = None
    takes: Sequence[str] | None = None

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        x = _taken(x, names.states, self.takes, "states")
        return _call(self.function, x, "x", self.names, self.quantities)


class CoordinateSource(Protocol):
    """A model that reads its own coordinates from measured states, such as a rod scene."""

    def coordinates(self, stations: Any) -> Any:
        """An object with ``function`` (CasADi, x -> coordinates), ``names``, ``quantities``, and ``takes``: names of x.

        ``stations`` are where the states are measured: arclengths [m] or their number.
        """


def RodCoordinates(scene: CoordinateSource, stations: Any = 6) -> StateMap:
    """Columns of a rod's own coordinates (strains and their rates) read from its fields measured at ``stations``.

    ``scene`` is the rod, ``stations`` arclengths [m] or their number. Fields are found by their names, in any order.
    """
    found = scene.coordinates(stations)
    return StateMap(found.function, found.names, found.quantities, found.takes)


@dataclass(frozen=True)
class Equilibrium(Base):
    """Columns ``function(u)`` of a CasADi Function u (m,) -> (p,): features of the equilibrium x_eq(u) under u.

    The function may contain a rootfinder or an interpolant. ``names`` (p,) or one text; ``quantities`` default to one
    scale for all features. ``takes`` (m,) names the inputs that the function takes, in its order, as in
    :class:`StateMap`.
    """

    function: ca.Function
    names: str | Sequence[str] = "x_eq"
    quantities: Sequence[str] | None = None
    takes: Sequence[str] | None = None

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        size = self.function.numel_out(0)
        quantities = ("x_eq",) * size if self.quantities is None else self.quantities
        u = _taken(u, names.inputs, self.takes, "inputs")
        return _call(self.function, u, "u", self.names, quantities)


def _taken(symbol: Symbol, given: Sequence[str], takes: Sequence[str] | None, what: str) -> Symbol:
    """The entries of ``symbol``, which have the names ``given``, in the order that the function ``takes``."""
    if takes is None:
        return symbol
    return symbol[column_order(given, takes, what, "the dictionary", "a function in it").tolist()]


def _call(
    function: ca.Function, symbol: Symbol, what: str, names: str | Sequence[str], quantities: Sequence[str] | None
) -> Columns:
    if not isinstance(function, ca.Function):
        raise ValueError(f"function is a {type(function).__name__}; expected a casadi.Function of {what}")
    if function.n_in() != 1 or function.numel_in(0) != symbol.shape[0]:
        given = [function.numel_in(i) for i in range(function.n_in())]
        raise ValueError(
            f"{function.name()} takes arguments of sizes {given}; expected one: {what} ({symbol.shape[0]},)"
        )
    values = ca.vec(ca.densify(function(symbol)))
    labels = column_names(names, values.shape[0])
    groups = labels if quantities is None else tuple(str(q) for q in quantities)
    if len(groups) != len(labels):
        raise ValueError(f"quantities has {len(groups)} entries; expected {len(labels)}, one a column")
    return Columns(values, labels, groups)
