"""Observables: the building blocks of a :class:`pisplit.Dictionary` (``from pisplit import observables as ob``).

Every observable writes its columns for given symbols. A column belongs to the *state part* psi (functions of x_k) or to
the *input part* phi (functions of u_k); :class:`Delays` adds past values of both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, combinations_with_replacement
from typing import Any, Protocol

import casadi as ca

from pisplit.checks import count, finite_number, non_negative

Symbol = Any  # casadi SX or MX: an observable is written once for both


@dataclass(frozen=True)
class Names:
    """Names of the states and inputs, and the physical quantity of each."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    quantities: tuple[str, ...]
    input_quantities: tuple[str, ...]


@dataclass(frozen=True)
class Columns:
    """Some columns: a CasADi column vector, and a name and a physical quantity (the scaling group) for each entry."""

    values: Symbol
    names: tuple[str, ...]
    quantities: tuple[str, ...]


class Observable(Protocol):
    """What a dictionary asks of an observable (:class:`Delays` apart, which the dictionary fills itself)."""

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the state x (n,)."""

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the input u (m,)."""


class _Nothing:
    """No columns in either part; observables override the part they fill."""

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        return None

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        return None


@dataclass(frozen=True)
class Constant(_Nothing):
    """The column 1, which carries the constant part of an affine model."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return Columns(type(x).ones(1), ("1",), ("1",))


@dataclass(frozen=True)
class States(_Nothing):
    """The states x_k themselves."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return Columns(x, names.states, names.quantities)


@dataclass(frozen=True)
class Inputs(_Nothing):
    """The inputs u_k themselves."""

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        return Columns(u, names.inputs, names.input_quantities)


@dataclass(frozen=True)
class Identity(_Nothing):
    """States and inputs as they are (:class:`States` and :class:`Inputs`)."""

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return States().state_columns(x, names)

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        return Inputs().input_columns(u, names)


@dataclass(frozen=True)
class Delays:
    """Past states x_{k-1}..x_{k-states}, and the input part of the dictionary at u_{k-1}..u_{k-inputs}.

    Delayed states need the states themselves in the dictionary, because x_{k-1} is the next value's x_k.
    """

    states: int = 0
    inputs: int = 0

    def __post_init__(self) -> None:
        count(self.states, "states", minimum=0)
        count(self.inputs, "inputs", minimum=0)


@dataclass(frozen=True)
class Polynomials(_Nothing):
    """Monomials of the states of total degree 2 to ``degree`` (degree 0 is Constant, degree 1 States)."""

    degree: int

    def __post_init__(self) -> None:
        count(self.degree, "degree", minimum=2)

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        powers = [c for d in range(2, self.degree + 1) for c in combinations_with_replacement(range(x.shape[0]), d)]
        values = ca.vertcat(*[_product([x[i] for i in power]) for power in powers])
        return Columns(
            values,
            tuple(_monomial([names.states[i] for i in power]) for power in powers),
            tuple(_monomial(sorted(names.quantities[i] for i in power)) for power in powers),
        )


@dataclass(frozen=True)
class Slack(_Nothing):
    """Hinges of tendon inputs: max(0, u_i - k) for every knot k, max(0, u_i + u_j), max(0, -u_i - u_j).

    A tendon that goes slack has such a kink in its input. ``width`` [unit of u] > 0 replaces max(0, s) by the smooth
    softplus of that width, whose Jacobian a controller needs; 0 keeps the kink. ``knots`` are in the unit of u.
    """

    width: float = 0.0
    knots: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        non_negative(self.width, "width")
        object.__setattr__(self, "knots", tuple(finite_number(k, "knots") for k in self.knots))

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        m = u.shape[0]
        pairs = list(combinations(range(m), 2))
        arguments = [u[i] - k for k in self.knots for i in range(m)]
        labels = [f"{names.inputs[i]}{-k:+g}" if k else names.inputs[i] for k in self.knots for i in range(m)]
        arguments += [u[i] + u[j] for i, j in pairs] + [-u[i] - u[j] for i, j in pairs]
        labels += [f"{names.inputs[i]}+{names.inputs[j]}" for i, j in pairs]
        labels += [f"-{names.inputs[i]}-{names.inputs[j]}" for i, j in pairs]
        values = ca.vertcat(*[self._hinge(argument) for argument in arguments])
        return Columns(values, tuple(f"max(0,{label})" for label in labels), ("slack",) * len(labels))

    def _hinge(self, s: Symbol) -> Symbol:
        if self.width == 0.0:
            return ca.fmax(s, 0)
        return self.width * ca.log1p(ca.exp(-ca.fabs(s) / self.width)) + ca.fmax(s, 0)


@dataclass(frozen=True)
class Expression(_Nothing):
    """Any columns ``function(x, u)`` written in CasADi operations, of the state alone or of the input alone.

    ``name`` is one text, or one for each column; ``quantity`` the scaling group (default: each column its own).
    Raises ValueError if the columns depend on both x and u.
    """

    function: Callable[[Symbol, Symbol], Symbol]
    name: str | Sequence[str] = field(kw_only=True)
    quantity: str | None = field(default=None, kw_only=True)

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        u = type(x).sym("u", len(names.inputs))
        values, of_state, of_input = self._evaluate(x, u)
        return self._columns(values) if of_state or not of_input else None

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        x = type(u).sym("x", len(names.states))
        values, of_state, of_input = self._evaluate(x, u)
        return self._columns(values) if of_input and not of_state else None

    def _evaluate(self, x: Symbol, u: Symbol) -> tuple[Symbol, bool, bool]:
        result = self.function(x, u)
        values = ca.vec(ca.vertcat(*result) if isinstance(result, list | tuple) else type(x)(result))
        of_state, of_input = bool(ca.depends_on(values, x)), bool(ca.depends_on(values, u))
        if of_state and of_input:
            raise ValueError(
                f"Expression {self.name!r} depends on x and on u; a linear model takes functions of one of them "
                "(products of both belong to BilinearEDMDc)"
            )
        return values, of_state, of_input

    def _columns(self, values: Symbol) -> Columns:
        names = _column_names(self.name, values.shape[0])
        return Columns(values, names, (self.quantity,) * len(names) if self.quantity else names)


@dataclass(frozen=True)
class StateMap(_Nothing):
    """Columns ``function(x)`` of a CasADi Function x (n,) -> (p,), for instance a robot's own coordinates.

    ``names`` and ``quantities`` have p entries (quantities default to the names: each column its own scale).
    """

    function: ca.Function
    names: str | Sequence[str] = "map"
    quantities: Sequence[str] | None = None

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        return _call(self.function, x, "x", self.names, self.quantities)


class CoordinateSource(Protocol):
    """A model that reads its own coordinates from measured states, such as a rod scene."""

    def coordinates(self, stations: Any) -> Any:
        """An object with ``function`` (CasADi, x -> coordinates), ``names`` and ``quantities``."""


def RodCoordinates(scene: CoordinateSource, stations: Any = 6) -> StateMap:
    """Columns of a rod's own coordinates (strains and their rates) read from its measured fields at stations."""
    found = scene.coordinates(stations)
    return StateMap(found.function, found.names, found.quantities)


@dataclass(frozen=True)
class Equilibrium(_Nothing):
    """Columns ``function(u)`` of a CasADi Function u (m,) -> (p,): features of the equilibrium x_eq(u) under u.

    The function may contain a rootfinder or an interpolant. ``quantities`` default to one scale for all features.
    """

    function: ca.Function
    names: str | Sequence[str] = "x_eq"
    quantities: Sequence[str] | None = None

    def input_columns(self, u: Symbol, names: Names) -> Columns:
        size = self.function.numel_out(0)
        quantities = ("x_eq",) * size if self.quantities is None else self.quantities
        return _call(self.function, u, "u", self.names, quantities)


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
    labels = _column_names(names, values.shape[0])
    groups = labels if quantities is None else tuple(str(q) for q in quantities)
    if len(groups) != len(labels):
        raise ValueError(f"quantities has {len(groups)} entries; expected {len(labels)}, one a column")
    return Columns(values, labels, groups)


def _column_names(given: str | Sequence[str], size: int) -> tuple[str, ...]:
    if isinstance(given, str):
        return (given,) if size == 1 else tuple(f"{given}[{i + 1}]" for i in range(size))
    if len(given) != size:
        raise ValueError(f"{len(given)} names given for {size} columns: {tuple(given)[:6]}")
    return tuple(str(name) for name in given)


def _product(factors: list[Symbol]) -> Symbol:
    result = factors[0]
    for factor in factors[1:]:
        result = result * factor
    return result


def _monomial(names: list[str]) -> str:
    unique = dict.fromkeys(names)
    return "*".join(name if names.count(name) == 1 else f"{name}^{names.count(name)}" for name in unique)
