"""What the next step of an MPC depends on beside its arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pisplit.checks import Array
from pisplit.controllers.estimation.lifted_state import EstimationState
from pisplit.controllers.mpc.fallback import FallbackState
from pisplit.controllers.mpc.problem import ProblemState
from pisplit.controllers.mpc.servos import ServoState


@dataclass(frozen=True, eq=False)
class MPCState:
    """An MPC between two steps.

    States of ``estimation``, ``problem`` and ``fallback``; last ``plan`` (None before the first); ``line`` of commands
    on their way, the last of them ``commanded`` (m,); the reference ``wanted`` (p,) now, None at first; derivatives
    along the last plan of the ``prediction``, None where each move takes its own; ``loud`` steps in which innovations
    have been too large by now, beyond those that are borne once that was said; where the ``servos`` are.
    """

    estimation: EstimationState
    problem: ProblemState
    fallback: FallbackState
    plan: Array | None
    line: tuple[Array, ...]
    commanded: Array
    wanted: Array | None
    servos: ServoState
    prediction: Any = None
    loud: int = 0
