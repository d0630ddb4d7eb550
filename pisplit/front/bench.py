"""``pisplit bench``: times beside errors on this machine, in a minute: statics, motion, a fit, a step of MPC."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pisplit import Dictionary, LinearEDMDc, TendonArm, references
from pisplit import observables as ob
from pisplit.checks import Array, count
from pisplit.controllers import MPC, ClosedLoop
from pisplit.controllers.plants import ModelPlant

#: Nodes of the statics that are timed, and those of the shapes that they are held against.
NODES, TRUTH = (3, 4, 5, 6), 10
#: Nodes and tolerance of the motions that others are held against.
MOVING, TIGHT = 4, 1e-8


@dataclass(frozen=True)
class Measured:
    """A time beside an error.

    Attributes:
        what: was timed.
        milliseconds: of CPU of this process for one of them, the median.
        error: of what was computed; NaN where there is none.
        of: what the error is.
    """

    what: str
    milliseconds: float
    error: float
    of: str

    def __str__(self) -> str:
        error = f"{self.error:.1e} {self.of}" if np.isfinite(self.error) else self.of
        return f"{self.what:<52} {self.milliseconds:>9.3g} ms  {error}"

    def as_dict(self) -> dict[str, Any]:
        """The same as JSON-able facts; no error is None."""
        return {**asdict(self), "error": self.error if np.isfinite(self.error) else None}


def bench(steps: int = 60, seed: int = 0) -> tuple[Measured, ...]:
    """Work and precision of the paper's arm on this machine.

    ``steps`` of each motion and loop, at least 30; ``seed`` of displacements. Errors are against a finer grid (statics)
    and against IDAS at rtol 1e-8 on the same nodes (motions), in parts of the length. Raises ValueError for fewer.
    """
    total = count(steps, "steps", 30)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few nodes say so; the table says by how much
        return (*_statics(seed), *_motions(total, seed), *_control(total, seed))


def _timed(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median of the CPU milliseconds of a call, the first one left out, and what it returned."""
    found, spent = call(), []
    for _ in range(repeats):
        begin = time.process_time()
        found = call()
        spent.append(1e3 * (time.process_time() - begin))
    return float(np.median(spent)), found


def _moves(arm: TendonArm, number: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    turns = rng.uniform(0.0, 2.0 * np.pi, number)
    sizes = arm.amplitude * rng.uniform(0.3, 1.0, number)
    bends = np.stack([sizes * np.cos(turns), sizes * np.sin(turns)], axis=1)
    return np.asarray(arm.rest_inputs + bends @ arm.differential_basis.T)


def _statics(seed: int) -> list[Measured]:
    length = TendonArm.paper().scene.rod.length
    u = _moves(TendonArm.paper(), 12, seed)

    def tips(scene: Any, states: Array) -> Array:
        return np.asarray(scene.fields(states, 1)[:, 0, :3])

    fine = TendonArm.paper(TRUTH).scene
    exact = tips(fine, fine.statics().solve_many(u).states)
    rows = []
    for nodes in NODES:
        scene = TendonArm.paper(nodes).scene
        spent, found = _timed(lambda s=scene: s.statics().solve_many(u), 5)  # type: ignore[misc]
        off = np.linalg.norm(tips(scene, found.states) - exact, axis=1).max() / length
        rows.append(
            Measured(
                f"equilibrium and its branch, {nodes} nodes, of {len(u)} at once",
                spent / len(u),
                float(off),
                "L at the tip",
            )
        )
    return rows


def _motions(steps: int, seed: int) -> list[Measured]:
    arm = TendonArm.paper(MOVING)
    scene, dt = arm.scene, 0.03
    targets = _moves(arm, 3, seed)
    corners = np.vstack([arm.rest_inputs, targets])
    at = np.linspace(0.0, len(corners) - 1.0, steps)
    u = np.stack([np.interp(at, np.arange(len(corners)), c) for c in corners.T], axis=1)
    rest = scene.statics().solve(arm.rest_inputs).state
    exact = scene.simulator(dt, rtol=TIGHT).run(u, rest).fields(1)[:, 0, :3]
    makers = {
        "large checked steps": lambda: scene.fast_stepper(dt),
        "IDAS, rtol 1e-4": lambda: scene.simulator(dt, rtol=1e-4),
        "IDAS, rtol 1e-6": lambda: scene.simulator(dt, rtol=1e-6),
    }
    rows = []
    for name, make in makers.items():
        plant = make()
        spent, found = _timed(lambda p=plant: p.run(u, rest), 2)  # type: ignore[misc]
        off = np.linalg.norm(found.fields(1)[:, 0, :3] - exact, axis=1).max() / scene.rod.length
        rows.append(Measured(f"30 ms of motion, {name}", spent / steps, float(off), "L at the tip, in time"))
    return rows


def _control(steps: int, seed: int) -> list[Measured]:
    arm = TendonArm.paper(MOVING)
    d1 = arm.record(4, seed, steps, workers=1, progress=False)
    theta = Dictionary(ob.Constant(), ob.States(), ob.Delays(states=4, inputs=1), ob.Inputs(), n_states=144, n_inputs=3)
    spent, model = _timed(lambda: LinearEDMDc(theta, alpha=1e-4).fit(d1[:3]), 2)
    error = float(np.sqrt(model.score(d1[3:], "tip").median)) / arm.scene.rod.length
    fit = Measured(f"fit, {theta.n_columns} columns, {3 * (steps - 4)} pairs", spent, error, "L at the tip, roll-out")
    lifted = model.lifted
    mpc = MPC(lifted, 20, -0.014, 0.016, 0.002, track="tip")
    plant = ModelPlant(lifted, d1.xs[0][0])
    log = ClosedLoop(plant, mpc).run(references.circle(0.03, 4.0), steps, u0=arm.rest_inputs, progress=False)
    median, late = 1e3 * np.percentile(log.cpu_time[5:], [50, 99]) if len(log.u) > 5 else (np.nan, np.nan)
    solved = 100.0 * np.mean([s == "solved" for s in log.statuses]) if log.statuses else 0.0
    told = f"{solved:.0f} % solved to tolerance, p99 {late:.2g} ms"
    return [fit, Measured(f"step of MPC, {lifted.n_lifted} lifted states, horizon 20", float(median), np.nan, told)]
