"""What every observable writes: named columns of the state part or of the input part, and how observables combine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import casadi as ca

from pisplit.checks import one_of

if TYPE_CHECKING:
    from pisplit.observables.algebra import Product, Sum

Symbol = Any  # casadi SX or MX: an observable is written once for both

SIDES = ("states", "inputs")


@dataclass(frozen=True)
class Names:
    """Names of the ``states`` (n,) and ``inputs`` (m,).

    Their physical ``quantities`` (n,) and ``input_quantities`` (m,).
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    quantities: tuple[str, ...]
    input_quantities: tuple[str, ...]


@dataclass(frozen=True)
class Columns:
    """Some columns: a CasADi column vector ``values``, and for each entry one of the ``names`` and ``quantities``.

    Columns of one physical quantity share a scale.
    """

    values: Symbol
    names: tuple[str, ...]
    quantities: tuple[str, ...]


class Observable(Protocol):
    """What a dictionary asks of an observable (it fills ``Delays`` and ``Bilinear`` itself)."""

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the state ``x`` (n,), with the ``names`` of states and inputs.

        None if there are none.
        """

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the input ``u`` (m,), with the ``names`` of states and inputs.

        None if there are none.
        """


class Combining:
    """``a + b``: the columns of both. ``a * b``: the products of a column of a and one of b."""

    def __add__(self, other: Any) -> Sum:
        from pisplit.observables.algebra import Sum

        return Sum(self, other)

    def __mul__(self, other: Any) -> Product:
        from pisplit.observables.algebra import Product

        return Product(self, other)


class Base(Combining):
    """No columns in either part; observables override the part they fill."""

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the state ``x`` (n,), with the ``names`` of states and inputs.

        None if there are none.
        """
        return None

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the input ``u`` (m,), with the ``names`` of states and inputs.

        None if there are none.
        """
        return None


class OneSided(Base, ABC):
    """An observable that writes the same columns of some variables of one side: ``of`` = "states" or "inputs".

    ``variables``: names or positions of the states (inputs) that it takes; None takes all.
    """

    of: str
    variables: Sequence[str] | Sequence[int] | None

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the state ``x`` (n,), with the ``names`` of states and inputs.

        None if there are none.
        """
        if one_of(self.of, "of", SIDES) == "inputs":
            return None
        return self._write(*chosen(x, names.states, names.quantities, self.variables))

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Columns that depend on the input ``u`` (m,), with the ``names`` of states and inputs.

        None if there are none.
        """
        if one_of(self.of, "of", SIDES) == "states":
            return None
        return self._write(*chosen(u, names.inputs, names.input_quantities, self.variables))

    @abstractmethod
    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        """The columns of the chosen variables v."""


def chosen(
    symbol: Symbol,
    labels: tuple[str, ...],
    quantities: tuple[str, ...],
    variables: Sequence[str] | Sequence[int] | None,
) -> tuple[Symbol, tuple[str, ...], tuple[str, ...]]:
    """The entries of ``symbol`` named by ``variables`` (names or positions), with their names and quantities.

    ``labels`` and ``quantities`` are those of all entries. Raises ValueError for unknown or repeated variables.
    """
    if variables is None:
        return symbol, labels, quantities
    given: list[Any] = [variables] if isinstance(variables, str) else list(variables)
    positions = {label: i for i, label in enumerate(labels)}
    found = [positions.get(v, -1) if isinstance(v, str) else int(v) for v in given]
    if not found or any(not 0 <= i < len(labels) for i in found) or len(set(found)) != len(found):
        raise ValueError(f"variables = {variables!r}; expected different names or positions among {labels[:6]}")
    entries = ca.vertcat(*[symbol[i] for i in found])
    return entries, tuple(labels[i] for i in found), tuple(quantities[i] for i in found)


def column_names(given: str | Sequence[str], size: int) -> tuple[str, ...]:
    """Names of ``size`` columns: those given, or one text with a number for each."""
    if isinstance(given, str):
        return (given,) if size == 1 else tuple(f"{given}[{i + 1}]" for i in range(size))
    if len(given) != size:
        raise ValueError(f"{len(given)} names given for {size} columns: {tuple(given)[:6]}")
    return tuple(str(name) for name in given)


def monomial(names: Sequence[str]) -> str:
    """Name of the product of columns called ``names``: equal factors become a power."""
    factors = list(names)
    unique = dict.fromkeys(factors)
    return "*".join(name if factors.count(name) == 1 else f"{name}^{factors.count(name)}" for name in unique)


def linear_form(weights: Sequence[float], labels: Sequence[str], offset: float = 0.0) -> str:
    """Text of w . v + ``offset`` with ``weights`` w and variables called ``labels``, such as "2*x1-x2+0.5".

    "0" if all numbers are zero.
    """
    text = ""
    for weight, label in zip(weights, labels, strict=True):
        if weight:
            size = "" if abs(weight) == 1.0 else f"{abs(weight):.6g}*"
            text += f"{'-' if weight < 0 else '+' if text else ''}{size}{label}"
    if offset:
        text += f"{offset:+.6g}" if text else f"{offset:.6g}"
    return text or "0"
