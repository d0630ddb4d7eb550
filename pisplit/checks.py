"""Checks on arguments: one line that says what was given, what is expected and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def finite_array(value: ArrayLike, name: str, shape: Sequence[int | None]) -> Array:
    """A float64 copy-free view of ``value`` with the wanted shape (``None`` = any length) and finite entries."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is not numeric: got {type(value).__name__}; give numbers") from None
    wanted = "(" + ", ".join("any" if k is None else str(k) for k in shape) + ("," if len(shape) == 1 else "") + ")"
    if array.ndim != len(shape) or any(k is not None and k != n for k, n in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name} has shape {array.shape}; expected {wanted}")
    bad = int(array.size - np.count_nonzero(np.isfinite(array)))
    if bad:
        raise ValueError(f"{name} has {bad} NaN or infinite entries; remove or repair them first")
    return array


def positive(value: Any, name: str, unit: str = "") -> float:
    """``value`` as a float, which must be finite and > 0."""
    number = finite_number(value, name)
    if number <= 0.0:
        raise ValueError(f"{name} = {number:g}{' ' + unit if unit else ''}; expected a positive number")
    return number


def non_negative(value: Any, name: str, unit: str = "") -> float:
    """``value`` as a float, which must be finite and >= 0."""
    number = finite_number(value, name)
    if number < 0.0:
        raise ValueError(f"{name} = {number:g}{' ' + unit if unit else ''}; expected zero or a positive number")
    return number


def finite_number(value: Any, name: str) -> float:
    """``value`` as a finite float."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is not a number: got {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{name} = {number}; expected a finite number")
    return number


def count(value: Any, name: str, minimum: int = 1) -> int:
    """``value`` as an int, which must be a whole number >= ``minimum``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or int(value) < minimum:
        raise ValueError(f"{name} = {value!r}; expected a whole number of at least {minimum}")
    return int(value)


def one_of(value: Any, name: str, choices: Sequence[str]) -> str:
    """``value``, which must be one of ``choices``."""
    if value not in choices:
        raise ValueError(f"{name} = {value!r}; expected one of {', '.join(map(repr, choices))}")
    return str(value)
