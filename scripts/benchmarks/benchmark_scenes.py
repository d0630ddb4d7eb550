"""What each part of a scene costs: from a plane rod without tendons to everything, in one run.

CPU time per 0.03 s simulated (virtual machine of CasADi; with ``--compiled`` also machine code) and instruction counts
of residual and Jacobian. Every scene follows the same plan from its own rest: tendons or, without them, the tip force
that bends the rod as much. Then the paper's arm over nodes and tolerances against a fine reference, the full Cosserat
arm with default settings, the time from nothing to a first result, and the energy of an undamped rod over 10 s. Figures
are printed beside their targets.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from tqdm import tqdm

from common.drawing import save_figure
from common.report import Report, parser, run
from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

DT = 0.03
NODES = 4
#: Finer tolerance of the runs that the errors are measured against.
EXACT = 1e-8
#: Nodes and tolerance of the paper's arm.
ARM_SETTINGS = ((4, 1e-4), (5, 1e-4), (5, 3e-5), (6, 3e-5), (6, 1e-5), (7, 1e-5), (8, 1e-5), (8, 5e-6))
#: Errors in parts of L at which the paper's arm is timed, with targets in ms by kind of evaluation.
ARM_GOALS = ((7e-4, {"VM": 4.0, "compiled": 1.5}), (3e-5, {"compiled": 2.0}))
#: A new process builds the paper's arm, solves its rest, and runs one step.
FIRST_RESULT = """
import time
start = time.perf_counter()
from pisplit.models.arm.tendon_arm import TendonArm
arm = TendonArm.paper()
rest = arm.scene.statics().solve(arm.rest_inputs)
assert arm.scene.simulator(0.03).run([arm.rest_inputs], rest.state).success
print(time.perf_counter() - start, time.process_time())
"""
LENGTH, OFFSET = 0.7144, 15.06e-3
SECTION = rod.Circle(0.675e-3)
MATERIAL = rod.Elastic(207e9, 207e9 / 2.6, 33249.0)
Row = dict[str, Any]


def scenes() -> dict[str, rod.Scene]:
    """The paper's backbone with more and more on it."""
    gravity = rod.Gravity((-9.81, 0.0, 0.0))
    damping = rod.KelvinVoigt(bending=5e-4, torsion=5e-4, shear=5.0, stretch=50.0)
    drag = rod.QuadraticDrag(1e-4)
    force = rod.TipWrench(force=rod.Input("force", 3))
    pair = rod.Tendons([(OFFSET, 0.0), (-OFFSET, 0.0)], rod.Displacement(1e-4))
    three = rod.Tendons.parallel(OFFSET, (0, 120, 240), rod.Displacement(1e-4))

    def made(strains: str, *terms: Any) -> rod.Scene:
        return rod.Scene(rod.Rod(LENGTH, SECTION, MATERIAL, strains), damping, force, *terms, nodes=NODES)

    return {
        "plane": made("planar"),
        "plane, gravity": made("planar", gravity),
        "plane, gravity, drag": made("planar", gravity, drag),
        "plane, gravity, drag, 2 tendons": made("planar", gravity, drag, pair),
        "space": made("kirchhoff"),
        "space, gravity": made("kirchhoff", gravity),
        "space, gravity, drag": made("kirchhoff", gravity, drag),
        "space, gravity, drag, 3 tendons": made("kirchhoff", gravity, drag, three),
        "space, shear and stretch": made("cosserat"),
        "everything": made("cosserat", gravity, drag, three),
    }


def commands(scene: rod.Scene, steps: int) -> np.ndarray:
    """Slow ramps of the tip force, or of the tendons, which bend the rod about as much."""
    t = DT * np.arange(1, steps + 1)
    wave = np.stack([np.sin(2.0 * t), np.sin(3.1 * t)], axis=1)
    u = np.zeros((steps, scene.n_inputs))
    tendons = [term for term in scene.terms if isinstance(term, rod.Tendons)]
    if tendons:
        points = np.array([point for point in tendons[0].offsets if not callable(point)]) / OFFSET
        u[:, 3:] = 1e-3 + 0.008 * wave @ points.T
    else:
        u[:, :2] = 0.05 * wave
        if scene.rod.strain_set.planar:
            u[:, 1] = 0.0
    return u


def measure(scene: rod.Scene, steps: int, rtol: float, compiled: bool, repeats: int) -> Row:
    """Median time per interval, error of the tip in parts of L, and sizes."""
    rest = scene.statics().solve().state
    u = commands(scene, steps)
    simulator = scene.simulator(DT, rtol=rtol)
    run = simulator.run(u, rest)
    exact = scene.simulator(DT, rtol=EXACT).run(u, rest)
    off = np.linalg.norm(run.fields(1)[:, 0, :3] - exact.fields(1)[: len(run.t), 0, :3], axis=1).max() / LENGTH
    cost = scene.cost().total
    row: Row = {
        "vm": _median_time(simulator, u, rest, repeats),
        "error": float(off) if run.success and exact.success else float("nan"),
        "steps": run.stats["nsteps"] / steps,
        "states": scene.n_states,
        "residual": cost.residual,
        "jacobian": cost.jacobian,
    }
    if compiled:
        row["compiled"] = _median_time(scene.compile(stations=1).simulator(DT, rtol=rtol), u, rest, repeats)
    return row


def _median_time(simulator: Any, u: np.ndarray, rest: np.ndarray, repeats: int) -> float:
    """Milliseconds of CPU time per interval, the first run left out."""
    simulator.run(u, rest)
    seconds = []
    for _ in range(repeats):
        before = time.process_time()
        simulator.run(u, rest)
        seconds.append(time.process_time() - before)
    return 1e3 * float(np.median(seconds)) / len(u)


def table(rows: dict[str, Row]) -> str:
    """One line a scene."""
    compiled = "compiled" in next(iter(rows.values()))
    head = f"{'ms per 0.03 s':<34}{'VM':>8}" + (f"{'C':>8}" if compiled else "")
    lines = [head + f"{'steps':>8}{'error/L':>10}{'states':>8}{'residual':>10}{'Jacobian':>10}"]
    for name, r in rows.items():
        times = f"{r['vm']:>8.3f}" + (f"{r['compiled']:>8.3f}" if compiled else "")
        sizes = f"{r['steps']:>8.1f}{r['error']:>10.1e}{r['states']:>8}{r['residual']:>10}{r['jacobian']:>10}"
        lines.append(f"{name:<34}{times}{sizes}")
    return "\n".join(lines)


def draw(rows: dict[str, Row], path: Path) -> None:
    """Bars of time beside bars of instructions."""
    names = list(rows)[::-1]
    figure, axes = plt.subplots(1, 2, figsize=(13.0, 5.2), sharey=True, constrained_layout=True)
    places = np.arange(len(names))
    kinds = [k for k in ("vm", "compiled") if k in rows[names[0]]]
    height = 0.8 / len(kinds)
    for i, kind in enumerate(kinds):
        label, colour = {"vm": ("virtual machine", "#1b6ca8"), "compiled": ("machine code", "#0f9d76")}[kind]
        at = places + 0.4 - height * (i + 0.5)
        bars = axes[0].barh(at, [rows[n][kind] for n in names], height=height, color=colour, label=label)
        axes[0].bar_label(bars, fmt="%.2f", padding=3, fontsize=8)
    axes[0].set_yticks(places, names)
    axes[0].set(xlabel="CPU time (ms per 0.03 s simulated)")
    axes[0].legend(frameon=False, loc="upper right")
    for size, colour, shift in (("residual", "#d98c3f", 0.2), ("jacobian", "#7d5ba6", -0.2)):
        axes[1].barh(places + shift, [rows[n][size] for n in names], height=0.38, color=colour, label=size)
    axes[1].set(xlabel="instructions", xscale="log")
    axes[1].legend(frameon=False, loc="upper right")
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="x", alpha=0.25)
        axis.set_axisbelow(True)
    save_figure(figure, path, dpi=130)


def paper_arm(report: Report, compiled: bool, quick: bool, seed: int) -> list[str]:
    """The paper's arm under random ramps of its tendons: nodes and tolerance against error, by kind of evaluation."""
    steps = 40 if quick else 200
    arm = TendonArm.paper()
    rng = np.random.default_rng(seed)
    knots = arm.amplitude * rng.uniform(-1.0, 1.0, (steps // 8 + 2, 2)) @ arm.differential_basis.T
    at = np.arange(1, steps + 1) / 8.0
    u = arm.pretension + np.stack([np.interp(at, np.arange(len(knots)), k) for k in knots.T], axis=1)

    def rest(scene: rod.Scene) -> np.ndarray:
        return scene.statics().solve(arm.rest_inputs).state

    fine = TendonArm.paper(nodes=10 if quick else 14).scene
    exact = fine.simulator(DT, rtol=1e-7).run(u, rest(fine)).fields(1)[:, 0, :3]
    lines = [f"{'paper arm, ms per 0.03 s':<34}{'VM':>8}{'C':>8}{'error/L, max':>14}{'median':>10}"]
    found: list[tuple[str, float, float]] = []
    for nodes, rtol in tqdm(((5, 1e-4),) if quick else ARM_SETTINGS, desc="paper arm", unit="setting"):
        scene = TendonArm.paper(nodes).scene
        start, simulator = rest(scene), scene.simulator(DT, rtol=rtol)
        off = np.linalg.norm(simulator.run(u, start).fields(1)[:, 0, :3] - exact, axis=1) / LENGTH
        times = {"VM": _median_time(simulator, u, start, 5)}
        if compiled:
            times["compiled"] = _median_time(scene.compile(stations=1).simulator(DT, rtol=rtol), u, start, 5)
        name = f"K={nodes}, rtol {rtol:.0e}"
        code = times.get("compiled", float("nan"))
        lines.append(f"{name:<34}{times['VM']:>8.3f}{code:>8.3f}{off.max():>14.1e}{np.median(off):>10.1e}")
        found += [(kind, ms, float(off.max())) for kind, ms in times.items()]
    for limit, targets in ARM_GOALS:
        for kind, bound in targets.items():
            good = [ms for k, ms, error in found if k == kind and error <= limit]
            if good:
                report.figure(f"paper arm within {limit:g} L, {kind}", min(good), "ms per 0.03 s", ("<=", bound))
            elif any(k == kind for k, _, _ in found):
                lines.append(f"no setting of the paper arm is within {limit:g} L")
    return lines


def plane_rod(report: Report, steps: int) -> None:
    """The plane rod at the loosest tolerance within 7e-4 L of a reference on more nodes."""
    scene = scenes()["plane"]
    u, rest = commands(scene, steps), scene.statics().solve().state
    exact = scene.with_nodes(NODES + 4).simulator(DT, rtol=EXACT).run(u).fields(1)[:, 0, :3]
    for rtol in (1e-4, 3e-5, 1e-5, 3e-6):
        simulator = scene.simulator(DT, rtol=rtol)
        off = np.linalg.norm(simulator.run(u, rest).fields(1)[:, 0, :3] - exact, axis=1).max() / LENGTH
        if off <= 7e-4:
            break
    name = f"plane, no tendons, rtol {rtol:.0e}"
    report.figure(name, _median_time(simulator, u, rest, 5), "ms per 0.03 s", ("<=", 0.3))
    report.figure(f"{name}, error", float(off), "L", ("<=", 7e-4))


def full_arm(report: Report, steps: int) -> None:
    """The paper's arm with shear and stretch, default nodes and tolerance, under the plan of ``commands``."""
    terms = scenes()["everything"].terms
    scene = rod.Scene(rod.Rod(LENGTH, SECTION, MATERIAL, "cosserat"), *terms)
    fine = scene.with_nodes(scene.nodes + 4)
    u = commands(scene, steps)
    simulator, rest = scene.simulator(DT), scene.statics().solve().state
    run, exact = simulator.run(u, rest), fine.simulator(DT, rtol=1e-7).run(u)
    off = np.linalg.norm(run.fields(1)[:, 0, :3] - exact.fields(1)[:, 0, :3], axis=1).max() / LENGTH
    name = f"full Cosserat arm, defaults (K={scene.nodes})"
    report.figure(name, _median_time(simulator, u, rest, 3), "ms per 0.03 s", ("<=", 8.0))
    report.figure(f"{name}, error", float(off), "L", ("<=", 1e-3))


def first_result(report: Report) -> None:
    """Imports, building the scene, its rest and one step in a new process; the least of three."""
    command = [sys.executable, "-c", FIRST_RESULT]
    done = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(3)]
    wall, cpu = np.array([[float(value) for value in text.split()] for text in done]).min(axis=0)
    report.figure("scene to first result, no compiler, CPU time", cpu, "s", ("<=", 1.5))
    report.figure("scene to first result, no compiler, wall clock", wall, "s")


def energy_drift(report: Report, quick: bool) -> None:
    """An undamped soft rod let go, in Gauss steps of 1 ms: energy over 10 s in parts of the kinetic swing."""
    span = 2.0 if quick else 10.0
    for strains in ("planar", "kirchhoff"):
        body = rod.Rod(0.5, rod.Circle(1e-2), rod.Elastic(1e6, 1e6 / 3.0, 1100.0), strains)
        scene = rod.Scene(body, rod.Gravity((-9.81, 0.0, 0.0 if strains == "planar" else 1.5)), nodes=4)
        size = body.stiffness[0] / body.length**2
        side = 0.0 if strains == "planar" else 0.8 * size
        stepper = scene.stepper(0.02, step=1e-3)
        held = (stepper.equations + rod.TipWrench((0.3 * size, side, 0.1 * size))).statics().solve()
        run = stepper.run(np.zeros((round(span / 0.02), 0)), held.state)
        stored = run.scene.energies(run.x)
        total, tenth, swing = stored.total, len(run.t) // 10, np.ptp(stored.kinetic)
        name = f"undamped {strains} rod, {span:g} s of 1 ms steps"
        report.figure(f"{name}, energy drift", float(np.abs(total - total[0]).max() / swing), "", ("<=", 1e-6))
        trend = float(abs(total[-tenth:].mean() - total[:tenth].mean()) / swing)
        report.figure(f"{name}, trend (last against first tenth)", trend, "")


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--compiled", action="store_true", help="also as machine code (minutes, the first time)")
    made.add_argument("--rtol", type=float, default=1e-4, help="relative tolerance of the timed runs")
    arguments = made.parse_args()
    steps, repeats = (40, 3) if arguments.quick else (200, 7)
    report = Report.of("cost of scenes", arguments)
    rows = {}
    for name, scene in tqdm(scenes().items(), desc="scenes", unit="scene"):
        rows[name] = measure(scene, steps, arguments.rtol, arguments.compiled, repeats)
        report.figure(name, rows[name]["vm"], "ms per 0.03 s")
        if arguments.compiled:
            report.figure(f"{name}, compiled", rows[name]["compiled"], "ms per 0.03 s")
        for kind in ("residual", "jacobian"):
            report.figure(f"{name}, {kind}", rows[name][kind], "instructions")
        report.figure(f"{name}, error", rows[name]["error"], "L")
    print(table(rows))
    print(f"everything costs {rows['everything']['vm'] / rows['plane']['vm']:.0f} times the plane rod without tendons")
    print("\n".join(paper_arm(report, arguments.compiled, arguments.quick, arguments.seed)))
    plane_rod(report, steps)
    full_arm(report, steps)
    first_result(report)
    energy_drift(report, arguments.quick)
    print(report)
    draw(rows, arguments.out / "benchmark_scenes.png")
    report.write(arguments.json)


if __name__ == "__main__":
    run(main)
