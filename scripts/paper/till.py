"""Trajectories by the time stepping that the paper names: implicit steps of 0.03 s by BDF2.

Till, Aloi and Rucker, *Real-time dynamics of soft and continuum robots based on Cosserat rod models*, IJRR 2019. The
scheme damps what is faster than its steps; it is a part of the data, not an error to be avoided. In space the arm keeps
its Gauss nodes, where the paper has 101 points.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit import Episodes
from pisplit.models import rod
from pisplit.models.arm.base import Arm
from pisplit.models.arm.blocks import Block, discard_blocks, run_blocks
from pisplit.models.arm.recording import arm_origin, labels, random_displacements

Array = NDArray[np.float64]

#: Newton iterations of a step, all with a new matrix.
ITERATIONS = 8
#: Last correction of the strains in parts of their nominal size up to which a step converged.
CONVERGED = 1e-8
ATTEMPTS = 20


def bdf2(scene: rod.Scene, dt: float, steps: int) -> ca.Function:
    """``(start (2 n,), commands (m, T)) -> states [xi, xi_t] (2 n, T), corrections (1, T)``: T steps of BDF2 from rest.

    The balance of ``scene`` holds at the end of every step, where its command is reached, with
    x_t = (3 x - 4 x_1 + x_2) / (2 dt) for strains and rates; the state before ``start`` is ``start``.
    """
    n, m, c = scene.n_strains, scene.n_inputs, 1.5 / dt
    memory, command = ca.MX.sym("memory", 4 * n), ca.MX.sym("command", m)
    last, before = memory[: 2 * n], memory[2 * n :]
    past = -2.0 / dt * last + 0.5 / dt * before
    residual = scene.native(scene.motion_residual)
    x = 2.0 * last[:n] - before[:n]
    size = ca.MX(np.inf)
    nominal = ca.DM(scene.nominal_strains)
    for _ in range(ITERATIONS):
        rate = c * x + past[:n]
        at = (x, rate, c * rate + past[n:], command)
        missed = residual(*at)
        of_shape, of_rate, mass = residual.jacobian()(*at, ca.DM(n, 1))[:3]
        change = ca.solve(of_shape + c * of_rate + c * c * mass, missed, "lapacklu")
        x, size = x - change, ca.norm_2(change / nominal)
    state = ca.vertcat(x, c * x + past[:n])
    step = ca.Function("step", [memory, command], [ca.vertcat(state, last), ca.vertcat(state, size)])
    start, commands = ca.MX.sym("start", 2 * n), ca.MX.sym("commands", m, steps)
    found = step.mapaccum(steps)(ca.vertcat(start, start), commands)[1]
    return ca.Function("bdf2", [start, commands], [found[: 2 * n, :], found[2 * n, :]])


@dataclass(frozen=True)
class ImplicitTask:
    """One episode from rest, the work of a block; draws that a step fails in are recorded and replaced.

    Its attributes are arguments of :func:`implicit_episodes`.
    """

    arm: Arm
    steps: int
    dt: float
    hold: int
    stations: int
    seed: int
    law: str
    compiled: bool

    def __call__(self, k: int) -> Block:
        """Episode ``k``: states of the simulator, inputs, fields."""
        scene, run = _steps(self.arm, self.dt, self.steps, self.compiled)
        rest = scene.statics().solve(self.arm.rest_inputs).state
        failures: list[str] = []
        for attempt in range(ATTEMPTS):
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(3, k, attempt)))
            commands = random_displacements(self.arm, self.steps, rng, self.law, self.hold)
            found, corrections = (np.asarray(v).T for v in run(rest[: 2 * scene.n_strains], commands.T))
            worst = float(np.max(corrections))
            if worst <= CONVERGED:
                states = np.vstack([rest, np.hstack([found, commands])])
                fields = scene.fields(states, self.stations).reshape(self.steps + 1, -1)
                return {"x": fields, "u": commands, "state": states, "failures": np.array(failures, dtype=str)}
            failures.append(f"Newton's method does not converge, last correction {worst:.1e}")
        raise RuntimeError(f"episode {k} failed {ATTEMPTS} times, last: {failures[-1]}")


def implicit_episodes(
    arm: Arm,
    path: str | os.PathLike[str],
    episodes: int,
    steps: int,
    dt: float,
    hold: int,
    seed: int = 0,
    workers: int = -1,
    progress: bool = True,
    law: str = "zero-sum",
    compiled: bool = False,
    stations: int = 6,
) -> Episodes:
    """Simulate ``episodes`` of ``steps`` BDF2 steps with new random targets every ``hold`` steps; kept at ``path``.

    The other arguments are those of :func:`pisplit.models.arm.recording.make_episodes`.
    """
    identity = implicit_origin(arm, steps, dt, hold, seed, law, stations)
    task = ImplicitTask(arm, steps, dt, hold, stations, seed, law, compiled)
    if compiled:
        _steps(arm, dt, steps, True)  # compiled once, not by every worker
    parts = f"{os.fspath(path)}.parts"
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    blocks = run_blocks(task, episodes, parts, identity, workers, "episodes", progress)
    failures = [f"episode {k}: {text}" for k, block in enumerate(blocks) for text in block["failures"]]
    result = Episodes(
        [block["x"] for block in blocks],
        [block["u"] for block in blocks],
        dt=dt,
        extra={"state": [block["state"] for block in blocks]},
        provenance={**identity, "failures": failures},
        **labels(arm, arm.scene.field_map(stations)),
    )
    result.save(path)
    discard_blocks(parts)
    return result


def implicit_origin(
    arm: Arm, steps: int, dt: float, hold: int, seed: int, law: str = "zero-sum", stations: int = 6
) -> dict[str, Any]:
    """All that decides the episodes of :func:`implicit_episodes` but their number."""
    origin = arm_origin(arm, "episodes", stations, seed, law)
    return {**origin, "steps": steps, "steps_per_target": hold, "dt": dt, "method": "bdf2"}


@lru_cache(maxsize=2)
def _steps(arm: Arm, dt: float, steps: int, compiled: bool) -> tuple[rod.Scene, ca.Function]:
    scene: rod.Scene = arm.scene.compile() if compiled else arm.scene
    return scene, bdf2(scene, dt, steps)
