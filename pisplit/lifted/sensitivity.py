"""Derivatives of predictions with respect to inputs."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array
from pisplit.data.columns import in_order
from pisplit.lifted.model import LiftedModel
from pisplit.lifted.modes import refuse_bilinear

Array = NDArray[np.float64]


def input_jacobian(model: LiftedModel, inputs: ArrayLike) -> Array:
    """d z_{k+1} / d u_k = B dphi/du (N, M, m) of a ``model`` at ``inputs`` (N, m).

    Raises ValueError for bilinear models.
    """
    refuse_bilinear(model, "a Jacobian that does not depend on the state")
    return np.asarray(np.einsum("ij,njk->nik", model.B, model.feature_jacobian(inputs)))


def rollout_jacobian(model: LiftedModel, inputs: ArrayLike) -> Array:
    """d y_k / d u_j (T, n, T, m) of a roll-out of a ``model`` under ``inputs`` (T, m).

    State k = 1..T (first axis), input j (third axis).

    Zero where the input comes after the state. Delayed inputs act through the columns of z that hold them.
    """
    points = finite_array(in_order(inputs, model.input_names, "inputs"), "U", (None, model.n_inputs))
    steps = len(points)
    direct = input_jacobian(model, points)
    result = np.zeros((steps, model.n_states, steps, model.n_inputs))
    reading = model.C  # C A^i, one product with A a step
    for i in range(steps):
        block = np.einsum("ij,njk->nik", reading, direct[: steps - i])
        for j in range(steps - i):
            result[j + i, :, j] = block[j]
        reading = reading @ model.A
    return result
