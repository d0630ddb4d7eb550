"""Principal components of measured states: few coordinates for nonlinear columns of many fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array
from pisplit.observables.columns import Base, Columns, Names, Symbol
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Principal(Base):
    """Columns c = W (x - mean): the states' leading principal components, each of order one.

    Quadratic monomials of all fields of an arm are thousands of columns; ``compose(Polynomials(2), Principal.of(x,
    12))`` are 78, and most of what they could tell. ``weights`` W (k, n) and ``mean`` (n,) are data of the dictionary.

    Raises ValueError in a dictionary of another number of states.
    """

    weights: Sequence[Sequence[float]] = field(repr=False)
    mean: Sequence[float] = field(repr=False)

    def __post_init__(self) -> None:
        rows = finite_array(self.weights, "weights", (None, None))
        object.__setattr__(self, "weights", tuple(map(tuple, rows.tolist())))
        centre = finite_array(self.mean, "mean", (rows.shape[1],))
        object.__setattr__(self, "mean", tuple(centre.tolist()))

    def __repr__(self) -> str:
        return f"Principal({len(self.weights)} of {len(self.mean)} states)"

    @classmethod
    def of(
        cls, states: ArrayLike, number: int, quantities: Sequence[str] | None = None, omit: Sequence[str] = ()
    ) -> Principal:
        """The ``number`` leading components of ``states`` (N, n), each with unit variance over them.

        ``quantities``: groups of states with one scale (:func:`pisplit.regression.scaling.column_scales`); default: all
        states have one unit. States of a quantity in ``omit`` take no part.

        Raises ValueError for more components than the states vary in, and for quantities that they do not have.
        """
        x = finite_array(states, "states", (None, None))
        size = count(number, "number")
        if size > min(x.shape):
            raise ValueError(f"number = {size} components; {x.shape[0]} samples of {x.shape[1]} states have fewer")
        mean = x.mean(axis=0)
        labels = ("x",) * x.shape[1] if quantities is None else tuple(quantities)
        if set(omit) - set(labels):
            raise ValueError(f"omit = {list(omit)}; expected quantities of the states, {sorted(set(labels))}")
        scale = column_scales(x.std(axis=0), labels)
        part = np.array([float(label not in omit) for label in labels])
        triangle = np.linalg.qr((x - mean) / scale * part, mode="r")
        _, s, vt = np.linalg.svd(triangle)
        if s[size - 1] <= 1e-10 * s[0]:
            raise ValueError(
                f"number = {size} components; the states vary in {int((s > 1e-10 * s[0]).sum())} directions"
            )
        leading = vt[:size] * np.sign(vt[:size].sum(axis=1, keepdims=True) + 1e-300)
        weights = leading * part / scale / (s[:size, None] / np.sqrt(len(x)))
        return cls(weights.tolist(), mean.tolist())

    def state_columns(self, x: Symbol, names: Names) -> Columns:
        """The components."""
        if len(self.mean) != x.shape[0]:
            raise ValueError(f"Principal is of {len(self.mean)} states; the dictionary has {x.shape[0]}")
        values = ca.DM(np.array(self.weights)) @ (x - ca.DM(list(self.mean)))
        labels = tuple(f"c{i + 1}" for i in range(len(self.weights)))
        return Columns(values, labels, ("component",) * len(labels))
