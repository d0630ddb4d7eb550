"""Motions that were once wrong without a word, or are known to be hard, by name; on any number of nodes.

Each is a scene, a control interval, commands and a state at the start. What they were wrong by is in the tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit.models import rod

Array = NDArray[np.float64]
#: The paper's arm.
LENGTH, OFFSET = 0.7144, 15.06e-3
SECTION, MATERIAL = rod.Circle(0.675e-3), rod.Elastic(207e9, 207e9 / 2.6, 33249.0)
DOWN = rod.Gravity((-9.81, 0.0, 0.0))


@dataclass(frozen=True)
class Motion:
    """A scene, its control interval in s, commands (T, n_inputs), and the state at the start.

    Attributes:
        scene, dt, u, start: what moves, and how.
        options: of the simulator, beyond its defaults.
    """

    scene: rod.Scene
    dt: float
    u: Array
    start: Array
    options: dict[str, Any] = field(default_factory=dict)

    def on(self, nodes: int) -> Motion:
        """The same motion on another number of nodes an element; rest goes to rest, other states are interpolated."""
        finer = self.scene.with_nodes(nodes)
        weights = self.scene.rule.interpolate(finer.rule.nodes)
        *parts, u = self.scene.layout.split(self.start)
        fields = self.scene.rod.strain_set.n_fields
        moving = [(weights @ part.reshape(-1, self.scene.nodes, fields)).ravel() for part in parts]
        return Motion(finer, self.dt, self.u, np.concatenate([*moving, u]), self.options)


def _held(scene: rod.Scene, u: Array, servos: Array | None = None) -> Array:
    """State at rest under ``u``, with the inputs at ``servos`` where these are given."""
    rest = scene.statics().solve(u)
    if not rest.success:
        raise RuntimeError(f"no rest to start from: {rest.message}")
    return scene.state(rest.strains, np.zeros(scene.n_strains), u if servos is None else servos)


def paper_scene(strains: str, nodes: int, *damping: Any) -> rod.Scene:
    """The paper's arm with other free strains, damped in bending and torsion if not told otherwise."""
    body = rod.Rod(LENGTH, SECTION, MATERIAL, strains)
    tendons = rod.Tendons.parallel(OFFSET, (0, 120, 240), drive=rod.Displacement(1e-4))
    return rod.Scene(
        body,
        DOWN,
        *(damping or (rod.KelvinVoigt(bending=5e-4, torsion=5e-4),)),
        rod.QuadraticDrag(1e-4),
        tendons,
        nodes=nodes,
    )


def jump(strains: str, target: tuple[float, ...], option: bool, nodes: int, *damping: Any) -> Motion:
    """Tendons of the paper's arm jump by 1 to 2 mm: servos that are there already, or ``inputs="step"``."""
    scene = paper_scene(strains, nodes, *damping)
    u = np.tile(target, (20, 1))
    rest = np.full(3, 1e-3)
    if option:
        return Motion(scene, 0.03, u, _held(scene, rest), {"inputs": "step"})
    return Motion(scene, 0.03, u, _held(scene, rest, u[0]))


def ramps(strains: str, amplitude: float, nodes: int) -> Motion:
    """The paper's arm follows random commands of ``amplitude`` m, a new one every 30 ms."""
    scene = paper_scene(strains, nodes)
    u = 1e-3 + amplitude * np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3))
    return Motion(scene, 0.03, u, _held(scene, np.full(3, 1e-3)))


def waves(strains: str, nodes: int) -> Motion:
    """The paper's arm follows slow sines of 8 mm."""
    scene = paper_scene(strains, nodes)
    t = 0.03 * np.arange(1, 101)
    wave = np.stack([np.sin(2.0 * t), np.sin(3.1 * t)], axis=1)
    angles = np.deg2rad([0.0, 120.0, 240.0])
    u = 1e-3 + 8e-3 * wave @ np.stack([np.cos(angles), np.sin(angles)])
    return Motion(scene, 0.03, u, _held(scene, np.full(3, 1e-3)))


def ring_down(strains: str, pluck: float, ratio: float, periods: int, steps: int, nodes: int) -> Motion:
    """A soft rod that is bent by ``pluck`` of its length, let go, and swings for ``periods`` of its first mode."""
    body = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e6, 1e6 / 3.0, 1000.0), strains)
    stiffness, rate = body.stiffness[1], body.bending_rate
    damping = rod.KelvinVoigt(bending=2.0 * ratio * stiffness / rate, torsion=2.0 * ratio * stiffness / rate)
    scene = rod.Scene(body, damping, rod.TipWrench(force=rod.Input("force", 3)), nodes=nodes)
    start = _held(scene, np.array([3.0 * pluck * stiffness / 0.25, 0.0, 0.0]), np.zeros(3))
    return Motion(scene, 2.0 * np.pi / rate / steps, np.zeros((periods * steps, 3)), start)


def steel_ramp(strains: str, nodes: int) -> Motion:
    """A steel rod under a tip force that grows to 2 EI/L^2 within 30 ms and stays; a drag damps it."""
    body = rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(207e9, 69e9, 8000.0), strains)
    drag = rod.LinearDrag(20.0 * 8000.0 * np.pi * 1e-6)
    scene = rod.Scene(body, drag, rod.TipWrench(force=rod.Input("force", 3)), nodes=nodes)
    force = 2.0 * body.stiffness[0] / 0.16 * np.minimum(1.0, np.arange(1, 25) / 12.0)
    return Motion(scene, 2.5e-3, np.outer(force, [1.0, 0.0, 0.0]), _held(scene, np.zeros(3)))


def pendulum(strains: str, nodes: int) -> Motion:
    """A soft rod clamped at its upper end that is let go from the horizontal."""
    body = rod.Rod(0.5, rod.Circle(5e-3), rod.Elastic(5e5, 5e5 / 3.0, 1000.0), strains)
    damping = rod.KelvinVoigt(bending=1e-6, torsion=1e-6)
    scene = rod.Scene(body, DOWN, damping, nodes=nodes)
    return Motion(scene, 0.02, np.zeros((24, 0)), np.zeros(scene.n_states))


def swimmer(nodes: int) -> Motion:
    """A soft rod in water whose two chambers are pressed in turn: waves run along it against anisotropic drag."""
    body = rod.Rod(0.4, rod.Circle(8e-3), rod.Elastic(3e5, 1e5, 1000.0), "planar")
    drag = rod.AnisotropicDrag(normal_quadratic=8.0, tangential_quadratic=0.2)
    chambers = rod.Chambers(5e-5, [(5e-3, 0.0), (-5e-3, 0.0)])
    scene = rod.Scene(body, drag, rod.Retardation(0.01), chambers, nodes=nodes)
    push = 2e4 * np.sin(2.0 * np.pi * 2.0 * 0.02 * np.arange(1, 61))
    u = np.stack([np.maximum(0.0, push), np.maximum(0.0, -push)], axis=1)
    return Motion(scene, 0.02, u, _held(scene, np.zeros(2)))


def chamber_arm(nodes: int) -> Motion:
    """A soft arm that hangs, three chambers pressed one after another."""
    body = rod.Rod(0.2, rod.Circle(0.015), rod.Elastic(3e5, 1e5, 1070.0), "extensible")
    chambers = rod.Chambers.parallel(8e-5, 9e-3, (0, 120, 240))
    scene = rod.Scene(body, rod.Gravity((0.0, 0.0, 9.81)), rod.Retardation(0.02), chambers, nodes=nodes)
    t = 0.03 * np.arange(1, 41)
    u = 2.5e4 * np.stack([np.sin(4.0 * t + phase) ** 2 for phase in (0.0, 1.0, 2.0)], axis=1)
    return Motion(scene, 0.03, u, _held(scene, np.zeros(3)))


def silicone_arm(nodes: int) -> Motion:
    """A thin silicone arm that sags, pulled by two tendons in turn."""
    body = rod.Rod(0.3, rod.Circle(5e-3), rod.Elastic(5e5, 5e5 / 2.9, 1070.0))
    tendons = rod.Tendons.parallel(4e-3, (0, 120, 240), drive=rod.Tension())
    scene = rod.Scene(body, DOWN, rod.Retardation(2e-2), tendons, nodes=nodes)
    t = 0.05 * np.arange(1, 25)
    u = np.stack([0.1 * np.sin(5.0 * t) ** 2, 0.1 * np.sin(3.0 * t) ** 2, 0.0 * t], axis=1)
    return Motion(scene, 0.05, u, _held(scene, np.zeros(3)))


def tension_jump(nodes: int) -> Motion:
    """A thick soft arm with shear and stretch, whose tendons jump to five times their tension."""
    body = rod.Rod(0.3, rod.Circle(0.01), rod.Elastic(5e5, 5e5 / 2.9, 1070.0), "cosserat")
    tendons = rod.Tendons.parallel(8e-3, (0, 120, 240), drive=rod.Tension())
    scene = rod.Scene(body, rod.Gravity((0.0, 0.0, 9.81)), rod.Retardation(5e-3), tendons, nodes=nodes)
    u = np.tile([1.0, 0.2, 0.2], (20, 1))
    return Motion(scene, 0.03, u, _held(scene, np.full(3, 0.2), u[0]))


def helical(turns: float, nodes: int) -> Motion:
    """A soft arm curled up by a helical tendon of some turns."""
    body = rod.Rod(0.3, rod.Circle(0.01), rod.Elastic(5e5, 5e5 / 2.9, 1070.0), "cosserat")
    tendons = rod.Tendons.helical(8e-3, 0.3 / turns, (0,), drive=rod.Tension())
    scene = rod.Scene(body, rod.Gravity((0.0, 0.0, 9.81)), rod.Retardation(2e-2), tendons, nodes=nodes)
    return Motion(scene, 0.03, np.linspace(0.05, 1.0, 20)[:, None], _held(scene, np.zeros(1)))


def tapered(ratio: float, nodes: int) -> Motion:
    """A soft tentacle whose radius falls by ``ratio``, hanging sideways, pulled by a tendon."""
    section = rod.Tapered(rod.Circle(0.012), rod.Circle(0.012 / ratio))
    body = rod.Rod(0.2, section, rod.Elastic(1e5, 1e5 / 3.0, 1042.0), "planar")
    line = rod.Line((0.0096, 0.0), (0.0096 / ratio, 0.0), 0.2)
    scene = rod.Scene(
        body,
        rod.Gravity((0.0, 0.0, 9.81)),
        rod.Retardation(0.05),
        rod.Tendons([line], drive=rod.Tension()),
        nodes=nodes,
    )
    return Motion(scene, 0.03, np.linspace(1e-3, 2e-2, 20)[:, None], _held(scene, np.zeros(1)))


def rolled(turns: float, nodes: int) -> Motion:
    """A rod that is rolled up by a moment at its tip, over five natural periods."""
    body = rod.Rod(0.5, rod.Circle(5e-3), rod.Elastic(1e6, 1e6 / 3.0, 1000.0), "planar")
    damping = rod.KelvinVoigt(bending=0.1 * body.stiffness[1] / body.bending_rate)
    scene = rod.Scene(body, damping, rod.TipWrench(moment=rod.Input("moment", 3)), nodes=nodes)
    moment = 2.0 * np.pi * turns * body.stiffness[1] / 0.5
    u = np.outer(np.linspace(0.05, 1.0, 20), [0.0, moment, 0.0])
    return Motion(scene, 0.5 * np.pi / body.bending_rate, u, _held(scene, np.zeros(3)))


def coiled(coils: float, nodes: int) -> Motion:
    """A rod that is a coil of some turns when unloaded, pushed sideways at its tip."""
    curvature = (0.0, 2.0 * np.pi * coils / 0.5, 0.0)
    body = rod.Rod(0.5, rod.Circle(2e-3), rod.Elastic(1e8, 3e7, 1000.0), "planar", curvature)
    damping = rod.KelvinVoigt(bending=0.1 * body.stiffness[1] / body.bending_rate)
    scene = rod.Scene(body, damping, rod.TipWrench(force=rod.Input("force", 3)), nodes=nodes)
    u = np.outer(np.linspace(0.05, 1.0, 20), [body.stiffness[1] / 0.25, 0.0, 0.0])
    return Motion(scene, 0.5 * np.pi / body.bending_rate, u, _held(scene, np.zeros(3)))


def motions() -> dict[str, Callable[[int], Motion]]:
    """All of them, by name, as functions of the number of nodes an element."""
    one, all_three = (3e-3, 1e-3, 1e-3), (2e-3, 2e-3, 2e-3)
    found: dict[str, Callable[[int], Motion]] = {}
    for strains in ("cosserat", "extensible", "kirchhoff"):
        found[f"2 mm on one tendon, step inputs, {strains}"] = partial(jump, strains, one, True)
        found[f"2 mm on one tendon, servos there, {strains}"] = partial(jump, strains, one, False)
    found["1 mm on all tendons, servos there, cosserat"] = partial(jump, "cosserat", all_three, False)
    for strains in ("cosserat", "kirchhoff"):
        found[f"5 mm random ramps, {strains}"] = partial(ramps, strains, 5e-3)
        found[f"slow sines, {strains}"] = partial(waves, strains)
        found[f"steel ramp, {strains}"] = partial(steel_ramp, strains)
    for strains in ("planar", "kirchhoff"):
        for pluck in (1e-3, 1e-2, 0.1):
            found[f"ring-down from {pluck:g} L, {strains}"] = partial(ring_down, strains, pluck, 0.02, 5, 20)
        found[f"soft pendulum, {strains}"] = partial(pendulum, strains)
    found["swimmer"], found["chamber arm"], found["silicone arm"] = swimmer, chamber_arm, silicone_arm
    found["tension jump, cosserat"] = tension_jump
    for turns in (1.0, 2.0):
        found[f"helical tendon of {turns:g} turns"] = partial(helical, turns)
    for ratio in (10.0, 100.0):
        found[f"taper {ratio:g}:1"] = partial(tapered, ratio)
    for turns in (1.0, 2.0, 3.0):
        found[f"rolled {turns:g} turns"] = partial(rolled, turns)
    found["rest curvature of ten coils"] = partial(coiled, 10.0)
    return found
