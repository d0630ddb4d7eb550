"""Cases that strain the rod, and what becomes of one of them."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.dynamics.motion_error import motion_error
from pisplit.models.rod.dynamics.trajectory import Trajectory
from stress import equilibria
from stress.random_scenes import build, unloaded

Array = NDArray[np.float64]
Case = dict[str, Any]
LENGTH, DENSITY = 0.5, 1200.0
#: Nodes of the swept rods and of the arms; internal steps follow from the default tolerance.
NODES, ARM_NODES = 5, 4
#: Internal steps of a run beyond which it is not moved once more on a finer grid.
LONGEST = 20_000
#: Names of the two arms: the paper's, and the same backbone with shear and stretch free and damped.
ARMS = {"kirchhoff": "arm", "cosserat": "full arm"}


def sweeps(quick: bool, seed: int) -> list[Case]:
    """All cases as plain data. Raises ValueError without hypothesis."""
    rng = np.random.default_rng(seed)
    cases: list[Case] = []
    for strains in ("cosserat", "kirchhoff"):
        cases += _rods(strains, quick)
    for strains in ARMS:
        cases += _arms(strains, quick)
    cases += equilibria.cases(quick, rng)
    return cases + [
        {"sweep": "random scenes", "kind": "random", "scene": scene} for scene in _random_scenes(quick, seed)
    ]


def _rods(strains: str, quick: bool) -> list[Case]:
    """Modulus by slenderness, and damping."""
    moduli = np.geomspace(1e4, 1e12, 2 if quick else 5).tolist()
    ratios = np.geomspace(1e-4, 0.1, 2 if quick else 4).tolist()
    dampings = [0.0, *np.geomspace(1e-4, 100.0, 1 if quick else 7).tolist()]
    rod_of: Case = {"kind": "load", "strains": strains}
    return [
        {"sweep": f"stiffness, {strains}", **rod_of, "young": e, "ratio": r, "damping": 0.05}
        for e in moduli
        for r in ratios
    ] + [
        {"sweep": f"damping, {strains}", **rod_of, "young": 1e7, "ratio": 0.01, "damping": damping}
        for damping in dampings
    ]


def _arms(strains: str, quick: bool) -> list[Case]:
    """Every stress of one arm: control interval, pulls, switching, damping, tip loads in motion and cold."""
    arm: Case = {"kind": "arm", "strains": strains, "dt": 0.03, "pattern": "random", "amplitude": 0.01}
    cases: list[Case] = [
        arm | {"sweep": "control interval", "dt": dt} for dt in np.geomspace(1e-4, 0.3, 1 if quick else 5).tolist()
    ]
    cases += [
        arm | {"sweep": "tendon pull", "pattern": "ramp", "amplitude": a * 0.7144}
        for a in (np.linspace(0.3, 0.3, 1) if quick else np.linspace(0.02, 0.3, 6)).tolist()
    ]
    cases += [
        arm | {"sweep": "slack and taut in turn", "dt": dt, "pattern": "switch", "amplitude": a}
        for dt in ((0.03,) if quick else (0.01, 0.1))
        for a in ((0.01,) if quick else (0.003, 0.03))
    ]
    cases += [
        arm | {"sweep": "damping", "pattern": "wave", "damping": factor}
        for factor in ((1.0,) if quick else (0.0, 1e-2, 0.3, 3.0, 100.0))
    ]
    cases += [
        arm | {"sweep": "damping, jumping pulls", "damping": factor}
        for factor in ((1.0,) if quick else (0.0, 1e-2, 1.0, 100.0))
    ]
    loads = (100.0,) if quick else (1.0, 30.0, 100.0, 300.0)
    cases += [arm | {"sweep": "tip load", "pattern": "load", "load": load} for load in loads]
    cases += [
        {"sweep": "cold tip load", "kind": "arm at rest", "strains": strains, "load": load, "seed": k}
        for load in loads
        for k in range(1 if quick else 2)
    ]
    return [case | {"sweep": f"{ARMS[strains]}: {case['sweep']}"} for case in cases]


def _random_scenes(quick: bool, seed: int) -> list[Case]:
    try:
        from stress.scene_strategy import drawn
    except ModuleNotFoundError as error:
        if error.name != "hypothesis":
            raise
        raise ValueError("random scenes need hypothesis, which is not installed; pip install hypothesis") from None
    return drawn(6 if quick else 120, seed)


def work(case: Case) -> dict[str, Any]:
    """Run one case.

    ``outcome`` is ok, flagged, unjudged (no truth is to be had), failed (a clean status), refused (one-line
    ValueError), wrong, nan or raised.
    """
    start = time.process_time()
    kinds = {"load": _load, "arm": _arm, "arm at rest": _arm_at_rest, "random": _random}
    kinds |= {"dead truth": equilibria.dead, "arm truth": equilibria.arm}
    try:
        found = kinds[case["kind"]](case)
    except ValueError as error:
        found = {"outcome": "refused" if "\n" not in str(error) else "raised", "message": str(error)[:200]}
    except Exception as error:
        found = {"outcome": "raised", "message": f"{type(error).__name__}: {str(error)[:200]}"}
    return found | {"seconds": time.process_time() - start}


def _load(case: Case) -> dict[str, Any]:
    """A tip load of F L^2/EI = 1 that grows over one natural period and stays for another."""
    radius = case["ratio"] * LENGTH
    material = rod.Elastic(case["young"], case["young"] / 3.0, DENSITY)
    body = rod.Rod(LENGTH, rod.Circle(radius), material, case["strains"])
    terms: list[Any] = [rod.TipWrench(force=rod.Input("force", 3))]
    if case["damping"]:
        terms.append(rod.Retardation(2.0 * case["damping"] / body.bending_rate))
    scene = rod.Scene(body, *terms, nodes=NODES)
    force = body.stiffness[0] / LENGTH**2 * np.minimum(1.0, np.arange(1, 41) / 20.0)
    return _run(scene, 2.0 * np.pi / body.bending_rate / 20.0, np.outer(force, [0.8, 0.6, 0.0]), case)


def arm_scene(strains: str, damping: float = 1.0, *terms: Any) -> rod.Scene:
    """The paper's arm; with ``"cosserat"`` shear and stretch are free and damped like the rest (5 and 50 N s)."""
    scene = TendonArm.paper(nodes=ARM_NODES).scene
    body = rod.Rod(scene.rod.length, scene.rod.section, scene.rod.material, strains)
    kept = [term for term in scene.terms if not isinstance(term, rod.KelvinVoigt)]
    if damping:
        kept.append(rod.KelvinVoigt(5e-4 * damping, 5e-4 * damping, 5.0 * damping, 50.0 * damping))
    return rod.Scene(body, *kept, *terms, nodes=ARM_NODES)


def _arm(case: Case) -> dict[str, Any]:
    """The arm under smooth, random, ramped or switching pulls, or under a tip load that grows to ``load`` EI/L^2."""
    steps, a = 20, case["amplitude"]
    if case["pattern"] == "load":
        scene = arm_scene(case["strains"], 1.0, rod.TipWrench(force=rod.Input("force", 3)))
        force = case["load"] * scene.rod.stiffness[0] / scene.rod.length**2
        u = np.outer(np.minimum(1.0, np.arange(1, steps + 1) / 10.0), [0.0, 0.0, 0.0, 0.0, 0.8 * force, 0.6 * force])
        return _run(scene, case["dt"], u, case)
    arm = TendonArm.paper(nodes=ARM_NODES)
    if case["pattern"] == "wave":
        t = case["dt"] * np.arange(1, steps + 1)
        u = arm.pretension + a * np.stack([np.sin(4.0 * t), np.sin(6.0 * t)], axis=1) @ arm.differential_basis.T
    elif case["pattern"] == "random":
        u = arm.pretension + a * np.random.default_rng(1).uniform(-1.0, 1.0, (steps, 2)) @ arm.differential_basis.T
    elif case["pattern"] == "ramp":
        u = np.outer(np.arange(1, steps + 1) / steps, [a, 0.0, 0.0])
    else:
        u = np.where(np.arange(steps)[:, None] % 2 == 0, a, -a) * np.ones(3)
    return _run(arm_scene(case["strains"], case.get("damping", 1.0)), case["dt"], u, case)


def _arm_at_rest(case: Case) -> dict[str, Any]:
    """The arm with slack tendons under a dead tip force of ``load`` EI/L^2 in a random direction, cold."""
    scene = arm_scene(case["strains"])
    force = case["load"] * scene.rod.stiffness[0] / scene.rod.length**2 * _direction(case["seed"])
    return equilibria.beside_path(scene + rod.TipWrench(force=tuple(force.tolist())), np.zeros(3), case)


def _direction(seed: int) -> Array:
    direction = np.random.default_rng(seed).standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def _random(case: Case) -> dict[str, Any]:
    """An equilibrium under the first inputs, and a few steps from the unloaded rod, which is let go."""
    scene, dt, u = build(case["scene"])
    still = equilibria.beside_path(scene, u[0], case)
    if still["outcome"] != "ok":
        return still
    return _run(scene, dt, u, case, unloaded(scene))


def _run(scene: rod.Scene, dt: float, u: Array, case: Case, start: Array | None = None) -> dict[str, Any]:
    """Simulate, from rest if not told otherwise; error along the rod in parts of the travel.

    The truth is the motion on two more nodes an element at a tenth of the tolerance. What was flagged cannot be wrong
    without a word: its truth is worth one call, for the share that is flagged though right. The motion is larger by
    the ``"spoil"`` of a case than it was computed, relative: a wrong answer, which the judge must not let pass.
    """
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", rod.Unresolved)
        if start is None:
            rest = scene.statics().solve()
            if not rest.success:
                return {"outcome": "failed", "message": rest.message}
            start = rest.state
        simulator = scene.simulator(dt)
        run = simulator.run(u, start)
    told = "; ".join(str(w.message) for w in said if issubclass(w.category, rod.Unresolved))
    if not np.all(np.isfinite(run.x)) or not np.all(np.isfinite(run.fields(1))):
        return {"outcome": "nan", "message": "a state or a field is not finite"}
    if not run.success:
        good = run.message.startswith("IDAS") and "\n" not in run.message
        return {"outcome": "failed" if good else "raised", "message": run.message, "steps": run.stats.get("nsteps")}
    found = {"message": told[:200], "steps": run.stats["nsteps"] / len(u)}
    true = _true_motion(simulator, run, once=bool(told)) if run.stats["nsteps"] <= LONGEST else None
    if true is None:
        return found | {"outcome": "flagged" if told else "unjudged"}
    strains = scene.layout.strains
    run.x[:, strains] += case.get("spoil", 0.0) * (run.x[:, strains] - run.x[0, strains])
    error = motion_error(run, true)
    found["error"] = float(error.drift.max()) / max(error.travel, 1e-300)
    if error.first_above(equilibria.ALLOWED, 1e-7 * scene.rod.length) is not None and not told:
        message = f"off by {found['error']:.1e} of the travel without a word"
        return found | {"outcome": "wrong", "message": message}
    return found | {"outcome": "flagged" if told else "ok"}


def _true_motion(simulator: Any, run: Trajectory, once: bool) -> Trajectory | None:
    """The motion of ``run`` on two more nodes an element at a tenth of the tolerance, None where it is not to be had.

    By one call of IDAS alone if told to do it ``once``, else interval by interval where that fails.
    """
    start = simulator.resolution.on_finer(run.x[0])
    if not once:
        finer = simulator.finer.run(run.u, start, check=False)
        return finer if finer.success else None
    try:
        states, stats = simulator.finer.integrate(start, run.u)
    except RuntimeError:
        return None
    x = np.vstack([start, np.hstack([states, run.u])])
    return Trajectory(run.t, x, run.u, True, "", stats, simulator.finer.equations)
