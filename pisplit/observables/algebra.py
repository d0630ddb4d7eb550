"""Observables made of observables: sums, products, compositions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement, product
from typing import Any

import casadi as ca

from pisplit.observables.basic import Bilinear, Delays
from pisplit.observables.columns import Base, Columns, Combining, Names, Symbol, monomial


class Sum(Combining):
    """The columns of several observables, ``a + b + c``; a dictionary takes its parts as if they stood alone."""

    def __init__(self, *parts: Any) -> None:
        self.parts = tuple(flattened(parts))

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.parts))

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Columns of all parts that depend on the state ``x`` (n,), with the ``names`` of states and inputs."""
        return _joined([_plain(part, "a sum").state_columns(x, names) for part in self.parts])

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Columns of all parts that depend on the input ``u`` (m,), with the ``names`` of states and inputs."""
        return _joined([_plain(part, "a sum").input_columns(u, names) for part in self.parts])


class Product(Base):
    """Every column of a times every column of b, state columns with state columns and input with input columns.

    The product of an observable with itself takes each pair once. Products of states and inputs are ``Bilinear``.
    """

    def __init__(self, a: Any, b: Any) -> None:
        self.a, self.b = _plain(a, "a product"), _plain(b, "a product")

    def __repr__(self) -> str:
        return f"{_in_brackets(self.a)} * {_in_brackets(self.b)}"

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """Products of the state columns of both. Raises ValueError where only a state and an input could meet."""
        found = self._products(self.a.state_columns(x, names), self.b.state_columns(x, names))
        if found is None and self.input_columns(type(x).sym("u", len(names.inputs)), names) is None:
            raise ValueError(f"{self!r} multiplies states and inputs; such products are ob.Bilinear, for BilinearEDMDc")
        return found

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Products of the input columns of both."""
        return self._products(self.a.input_columns(u, names), self.b.input_columns(u, names))

    def _products(self, a: Columns | None, b: Columns | None) -> Columns | None:
        if a is None or b is None:
            return None
        sizes = range(len(a.names)), range(len(b.names))
        same = a.names == b.names
        pairs = list(combinations_with_replacement(sizes[0], 2) if same else product(*sizes))
        return Columns(
            ca.vertcat(*[a.values[i] * b.values[j] for i, j in pairs]),
            tuple(monomial([a.names[i], b.names[j]]) for i, j in pairs),
            tuple(monomial(sorted((a.quantities[i], b.quantities[j]))) for i, j in pairs),
        )


class Composition(Base):
    """``outer`` of the columns of ``inner``: f(g(x)) in the state part, f(g(u)) in the input part.

    The columns of ``inner`` take the place of the states (inputs): ``compose(Polynomials(2), RodCoordinates(scene))``
    are the quadratic monomials of a rod's own coordinates. ``inner`` itself is no column; add it where it is wanted.
    """

    def __init__(self, outer: Any, inner: Any) -> None:
        self.outer, self.inner = _plain(outer, "a composition"), _plain(inner, "a composition")

    def __repr__(self) -> str:
        return f"compose({self.outer!r}, {self.inner!r})"

    def state_columns(self, x: Symbol, names: Names) -> Columns | None:
        """State columns of ``outer`` at the state columns of ``inner``."""
        inside = self.inner.state_columns(x, names)
        other = self.inner.input_columns(type(x).sym("u", len(names.inputs)), names)
        if inside is None:
            return None
        y = type(x).sym("y", len(inside.names))
        return _substituted(y, self.outer.state_columns(y, _renamed(names, inside, other)), inside.values)

    def input_columns(self, u: Symbol, names: Names) -> Columns | None:
        """Input columns of ``outer`` at the input columns of ``inner``."""
        inside = self.inner.input_columns(u, names)
        other = self.inner.state_columns(type(u).sym("x", len(names.states)), names)
        if inside is None:
            return None
        v = type(u).sym("v", len(inside.names))
        return _substituted(v, self.outer.input_columns(v, _renamed(names, other, inside)), inside.values)


def compose(outer: Any, inner: Any) -> Composition:
    """``outer`` of the columns of ``inner`` (:class:`Composition`)."""
    return Composition(outer, inner)


def flattened(observables: Any) -> Iterator[Any]:
    """The ``observables`` one by one, sums taken apart."""
    for observable in observables:
        if isinstance(observable, Sum):
            yield from observable.parts
        else:
            yield observable


def _renamed(names: Names, states: Columns | None, inputs: Columns | None) -> Names:
    return Names(
        states=names.states if states is None else states.names,
        inputs=names.inputs if inputs is None else inputs.names,
        quantities=names.quantities if states is None else states.quantities,
        input_quantities=names.input_quantities if inputs is None else inputs.quantities,
    )


def _substituted(symbol: Symbol, columns: Columns | None, values: Symbol) -> Columns | None:
    if columns is None:
        return None
    function = ca.Function("outer", [symbol], [columns.values])
    return Columns(function(values), columns.names, columns.quantities)


def _joined(parts: list[Columns | None]) -> Columns | None:
    found = [part for part in parts if part is not None]
    if not found:
        return None
    return Columns(
        ca.vertcat(*[part.values for part in found]),
        tuple(name for part in found for name in part.names),
        tuple(quantity for part in found for quantity in part.quantities),
    )


def _plain(observable: Any, where: str) -> Any:
    """An observable that writes its own columns."""
    if isinstance(observable, Delays | Bilinear):
        raise ValueError(f"{observable!r} cannot be part of {where}; give it to the dictionary itself")
    if isinstance(observable, type) or not hasattr(observable, "state_columns"):
        raise ValueError(f"{observable!r} is no observable; use those of pisplit.observables, with parentheses")
    return observable


def _in_brackets(observable: Any) -> str:
    return f"({observable!r})" if isinstance(observable, Sum) else repr(observable)
