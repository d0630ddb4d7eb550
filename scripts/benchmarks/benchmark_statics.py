"""Static equilibria: time per solve, and error against time beside a general boundary-value solver."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from common.report import Report
from pisplit.models import rod
from pisplit.models.arm.recording import random_differential
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.statics.flutter import Flutter

#: Tip (across, along) in parts of L of the inextensible elastica at F L^2 / EI = 10 (Bisshopp & Drucker 1945).
ELASTICA = np.array([0.8106090248802965, 0.4450044022462487])
SOLVES = 140_000


def measure_statics(report: Report, quick: bool, seed: int) -> None:
    """Cold solves, a large batch, and the elastica."""
    rng = np.random.default_rng(seed)
    count = 100 if quick else 1000
    cold_solves(report, "reference rod", reference_rod(), random_loads(count, rng))
    arm = TendonArm.paper(nodes=6)
    cold_solves(report, "paper arm", arm.scene, arm.rest_inputs + random_differential(arm, count, rng))
    many_solves(report, arm, 10_000 if quick else SOLVES, rng)
    elastica(report)
    flutter(report)


def reference_rod() -> rod.Scene:
    """Steel, radius 1 mm, 0.4 m, gravity, three tendons driven by tension, a tip force; six nodes."""
    return rod.Scene(
        rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0)),
        rod.Gravity((0.0, 0.0, -9.81)),
        rod.TipWrench(force=rod.Input("force", 3)),
        rod.Tendons.parallel(0.015, (0, 120, 240), rod.Tension()),
        nodes=6,
    )


def random_loads(count: int, rng: np.random.Generator) -> np.ndarray:
    """Tip forces of 0.5 N per axis (F L^2 / EI = 0.5) and tensions up to 10 N."""
    return np.hstack([0.5 * rng.standard_normal((count, 3)), rng.uniform(0.0, 10.0, (count, 3))])


def cold_solves(report: Report, name: str, scene: rod.Scene, inputs: np.ndarray) -> None:
    """Median time of one solve from the straight rod: the rootfinder alone, and the checked front door around it."""
    statics = scene.statics()
    zero = np.zeros(scene.n_strains)
    bare, whole, solved = [], [], 0
    for u in inputs:
        equilibrium, seconds = timed(statics.solve, u)
        whole.append(seconds)
        solved += equilibrium.success
        if equilibrium.solver == "kinsol":
            bare.append(timed(statics.kinsol, zero, u)[1])
    label = f"statics {name}, K=6"
    report.figure(f"{label}, cold solve", 1e3 * float(np.median(bare)), "ms", ("<=", 0.25))
    report.figure(f"{label}, cold solve with checks and tensions", 1e3 * float(np.median(whole)), "ms")
    report.figure(f"{label}, solved", 100.0 * solved / len(inputs), "%", (">=", 100.0))


def many_solves(report: Report, arm: TendonArm, count: int, rng: np.random.Generator) -> None:
    """A batch of random displacements on the paper arm: the virtual machine, and machine code on two threads."""
    statics = arm.scene.statics()
    inputs = arm.rest_inputs + random_differential(arm, count, rng)
    statics.solve_many(inputs[:200], compiled=False)
    part = inputs[: count // 10]
    batch, seconds = timed(lambda u: statics.solve_many(u, compiled=False), part)
    report.figure("statics paper arm, K=6, one of many", 1e3 * seconds / len(part), "ms")
    report.figure(f"statics 140,000 solves (scaled from {len(part)})", SOLVES * seconds / len(part), "s", ("<=", 30.0))
    report.figure("statics of many, solved", 100.0 * float(batch.success.mean()), "%", (">=", 100.0))
    walls = []
    for _ in range(2):  # the first makes or finds the machine code
        begin = time.perf_counter()
        found = statics.solve_many(inputs, progress=True, threads=2, compiled=True)
        walls.append(SOLVES / count * (time.perf_counter() - begin))
    scaled = "" if count == SOLVES else f" (scaled from {count})"
    report.figure(f"statics 140,000 solves by machine code on two threads, wall{scaled}", walls[1], "s", ("<=", 5.0))
    report.figure(
        "statics of many, machine code, numbers that differ", int((found.states[: len(part)] != batch.states).sum()), ""
    )


def elastica(report: Report) -> None:
    """Error against time at F L^2 / EI = 10: collocation of strains, and scipy's collocation of the plane problem."""
    print("elastica, F L^2 / EI = 10          tip error / L      CPU time")
    for strains, nodes in (("kirchhoff", 6), ("kirchhoff", 8), ("kirchhoff", 12), ("planar", 6), ("planar", 8)):
        body = rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0), strains)
        scene = rod.Scene(body, rod.TipWrench(force=rod.Input("f", 3)), nodes=nodes)
        load = np.array([10.0 * body.stiffness[0] / body.length**2, 0.0, 0.0])
        statics = scene.statics()
        tip = statics.solve(load).tip / body.length
        error = float(np.linalg.norm(tip[[0, 2]] - ELASTICA))
        seconds = repeated(50, statics.solve, load)
        print(f"  {strains + f', K = {nodes}':<30} {error:12.1e} {1e3 * seconds:12.3f} ms")
        if (strains, nodes) == ("kirchhoff", 8):
            report.figure("elastica, K=8, tip error", error, "L", ("<=", 5e-6))
    for tolerance in (1e-3, 1e-6, 1e-9):
        found = shoot(tolerance)
        error = float(np.linalg.norm(found - ELASTICA))
        seconds = repeated(5, shoot, tolerance)
        print(f"  {f'scipy solve_bvp, tol = {tolerance:g}':<30} {error:12.1e} {1e3 * seconds:12.3f} ms")
        if tolerance == 1e-6:
            report.figure("elastica, scipy solve_bvp tol 1e-6, tip error", error, "L")
            report.figure("elastica, scipy solve_bvp tol 1e-6", 1e3 * seconds, "ms")


def flutter(report: Report) -> None:
    """How much longer equilibria under strong follower loads take because flutter is looked for."""
    steel, push = rod.Elastic(207e9, 207e9 / 2.6, 8000.0), rod.Input("force", 3)
    for name, strains, load in (
        ("in the middle", "kirchhoff", rod.PointWrench(0.25, force=push, follower=True)),
        ("at the tip", "kirchhoff", rod.TipWrench(force=push, follower=True)),
        ("at the tip, plane", "planar", rod.TipWrench(force=push, follower=True)),
    ):
        body = rod.Rod(0.5, rod.Circle(1e-3), steel, strains)
        statics = rod.Scene(body, rod.Retardation(1e-4), load, nodes=6).statics()
        parts = []
        for size in (0.5, 1.0, 2.0):
            u = size * body.stiffness[0] / body.length**2 * np.array([1.0, 0.0, 0.0])
            if not statics.solve(u).success:
                raise RuntimeError(f"a follower force of {size:g} EI/L^2 {name} has no stable equilibrium")
            whole = repeated(20, statics.solve, u)
            looked = Flutter.met
            Flutter.met = lambda self, way: (None, None)  # type: ignore[method-assign]
            try:
                parts.append(whole / repeated(20, statics.solve, u))
            finally:
                Flutter.met = looked  # type: ignore[method-assign]
        for label, value in (("least", min(parts)), ("largest", max(parts))):
            report.figure(f"statics, follower load {name}, factor for flutter, {label}", value, "", ("<=", 1.5))


def shoot(tolerance: float) -> np.ndarray:
    """Tip (across, along) of theta'' = -10 cos theta, theta(0) = theta'(1) = 0 by scipy's ``solve_bvp``."""

    def rates(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([y[1], -10.0 * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 9)
    found = solve_bvp(rates, ends, s, np.stack([0.0 * s, 0.0 * s, 0.0 * s, s]), tol=tolerance, max_nodes=100_000)
    tip: np.ndarray = found.y[2:, -1]
    return tip


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Result of a call and its CPU time in s."""
    begin = time.process_time()
    found = call(*arguments)
    return found, time.process_time() - begin


def repeated(times: int, call: Callable[..., Any], *arguments: Any) -> float:
    """Median CPU time of a call in s."""
    return float(np.median([timed(call, *arguments)[1] for _ in range(times)]))
