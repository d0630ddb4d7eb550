"""Rods of cosseratbench that are clamped at both ends and driven at one: twisted, sliding along their axis, under load.

The rod is a ``kirchhoff`` one (no shear, no stretch, which move the critical twist of the suite's rod by 4e-4), damped
in proportion to its mass with the critical rate of its slowest mode, as the suite's own adapters do. It does not touch
itself: what happens once it has looped is not that of a real rod.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pisplit.models import rod

Array = NDArray[np.float64]
#: Gauss nodes; a step in parts of 1 / (first bending rate); how far from straight a rod may start, in parts of L.
NODES, STEP, STRAIGHT = 10, 0.03, 1e-2


def driven(spec: Any, scenario: Any, times: Array, elements: int) -> tuple[Array, Array]:
    """Positions (T, n + 1, 3) and directors (T, n, 3) of a rod ``spec`` of a ``scenario`` at ``times`` (T,).

    Raises NotImplementedError for rods that are far from straight, not clamped at both ends, or driven otherwise, and
    RuntimeError for motions that cannot be followed.
    """
    motion, axes = spec.end_motion, _axes(spec)
    _check(spec, scenario, axes)
    force = axes.T @ np.sum([load.force for load in spec.loads if load.at.value == "end"], axis=0)
    drag = 2.0 * scenario.slowest_frequency() * spec.material.density * spec.area
    dt = float(times[1] - times[0])
    scene, stepper = _plant(spec.length, spec.radius, spec.material, tuple(force.tolist()), drag, dt)
    pieces = round(dt / stepper.dt)
    rows = _commands(motion, axes[:, 2], stepper.dt, pieces * (len(times) - 1) + 1)
    start = np.concatenate([_strains(spec, axes, scene), np.zeros(scene.n_strains), rows[0]])
    found = stepper.run(rows[1:], start, check=False)
    if not found.success:
        raise RuntimeError(found.message)
    shape = _shape(scene, elements)
    shapes = [np.asarray(shape(x)).T @ axes.T for x in found.x[::pieces, : scene.n_strains]]
    positions, directors = np.split(np.array(shapes), [elements + 1], axis=1)
    return positions + np.asarray(spec.centerline[0]), directors


def _check(spec: Any, scenario: Any, axes: Array) -> None:
    motion = spec.end_motion
    still = spec.start.value == "clamped" and spec.start_motion is None and motion is not None
    if not still or any(scenario.gravity) or spec.rest_arc_length is not None:
        raise NotImplementedError("ends that are not clamped, a start that moves, weight, or a stretched start")
    if motion.slides_along is None or np.any(motion.displacement) or abs(motion.axis @ axes[:, 2]) < 1.0 - 1e-9:
        raise NotImplementedError("a driven end that does not slide along the rod")
    across = (np.asarray(spec.centerline) - spec.centerline[0]) @ axes[:, :2]
    if np.abs(across).max() > STRAIGHT * spec.length:
        raise NotImplementedError("a driven rod that starts bent")


def _axes(spec: Any) -> Array:
    """Our axes (3, 3) in the world of the suite, as columns: director, the one across, and from end to end."""
    along = np.subtract(spec.centerline[-1], spec.centerline[0])
    along /= np.linalg.norm(along)
    first = np.asarray(spec.normal) - (np.asarray(spec.normal) @ along) * along
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(along, first), along], axis=1)


@cache
def _plant(
    length: float, radius: float, material: Any, force: tuple[float, ...], drag: float, dt: float
) -> tuple[rod.Scene, Any]:
    """The scene and what moves it; made once, as what the others compile is."""
    elastic = rod.Elastic(material.youngs_modulus, material.shear_modulus, material.density)
    body = rod.Rod(length, rod.Circle(radius), elastic, "kirchhoff")
    rotation, spin, spin_rate = (rod.Input(f"tip {name}", 3) for name in ("rotation", "spin", "spin_rate"))
    slides = rod.HeldTip(position=(0.0, 0.0, 0.0), axes="xy", rotation=rotation, spin=spin, spin_rate=spin_rate)
    scene = rod.Scene(body, rod.LinearDrag(drag), rod.TipWrench(force=force), slides, nodes=NODES)
    step = dt / np.ceil(dt * body.bending_rate / STEP - 1e-9)
    return scene, scene.stepper(step, step=step)


@cache
def _shape(scene: rod.Scene, elements: int) -> ca.Function:
    """``xi -> `` positions at the ends of ``elements`` equal pieces, then directors at their middles, (3, 2 n + 1)."""
    free = scene.without(rod.HeldTip)
    xi, _, balance = free.static_balance
    points = free.rod.length * np.linspace(0.0, 1.0, elements + 1)
    frames = balance.motion.frames_at((0.5 * (points[1:] + points[:-1])).tolist())
    columns = [balance.motion.position_at(points.tolist()), *[frame[:, 0] for frame in frames]]
    return ca.Function("shape", [xi], [ca.horzcat(*columns)], {"cse": True})


def _commands(motion: Any, axis: Array, dt: float, number: int) -> Array:
    """Rotation, spin and its rate (number, 9) about our third axis, in steps of ``dt`` from rest to rest."""
    t = dt * np.arange(max(number, int(np.ceil(motion.times[-1] / dt)) + 2))  # to the end of the motion at least
    turns = np.zeros((len(t), 3))
    turns[:, 2] = np.interp(t, motion.times, np.asarray(motion.rotation) @ axis)
    _, rotation, _, _, spin, spin_rate = np.split(rod.tip_commands(dt, np.zeros((len(t), 3)), turns), 6, axis=1)
    return np.hstack([rotation, spin, spin_rate])[:number]


def _strains(spec: Any, axes: Array, scene: rod.Scene) -> Array:
    """Strains (n,) of the initial shape, which is nearly straight: its curvature, no twist."""
    points = (np.asarray(spec.centerline) - spec.centerline[0]) @ axes
    bend = CubicSpline(points[:, 2], points[:, :2], bc_type="clamped")(scene.rule.nodes, 2)
    return np.stack([-bend[:, 1], bend[:, 0], np.zeros(len(bend))], axis=1).ravel()
