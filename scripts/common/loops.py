"""Closed loops of several controllers on the simulated arm, each controller in a process of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit import LiftedModel
from pisplit.controllers import MPC, ClosedLoop, FeedForward, LoopLog, references
from pisplit.models.arm.static_table import EquilibriumTable
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.analysis.fields import N_FIELDS
from pisplit.models.rod.dynamics.fast import FastStepper

Array = NDArray[np.float64]

HORIZON = 20
#: Weights of the input rate among which the tuning runs choose, per model; the one that is safe most often is first.
RATE_WEIGHTS = (0.2, 0.02)
#: Where the tuning runs jump to, from the tip at rest [m].
TRIAL_JUMPS = ((-0.08, 0.06), (0.06, -0.08))


@dataclass(frozen=True)
class Bench:
    """Where controllers are tried.

    Attributes:
        arm: the arm; dt: its step in s; stations: how many of them are measured.
    """

    arm: TendonArm
    dt: float
    stations: int

    @cached_property
    def plant(self) -> FastStepper:
        """The arm, moved in large checked steps."""
        return self.arm.scene.fast_stepper(dt=self.dt, stations=self.stations)

    @cached_property
    def tip(self) -> Array:
        """The tip at rest (3,) in m."""
        return np.asarray(self.plant.reset(self.arm.rest_inputs)[-N_FIELDS : 3 - N_FIELDS])

    @property
    def limits(self) -> dict[str, Any]:
        """Displacements within 15 mm of the rest position, 2 mm a step."""
        middle = self.arm.pretension
        return {"u_min": middle - 0.015, "u_max": middle + 0.015, "du_max": 0.002}

    def loop(self, controller: MPC | FeedForward, reference: references.Reference, steps: int) -> LoopLog:
        """One closed loop of ``steps`` from rest."""
        run = ClosedLoop(plant=self.plant, controller=controller)
        log = run.run(reference, steps, u0=self.arm.rest_inputs, progress=False)
        if log.interrupted:
            raise KeyboardInterrupt
        return log

    def tuned(self, model: LiftedModel, turns: int = len(TRIAL_JUMPS)) -> MPC:
        """MPC with the rate weight that does best on trials.

        They are a smaller, slower circle than the one of the comparison, and ``turns`` jumps as far as its set-point in
        other directions: a model that is too bold for its errors does not come to rest after some of them. Circle and
        jumps count alike. A weight that is worse already is not tried any further.
        """
        tip = self.tip
        circle = references.circle(radius=0.06, period=6.0, center=tip[:2], approach=1.5)
        jumps = [references.setpoint([[tip[0] + x, tip[1] + y, np.nan]], [0.3]) for x, y in TRIAL_JUMPS[:turns]]
        trials = [(circle, 1.5, 1.0), *((jump, 3.0, 1.0 / len(jumps)) for jump in jumps)]
        best, least = None, np.inf
        for weight in RATE_WEIGHTS:
            mpc, total = MPC(model, horizon=HORIZON, track="tip", rate_weight=weight, **self.limits), 0.0
            for reference, after, share in trials:
                error = self.loop(mpc, reference, 150).rms_error(after=after)
                total += share * error if np.isfinite(error) else np.inf
                if total >= least:
                    break
            else:
                best, least = mpc, total
        return best if best is not None else mpc


@dataclass(frozen=True)
class Contest:
    """The same tasks for every controller: MPC on each of several models, tuned first, and feed-forward behind them.

    Attributes:
        bench: where they run; models: what the controllers know; table: statics for the feed-forward.
        tasks: references by name; steps: of each loop; turns: jumps in the tuning runs.
    """

    bench: Bench
    models: tuple[LiftedModel, ...]
    table: EquilibriumTable
    tasks: dict[str, references.Reference]
    steps: int
    turns: int

    def __call__(self, k: int) -> dict[str, LoopLog]:
        """The log of every task under controller ``k``; the number of the models is that of the feed-forward."""
        controller: MPC | FeedForward
        if k == len(self.models):
            controller = FeedForward(self.table.inverse, self.models[0], **self.bench.limits)
        else:
            controller = self.bench.tuned(self.models[k], self.turns)
        return {task: self.bench.loop(controller, reference, self.steps) for task, reference in self.tasks.items()}
