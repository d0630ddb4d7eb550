"""Cantilever, catenary, pendulum and twist of cosseratbench (0.3), an independent suite, beside its own solvers.

``pip install pisplit[bench]``; MuJoCo (``mujoco<4``) joins where it is installed. Every solver runs every experiment
with its defaults in this process, timed after what is compiled or built once (machine code of theirs, our scene); the
errors are those that the suite measures against its references. Who cannot run an experiment is said to be unable to.

``PisplitSolver`` is an adapter as the suite wants it. To have its own command find it, declare it in any package that
has ``scripts/`` on its path:

    [project.entry-points."cosseratbench.solvers"]
    pisplit = "benchmarks.cosseratbench_plugin:PisplitSolver"
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the other rooms of scripts/

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from benchmarks.cosseratbench_driven import driven
from benchmarks.cosseratbench_swing import swinging
from common.report import Report, parser, run
from pisplit.models import rod

Array = NDArray[np.float64]
#: Experiments of the suite; the first two take seconds, the twist minutes.
EXPERIMENTS = ("cantilever", "catenary", "pendulum", "twist")
#: Gauss nodes of the rod at rest.
NODES = 12
#: Errors that the references of the suite allow (linear theory, no bending stiffness, finite amplitude), by metric.
TARGETS = {"tip_deflection_error": 6e-4, "shape_error": 6e-4, "period_error": 2.5e-5, "critical_twist_error": 5e-3}


class PisplitSolver:
    """Adapter of the suite for equilibria of one rod in the x-z plane, clamped or pinned, driven and swinging rods.

    Quasi-static scenarios are answered by their equilibrium from the second frame on. A pin at the start is a clamp
    that is turned until it bears no moment. Rods with a driven end, any number that do not touch, move (see
    ``cosseratbench_driven``), and so do those that hang from a pin (``cosseratbench_swing``).
    """

    name = "pisplit"

    def __init__(self) -> None:
        from cosseratbench.solver import Capability

        self.capabilities = frozenset({Capability.STRETCH, Capability.SHEAR})

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Any:
        """The trajectory of ``scenario`` at ``n_elements`` + 1 points of its rod, in ``n_frames`` frames.

        Raises NotImplementedError for what the adapter does not do.
        """
        from cosseratbench.trajectory import Trajectory

        if scenario.obstacles:
            raise NotImplementedError("obstacles")
        times = np.linspace(0.0, scenario.duration, n_frames)
        if not scenario.quasi_static:
            swung = [swinging(spec, scenario, times, n_elements) for spec in scenario.rods]
            return Trajectory(times, *(tuple(part) for part in zip(*swung, strict=True)))
        if all(spec.end_motion for spec in scenario.rods):
            moved = [driven(spec, scenario, times, n_elements) for spec in scenario.rods]
            return Trajectory(times, *(tuple(part) for part in zip(*moved, strict=True)))
        if len(scenario.rods) != 1:
            raise NotImplementedError("several rods, unless each is driven")
        (spec,) = scenario.rods
        if np.any(np.array(spec.centerline)[:, 1]) or spec.start_motion:
            raise NotImplementedError("rods out of the x-z plane, or a driven start")
        if spec.start.value == "free" or spec.end.value == "clamped":
            raise NotImplementedError("a free start or a clamped end")
        positions, directors = _equilibrium(spec, scenario.gravity, n_elements)
        all_positions = np.concatenate([spec.nodes(n_elements)[None], np.tile(positions, (n_frames - 1, 1, 1))])
        all_directors = np.concatenate([spec.directors(n_elements)[None], np.tile(directors, (n_frames - 1, 1, 1))])
        return Trajectory(times, (all_positions,), (all_directors,))


@cache
def _scene(spec: Any, gravity: tuple[float, float, float]) -> rod.Scene:
    """A rod of the suite on a clamp that can be turned; made once, as what the others compile is."""
    material = spec.material
    elastic = rod.Elastic(material.youngs_modulus, material.shear_modulus, material.density)
    body = rod.Rod(spec.length, rod.Circle(spec.radius, shear_factor=27.0 / 28.0), elastic, "planar-cosserat")
    loads = [rod.TipWrench(force=tuple(load.force)) for load in spec.loads if load.at.value == "end"]
    return rod.Scene(body, rod.Gravity(tuple(gravity)), rod.Base(rotation=rod.Input("turn", 3)), *loads, nodes=NODES)


def _equilibrium(spec: Any, gravity: tuple[float, float, float], elements: int) -> tuple[Array, Array]:
    """Positions (n + 1, 3) and directors (n, 3) at rest of a rod of the suite."""
    origin, scene = np.asarray(spec.centerline[0], dtype=float), _scene(spec, gravity)
    statics, reach = scene.statics(), np.asarray(spec.centerline[-1]) - origin
    chord = np.subtract(spec.centerline[1], origin)

    def held(angle: float, guess: Array | None) -> Any:
        u = np.array([0.0, angle, 0.0])
        found = statics.pin_tip(reach, u, guess) if spec.end.value == "pinned" else statics.solve(u)
        if not found.success:
            raise RuntimeError(found.message)
        return found

    angle = float(np.arctan2(chord[0], chord[2]))
    found = held(angle, None)
    if spec.start.value == "pinned":
        last: list[Array] = [found.state]

        def moment(turn: float) -> float:
            last[0] = held(turn, last[0]).state
            return float(scene.fields(last[0], [0.0])[0, 16])

        step = 0.2 * np.sign(moment(angle))  # a clamp that is turned along with the moment bears less of it
        while moment(angle + step) * step > 0.0:
            angle += step
            if abs(angle) > 10.0:
                raise RuntimeError("no angle of the pinned start bears no moment")
        angle = brentq(moment, angle, angle + step, xtol=1e-12)
        found = held(angle, last[0])
        if abs(moment(angle)) > 1e-6 / spec.length:
            raise RuntimeError("the moment of the pinned start jumps: there are two shapes")
    points = spec.length * np.linspace(0.0, 1.0, elements + 1)
    middles = 0.5 * (points[1:] + points[:-1])
    positions = scene.fields(found.state, points)[:, :3] + origin
    turned = scene.fields(found.state, middles)[:, 3:12].reshape(-1, 3, 3)
    straight = Rotation.from_euler("y", np.arctan2(chord[0], chord[2])).as_matrix()
    return positions, turned @ straight.T @ spec.directors(elements)[0]


def main() -> None:
    made = parser(__doc__ or "")
    made.add_argument("--only", choices=EXPERIMENTS, help="one experiment")
    arguments = made.parse_args()
    try:
        from cosseratbench import registry
        from cosseratbench.experiment import run as measured
    except ModuleNotFoundError:
        raise ValueError("cosseratbench is not installed; pip install pisplit[bench]") from None
    report = Report.of("cosseratbench", arguments)
    names = (arguments.only,) if arguments.only else EXPERIMENTS[:2] if arguments.quick else EXPERIMENTS
    for experiment in (registry.load_experiment(name) for name in tqdm(names, desc="cosseratbench", unit="experiment")):
        for solver in _solvers(registry):
            missing = _run(measured, experiment, solver, report)
            if missing:
                tqdm.write(f"{experiment.name}, {solver.name}: {missing}")
    print(report)
    report.write(arguments.json)


def _solvers(registry: Any) -> list[Any]:
    """Ours, and those of the suite whose backends are installed."""
    found: list[Any] = [PisplitSolver()]
    for name in ("pyelastica", "mujoco"):
        try:
            found.append(registry.load_solver(name))
        except ImportError:
            tqdm.write(f"{name} is not installed and left out")
    return found


def _run(measured: Any, experiment: Any, solver: Any, report: Report) -> str:
    """Record errors and CPU time of a solver; what it does not do."""
    scenario = experiment.scenario_for()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:  # what is compiled once is left out
            solver.run(
                replace(scenario, duration=1e-3 * scenario.duration), n_elements=experiment.n_elements, n_frames=2
            )
            before = time.process_time()
            result = measured(experiment, solver)
        except (RuntimeError, ValueError, NotImplementedError) as error:
            return " ".join(str(error).split())
    spent = time.process_time() - before
    if result.trajectory is None:
        return f"{result.outcome}: {', '.join(result.missing) or result.failure}"
    for name, value in result.metrics.items():
        if name in TARGETS:
            target = ("<=", TARGETS[name]) if solver.name == "pisplit" else None
            report.figure(f"{experiment.name}, {solver.name}: {name}", value, "", target)
    report.figure(f"{experiment.name}, {solver.name}: CPU time", spent, "s")
    return ""


if __name__ == "__main__":
    run(main)
