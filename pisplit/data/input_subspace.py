"""Directions in which inputs vary: an arm whose commands always add up to zero has one fewer than inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Spread of a direction, relative to the largest, from which its gain is more than rounding and noise of a command log.
EXCITED = 0.03
#: Spread of an input, relative to its largest magnitude, up to which it counts as constant.
CONSTANT = 1e-6


@dataclass(frozen=True, eq=False)
class InputDirections:
    """Where inputs vary: ``offset`` (m,) their mean, ``basis`` (m, r) orthonormal, the directions that are kept.

    ``combinations`` (m, m): the rows are combinations of the inputs, of unit length, most excited first; ``shares``
    (m,): their spread relative to the largest; the first r are kept.
    """

    offset: Array
    basis: Array
    combinations: Array
    shares: Array

    def lines(self, names: Sequence[str]) -> tuple[str, ...]:
        """One line a direction, in terms of the input ``names`` (m,): how much it varies, kept or held."""
        kept = self.basis.shape[1]
        return tuple(
            f"{combination(row, names)}: {share:.2g} of the largest spread, {'kept' if i < kept else 'held'}"
            for i, (row, share) in enumerate(zip(self.combinations, self.shares, strict=True))
        )


def combination(row: Array, names: Sequence[str]) -> str:
    """Text of a combination ``row`` (m,) of inputs called ``names`` (m,)."""
    terms = [f"{value:+.2f} {name}" for value, name in zip(row, names, strict=True) if abs(value) > 5e-3]
    return " ".join(terms) or "nothing"


def excited_directions(
    mean: Array, factor: Array, largest: Array, n_samples: int, units: Sequence[str] | None = None
) -> InputDirections:
    """Directions of inputs whose centred samples have the Gram matrix factor^T factor, ``factor`` (k, m).

    ``mean``, ``largest`` (m,): mean and largest magnitude of each input; ``n_samples``: number of samples.

    Inputs are compared in parts of their own spread, or of the largest among those of the same unit where ``units``
    (m,) tell it. A direction counts if its spread exceeds ``EXCITED`` of the largest: what is left of a zero-sum
    command that was rounded, or of a motor that was to stand still, is noise, and a gain fitted to it is wrong.
    """
    m = len(mean)
    if m == 0:
        return InputDirections(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    spread = np.linalg.norm(factor, axis=0) / np.sqrt(n_samples)
    rounding = np.finfo(float).eps * np.sqrt(n_samples)
    varying = spread > max(CONSTANT, rounding) * largest
    scale = np.where(varying, spread, 0.0)
    labels = [unit or f"?{i}" for i, unit in enumerate(units or [""] * m)]
    for label in set(labels):
        group = np.array([other == label for other in labels])
        scale[group] = scale[group].max()
    scale[scale == 0.0] = 1.0
    _, values, directions = np.linalg.svd(np.where(varying, factor, 0.0) / scale, full_matrices=True)
    values = np.concatenate([values, np.zeros(m - len(values))])
    shares = values / (float(values.max()) or 1.0)
    # Rounding of the singular values themselves, where all of them are tiny.
    kept = (shares > EXCITED) & (values > 0.0)
    span = directions[kept].T * scale[:, None]
    basis = directions[kept].T.copy() if np.ptp(scale) == 0.0 else np.linalg.qr(span)[0]
    rows = directions / scale
    return InputDirections(mean, basis, rows / np.linalg.norm(rows, axis=1, keepdims=True), shares)
