"""Targets that can be reached: outputs at rest under inputs inside the limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import count, finite_array, positive
from pisplit.controllers.references.curves import Reference, setpoint
from pisplit.evaluation.matching import Fitted, model_of, state_indices
from pisplit.lifted.model import LiftedModel


def random_targets(
    model: LiftedModel | Fitted,
    u_min: ArrayLike,
    u_max: ArrayLike,
    number: int,
    every: float,
    track: str = "tip",
    seed: int = 0,
) -> Reference:
    """Set-points of outputs ``track`` in which the ``model`` rests under random inputs, a new one ``every`` seconds.

    Inputs (m,) are drawn evenly from the box ``u_min`` .. ``u_max`` (numbers or (m,)) and put into the plane that the
    recordings excite; those that leave the box there are drawn again. ``number``: of targets; ``seed``: of the draws.

    Raises ValueError for models without a single state of rest, and where no input of the plane is inside the box.
    """
    found = model_of(model)
    m = found.n_inputs
    low, high = (
        finite_array(np.full(m, b) if np.ndim(b) == 0 else b, name, (m,))
        for b, name in ((u_min, "u_min"), (u_max, "u_max"))
    )
    rows = list(state_indices(found, track))
    rng, points = np.random.default_rng(count(seed, "seed", 0)), []
    offset, basis = found.input_offset, found.input_basis
    for _ in range(1000 * count(number, "number")):
        u = offset + basis @ (basis.T @ (rng.uniform(low, high) - offset))
        if (u >= low).all() and (u <= high).all():
            points.append(found.read(found.fixed_point(u))[rows])
        if len(points) == number:
            break
    else:
        raise ValueError("the box u_min .. u_max holds no input of the training data's plane; widen it")
    return setpoint(np.array(points), positive(every, "every", "s") * np.arange(1, number + 1), track)
