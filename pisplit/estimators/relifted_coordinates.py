"""Coordinates and products of re-lifted models: principal components of the states, inputs and how they change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from pisplit.data.pairs import Pairs
from pisplit.lifted.operators import excited_inputs
from pisplit.regression.scaling import column_scales

Array = NDArray[np.float64]

#: Components smaller than this part of the largest are rounding.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Coordinates:
    """x = mean + decode c, c = encode (x - mean), and inputs as coordinates of the directions that vary.

    mean     (n,) of the states
    encode   (r, n) and decode (n, r): c are principal components of the states, each divided by the spread of its
             quantity, in units of the spread of the leading one
    offset   (m,) and
    inputs   (q, m): a = inputs (u - offset), of order one
    change   size of the change of ``a`` in a step
    """

    mean: Array
    encode: Array
    decode: Array
    offset: Array
    inputs: Array
    change: float

    @classmethod
    def of(
        cls,
        pairs: Pairs,
        quantities: Sequence[str],
        omit: Sequence[str],
        number: int,
        margins: Mapping[str, float] | None = None,
    ) -> Coordinates:
        """``number`` components of the states in ``pairs``, at most as many as vary.

        ``quantities`` (n,) of the states; those of a quantity in ``omit`` do not shape the components, and are read
        from them by regression. ``margins``: as in :func:`pisplit.regression.column_scales`.
        """
        x = np.vstack([pairs.x, pairs.x_next])
        mean = x.mean(axis=0)
        scale = column_scales(x.std(axis=0), quantities, margins=margins)
        part = np.array([float(q not in omit) for q in quantities])
        deviations = (x - mean) / scale
        triangle = np.linalg.qr(deviations, mode="r")
        _, s, vt = np.linalg.svd(triangle * part)
        size = min(number, int((s > ROUNDING * s[0]).sum())) if s.size and s[0] > 0.0 else 0
        v, unit = vt[:size].T, (s[0] / np.sqrt(len(x)) if size else 1.0)
        # What the components say of all states: those that shaped them are V c, others by least squares.
        read = np.linalg.lstsq(triangle @ v, triangle, rcond=1e-10)[0].T if size else np.zeros((x.shape[1], 0))
        directions = excited_inputs(pairs)
        spread = (np.vstack([pairs.u, pairs.u_history[:, 0]]) - directions.offset) @ directions.basis
        size_u = float(np.sqrt((spread**2).mean(axis=0)).max(initial=0.0)) or 1.0
        change = (pairs.u - pairs.u_history[:, 0]) @ directions.basis / size_u
        return cls(
            mean=mean,
            encode=(v * part[:, None]).T / scale / unit,
            decode=scale[:, None] * read * unit,
            offset=directions.offset,
            inputs=directions.basis.T / size_u,
            change=float(np.sqrt((change**2).mean(axis=0)).max(initial=0.0)) or 1.0,
        )

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers (r, q, m) of components, of input directions and of inputs."""
        return len(self.encode), *self.inputs.shape

    @cached_property
    def variables(self) -> tuple[Array, Array]:
        """F (r + 2 q, r + 2 m) and f (r + 2 q,): (c, mean input, its change) = F (c, u_{k-1}, u_k) + f."""
        r, q, m = self.sizes
        basis = np.zeros((r + 2 * q, r + 2 * m))
        basis[:r, :r] = np.eye(r)
        basis[r : r + q, r : r + m] = basis[r : r + q, r + m :] = 0.5 * self.inputs
        basis[r + q :, r : r + m], basis[r + q :, r + m :] = -self.inputs / self.change, self.inputs / self.change
        return basis, np.concatenate([np.zeros(r), -self.inputs @ self.offset, np.zeros(q)])


def product_table(components: int, inputs: int, leading: int, degree: int) -> NDArray[np.int64]:
    """Factors (P, degree) of the products of (components, inputs), positions; the number of variables stands for 1.

    All products of 2 to ``degree`` factors among the ``leading`` components and the ``inputs`` variables, and the other
    components times each of these (bilinear).
    """
    first = [*range(leading), *range(components, components + inputs)]
    found: list[tuple[int, ...]] = []
    for size in range(2, degree + 1):
        found += combinations_with_replacement(first, size)
    found += [(i, j) for i in range(leading, components) for j in range(components, components + inputs)]
    one, width = components + inputs, max(degree, 2)
    return np.array([(*p, *(one,) * (width - len(p))) for p in found], dtype=np.int64).reshape(len(found), width)


def kinked_table(first: int, variables: int, hinges: int, gates: Sequence[tuple[int, ...]]) -> NDArray[np.int64]:
    """Factors (P, 3) of products with kinks, the ``first`` of which stands at this position.

    The ``hinges``, so many, are columns themselves. ``gates`` are positions of others behind the first kink, one or two
    in each: their product is a column, and so is it times each of the ``variables``, so many. The position behind the
    last kink stands for 1.
    """
    kinks = hinges + max((i + 1 - hinges for g in gates for i in g), default=0)
    one = first + kinks
    found: list[tuple[int, ...]] = [(first + k, one, one) for k in range(hinges)]
    for gate in gates:
        own = tuple(first + k for k in gate) + (one,) * (2 - len(gate))
        found += [(*own, v) for v in (one, *range(variables))]
    return np.array(found, dtype=np.int64).reshape(len(found), 3)


def joined_tables(products: NDArray[np.int64], kinked: NDArray[np.int64], one: int, new: int) -> NDArray[np.int64]:
    """``products`` above ``kinked``, as wide as the wider; ``one`` stands for 1 in the first, ``new`` in the result."""
    width = max(products.shape[1], kinked.shape[1])
    first = np.where(products == one, new, products)
    padded = [np.pad(t, ((0, 0), (0, width - t.shape[1])), constant_values=new) for t in (first, kinked)]
    return np.asarray(np.vstack(padded))
