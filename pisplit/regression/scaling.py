"""Column scales: one for each physical quantity, so that columns of tiny variance are not blown up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import one_of

Array = NDArray[np.float64]

SCALINGS = ("quantity", "column")


def column_scales(
    std: Array, quantities: Sequence[str], scale: str | None = "quantity", margins: Mapping[str, float] | None = None
) -> Array:
    """Scales (k,) of columns with standard deviations ``std`` (k,) about their means and physical ``quantities`` (k,).

    "quantity": the root mean square of ``std`` over the columns of one quantity, times the factor that ``margins`` of
    states' quantities give it (:func:`pisplit.data.noise.noise_margins`; products have those of their factors);
    "column": each its own; None: 1. A quantity that does not vary has scale 1.
    """
    if scale is None:
        return np.ones_like(std)
    if one_of(scale, "scale", SCALINGS) == "column":
        scales = std.copy()
    else:
        labels = np.array(quantities)
        scales = np.empty_like(std)
        for quantity in set(quantities):
            group = labels == quantity
            scales[group] = np.sqrt(np.mean(std[group] ** 2)) * _margin(quantity, margins or {})
    scales[scales == 0.0] = 1.0
    return scales


def _margin(quantity: str, margins: Mapping[str, float]) -> float:
    """The factor of a column's ``quantity``, a product of those of its factors, from the ``margins`` of states."""
    if quantity in margins or not margins:
        return margins.get(quantity, 1.0)
    found = 1.0
    for factor in quantity.split("*"):
        name, _, power = factor.rpartition("^")
        if name and power.isdigit():
            found *= margins.get(name, 1.0) ** int(power)
        else:
            found *= margins.get(factor, 1.0)
    return found
