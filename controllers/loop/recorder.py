"""What a loop has run so far, step by step: it survives whatever ends the run, and goes on after it."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from pisplit.checks import Array
from pisplit.controllers.loop.log import LoopLog
from pisplit.controllers.loop.tracking import Controller, Move
from pisplit.controllers.loop.wiring import Wiring
from pisplit.controllers.references import Reference

LIMIT_TOLERANCE = 1e-9


@dataclass(eq=False)
class Recorder:
    """A run: its ``reference``, bound to the start, and its samples ``wanted`` (so far); ``u0`` (m,); states ``x``,
    ``moves``, the inputs ``u`` of completed steps, ``plant_time`` and ``late`` [s] each, whether a limit of then was
    ``broken``; ``message`` and ``notes`` as in the log; ``stuck``: states that were found stuck; ``swings``: whether
    that was said."""

    reference: Reference
    wanted: Array
    u0: Array
    x: list[Array]
    moves: list[Move] = field(default_factory=list)
    u: list[Array] = field(default_factory=list)
    plant_time: list[float] = field(default_factory=list)
    late: list[float] = field(default_factory=list)
    broken: list[bool] = field(default_factory=list)
    message: str = ""
    notes: list[str] = field(default_factory=list)
    stuck: set[int] = field(default_factory=set)
    swings: bool = False

    def copy(self) -> Recorder:
        """A record that goes on apart from this one."""
        return copy.deepcopy(self)

    def add(self, move: Move, u: Array, plant_time: float, late: float, x: Array, controller: Controller) -> None:
        """A completed step: ``move``, applied input ``u`` (m,), ``plant_time``, ``late`` [s], state ``x`` (n,) then.

        ``controller``: whose limits of now the input had to keep.
        """
        self.broken.append(_violated(u, self.u[-1] if self.u else self.u0, controller))
        self.x[-1][list(move.stuck)] = np.nan
        self.moves.append(move)
        self.u.append(u)
        self.plant_time.append(plant_time)
        self.late.append(late)
        self.x.append(x)

    def log(self, dt: float, controller: Controller, wiring: Wiring, first: int = 0) -> LoopLog:
        """The log of what was run so far by the ``controller``, in steps of ``dt`` [s]; ``wiring`` tells the units.

        ``first``: the step that it begins with, the input before it being its ``u0``.
        """
        model, N = controller.model, len(self.x) - 1  # an interrupt may have come amid ``add``, whose last is the state
        moves = self.moves[first:N]
        u0 = self.u[first - 1] if first else self.u0
        u = np.reshape(np.array(self.u[first:N], dtype=np.float64), (N - first, len(u0)))
        return LoopLog(
            dt=dt,
            t=dt * np.arange(first, N + 1, dtype=np.float64),
            x=np.array(self.x[first : N + 1]),
            reference=self.wanted[first : N + 1].copy(),
            u=u,
            u0=u0.copy(),
            tracked=tuple(controller.tracked),
            state_names=model.state_names,
            input_names=model.input_names,
            state_units=wiring.states.units,
            input_units=wiring.inputs.units,
            statuses=tuple(move.status for move in moves),
            actions=tuple(move.action for move in moves),
            iterations=np.array([move.iterations for move in moves], dtype=int),
            fallback=np.array([move.fallback for move in moves], dtype=bool),
            solve_time=np.array([move.solve_time for move in moves]),
            cpu_time=np.array([move.cpu_time for move in moves]),
            plant_time=np.array(self.plant_time[first:N]),
            jitter=np.array(self.late[first:N]),
            missing=np.array([move.missing for move in moves], dtype=int),
            rejected=np.array([move.rejected for move in moves], dtype=int),
            stuck=np.array([len(move.stuck) for move in moves], dtype=int),
            limit_violations=sum(self.broken[first:N]),
            message=self.message,
            notes=tuple(self.notes),
        )


def _violated(u: Array, before: Array, controller: Controller) -> bool:
    """Whether the input is outside the box or changed faster than the rate limits."""
    outside = (u < controller.u_min - LIMIT_TOLERANCE) | (u > controller.u_max + LIMIT_TOLERANCE)
    return bool((outside | (np.abs(u - before) > controller.du_max + LIMIT_TOLERANCE)).any())
