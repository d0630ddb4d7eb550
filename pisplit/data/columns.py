"""Names and units of columns: two parties agree by name, in any order, or are told apart in one line."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.data.units import conversion

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: First letter of the names that columns have when none were given.
LETTERS = {"states": "x", "inputs": "u"}


def default_names(what: str, size: int) -> tuple[str, ...]:
    """x1, x2, ... for ``what`` = "states", u1, u2, ... for "inputs": ``size`` names of columns that were given none."""
    return tuple(f"{LETTERS[what]}{i + 1}" for i in range(size))


def labels(given: Sequence[str] | None, name: str, default: Sequence[str], unique: bool = True) -> tuple[str, ...]:
    """``given`` texts, one for each entry of ``default``, which stands in where None is given.

    ``name`` is what errors call them. Raises ValueError for another number of texts, a text in place of a list, and
    with ``unique`` for repeated ones.
    """
    if isinstance(given, str):
        raise ValueError(f"{name} = {given!r} is one text; expected a list of {len(default)}")
    found = tuple(default) if given is None else tuple(str(label) for label in given)
    if len(found) != len(default):
        raise ValueError(f"{name} has {len(found)} entries; expected {len(default)}")
    if unique and len(set(found)) != len(found):
        raise ValueError(f"{name} repeats a name: {sorted(label for label in set(found) if found.count(label) > 1)}")
    return found


def table_columns(arrays: Sequence[Any], given: Sequence[str] | None, name: str) -> Sequence[str] | None:
    """``given`` names, or those of the columns where ``arrays`` are tables that name them (pandas, polars).

    ``name`` is what errors call the names. Raises ValueError for tables that name their columns differently, and for
    given names that are those of the tables in another order.
    """
    found = {
        tuple(map(str, table.columns)) for table in arrays if isinstance(getattr(table, "columns", None), Iterable)
    }
    if not found:
        return given
    if len(found) > 1:
        first, second = sorted(found)[:2]
        raise ValueError(f"tables name their columns {list(first)[:4]} and {list(second)[:4]}; expected one order")
    (names,) = found
    if given is None:
        return names
    if tuple(given) != names and sorted(map(str, given)) == sorted(names):
        raise ValueError(f"{name} is {list(given)[:4]}, the table has {list(names)[:4]}; give the order of its columns")
    return given


def in_order(value: Any, names: Sequence[str], what: str, owner: str = "the model") -> Any:
    """``value`` as it is, or with its columns in the order of ``names`` where it is a table or a row that names them.

    value  an array of any kind; a table (pandas, polars) whose columns, or a row (pandas) whose entries have texts for
           names
    names  of the columns that the ``owner`` wants; where these are x1, x2, ... or u1, u2, ... columns go by position
    what   "states" or "inputs"

    Raises ValueError, in one line, if the table has other columns.
    """
    found = getattr(value, "columns", None)
    if found is None and getattr(value, "ndim", 0) == 1:
        found = getattr(value, "index", None)
    if not isinstance(found, Iterable) or not all(isinstance(label, str) for label in found):
        return value
    order = column_order(tuple(found), names, what, "the table", owner)
    return np.asarray(value)[..., order]


def column_order(
    given: Sequence[str] | None,
    wanted: Sequence[str] | None,
    what: str,
    giver: str = "the data",
    owner: str = "the model",
) -> Index:
    """Positions (k,) in ``given`` of the columns that ``wanted`` names, in its order: given[order] = wanted.

    given, wanted  names of all columns of both sides. Columns without names (None, or x1, x2, ... and u1, u2, ... in
                   order) are matched by position
    what           "states" or "inputs"
    giver, owner   who gives and who wants them, for the message

    Raises ValueError, in one line, if the numbers differ or a name of one side is unknown to the other.
    """
    if given is None or wanted is None:
        return np.arange(len(given or wanted or ()))
    if len(given) != len(wanted):
        raise ValueError(f"{giver} has {len(given)} {what}, {owner} {len(wanted)}; give the same {what}")
    given, wanted = tuple(given), tuple(wanted)
    missing, unknown = (sorted(set(a) - set(b)) for a, b in ((wanted, given), (given, wanted)))
    if given == wanted or (missing and default_names(what, len(given)) in (given, wanted)):
        return np.arange(len(given))
    if missing:
        raise ValueError(
            f"{giver} has no {what} named {', '.join(missing[:3])} of {owner}, but {', '.join(unknown[:3])}; "
            f"rename or select the columns"
        )
    return np.array([given.index(name) for name in wanted], dtype=np.int64)


def unit_factors(
    given: Sequence[str] | None,
    wanted: Sequence[str] | None,
    names: Sequence[str],
    giver: str = "the data",
    owner: str = "the model",
) -> Array:
    """Factors (k,) that turn columns in units ``given`` into units ``wanted``; 1 where either side names none.

    names         of the columns, for the message
    giver, owner  who gives and who wants them, for the message

    Raises ValueError, in one line, for units of different kinds and for those without a known factor.
    """
    factors = np.ones(len(names))
    for i, (mine, theirs) in enumerate(zip(given or (), wanted or (), strict=False)):
        if mine and theirs and mine != theirs:
            factor = conversion(mine, theirs)
            if factor is None:
                raise ValueError(
                    f"{names[i]} is in {mine} in {giver}, in {theirs} in {owner}; convert it, no factor is known"
                )
            factors[i] = factor
    return factors


def regrouped(groups: Mapping[str, Sequence[int]], order: Index) -> dict[str, tuple[int, ...]]:
    """The ``groups`` {name: positions} after the columns were put in ``order`` (k,): each keeps its columns."""
    place = np.argsort(order)
    return {name: tuple(int(place[i]) for i in group) for name, group in groups.items()}
