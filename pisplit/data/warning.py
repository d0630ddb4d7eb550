"""Warnings at the line of the caller, however deep in this room they arise."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")


def warn(text: str) -> None:
    """Warn with ``text`` at the line that called this room."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("pisplit.data"):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, stacklevel=level)


def silently(made: Callable[[], _T]) -> _T:
    """What ``made`` gives, without its warnings: what was said of a recording when it was first made."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return made()
