"""The known half step of a bilinear dictionary: inputs are constant over it, u_i psi moves as psi does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pisplit.dictionary.dictionary import Dictionary

Array = NDArray[np.float64]

#: Entries of a scaled half step that count as zero.
NEGLIGIBLE = 1e-8


def with_products(theta: Dictionary, half: Array, scale: Array) -> Array:
    """K_f (M, M) on [psi; phi; u_1 psi_J; ..; u_m psi_J] from ``half``, that on [psi; phi], both on scaled columns.

    ``theta`` is the bilinear dictionary of M columns, ``scale`` (M,) their units.

    d/dt (u_i psi_J) = u_i L_f psi: row u_i psi_j of K_f is u_i times row psi_j. It stays in the dictionary if f moves
    psi_J within psi_J and does not depend on the inputs; u_i times the constant is the input itself. Raises ValueError
    otherwise.
    """
    plain, products = theta.n_lifted + theta.n_features, theta.products
    physical = half * scale[:plain, None] / scale[:plain]
    k = np.zeros((theta.n_columns, theta.n_columns))
    k[:plain, :plain] = physical
    for i, name in enumerate(theta.names.inputs):
        first = plain + i * len(products)
        into = np.full(plain, -1)
        into[products] = first + np.arange(len(products))
        if theta.constant_column not in (None, *products) and name in theta.feature_names:
            into[theta.constant_column] = theta.n_lifted + theta.feature_names.index(name)
        lost = np.abs(half[np.ix_(products, into < 0)]).max(initial=0.0)
        if lost > NEGLIGIBLE:
            raise ValueError(
                f"f takes products with {name} out of the dictionary (by {lost:.1g}); "
                "multiply all columns that f mixes, and give samples of an f without inputs"
            )
        kept = np.flatnonzero(into >= 0)
        k[np.ix_(np.arange(first, first + len(products)), into[kept])] = physical[np.ix_(products, kept)]
    return np.asarray(k * scale / scale[:, None])
