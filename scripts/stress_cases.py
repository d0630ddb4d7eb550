"""Cases that strain the rod, and what becomes of one of them."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod
from pisplit.models.tendon_arm import TendonArm

Array = NDArray[np.float64]
LENGTH, DENSITY = 0.5, 1200.0
#: Nodes of the swept rods; internal steps follow from the default tolerance.
NODES = 3


def sweeps(quick: bool, seed: int) -> list[dict[str, Any]]:
    """All cases as plain data."""
    rng = np.random.default_rng(seed)
    cases: list[dict[str, Any]] = []
    moduli = np.geomspace(1e4, 1e12, 3 if quick else 9).tolist()
    ratios = np.geomspace(1e-4, 0.1, 3 if quick else 7).tolist()
    for strains in ("cosserat", "kirchhoff"):
        cases += [
            {
                "sweep": f"stiffness, {strains}",
                "kind": "load",
                "strains": strains,
                "young": e,
                "ratio": r,
                "damping": 0.05,
            }
            for e in moduli
            for r in ratios
        ]
        cases += [
            {
                "sweep": f"damping, {strains}",
                "kind": "load",
                "strains": strains,
                "young": 1e7,
                "ratio": 0.01,
                "damping": d,
            }
            for d in [0.0, *np.geomspace(1e-4, 100.0, 3 if quick else 13).tolist()]
        ]
    cases += [
        {"sweep": "control interval", "kind": "arm", "dt": dt, "pattern": "random", "amplitude": 0.01}
        for dt in np.geomspace(1e-4, 0.3, 3 if quick else 9).tolist()
    ]
    cases += [
        {"sweep": "tendon pull", "kind": "arm", "dt": 0.03, "pattern": "ramp", "amplitude": a * 0.7144}
        for a in (np.linspace(0.05, 0.3, 2) if quick else np.linspace(0.02, 0.3, 15)).tolist()
    ]
    cases += [
        {"sweep": "slack and taut in turn", "kind": "arm", "dt": dt, "pattern": "switch", "amplitude": a}
        for dt in ((0.03,) if quick else (0.003, 0.01, 0.03, 0.1))
        for a in ((0.01,) if quick else (0.003, 0.01, 0.03))
    ]
    for strains in ("kirchhoff",) if quick else ("kirchhoff", "cosserat"):
        cases += [
            {"sweep": f"cold tip load, {strains}", "kind": "cold", "strains": strains, "load": load, "seed": int(k)}
            for load in ((1.0, 100.0, 300.0) if quick else (1.0, 10.0, 30.0, 100.0, 200.0, 300.0))
            for k in rng.integers(2**31, size=4 if quick else 20)
        ]
    cases += [
        {"sweep": "random scenes", "kind": "random", "seed": int(k)}
        for k in rng.integers(2**31, size=12 if quick else 500)
    ]
    return cases


def work(case: dict[str, Any]) -> dict[str, Any]:
    """Run one case; ``outcome`` is ok, failed (a clean status), refused (one-line ValueError), nan or raised."""
    start = time.perf_counter()
    try:
        found = {"load": _load, "arm": _arm, "cold": _cold, "random": _random}[case["kind"]](case)
    except ValueError as error:
        found = {"outcome": "refused" if "\n" not in str(error) else "raised", "message": str(error)[:200]}
    except Exception as error:
        found = {"outcome": "raised", "message": f"{type(error).__name__}: {str(error)[:200]}"}
    return found | {"seconds": time.perf_counter() - start}


def _load(case: dict[str, Any]) -> dict[str, Any]:
    """A tip load of F L^2/EI = 1 that grows over one natural period and stays for another."""
    radius = case["ratio"] * LENGTH
    material = rod.Elastic(case["young"], case["young"] / 3.0, DENSITY)
    body = rod.Rod(LENGTH, rod.Circle(radius), material, case["strains"])
    section = rod.Circle(radius)
    bending = case["young"] * section.second_moments[0]
    relative = 2.0 * case["damping"] / body.bending_rate  # s: Kelvin-Voigt damping is this times the stiffness
    axial = relative * case["young"] * section.area
    terms: list[Any] = [rod.TipWrench(force=rod.Input("force", 3))]
    if relative:
        terms.append(rod.KelvinVoigt(relative * bending, relative * bending, axial / 3.0, axial))
    scene = rod.Scene(body, *terms, nodes=NODES)
    force = bending / LENGTH**2 * np.minimum(1.0, np.arange(1, 41) / 20.0)
    return _run(scene, 2.0 * np.pi / body.bending_rate / 20.0, np.outer(force, [0.8, 0.6, 0.0]))


def _arm(case: dict[str, Any]) -> dict[str, Any]:
    """The paper's arm under random, ramped or switching pulls."""
    arm = TendonArm.paper(nodes=4)
    steps, a = 20, case["amplitude"]
    if case["pattern"] == "random":
        u = arm.pretension + a * np.random.default_rng(1).uniform(-1.0, 1.0, (steps, 2)) @ arm.differential_basis.T
    elif case["pattern"] == "ramp":
        u = np.outer(np.arange(1, steps + 1) / steps, [a, 0.0, 0.0])
    else:
        u = np.where(np.arange(steps)[:, None] % 2 == 0, a, -a) * np.ones(3)
    return _run(arm.scene, case["dt"], u)


def _cold(case: dict[str, Any]) -> dict[str, Any]:
    """A dead tip force of ``load`` EI/L^2 in a random direction, from the straight rod."""
    body = rod.Rod(LENGTH, rod.Circle(1e-3), rod.Elastic(207e9, 207e9 / 2.6, 8000.0), case["strains"])
    direction = np.random.default_rng(case["seed"]).standard_normal(3)
    bending = 207e9 * rod.Circle(1e-3).second_moments[0]
    force = case["load"] * bending / LENGTH**2 * direction / np.linalg.norm(direction)
    scene = rod.Scene(body, rod.TipWrench(force=tuple(force.tolist())), nodes=8)
    return _equilibrium(scene, np.zeros(0))


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
    finer = scene.simulator(dt, rtol=1e-5).run(u, start)
    if finer.success:
        distance = np.linalg.norm(scene.fields(finer.x, 1)[:, 0, :3] - tip, axis=1)
        found["error"] = float(distance.max() / scene.rod.length)
    return found


def _random(case: dict[str, Any]) -> dict[str, Any]:
    """Any rod, terms and inputs within reason: an equilibrium under its inputs, and ten steps after release."""
    rng = np.random.default_rng(case["seed"])

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    length, young, density = log(0.05, 2.0), log(1e5, 4e11), log(500.0, 9000.0)
    radius = length * log(1e-3, 0.05)
    section = rod.Circle(radius)
    strains = str(rng.choice(["planar", "kirchhoff", "cosserat"], p=[0.3, 0.45, 0.25]))
    body = rod.Rod(length, section, rod.Elastic(young, young / rng.uniform(2.0, 3.0), density), strains)
    bending, weight = young * section.second_moments[0], density * section.area
    relative = 2.0 * log(1e-3, 3.0) / body.bending_rate
    axial = relative * young * section.area
    steepest = 3.0 * bending / (weight * length**3)  # gravity that loads the rod like a tip force of 3 EI/L^2
    offset = radius + length * log(0.003, 0.03)
    points = [(offset, 0.0), (-offset, 0.0)]
    if strains != "planar":
        points = [(offset, 0.0), (-offset, offset), (0.0, -offset)]
    tension = log(0.1, 3.0) * bending / (length * offset)
    drive = rod.Displacement(0.05 * log(0.1, 10.0) * offset / length / tension) if rng.random() < 0.5 else rod.Tension()
    every: list[Any] = [
        rod.Gravity((-min(9.81, steepest), 0.0, 0.0)),
        rod.KelvinVoigt(relative * bending, relative * bending, axial / 3.0, axial),
        rod.QuadraticDrag(log(1e-3, 10.0) * radius),
        rod.LinearDrag(log(1e-3, 1.0) * weight * body.bending_rate),
        rod.TipWrench(force=(log(0.01, 3.0) * bending / length**2, 0.0, 0.0), follower=bool(rng.random() < 0.3)),
        rod.Tendons(points, drive),
    ]
    terms = [term for term in every if rng.random() < 0.6]
    scene = rod.Scene(body, *terms, nodes=int(rng.integers(2, 5)))
    reach = tension if isinstance(drive, rod.Tension) else offset * log(0.1, 2.0)
    u = reach * rng.uniform(0.0, 1.0, (11, scene.n_inputs))
    still = _equilibrium(scene, u[0])
    if still["outcome"] != "ok":
        return still
    straight = np.zeros(scene.n_states)
    if strains == "cosserat":
        straight[: scene.n_strains].reshape(-1, 6)[:, 5] = 1.0
    return _run(scene, log(0.01, 0.5) * 2.0 * np.pi / body.bending_rate, u[1:], straight)
