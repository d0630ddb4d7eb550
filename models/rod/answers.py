"""Answers that are right, or say so."""

from __future__ import annotations

import sys
import warnings

import numpy as np

from pisplit.checks import Array


def finite_answer(values: Array, what: str) -> Array:
    """``values`` of any shape, which must be finite; ``what`` names them.

    Raises ValueError where they overflow, instead of handing on NaN.
    """
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{what} overflow: strains or rates of the state are too large; give one that a rod can have")
    return values


class Unresolved(UserWarning):
    """The nodes of a scene, or the steps in time, are too few for the shape or the motion."""


def warn_unresolved(message: str) -> None:
    """Warn with a ``message`` that names the line outside the package from which it was called."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).startswith("pisplit."):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, Unresolved, stacklevel=level)
