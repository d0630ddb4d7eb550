"""What a result says of itself at a prompt: its fields, arrays by their shapes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

#: Numbers of an array, entries of a sequence and letters of a text up to which they are shown.
NUMBERS, ENTRIES, LETTERS = 6, 4, 60


def brief(cls: type[T]) -> type[T]:
    """The dataclass ``cls`` with a ``repr`` that fits a few lines, whatever its arrays hold."""
    cls.__repr__ = _fields  # type: ignore[method-assign]
    return cls


def _fields(result: Any) -> str:
    told = [f"{f.name}={_short(getattr(result, f.name))}" for f in dataclasses.fields(result) if f.repr]
    return f"{type(result).__name__}({', '.join(told)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        if value.size <= NUMBERS and value.ndim <= 1:
            return np.array2string(value, precision=4, separator=", ")
        return f"{' x '.join(map(str, value.shape))} {value.dtype}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(value if len(value) <= LETTERS else f"{value[: LETTERS - 3]}...")
    if isinstance(value, Mapping):
        return f"{{{len(value)} entries}}" if value else "{}"
    if isinstance(value, list | tuple):
        if len(value) > ENTRIES:
            return f"({_short(value[0])}, ... {len(value)} in all)"
        return f"({', '.join(map(_short, value))})"
    if dataclasses.is_dataclass(value) or callable(value):
        return type(value).__name__
    told = repr(value)
    return told if len(told) <= LETTERS else type(value).__name__
