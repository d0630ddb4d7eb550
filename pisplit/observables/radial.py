"""Radial basis functions about centres that may come from data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import count, finite_array, one_of, positive, real_array
from pisplit.observables.columns import Columns, OneSided, Symbol
from pisplit.observables.fourier import per_variable

Array = NDArray[np.float64]

KINDS = ("gaussian", "thin_plate")


@dataclass(frozen=True)
class Radial(OneSided):
    """Functions of r_j = |(v - c_j) / width|; ``kind`` is exp(-r^2 / 2) ("gaussian") or r^2 log r ("thin_plate").

    ``centres``: k rows with one entry a variable. ``width``: one number or one a variable [unit of v].

    Raises ValueError where there is no centre.
    """

    centres: Sequence[Sequence[float]]
    width: float | Sequence[float] = 1.0
    kind: str = "gaussian"
    of: str = "states"
    variables: Sequence[str] | Sequence[int] | None = None

    def __post_init__(self) -> None:
        rows = finite_array(self.centres, "centres", (None, None))
        if rows.size == 0:
            raise ValueError("centres is empty; give at least one centre")
        object.__setattr__(self, "centres", tuple(tuple(row) for row in rows.tolist()))
        widths = np.atleast_1d(real_array(self.width, "width")).tolist()
        object.__setattr__(self, "width", tuple(positive(w, "width") for w in widths))
        one_of(self.kind, "kind", KINDS)

    def __repr__(self) -> str:
        return f"Radial({len(self.centres)} centres, width={self.width}, kind={self.kind!r}, of={self.of!r})"

    @classmethod
    def from_data(
        cls,
        data: ArrayLike,
        n_centres: int,
        method: str = "kmeans",
        width: float | None = None,
        kind: str = "gaussian",
        seed: int = 0,
        of: str = "states",
        variables: Sequence[str] | Sequence[int] | None = None,
    ) -> Radial:
        """``n_centres`` among ``data`` (N, d), one column a variable.

        ``method`` "kmeans", or "random" rows by ``seed``.

        Distances are in standard deviations of the columns. ``width`` in the same measure; default: the median
        distance between neighbouring centres. k-means starts from spread seeds (Arthur and Vassilvitskii, 2007).
        ``kind``, ``of`` and ``variables`` (d of them) as in the class.

        Raises ValueError for more centres than different rows.
        """
        rows = finite_array(data, "data", (None, None))
        size, rng = count(n_centres, "n_centres"), np.random.default_rng(count(seed, "seed", minimum=0))
        std = rows.std(axis=0)
        std[std == 0.0] = 1.0
        scaled = np.unique(rows / std, axis=0)
        if len(scaled) < size:
            raise ValueError(f"n_centres = {size}; data has only {len(scaled)} different rows")
        if one_of(method, "method", ("kmeans", "random")) == "random":
            centres = scaled[np.sort(rng.choice(len(scaled), size, replace=False))]
        else:
            from scipy.cluster.vq import kmeans2  # half of the import time of the package, needed here alone

            centres, _ = kmeans2(scaled, _spread(scaled, size, rng), minit="matrix", iter=30)
        unit = _spacing(centres) if width is None else positive(width, "width")
        return cls((centres * std).tolist(), (unit * std).tolist(), kind, of, variables)

    def _write(self, v: Symbol, labels: tuple[str, ...], quantities: tuple[str, ...]) -> Columns:
        centres = np.array(self.centres)
        if centres.shape[1] != len(labels):
            raise ValueError(f"centres have {centres.shape[1]} entries; expected {len(labels)}, one a variable")
        width = per_variable(self.width, "width", len(labels))
        squares = [ca.sumsqr((v - centre) / width) for centre in centres]
        if self.kind == "gaussian":
            values = [ca.exp(-0.5 * s) for s in squares]
        else:  # r^2 log r is smooth at the centre; the smallest number keeps log finite there
            values = [0.5 * s * ca.log(s + np.finfo(float).tiny) for s in squares]
        inside = ",".join(labels) if len(labels) <= 2 else f"{labels[0]}..{labels[-1]}"
        names = tuple(f"{self.kind}({inside})[{j + 1}]" for j in range(len(centres)))
        return Columns(ca.vertcat(*values), names, ("radial",) * len(names))


def _spread(rows: Array, size: int, rng: np.random.Generator) -> Array:
    """Rows drawn with probability proportional to the squared distance from those drawn before (k-means++)."""
    found = [rows[rng.integers(len(rows))]]
    nearest = np.full(len(rows), np.inf)
    for _ in range(size - 1):
        nearest = np.minimum(nearest, ((rows - found[-1]) ** 2).sum(axis=1))
        found.append(rows[rng.choice(len(rows), p=nearest / nearest.sum())])
    return np.array(found)


def _spacing(centres: Array) -> float:
    """Median distance of a centre to its nearest neighbour; 1 for a single centre."""
    if len(centres) == 1:
        return 1.0
    distance = np.linalg.norm(centres[:, None] - centres, axis=2) + np.diag(np.full(len(centres), np.inf))
    return float(np.median(distance.min(axis=1)))
