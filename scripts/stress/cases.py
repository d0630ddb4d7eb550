"""Cases that strain the rod, and what becomes of one of them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from stress.random_scenes import build, unloaded

Array = NDArray[np.float64]
Case = dict[str, Any]
LENGTH, DENSITY = 0.5, 1200.0
#: Nodes of the swept rods and of the arms; internal steps follow from the default tolerance.
NODES, ARM_NODES = 3, 4
#: Tolerance of the run that the error is measured against, and the internal steps beyond which there is none.
FINER, LONGEST = 1e-6, 20_000
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
    for strains in ("kirchhoff",) if quick else ("kirchhoff", "cosserat"):
        cases += [
            {"sweep": f"cold tip load, {strains}", "kind": "cold", "strains": strains, "load": load, "seed": int(k)}
            for load in ((1.0, 100.0, 300.0) if quick else (1.0, 10.0, 30.0, 100.0, 200.0, 300.0))
            for k in rng.integers(2**31, size=4 if quick else 20)
        ]
    return cases + [
        {"sweep": "random scenes", "kind": "random", "scene": scene} for scene in _random_scenes(quick, seed)
    ]


def _rods(strains: str, quick: bool) -> list[Case]:
    """Modulus by slenderness, and damping."""
    moduli = np.geomspace(1e4, 1e12, 3 if quick else 9).tolist()
    ratios = np.geomspace(1e-4, 0.1, 3 if quick else 7).tolist()
    dampings = [0.0, *np.geomspace(1e-4, 100.0, 3 if quick else 13).tolist()]
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
        arm | {"sweep": "control interval", "dt": dt} for dt in np.geomspace(1e-4, 0.3, 3 if quick else 9).tolist()
    ]
    cases += [
        arm | {"sweep": "tendon pull", "pattern": "ramp", "amplitude": a * 0.7144}
        for a in (np.linspace(0.05, 0.3, 2) if quick else np.linspace(0.02, 0.3, 15)).tolist()
    ]
    cases += [
        arm | {"sweep": "slack and taut in turn", "dt": dt, "pattern": "switch", "amplitude": a}
        for dt in ((0.03,) if quick else (0.003, 0.01, 0.03, 0.1))
        for a in ((0.01,) if quick else (0.003, 0.01, 0.03))
    ]
    cases += [
        arm | {"sweep": "damping", "pattern": "wave", "damping": factor}
        for factor in ((0.0, 100.0) if quick else (0.0, 1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0))
    ]
    cases += [
        arm | {"sweep": "damping, jumping pulls", "damping": factor}
        for factor in ((0.1, 100.0) if quick else (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0))
    ]
    loads = (100.0,) if quick else (1.0, 10.0, 30.0, 100.0, 200.0, 300.0)
    cases += [arm | {"sweep": "tip load", "pattern": "load", "load": load} for load in loads]
    cases += [
        {"sweep": "cold tip load", "kind": "arm at rest", "strains": strains, "load": load, "seed": k}
        for load in loads
        for k in range(2 if quick else 5)
    ]
    return [case | {"sweep": f"{ARMS[strains]}: {case['sweep']}"} for case in cases]


def _random_scenes(quick: bool, seed: int) -> list[Case]:
    try:
        from stress.scene_strategy import drawn
    except ModuleNotFoundError as error:
        if error.name != "hypothesis":
            raise
        raise ValueError("random scenes need hypothesis, which is not installed; pip install hypothesis") from None
    return drawn(12 if quick else 500, seed)


def work(case: Case) -> dict[str, Any]:
    """Run one case; ``outcome`` is ok, failed (a clean status), refused (one-line ValueError), nan or raised."""
    start = time.perf_counter()
    kinds = {"load": _load, "arm": _arm, "arm at rest": _arm_at_rest, "cold": _cold, "random": _random}
    try:
        found = kinds[case["kind"]](case)
    except ValueError as error:
        found = {"outcome": "refused" if "\n" not in str(error) else "raised", "message": str(error)[:200]}
    except Exception as error:
        found = {"outcome": "raised", "message": f"{type(error).__name__}: {str(error)[:200]}"}
    return found | {"seconds": time.perf_counter() - start}


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
    return _run(scene, 2.0 * np.pi / body.bending_rate / 20.0, np.outer(force, [0.8, 0.6, 0.0]))


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
        return _run(scene, case["dt"], u)
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
    return _run(arm_scene(case["strains"], case.get("damping", 1.0)), case["dt"], u)


def _arm_at_rest(case: Case) -> dict[str, Any]:
    """The arm with slack tendons under a dead tip force of ``load`` EI/L^2 in a random direction, cold."""
    scene = arm_scene(case["strains"])
    force = case["load"] * scene.rod.stiffness[0] / scene.rod.length**2 * _direction(case["seed"])
    return _equilibrium(scene + rod.TipWrench(force=tuple(force.tolist())), np.zeros(3))


def _cold(case: Case) -> dict[str, Any]:
    """A dead tip force of ``load`` EI/L^2 in a random direction, from the straight rod."""
    body = rod.Rod(LENGTH, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0), case["strains"])
    force = case["load"] * body.stiffness[0] / LENGTH**2 * _direction(case["seed"])
    return _equilibrium(rod.Scene(body, rod.TipWrench(force=tuple(force.tolist())), nodes=8), np.zeros(0))


def _direction(seed: int) -> Array:
    direction = np.random.default_rng(seed).standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction))


def _random(case: Case) -> dict[str, Any]:
    """An equilibrium under the first inputs, and a few steps from the unloaded rod, which is let go."""
    scene, dt, u = build(case["scene"])
    still = _equilibrium(scene, u[0])
    if still["outcome"] != "ok":
        return still
    return _run(scene, dt, u, unloaded(scene))


def _equilibrium(scene: rod.Scene, u: Array) -> dict[str, Any]:
    found = scene.statics().solve(u)
    if not np.all(np.isfinite(found.state)):
        return {"outcome": "nan", "message": found.message}
    outcome = "ok" if found.success else "failed"
    return {"outcome": outcome, "message": found.message, "error": found.residual, "steps": found.iterations}


def _run(scene: rod.Scene, dt: float, u: Array, start: Array | None = None) -> dict[str, Any]:
    """Simulate, from rest if not told otherwise; error in parts of L against a run at a tenth of the tolerance."""
    if start is None:
        rest = scene.statics().solve()
        if not rest.success:
            return {"outcome": "failed", "message": rest.message}
        start = rest.state
    run = scene.simulator(dt).run(u, start)
    if not np.all(np.isfinite(run.x)):
        return {"outcome": "nan", "message": "a state is not finite"}
    if not run.success:
        good = run.message.startswith("IDAS") and "\n" not in run.message
        return {"outcome": "failed" if good else "raised", "message": run.message, "steps": run.stats.get("nsteps")}
    tip = scene.fields(run.x, 1)[:, 0, :3]
    if not np.all(np.isfinite(tip)):
        return {"outcome": "nan", "message": "a field is not finite"}
    found = {"outcome": "ok", "message": "", "steps": run.stats["nsteps"] / len(u)}
    if run.stats["nsteps"] > LONGEST:
        return found
    finer = scene.simulator(dt, rtol=FINER).run(u, start)
    if finer.success:
        distance = np.linalg.norm(scene.fields(finer.x, 1)[:, 0, :3] - tip, axis=1)
        found["error"] = float(distance.max() / scene.rod.length)
    return found
