"""Directions in which inputs vary: an arm whose commands always add up to zero has one fewer than inputs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EXCITED = 1e-6


def excited_directions(inputs: Array) -> tuple[Array, Array]:
    """Mean (m,) of ``inputs`` (N, m) and an orthonormal basis (m, r) of the directions in which they vary.

    A direction counts if its singular value exceeds 1e-6 of the largest.
    """
    if inputs.shape[1] == 0:
        return np.zeros(0), np.zeros((0, 0))
    offset = inputs.mean(axis=0)
    _, values, directions = np.linalg.svd(inputs - offset, full_matrices=False)
    rounding = np.finfo(float).eps * float(np.abs(inputs).max(initial=0.0)) * len(inputs)
    excited = values > max(EXCITED * float(values.max(initial=0.0)), rounding)
    return offset, directions[excited].T.copy()
