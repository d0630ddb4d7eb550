"""Equilibria whose truth is known by another way: sagging rods, dead tip loads, arms with tendons under load."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod
from stress.elastica import POINTS, PlaneElastica, followed

Array = NDArray[np.float64]
Case = dict[str, Any]
LENGTH, RADIUS, YOUNG, DENSITY = 1.0, 0.01, 1e6, 1000.0
#: Distance from the truth along the rod, in parts of the length, from which on a result is wrong.
ALLOWED = 1e-3
SETS = ("planar", "kirchhoff", "extensible", "cosserat")
#: Nodes beyond those of a case on which arms are followed.
MORE = 4


def cases(quick: bool, rng: np.random.Generator) -> list[Case]:
    """Sagging rods, dead tip loads and arms as plain data."""
    sags, tips, arms = (24, 40, 4) if quick else (560, 1200, 100)
    nodes = (4, 6) if quick else tuple(range(4, 11))
    found = [_dead("sag", k, nodes, rng, auto=k % 20 == 2) for k in range(sags)]
    found += [_dead("tip load", k, nodes, rng) for k in range(tips)]
    found += [
        {
            "sweep": "truth: arm with tendons",
            "kind": "arm truth",
            "nodes": int(rng.integers(4, 9)),
            "tip": _logarithmic(rng, 0.3, 30.0) if k % 2 else 0.0,
            "weight": _logarithmic(rng, 1.0, 100.0),
            "pull": (rng.uniform(0.0, 4.0, 3) * (rng.random(3) < 0.6) if k % 3 else np.zeros(3)).tolist(),
            "drive": ("tension", "displacement")[k // 2 % 2],
            "direction": _direction(rng),
            "sideways": _direction(rng),
        }
        for k in range(arms)
    ]
    # Rods of one kind share a scene in a worker.
    return sorted(found, key=lambda c: (c["sweep"], c.get("strains", c.get("drive", "")), str(c["nodes"])))


def _dead(kind: str, k: int, nodes: tuple[int, ...], rng: np.random.Generator, auto: bool = False) -> Case:
    """A dead load in one of four kinds of directions: any, across, skewed, and almost or exactly against the rod."""
    direction = np.array(_direction(rng))
    if k % 4 == 1:
        direction[2] = 0.0
    elif k % 4 == 3:
        direction = np.array([0.0, 0.0, -1.0]) + (0.0 if k % 16 == 3 else rng.uniform(0.01, 0.2)) * direction
    direction /= np.linalg.norm(direction)
    return {
        "sweep": f"truth: {kind}",
        "kind": "dead truth",
        "load": _logarithmic(rng, 1.0, 300.0),
        "strains": SETS[k // 4 % 4],
        "nodes": "auto" if auto else int(rng.choice(nodes)),
        "direction": direction.tolist(),
    }


def _direction(rng: np.random.Generator) -> list[float]:
    direction = rng.normal(size=3)
    found: list[float] = (direction / np.linalg.norm(direction)).tolist()
    return found


def _logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


# Dead loads ----------------------------------------------------------------------------------------------------------


@cache
def _body(strains: str) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(RADIUS), rod.Elastic(YOUNG, YOUNG / 3.0, DENSITY), strains)


@cache
def _scene(kind: str, strains: str, nodes: int) -> rod.Scene:
    load: Any = rod.Gravity(rod.Input("load", 3)) if kind == "sag" else rod.TipWrench(force=rod.Input("load", 3))
    return rod.Scene(_body(strains), load, nodes=nodes)


def dead(case: Case) -> dict[str, Any]:
    """A sagging or loaded rod beside the plane elastica."""
    kind, strains = case["sweep"].split(": ")[1], case["strains"]
    body, direction = _body(strains), np.array(case["direction"])
    if strains == "planar":
        direction = np.array([np.hypot(direction[0], direction[1]), 0.0, direction[2]])
    across = np.hypot(direction[0], direction[1])
    stiffness, stretchy, sheared = body.stiffness[1], "extensible cosserat", "cosserat"
    elastica = PlaneElastica(
        stretch=stiffness / (body.stiffness[5] * LENGTH**2) if strains in stretchy else 0.0,
        shear=stiffness / (body.stiffness[3] * LENGTH**2) if strains == sheared else 0.0,
    )
    load, none = case["load"] * np.array([across, direction[2]]), np.zeros(2)
    push = np.array([0.02 * case["load"], 0.0]) if across == 0.0 else None  # a straight one buckles where it is pushed
    true = elastica.shape(none, load, push) if kind == "sag" else elastica.shape(load, none, push)
    force = case["load"] * stiffness / LENGTH**2 * direction
    u = force / (body.mass_per_length * LENGTH) if kind == "sag" else force
    if case["nodes"] == "auto":
        gravity = rod.Gravity((float(u[0]), float(u[1]), float(u[2])))
        scene, u = rod.Scene(body, gravity, nodes="auto"), np.zeros(0)
    else:
        scene = _scene(kind, strains, case["nodes"])
    shape, told = _solved(scene, u, case)
    # In the plane of load and axis; which plane that is is open where the load is along the axis.
    seen = shape[np.abs(true[:, 0]).argmax(), :2] * np.sign(true[np.abs(true[:, 0]).argmax(), 0])
    axis = direction[:2] / across if across > 0.0 else seen / max(float(np.linalg.norm(seen)), 1e-12)
    expected = np.column_stack([np.outer(true[:, 0], axis), true[:, 1]])
    return judged(float(np.linalg.norm(shape - expected * LENGTH, axis=1).max()) / LENGTH, told)


def _solved(scene: rod.Scene, u: Array, case: Case) -> tuple[Array, str]:
    """Shape (20, 3) of the equilibrium, and what was said against it; bent aside by the ``"spoil"`` of a case.

    In parts of the length at the tip: a wrong answer, which the judge must not let pass.
    """
    statics = scene.statics()
    statics.resolution.checked = -1.0  # a scene of its own for every case
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", rod.Unresolved)
        found = statics.solve(u)
    told = [str(w.message) for w in said if issubclass(w.category, rod.Unresolved)]
    if not found.success or found.branch == "snapped":
        told.append(found.message)
    points = scene.rod.length * np.arange(1, POINTS + 1) / POINTS
    shape = scene.fields(found.state, points)[:, :3]
    shape[:, 0] += case.get("spoil", 0.0) * scene.rod.length * (points / scene.rod.length) ** 2
    return shape, "; ".join(told)


def judged(distance: float, told: str) -> dict[str, Any]:
    """``distance`` from the truth in parts of the length: right, flagged (whatever it is), or wrong without a word."""
    outcome = "flagged" if told else "ok" if distance <= ALLOWED else "wrong"
    return {"outcome": outcome, "message": told[:200] or f"off by {distance:.1e} L without a word", "error": distance}


# Arms ----------------------------------------------------------------------------------------------------------------


@cache
def _arm(nodes: int, drive: str) -> rod.Scene:
    """A silicone arm whose weight and tip force are inputs, with three tendons."""
    body = rod.Rod(0.3, rod.Circle(5e-3), rod.Elastic(5e5, 5e5 / 2.9, 1070.0))
    pull: Any = rod.Tension() if drive == "tension" else rod.Displacement(0.05)
    loads = rod.Gravity(rod.Input("gravity", 3)), rod.TipWrench(force=rod.Input("force", 3))
    return rod.Scene(body, *loads, rod.Tendons.parallel(4e-3, (0, 120, 240), drive=pull), nodes=nodes)


def arm(case: Case) -> dict[str, Any]:
    """A silicone arm with idle or pulled tendons under its weight and a tip load, beside a fine path on more nodes."""
    scene = _arm(case["nodes"], case["drive"])
    body, stiffness = scene.rod, scene.rod.stiffness[1]
    weight = case["weight"] * stiffness / (body.mass_per_length * body.length**3) * np.array(case["direction"])
    force = case["tip"] * stiffness / body.length**2 * np.array(case["sideways"])
    pull = np.array(case["pull"]) * (stiffness / (body.length * 4e-3) if case["drive"] == "tension" else 4e-3)
    return beside_path(scene, np.concatenate([weight, force, pull]), case)


@cache
def _finer(scene: rod.Scene) -> rod.Scene:
    return scene.with_nodes([k + MORE for k in scene.element_nodes])


def beside_path(scene: rod.Scene, u: Array, case: Case) -> dict[str, Any]:
    """The equilibrium of any scene under inputs ``u`` beside the fine path on more nodes."""
    shape, told = _solved(scene, u, case)
    finer = _finer(scene)
    state, part = followed(finer, u)
    if state is None:  # the path ends: there is no truth to be had but that it does
        outcome, lost = "flagged" if told else "wrong", f"stability is lost at {part:.2f} of the load, without a word"
        return {"outcome": outcome, "message": told[:200] or lost}
    points = scene.rod.length * np.arange(1, POINTS + 1) / POINTS
    true = finer.fields(state, points)[:, :3]
    return judged(float(np.linalg.norm(shape - true, axis=1).max()) / scene.rod.length, told)
