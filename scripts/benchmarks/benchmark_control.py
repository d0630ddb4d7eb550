"""Time of one MPC step on a lifted model of 723 columns, and of its parts beside what they replaced.

``python scripts/benchmarks/benchmark_control.py`` runs this alone, ``make bench`` with the rod's.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from benchmarks.rounds import busy_cores, rounds_of, show
from common.report import Report, parser, run
from pisplit import LiftedModel
from pisplit.controllers import MPC, QPSettings
from pisplit.controllers.mpc.limits import InputLimits, input_limits

COLUMNS = 723
HORIZON = 20
DT = 0.03
#: Angles of the tendons, and what a pull of 1 m of one of them would move the tip by if the arm were linear.
ANGLES = np.deg2rad([0.0, 120.0, 240.0])
REACH = 20.0


def measure_control(report: Report, quick: bool, seed: int) -> None:
    """Track a circle of 0.1 m in 4 s with the model as its own, noisy, plant; limits of the paper's arm."""
    solvers = ["osqp"] + (["daqp"] if find_spec("daqp") else [])
    model = arm_like_model(np.random.default_rng(seed))
    for solver in solvers:
        _measure_solver(report, model, solver, quick, seed)
    _measure_parts(report, model, quick, seed)
    _measure_threads(report, model, quick)


def _measure_solver(report: Report, model: LiftedModel, solver: str, quick: bool, seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    settings = QPSettings(solver=solver)
    mpc = MPC(model, HORIZON, u_min=-0.015, u_max=0.015, du_max=0.002, track="tip", rate_weight=0.01, qp=settings)
    mpc.reset(np.zeros(3))
    steps = 200 if quick else 1000
    angle = 2.0 * np.pi * DT / 4.0 * np.arange(steps + HORIZON + 1)
    circle = 0.1 * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * angle], axis=1)
    state, spent, bad, solved = np.zeros(COLUMNS), [], 0, 0
    for k in tqdm(range(steps), desc=f"MPC, {solver}", unit="step"):
        move = mpc.step(state, circle[k + 1 : k + 1 + HORIZON])
        spent.append(1e3 * move.cpu_time)
        bad += move.fallback
        solved += move.status == "solved"
        state = model.A @ state + model.B @ move.u + 1e-4 * rng.standard_normal(COLUMNS)
    label = f"MPC step, H = {HORIZON}, M = {COLUMNS}, {solver.upper()}"
    report.figure(f"{label}, median", float(np.median(spent)), "ms", ("<=", 1.0))
    report.figure(f"{label}, p99", float(np.percentile(spent, 99)), "ms", ("<=", 2.5))
    report.figure(f"{label}, maximum after the first", float(np.max(spent[1:])), "ms")
    report.figure(f"{label}, solved to tolerance", 100.0 * solved / steps, "%", (">=", 100.0))
    report.figure(f"{label}, fallbacks", bad, "")


def _measure_parts(report: Report, model: LiftedModel, quick: bool, seed: int) -> None:
    """Reading the states and projecting onto the limits, a thousand of each, beside what did it before."""
    rng = np.random.default_rng([seed, 2])
    limits = input_limits(-0.015, 0.015, 0.002, 3, model.input_offset, model.input_basis)
    before = limits.offset + limits.basis @ limits.coordinates(rng.uniform(-0.01, 0.01, 3))
    moves = before + 2e-3 * rng.standard_normal((1000, 3))
    states = rng.standard_normal((1000, COLUMNS))
    low, high = before - limits.du_max, before + limits.du_max
    parts: dict[str, dict[str, Callable[[Any], Any]]] = {
        "MPC, states of a lifted state": {"taken": model.read, "product with C": lambda z: z @ model.C.T + model.d},
        "MPC, projection onto limits": {
            "nearest point": lambda u: limits.project(u, before),
            "alternating projections": lambda u: _alternating(limits, u, low, high),
        },
    }
    for (title, variants), values in zip(parts.items(), (states, moves), strict=True):
        calls = {name: partial(_each, action, values) for name, action in variants.items()}
        with threadpool_limits(1):
            times = rounds_of(calls, 2 if quick else 7, process_time, title)
        show(report, title, {name: 1e6 * spent / len(values) for name, spent in times.items()}, "us")


def _each(action: Callable[[Any], Any], values: NDArray[np.float64]) -> None:
    for value in values:
        action(value)


def _alternating(
    limits: InputLimits, u: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """A point of the box [low, high] on the plane of the inputs, by alternating projections: not the nearest."""
    for _ in range(200):
        inside = np.clip(u, low, high)
        u = limits.offset + limits.basis @ (limits.basis.T @ (inside - limits.offset))
        if np.abs(u - inside).max() <= 1e-10 * limits.amplitude.max():
            return np.asarray(inside)
    return None


def _measure_threads(report: Report, model: LiftedModel, quick: bool) -> None:
    """Wall time of steps with two BLAS threads while two other processes run: as they are, and not limited."""
    mpc = MPC(model, HORIZON, u_min=-0.015, u_max=0.015, du_max=0.002, track="tip", rate_weight=0.01)
    window = np.tile([0.01, 0.0, 0.0], (HORIZON, 1))

    def steps(threads: int, step: Callable[..., Any]) -> None:
        mpc.reset(np.zeros(3))
        with threadpool_limits(threads):
            for _ in range(20):
                step(np.zeros(COLUMNS), window)

    unlimited = partial(getattr(MPC.step, "__wrapped__"), mpc)  # noqa: B009
    calls = {
        "one thread": partial(steps, 1, mpc.step),
        "two threads": partial(steps, 2, mpc.step),
        "two threads, not limited": partial(steps, 2, unlimited),
    }
    title = "MPC step while two other processes run"
    with busy_cores(2):
        times = rounds_of(calls, 2 if quick else 7, perf_counter, title)
    show(report, title, {name: 1e3 * spent / 20 for name, spent in times.items()}, "ms")


def arm_like_model(rng: np.random.Generator) -> LiftedModel:
    """A lifted model with the size and the slow modes of an identified arm: bending at 1.55 Hz with 6 % of damping in
    two directions, overtones, and fast real modes, mixed by a random change of columns whose first three are the tip.
    """
    blocks, drives, reads = [], [], []
    for k in range(12):
        rate = 2.0 * np.pi * 1.55 * (1.0 + 0.7 * k)
        growth, turn = np.exp(-0.06 * rate * DT), rate * DT * np.sqrt(1.0 - 0.06**2)
        block = growth * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        direction = (0.5 * np.pi) * (k % 2)
        pull = np.cos(ANGLES - direction) * 2.0 / 3.0
        axis = np.array([np.cos(direction), np.sin(direction), 0.0])
        settled = np.linalg.solve(np.eye(2) - block, np.array([1.0, 0.0]))[0]
        blocks.append(block)
        drives.append(np.stack([pull, 0.0 * pull]))
        reads.append(np.stack([REACH / (1.0 + k) ** 3 / settled * axis, 0.0 * axis], axis=1))
    fast = COLUMNS - 2 * len(blocks)
    modes = np.zeros((COLUMNS, COLUMNS))
    for k, block in enumerate(blocks):
        modes[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
    modes[range(2 * len(blocks), COLUMNS), range(2 * len(blocks), COLUMNS)] = rng.uniform(0.0, 0.8, fast)
    drive = np.vstack([*drives, rng.standard_normal((fast, 3))])
    mix = np.linalg.qr(rng.standard_normal((COLUMNS, COLUMNS)))[0]
    mix[:3] = 0.0
    mix[:3, : 2 * len(blocks)] = np.hstack(reads)
    mix[2, 2 * len(blocks)] = 1e-2
    back = np.linalg.inv(mix)
    x, v, u = ca.MX.sym("x", COLUMNS), ca.MX.sym("v", 3, 0), ca.MX.sym("u", 3)
    names, inputs = tuple(f"x{k}" for k in range(COLUMNS)), ("u1", "u2", "u3")
    return LiftedModel(
        A=mix @ modes @ back,
        B=mix @ drive,
        c=np.zeros(COLUMNS),
        C=np.eye(COLUMNS),
        d=np.zeros(COLUMNS),
        dt=DT,
        lift_function=ca.Function("lift", [x, v], [x]),
        input_function=ca.Function("phi", [u], [u]),
        n_delays=0,
        state_names=names,
        input_names=inputs,
        column_names=names,
        feature_names=inputs,
        input_offset=np.zeros(3),
        input_basis=np.linalg.svd(np.eye(3) - 1.0 / 3.0)[0][:, :2],
        state_range=np.ones(COLUMNS),
        outputs={"tip": (0, 1, 2)},
    )


def main() -> None:
    """Measure, print, write the figures."""
    given = parser(__doc__ or "").parse_args()
    report = Report.of("controller, CPU time on one thread", given)
    with threadpool_limits(1):
        measure_control(report, given.quick, given.seed)
    report.write(given.json)
    print(f"\n{report}")


if __name__ == "__main__":
    run(main)
