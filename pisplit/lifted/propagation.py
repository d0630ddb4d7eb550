"""Roll-outs of many episodes at once, in place.

z (T+1, E, M) holds the forcing of every step on entry and the lifted states at the end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pisplit.dictionary.products import BilinearTerm, Transition
from pisplit.lifted.relifting import ReliftedTerm

Array = NDArray[np.float64]


def propagate(transition: Transition, z: Array) -> None:
    """z_{k+1} += A z_k with the ``transition`` A, for ``z`` (T+1, E, M)."""
    if z.shape[1] > 1:
        for k in range(len(z) - 1):
            transition.add(z[k], z[k + 1])
        return
    dot = transition if transition.structured else transition.matrix.dot
    previous = z[0, 0]
    for current in z[1:, 0]:
        current += dot(previous)
        previous = current


def propagate_bilinear(transition: Transition, term: BilinearTerm, z: Array, inputs: Array) -> None:
    """z_{k+1} += A z_k + sum_i u_i N_i z_k with ``transition``, ``term``, ``z`` (T+1, E, M), ``inputs`` (E, T, m)."""
    for k in range(len(z) - 1):
        transition.add(z[k], z[k + 1])
        z[k + 1][:, term.rows] += term(z[k], inputs[:, k])


def propagate_relifted(
    transition: Transition, term: ReliftedTerm, bilinear: BilinearTerm | None, z: Array, inputs: Array
) -> None:
    """z_{k+1} += A z_k + sum_i u_i N_i z_k + g(z_k, u_k) with ``transition``, ``bilinear`` products and ``term`` g.

    ``z`` (T+1, E, M), ``inputs`` (E, T, m).
    """
    for k in range(len(z) - 1):
        transition.add(z[k], z[k + 1])
        z[k + 1] += term(z[k], inputs[:, k])
        if bilinear is not None:
            z[k + 1][:, bilinear.rows] += bilinear(z[k], inputs[:, k])
