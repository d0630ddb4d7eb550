"""Stretches of samples, and what holds between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

#: Steps of fewer units of the last digit than this are of a coarse sensor, which may repeat itself.
COARSE = 10.0


def stretches(flags: Mask) -> list[tuple[int, int]]:
    """First and one past the last position of every stretch of True in ``flags`` (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def held(inputs: Array) -> Array:
    """Commands ``inputs`` (N, m) with those that are missing held from the last one; before it, the first one."""
    if not len(inputs):
        return inputs
    known = np.isfinite(inputs)
    last = np.maximum.accumulate(np.where(known, np.arange(len(inputs))[:, None], -1), axis=0)
    first = np.argmax(known, axis=0)[None]
    return np.nan_to_num(np.take_along_axis(inputs, np.where(last < 0, first, last), axis=0))


def coarse(column: Array, runs: Sequence[Index]) -> bool:
    """Whether steps of a ``column`` (N,) are few units of the sensor's last digit.

    ``runs``: positions of the samples of every run, in order of time.
    """
    steps = np.concatenate([np.abs(np.diff(column[rows[np.isfinite(column[rows])]])) for rows in runs])
    steps = steps[steps > 1e-12 * np.nanmax(np.abs(column))]
    return len(steps) == 0 or float(np.median(steps)) < COARSE * float(steps.min())
