"""Scenes from short plain descriptions, in parts of natural sizes; ``scene_strategy`` draws such descriptions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod

Array = NDArray[np.float64]
Description = dict[str, Any]


def build(described: Description) -> tuple[rod.Scene, float, Array]:
    """The scene, the control interval in s and inputs (T, n_inputs) of a description."""
    body = _body(described)
    inputs: list[Array] = []  # sizes of the inputs of the terms so far
    terms = [_TERMS[t["term"]](t, body, inputs) for t in described["terms"]]
    scene = rod.Scene(body, *terms, nodes=described["nodes"])
    dt = described["interval"] * 2.0 * np.pi / body.bending_rate
    return scene, dt, _inputs(described, np.concatenate([np.zeros(0), *inputs]))


def unloaded(scene: rod.Scene) -> Array:
    """State of the unloaded rod at rest under zero inputs."""
    return scene.at_rest(scene.rest_coordinates, np.zeros(scene.n_inputs))


def _inputs(described: Description, size: Array) -> Array:
    """Inputs (T, n) that grow to their size, switch between a part of it and nothing, or are drawn for every step."""
    rng, step = np.random.default_rng(described["inputs"]), np.arange(1, int(described["steps"]) + 1)
    parts: dict[str, Array] = {
        "ramp": np.outer(step / step[-1], np.ones(size.size)),
        "switch": np.outer(step % 2, rng.uniform(0.0, 1.0, size.size)),
        "random": rng.uniform(0.0, 1.0, (step.size, size.size)),
    }
    return parts[described["pattern"]] * size


def _body(d: Description) -> rod.Rod:
    length, radius = d["length"], d["slenderness"] * d["length"]
    sections: dict[str, Any] = {
        "circle": rod.Circle(radius),
        "tube": rod.Tube(radius, 0.6 * radius),
        "tapered": rod.Tapered(rod.Circle(radius), rod.Circle(0.6 * radius)),
    }
    material = rod.Elastic(d["young"], d["young"] / 2.6, d["density"])
    curvature = (0.0, d["rest_curvature"] / length, 0.0)
    elements = (0.5 * length, 0.5 * length) if d["elements"] == 2 else ()
    return rod.Rod(length, sections[d["section"]], material, d["strains"], curvature, elements)


def _steepest(body: rod.Rod) -> float:
    """Acceleration in m/s^2 that loads the rod like a tip force of 3 EI/L^2, or that of gravity if that is less."""
    return float(min(9.81, 3.0 * body.stiffness[1] / (body.mass_per_length * body.length**3)))


def _force(body: rod.Rod, angle_deg: float) -> tuple[float, float, float]:
    """EI/L^2 in N, across the rod; along x in the plane."""
    size, angle = body.stiffness[1] / body.length**2, 0.0 if body.strain_set.planar else np.deg2rad(angle_deg)
    return size * np.cos(angle), size * np.sin(angle), 0.0


def _scaled(vector: tuple[float, float, float], factor: float) -> tuple[float, ...]:
    return tuple(factor * v for v in vector)


def _gravity(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.Gravity:
    return rod.Gravity((-_steepest(body), 0.0, 0.0))


def _damping(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.Retardation:
    """The first mode is damped by a fraction ``ratio`` of the critical."""
    return rod.Retardation(2.0 * t["ratio"] / body.bending_rate)


def _bending_damping(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.KelvinVoigt:
    """Nothing damps shear and stretch."""
    time = 2.0 * t["ratio"] / body.bending_rate
    return rod.KelvinVoigt(bending=time * body.stiffness[1], torsion=time * body.stiffness[2])


def _linear_drag(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.LinearDrag:
    return rod.LinearDrag(t["size"] * body.mass_per_length * body.bending_rate)


def _quadratic_drag(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.QuadraticDrag:
    return rod.QuadraticDrag(t["size"] * body.mass_per_length / body.length)


def _tip(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.TipWrench:
    return rod.TipWrench(force=_scaled(_force(body, t["angle_deg"]), t["size"]), follower=t["follower"])


def _tip_input(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.TipWrench:
    inputs.append(np.array(_scaled(_force(body, t["angle_deg"]), t["size"])))
    return rod.TipWrench(force=rod.Input("force", 3))


def _distributed(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.DistributedWrench:
    return rod.DistributedWrench(force=_scaled(_force(body, t["angle_deg"]), t["size"] / body.length))


def _mass(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.PointMass:
    return rod.PointMass(s=t["at"] * body.length, mass=t["size"] * body.mass_per_length * body.length)


def _points(body: rod.Rod, offset: float) -> list[tuple[float, float]]:
    if body.strain_set.planar:
        return [(offset, 0.0), (-offset, 0.0)]
    angles = np.deg2rad([0.0, 120.0, 240.0])
    return [(offset * float(np.cos(a)), offset * float(np.sin(a))) for a in angles]


def _tendons(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.Tendons:
    """Tension ``size`` EI/(L offset), or a pull of ``size`` offsets by tendons whose stiffness is that of the rod."""
    offset = t["offset"] * body.length
    tension = body.stiffness[1] / (body.length * offset)
    end = 0.5 * body.length if t["half"] and body.elements else None
    drive: rod.Displacement | rod.Tension = rod.Tension()
    if t["drive"] == "displacement":
        drive = rod.Displacement(t["compliance"] * offset / body.length / tension)
    points = _points(body, offset)
    inputs.append(np.full(len(points), t["size"] * (tension if t["drive"] == "tension" else offset)))
    if t["route"] == "helical" and not body.strain_set.planar:
        return rod.Tendons.helical(offset, 2.0 * body.length, (0, 120, 240), drive, end=end, friction=t["friction"])
    return rod.Tendons(points, drive, end=end, friction=t["friction"])


def _chambers(t: Description, body: rod.Rod, inputs: list[Array]) -> rod.Chambers:
    """Pressures that bend the rod by ``size`` / L."""
    offset = t["offset"] * body.length
    area = 0.2 * offset**2
    points = _points(body, offset)
    inputs.append(np.full(len(points), t["size"] * body.stiffness[1] / (body.length * area * offset)))
    return rod.Chambers(area, points)


_TERMS: dict[str, Any] = {
    "gravity": _gravity,
    "damping": _damping,
    "bending damping": _bending_damping,
    "linear drag": _linear_drag,
    "quadratic drag": _quadratic_drag,
    "tip force": _tip,
    "driven tip force": _tip_input,
    "distributed force": _distributed,
    "point mass": _mass,
    "tendons": _tendons,
    "chambers": _chambers,
}
