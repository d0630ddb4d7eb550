"""Checks of what a lifted model is made of."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca


def units_of(given: Sequence[str] | None, what: str, size: int) -> tuple[str, ...]:
    """Units ``given`` for ``size`` columns, "" where one is not known; ``what`` they belong to stands in errors.

    Raises ValueError for another number, or what is no text.
    """
    units = ("",) * size if given is None else tuple(given)
    if len(units) != size or not all(isinstance(unit, str) for unit in units):
        raise ValueError(f'{what} = {given!r}; expected {size} texts, "" where the unit is not known')
    return units


def check_signature(function: ca.Function, name: str, shapes: tuple[tuple[int, int], ...], rows: int) -> None:
    """Raise ValueError unless ``function``, called ``name``, maps arguments of ``shapes`` to one of (``rows``, 1)."""
    if not isinstance(function, ca.Function):
        raise ValueError(f"{name} is a {type(function).__name__}; expected a casadi.Function")
    given = tuple(function.size_in(i) for i in range(function.n_in()))
    if given != shapes or function.n_out() != 1 or function.size_out(0) != (rows, 1):
        raise ValueError(
            f"{name} maps {given} to {[function.size_out(i) for i in range(function.n_out())]}; "
            f"expected {shapes} to [({rows}, 1)]"
        )
