"""Motion of the paper's arm: time per step, error against a fine reference, and a work-precision diagram."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from scipy.integrate import solve_ivp
from tqdm import tqdm

from common.drawing import save_figure
from common.report import Report
from pisplit.models import rod
from pisplit.models.arm.recording import random_displacements
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.dynamics.fast import FastStepper
from pisplit.models.rod.dynamics.integrator import Simulator

matplotlib.use("Agg")
from matplotlib import pyplot as plt

DT = 0.03
DEFAULT = (5, 1e-4)


@dataclass(frozen=True)
class Point:
    """One setting: CPU time per step of 0.03 s in ms, maximum tip error in parts of L.

    ``rtol`` is the relative tolerance, or the internal step in s.
    """

    label: str
    rtol: float
    time: float
    error: float


def measure_dynamics(report: Report, quick: bool, seed: int, out: Path) -> None:
    """The default setting against its targets, steps of a closed loop, and the diagram."""
    steps = 40 if quick else 200
    commands = random_displacements(TendonArm.paper(), steps, np.random.default_rng(seed))
    with tqdm(total=1, desc="reference (K=10, rtol 1e-8)", unit="run") as bar:
        reference, _ = trajectory(10, 1e-8, commands, 1)
        bar.update()
    nodes, rtol = DEFAULT
    default = point(nodes, rtol, commands, reference, 5)
    span = f"{steps} steps"
    report.figure("dynamics paper arm, step of 0.03 s", default.time, "ms", ("<=", 4.0))
    report.figure(f"dynamics paper arm, maximum tip error over {span}", default.error, "L", ("<=", 1e-3))
    fast = fast_point(nodes, DT, commands, reference, 5)
    report.figure("dynamics fast Radau steps, step of 0.03 s", fast.time, "ms", ("<=", 0.3))
    report.figure(f"dynamics fast Radau steps, maximum tip error over {span}", fast.error, "L", ("<=", 1e-4))
    machine = fast_point(nodes, DT, commands, reference, 5, compiled=True)
    report.figure("dynamics fast Radau steps, machine code, step of 0.03 s", machine.time, "ms", ("<=", 0.08))
    single_steps(report, commands, reference)
    points = [
        point(k, tolerance, commands, reference, 1)
        for k, tolerance in tqdm(settings(quick), desc="work-precision", unit="run")
    ]
    points += [
        fast_point(k, DT / cut, commands, reference, 1)
        for k in ((5, 6) if quick else (4, 5, 6, 8))
        for cut in ((1, 2) if quick else (1, 2, 4))
    ]
    peers = peer_points(commands, reference, quick)
    best = min((p for p in peers), key=lambda p: abs(np.log(p.error / default.error)))
    report.figure(f"dynamics peer {best.label} rtol {best.rtol:g}, step", best.time, "ms")
    report.figure(f"dynamics peer {best.label} rtol {best.rtol:g}, maximum tip error", best.error, "L")
    print("\nwork and precision                  rtol    tip error / L    ms per step   (fast: step in s)")
    for p in points + peers:
        print(f"  {p.label:<30} {p.rtol:9.1e} {p.error:14.1e} {p.time:14.2f}")
    draw(points + peers, out / "work_precision.png")


def settings(quick: bool) -> list[tuple[int, float]]:
    """Nodes and tolerances of the diagram."""
    nodes = (4, 5, 6) if quick else (3, 4, 5, 6, 8)
    tolerances = (1e-3, 1e-4, 1e-5) if quick else (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6)
    return [(k, rtol) for k in nodes for rtol in tolerances]


def tips(scene: rod.Scene, states: np.ndarray) -> np.ndarray:
    """Tip positions (T, 3) in parts of L."""
    found: np.ndarray = scene.fields(states, [scene.rod.length])[:, 0, :3] / scene.rod.length
    return found


def trajectory(nodes: int, rtol: float, commands: np.ndarray, repeats: int) -> tuple[np.ndarray, float]:
    """Tips of a run of IDAS from rest, and the median CPU time per step in ms."""
    return timed(TendonArm.paper(nodes).scene.simulator(DT, rtol=rtol), commands, repeats)


def timed(mover: Simulator | FastStepper, commands: np.ndarray, repeats: int) -> tuple[np.ndarray, float]:
    """Tips of a run from rest, and the median CPU time per step in ms; building functions is not counted."""
    scene, arm = mover.scene, TendonArm.paper()
    start = scene.statics().solve(arm.rest_inputs).state
    mover.run(np.tile(arm.rest_inputs, (len(commands), 1)), start, check=False)
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        run = mover.run(commands, start, check=False)
        spent.append(time.process_time() - begin)
    if not run.success:
        raise RuntimeError(f"K = {scene.nodes}: {run.message}")
    return tips(scene, run.x), 1e3 * float(np.median(spent)) / len(commands)


def fast_point(
    nodes: int, step: float, commands: np.ndarray, reference: np.ndarray, repeats: int, compiled: bool = False
) -> Point:
    """Large checked Radau steps against the reference."""
    scene = TendonArm.paper(nodes).scene
    mover = (scene.compile() if compiled else scene).fast_stepper(DT, step=step)
    found, spent = timed(mover, commands, repeats)
    return Point(f"fast Radau, K = {nodes}", step, spent, float(np.abs(found - reference).max()))


def point(nodes: int, rtol: float, commands: np.ndarray, reference: np.ndarray, repeats: int) -> Point:
    """One setting against the reference."""
    found, spent = trajectory(nodes, rtol, commands, repeats)
    return Point(f"IDAS, K = {nodes}", rtol, spent, float(np.abs(found - reference).max()))


def single_steps(report: Report, commands: np.ndarray, reference: np.ndarray) -> None:
    """The arm as a plant, one step at a time; the measured fields are part of the step."""
    arm = TendonArm.paper(DEFAULT[0])
    plants: list[tuple[str, Simulator | FastStepper]] = [
        ("IDAS", arm.scene.simulator(DT, rtol=DEFAULT[1])),
        ("fast Radau", arm.scene.fast_stepper(DT)),
        ("fast Radau, machine code,", arm.scene.compile().fast_stepper(DT)),
    ]
    for name, simulator in plants:
        _single_steps(report, name, simulator, commands, reference)


def _single_steps(
    report: Report, name: str, simulator: Simulator | FastStepper, commands: np.ndarray, reference: np.ndarray
) -> None:
    simulator.reset(TendonArm.paper().rest_inputs)
    tip = list(simulator.field_map.outputs["tip"])
    spent, measured, failed = [], [], 0
    for k, u in enumerate(commands):
        begin = time.process_time()
        step = simulator.step(u)
        if k:  # the first builds the integrator
            spent.append(1e3 * (time.process_time() - begin))
        failed += not step.ok
        measured.append(step.state[tip] / simulator.scene.rod.length)
    report.figure(f"closed-loop {name} step, median", float(np.median(spent)), "ms", ("<=", 5.0))
    report.figure(f"closed-loop {name} step, p99", float(np.percentile(spent, 99)), "ms")
    report.figure(f"closed-loop {name} step, failures", failed, "", ("<=", 0.0))
    report.figure(f"closed-loop {name} step, maximum tip error", float(np.abs(measured - reference[1:]).max()), "L")


def peer_points(commands: np.ndarray, reference: np.ndarray, quick: bool) -> list[Point]:
    """scipy's BDF and Radau on the same equations, solved for the accelerations, with their exact Jacobian."""
    arm = TendonArm.paper(DEFAULT[0])
    scene, n = arm.scene, arm.scene.n_strains
    steps = len(commands)
    start = scene.statics().solve(arm.rest_inputs).state
    t = DT * np.arange(steps + 1)
    servo = np.vstack([arm.rest_inputs, commands[:steps]])
    nominal = np.concatenate([scene.nominal_strains, scene.nominal_strains * scene.rod.bending_rate])
    derivative, upper = scene.acceleration.jacobian(), np.hstack([np.zeros((n, n)), np.eye(n)])

    def inputs(now: float) -> np.ndarray:
        return np.array([np.interp(now, t, column) for column in servo.T])

    def rates(now: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[n:], np.asarray(scene.acceleration(y[:n], y[n:], inputs(now))).ravel()])

    def jacobian(now: float, y: np.ndarray) -> np.ndarray:
        by_strains, by_rates = derivative(y[:n], y[n:], inputs(now), np.zeros(n))[:2]
        return np.vstack([upper, np.hstack([np.asarray(by_strains), np.asarray(by_rates)])])

    points = []
    runs = [(method, rtol) for method in ("BDF", "Radau") for rtol in ((1e-3, 1e-4) if quick else (1e-3, 1e-4, 1e-5))]
    for method, rtol in tqdm(runs, desc="scipy", unit="run"):
        begin = time.process_time()
        run = solve_ivp(rates, (0.0, t[-1]), start[: 2 * n], method, t, rtol=rtol, atol=rtol * nominal, jac=jacobian)
        spent = 1e3 * (time.process_time() - begin) / steps
        if run.success:
            error = np.abs(tips(scene, np.hstack([run.y.T, servo])) - reference[: steps + 1]).max()
            points.append(Point(f"scipy {method}, K = {DEFAULT[0]}", rtol, spent, float(error)))
    return points


def draw(points: list[Point], path: Path) -> None:
    """Error against CPU time, one line a method."""
    figure, axes = plt.subplots(figsize=(8.5, 5.0), constrained_layout=True)
    for label in dict.fromkeys(p.label for p in points):
        line = sorted((p for p in points if p.label == label), key=lambda p: -p.rtol)
        style = {"marker": "s", "linestyle": "--"} if "scipy" in label else {"marker": "o", "linestyle": "-"}
        axes.loglog([p.time for p in line], [p.error for p in line], label=label, **style)
    axes.axhline(1e-3, color="0.6", linewidth=0.8)
    axes.axvline(4.0, color="0.6", linewidth=0.8)
    axes.set_xlabel("CPU time per 0.03 s of motion [ms], one thread")
    axes.set_ylabel("maximum tip error [parts of L]")
    axes.set_title("Paper's tendon arm: each line from loose to tight rtol; grey: targets")
    axes.grid(True, which="both", alpha=0.25)
    figure.legend(loc="outside right upper")
    save_figure(figure, path, dpi=140)
