"""Checks on arguments: one line that says what was given, what is expected and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FLOAT = np.dtype(np.float64)
#: Relative difference up to which two time steps are one.
SAME_STEP = 1e-6
#: What arrays hold that are no numbers, by kind of NumPy's data types.
KINDS = {
    "c": "complex numbers; give real and imaginary parts as columns of their own",
    "U": "texts; convert them to numbers",
    "S": "texts; convert them to numbers",
    "T": "texts; convert them to numbers",
    "M": "dates; give numbers",
    "m": "durations; give numbers and name their unit",
    "V": "records; give plain columns",
}


def real_array(value: ArrayLike, name: str) -> Array:
    """``value`` as float64, NaN where an entry is masked, None or NA; a float64 array is handed on as it is.

    value  numbers of any kind that are real: integers, booleans (0 and 1), floats, fractions
    name   what errors call it

    Raises ValueError for complex numbers, texts, dates, quantities that carry a unit, and rows of different lengths.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:
        return value
    if isinstance(value, list | tuple):
        value = _unmasked(value)
    if hasattr(type(value), "to_base_units") or hasattr(type(value), "to_value"):  # pint, astropy
        raise ValueError(f"{name} carries a unit, which would be lost; give its numbers, and the unit by name")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} is not numeric: got {type(value).__name__}; give rows of one length") from None
    if array.dtype.kind == "O":
        return np.array([_real(entry, name) for entry in array.ravel().tolist()]).reshape(array.shape)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} is not numeric: it holds {KINDS.get(array.dtype.kind, str(array.dtype))}")
    found = array.astype(np.float64, copy=isinstance(value, np.ma.MaskedArray))
    if isinstance(value, np.ma.MaskedArray):
        found[np.ma.getmaskarray(value)] = np.nan
    return found


def _unmasked(value: Any) -> Any:
    """Lists ``value``, however deep, with NaN for what is masked in arrays they hold: np.asarray drops their masks."""
    if isinstance(value, np.ma.MaskedArray):
        return real_array(value, "") if value.dtype.kind in "fiub" else value
    if isinstance(value, list | tuple) and any(isinstance(part, list | tuple | np.ma.MaskedArray) for part in value):
        return [_unmasked(part) for part in value]
    return value


def finite_array(value: ArrayLike, name: str, shape: Sequence[int | None]) -> Array:
    """``value`` as float64 with the wanted shape (``None`` = any length) and finite entries, copied only if needed.

    value  real numbers, as in :func:`real_array`
    name   what errors call it
    shape  wanted length of every dimension

    Raises ValueError, in one line, for entries that are no real numbers, NaN, masked or infinite, and other shapes.
    """
    array = real_array(value, name)
    if array.ndim != len(shape) or any(k is not None and k != n for k, n in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("any" if k is None else str(k) for k in shape) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name} has shape {array.shape}; expected {wanted}{_shape_hint(array.shape, shape, name)}")
    bad = int(array.size - np.count_nonzero(np.isfinite(array)))
    if bad:
        kinds = "masked, NaN" if isinstance(value, np.ma.MaskedArray) else "NaN"
        raise ValueError(f"{name} has {bad} {kinds} or infinite entries; remove or repair them first")
    return array


def differing(first: float, second: float) -> tuple[str, str]:
    """The numbers ``first`` and ``second`` as texts with as many digits as it takes to tell them apart."""
    for digits in range(6, 18):
        texts = f"{first:.{digits}g}", f"{second:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts


def same_step(first: float, second: float) -> bool:
    """True if the time steps ``first`` and ``second`` [s] differ by less than a millionth.

    Written in a file as decimals, they are equal.
    """
    return abs(first - second) <= SAME_STEP * abs(second)


def check_same_step(given: float, wanted: float, giver: str, owner: str) -> None:
    """Raise ValueError if the time step ``given`` [s] of the ``giver`` is not the one ``wanted`` by the ``owner``."""
    if not same_step(given, wanted):
        found, expected = differing(given, wanted)
        raise ValueError(f"{giver} dt = {found} s, {owner} {expected} s; give both the same time step")


def positive(value: Any, name: str, unit: str = "") -> float:
    """``value`` as a float, which must be finite and > 0; errors call it ``name`` and give its ``unit``."""
    number = finite_number(value, name)
    if number <= 0.0:
        raise ValueError(f"{name} = {number:g}{' ' + unit if unit else ''}; expected a positive number")
    return number


def non_negative(value: Any, name: str, unit: str = "") -> float:
    """``value`` as a float, which must be finite and >= 0; errors call it ``name`` and give its ``unit``."""
    number = finite_number(value, name)
    if number < 0.0:
        raise ValueError(f"{name} = {number:g}{' ' + unit if unit else ''}; expected zero or a positive number")
    return number


def finite_number(value: Any, name: str) -> float:
    """``value``, a real number and no text, as a finite float; errors call it ``name``."""
    try:
        # float() reads "1_0" as 10, durations as their ticks, and drops imaginary parts.
        if isinstance(value, str | bytes | complex | np.datetime64 | np.timedelta64) or value is np.ma.masked:
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is not a number: got {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{name} = {number}; expected a finite number")
    return number


def count(value: Any, name: str, minimum: int = 1) -> int:
    """``value`` as an int, which must be a whole number >= ``minimum``; errors call it ``name``."""
    if isinstance(value, bool | np.timedelta64) or not isinstance(value, int | np.integer) or int(value) < minimum:
        raise ValueError(f"{name} = {value!r}; expected a whole number of at least {minimum}")
    return int(value)


def one_of(value: Any, name: str, choices: Sequence[str]) -> str:
    """``value``, which must be one of ``choices``; errors call it ``name``."""
    if value not in choices:
        raise ValueError(f"{name} = {value!r}; expected one of {', '.join(map(repr, choices))}")
    return str(value)


def _real(entry: Any, name: str) -> float:
    """One entry of an array of objects as a float, NaN where it is missing."""
    if entry is None or type(entry).__name__ in ("NAType", "MaskedConstant"):
        return np.nan
    if isinstance(entry, Real | Decimal | np.bool_):
        return float(entry)
    raise ValueError(f"{name} is not numeric: it holds {' '.join(repr(entry).split())[:40]}; give rows of numbers")


def _shape_hint(found: Sequence[int], wanted: Sequence[int | None], name: str) -> str:
    """How to get from one shape to the other, where a new axis or a transpose does it."""

    def fits(shape: Sequence[int]) -> bool:
        return all(k is None or k == n for k, n in zip(wanted, shape, strict=True))

    array = name if name and all(c.isalnum() or c in "_.[]" for c in name) else "array"
    if len(wanted) == 2 and len(found) == 1 and fits((found[0], 1)):
        return f"; give ({found[0]}, 1): {array}[:, None]"
    if len(wanted) == 2 and len(found) == 1 and fits((1, found[0])):
        return f"; give (1, {found[0]}): {array}[None]"
    if len(wanted) == len(found) == 2 and fits(found[::-1]):
        return f"; give its transpose, {array}.T"
    return ""
