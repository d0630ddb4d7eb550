"""Rods of cosseratbench that hang from a pin and swing in the x-z plane, without damping.

They bend and stretch (the references of the suite know no shear), on a base with a hinge, in Gauss steps, which keep
their energy.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pisplit.models import rod

Array = NDArray[np.float64]
#: Gauss nodes, and the longest step in parts of 1 / (first bending rate of the rod without weight, or of a pendulum).
NODES, STEP = 10, 0.02
#: Bending and stretch in the plane.
STRAINS = rod.StrainSet("bend-stretch", (1, 5))


def swinging(spec: Any, scenario: Any, times: Array, elements: int) -> tuple[Array, Array]:
    """Positions (T, n + 1, 3) and directors (T, n, 3) of a rod ``spec`` of a ``scenario`` at ``times`` (T,).

    Raises NotImplementedError for rods that are not free at one end and pinned at the other, or leave the plane, and
    RuntimeError for motions that cannot be followed.
    """
    line, gravity = np.asarray(spec.centerline, dtype=float), np.asarray(scenario.gravity, dtype=float)
    pinned = spec.start.value == "pinned" and spec.end.value == "free"
    if not pinned or spec.loads or spec.start_motion or spec.end_motion or np.any(line[:, 1]) or gravity[1]:
        raise NotImplementedError("motions but of rods that hang from a pin in the x-z plane")
    dt = float(times[1] - times[0])
    scene, stepper = _plant(spec.length, spec.radius, spec.material, tuple(gravity.tolist()), dt)
    pieces = round(dt / stepper.dt)
    found = stepper.run(np.empty((pieces * (len(times) - 1), 0)), _start(spec, scene), check=False)
    if not found.success:
        raise RuntimeError(found.message)
    x, points = found.x[::pieces], spec.length * np.linspace(0.0, 1.0, elements + 1)
    positions = scene.fields(x, points)[:, :, :3] + line[0]
    turned = scene.fields(x, 0.5 * (points[1:] + points[:-1]))[:, :, 3:12].reshape(len(x), elements, 3, 3)
    directors = turned @ np.swapaxes(turned[0], 1, 2) @ np.asarray(spec.directors(elements))[..., None]
    return positions, directors[..., 0]


@cache
def _plant(length: float, radius: float, material: Any, gravity: tuple[float, ...], dt: float) -> tuple[rod.Scene, Any]:
    """The scene and what moves it; made once, as what the others compile is."""
    elastic = rod.Elastic(material.youngs_modulus, material.shear_modulus, material.density)
    body = rod.Rod(length, rod.Circle(radius), elastic, STRAINS)
    scene = rod.Scene(body, rod.Gravity(gravity), rod.Base(hinge=(0, 1, 0)), nodes=NODES)
    rate = max(body.bending_rate, float(np.sqrt(np.linalg.norm(gravity) / length)))
    step = dt / np.ceil(dt * rate / STEP - 1e-9)
    return scene, scene.stepper(step, step=step)


def _start(spec: Any, scene: rod.Scene) -> Array:
    """State at rest in the initial shape: turn of its base, curvature and stretch."""
    s = np.linspace(0.0, spec.length, len(spec.centerline))
    s = s if spec.rest_arc_length is None else np.asarray(spec.rest_arc_length, dtype=float)
    tangent = CubicSpline(s, np.asarray(spec.centerline)[:, ::2])(s, 1)
    angle = CubicSpline(s, np.unwrap(np.arctan2(tangent[:, 0], tangent[:, 1])))
    stretch = CubicSpline(s, np.linalg.norm(tangent, axis=1))
    nodes = scene.rule.nodes
    strains = np.stack([angle(nodes, 1), stretch(nodes)], axis=1).ravel()
    return scene.at_rest(np.append(strains, angle(0.0)), np.zeros(0))
