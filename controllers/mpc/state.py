"""What the next step of an MPC depends on beside its arguments."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array
from pisplit.controllers.estimation.disturbance import EstimatorState
from pisplit.controllers.estimation.stuck import StuckState
from pisplit.controllers.loop.history import History
from pisplit.controllers.mpc.fallback import FallbackState
from pisplit.controllers.mpc.problem import ProblemState


@dataclass(frozen=True, eq=False)
class Past:
    """What a step began with: ``history``, ``estimator``, ``readout`` and ``doubts`` as in the state of an MPC, what
    was ``measured`` (n,), and the input ``acting`` (m,) after it."""

    history: History
    estimator: EstimatorState
    readout: Array | None
    doubts: NDArray[np.int64]
    measured: Array
    acting: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class MPCState:
    """An MPC between two steps.

    ``history`` of delays, last ``plan`` (None before the first), states of the disturbance ``estimator`` and of the
    ``problem``; ``readout`` (n,), what the read-out missed of the last measurement, None before it; steps ``blind``
    since anything was measured; ``doubts`` (p,), steps for which the observer rejected each of its entries; ``line`` of
    commands on their way, the last of them ``commanded`` (m,); the reference ``wanted`` (p,) now, None at first;
    ``stuck``, what is known of sensors that repeat themselves, and the ``past`` steps that are forgotten where they do;
    ``fallback``, how far its order has been gone down.
    """

    history: History
    plan: Array | None
    estimator: EstimatorState
    problem: ProblemState
    readout: Array | None
    blind: int
    doubts: NDArray[np.int64]
    line: tuple[Array, ...]
    commanded: Array
    wanted: Array | None
    stuck: StuckState | None
    past: tuple[Past, ...]
    fallback: FallbackState
