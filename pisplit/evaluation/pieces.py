"""Roll-outs of many episodes in bounded memory: some side by side, a stretch of time at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]

#: Roll-outs side by side: enough for products of matrices to be as fast as they get.
SIDE_BY_SIDE = 256
#: Bytes that one stretch of time may take.
BUDGET = 24_000_000


@dataclass(frozen=True)
class Piece:
    """A stretch of time of roll-outs that have not diverged before it.

    which        (A,) their positions among all that started
    first        step of the first state
    x            (A, L+1, n) states of the steps first..first + L; held from divergence on
    diverged_at  (A,) step of divergence counted from the start of the roll-out, -1 for "not yet"
    """

    which: NDArray[np.int64]
    first: int
    x: Array
    diverged_at: NDArray[np.int64]


def pieces(model: LiftedModel, z0: Array, inputs: Sequence[Array]) -> Iterator[Piece]:
    """Roll-outs of a ``model`` from lifted states ``z0`` (E, M) under E ``inputs`` (T, m) of one length.

    They come one stretch after another.

    A roll-out that diverged takes no part in the stretches after that.
    """
    steps = len(inputs[0])
    which, z, first = np.arange(len(z0)), z0, 0
    while first < steps and len(which):
        last = min(steps, first + max(1, BUDGET // (len(which) * _bytes_a_step(model))))
        result = model.rollout(z, np.stack([inputs[i][first:last] for i in which.tolist()]))
        at = np.asarray(result.diverged_at)
        yield Piece(which, first, result.x, np.where(at < 0, -1, first + at))
        going = at < 0
        which, z, first = which[going], result.z[going, -1], last


def _bytes_a_step(model: LiftedModel) -> int:
    """What a roll-out holds for one step: lifted states twice, states four times, inputs and features."""
    return 8 * (2 * model.n_lifted + 4 * model.n_states + model.n_inputs + model.n_features)
