"""The columns of one part of a dictionary as one CasADi Function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from pisplit.observables import Columns, Names
from pisplit.observables.own_errors import is_of_casadi

#: Scalar instructions from which matrix instructions are tried, and how many times fewer they must be.
LARGE, FEWER = 20_000, 100


@dataclass(frozen=True)
class Part:
    """The columns of one part (state or input): a CasADi ``function`` with the ``names`` and ``quantities`` of each."""

    function: ca.Function
    names: tuple[str, ...]
    quantities: tuple[str, ...]


def compile_part(
    letter: str, size: int, writers: Sequence[Callable[[Any, Names], Columns | None]], names: Names
) -> Part:
    """Write all columns of one part in SX, which evaluates fastest, or in MX if one of them cannot be.

    Products with large matrices (random Fourier features of many states) are the exception: scalar by scalar they take
    seven times as long as whole.

    letter   of the symbol: "x" or "u"
    size     of the symbol
    writers  functions of the symbol and ``names`` that write the columns of one observable, or None for no columns
    names    of states and inputs

    Raises ValueError for columns that CasADi cannot write. Errors of the writers' own are theirs, from the first call.
    """
    try:
        scalar = _as(ca.SX, letter, size, writers, names)
        if scalar.function.n_instructions() <= LARGE:
            return scalar
        whole = _as(ca.MX, letter, size, writers, names)
        return whole if FEWER * whole.function.n_instructions() < scalar.function.n_instructions() else scalar
    except (RuntimeError, NotImplementedError) as error:
        if not is_of_casadi(error):
            raise
        # CasADi's two ways to say that a Function inside (a rootfinder, an interpolant) takes no SX
    try:
        return _as(ca.MX, letter, size, writers, names)
    except (RuntimeError, NotImplementedError) as error:
        if not is_of_casadi(error):
            raise
        reason = str(error).strip().splitlines()[-1]
        raise ValueError(f"an observable of {letter} ({size},) cannot be written in CasADi: {reason}") from None


def _as(
    kind: Any, letter: str, size: int, writers: Sequence[Callable[[Any, Names], Columns | None]], names: Names
) -> Part:
    symbol = kind.sym(letter, size)
    columns = [part for part in (write(symbol, names) for write in writers) if part is not None]
    values = ca.densify(ca.vertcat(*[part.values for part in columns])) if columns else kind(0, 1)
    return Part(
        function=ca.Function(f"columns_of_{letter}", [symbol], [values]),
        names=tuple(name for part in columns for name in part.names),
        quantities=tuple(quantity for part in columns for quantity in part.quantities),
    )
